//! The table as the board keeps it: six bytes an entry, and of each header what differs from the one before.
//!
//! It is made of [`TABLE`] when the program is built; on the board nothing else of that is left.

use super::{Command, Entry, Form, TABLE};
use crate::error::ErrorNumber;
use core::fmt::{self, Write};
use heapless::Vec;

/// Longest header of the table.
const PATTERN_MAX: usize = 48;

/// An entry without what the manual says of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Which.
    pub command: Command,
    form: Form,
    /// Fewest and most parameters, without question mark and of the query: half a byte each.
    arity: [u8; 2],
    /// Bytes that its pattern has in common with the one before, and the bytes of its own.
    shared: u8,
    own: u8,
}

/// Bytes at the start of both.
const fn shared(one: &[u8], other: &[u8]) -> usize {
    let mut n = 0;
    while n < one.len() && n < other.len() && one[n] == other[n] {
        n += 1;
    }
    n
}

/// Pattern of an entry, and what it shares with the one before.
const fn pattern(n: usize) -> (&'static [u8], usize) {
    let pattern = TABLE[n].pattern.as_bytes();
    (pattern, if n == 0 { 0 } else { shared(TABLE[n - 1].pattern.as_bytes(), pattern) })
}

const fn half_bytes((least, most): (u8, u8)) -> u8 {
    assert!(least < 16 && most < 16);
    least << 4 | most
}

static HEADERS: [Header; TABLE.len()] = {
    let Entry { command, form, .. } = TABLE[0];
    let mut headers = [Header { command, form, arity: [0; 2], shared: 0, own: 0 }; TABLE.len()];
    let mut n = 0;
    while n < TABLE.len() {
        let Entry { command, form, arity, .. } = TABLE[n];
        let (pattern, shared) = pattern(n);
        assert!(pattern.len() <= PATTERN_MAX && pattern[0] != b'[');
        let arity = [half_bytes(arity[0]), half_bytes(arity[1])];
        headers[n] = Header { command, form, arity, shared: shared as u8, own: (pattern.len() - shared) as u8 };
        n += 1;
    }
    headers
};

/// Bytes of all patterns that are not shared, and of all lines of SYSTem:HELP:HEADers?.
const fn lengths() -> (usize, usize) {
    let (mut own, mut help, mut n) = (0, 0, 0);
    while n < TABLE.len() {
        let (pattern, shared) = pattern(n);
        own += pattern.len() - shared;
        help += pattern.len() + (pattern[0] != b'*') as usize + line_end(TABLE[n].form).len();
        n += 1;
    }
    (own, help)
}

/// Bytes of all lines of SYSTem:HELP:HEADers?.
pub const HELP_LENGTH: usize = lengths().1;

static PATTERNS: [u8; lengths().0] = {
    let mut all = [0; lengths().0];
    let (mut at, mut n) = (0, 0);
    while n < TABLE.len() {
        let (pattern, mut byte) = pattern(n);
        while byte < pattern.len() {
            all[at] = pattern[byte];
            (at, byte) = (at + 1, byte + 1);
        }
        n += 1;
    }
    all
};

/// What a line of SYSTem:HELP:HEADers? ends with.
const fn line_end(form: Form) -> &'static str {
    match form {
        Form::Set => "/nquery/\n",
        Form::Query => "/qonly/\n",
        Form::Both => "\n",
    }
}

impl Header {
    /// Fewest and most parameters.
    pub fn arity(&self, query: bool) -> (usize, usize) {
        let halves = usize::from(self.arity[usize::from(query)]);
        (halves >> 4, halves & 15)
    }
}

/// Walks over the table.
pub struct Walk {
    left: core::slice::Iter<'static, Header>,
    /// Where the next one's own bytes begin.
    at: usize,
    pattern: Vec<u8, PATTERN_MAX>,
    /// What is passed begins with another letter.
    passed: bool,
}

impl Walk {
    /// In front of the first entry.
    pub fn begin() -> Self {
        Walk { left: HEADERS.iter(), at: 0, pattern: Vec::new(), passed: false }
    }

    /// The next entry; with a letter, the next one that may begin with it. A capital.
    #[inline(never)]
    pub fn step(&mut self, letter: Option<u8>) -> Option<&'static Header> {
        loop {
            let header = self.left.next()?;
            let from = self.at;
            self.at += usize::from(header.own);
            // what shares something with the entry before begins as that does
            if header.shared == 0 {
                self.passed = letter.is_some() && PATTERNS.get(from).copied() != letter;
            }
            if !self.passed {
                self.pattern.truncate(header.shared.into());
                self.pattern.extend_from_slice(PATTERNS.get(from..self.at)?).ok()?;
                return Some(header);
            }
        }
    }

    /// Pattern of the entry of the last step.
    pub fn pattern(&self) -> &[u8] {
        &self.pattern
    }

    /// Writes the line of SYSTem:HELP:HEADers? (SCPI-99 volume 2, 21.11) of the last step, the LF included.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, header: &Header, to: &mut dyn Write) -> fmt::Result {
        if !self.pattern.starts_with(b"*") {
            to.write_str(":")?;
        }
        self.pattern.iter().try_for_each(|byte| to.write_char(char::from(*byte)))?;
        to.write_str(line_end(header.form))
    }
}

/// The entry of a header and the number in it.
///
/// # Errors
/// -113 unknown, or not in this form; -114 an axis that does not exist.
pub fn find(nodes: &[&[u8]], query: bool) -> Result<(&'static Header, Option<u8>), ErrorNumber> {
    let first = nodes.first().and_then(|node| node.first()).map_or(0, u8::to_ascii_uppercase);
    let mut walk = Walk::begin();
    while let Some(header) = walk.step(Some(first)) {
        let pattern = walk.pattern();
        if !header.form.has(query) {
            continue;
        }
        if let Some(suffix) = super::match_nodes(pattern, nodes) {
            return match suffix {
                None => Ok((header, None)),
                Some(n) if super::numbers(pattern).contains(&n) => Ok((header, Some(n))),
                Some(_) => Err(ErrorNumber::HeaderSuffixOutOfRange),
            };
        }
    }
    Err(ErrorNumber::UndefinedHeader)
}
