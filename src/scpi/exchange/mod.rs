//! The message exchange of IEEE 488.2-1992, chapter 6, for links on which one side speaks at a time.
//!
//! # Where it stands
//! A bus (GPIB), and a link that has what a bus has (HiSLIP, USB488), tells bytes from the end of a message (END), asks
//! for an answer instead of waiting for one, and has lines beside the data: clear, trigger, serial poll, service
//! request, remote and local. All that ends here. Below is a [`Device`]: bytes in, bytes out, one status. It does not
//! know what link it serves, and what executes its commands knows even less.
//!
//! ```text
//! (bytes, END) -> Exchange::write -> Device::take, end   -> parser, execution
//! read request -> Exchange::read  <- Device::give        <- answers
//! poll, SRQ    <- Exchange        <- Device::status_byte
//! ```
//!
//! # The rules
//! The controller ends a message before it reads, and reads an answer whole before it writes again. What breaks them:
//!
//! | What the controller does | Error | What becomes of it |
//! |---|---|---|
//! | writes or triggers while an answer waits, is read or is being made | -410 | the answer, and the rest of its message, are dropped |
//! | reads when nothing was asked, or in the middle of a message | -420 | nothing is sent; a message that has begun is dropped |
//! | asks again behind `*IDN?` or `*OPT?` in one message | -440 | the first answer stands, the rest is dropped |
//! | triggers in the middle of a message | -105 | no trigger; the message is dropped |
//!
//! Several messages in one go are executed in turn; the first that asks waits for its reader, and if another one
//! stands behind it, it is interrupted. -430 (DEADLOCKED: input and output are full) does not happen: a message is
//! executed when it is there as a whole, so no answer ever waits for the end of its own question.
//!
//! White space between messages is none: `*IDN?` with a line end of its own, in front of the one that a driver adds, is
//! one question.
//!
//! A stream needs none of this: there a [`Session`](super::session::Session) sends its answers as they come.

mod control;
#[cfg(feature = "gpib")]
pub mod gpib;
#[cfg(test)]
mod tests;
mod usb488;

pub use control::{Control, RemoteLocal};
pub use usb488::Attached;

use super::status::stb;
use crate::error::ErrorNumber;

/// What takes program messages and makes answers.
pub trait Device {
    /// Takes bytes; says how many. The others are to be offered again, first and unchanged.
    fn take(&mut self, bytes: &[u8]) -> usize;
    /// END came with the last byte that was taken. False: not yet, to be said again after the next poll.
    fn end(&mut self) -> bool;
    /// A message has begun and has not ended.
    fn is_partial(&self) -> bool;
    /// Forgets a message that has begun, and bytes that were refused; what stands in front of it stays.
    fn drop_partial(&mut self);
    /// A `!` is `coming` on the link, behind bytes that it holds back: aborts at once, and after each command up to it.
    /// False: none is on its way any more. What knows no `!` does nothing.
    fn foresee_abort(&mut self, coming: bool) {
        let _ = coming;
    }
    /// A whole message is there: executed, held up, or waiting for its turn.
    fn is_busy(&self) -> bool;
    /// Bytes stand behind the message that is executed, or behind an answer, that are more than white space.
    fn has_more(&self) -> bool;
    /// The message that is executed has asked something, and its answer has not ended.
    fn asks(&self) -> bool;
    /// Bytes of an answer wait.
    fn has_answer(&self) -> bool {
        self.available() > 0
    }
    /// So many bytes of an answer wait.
    fn available(&self) -> usize;
    /// Hands bytes of an answer out; says how many.
    fn give(&mut self, to: &mut [u8]) -> usize;
    /// Forgets an answer, and the rest of its message.
    fn drop_answer(&mut self);
    /// Device clear: forgets input and output and what they wait for; registers and errors stay.
    fn clear(&mut self);
    /// Does what *TRG does, behind what was sent before. False: no room, to be said again.
    fn trigger(&mut self) -> bool;
    /// Queues an error.
    fn report(&mut self, error: ErrorNumber);
    /// The status byte, with MSS in bit 6; `held`: the link has bytes of an answer that its reader has not.
    fn status_byte(&self, held: bool) -> u8;
}

/// What a read has brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Read {
    /// So many bytes; with END on the last one, the answer is complete.
    Bytes(usize, bool),
    /// Nothing yet: a message is still executed, which may answer.
    NotYet,
    /// Nothing, and nothing will come: the controller has not asked (-420).
    NothingAsked,
}

/// The exchange of one link.
#[derive(Clone, Copy, Debug, Default)]
pub struct Exchange {
    /// END is still to be told.
    ending: bool,
    /// The link has taken an answer that its reader has not: it waits, as if it were still in the device.
    held: bool,
    /// What comes does not interrupt a held answer.
    overlaps: bool,
    /// Bytes or a trigger have come since this was last asked.
    heard: bool,
    /// MSS as last seen.
    summary: bool,
    /// RQS: MSS has risen since the last serial poll.
    requests: bool,
    control: RemoteLocal,
}

impl Exchange {
    /// As after power-up.
    pub const fn new() -> Self {
        Exchange {
            ending: false,
            held: false,
            overlaps: false,
            heard: false,
            summary: false,
            requests: false,
            control: RemoteLocal::new(),
        }
    }

    /// The controller sends bytes, `end`: with END on the last. Says how many are taken; the others are to be offered
    /// again, first and unchanged, after the next poll. Who gives the rest up clears the device.
    pub fn write(&mut self, device: &mut impl Device, bytes: &[u8], end: bool) -> usize {
        self.tell_end(device);
        if self.ending || bytes.is_empty() {
            return 0;
        }
        self.control.listens();
        if bytes.iter().all(u8::is_ascii_whitespace) && !device.is_partial() && !device.has_more() {
            // the end of the last message, sent twice
            self.heard = true;
            return bytes.len();
        }
        self.interrupt(device);
        let taken = device.take(bytes);
        self.heard |= taken > 0;
        if taken == bytes.len() && end {
            self.ending = true;
            self.tell_end(device);
        }
        self.observe(device);
        taken
    }

    /// The controller wants bytes of an answer. Poll the device before.
    pub fn read(&mut self, device: &mut impl Device, to: &mut [u8]) -> Read {
        if to.is_empty() {
            return Read::NotYet;
        }
        let asked = self.look(device);
        if !matches!(asked, Read::Bytes(..)) {
            return asked;
        }
        let count = device.give(to);
        self.observe(device);
        Read::Bytes(count, !device.has_answer() && !device.asks())
    }

    /// As [`Exchange::read`], but leaves the bytes where they are: says how many there are.
    pub fn look(&mut self, device: &mut impl Device) -> Read {
        let there = device.available();
        if there > 0 {
            Read::Bytes(there, !device.asks())
        } else if self.ending || device.is_busy() {
            Read::NotYet
        } else {
            device.drop_partial();
            device.report(ErrorNumber::QueryUnterminated);
            self.observe(device);
            Read::NothingAsked
        }
    }

    /// Executes what can be executed: `execute` polls the device, shows every status byte on the way, and says whether
    /// it has done something.
    pub fn poll<D: Device>(
        &mut self,
        device: &mut D,
        mut execute: impl FnMut(&mut D, &mut dyn FnMut(u8)) -> bool,
    ) -> bool {
        let mut progress = false;
        loop {
            progress |= execute(device, &mut |status| {
                if !self.held {
                    self.see(status);
                }
            });
            self.observe(device);
            let ended = self.ending && self.tell_end(device);
            if device.has_more() && self.interrupt(device) || ended {
                continue;
            }
            return progress;
        }
    }

    /// An answer waits, or is being made: what is sent now interrupts it.
    pub fn awaits_reader(&self, device: &impl Device) -> bool {
        self.held && !self.overlaps || device.has_answer() || device.asks()
    }

    /// For links on which questions may be sent ahead of the answers (HiSLIP, overlapped mode): an answer that is held
    /// shows in the status byte, and is not interrupted by what comes.
    pub fn overlap(&mut self, overlaps: bool) {
        self.overlaps = overlaps;
    }

    /// Bytes or a trigger have come since this was last asked: traffic, as a jog needs it.
    pub fn take_heard(&mut self) -> bool {
        core::mem::take(&mut self.heard)
    }

    /// The link has refused the rest of a message: what has begun of it is forgotten. Only when nothing is executed.
    pub fn drop_message(&mut self, device: &mut impl Device) {
        if device.is_partial() {
            device.drop_partial();
        }
    }

    /// For links that take answers ahead of their reader: `held` until the last byte has been read.
    pub fn hold(&mut self, device: &impl Device, held: bool) {
        self.held = held;
        self.observe(device);
    }

    /// Something was sent while an answer waited: -410.
    fn interrupt(&mut self, device: &mut impl Device) -> bool {
        let waits = self.awaits_reader(device);
        if waits {
            self.held &= self.overlaps;
            device.drop_answer();
            device.report(ErrorNumber::QueryInterrupted);
        }
        waits
    }

    /// True when the device knows of the end now.
    #[inline(never)]
    fn tell_end(&mut self, device: &mut impl Device) -> bool {
        if self.ending {
            self.ending = !device.end();
        }
        !self.ending
    }

    /// Something has changed at the device between two polls.
    #[inline(never)] // called at the end of everything
    pub fn observe(&mut self, device: &impl Device) {
        self.see(device.status_byte(self.held));
    }

    /// The status byte at some time: a service request is an edge of its summary.
    fn see(&mut self, status: u8) {
        let summary = status & stb::MASTER_SUMMARY != 0;
        self.requests = summary && (self.requests || !self.summary);
        self.summary = summary;
    }

    /// The device asks for a serial poll (SRQ).
    pub const fn requests_service(&self) -> bool {
        self.requests
    }

    /// The status byte with RQS in bit 6.
    pub fn status(&mut self, device: &impl Device) -> u8 {
        let status = device.status_byte(self.held);
        self.see(status);
        status & !stb::MASTER_SUMMARY | if self.requests { stb::MASTER_SUMMARY } else { 0 }
    }

    /// The status byte with RQS in bit 6, which this clears.
    pub fn serial_poll(&mut self, device: &impl Device) -> u8 {
        let status = self.status(device);
        self.requests = false;
        status
    }

    /// Nothing is executed and no answer waits: a read would be an error.
    pub fn is_idle(&self, device: &impl Device) -> bool {
        !self.ending && !device.is_busy() && !device.has_answer()
    }

    /// Device clear (DCL, SDC).
    pub fn clear(&mut self, device: &mut impl Device) {
        (self.ending, self.held) = (false, false);
        device.clear();
        self.observe(device);
    }

    /// Group execute trigger. False: to be said again after the next poll.
    pub fn trigger(&mut self, device: &mut impl Device) -> bool {
        if !self.tell_end(device) {
            return false;
        }
        self.control.listens();
        let done = if device.is_partial() {
            device.drop_partial();
            device.report(ErrorNumber::GetNotAllowed);
            true
        } else {
            self.interrupt(device);
            device.trigger()
        };
        self.heard |= done;
        self.observe(device);
        done
    }

    /// The controller gives a message up that it has begun, with the bytes that were refused. Those before it stay.
    pub fn abandon(&mut self, device: &mut impl Device) {
        // while an end is still to be told, nothing of the next message has been taken
        if !self.ending {
            device.drop_partial();
        }
    }

    /// Remote, local and lockout.
    pub const fn control(&mut self) -> &mut RemoteLocal {
        &mut self.control
    }
}
