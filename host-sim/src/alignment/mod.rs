//! Aligning fibre, chip and array: what the alignment PC does, over messages alone.
//!
//! The way of the data: [`Bus`] (messages out, lines back) → [`Controller`] (commands checked by the error queue) →
//! the steps of the alignment → a report per channel. [`Lab`] is a bench on the desktop that such a bus can lead to.

mod bus;
mod lab;

pub use bus::{Bus, BusError, Controller};
pub use lab::Lab;
