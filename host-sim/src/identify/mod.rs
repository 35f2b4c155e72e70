//! From measurements to the constants of a stage: least squares over all files of a directory.
//!
//! Files are read ([`read_directory`]), compared with what the nominal machine would give so that a mistaken unit is
//! seen, and fitted together: linear least squares first, Levenberg-Marquardt to the end, readings that do not belong
//! left out by name. docs/CALIBRATION.md describes files, gauge and result.

mod agreement;
mod bordered;
mod changes;
mod checks;
mod conclude;
mod constants;
mod covariance;
mod evaluated;
mod fit;
mod freedom;
mod gauge;
mod jacobian;
mod least_squares;
mod observe;
mod outliers;
mod per_target;
mod play;
pub mod plots;
mod position_errors;
mod rank;
mod read;
mod report;
mod result;
mod reversal;
mod series;
mod suspicions;
mod undetermined;
pub mod units;
mod weights;
mod widen;
mod wild;
mod zeros;

pub use constants::{CONSTANTS, Constant, backlash_name};
pub use fit::identify;
pub use jacobian::{Interface, Linearised, Twist};
pub use play::{Behind, Walk};
pub use rank::{Ranks, dependent, ranks};
pub use read::{ReadError, decode, is_measurement, parse, read_directory};
pub use result::{Estimate, FileSummary, Identification, Outlier, Residual, Reversal};
pub use series::{Approach, Kind, Reading, Series};

/// How to fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Names, or beginnings of names, that are not fitted, and their values in the unit of the machine file; without
    /// a value that of the nominal machine.
    pub hold: Vec<(String, Option<f64>)>,
    /// Fit a drift, linear in time, to files that have times.
    pub drift: bool,
    /// Leave out readings that do not belong.
    pub reject: bool,
}

impl Default for Options {
    fn default() -> Self {
        Options { hold: Vec::new(), drift: true, reject: true }
    }
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// A file cannot be read, or a line of it is not usable.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The measurements do not determine everything that is asked for.
    #[error(
        "these measurements do not tell {}: {advice} (or keep them at the nominal values: --hold {})",
        undetermined.join(", "), hold.join(",")
    )]
    Undetermined {
        /// All that can change unseen.
        undetermined: Vec<String>,
        /// What to measure.
        advice: String,
        /// So many of them that the others are determined.
        hold: Vec<String>,
    },
    /// What is held cannot be held.
    #[error("gauge: {0}")]
    Gauge(String),
    /// The fit ends where no stage can be.
    #[error("{0}")]
    Result(String),
}

impl Refusal {
    fn line(series: &Series, line: u64, reason: impl Into<String>) -> Self {
        Refusal::Read(ReadError::Line { file: series.file.clone(), line, reason: reason.into() })
    }
}
