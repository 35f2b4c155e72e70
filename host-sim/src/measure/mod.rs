//! Measurements of a stage as instruments would give them, from its exact model: noise, drift, backlash, all seeded.

mod instrument;
mod plan;

pub use plan::{MeasuredFile, Spoiled, measure, nominal};

/// How good the instruments are, and how much they measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Start of the random numbers.
    pub seed: u64,
    /// Standard deviation of a length, nm.
    pub noise_nm: f64,
    /// Standard deviation of an angle, nrad.
    pub noise_nrad: f64,
    /// Drift of lengths, nm per hour, at most, each instrument and direction its own.
    pub drift_nm_per_hour: f64,
    /// Drift of angles, nrad per hour, at most.
    pub drift_nrad_per_hour: f64,
    /// Poses at which the fibre point's position is measured.
    pub fibre_poses: usize,
    /// Poses at which the array's orientation is measured.
    pub orientation_poses: usize,
    /// Readings of the fibre point that are spoiled.
    pub outliers: usize,
    /// The files state the noise.
    pub state_noise: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            seed: 1,
            noise_nm: 50.0,
            noise_nrad: 1000.0,
            drift_nm_per_hour: 0.0,
            drift_nrad_per_hour: 0.0,
            fibre_poses: 300,
            orientation_poses: 100,
            outliers: 0,
            state_noise: true,
        }
    }
}
