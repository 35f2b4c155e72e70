//! What is named or set at standstill: counts, drivers, pulses, settings.

use super::orders::Waiting;
use super::storage::timing;
use super::{Abort, Anchored, Front, NO_LIMITS, PIVOTS, check_step_rates};
use crate::compensation::backlash::Overlay;
use crate::compensation::law::Law;
use crate::error::{Error, ErrorNumber};
use crate::motion::limits::{AxisLimits, Limits};
use crate::settings::{self, AxisSettings, Settings};
use crate::units::steps::units_to_steps;
use crate::units::{AXES, Axis, MotorSteps};

impl Front {
    /// Stands at motor counts: the pose follows from the law, no motor moves.
    pub(super) fn stand_at(&mut self, steps: MotorSteps) {
        self.forget_stopped_scan();
        let pose = self.capability.law.forward(steps);
        self.planner.rest_at(pose);
        // the queue was just cleared or has room: standstill comes first
        let _ = self.order(Waiting::Anchor { pose, steps });
        self.anchor = Some(Anchored { steps, sequence: self.sequence });
        self.show_anchor();
    }

    /// Names the coordinate at which an axis stands: re-anchors the count of its motor alone.
    ///
    /// # Errors
    /// 104 while moving, -222 beyond the arithmetic's range.
    pub fn set_position(&mut self, axis: Axis, x: i64) -> Result<(), Error> {
        self.standstill()?;
        let i = axis.index();
        let law = &self.capability.law;
        let unlimited = Limits([NO_LIMITS; AXES]);
        unlimited.check_coordinate(law, axis, x)?;
        let mut steps = self.report.final_steps;
        for _ in 0..8 {
            let lack = x - i64::from(law.forward(steps).0[i]);
            let by = units_to_steps(lack, law.step_q32(i));
            if by == 0 {
                break;
            }
            steps.0[i] = steps.0[i].wrapping_add(by as i32);
        }
        if !law.names(steps) {
            return Err(Error::axis(ErrorNumber::DataOutOfRange, axis));
        }
        self.homed[i] = true;
        self.uncertain[i] = false;
        self.stand_at(steps);
        self.refresh();
        Ok(())
    }

    /// Enables or disables a motor.
    ///
    /// # Errors
    /// 104 when it is to be disabled while moving, 112 when it is to be enabled while its driver reports a fault.
    pub fn set_enabled(&mut self, axis: Axis, on: bool) -> Result<(), Error> {
        if !on {
            self.standstill()?;
        } else if self.driver_faults() >> axis.index() & 1 != 0 {
            return Err(Error::axis_text(
                ErrorNumber::DriverFault,
                axis,
                "fault line active; clear the driver or set FAULt:POLarity",
            ));
        }
        self.enabled[axis.index()] = on;
        self.refresh();
        Ok(())
    }

    /// Pulse timing and sense of the motors; no motor moves.
    ///
    /// # Errors
    /// 104 while moving, -221 when a motor's velocity needs more steps per second than the timing allows, or when
    /// the times are too long.
    pub fn set_pulses(&mut self, settings: &Settings) -> Result<(), Error> {
        self.standstill()?;
        let timing = timing(settings)?;
        check_step_rates(&timing, &self.motors())?;
        self.order(Waiting::Pulses)?;
        self.timing = timing;
        self.settings.axes = settings.axes;
        Ok(())
    }

    /// Takes over settings of axes: rates and limits at any time but in a scan, backlash width and mode, wiring and homing
    /// at standstill.
    ///
    /// # Errors
    /// -213 while a scan runs, whose route was checked with those of before, 104 when backlash width, mode or reserve, the wiring or the homing change while moving.
    pub fn set_axes(&mut self, settings: &Settings) -> Result<(), Error> {
        self.not_scanning()?;
        for (new, own) in settings.axes.iter().zip(&self.settings.axes) {
            let reserve = |a: &AxisSettings| (a.backlash.mode, a.backlash.distance, a.backlash.velocity);
            if reserve(new) != reserve(own) || (new.wiring, new.home) != (own.wiring, own.home) {
                self.standstill()?;
            }
        }
        self.settings.axes = settings.axes;
        self.refresh_plays()
    }

    /// Step size of a motor while no calibration is loaded; the motor stays where it is.
    ///
    /// # Errors
    /// -221 with a calibration loaded, 104 while moving.
    pub fn set_step(&mut self, axis: Axis, step_q32: u64) -> Result<(), Error> {
        if self.calibration.is_some() {
            return Err(Error::text(ErrorNumber::SettingsConflict, "the calibration gives the step size"));
        }
        self.standstill()?;
        let mut settings = self.settings;
        settings.axes[axis.index()].step_q32 = step_q32;
        let motors = settings::motors(None, Some(&settings));
        check_step_rates(&self.timing, &motors)?;
        self.check_standing(&Law::identity(&motors))?;
        self.settings = settings;
        self.change_law()
    }

    /// All settings to their defaults; calibration, home and limits stay, nothing moves.
    pub fn reset(&mut self) {
        self.abort();
        let fresh = Settings::defaults(self.calibration.as_ref());
        for (own, new) in self.settings.axes.iter_mut().zip(&fresh.axes) {
            let kept = *own;
            *own = *new;
            (own.soft_lower, own.soft_upper, own.soft_on) = (kept.soft_lower, kept.soft_upper, kept.soft_on);
            (own.step_q32, own.wiring, own.home) = (kept.step_q32, kept.wiring, kept.home);
        }
        self.settings.override_percent = fresh.override_percent;
        self.settings.jog_timeout_ms = fresh.jog_timeout_ms;
        self.settings.switches = fresh.switches;
        self.reset_sense();
        self.pivot = 0;
        self.pivots = [None; PIVOTS];
        self.reset_compare();
        if self.abort == Abort::None {
            let _ = self.set_pulses(&fresh_pulses(&self.settings, &fresh)).and_then(|()| self.change_law());
        } else {
            self.settings = fresh_pulses(&self.settings, &fresh);
            self.reset_due = true;
        }
    }

    /// What follows from the settings for planning.
    pub(super) fn refresh(&mut self) {
        let motors = self.motors();
        for (i, own) in self.settings.axes.iter().enumerate() {
            let motor = &motors[i];
            self.capability.motors[i] = settings::motor_rates(motor).less(own.reserve(motor, self.report.overlay[i]));
            self.capability.wanted[i] = own.wanted();
            self.capability.limits.0[i] = AxisLimits {
                soft_lower: own.soft_lower,
                soft_upper: own.soft_upper,
                soft_on: own.soft_on,
                travel_lower: motor.travel_lower,
                travel_upper: motor.travel_upper,
                homed: self.homed[i],
                enabled: self.enabled[i],
            };
        }
        self.refresh_homing();
        self.refresh_scan();
        self.refresh_watch();
        self.capability.override_percent = self.settings.override_percent;
    }

    /// The same, and the generator's backlash configuration where it changes.
    pub(super) fn refresh_plays(&mut self) -> Result<(), Error> {
        self.refresh();
        let motors = self.motors();
        for (i, motor) in motors.iter().enumerate() {
            let mut config = self.settings.axes[i].play(motor, self.settings.switches, self.report.overlay[i]);
            if self.is_homing(i) {
                config.overlay = Overlay::Frozen;
            }
            if self.told[i] != Some(config) {
                self.order(Waiting::Play { motor: i as u8, config })?;
                self.told[i] = Some(config);
            }
        }
        Ok(())
    }
}

/// The settings with the pulse times and senses of the fresh ones.
fn fresh_pulses(own: &Settings, fresh: &Settings) -> Settings {
    let mut settings = *own;
    for (to, from) in settings.axes.iter_mut().zip(&fresh.axes) {
        (to.timing, to.inverted) = (from.timing, from.inverted);
    }
    settings
}
