//! What a client has sent and the bus has not done yet, line by line, each with the address it is for.

use super::command::{Address, Command};
use super::lines::Line;
use std::collections::VecDeque;

/// Bytes that wait, beyond which no more is taken from a client: so far back a `!` and a `++clr` are seen.
const MOST: usize = 65_536;
/// What a line counts at least, bytes.
const LEAST: usize = 16;

/// A line, understood.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum What {
    /// `whole`: the line ends here; `aborts`: it began with `!`, and the instrument knows.
    Data { bytes: Vec<u8>, whole: bool, aborts: bool },
    /// None: it is not understood.
    Command(Option<Command>),
}

/// Lines that wait.
#[derive(Clone, Debug)]
pub(super) struct Queue {
    lines: VecDeque<(Address, What, usize)>,
    size: usize,
    /// The address behind all of them.
    address: Address,
    first: Address,
}

impl Queue {
    pub fn new(first: Address) -> Self {
        Queue { lines: VecDeque::new(), size: 0, address: first, first }
    }

    /// The address behind all that waits.
    pub fn address(&self) -> Address {
        self.address
    }

    pub fn is_empty(&self) -> bool {
        self.lines.is_empty()
    }

    pub fn is_full(&self) -> bool {
        self.size >= MOST
    }

    pub fn push(&mut self, line: Line, aborts: bool) {
        let (what, size) = match line {
            Line::Command(text) => (What::Command(Command::parse(&text)), text.len()),
            Line::Data { bytes, whole } => {
                let size = bytes.len();
                (What::Data { bytes, whole, aborts }, size)
            }
        };
        match &what {
            What::Command(Some(Command::Address(Some(address)))) => self.address = *address,
            What::Command(Some(Command::Reset)) => self.address = self.first,
            _ => {}
        }
        let size = size.max(LEAST);
        self.size += size;
        self.lines.push_back((self.address, what, size));
    }

    pub fn pop(&mut self) -> Option<What> {
        let (_, what, size) = self.lines.pop_front()?;
        self.size -= size;
        Some(what)
    }

    /// A line that begins with `!` waits for this address.
    pub fn aborts(&self, at: Address) -> bool {
        self.lines.iter().any(|(address, what, _)| *address == at && matches!(what, What::Data { aborts: true, .. }))
    }

    /// Whether a clear of the instrument at this address waits, or of the interface. What is sent to it, asked of it or
    /// read from it in front of that is dropped, as a clear drops it; all else keeps its place.
    pub fn take_clear(&mut self, at: Address) -> bool {
        let clears = |(address, what, _): &(Address, What, usize)| match what {
            What::Command(Some(Command::Clear)) => *address == at,
            What::Command(Some(Command::InterfaceClear | Command::Reset)) => true,
            _ => false,
        };
        let Some(place) = self.lines.iter().position(clears) else { return false };
        let behind = self.lines.split_off(place);
        self.lines.retain(|(address, what, _)| {
            let goes = match what {
                What::Data { .. } | What::Command(Some(Command::Read(_))) => *address == at,
                What::Command(Some(Command::Trigger(others))) => *address == at && others.is_empty(),
                _ => false,
            };
            !goes
        });
        self.lines.extend(behind);
        self.size = self.lines.iter().map(|(_, _, size)| size).sum();
        true
    }
}
