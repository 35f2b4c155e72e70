//! What a motion may not exceed: soft limits of the logical axes, travel of the motors, enabled motors.

use super::bounds::Bounds;
use crate::compensation::law::{Law, Remembered};
use crate::error::{Detail, Error, ErrorNumber};
use crate::settings::steps_to_units;
use crate::units::{ANGLE_LIMIT, AXES, Axis, COORDINATE_LIMIT, FinePose, Pose};

/// Limits of one axis and of its motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AxisLimits {
    /// Lower soft limit, nm or nrad.
    pub soft_lower: i32,
    /// Upper soft limit, nm or nrad.
    pub soft_upper: i32,
    /// The soft limits are watched.
    pub soft_on: bool,
    /// Lower end of the motor's travel, nm or nrad.
    pub travel_lower: i32,
    /// Upper end of the motor's travel, nm or nrad.
    pub travel_upper: i32,
    /// The axis is homed: its limits mean something.
    pub homed: bool,
    /// The motor is enabled.
    pub enabled: bool,
}

/// The limits of all axes.
#[derive(Clone, Copy, Debug)]
pub struct Limits(pub [AxisLimits; AXES]);

fn beyond(axis: Axis, value: i64, bound: i64, motor: bool) -> Error {
    Error { number: ErrorNumber::DataOutOfRange, detail: Detail::Limit { axis, value, bound, motor } }
}

impl Limits {
    /// Checks one logical coordinate.
    ///
    /// # Errors
    /// -222 with the axis, the value and the bound.
    pub fn check_coordinate(&self, law: &Law, axis: Axis, value: i64) -> Result<(), Error> {
        let (lower, upper) = self.range(law, axis);
        if value < i64::from(lower) {
            return Err(beyond(axis, value, i64::from(lower), false));
        }
        if value > i64::from(upper) {
            return Err(beyond(axis, value, i64::from(upper), false));
        }
        Ok(())
    }

    /// The logical range of an axis that commands may use, nm or nrad.
    pub fn range(&self, law: &Law, axis: Axis) -> (i32, i32) {
        let own = &self.0[axis.index()];
        // the rotation-centre law holds sixteenths of a nanoradian in 32 bits
        let hard = if axis.is_rotary() && law.lever_nm() != 0 { ANGLE_LIMIT } else { COORDINATE_LIMIT };
        if own.soft_on && own.homed {
            (own.soft_lower.max(-hard), own.soft_upper.min(hard))
        } else {
            (-hard, hard)
        }
    }

    /// Checks a pose.
    ///
    /// # Errors
    /// -222 with the first axis beyond its limit.
    pub fn check_pose(&self, law: &Law, pose: Pose) -> Result<(), Error> {
        for axis in Axis::ALL {
            self.check_coordinate(law, axis, i64::from(pose.0[axis.index()]))?;
        }
        Ok(())
    }

    /// Checks what the motors do along a path: travel of the homed ones, and that all that step are enabled.
    /// `others`: how far other tracks may still take each motor either way, Q32 steps.
    ///
    /// # Errors
    /// -222 with the motor, its position and the end of its travel; 108 with the disabled axis.
    pub fn check_motors(&self, law: &Law, bounds: &Bounds, others: &[i64; AXES]) -> Result<(), Error> {
        for axis in Axis::ALL {
            let i = axis.index();
            let own = &self.0[i];
            if bounds.steps >> i & 1 != 0 && !own.enabled {
                return Err(Error::axis(ErrorNumber::AxisDisabled, axis));
            }
            if !own.homed {
                continue;
            }
            // the nearest whole step decides: half a step is what rounding adds
            let position =
                |steps: i64| ((i128::from(steps >> 32) * i128::from(law.step_q32(i))) >> 32) as i64;
            let half = (law.step_q32(i) >> 33) as i64 + 1;
            let lowest = position(bounds.lowest[i].saturating_sub(others[i]));
            let highest = position(bounds.highest[i].saturating_add(others[i]));
            if lowest < i64::from(own.travel_lower) - half {
                return Err(beyond(axis, lowest, i64::from(own.travel_lower), true));
            }
            if highest > i64::from(own.travel_upper) + half {
                return Err(beyond(axis, highest, i64::from(own.travel_upper), true));
            }
        }
        Ok(())
    }

    /// How far an axis can go by itself from where all others come to rest: the soft limit, and less where a motor's
    /// travel ends before.
    pub fn farthest(&self, law: &Law, rest: FinePose, axis: Axis, upwards: bool) -> i32 {
        let i = axis.index();
        let (lower, upper) = self.range(law, axis);
        let here = rest.rounded().0[i].clamp(lower, upper);
        let far = if upwards { upper } else { lower };
        let mut pose = rest;
        let mut reaches = |x: i32| {
            pose.0[i] = i64::from(x) << 32;
            let motors = law.motors(&pose, &mut Remembered::default()).floor();
            motors.0.iter().zip(&self.0).enumerate().all(|(m, (steps, own))| {
                let at = steps_to_units(i64::from(*steps), law.step_q32(m));
                !own.homed || (i64::from(own.travel_lower)..=i64::from(own.travel_upper)).contains(&at)
            })
        };
        if reaches(far) || !reaches(here) {
            return far;
        }
        let (mut good, mut bad) = (here, far);
        while good.abs_diff(bad) > 1 {
            let middle = good.midpoint(bad);
            if reaches(middle) { good = middle } else { bad = middle }
        }
        good
    }
}
