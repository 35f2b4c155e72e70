//! The device side of IEEE 488.1 (GPIB) over sixteen lines, without hardware.
//!
//! ```text
//! bus <-> transceivers, gates <-> Sample -> Device::step -> Drive      docs/GPIB-BOARD.md
//!                                              |    ^
//!                                        Event v    | accept, offer, set_status
//!                                         message exchange (IEEE 488.2)
//! ```
//!
//! - [`lines`] names the sixteen lines; [`message`] reads what a controller says while ATN is true.
//! - [`acceptor`], [`source`], [`addressing`], [`service`] and [`remote`] hold one interface function each, with the
//!   state names of the standard; [`table`] is how they are written where they follow messages alone.
//! - [`device`] puts them together: lines in, lines and at most one event out.
//! - [`timing`] holds the times of the standard, and says which of them software cannot keep.
//!
//! Interface functions: [`CAPABILITY`]. State names and transitions are those of IEEE 488.1-1987, section 2; where this
//! crate does more than the standard asks, the item says so.
//!
//! No `unsafe` code, no allocation, no floating point, nothing that can panic.
//!
//! # Example
//!
//! ```
//! use stage_gpib::device::{Address, Device, Sample};
//! use stage_gpib::lines::Lines;
//!
//! let mut device = Device::new(Address::new(5).unwrap());
//! device.accept();
//! let quiet = device.step(0, Sample { lines: Lines::NONE, armed: false });
//! assert_eq!(quiet.drive.lines, Lines::NONE);
//! let attention = device.step(1_000, Sample { lines: Lines::ATN, armed: false });
//! assert_eq!(attention.drive.lines, Lines::NRFD | Lines::NDAC);
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::arithmetic_side_effects
)]
// states are written as the standard writes them
#![allow(clippy::upper_case_acronyms)]

pub mod acceptor;
pub mod addressing;
pub mod device;
pub mod lines;
pub mod message;
pub mod remote;
pub mod service;
pub mod source;
pub mod table;
pub mod timing;

/// Interface functions as they stand beside the connector (IEEE 488.1, appendix C).
///
/// | code | meaning |
/// |---|---|
/// | SH1, AH1 | full source and acceptor handshake |
/// | T6 | talker, serial poll, untalked by its listen address; no talk-only |
/// | L4 | listener, unlistened by its talk address; no listen-only |
/// | SR1, RL1, DC1, DT1 | service request, remote and local with lockout, device clear, trigger: all of each |
/// | PP0, C0 | no parallel poll, no controller |
/// | E2 | three-state drivers on DIO, DAV and EOI |
pub const CAPABILITY: &str = "SH1 AH1 T6 L4 SR1 RL1 PP0 DC1 DT1 C0 E2";
