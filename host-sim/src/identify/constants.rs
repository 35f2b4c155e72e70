//! The 24 constants that measurements can tell of a stage, and where they stand in a machine.
//!
//! A serial chain of R rotary and P linear axes has 4R + 2P + 6 constants (Everett and Mooring): 24 for three and
//! three. They are the nine static angles, three offsets between the rotary axes, and the six of each mount.

use crate::machine::{Machine, StaticErrors};
use stage_controller::units::{AXES, Axis};
use std::fmt;

/// Number of identifiable constants of the chain; the backlash of six motors comes beside them.
pub const CONSTANTS: usize = 24;

const COMPONENTS: [&str; 3] = ["x", "y", "z"];

/// One constant of the chain: what it moves, and where. Components 0, 1, 2 are x, y, z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Constant {
    /// A static angle, by its place in [`StaticErrors::NAMES`].
    Static(usize),
    /// A component of the position of a rotary stage's frame in the one before it.
    Offset(Axis, usize),
    /// Position of the fibre array frame in that of the last stage.
    FibreOffset(usize),
    /// Orientation of the fibre array frame.
    FibreRotation(usize),
    /// Position of the chip in the base frame.
    ChipOffset(usize),
    /// Orientation of the chip.
    ChipRotation(usize),
}

impl Constant {
    /// The 24 of an order of the axes.
    ///
    /// Of the three rotary axes r1, r2, r3 from base to tip each pair has one distance that no zero position absorbs:
    /// that along the nominal direction of the third one. So the frame of r2 has an offset along r3, and that of r3
    /// along r1 and along r2. For gamma, beta, alpha: gamma-beta along x, beta-alpha along z, gamma-alpha along y.
    pub fn all(order: &[Axis; AXES]) -> [Constant; CONSTANTS] {
        let mut rotary = order.iter().copied().filter(|axis| axis.is_rotary());
        let mut next = || rotary.next().expect("an order holds three rotary axes");
        let (first, second, third) = (next(), next(), next());
        let along = |axis: Axis| axis.index() - 3;
        let offsets = [
            Constant::Offset(second, along(third)),
            Constant::Offset(third, along(second)),
            Constant::Offset(third, along(first)),
        ];
        std::array::from_fn(|i| match i {
            0..9 => Constant::Static(i),
            9..12 => offsets[i - 9],
            12..15 => Constant::FibreOffset(i - 12),
            15..18 => Constant::FibreRotation(i - 15),
            18..21 => Constant::ChipOffset(i - 18),
            _ => Constant::ChipRotation(i - 21),
        })
    }

    /// An angle (rad), not a length (nm).
    pub fn is_angle(self) -> bool {
        matches!(self, Constant::Static(_) | Constant::FibreRotation(_) | Constant::ChipRotation(_))
    }

    /// Its value in a machine, rad or nm.
    pub fn of(self, machine: &Machine) -> f64 {
        match self {
            Constant::Static(i) => machine.statics.values()[i],
            Constant::Offset(axis, c) => machine.axis_offset_nm[axis.index()][c],
            Constant::FibreOffset(c) => machine.mounts.fibre.offset_nm[c],
            Constant::FibreRotation(c) => machine.mounts.fibre.rotation_rad[c],
            Constant::ChipOffset(c) => machine.mounts.chip.offset_nm[c],
            Constant::ChipRotation(c) => machine.mounts.chip.rotation_rad[c],
        }
    }

    /// Puts a value (rad or nm) into a machine.
    pub fn set(self, machine: &mut Machine, value: f64) {
        match self {
            Constant::Static(i) => {
                let mut values = machine.statics.values();
                values[i] = value;
                machine.statics = StaticErrors::from_values(values);
            }
            Constant::Offset(axis, c) => machine.axis_offset_nm[axis.index()][c] = value,
            Constant::FibreOffset(c) => machine.mounts.fibre.offset_nm[c] = value,
            Constant::FibreRotation(c) => machine.mounts.fibre.rotation_rad[c] = value,
            Constant::ChipOffset(c) => machine.mounts.chip.offset_nm[c] = value,
            Constant::ChipRotation(c) => machine.mounts.chip.rotation_rad[c] = value,
        }
    }
}

/// The key of the machine file, with the component behind it: `static_rad.S_XY`, `mount.chip.rot_rad.z`.
impl fmt::Display for Constant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Constant::Static(i) => write!(f, "static_rad.{}", StaticErrors::NAMES[i]),
            Constant::Offset(axis, c) => write!(f, "axis_offset_um.{}.{}", axis.name(), COMPONENTS[c]),
            Constant::FibreOffset(c) => write!(f, "mount.fibre.offset_um.{}", COMPONENTS[c]),
            Constant::FibreRotation(c) => write!(f, "mount.fibre.rot_rad.{}", COMPONENTS[c]),
            Constant::ChipOffset(c) => write!(f, "mount.chip.offset_um.{}", COMPONENTS[c]),
            Constant::ChipRotation(c) => write!(f, "mount.chip.rot_rad.{}", COMPONENTS[c]),
        }
    }
}

/// What a motor's backlash is called: the key of the machine file.
pub fn backlash_name(axis: Axis) -> String {
    format!("axes.{}.backlash_{}", axis.name(), if axis.is_rotary() { "nrad" } else { "nm" })
}
