//! From a logical pose to motor targets: the law, its parts, and its inverse.
//!
//! ```text
//! pose (nm, nrad) -> rotation: q_a, c(q_a) -> coupling rows: D^-1 (p - c), q_a / step -> targets (Q32.32 steps)
//!                                                                     -> backlash: + overlay -> motor positions
//! ```

pub mod backlash;
pub mod calibration;
pub mod coupling;
pub mod law;
pub mod pivot;
