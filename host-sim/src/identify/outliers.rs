//! From where on a residual is no noise any more.

use statrs::distribution::{ContinuousCDF, Normal};

/// Chance that a reading is rejected although all are normal.
const FALSE_ALARM: f64 = 0.01;

/// Largest studentised residual that normal noise shows among so many values, with 99 % confidence.
pub fn threshold(values: usize) -> f64 {
    let normal = Normal::standard();
    normal.inverse_cdf(1.0 - 0.5 * FALSE_ALARM / values.max(1) as f64).max(3.5)
}

/// Weight of a residual (in standard deviations) by Huber's rule: full up to 1.5, then by its inverse.
pub fn huber(normalised: f64) -> f64 {
    (1.5 / normalised.abs()).min(1.0)
}
