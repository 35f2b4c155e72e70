//! Bulk OUT: messages, requests to read, triggers (USBTMC, 3.2).

use crate::PACKET;
use crate::header::{self, Command};

/// What a packet has brought, besides bytes of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Brought {
    /// Nothing else.
    Data,
    /// The host wants to read: tag, at most so many bytes, up to this character.
    Request(u8, u32, Option<u8>),
    /// Against the rules: the endpoint is to be halted.
    Malformed,
}

/// The transfer that is received.
#[derive(Clone, Debug)]
pub struct Receive {
    packet: [u8; PACKET],
    /// Bytes of the message that wait, in the packet.
    from: usize,
    to: usize,
    /// Bytes of the transfer in packets to come.
    left: u32,
    end: bool,
    /// A trigger waits.
    trigger: bool,
    /// Of this or the last transfer.
    tag: u8,
    /// Bytes of the message that this or the last transfer has brought.
    received: u32,
}

impl Receive {
    /// Nothing received.
    pub const fn new() -> Self {
        Receive { packet: [0; PACKET], from: 0, to: 0, left: 0, end: false, trigger: false, tag: 0, received: 0 }
    }

    /// All that came is with the instrument: there is room for a packet.
    pub const fn is_free(&self) -> bool {
        self.from >= self.to && !self.trigger
    }

    /// A transfer is on its way, or not with the instrument yet.
    pub const fn is_active(&self) -> bool {
        self.left > 0 || !self.is_free()
    }

    /// Its tag, or that of the last one; 0: there was none.
    pub const fn tag(&self) -> u8 {
        self.tag
    }

    /// Bytes of the message that it has brought.
    pub const fn received(&self) -> u32 {
        self.received
    }

    /// Where the next packet goes; only when there is room.
    pub const fn room(&mut self) -> &mut [u8; PACKET] {
        &mut self.packet
    }

    /// The packet that has come, so long, is the first of a message that begins with `byte`.
    pub fn begins_with(&self, length: usize, byte: u8) -> bool {
        let message = matches!(header::parse(&self.packet), Some((_, Command::Message { .. })));
        message && length > header::SIZE && self.packet.get(header::SIZE) == Some(&byte)
    }

    /// A packet has come, so long.
    pub fn take(&mut self, length: usize) -> Brought {
        let begins = self.left == 0;
        if begins && length == 0 {
            // ends a transfer of whole packets that was complete
            return Brought::Data;
        }
        let mut head = 0;
        if begins {
            let packet = self.packet.get(..length).unwrap_or(&self.packet);
            let Some((tag, command)) = header::parse(packet) else { return Brought::Malformed };
            (self.tag, self.received) = (tag, 0);
            match command {
                Command::Message { size, end } => (self.left, self.end, head) = (size, end, header::SIZE),
                Command::Request { size, term } => return Brought::Request(tag, size, term),
                Command::Trigger => {
                    self.trigger = true;
                    return Brought::Data;
                }
            }
        }
        let present = length.saturating_sub(head);
        let count = present.min(self.left as usize);
        let rest = self.left.saturating_sub(count as u32);
        // a short packet is the last, and has all that was announced; no more than alignment follows
        if rest > 0 && length < PACKET || present.saturating_sub(count) > header::alignment(count) {
            return Brought::Malformed;
        }
        self.left = rest;
        self.received = self.received.wrapping_add(count as u32);
        (self.from, self.to) = (head, head.saturating_add(count));
        Brought::Data
    }

    /// Bytes for the instrument, and whether the last ends the message.
    pub fn waiting(&self) -> (&[u8], bool) {
        (self.packet.get(self.from..self.to).unwrap_or(&[]), self.end && self.left == 0)
    }

    /// So many of them are with the instrument.
    pub fn consume(&mut self, count: usize) {
        self.from = self.from.saturating_add(count);
    }

    /// A trigger waits.
    pub const fn has_trigger(&self) -> bool {
        self.trigger
    }

    /// It is with the instrument.
    pub const fn triggered(&mut self) {
        self.trigger = false;
    }

    /// Forgets the transfer.
    pub const fn drop_transfer(&mut self) {
        (self.from, self.to, self.left, self.trigger) = (0, 0, 0, false);
    }
}

impl Default for Receive {
    fn default() -> Self {
        Self::new()
    }
}
