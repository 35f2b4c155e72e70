//! Bulk IN: answers (USBTMC, 3.3).

use crate::PACKET;
use crate::header::{self, EOM, TERM_CHAR};
use crate::instrument::{Found, Instrument};

/// Where the answer begins, in the buffer: behind the header.
const DATA: usize = header::SIZE;
/// Most bytes behind the last one of a transfer.
const ALIGNMENT: usize = 3;

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
    /// Its header has not been fetched.
    begins: bool,
    /// Bytes that have not been fetched.
    left: usize,
}

/// What stands at the endpoint.
#[derive(Clone, Copy, Debug)]
struct Flight {
    /// Bytes of the answer in it.
    data: usize,
    short: bool,
}

/// A packet, in the buffer.
struct Place {
    from: usize,
    to: usize,
    data: usize,
}

/// The answer that is sent.
#[derive(Clone, Debug)]
pub struct Send {
    /// A header, and behind it bytes of the answer that the host has not fetched, `waiting` of them.
    bytes: [u8; DATA + PACKET + ALIGNMENT],
    waiting: usize,
    request: Option<Request>,
    /// The instrument has not looked at the request.
    unseen: bool,
    transfer: Option<Transfer>,
    /// Of this or the last transfer.
    tag: u8,
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
            bytes: [0; DATA + PACKET + ALIGNMENT],
            waiting: 0,
            request: None,
            unseen: false,
            transfer: None,
            tag: 0,
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
        self.unseen = true;
    }

    /// Forgets what was to be sent.
    pub fn drop_answer(&mut self) {
        self.stop();
        self.waiting = 0;
    }

    #[inline(never)]
    fn stop(&mut self) {
        self.recall = self.flight.is_some();
        (self.request, self.unseen, self.transfer, self.ending) = (None, false, None, false);
    }

    /// The host has bytes of an answer to fetch.
    pub const fn holds(&self) -> bool {
        self.waiting > 0
    }

    /// A transfer has been announced and not been fetched.
    pub const fn is_active(&self) -> bool {
        self.transfer.is_some()
    }

    /// The instrument has not looked at the host's request: whether an answer is there is not known yet.
    pub const fn is_unseen(&self) -> bool {
        self.unseen
    }

    /// Tag of this or the last transfer; 0: there was none.
    pub const fn tag(&self) -> u8 {
        self.tag
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
        let mine = self.transfer.is_some() && self.tag == tag;
        if mine {
            self.stop();
            self.ending = true;
        } else if self.request.is_some_and(|request| request.tag == tag) {
            self.request = None;
        }
        mine
    }

    /// Fetches what is to be sent. True when there was something to do.
    pub fn turn<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        if self.flight.is_some() || self.ending {
            return false;
        }
        // what stands behind a request comes when it was looked at
        let seen = core::mem::take(&mut self.unseen);
        let begun = self.transfer.is_none() && self.begin(instrument);
        let Some(Transfer { left, .. }) = self.transfer else { return seen };
        let filled = self.fill(left, instrument);
        if self.waiting < left.min(PACKET)
            && let Some(transfer) = &mut self.transfer
        {
            // what was announced is not there any more
            transfer.left = self.waiting;
        }
        seen | begun | filled
    }

    /// Announces a transfer; false when there is nothing to send.
    fn begin<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        let Some(request) = self.request else { return false };
        if self.waiting == 0 {
            match instrument.look() {
                Found::Answer => {}
                Found::NotYet => return false,
                Found::NothingAsked => {
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
            if let Some(at) = self.bytes.iter().skip(DATA).take(size).position(|byte| *byte == term) {
                (size, attributes) = (at.saturating_add(1), TERM_CHAR);
            }
        }
        if size == there && instrument.is_whole() {
            attributes |= EOM;
        }
        if let Some(head) = self.bytes.first_chunk_mut() {
            *head = header::answer(request.tag, size as u32, attributes);
        }
        self.request = None;
        (self.tag, self.sent) = (request.tag, 0);
        self.transfer = Some(Transfer { begins: true, left: size });
        true
    }

    /// Fetches up to `size` bytes of the answer, as far as they find room. True when any came.
    fn fill<I: Instrument>(&mut self, size: usize, instrument: &mut I) -> bool {
        let (from, to) = (DATA.saturating_add(self.waiting), DATA.saturating_add(size.min(PACKET)));
        let Some(room) = self.bytes.get_mut(from..to).filter(|room| !room.is_empty()) else { return false };
        let count = instrument.read(room);
        self.waiting = self.waiting.saturating_add(count);
        count > 0
    }

    /// The next packet for the endpoint, when it is free.
    pub fn packet(&self) -> Option<&[u8]> {
        let Place { from, to, .. } = self.place()?;
        self.bytes.get(from..to)
    }

    #[inline(never)]
    fn place(&self) -> Option<Place> {
        if self.flight.is_some() {
            return None;
        }
        if self.ending {
            return Some(Place { from: DATA, to: DATA, data: 0 });
        }
        let Transfer { begins, left, .. } = self.transfer?;
        let (from, most) = if begins { (0, PACKET.saturating_sub(DATA)) } else { (DATA, PACKET) };
        let data = left.min(most);
        if data > self.waiting {
            return None;
        }
        // what the alignment bytes are is left open
        let padding = if data == left { header::alignment(data) } else { 0 };
        Some(Place { from, to: DATA.saturating_add(data).saturating_add(padding), data })
    }

    /// The packet is at the endpoint.
    pub fn handed(&mut self) {
        if let Some(Place { from, to, data }) = self.place() {
            self.flight = Some(Flight { data, short: to.saturating_sub(from) < PACKET });
        }
    }

    /// The host has fetched it.
    pub fn fetched(&mut self) {
        let Some(Flight { data, short }) = self.flight.take() else { return };
        let data = data.min(self.waiting);
        self.waiting = self.waiting.saturating_sub(data);
        self.bytes.copy_within(DATA.saturating_add(data)..DATA.saturating_add(data).saturating_add(self.waiting), DATA);
        self.sent = self.sent.saturating_add(data as u32);
        self.ending = self.ending && (!short || data > 0);
        if let Some(transfer) = &mut self.transfer {
            transfer.begins = false;
            transfer.left = transfer.left.saturating_sub(data);
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
        let ending = self.ending;
        if fetched {
            self.fetched();
        }
        (self.flight, self.ending) = (None, ending);
    }
}

impl Default for Send {
    fn default() -> Self {
        Self::new()
    }
}
