//! Aligning fibre, chip and array: what the alignment PC does, over messages alone.
//!
//! The way of the data: [`Bus`] (messages out, lines back) → [`Controller`] (commands checked by the error queue) →
//! scans and moves → [`align`], the steps of the alignment → [`Alignment`], a level per channel. [`Lab`] is a bench on the
//! desktop that such a bus can lead to.

mod bus;
mod geometry;
mod lab;
mod learn;
mod probe;
mod program;
mod reading;
mod rest;
mod scans;
mod trouble;
mod view;

pub use bus::{Bus, BusError, Controller, no_setup};
pub use geometry::{Fall, Optics, Peak, Shift, best_for_all};
pub use lab::{Lab, Moment};
pub use learn::{Learned, Told, learn};
pub use program::{Alignment, Options, Step, align};
pub use scans::{End, Flank, Found, Place, Scan};
pub use trouble::{Ended, Stand, Trouble};
pub use view::LiveLine;
