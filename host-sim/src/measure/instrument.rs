//! Noise and drift of instruments.

use crate::board::Seeded;
use std::f64::consts::TAU;

/// Seeded random numbers of measurements.
#[derive(Debug)]
pub(super) struct Noise(Seeded);

impl Noise {
    pub fn new(seed: u64) -> Self {
        let mut seeded = Seeded::new(seed);
        // neighbouring seeds begin alike
        for _ in 0..8 {
            seeded.next_u64();
        }
        Noise(seeded)
    }

    /// Uniform in 0..1, never 0.
    fn unit(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    pub fn between(&mut self, lower: f64, upper: f64) -> f64 {
        lower + (upper - lower) * self.unit()
    }

    pub fn below(&mut self, bound: usize) -> usize {
        self.0.below(bound as u64) as usize
    }

    /// Normal with standard deviation 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let (u, v) = (self.unit(), self.unit());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }
}
