//! The twin of the alignment bench: errors, geometry, light, contact, what the controller knows, and the best there is.

mod best;
mod contact;
mod geometry;
mod known;
mod light;
mod speed;
mod stages;

use host_sim::bench_twin::{Bench, Options};

/// Both stages at home.
pub const HOME: [[f64; 6]; 2] = [[0.0; 6]; 2];
/// Ticks from one look at the light to the next.
pub const SEGMENT: u64 = 256;

/// A bench as it is by default.
pub fn bench(seed: u64) -> Bench {
    Bench::seeded(seed, &Options::default())
}

/// Stands still and sees its light through a meter without noise.
pub fn still() -> Options {
    let mut options = Options { drift_um_per_min: 0.0, adc_noise_lsb: 0.0, ..Options::default() };
    options.meter.noise_db = 0.0;
    options.settling.share = 0.0;
    options
}
