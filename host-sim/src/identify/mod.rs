//! From measurements to the constants of a stage: least squares over all files of a directory.

mod constants;
mod jacobian;
mod rank;
mod result;

pub use constants::{CONSTANTS, Constant, backlash_name};
pub use jacobian::{Interface, Linearised, Twist};
pub use rank::{Ranks, dependent, ranks};
pub use result::{Estimate, FileSummary, Identification, Outlier, Residual, Reversal};
