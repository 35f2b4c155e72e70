//! Gaussian modes and what is between them.

use std::f64::consts::TAU;

/// The mode of a fibre or a waveguide: an elliptical Gaussian with its waist on the face, exp(-x²/w_x² - y²/w_y²).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Radii w_x, w_y at which the field is 1/e of that in the middle (the power 1/e²), um; half the mode field
    /// diameter.
    pub radius_um: [f64; 2],
}

impl Mode {
    /// A round mode.
    pub const fn round(radius_um: f64) -> Self {
        Mode { radius_um: [radius_um; 2] }
    }
}

/// What fills the gap between two faces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Medium {
    /// Wavelength in vacuum, um.
    pub wavelength_um: f64,
    /// Refractive index.
    pub index: f64,
}

impl Medium {
    /// k = 2 pi n / lambda, rad per um.
    pub fn wave_number(&self) -> f64 {
        TAU * self.index / self.wavelength_um
    }

    /// Rayleigh length pi n w² / lambda of a waist radius (um), um.
    pub fn rayleigh_um(&self, radius_um: f64) -> f64 {
        0.5 * self.wave_number() * radius_um * radius_um
    }
}
