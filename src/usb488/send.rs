//! Bulk IN: answers (USBTMC, 3.3).

use crate::PACKET;
use crate::header::{self, EOM, TERM_CHAR};
use crate::instrument::{Instrument, Read};

/// The host is going to read.
#[derive(Clone, Copy, Debug)]
struct Request {
    tag: u8,
    size: u32,
    term: Option<u8>,
}

/// A transfer that has been announced.
#[derive(Clone, Copy, Debug)]
struct Transfer {
    tag: u8,
    attributes: u8,
    /// Its header has not been fetched.
    begins: bool,
    /// Bytes that have not been fetched.
    left: u32,
}

/// What stands at the endpoint.
#[derive(Clone, Copy, Debug)]
struct Flight {
    /// Bytes of the answer in it.
    data: usize,
    short: bool,
}

/// The answer that is sent.
#[derive(Clone, Debug)]
pub struct Send {
    /// Bytes of the answer that the host has not fetched, `waiting` of them.
    bytes: [u8; PACKET],
    waiting: usize,
    request: Option<Request>,
    transfer: Option<Transfer>,
    flight: Option<Flight>,
    /// What stands at the endpoint is to be taken back.
    recall: bool,
    /// An aborted transfer is to be ended by an empty packet.
    ending: bool,
    /// Bytes that the host has fetched of this or the last transfer.
    sent: u32,
}

impl Send {
    /// Nothing to send.
    pub const fn new() -> Self {
        Send {
            bytes: [0; PACKET],
            waiting: 0,
            request: None,
            transfer: None,
            flight: None,
            recall: false,
            ending: false,
            sent: 0,
        }
    }

    /// The host is going to read; what it has not fetched of the last answer comes first.
    pub fn ask(&mut self, tag: u8, size: u32, term: Option<u8>) {
        self.stop();
        self.request = Some(Request { tag, size, term });
    }

    /// Forgets what was to be sent.
    pub fn drop_answer(&mut self) {
        self.stop();
        self.waiting = 0;
    }

    fn stop(&mut self) {
        self.recall = self.flight.is_some();
        (self.request, self.transfer, self.ending) = (None, None, false);
    }

    /// The host has bytes of an answer to fetch.
    pub const fn holds(&self) -> bool {
        self.waiting > 0
    }

    /// The tag of a transfer that has been announced and not been fetched.
    pub fn active(&self) -> Option<u8> {
        self.transfer.map(|transfer| transfer.tag)
    }

    /// Bytes that the host has fetched of this or the last transfer.
    pub const fn sent(&self) -> u32 {
        self.sent
    }

    /// An aborted transfer has not been ended yet.
    pub const fn is_ending(&self) -> bool {
        self.ending
    }

    /// Aborts the transfer; false when it is not that of `tag`. A request that has not been served is withdrawn.
    pub fn abort(&mut self, tag: u8) -> bool {
        if self.active() == Some(tag) {
            self.stop();
            self.ending = true;
            return true;
        }
        self.request = self.request.filter(|request| request.tag != tag);
        false
    }

    /// Fetches what is to be sent. True when there was something to do.
    pub fn turn<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        if self.flight.is_some() || self.ending {
            return false;
        }
        if self.transfer.is_none() && !self.begin(instrument) {
            return false;
        }
        let left = self.transfer.map_or(0, |transfer| transfer.left as usize);
        let filled = self.fill(left, instrument);
        if self.waiting < left.min(PACKET)
            && let Some(transfer) = &mut self.transfer
        {
            // what was announced is not there any more
            transfer.left = self.waiting as u32;
        }
        filled
    }

    /// Announces a transfer; false when there is nothing to send.
    fn begin<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        let Some(request) = self.request else { return false };
        if self.waiting == 0 && instrument.available() == 0 {
            match instrument.read(&mut self.bytes) {
                Read::Bytes(count) => self.waiting = count,
                Read::NotYet => return false,
                Read::NothingAsked => {
                    self.request = None;
                    return false;
                }
            }
        }
        let there = self.waiting.saturating_add(instrument.available());
        let mut size = there.min(request.size as usize);
        let mut attributes = 0;
        if let Some(term) = request.term {
            self.fill(size, instrument);
            size = size.min(self.waiting);
            if let Some(at) = self.bytes.iter().take(size).position(|byte| *byte == term) {
                (size, attributes) = (at.saturating_add(1), TERM_CHAR);
            }
        }
        if size == there && instrument.is_whole() {
            attributes |= EOM;
        }
        self.request = None;
        self.sent = 0;
        self.transfer = Some(Transfer { tag: request.tag, attributes, begins: true, left: size as u32 });
        true
    }

    /// Fetches up to `size` bytes of the answer, as far as they find room. True when any came.
    fn fill<I: Instrument>(&mut self, size: usize, instrument: &mut I) -> bool {
        let Some(room) = self.bytes.get_mut(self.waiting..size.min(PACKET)).filter(|room| !room.is_empty()) else {
            return false;
        };
        let Read::Bytes(count) = instrument.read(room) else { return false };
        self.waiting = self.waiting.saturating_add(count);
        count > 0
    }

    /// The next packet for the endpoint, when it is free; says how long it is.
    pub fn packet(&self, packet: &mut [u8; PACKET]) -> Option<usize> {
        self.compose(packet).map(|(length, _)| length)
    }

    /// The next packet; its length, and how many bytes of the answer are in it.
    fn compose(&self, packet: &mut [u8; PACKET]) -> Option<(usize, usize)> {
        if self.flight.is_some() {
            return None;
        }
        if self.ending {
            return Some((0, 0));
        }
        let transfer = self.transfer?;
        let head = if transfer.begins { header::SIZE } else { 0 };
        let data = (transfer.left as usize).min(PACKET.saturating_sub(head));
        if data > self.waiting {
            return None;
        }
        if transfer.begins {
            let header = header::answer(transfer.tag, transfer.left, transfer.attributes);
            packet.iter_mut().zip(header).for_each(|(to, from)| *to = from);
        }
        let body = packet.iter_mut().skip(head);
        body.zip(self.bytes.iter().take(data).chain(&[0; 3])).for_each(|(to, from)| *to = *from);
        let last = data == transfer.left as usize;
        let filled = head.saturating_add(data);
        let length = if last { filled.saturating_add(header::alignment(filled)) } else { filled };
        Some((length, data))
    }

    /// The packet is at the endpoint.
    pub fn handed(&mut self) {
        if let Some((length, data)) = self.compose(&mut [0; PACKET]) {
            self.flight = Some(Flight { data, short: length < PACKET });
        }
    }

    /// The host has fetched it.
    pub fn fetched(&mut self) {
        let Some(Flight { data, short }) = self.flight.take() else { return };
        let data = data.min(self.waiting);
        self.bytes.copy_within(data..self.waiting, 0);
        self.waiting = self.waiting.saturating_sub(data);
        self.sent = self.sent.saturating_add(data as u32);
        self.ending = self.ending && (!short || data > 0);
        if let Some(transfer) = &mut self.transfer {
            transfer.begins = false;
            transfer.left = transfer.left.saturating_sub(data as u32);
            if short {
                self.transfer = None;
            }
        }
    }

    /// A packet stands at the endpoint.
    pub const fn is_in_flight(&self) -> bool {
        self.flight.is_some()
    }

    /// What stands at the endpoint is to be taken back; then say [`Send::recalled`].
    pub const fn recalls(&self) -> bool {
        self.recall
    }

    /// The endpoint is empty; `fetched`: because the host was faster.
    pub fn recalled(&mut self, fetched: bool) {
        self.recall = false;
        if fetched {
            let ending = self.ending;
            self.fetched();
            self.ending = ending;
        }
        self.flight = None;
    }
}

impl Default for Send {
    fn default() -> Self {
        Self::new()
    }
}
