//! Machine files: what a stage is, in the units of its data sheet, read from TOML and checked.
//!
//! A file names every quantity with its unit (`step_nm`, `travel_deg`); here they become nm and nrad
//! in axis order. Errors name the key and the value.

mod file;
mod kinematic;
mod write;

pub use file::{FARTHEST_UM, MachineFile, NRAD_PER_DEG};
pub use kinematic::{Component, ErrorName, Function, Kinematic, LARGEST_KINEMATIC_UM};
pub use write::{to_toml, to_toml_with};

use serde::Deserialize;
use stage_controller::units::{AXES, Axis};
use std::path::Path;

/// Highest step rate of one motor in steps per second (pulse timing of the step generator).
pub const STEP_RATE_CEILING: f64 = 499_000.0;

/// Smallest step in nm or nrad: the coupling row needs `30 + floor(log2 step)` bits, at least 31.
pub const SMALLEST_STEP: f64 = 2.0;

/// Steps of this size (nm or nrad) and more do not fit the calibration block.
pub const STEP_LIMIT: f64 = 32_768.0;

/// Largest static angular error that is taken for one, in radians: beyond it a unit was mistaken.
pub const LARGEST_STATIC: f64 = 0.02;

const DEFAULT: &str = include_str!("../../machines/paper.toml");

/// Why a machine file is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MachineError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// Not TOML, an unknown or missing key, or a value of the wrong kind; shows the line.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A value that no machine can have.
    #[error("{key} = {value}: {reason}")]
    Value {
        /// Full name of the key, such as `axes.X.step_nm`.
        key: String,
        /// The value found.
        value: String,
        /// What it must be.
        reason: String,
    },
}

impl MachineError {
    fn value(key: impl Into<String>, value: impl ToString, reason: impl Into<String>) -> Self {
        MachineError::Value { key: key.into(), value: value.to_string(), reason: reason.into() }
    }
}

/// The nine position-independent angular errors in radians (docs/LAW.md 1), right-handed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case)]
pub struct StaticErrors {
    /// Squareness of Z and X, about y.
    pub S_ZX: f64,
    /// Squareness of Z and Y, about x.
    pub S_ZY: f64,
    /// Squareness of X and Y, about z.
    pub S_XY: f64,
    /// Tilt of the gamma axis about x.
    pub ex_gamma: f64,
    /// Tilt of the gamma axis about y.
    pub ey_gamma: f64,
    /// Tilt of the beta axis about x.
    pub ex_beta: f64,
    /// Tilt of the beta axis about z.
    pub ez_beta: f64,
    /// Tilt of the alpha axis about y.
    pub ey_alpha: f64,
    /// Tilt of the alpha axis about z.
    pub ez_alpha: f64,
}

impl StaticErrors {
    /// Names in machine files, in the order of [`StaticErrors::values`].
    pub const NAMES: [&'static str; 9] =
        ["S_ZX", "S_ZY", "S_XY", "ex_gamma", "ey_gamma", "ex_beta", "ez_beta", "ey_alpha", "ez_alpha"];

    /// The nine values in radians.
    pub fn values(&self) -> [f64; 9] {
        [
            self.S_ZX,
            self.S_ZY,
            self.S_XY,
            self.ex_gamma,
            self.ey_gamma,
            self.ex_beta,
            self.ez_beta,
            self.ey_alpha,
            self.ez_alpha,
        ]
    }

    /// The errors from their values in the order of [`StaticErrors::NAMES`].
    pub fn from_values(v: [f64; 9]) -> Self {
        StaticErrors {
            S_ZX: v[0],
            S_ZY: v[1],
            S_XY: v[2],
            ex_gamma: v[3],
            ey_gamma: v[4],
            ex_beta: v[5],
            ez_beta: v[6],
            ey_alpha: v[7],
            ez_alpha: v[8],
        }
    }
}

/// How a part is mounted: where its frame really lies in the one that it is meant to coincide with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Position, nm.
    pub offset_nm: [f64; 3],
    /// Orientation: the rotation `exp([rotation]x)`, rad.
    pub rotation_rad: [f64; 3],
}

/// How the fibre array sits on the last stage, and the chip on the base.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mounts {
    /// The fibre array frame in that of the last stage.
    pub fibre: Mount,
    /// The chip in the base frame.
    pub chip: Mount,
}

/// One motor and the stage that it drives, in nm or, for a rotary stage, nrad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Size of one step.
    pub step: f64,
    /// Width of the play.
    pub backlash: f64,
    /// Lower and upper end of the travel.
    pub travel: [f64; 2],
    /// Where the lower and the upper limit switch trip.
    pub switches: [f64; 2],
    /// Largest velocity per second.
    pub velocity: f64,
    /// Largest acceleration per second squared.
    pub acceleration: f64,
    /// Largest jerk per second cubed.
    pub jerk: f64,
}

/// A checked machine description.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Name, at most 16 printable ASCII characters.
    pub name: String,
    /// The stages from the base to the fibre array: a permutation of the six axes.
    pub order: [Axis; AXES],
    /// The fibre point F in the fibre array frame, nm.
    pub fibre_point_nm: [f64; 3],
    /// Nominal position of each joint frame in the one before it, nm, in axis order.
    pub axis_offset_nm: [[f64; 3]; AXES],
    /// Static angular errors.
    pub statics: StaticErrors,
    /// Mounting of fibre array and chip.
    pub mounts: Mounts,
    /// Errors that depend on where a stage stands.
    pub kinematic: Kinematic,
    /// Motors in axis order.
    pub drives: [Drive; AXES],
}

impl Machine {
    /// Reads and checks a machine file.
    ///
    /// # Errors
    /// When the file cannot be read, parsed or believed.
    pub fn load(path: &Path) -> Result<Self, MachineError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| MachineError::Read { path: path.display().to_string(), source })?;
        Self::parse(&text)
    }

    /// Parses and checks the text of a machine file.
    ///
    /// # Errors
    /// When the text is not a machine or a value cannot be believed.
    pub fn parse(text: &str) -> Result<Self, MachineError> {
        toml::from_str::<MachineFile>(text)?.try_into()
    }

    /// The built-in machine `paper`: the stage of the paper.
    pub fn paper() -> Self {
        Self::parse(DEFAULT).expect("the built-in machine is valid")
    }
}
