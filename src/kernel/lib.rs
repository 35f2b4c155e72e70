//! From a pose to words of STEP and DIR.
//!
//! ```text
//! pose -> motion -> orders -> refill -> compensation -> stepgen -> words
//! ```
//!
//! - [`motion`] plans jerk-limited moves on which no motor exceeds its limits.
//! - [`refill`] runs them: the half of the controller that lives in an interrupt.
//! - [`compensation`] turns the logical pose of the fibre point into motor positions: coupling, rotation centre,
//!   backlash.
//! - [`stepgen`] places the steps of all six motors into words, one for each tick of 1 us.
//! - [`units`] names the quantities; [`error`] the errors; [`wire`] turns records into bytes.
//!
//! It knows nothing of messages, links and settings. A crate of its own, because it is compiled for speed and what
//! surrounds it for size.
#![no_std]
#![forbid(unsafe_code)]

pub mod compensation;
pub mod error;
pub mod motion;
#[cfg(test)]
mod random;
pub mod refill;
pub mod stepgen;
pub mod units;
pub mod wire;
