//! Chance of a bench: one stream of numbers for each of its parts, so that none depends on how many another one takes.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// Random numbers of one part of a bench.
pub(super) struct Chance(ChaCha8Rng);

impl Chance {
    /// Of a part; the same seed and part give the same numbers.
    pub fn new(seed: u64, part: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(part);
        Chance(random)
    }

    /// Uniform from lower to upper.
    pub fn between(&mut self, [lower, upper]: [f64; 2]) -> f64 {
        lower + (upper - lower) * self.0.random::<f64>()
    }

    /// Uniform within plus and minus `reach`.
    pub fn within(&mut self, reach: f64) -> f64 {
        self.between([-reach, reach])
    }

    /// Normal with standard deviation 1 (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.0.random::<f64>()).ln()).sqrt();
        radius * (TAU * self.0.random::<f64>()).cos()
    }

    /// Bits.
    pub fn bits(&mut self) -> u64 {
        self.0.random()
    }
}
