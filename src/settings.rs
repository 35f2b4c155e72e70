//! What a user can set, its ranges and its defaults.

mod check;
mod fields;

use crate::compensation::backlash::{Flank, Overlay, PlayConfig};
use crate::compensation::calibration::{Calibration, MotorData, row_bits};
use crate::compensation::law::Switches;
use crate::motion::budget::{Rates, take_up_quarter};
use crate::sense::SenseInputs;
use crate::stepgen::timing::MotorTiming;
use crate::units::steps::{steps_to_units, units_to_steps};
use crate::units::{AXES, Axis, wide};
use serde::{Deserialize, Serialize};

/// How backlash of a motor is dealt with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum BacklashMode {
    /// The overlay stays as it is.
    Off,
    /// Taken up on every change of direction of the motor.
    #[default]
    Reversal,
    /// Every positioning move ends in the positive direction of the motor.
    UniPositive,
    /// Every positioning move ends in the negative direction of the motor.
    UniNegative,
}

impl BacklashMode {
    /// The flank on which moves end, of the one-directional modes.
    pub fn ending(self) -> Option<Flank> {
        match self {
            BacklashMode::UniPositive => Some(Flank::Positive),
            BacklashMode::UniNegative => Some(Flank::Negative),
            BacklashMode::Off | BacklashMode::Reversal => None,
        }
    }
}

/// Backlash of one motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct BacklashSettings {
    /// How it is dealt with.
    pub mode: BacklashMode,
    /// Width of the play, nm or nrad.
    pub distance: i32,
    /// Largest velocity of a take-up, nm/s or nrad/s: with it goes the same share of acceleration and jerk.
    pub velocity: u64,
    /// Steps of retreat that are not yet a reversal.
    pub dead_band: i32,
    /// Steps beyond the play of a one-directional overshoot.
    pub margin: i32,
}

/// An end of a motor's travel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Side {
    /// The lower end.
    #[default]
    Lower,
    /// The upper end.
    Upper,
}

/// How the inputs and outputs of a motor beside STEP and DIR are wired: facts of the cabinet, which `*RST` and another
/// calibration leave alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wiring {
    /// Its limit switches are watched: they stop motion.
    pub limits_on: bool,
    /// Its limit switches are active when their line is high.
    pub limits_high: bool,
    /// The enable line of its driver is active when high.
    pub enable_high: bool,
    /// The fault line of its driver is active when high.
    pub fault_high: bool,
}

impl Default for Wiring {
    /// Limit switches are not watched, so that a bare board moves. All inputs are pulled up: a normally closed switch
    /// to ground is active when its line is high, and so is a broken wire; a fault line is an open collector to ground.
    fn default() -> Self {
        Wiring { limits_on: false, limits_high: true, enable_high: false, fault_high: false }
    }
}

/// How an axis is homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HomeSettings {
    /// On the limit switch of this end.
    pub side: Side,
    /// Velocity of the fast approach, nm/s or nrad/s.
    pub velocity: u64,
    /// Where the motor stands once it is homed, nm or nrad; none: the end of the travel on that side.
    pub offset: Option<i32>,
}

impl HomeSettings {
    /// Where the motor stands once it is homed, nm or nrad.
    pub fn reference(&self, motor: &MotorData) -> i32 {
        self.offset.unwrap_or(match self.side {
            Side::Lower => motor.travel_lower,
            Side::Upper => motor.travel_upper,
        })
    }
}

/// Settings of one axis and its motor. Lengths in nm or nrad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AxisSettings {
    /// Wanted velocity of the logical axis, per s.
    pub velocity: u64,
    /// Velocity above which an immediate stop makes the position uncertain, per s.
    pub start_velocity: u64,
    /// Wanted acceleration, per s^2.
    pub acceleration: u64,
    /// Wanted jerk, per s^3.
    pub jerk: u64,
    /// Lower soft limit.
    pub soft_lower: i32,
    /// Upper soft limit.
    pub soft_upper: i32,
    /// Soft limits are watched.
    pub soft_on: bool,
    /// Step size without a calibration, Q32.
    pub step_q32: u64,
    /// DIR is inverted.
    pub inverted: bool,
    /// Pulse timing of the driver.
    pub timing: MotorTiming,
    /// Backlash.
    pub backlash: BacklashSettings,
    /// Switches and driver lines.
    pub wiring: Wiring,
    /// Homing.
    pub home: HomeSettings,
}

/// Everything that a user can set and that `*RST` sets back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settings {
    /// Per axis.
    pub axes: [AxisSettings; AXES],
    /// Parts of the compensation.
    pub switches: Switches,
    /// Speed override, percent.
    pub override_percent: u8,
    /// A jog ends after this time without traffic on its link, ms.
    pub jog_timeout_ms: u32,
    /// Serial port, bits per second. `*RST` leaves it: the link that asks for it must go on.
    pub baud: u32,
    /// Power inputs.
    pub sense: SenseInputs,
}

/// Least acceleration and jerk, nm or nrad per s^2 and s^3.
pub const RATE_MIN: u64 = 1000;
/// Most steps of dead band and margin.
pub const STEPS_MAX: i32 = 1 << 20;
/// Shortest time without traffic after which a jog ends, ms.
pub const JOG_TIMEOUT_MIN_MS: u32 = 10;
/// Longest, ms.
pub const JOG_TIMEOUT_MAX_MS: u32 = 3_600_000;
/// Serial port after the first power-up, bits per second.
pub const BAUD_DEFAULT: u32 = 115_200;
/// Slowest serial port, bits per second.
pub const BAUD_MIN: u32 = 9_600;
/// Fastest serial port, bits per second.
pub const BAUD_MAX: u32 = 1_000_000;

/// Largest share of a motor that a take-up may use: a half.
pub const TAKE_UP_SHARE_MAX: u64 = 2;
/// Smallest share: a hundredth.
pub const TAKE_UP_SHARE_MIN: u64 = 100;
/// Default share: a tenth.
pub const TAKE_UP_SHARE_DEFAULT: u64 = 10;

/// Default velocity of homing: this part of the motor's.
pub const HOME_PART: u64 = 4;

/// Motor data that hold while no calibration is loaded: the coarse steps and modest rates of a common stage.
pub fn uncalibrated(axis: Axis, step_q32: u64) -> MotorData {
    let (travel, velocity, acceleration, jerk) = if axis.is_rotary() {
        (87_266_463, 34_906_585, 349_065_850, 6_981_317_008)
    } else {
        (25_000_000, 2_000_000, 20_000_000, 400_000_000)
    };
    MotorData {
        step_q32,
        row_bits: row_bits(step_q32),
        backlash_steps: 0,
        travel_lower: -travel,
        travel_upper: travel,
        velocity,
        acceleration,
        jerk,
    }
}

/// Step size while nothing else is known, Q32: 50 nm or 4 urad.
pub fn default_step_q32(axis: Axis) -> u64 {
    if axis.is_rotary() { 4_000 << 32 } else { 50 << 32 }
}

impl AxisSettings {
    /// The defaults: the calibration's values where it has one.
    pub fn defaults(motor: &MotorData) -> Self {
        AxisSettings {
            velocity: motor.velocity,
            start_velocity: motor.velocity,
            acceleration: motor.acceleration,
            jerk: motor.jerk,
            soft_lower: motor.travel_lower,
            soft_upper: motor.travel_upper,
            soft_on: true,
            step_q32: motor.step_q32,
            inverted: false,
            timing: MotorTiming::default(),
            backlash: BacklashSettings {
                mode: BacklashMode::Reversal,
                distance: steps_to_units(i64::from(motor.backlash_steps), motor.step_q32) as i32,
                velocity: (motor.velocity / TAKE_UP_SHARE_DEFAULT).max(1),
                dead_band: 1,
                margin: 10,
            },
            wiring: Wiring::default(),
            home: HomeSettings { side: Side::Lower, velocity: (motor.velocity / HOME_PART).max(1), offset: None },
        }
    }

    /// Width of the play in whole steps.
    pub fn backlash_steps(&self, motor: &MotorData) -> i32 {
        units_to_steps(i64::from(self.backlash.distance), motor.step_q32).clamp(0, 1 << 20) as i32
    }

    /// Reserve of the motor for take-up: none where none can come. `overlay`: in steps, as it is now.
    pub fn reserve(&self, motor: &MotorData, overlay: i32) -> Rates {
        if self.backlash.mode == BacklashMode::Off || (self.backlash.distance == 0 && overlay == 0) {
            return Rates::default();
        }
        let share = wide::div_up(u128::from(self.backlash.velocity) << 10, u128::from(motor.velocity.max(1)));
        motor_rates(motor).share(share.max(1).min(1024 / u128::from(TAKE_UP_SHARE_MAX)) as u32)
    }

    /// Configuration of the motor's play in the generator. `overlay`: in steps, as it is now; from a play that was
    /// set before it may be farther to the next one than its width.
    pub fn play(&self, motor: &MotorData, switches: Switches, overlay: i32) -> PlayConfig {
        let width = self.backlash_steps(motor);
        let farthest = width.max(overlay.saturating_abs()).max(overlay.saturating_add(width).saturating_abs());
        let follows = match (switches.compensation && switches.backlash, self.backlash.mode) {
            (false, _) | (_, BacklashMode::Off) => Overlay::Frozen,
            (true, BacklashMode::Reversal) => Overlay::Follow,
            (true, BacklashMode::UniPositive) => Overlay::Fixed(Flank::Positive),
            (true, BacklashMode::UniNegative) => Overlay::Fixed(Flank::Negative),
        };
        PlayConfig {
            width,
            dead_band: self.backlash.dead_band,
            reference: Flank::Positive,
            quarter: take_up_quarter(farthest.unsigned_abs(), self.reserve(motor, overlay)),
            overlay: follows,
        }
    }

    /// Wanted rates of the logical axis, nm or nrad per segment^k.
    pub fn wanted(&self) -> Rates {
        Rates::per_segment(self.velocity, self.acceleration, self.jerk, 1 << 32)
    }
}

/// Limits of a motor, steps per segment^k.
pub fn motor_rates(motor: &MotorData) -> Rates {
    Rates::per_segment(motor.velocity, motor.acceleration, motor.jerk, motor.step_q32)
}

impl Settings {
    /// The defaults for a calibration, or without one.
    pub fn defaults(calibration: Option<&Calibration>) -> Self {
        let motors = motors(calibration, None);
        Settings {
            axes: motors.map(|m| AxisSettings::defaults(&m)),
            switches: Switches::default(),
            override_percent: 100,
            jog_timeout_ms: 1000,
            baud: BAUD_DEFAULT,
            sense: SenseInputs::default(),
        }
    }
}

/// Motor data in force: the calibration's, or the uncalibrated ones with the step sizes set by hand.
pub fn motors(calibration: Option<&Calibration>, settings: Option<&Settings>) -> [MotorData; AXES] {
    match calibration {
        Some(calibration) => calibration.motors,
        None => Axis::ALL.map(|axis| {
            let step = settings.map_or(default_step_q32(axis), |s| s.axes[axis.index()].step_q32);
            uncalibrated(axis, step)
        }),
    }
}
