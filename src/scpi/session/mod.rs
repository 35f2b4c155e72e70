//! One link: bytes in, calls of the instrument, bytes out.
//!
//! # Design
//! The link offers bytes to [`Session::receive`], calls [`Session::poll`] whenever something may have changed, and
//! drains [`Session::transmit`]. One message is executed at a time, one unit after the other. While it waits (*WAI,
//! *OPC?, back-pressure) further bytes go to a backlog of 512 bytes and are then refused.
//!
//! # `!` and 0x18 while the link waits
//! A second [`Framer`] (the watch) runs over *every* byte that is offered, the refused ones too; it remembers how many
//! of them it has seen. So the link must offer refused bytes again, first and unchanged, and should offer whatever it
//! has. `!` calls [`Instrument::abort`] at the next poll, before anything else. What stands in front of it is still
//! executed in order (no setting and no answer is lost, a pending *OPC? answers once motion has ended), but until the
//! `!` is reached each command is followed by an abort: nothing sent before a `!` moves on after it. 0x18 clears the
//! link and everything in front of it; inside block data both are data.
//!
//! # Streams and buses
//! A stream (socket, serial port) uses a session as it is: answers leave as they come, and nothing interrupts them. A
//! link that is a bus, or has what a bus has, puts an `Exchange` of `scpi::exchange` before it.

use crate::error::{Error, ErrorNumber};
use crate::scpi::common;
use crate::scpi::lexer::{Class, Event, Framer, Lexer};
use crate::scpi::parser::{self, Call, Path};
use crate::scpi::response::Response;
use crate::scpi::status::{Conditions, LinkStatus};
use crate::scpi::tree::Command;
use heapless::Deque;

/// Bytes that are kept while a message waits.
pub const BACKLOG: usize = 512;

/// How a call went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// Done.
    Done,
    /// Not yet: nothing has changed and nothing is answered; the same call comes again at the next poll.
    Wait,
    /// A part of the answer is written; the same call comes again when there is room, with [`Response::cursor`] as set.
    More,
}

/// What executes the calls that are not the link's own.
pub trait Instrument {
    /// Executes a call. A call that fails changes nothing; what it has written is dropped.
    ///
    /// # Errors
    /// Any; it goes to the queue of the link.
    fn execute(&mut self, link: u8, call: &Call<'_>, out: &mut Response) -> Result<Flow, Error>;
    /// `!` on a link: stop everything at once.
    fn abort(&mut self, link: u8);
    /// Motion, scanning or take-up has not ended: what *OPC, *OPC? and *WAI wait for.
    fn operation_pending(&self) -> bool;
    /// The shared conditions.
    fn conditions(&self) -> Conditions;
}

/// What [`Session::step`] did.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    Blocked,
    /// A command, which may have started something.
    Command,
    /// A query, a unit that failed, or the end of a message.
    Other,
}

/// State of one link.
#[derive(Clone, Debug)]
pub struct Session {
    link: u8,
    lexer: Lexer,
    watch: Framer,
    /// Refused bytes that the watch has seen.
    ahead: usize,
    backlog: Deque<u8, BACKLOG>,
    abort_now: bool,
    /// `!` that the watch has seen and the lexer has not.
    aborts_ahead: usize,
    /// Of these, `!` that the link has told of and the watch has not seen.
    #[cfg(feature = "bus")]
    foreseen: usize,
    /// The lexer holds a message that is being executed.
    busy: bool,
    /// Where its next unit begins.
    at: usize,
    path: Path,
    /// The answers of a message are one answer, which its reader reads whole.
    #[cfg(feature = "bus")]
    one_answer: bool,
    /// This message has asked for text without an end of its own.
    #[cfg(feature = "bus")]
    indefinite: bool,
    status: LinkStatus,
    out: Response,
}

impl Session {
    /// A link as after power-up. `link` is handed to the instrument.
    #[inline(never)]
    pub const fn new(link: u8) -> Self {
        Session {
            link,
            lexer: Lexer::new(),
            watch: Framer::new(),
            ahead: 0,
            backlog: Deque::new(),
            abort_now: false,
            aborts_ahead: 0,
            #[cfg(feature = "bus")]
            foreseen: 0,
            busy: false,
            at: 0,
            path: Path::new(),
            #[cfg(feature = "bus")]
            one_answer: false,
            #[cfg(feature = "bus")]
            indefinite: false,
            status: LinkStatus::new(),
            out: Response::new(),
        }
    }

    /// Takes bytes of the link; says how many. The others are to be offered again, first.
    #[inline(never)]
    pub fn receive(&mut self, bytes: &[u8]) -> usize {
        let watched = self.ahead;
        let (mut taken, mut refusing) = (0, false);
        for (n, byte) in bytes.iter().enumerate() {
            if n >= watched {
                match self.watch.step(*byte) {
                    Class::Clear => {
                        self.device_clear();
                        (taken, refusing) = (n + 1, false);
                        continue;
                    }
                    #[cfg(feature = "bus")]
                    Class::Abort if self.foreseen > 0 => self.foreseen -= 1,
                    Class::Abort => {
                        self.abort_now = true;
                        self.aborts_ahead += 1;
                    }
                    _ => {}
                }
            }
            refusing = refusing || !self.accept(*byte);
            if !refusing {
                taken = n + 1;
            }
        }
        self.ahead = watched.max(bytes.len()) - taken;
        taken
    }

    fn accept(&mut self, byte: u8) -> bool {
        if self.busy || !self.backlog.is_empty() {
            return self.backlog.push_back(byte).is_ok();
        }
        let event = self.lexer.push(byte);
        self.framed(event);
        true
    }

    fn framed(&mut self, event: Event) {
        match event {
            Event::Message => {
                self.busy = true;
                self.at = 0;
                self.path = Path::new();
                #[cfg(feature = "bus")]
                {
                    self.indefinite = false;
                }
            }
            Event::TooLong => {
                self.status.report(Error::text(ErrorNumber::InputBufferOverrun, "message longer than 512 bytes"));
            }
            Event::Abort => self.aborts_ahead = self.aborts_ahead.saturating_sub(1),
            // The watch has cleared already.
            Event::Clear | Event::None => {}
        }
    }

    /// True while the rest of a block is awaited and the link is free to send it: after two seconds without a byte
    /// call [`Session::timeout`].
    pub fn awaits_block(&self) -> bool {
        !self.busy && self.backlog.is_empty() && self.ahead == 0 && self.lexer.in_block()
    }

    /// The rest of a block did not come: -161. Does nothing unless [`Session::awaits_block`].
    pub fn timeout(&mut self) {
        if self.awaits_block() {
            let event = self.lexer.timeout();
            self.watch = Framer::new();
            self.framed(event);
        }
    }

    /// BREAK, a closed socket, 0x18: drops input, output and a pending *OPC, *OPC? or *WAI; registers and errors stay.
    /// The link drops bytes that were refused.
    #[inline(never)]
    pub fn device_clear(&mut self) {
        self.lexer.clear();
        self.watch = Framer::new();
        self.backlog.clear();
        (self.ahead, self.aborts_ahead, self.busy, self.at) = (0, 0, false, 0);
        #[cfg(feature = "bus")]
        {
            self.foreseen = 0;
        }
        self.out.clear();
        self.status.forget_operation_complete();
    }

    /// Executes what can be executed. True when a unit was.
    pub fn poll(&mut self, instrument: &mut impl Instrument) -> bool {
        self.advance(instrument, &mut |_| true)
    }

    /// Executes what can be executed, for as long as `goes_on` says so; it is asked in front of every unit and every
    /// message.
    fn advance(&mut self, instrument: &mut impl Instrument, goes_on: &mut dyn FnMut(&mut Self) -> bool) -> bool {
        let mut progress = false;
        if core::mem::take(&mut self.abort_now) {
            instrument.abort(self.link);
        }
        self.look_at(instrument);
        while goes_on(self) && (self.busy || self.refill()) {
            match self.step(instrument) {
                Step::Blocked => break,
                Step::Command => {
                    if self.aborts_ahead > 0 {
                        instrument.abort(self.link);
                    }
                    self.look_at(instrument);
                }
                // it has changed nothing
                Step::Other => {}
            }
            progress = true;
        }
        progress
    }

    /// Takes over what the instrument's state says of status and pending operations.
    fn look_at(&mut self, instrument: &impl Instrument) {
        self.status.observe(&instrument.conditions());
        if !instrument.operation_pending() {
            self.status.operation_ended();
        }
    }

    /// From the backlog into the lexer, up to the next message.
    fn refill(&mut self) -> bool {
        while !self.busy {
            let Some(byte) = self.backlog.pop_front() else {
                #[cfg(feature = "bus")]
                if self.ahead == 0 {
                    // a `!` in a message that was given up is reached when all in front of it is
                    self.aborts_ahead = self.foreseen;
                }
                return false;
            };
            let event = self.lexer.push(byte);
            self.framed(event);
        }
        true
    }

    /// One unit, or the end of the message.
    #[inline(never)]
    fn step(&mut self, instrument: &mut impl Instrument) -> Step {
        if !self.out.ready() {
            return Step::Blocked;
        }
        let Session { link, lexer, path, status, out, .. } = self;
        let Some(unit) = parser::next_unit(lexer.message(), self.at, path) else {
            self.end_message();
            return Step::Other;
        };
        #[cfg(feature = "bus")]
        if self.one_answer
            && let Ok(call) = &unit.call
            && call.query
        {
            // The answers to *IDN? and *OPT? are text without an end of its own: nothing may follow them in an answer
            // (IEEE 488.2, 6.5.7.5). The rest of the message is dropped.
            if self.indefinite {
                status.report(ErrorNumber::QueryAfterIndefinite.into());
                self.end_message();
                return Step::Other;
            }
            self.indefinite = matches!(call.command, Command::Identify | Command::Options);
        }
        let done = if unit.call.is_ok_and(|call| !call.query) { Step::Command } else { Step::Other };
        out.begin();
        let result = unit.call.and_then(|call| {
            let pending = instrument.operation_pending();
            let flow = match common::execute(&call, pending, status, out) {
                Some(own) => own?,
                None => instrument.execute(*link, &call, out)?,
            };
            if !out.fits() {
                return Err(Error::text(ErrorNumber::SystemError, "answer too long"));
            }
            if call.command == Command::Reset && flow == Flow::Done {
                status.forget_operation_complete();
            }
            Ok(flow)
        });
        match result {
            Ok(Flow::Wait) => {
                out.roll_back();
                return Step::Blocked;
            }
            Ok(Flow::More) => return if out.advanced() { Step::Other } else { Step::Blocked },
            Ok(Flow::Done) => {}
            Err(error) => {
                out.roll_back();
                status.report(error);
                if error.number.is_command_error() {
                    self.end_message();
                    return Step::Other;
                }
            }
        }
        out.end_unit();
        (self.at, self.path) = (unit.next, unit.path);
        done
    }

    fn end_message(&mut self) {
        self.out.end_message();
        self.lexer.release();
        self.busy = false;
    }

    /// Hands answers to the link; says how many bytes.
    pub fn transmit(&mut self, to: &mut [u8]) -> usize {
        self.out.transmit(to)
    }

    /// Answers wait for the link.
    pub fn has_output(&self) -> bool {
        self.out.is_available()
    }

    /// A message is held up: by motion, or by a reading that is not there yet.
    pub fn is_waiting(&self) -> bool {
        self.busy && !self.has_output()
    }

    /// Queues a device event, which goes to every link.
    pub fn report(&mut self, error: Error) {
        self.status.report(error);
    }

    /// Latches conditions between two polls, so that a short one is not missed.
    pub fn observe(&mut self, conditions: &Conditions) {
        self.status.observe(conditions);
    }

    /// Status byte with MAV and MSS: serial poll of a GPIB gateway, SRQ.
    pub fn status_byte(&self) -> u8 {
        self.status.status_byte(self.out.is_available())
    }
}

#[cfg(feature = "bus")]
mod message;

#[cfg(test)]
mod tests;
