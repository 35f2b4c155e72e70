//! One file of measurements as data: lengths in nm, angles in nrad, times in s.

use super::units::{Quantity, Unit};
use stage_controller::units::{AXES, Axis};

/// What a file holds; docs/CALIBRATION.md describes each.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Kind {
    /// Bidirectional positioning runs of one axis, ISO 230-2.
    Positioning(Axis),
    /// Transverse displacement of the fibre point along a chip axis (0, 1, 2) while one linear axis moves.
    Straightness {
        /// The axis that moves.
        axis: Axis,
        /// The chip axis along which is measured.
        direction: usize,
        /// True when the straight edge is the chip's own axis, so that the slope counts.
        to_chip: bool,
    },
    /// Angles between the positive directions of two linear axes, less 90 degrees.
    Squareness,
    /// Distances from the first point along lines, ISO 230-6.
    Diagonal,
    /// Two angles of a mirror on the array whose normal is near a chip axis (0, 1, 2).
    Autocollimator(usize),
    /// Positions of a point of the array (nm, array frame; none: the fibre point) in chip axes.
    Fibre(Option<[f64; 3]>),
    /// Orientation of the array in chip axes as rotation vectors.
    Orientation,
}

impl Kind {
    /// As the line `# kind:` names it.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Positioning(_) => "positioning",
            Kind::Straightness { .. } => "straightness",
            Kind::Squareness => "squareness",
            Kind::Diagonal => "diagonal",
            Kind::Autocollimator(_) => "autocollimator",
            Kind::Fibre(_) => "fibre",
            Kind::Orientation => "orientation",
        }
    }

    /// Length or angle.
    pub fn quantity(self) -> Quantity {
        match self {
            Kind::Positioning(axis) if axis.is_rotary() => Quantity::Angle,
            Kind::Positioning(_) | Kind::Straightness { .. } | Kind::Diagonal | Kind::Fibre(_) => Quantity::Length,
            Kind::Squareness | Kind::Autocollimator(_) | Kind::Orientation => Quantity::Angle,
        }
    }

    /// Columns of the values read, without their units.
    pub fn columns(self) -> &'static [&'static str] {
        match self {
            Kind::Positioning(_) | Kind::Straightness { .. } | Kind::Squareness => &["measured"],
            Kind::Diagonal => &["distance"],
            Kind::Autocollimator(0) => &["about_y", "about_z"],
            Kind::Autocollimator(1) => &["about_z", "about_x"],
            Kind::Autocollimator(_) => &["about_x", "about_y"],
            Kind::Fibre(_) => &["x", "y", "z"],
            Kind::Orientation => &["rx", "ry", "rz"],
        }
    }
}

/// From which side every motor comes to a reading's position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Approach {
    /// Upwards: on the reference flank, where the stage stands at the motor's count.
    Up,
    /// Downwards: the stage stands by the play above it.
    Down,
    /// From the reading of the line before; the first one from home on the reference flank.
    Sequence,
}

/// One row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Line of the file.
    pub line: u64,
    /// Where the motors stand: counts times step, nm and nrad.
    pub motors: [f64; AXES],
    /// Of runs: approached downwards.
    pub down: bool,
    /// Of runs: the run's number; of diagonals: the line's.
    pub run: u32,
    /// Of squareness: the two axes.
    pub pair: Option<(Axis, Axis)>,
    /// Since the first reading, s; 0 without times.
    pub time_s: f64,
    /// As many as the kind has columns; the rest 0.
    pub values: [f64; 3],
}

/// One file.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Its name.
    pub file: String,
    /// What it holds.
    pub kind: Kind,
    /// Approach, of kinds without a direction column.
    pub approach: Approach,
    /// Standard deviation of one value as the file states it, nm or nrad.
    pub noise: Option<f64>,
    /// It has a column of times.
    pub timed: bool,
    /// Units of the value columns as written, for messages.
    pub units: Vec<Unit>,
    /// The rows.
    pub readings: Vec<Reading>,
}

impl Series {
    /// It has times from which a drift can be told: not all one and the same.
    pub fn shows_drift(&self) -> bool {
        self.timed && self.readings.iter().any(|reading| reading.time_s != self.readings[0].time_s)
    }
}
