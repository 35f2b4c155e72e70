//! Answers of one link: a bounded buffer between the commands that write and the link that drains.
//!
//! One answer of one unit is at most [`ANSWER_MAX`] bytes; that much is free when a unit is executed, so an answer is
//! never lost. A longer one is written in parts: the handler writes a part, notes in [`Response::resume_at`] where to
//! go on, returns `Flow::More`, and is called again when there is room.

use crate::error::Error;
pub use crate::units::decimal::axis_unit;
use crate::units::decimal::{Dimension, Formatted, Unit, write_digits, write_fraction, write_integer};
use crate::units::{Axis, wide};
use core::fmt::{self, Write};
use heapless::Vec;

/// Most bytes that one call of a handler may write.
pub const ANSWER_MAX: usize = 256;
const CAPACITY: usize = 768;

/// What a roll-back restores.
#[derive(Clone, Copy, Debug, Default)]
struct Mark {
    length: usize,
    message_open: bool,
    unit_open: bool,
    cursor: u32,
}

/// The answers that the link has not taken yet.
#[derive(Clone, Debug, Default)]
pub struct Response {
    bytes: Vec<u8, CAPACITY>,
    /// Bytes already taken by the link.
    read: usize,
    /// The message has an answer: the next one is parted by `;`, its end is LF.
    message_open: bool,
    /// The unit has written: its next item is parted by a comma.
    unit_open: bool,
    cursor: u32,
    overflow: bool,
    mark: Mark,
}

impl Response {
    /// Empty.
    pub const fn new() -> Self {
        Response {
            bytes: Vec::new(),
            read: 0,
            message_open: false,
            unit_open: false,
            cursor: 0,
            overflow: false,
            mark: Mark { length: 0, message_open: false, unit_open: false, cursor: 0 },
        }
    }

    // For handlers.

    /// A whole number.
    pub fn integer(&mut self, value: impl Into<i64>) {
        self.whole(value.into());
    }

    #[inline(never)]
    fn whole(&mut self, value: i64) {
        self.part();
        let _ = write_integer(self, value);
    }

    /// 0 or 1.
    pub fn boolean(&mut self, value: bool) {
        self.integer(i64::from(value));
    }

    /// An integer in its unit's text: um, degrees, seconds.
    #[inline(never)]
    pub fn quantity(&mut self, value: i64, unit: Unit) {
        self.part();
        let _ = Formatted { value, unit }.write(self);
    }

    /// nm or nrad (`order` 0), or a rate of them, of an axis.
    #[inline(never)]
    pub fn axis_quantity(&mut self, axis: Axis, value: i64, order: u8) {
        self.quantity(value, axis_unit(axis).per_second(order));
    }

    /// A length or an angle with 32 fractional bits, nm or nrad, in um or degrees with as many decimals as it takes
    /// to get the same number back.
    pub fn fine_quantity(&mut self, value: i64, unit: Unit) {
        let (scaled, decimals, least) = match unit.dimension {
            // 180 / pi in 10^-18; 10^-18 degree is below 2^-32 nrad
            Dimension::Angle => (
                (wide::signed_div(i128::from(value) * 57_295_779_513_082_320_877, 1_000_000_000) + (1 << 31)) >> 32,
                18,
                8,
            ),
            // 10^-13 um is below 2^-32 nm
            _ => ((i128::from(value) * 10_000_000_000 + (1 << 31)) >> 32, 13, 3),
        };
        let (mut size, mut decimals) = (scaled.unsigned_abs(), decimals);
        while decimals > least {
            let (tenth, 0) = wide::div_rem(size, 10) else { break };
            size = tenth;
            decimals -= 1;
        }
        self.fraction(scaled < 0, size, decimals);
    }

    /// `size / 10^decimals` with its sign; whole units must fit 64 bits.
    pub fn fraction(&mut self, negative: bool, size: u128, decimals: u32) {
        self.part();
        let _ = write_fraction(self, negative, size, decimals);
    }

    /// Characters as they are: a keyword, or several items that are already parted.
    #[inline(never)]
    pub fn text(&mut self, text: &str) {
        self.part();
        self.put(text.as_bytes());
    }

    /// The short form of a keyword: its capitals.
    #[inline(never)]
    pub fn short_form(&mut self, keyword: &str) {
        self.part();
        keyword.split(|c: char| c.is_ascii_lowercase()).for_each(|capitals| self.put(capitals.as_bytes()));
    }

    /// An error as the queue tells it.
    pub fn error(&mut self, error: &Error) {
        self.part();
        let _ = error.write(self);
    }

    /// A string in double quotes.
    pub fn string(&mut self, text: &[u8]) {
        self.part();
        self.put(b"\"");
        for byte in text {
            self.put(if *byte == b'"' { b"\"\"" } else { core::slice::from_ref(byte) });
        }
        self.put(b"\"");
    }

    /// A whole definite block; a larger one by [`Response::block_head`], [`Response::raw`] and `Flow::More`.
    pub fn block(&mut self, data: &[u8]) {
        self.block_head(data.len());
        self.raw(data);
    }

    /// `#<n><len>`, to be followed by `length` bytes of [`Response::raw`].
    #[inline(never)]
    pub fn block_head(&mut self, length: usize) {
        let digits = length.checked_ilog10().unwrap_or(0) + 1;
        self.part();
        self.put(b"#");
        let _ = write_digits(self, digits.into(), 1);
        let _ = write_digits(self, length as u64, 1);
    }

    /// Bytes of a block.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.put(bytes);
    }

    /// Where an answer in parts goes on: 0 at the first call of a unit.
    pub const fn cursor(&self) -> u32 {
        self.cursor
    }

    /// Sets what [`Response::cursor`] says at the next call of this unit.
    pub const fn resume_at(&mut self, cursor: u32) {
        self.cursor = cursor;
    }

    /// Bytes that still fit this call.
    pub fn room(&self) -> usize {
        (self.mark.length + ANSWER_MAX).saturating_sub(self.bytes.len())
    }

    #[inline(never)]
    fn part(&mut self) {
        if self.unit_open {
            self.put(b",");
        } else if self.message_open {
            self.put(b";");
        }
        (self.unit_open, self.message_open) = (true, true);
    }

    #[inline(never)]
    fn put(&mut self, bytes: &[u8]) {
        // One byte beyond the promised room for the `;`.
        let end = self.mark.length + ANSWER_MAX + 1;
        if self.bytes.len() + bytes.len() > end || self.bytes.extend_from_slice(bytes).is_err() {
            self.overflow = true;
        }
    }

    // For the session.

    /// True when a unit may be executed: its longest answer fits, with its `;` and LF.
    pub(super) fn ready(&mut self) -> bool {
        self.compact();
        CAPACITY - self.bytes.len() >= ANSWER_MAX + 2
    }

    /// A call of a handler begins.
    pub(super) fn begin(&mut self) {
        self.overflow = false;
        self.mark = Mark {
            length: self.bytes.len(),
            message_open: self.message_open,
            unit_open: self.unit_open,
            cursor: self.cursor,
        };
    }

    /// The call has written nothing after all.
    pub(super) fn roll_back(&mut self) {
        self.bytes.truncate(self.mark.length);
        (self.message_open, self.unit_open) = (self.mark.message_open, self.mark.unit_open);
        self.cursor = self.mark.cursor;
    }

    /// False when the call wrote more than it may.
    pub(super) const fn fits(&self) -> bool {
        !self.overflow
    }

    /// True when the call has written or moved its cursor.
    pub(super) fn advanced(&self) -> bool {
        self.bytes.len() != self.mark.length || self.cursor != self.mark.cursor
    }

    /// The unit is done.
    pub(super) fn end_unit(&mut self) {
        (self.unit_open, self.cursor) = (false, 0);
    }

    /// The message is done.
    pub(super) fn end_message(&mut self) {
        self.end_unit();
        if core::mem::take(&mut self.message_open) {
            let _ = self.bytes.push(b'\n');
        }
    }

    /// Bytes wait for the link (MAV).
    pub fn is_available(&self) -> bool {
        self.read < self.bytes.len()
    }

    /// The message that is executed has an answer, which has not ended yet.
    #[cfg(feature = "bus")]
    pub(super) const fn is_open(&self) -> bool {
        self.message_open
    }

    /// Bytes that the link can take.
    #[cfg(feature = "bus")]
    pub(super) fn available(&self) -> usize {
        self.bytes.len().saturating_sub(self.read)
    }

    /// Moves answers to the link; says how many bytes.
    pub fn transmit(&mut self, to: &mut [u8]) -> usize {
        let from = self.bytes.get(self.read..).unwrap_or(&[]);
        let count = from.len().min(to.len());
        to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
        self.read += count;
        self.compact();
        count
    }

    fn compact(&mut self) {
        if self.read > 0 {
            let length = self.bytes.len();
            let read = self.read.min(length);
            self.bytes.copy_within(read.., 0);
            self.bytes.truncate(length - read);
            self.read = 0;
        }
    }

    /// Drops everything.
    pub(super) fn clear(&mut self) {
        *self = Response::new();
    }
}

impl Write for Response {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.put(text.as_bytes());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::String;

    fn drain(out: &mut Response) -> String {
        let mut buffer = [0; 2000];
        let count = out.transmit(&mut buffer);
        String::from_utf8_lossy(&buffer[..count]).into_owned()
    }

    #[test]
    fn items_are_parted_by_commas_answers_by_semicolons_and_lf_ends_the_message() {
        let mut out = Response::default();
        out.begin();
        out.axis_quantity(Axis::X, -1_500, 0);
        out.axis_quantity(Axis::Alpha, 17_453_293, 0);
        out.end_unit();
        out.begin();
        out.string(b"a\"b");
        out.block(b"xyz");
        out.boolean(true);
        out.end_message();
        out.end_message();
        assert_eq!(drain(&mut out), "-1.500,1.00000003;\"a\"\"b\",#13xyz,1\n");
    }

    #[test]
    fn a_unit_that_fails_leaves_no_trace() {
        let mut out = Response::default();
        out.begin();
        out.integer(1);
        out.end_unit();
        out.begin();
        out.integer(2);
        out.roll_back();
        out.begin();
        out.integer(3);
        out.end_message();
        assert_eq!(drain(&mut out), "1;3\n");
    }

    #[test]
    fn more_than_the_room_is_noticed() {
        let mut out = Response::default();
        out.begin();
        (0..100).for_each(|_| out.integer(1234));
        assert!(!out.fits());
    }
}
