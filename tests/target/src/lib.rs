//! The golden suite: scripts, one player of them, and what their words must be.
//!
//! # Design
//! [`script`] reads a script line by line, [`play`](mod@play) drives a [`Rig`](play::Rig) with it and [`record`] sums
//! up every word that it plays and every byte that it answers. [`halves`] is the rig that runs on a Cortex-M4F and on a
//! desktop alike: both halves of the controller, one link and a ring of four segments, with nothing allocated.
//! [`suite`] holds the scripts, the calibration blocks and the expected records.
#![no_std]
#![forbid(unsafe_code)]

pub mod halves;
pub mod play;
pub mod record;
pub mod script;
pub mod suite;
