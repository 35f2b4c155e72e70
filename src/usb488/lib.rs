//! The device side of USB488, the class of test instruments on USB, without hardware.
//!
//! ```text
//! bulk OUT     -->  pump           turn  <-->  Instrument: message exchange (IEEE 488.2)
//! bulk IN      <--  pump  Interface
//! interrupt IN <--  pump
//! endpoint 0   <->  control
//! ```
//!
//! - [`header`] reads and writes the 12 bytes in front of every transfer.
//! - [`receive`] takes bulk OUT apart, [`send`] makes bulk IN, [`notify`] interrupt IN.
//! - [`control`] answers the requests of the class; [`descriptor`] holds what the device says of itself.
//! - [`interface`] puts them together, between a [`Wire`] and an [`Instrument`].
//!
//! Standards: USB Test and Measurement Class 1.0 (USBTMC) and its subclass USB488 1.0, both of 2003-04-14.
//!
//! # Memory
//! One packet each way. A transfer announces as many bytes as the instrument has at that moment, at most what the host
//! has asked for, and fetches them packet by packet; a longer answer is several transfers, of which the last has EOM.
//!
//! # Where the standards leave a choice
//! - **TermChar** is supported: a transfer ends at the character. As its size comes first, such a transfer is at most
//!   one packet long.
//! - **A read without a query** is answered by nothing: bulk IN is NAKed until the host gives up, as GPIB instruments
//!   do. The exchange reports -420.
//! - **A message or trigger while an answer waits** interrupts it (-410): what stands at bulk IN is taken back, so that
//!   the next read does not begin with it.
//! - **Another request to read** before the first was served replaces it. Bytes that the host has not fetched are sent
//!   again, under the new tag: a host may time out, and read again.
//! - **Abort of bulk IN** takes the packet back that was not fetched, and ends the transfer with an empty one; a later
//!   read goes on where the host stopped.
//! - **Abort of bulk OUT, and what is malformed**, drops the message that it belongs to. Malformed headers halt bulk
//!   OUT until the host clears that; reserved bytes are not looked at, and a transfer without data is taken for nothing,
//!   for hosts send such.
//! - **Clear and aborts** do not halt bulk OUT. They read away what was on its way, and then say that they are done.
//! - **Status byte**: bit 6 is RQS, which its reading clears, be it a READ_STATUS_BYTE or the notification of a service
//!   request.
//! - **Indicator pulse** is not supported, nor are messages of vendors.
//!
//! No `unsafe` code, no allocation, no floating point, nothing that can panic.
#![no_std]
#![forbid(unsafe_code)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    clippy::arithmetic_side_effects
)]

pub mod control;
pub mod descriptor;
pub mod header;
pub mod instrument;
pub mod interface;
pub mod notify;
pub mod receive;
pub mod send;
pub mod wire;

pub use control::Setup;
pub use instrument::{Found, Instrument, Panel};
pub use interface::Interface;
pub use wire::Wire;

/// Largest packet of a bulk endpoint at full speed (USB 2.0, 5.8.3).
pub const PACKET: usize = 64;
