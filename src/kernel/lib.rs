//! From a pose to words of STEP and DIR.
//!
//! ```text
//! pose -> motion -> tracks -> compensation -> positions of motors
//! ```
//!
//! - [`motion`] plans jerk-limited moves on which no motor exceeds its limits.
//! - [`compensation`] turns the logical pose of the fibre point into motor positions: coupling, rotation centre,
//!   backlash.
//! - [`units`] names the quantities; [`error`] the errors; [`wire`] turns records into bytes.
//!
//! It knows nothing of messages, links and settings. The crate of words stands on it.
#![no_std]
#![forbid(unsafe_code)]

pub mod compensation;
pub mod error;
pub mod motion;
#[cfg(test)]
#[path = "../arithmetic/random.rs"]
mod random;
pub mod units;
pub mod wire;
