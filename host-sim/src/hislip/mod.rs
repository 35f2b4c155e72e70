//! HiSLIP (IVI-6.1, version 1.0): what a GPIB has, over two TCP connections.
//!
//! # The way of the data
//! ```text
//! bytes of a connection -> Frames   -> Frame { kind, control, parameter, payload }     both in a Link
//! Frame                 -> Client   -> one operation at a time: write, trigger, clear, status, lock
//! operation             -> Instrument (a link of the client's own)
//! ```
//! Answers are sent ahead of their reader. The client says with the next message whether it has read the last one to
//! its end (RMT-delivered); until it has, the answer waits as one in the instrument would: it shows in the status byte,
//! and in synchronised mode a message that comes before is -410. What no link of this kind can see is a read without a
//! query (-420).
//!
//! Messages are taken as they come and wait in the [`Link`], so that `!` is seen behind whatever waits: a question that
//! is not answered yet, another client's lock.

mod client;
mod errors;
mod frame;
mod link;
mod locks;

pub use errors::{Fatal, Over};
pub use frame::{Frame, Frames, Kind};
pub use link::{Channel, Link};
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
    if name.is_empty() {
        return Some(0);
    }
    let number = name.strip_prefix("hislip")?;
    number.bytes().all(|byte| byte.is_ascii_digit()).then(|| number.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::place;

    #[test]
    fn a_place_is_named_by_its_number_and_nothing_else() {
        assert_eq!((place(b""), place(b"hislip0"), place(b"HiSLIP12")), (Some(0), Some(0), Some(12)));
        for name in [&b"hislip"[..], b"hislip+1", b"hislip-1", b"hislip0,4880", b"inst0", b"hislip0 ", b"\xff"] {
            assert_eq!(place(name), None, "{name:?}");
        }
    }
}
