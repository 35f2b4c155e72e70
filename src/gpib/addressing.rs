//! Talker (T6) and listener (L4) functions (IEEE 488.1, 2.5 and 2.6).

use crate::message::Message;
use crate::table::{self, Arrow};

/// Talker states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum T {
    /// Talker idle.
    TIDS,
    /// Talker addressed; waits until ATN goes false.
    TADS,
    /// Talker active: sends bytes of messages.
    TACS,
    /// Serial poll active: sends the status byte.
    SPAS,
}

/// Serial poll mode of the talker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SP {
    /// Serial poll idle.
    SPIS,
    /// Serial poll mode.
    SPMS,
}

/// Listener states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum L {
    /// Listener idle.
    LIDS,
    /// Listener addressed.
    LADS,
    /// Listener active: takes bytes of messages.
    LACS,
}

/// T6: a listen address of its own, or the talk address of another, ends talking.
const TALKER: [Arrow<T, Message>; 3] =
    [(T::TIDS, Message::MTA, T::TADS), (T::TADS, Message::OTA, T::TIDS), (T::TADS, Message::MLA, T::TIDS)];

const POLL: [Arrow<SP, Message>; 2] = [(SP::SPIS, Message::SPE, SP::SPMS), (SP::SPMS, Message::SPD, SP::SPIS)];

/// L4: its own talk address ends listening.
const LISTENER: [Arrow<L, Message>; 3] =
    [(L::LIDS, Message::MLA, L::LADS), (L::LADS, Message::UNL, L::LIDS), (L::LADS, Message::MTA, L::LIDS)];

/// Who may talk and who listens, of one device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Addressing {
    /// Talker.
    pub talker: T,
    /// Serial poll mode.
    pub poll: SP,
    /// Listener.
    pub listener: L,
}

impl Addressing {
    /// After power-on and after IFC.
    pub const IDLE: Addressing = Addressing { talker: T::TIDS, poll: SP::SPIS, listener: L::LIDS };

    /// An interface message was accepted.
    pub fn on_message(&mut self, message: Message) {
        self.talker = table::next(&TALKER, self.talker, message);
        self.poll = table::next(&POLL, self.poll, message);
        self.listener = table::next(&LISTENER, self.listener, message);
    }

    /// ATN is as given: active while it is false, addressed while it is true.
    pub fn on_attention(&mut self, attention: bool) {
        self.talker = match (self.talker, attention, self.poll) {
            (T::TIDS, ..) => T::TIDS,
            (_, true, _) => T::TADS,
            (T::TADS, false, SP::SPIS) => T::TACS,
            (T::TADS, false, SP::SPMS) => T::SPAS,
            (active, false, _) => active,
        };
        self.listener = match (self.listener, attention) {
            (L::LIDS, _) => L::LIDS,
            (_, true) => L::LADS,
            (_, false) => L::LACS,
        };
    }

    /// Whether the device holds the drivers of DIO, DAV and EOI.
    pub fn talks(self) -> bool {
        matches!(self.talker, T::TACS | T::SPAS)
    }
}
