//! Entries of the error queue (SCPI-99 volume 2, 21.8).

use stage_controller::error::ErrorNumber;
use std::collections::VecDeque;
use std::fmt;

/// Entries that are kept.
const ROOM: usize = 16;
/// Bits of the standard event status register (IEEE 488.2, 11.5.1).
const QUERY: u8 = 4;
const DEVICE: u8 = 8;
const EXECUTION: u8 = 16;
const COMMAND: u8 = 32;

/// An error with what caused it.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    number: i16,
    detail: String,
}

impl Entry {
    /// An error of this number; `detail` names what was wrong.
    pub(super) fn new(number: i16, detail: impl Into<String>) -> Self {
        let mut detail: String = detail.into().replace('"', "'");
        detail.truncate(detail.char_indices().nth(160).map_or(detail.len(), |(at, _)| at));
        Entry { number, detail }
    }

    /// Which.
    pub fn number(&self) -> i16 {
        self.number
    }

    /// A message is not understood: the rest of it is dropped.
    pub(super) fn is_command_error(&self) -> bool {
        (-199..=-100).contains(&self.number)
    }

    fn event(&self) -> u8 {
        match self.number {
            -199..=-100 => COMMAND,
            -299..=-200 => EXECUTION,
            -499..=-400 => QUERY,
            _ => DEVICE,
        }
    }

    fn text(&self) -> &'static str {
        match self.number {
            0 => "No error",
            -104 => "Data type error",
            -108 => "Parameter not allowed",
            -109 => "Missing parameter",
            -113 => "Undefined header",
            -222 => "Data out of range",
            -224 => "Illegal parameter value",
            -350 => "Queue overflow",
            -363 => "Input buffer overrun",
            COLLISION => "Collision",
            // the same on every instrument
            number => {
                BUS.iter().find(|error| error.code() == number).map_or("Device error", |error| error.description())
            }
        }
    }
}

/// Errors of the message exchange.
const BUS: [ErrorNumber; 4] = [
    ErrorNumber::GetNotAllowed,
    ErrorNumber::QueryInterrupted,
    ErrorNumber::QueryUnterminated,
    ErrorNumber::QueryAfterIndefinite,
];

/// The faces have touched.
pub(super) const COLLISION: i16 = 201;

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gap = if self.detail.is_empty() { "" } else { "; " };
        write!(f, "{},\"{}{gap}{}\"", self.number, self.text(), self.detail)
    }
}

/// The queue and the event register of a link.
#[derive(Clone, Debug, Default)]
pub(super) struct Queue {
    entries: VecDeque<Entry>,
    /// Standard event status register.
    pub events: u8,
}

impl Queue {
    /// Empty, with these events.
    pub fn new(events: u8) -> Self {
        Queue { events, ..Queue::default() }
    }

    /// The last place says that there were more.
    pub fn push(&mut self, entry: Entry) {
        self.events |= entry.event();
        match self.entries.len() {
            ROOM => self.entries[ROOM - 1] = Entry::new(-350, ""),
            _ => self.entries.push_back(entry),
        }
    }

    /// The oldest one.
    pub fn pop(&mut self) -> Entry {
        self.entries.pop_front().unwrap_or_else(|| Entry::new(0, ""))
    }

    pub fn len(&self) -> usize {
        self.entries.len()
    }

    pub fn clear(&mut self) {
        *self = Queue::default();
    }
}
