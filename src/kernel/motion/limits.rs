//! What a motion may not exceed: soft limits of the logical axes, travel of the motors, enabled motors.

use super::bounds::Range;
use crate::compensation::law::{Law, Remembered};
use crate::error::{Error, ErrorNumber};
use crate::units::steps::steps_to_units;
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

impl AxisLimits {
    /// Where the motor stands at a whole step and the end of the travel that it lies beyond, if it does.
    #[inline(never)]
    fn leaves(&self, steps: i64, step_q32: u64) -> Option<(i64, i64)> {
        let at = steps_to_units(steps, step_q32);
        // the nearest whole step decides: half a step is what rounding adds
        let half = (step_q32 >> 33) as i64 + 1;
        let (lower, upper) = (i64::from(self.travel_lower), i64::from(self.travel_upper));
        if at < lower - half {
            Some((at, lower))
        } else if at > upper + half {
            Some((at, upper))
        } else {
            None
        }
    }
}

/// What a motor keeps from the step at which its travel ends, steps in Q32.
const SPARE: i64 = 1 << 29;

/// Points of a way that are looked at for the end of a motor's travel.
const FARTHEST_SAMPLES: i64 = 32;

/// The limits of all axes.
#[derive(Clone, Copy, Debug)]
pub struct Limits(pub [AxisLimits; AXES]);

impl Limits {
    /// Checks one logical coordinate.
    ///
    /// # Errors
    /// -222 with the axis, the value and the bound.
    pub fn check_coordinate(&self, law: &Law, axis: Axis, value: i64) -> Result<(), Error> {
        let (lower, upper) = self.range(law, axis);
        if value < i64::from(lower) {
            return Err(Error::limit(axis, value, i64::from(lower), false));
        }
        if value > i64::from(upper) {
            return Err(Error::limit(axis, value, i64::from(upper), false));
        }
        Ok(())
    }

    /// The logical range of an axis that commands may use, nm or nrad.
    pub fn range(&self, law: &Law, axis: Axis) -> (i32, i32) {
        let own = &self.0[axis.index()];
        // the rotation-centre law holds sixteenths of a nanoradian in 32 bits
        let hard = if axis.is_rotary() && law.lever_nm() != 0 { ANGLE_LIMIT } else { COORDINATE_LIMIT };
        if own.soft_on && own.homed {
            (own.soft_lower.clamp(-hard, hard), own.soft_upper.clamp(-hard, hard))
        } else {
            (-hard, hard)
        }
    }

    /// Checks the coordinates that a move changes: one that stays may lie beyond, after a change of law.
    ///
    /// # Errors
    /// -222 with the first axis beyond its limit.
    pub fn check_move(&self, law: &Law, from: Pose, to: Pose) -> Result<(), Error> {
        for axis in Axis::ALL {
            let (from, to) = (from.0[axis.index()], to.0[axis.index()]);
            if from != to {
                self.check_coordinate(law, axis, i64::from(to))?;
            }
        }
        Ok(())
    }

    /// Checks what the motors do along a path: travel of the homed ones, and that all that step are enabled.
    /// `starts_high`: the motion begins at the upper end of the stretch or at the lower one; none: between them, as
    /// one that has to turn back.
    ///
    /// # Errors
    /// -222 with the motor, its position and the end of its travel; 108 with the disabled axis.
    pub fn check_motors(&self, law: &Law, range: &Range, starts_high: Option<bool>) -> Result<(), Error> {
        for axis in Axis::ALL {
            let i = axis.index();
            let own = &self.0[i];
            if range.steps >> i & 1 != 0 && !own.enabled {
                return Err(Error::axis(ErrorNumber::AxisDisabled, axis));
            }
            if !own.homed {
                continue;
            }
            let step = law.step_q32(i);
            for extreme in [range.lowest[i] >> 32, range.highest[i] >> 32] {
                // from beyond the travel, as after another calibration, the way back in is free
                let stands = starts_high.map(|high| range.ends[usize::from(high)][i] >> 32);
                if let Some((at, bound)) = own.leaves(extreme, step).filter(|_| stands != Some(extreme)) {
                    return Err(Error::limit(axis, at, bound, true));
                }
            }
        }
        Ok(())
    }

    /// How far an axis can go by itself from where all others come to rest: the soft limit, and less where a motor's
    /// travel ends before.
    pub fn farthest(&self, law: &Law, rest: FinePose, axis: Axis, upwards: bool) -> i32 {
        let i = axis.index();
        let (lower, upper) = self.range(law, axis);
        let here = rest.rounded().0[i];
        let far = if upwards { upper.max(here) } else { lower.min(here) };
        let mut pose = rest;
        let standing = law.targets(&pose, &mut Remembered::default()).floor().0;
        let mut reaches = |x: i32| {
            pose.0[i] = i64::from(x) << 32;
            let motors = law.targets(&pose, &mut Remembered::default()).0;
            (0..AXES).all(|m| {
                let (own, step) = (&self.0[m], law.step_q32(m));
                let beyond = |steps: i64| own.leaves(steps, step);
                // not where the next rounding of another axis would make it one step more
                let ends = beyond((motors[m] - SPARE) >> 32).or_else(|| beyond((motors[m] + SPARE) >> 32));
                match (ends, beyond(i64::from(standing[m]))) {
                    _ if !own.homed => true,
                    (None, _) => true,
                    (Some(_), None) => false,
                    // from beyond the travel, as after another calibration, the way back in is free
                    (Some((at, end)), Some((stands, side))) => end == side && (at - end).abs() <= (stands - end).abs(),
                }
            })
        };
        // a rotation may take a motor out of its travel and back: the first end counts
        let way = i64::from(far) - i64::from(here);
        let at = |k: i64| (i64::from(here) + way * k / FARTHEST_SAMPLES) as i32;
        let Some(first) = (0..=FARTHEST_SAMPLES).find(|k| !reaches(at(*k))) else {
            return far;
        };
        if first == 0 {
            return here;
        }
        let (here, far) = (at(first - 1), at(first));
        let (mut good, mut bad) = (here, far);
        while good.abs_diff(bad) > 1 {
            let middle = good.midpoint(bad);
            if reaches(middle) { good = middle } else { bad = middle }
        }
        good
    }
}
