//! The law: motor targets of a logical pose, and the pose of motor counts.
//!
//! q_a from the angles, p' = p - c(q_a), linear motors = D^-1 p', rotary motors = q_a / step
//! (docs/LAW.md 2 and 3). The backlash overlay comes after, per motor.

use super::calibration::{Calibration, MotorData};
use super::coupling::{factor, lone, rows};
use super::pivot::{Rotary, Rotation, Screw, Turned, from_sixteenths, to_nanometres};
use crate::units::rough::Rough;
use crate::units::{AXES, COORDINATE_LIMIT, FinePose, FineSteps, MotorSteps, Pose, wide};
use serde::{Deserialize, Serialize};

/// Range of a coordinate in Q32.
const RANGE: i128 = (COORDINATE_LIMIT as i128) << 32;

/// Which parts of the compensation are on. All on by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Switches {
    /// Everything: off is like all of the others off.
    pub compensation: bool,
    /// D^-1, W^-1 and the second-order term.
    pub coupling: bool,
    /// c(q).
    pub pivot: bool,
    /// The backlash overlay.
    pub backlash: bool,
}

impl Default for Switches {
    fn default() -> Self {
        Switches { compensation: true, coupling: true, pivot: true, backlash: true }
    }
}

/// The law in the form in which the generator evaluates it.
#[derive(Clone, Copy, Debug)]
pub struct Law {
    /// Linear motors: D^-1 with the step folded in.
    slides: [[i32; 3]; 3],
    /// Rotary motors: 1 / step.
    gain: [i32; 3],
    /// See [`factor`].
    factors: [i32; AXES],
    /// Step sizes, Q32 nm or nrad.
    step: [u64; AXES],
    /// Steps per nm or nrad, not below the exact number.
    per_unit: [Rough; AXES],
    /// The rotary part.
    rotation: Rotary,
    /// Largest distance of the pivot from a rotary axis, nm, rounded up; 0 while the pivot is not held.
    lever_nm: u64,
    /// See [`Law::second_order_bound`].
    second_order: u64,
}

/// The rotary part of the last pose: unchanged angles cost nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Remembered {
    angles: [i64; 3],
    turned: Turned,
    valid: bool,
}

impl Law {
    /// The identity: every motor follows its own coordinate.
    pub fn identity(motors: &[MotorData; AXES]) -> Self {
        let unit = |i: usize| {
            let motor = &motors[i];
            let doubled = wide::div(1u128 << (u32::from(motor.row_bits) + 33), u128::from(motor.step_q32.max(1)));
            doubled.div_ceil(2).min(i32::MAX as u128) as i32
        };
        let mut slides = [[0; 3]; 3];
        for (i, row) in slides.iter_mut().enumerate() {
            row[i] = unit(i);
        }
        Law {
            slides,
            gain: [unit(3), unit(4), unit(5)],
            factors: motors.map(|m| factor(m.row_bits)),
            step: motors.map(|m| m.step_q32),
            per_unit: motors.map(|m| Rough::ONE.over_up(Rough::down(m.step_q32.max(1), 32))),
            rotation: Rotary::default(),
            lever_nm: 0,
            second_order: 0,
        }
    }

    /// The law of a calibration; `pivot` is the point to hold, in the fibre array frame, 1/16 nm.
    pub fn new(calibration: &Calibration, switches: Switches, pivot: [i32; 3]) -> Self {
        let mut law = Law::identity(&calibration.motors);
        let mut rotation = Rotation::default();
        if switches.compensation && switches.coupling {
            law.slides = calibration.inverse_slides;
            law.gain = calibration.rotary_gain;
            rotation.tilt = calibration.tilt;
            rotation.second_order = calibration.second_order;
        }
        if switches.compensation && switches.pivot {
            rotation.held = true;
            rotation.pivot = pivot_in_chip_axes(calibration, pivot);
            rotation.screws = calibration.screws.map(|s| Screw {
                angle: s.axis.index().saturating_sub(3) as u8,
                direction: s.direction,
                point: s.point.map(from_sixteenths),
            });
            law.lever_nm = largest_lever_nm(calibration, pivot);
        }
        law.rotation = rotation.prepared();
        law.second_order = second_order_bound(&law.rotation);
        law
    }

    /// Targets of the motors in Q32.32 steps, one half added.
    #[inline(always)]
    pub fn motors(&self, pose: &FinePose, last: &mut Remembered) -> FineSteps {
        let mut steps = FineSteps([0; AXES]);
        self.drive(pose, last, &mut steps);
        steps
    }

    /// The same, written over other targets.
    #[inline(always)]
    pub fn drive(&self, pose: &FinePose, last: &mut Remembered, steps: &mut FineSteps) {
        let u = &pose.0;
        let angles = [u[3], u[4], u[5]];
        let [a, b, c] = last.angles;
        if !last.valid || (u[3] ^ a) | (u[4] ^ b) | (u[5] ^ c) != 0 {
            last.angles = angles;
            last.valid = true;
            self.rotation.turn(&angles, &mut last.turned);
        }
        let Turned { actuator: q, displacement: c } = &last.turned;
        let p = [u[0] - c[0], u[1] - c[1], u[2] - c[2]];
        rows(&self.slides, &self.factors, &p, &mut steps.0);
        steps.0[3] = lone(self.gain[0], q[0], self.factors[3]);
        steps.0[4] = lone(self.gain[1], q[1], self.factors[4]);
        steps.0[5] = lone(self.gain[2], q[2], self.factors[5]);
    }

    /// [`Law::motors`] as a call: for planning, of which the refill must not pay for the size.
    pub fn targets(&self, pose: &FinePose, last: &mut Remembered) -> FineSteps {
        let mut steps = FineSteps([0; AXES]);
        self.write_targets(pose, last, &mut steps);
        steps
    }

    /// [`Law::targets`], written over others: without a copy.
    #[inline(never)]
    pub fn write_targets(&self, pose: &FinePose, last: &mut Remembered, steps: &mut FineSteps) {
        self.drive(pose, last, steps);
    }

    /// Step counts of a pose at rest.
    pub fn steps(&self, pose: Pose) -> MotorSteps {
        self.targets(&pose.fine(), &mut Remembered::default()).floor()
    }

    /// q_a of a pose: unrounded angles of the rotary stages, nrad in Q32 (alpha, beta, gamma).
    pub fn actuator_angles(&self, pose: Pose) -> [i64; 3] {
        let u = pose.fine().0;
        {
            let mut turned = Turned::default();
            self.rotation.turn(&[u[3], u[4], u[5]], &mut turned);
            turned.actuator
        }
    }

    /// The pose of motor counts: the integer Newton solution of this very law, rounded to nm and nrad,
    /// so that `steps(forward(m)) == m` for every m inside the travel. Beyond the range of coordinates it ends there.
    ///
    /// W and D are near the identity, so that the chord iteration gains at least a factor of 50 a round.
    pub fn forward(&self, steps: MotorSteps) -> Pose {
        let mut pose = FinePose::default();
        // The angles first and rounded, then the position at the rounded angles: c(q) belongs to what is commanded.
        for part in [3..AXES, 0..3] {
            for _ in 0..12 {
                let at = self.targets(&pose, &mut Remembered::default());
                let mut largest = 0;
                for i in part.clone() {
                    // the middle of the step is where the law, half included, stands one half above the count
                    let lack = ((i64::from(steps.0[i]) << 32) + super::coupling::HALF).saturating_sub(at.0[i]);
                    largest = largest.max(lack.unsigned_abs());
                    let better = i128::from(pose.0[i]) + ((i128::from(lack) * i128::from(self.step[i])) >> 32);
                    pose.0[i] = wide::within(better, -RANGE, RANGE) as i64;
                }
                if largest < 1 << 12 {
                    break;
                }
            }
            let rounded = pose.rounded().fine();
            for i in part {
                pose.0[i] = rounded.0[i];
            }
        }
        pose.rounded()
    }

    /// True when these counts are those of a pose within the range of coordinates.
    #[inline(never)]
    pub fn names(&self, steps: MotorSteps) -> bool {
        self.steps(self.forward(steps)) == steps
    }

    /// Step size of a motor, Q32 nm or nrad.
    pub fn step_q32(&self, motor: usize) -> u64 {
        self.step[motor]
    }

    /// Steps of a motor per nm or nrad, not below the exact number.
    pub fn per_unit(&self, motor: usize) -> Rough {
        self.per_unit[motor]
    }

    /// Largest distance of the held pivot from a rotary axis, nm; 0 while none is held.
    pub fn lever_nm(&self) -> u64 {
        self.lever_nm
    }

    /// Bound on what the second-order term adds to the slope of q_a, per radian in Q32.
    pub fn second_order_bound(&self) -> u64 {
        self.second_order
    }
}

fn second_order_bound(rotation: &Rotary) -> u64 {
    let row = |i: usize| rotation.second_order().iter().map(|column| u64::from(column[i].unsigned_abs())).sum();
    // c is per radian times 2^60 / 10^9; 2 q q' doubles it
    ([0, 1, 2].map(row).into_iter().max().unwrap_or(0) * 2 * (1_000_000_000 >> 9)) >> 19
}

/// The pivot at home in chip axes, 2^-20 nm, from the fibre array frame, 1/16 nm.
fn pivot_in_chip_axes(calibration: &Calibration, pivot: [i32; 3]) -> [i64; 3] {
    let mut p = calibration.home_origin.map(from_sixteenths);
    for (p, row) in p.iter_mut().zip(&calibration.home_rotation) {
        for (r, x) in row.iter().zip(&pivot) {
            // Q30 * 1/16 nm = 2^-34 nm, to 2^-20 nm
            *p += (i64::from(*r) * i64::from(*x)) >> 14;
        }
    }
    p
}

/// Largest distance of a pivot (fibre array frame, 1/16 nm) from a rotary axis, nm, rounded up.
pub fn largest_lever_nm(calibration: &Calibration, pivot: [i32; 3]) -> u64 {
    let p = pivot_in_chip_axes(calibration, pivot);
    let distance = |s: &super::calibration::ScrewAxis| {
        let mut r = [0i64; 3];
        for (r, (p, c)) in r.iter_mut().zip(p.iter().zip(&s.point)) {
            *r = (p - from_sixteenths(*c)).signum() * to_nanometres(p - from_sixteenths(*c)) as i64;
        }
        let w = s.direction.map(i64::from);
        // the law holds a lever in sixteenths of a nanometre in 32 bits, and it turns
        if r.iter().any(|r| r.unsigned_abs() > 120_000_000) {
            return u64::MAX;
        }
        let across =
            [(w[1] * r[2] - w[2] * r[1]) >> 30, (w[2] * r[0] - w[0] * r[2]) >> 30, (w[0] * r[1] - w[1] * r[0]) >> 30];
        across.iter().map(|a| a.unsigned_abs().pow(2)).sum::<u64>().isqrt() + 3
    };
    calibration.screws.iter().map(distance).max().unwrap_or(0)
}
