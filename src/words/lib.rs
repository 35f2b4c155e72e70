//! From tracks to words of STEP and DIR.
//!
//! ```text
//! orders -> refill -> law of the compensation -> stepgen -> words
//! ```
//!
//! - [`refill`] runs the tracks that planning makes: the half of the controller that lives in an interrupt.
//! - [`stepgen`] places the steps of all six motors into words, one for each tick of 1 us.
//!
//! A crate of its own, because it is compiled for speed and what surrounds it for size.
#![no_std]
#![forbid(unsafe_code)]

pub mod refill;
pub mod stepgen;

use stage_kernel::{compensation, motion, units};
