//! HiSLIP (IVI-6.1, version 1.0): what a GPIB has, over two TCP connections.
//!
//! # The way of the data
//! ```text
//! bytes of a connection -> Frames   -> Frame { kind, control, parameter, payload }
//! Frame                 -> Client   -> one operation at a time: write, trigger, clear, status, lock
//! operation             -> Instrument (a link of the client's own)
//! ```
//! Answers are sent ahead of their reader. The client says with the next message whether it has read the last one to
//! its end (RMT-delivered); until it has, the answer waits as one in the instrument would: it shows in the status byte,
//! and a message that comes before is -410. What no link of this kind can see is a read without a query (-420).

mod client;
mod frame;
mod locks;

pub use client::Client;
pub use frame::{Frame, Frames, Kind};
pub use locks::Locks;

/// Version of the protocol.
pub const VERSION: u16 = 0x0100;
/// Names the maker in the protocol: two letters.
pub const VENDOR: u16 = u16::from_be_bytes(*b"SC");
/// Most bytes of a payload that are taken.
pub const PAYLOAD_MOST: u64 = 65_536;

/// The place of an instrument by its name, `hislip0`, `hislip1`, ...; nothing is the first.
pub fn place(name: &[u8]) -> Option<usize> {
    let name = std::str::from_utf8(name).ok()?.to_ascii_lowercase();
    if name.is_empty() { Some(0) } else { name.strip_prefix("hislip")?.parse().ok() }
}
