//! Ranges of settings that come from storage: those of the commands, all at once.

use super::{
    AxisSettings, BAUD_MAX, BAUD_MIN, JOG_TIMEOUT_MAX_MS, JOG_TIMEOUT_MIN_MS, RATE_MIN, STEPS_MAX, Settings,
    TAKE_UP_SHARE_MAX,
};
use crate::compensation::calibration::{MotorData, STEP_END, STEP_MIN};
use crate::error::{Error, ErrorNumber};
use crate::units::{AXES, Axis, COORDINATE_LIMIT};

impl Settings {
    /// Every value must be one that its command would take. Pulse timing and step rates are judged where they are put
    /// in force.
    ///
    /// # Errors
    /// -222 with what is beyond its range.
    pub fn check(&self, motors: &[MotorData; AXES]) -> Result<(), Error> {
        let within = (1..=100).contains(&self.override_percent)
            && (JOG_TIMEOUT_MIN_MS..=JOG_TIMEOUT_MAX_MS).contains(&self.jog_timeout_ms)
            && (BAUD_MIN..=BAUD_MAX).contains(&self.baud);
        if !within {
            return Err(Error::text(ErrorNumber::DataOutOfRange, "speed override, jog time-out or baud rate"));
        }
        if !self.sense.iter().all(|input| input.is_good()) {
            return Err(Error::text(ErrorNumber::DataOutOfRange, "a saved power input"));
        }
        for ((axis, own), motor) in Axis::ALL.into_iter().zip(&self.axes).zip(motors) {
            own.check(motor).map_err(|what| Error::axis_text(ErrorNumber::DataOutOfRange, axis, what))?;
        }
        Ok(())
    }
}

impl AxisSettings {
    fn check(&self, motor: &MotorData) -> Result<(), &'static str> {
        let rate = |value: u64, least: u64, most: u64| (least.min(most)..=most).contains(&value);
        let steps = |value: i32| (0..=STEPS_MAX).contains(&value);
        let coordinate = |value: i32| (-COORDINATE_LIMIT..=COORDINATE_LIMIT).contains(&value);
        let rates = rate(self.velocity, 1, motor.velocity)
            && rate(self.start_velocity, 0, motor.velocity)
            && rate(self.acceleration, RATE_MIN, motor.acceleration)
            && rate(self.jerk, RATE_MIN, motor.jerk);
        let limits = coordinate(self.soft_lower) && coordinate(self.soft_upper) && self.soft_lower < self.soft_upper;
        let play = &self.backlash;
        let backlash = (0..=COORDINATE_LIMIT).contains(&play.distance)
            && rate(play.velocity, 1, (motor.velocity / TAKE_UP_SHARE_MAX).max(1))
            && steps(play.dead_band)
            && steps(play.margin);
        let checks = [
            (rates, "a saved rate"),
            (limits, "a saved soft limit"),
            ((STEP_MIN..STEP_END).contains(&self.step_q32), "the saved step size"),
            (backlash, "the saved backlash"),
            (rate(self.home.velocity, 1, motor.velocity), "the saved velocity of homing"),
            (self.home.offset.is_none_or(coordinate), "the saved home offset"),
        ];
        checks.iter().find(|(good, _)| !good).map_or(Ok(()), |(_, what)| Err(*what))
    }
}
