//! The physical twin: what the step words do to a real stage.

mod mechanics;
mod switches;
mod timing;

pub use mechanics::Mechanics;
pub use switches::{BOUNCE_TICKS, Switches};
pub use timing::{Count, Limits, Timing, Violations};

/// Port lines after a BSRR word: the low half sets, the high half resets, and a set bit wins over a
/// reset bit (RM0090 8.4.7).
#[inline(always)]
pub const fn after_word(lines: u32, word: u32) -> u32 {
    (lines & !(word >> 16)) | (word & 0xffff)
}
