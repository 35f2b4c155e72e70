//! The light of an alignment bench in f64: modes and how they couple, splitter and fibre array, power meter and ADC.
//!
//! Lengths in um, angles in rad, powers in dBm, losses in dB (positive). docs/BENCH.md has the formulae and says what is
//! assumed.

mod adc;
mod chip;
mod front_end;
mod meter;
mod mode;
pub mod noise;
mod overlap;

pub use adc::{Adc, CONVERSIONS, FULL_SCALE_VOLTS, LARGEST_CODE};
pub use chip::{Array, ArraySize, Splitter, SplitterSize};
pub use front_end::FrontEnd;
pub use meter::{Burst, Meter, MeterOptions};
pub use mode::{Medium, Mode};
pub use overlap::{Misalignment, Pair};

/// What a power of nothing is written as, dBm: below anything that a detector or a calculation tells apart.
pub const DARK_DBM: f64 = -200.0;

/// Power in mW of dBm.
pub fn milliwatts(dbm: f64) -> f64 {
    (dbm * (std::f64::consts::LN_10 / 10.0)).exp()
}

/// dBm of a power in mW, at least [`DARK_DBM`].
pub fn dbm(milliwatts: f64) -> f64 {
    if milliwatts > 1e-20 { 10.0 * milliwatts.log10() } else { DARK_DBM }
}

/// The largest of the losses of all channels, dB.
pub fn worst_db(losses_db: &[f64]) -> f64 {
    losses_db.iter().copied().fold(f64::NEG_INFINITY, f64::max)
}

/// Uniformity: the largest of the losses less the least, dB.
pub fn uniformity_db(losses_db: &[f64]) -> f64 {
    worst_db(losses_db) - losses_db.iter().copied().fold(f64::INFINITY, f64::min)
}
