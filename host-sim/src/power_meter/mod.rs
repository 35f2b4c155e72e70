//! The power meter of a bench with the optical switch before it, as an instrument that takes messages.
//!
//! One [`Session`] a link: bytes in, bytes out, an error queue of its own. All sessions see one [`Bench`]. Commands and
//! times are in docs/BENCH.md.
//!
//! [`Bench`]: crate::bench_twin::Bench

mod command;
mod error;
mod exchange;
mod session;
#[cfg(test)]
mod tests;

pub use error::Entry;
pub use session::Session;

use stage_controller::units::SEGMENT_NS;

/// Ticks of 1 us in a segment.
const SEGMENT_TICKS: u64 = SEGMENT_NS / 1000;
/// The switch has settled after this many ticks of 1 us: 40 segments.
pub(crate) const SWITCH_TICKS: u64 = 40 * SEGMENT_TICKS;
/// Before a mean is taken the meter settles for so long, ticks: 40 segments.
const SETTLE_TICKS: u64 = 40 * SEGMENT_TICKS;
/// Readings of a mean, one a segment.
const READINGS: u32 = 32;
