//! The quantities that cross module borders, their units and the one order of the axes.
//!
//! Linear coordinates are nanometres, angular ones nanoradians; a motor counts its own steps.
//! A *fine* quantity carries 32 fractional bits.

pub mod decimal;
pub use stage_arithmetic::{rough, wide};
pub mod steps;

use serde::{Deserialize, Serialize};

/// Number of axes, and of motors: motor `n` drives the stage of axis `n`.
pub const AXES: usize = 6;

/// Ticks in one second: one tick is 1 us.
pub const TICKS_PER_SECOND: u32 = 1_000_000;

/// Ticks, hence BSRR words, in one segment.
pub const SEGMENT_TICKS: usize = 256;

/// Duration of one segment in nanoseconds.
pub const SEGMENT_NS: u64 = SEGMENT_TICKS as u64 * 1_000_000_000 / TICKS_PER_SECOND as u64;

/// Largest magnitude of a logical coordinate in nm or nrad: 2^29, so that a row of six products
/// of 31-bit coefficients stays below 2^63 (docs/LAW.md 3).
pub const COORDINATE_LIMIT: i32 = 1 << 29;

/// Largest magnitude of an angle that the rotation-centre law accepts, in nrad (7.69 degrees):
/// a sixteenth of a nanoradian must fit 32 bits.
pub const ANGLE_LIMIT: i32 = (1 << 27) - 1;

/// A logical coordinate, or the motor that drives its stage. The numeric value is the index in
/// every array of six.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[allow(missing_docs)]
pub enum Axis {
    X = 0,
    Y = 1,
    Z = 2,
    Alpha = 3,
    Beta = 4,
    Gamma = 5,
}

impl Axis {
    /// All axes in the order of every array of six.
    pub const ALL: [Axis; AXES] = [Axis::X, Axis::Y, Axis::Z, Axis::Alpha, Axis::Beta, Axis::Gamma];
    /// The linear axes.
    pub const LINEAR: [Axis; 3] = [Axis::X, Axis::Y, Axis::Z];
    /// The rotary axes.
    pub const ROTARY: [Axis; 3] = [Axis::Alpha, Axis::Beta, Axis::Gamma];

    /// Index in arrays of six.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// The axis with this index, if there is one.
    pub fn from_index(index: usize) -> Option<Axis> {
        Self::ALL.get(index).copied()
    }

    /// True for alpha, beta and gamma, whose unit is the nanoradian.
    pub const fn is_rotary(self) -> bool {
        self as usize >= 3
    }

    /// The name in machine files.
    pub const fn name(self) -> &'static str {
        match self {
            Axis::X => "X",
            Axis::Y => "Y",
            Axis::Z => "Z",
            Axis::Alpha => "alpha",
            Axis::Beta => "beta",
            Axis::Gamma => "gamma",
        }
    }
}

/// Logical pose of the fibre point: x, y, z in nm and alpha, beta, gamma in nrad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pose(pub [i32; AXES]);

/// Logical pose with 32 fractional bits: nm and nrad in Q32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FinePose(pub [i64; AXES]);

impl Pose {
    /// The same pose with 32 fractional bits.
    pub fn fine(self) -> FinePose {
        FinePose(self.0.map(|u| i64::from(u) << 32))
    }
}

impl FinePose {
    /// Rounded to whole nm and nrad, halves upwards.
    pub fn rounded(self) -> Pose {
        Pose(self.0.map(|u| ((u + (1 << 31)) >> 32) as i32))
    }
}

/// Step counts of the six motors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorSteps(pub [i32; AXES]);

/// Motor positions in steps with 32 fractional bits, one half already added: the whole part
/// (arithmetic shift by 32) is the motor's target in whole steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FineSteps(pub [i64; AXES]);

impl FineSteps {
    /// Whole steps: the floor.
    pub fn floor(self) -> MotorSteps {
        MotorSteps(self.0.map(|m| (m >> 32) as i32))
    }
}
