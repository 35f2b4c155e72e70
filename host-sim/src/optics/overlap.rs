//! How much light goes from one Gaussian mode into another that is displaced, apart and tilted.
//!
//! Exact in the paraxial approximation, with offset, gap and tilt together. The field of an elliptical Gaussian is a
//! product of one in x and one in y, so the overlap is one too. In x, on the plane of the fibre's face, the light of the
//! guide is sqrt(i z_R / q) exp(-i k x² / 2q) with q = z + i z_R, and the mode of the fibre
//! exp(-(x - d)² / w_f²) exp(-i k θ (x - d)); both times (2 / π w²)^¼. Their overlap is
//! ∫ exp(-a x² + b x + c) dx = sqrt(π / a) exp(b² / 4a + c) with a = 1 / w_f² + i k / 2q, b = 2 d / w_f² + i k θ,
//! c = -d² / w_f² - i k θ d.

use super::{Medium, Mode};

/// 10 / ln 10.
const DB_PER_NEPER: f64 = 10.0 / std::f64::consts::LN_10;

/// Where a fibre stands before a guide.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Misalignment {
    /// Middle of the fibre's face beside the guide's axis, um.
    pub offset_um: [f64; 2],
    /// Distance along the guide's axis, um; below 0 it is taken as 0.
    pub gap_um: f64,
    /// Direction of the light that the fibre takes, against that which leaves the guide: slopes dx/ds, dy/ds along the
    /// way from guide to fibre, rad. In the middle of the light of a distant point it is offset / gap.
    pub tilt_rad: [f64; 2],
}

/// One transverse direction of a pair of modes.
#[derive(Clone, Copy, Debug)]
struct Line {
    wave_number: f64,
    /// 1 / w_f².
    narrowness: f64,
    /// z_R of the guide's mode, um.
    rayleigh: f64,
    /// 4 z_R² / (w_g² w_f²).
    scale: f64,
}

impl Line {
    fn new(guide: f64, fibre: f64, medium: Medium) -> Self {
        let rayleigh = medium.rayleigh_um(guide);
        let narrowness = 1.0 / (fibre * fibre);
        Line {
            wave_number: medium.wave_number(),
            narrowness,
            rayleigh,
            scale: 4.0 * rayleigh * rayleigh * narrowness / (guide * guide),
        }
    }

    /// Square of the overlap of centred modes, and the exponent by which offset and tilt lower it.
    #[inline]
    fn overlap(&self, d: f64, z: f64, tilt: f64) -> (f64, f64) {
        let spread = 1.0 / (z * z + self.rayleigh * self.rayleigh);
        let curved = 0.5 * self.wave_number * spread;
        let (re, im) = (self.narrowness + curved * self.rayleigh, curved * z);
        let size = re * re + im * im;
        let (p, t) = (2.0 * d * self.narrowness, self.wave_number * tilt);
        let exponent = ((p * p - t * t) * re + 2.0 * p * t * im) / (2.0 * size) - p * d;
        (self.scale * spread / size, exponent)
    }
}

/// A guide and a fibre before it, in a medium.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    lines: [Line; 2],
}

impl Pair {
    /// Radii, wavelength and index must be positive.
    pub fn new(guide: Mode, fibre: Mode, medium: Medium) -> Self {
        Pair { lines: [0, 1].map(|i| Line::new(guide.radius_um[i], fibre.radius_um[i], medium)) }
    }

    /// Natural logarithm of the share of the power that is coupled.
    #[inline]
    fn log_coupling(&self, at: &Misalignment) -> f64 {
        let z = at.gap_um.max(0.0);
        let (x, ex) = self.lines[0].overlap(at.offset_um[0], z, at.tilt_rad[0]);
        let (y, ey) = self.lines[1].overlap(at.offset_um[1], z, at.tilt_rad[1]);
        0.5 * (x * y).ln() + ex + ey
    }

    /// Share of the power that is coupled, 0 to 1; the same from fibre to guide.
    pub fn coupling(&self, at: &Misalignment) -> f64 {
        self.log_coupling(at).exp()
    }

    /// Loss -10 log10 of the share, dB.
    #[inline]
    pub fn loss_db(&self, at: &Misalignment) -> f64 {
        -DB_PER_NEPER * self.log_coupling(at)
    }
}
