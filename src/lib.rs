//! Motion controller for six-axis fibre alignment stages, from the bytes of a link to words of STEP and DIR.
//!
//! # The way of the data
//!
//! ```text
//! bytes -> scpi -> controller::front -> motion::planner        a thread
//!                        ^                     |
//!                     reports               orders
//!                        |                     v
//! words <- stepgen <- compensation <- motion::profile          the refill interrupt, every 256 us
//! ```
//!
//! - [`scpi`] frames messages, finds their commands in one table and keeps status and answers of each link.
//! - [`controller`] holds the two halves: [`controller::front::Front`] checks, plans and keeps the [`settings`];
//!   [`refill::generator::Generator`] makes the words. [`refill::border`] is all that crosses between them.
//! - [`motion`] plans jerk-limited moves on which no motor exceeds its limits.
//! - [`compensation`] turns the logical pose of the fibre point into motor positions: coupling, rotation centre,
//!   backlash.
//! - [`stepgen`] places the steps of all six motors into words, one for each tick of 1 us.
//! - [`sense`] turns what the power inputs say into dBm, [`scan`] finds peaks, [`trace`] records samples.
//! - [`store`] keeps settings in flash, and where the motors stand over a reset.
//! - [`units`] names the quantities; [`error`] the errors.
//!
//! Between a parsed number and a word everything is integer arithmetic, so that a board and a desktop make the same
//! words. An axis is a logical coordinate, a motor is what turns: with compensation on, one axis moves several motors.
//!
//! The crate has no `unsafe` code, needs no allocator and does not know what board it runs on.
#![no_std]
#![forbid(unsafe_code)]

pub mod controller;
pub mod hal;
pub mod scan;
pub mod scpi;
pub mod sense;
pub mod settings;
pub mod store;
pub mod tasks;
pub mod trace;

pub use stage_kernel::{compensation, error, motion, units, wire};
pub use stage_words::{refill, stepgen};
