//! The class as a whole: endpoints, requests and the instrument meet here.

use crate::control::status;
use crate::instrument::{Instrument, Panel};
use crate::notify::Notify;
use crate::receive::{Brought, Receive};
use crate::send::Send;
use crate::wire::Wire;

/// The two-part request that is on its way (USBTMC, 4.2.1.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Split {
    None,
    AbortOut,
    AbortIn,
    Clear,
}

/// Remote and local orders that wait, four bits each, the oldest highest.
#[derive(Clone, Debug, Default)]
struct Panels(u16);

impl Panels {
    const ALL: [Panel; 4] = [Panel::Disable, Panel::Enable, Panel::Local, Panel::LockOut];

    fn push(&mut self, panel: Panel) -> bool {
        let room = self.0 < 0x1000;
        if room {
            self.0 = self.0 << 4 | (panel as u16).wrapping_add(1);
        }
        room
    }

    fn pop(&mut self) -> Option<Panel> {
        let shift = 12_u32.saturating_sub(self.0.leading_zeros() & 0xc);
        let code = self.0.checked_shr(shift).unwrap_or(0);
        self.0 &= !(0xf_u16.checked_shl(shift).unwrap_or(0));
        Self::ALL.get(usize::from(code).checked_sub(1)?).copied()
    }
}

/// One interface of class USB488.
///
/// Its two sides may be called from different places, one at a time: [`pump`] and [`control`] by who has the endpoints,
/// [`turn`] by who has the instrument.
///
/// [`pump`]: Interface::pump
/// [`control`]: Interface::control
/// [`turn`]: Interface::turn
#[derive(Clone, Debug)]
pub struct Interface {
    pub(crate) receive: Receive,
    pub(crate) send: Send,
    notify: Notify,
    split: Split,
    panels: Panels,
    /// The instrument is to be cleared.
    clear: bool,
    /// The message that has begun is to be forgotten.
    abandon: bool,
    /// What is on its way on bulk OUT is to be read away.
    drain: bool,
    /// Bulk OUT is halted.
    halted: bool,
    /// A `!` was among what was read away behind a clear.
    shout: bool,
}

impl Interface {
    /// As after a reset of the bus, and after the device has been configured: what bulk OUT has from before is read away.
    pub const fn new() -> Self {
        Interface {
            receive: Receive::new(),
            send: Send::new(),
            notify: Notify::new(),
            split: Split::None,
            panels: Panels(0),
            clear: false,
            abandon: false,
            drain: true,
            halted: false,
            shout: false,
        }
    }

    // The endpoints.

    /// Goes on with the endpoints. True when something has come or gone that the instrument's side looks after.
    pub fn pump(&mut self, wire: &mut impl Wire) -> bool {
        let mut any = false;
        // before what comes: a host that has fetched all of an answer goes on
        if self.send.is_in_flight() && wire.is_fetched() {
            self.send.fetched();
            any = true;
        }
        if self.notify.is_in_flight() && wire.is_notice_fetched() {
            self.notify.fetched();
            any = true;
        }
        while self.wants_packet() {
            let Some(length) = wire.receive(self.receive.room()) else {
                self.drain &= self.clear;
                break;
            };
            if self.packet_out(length) {
                wire.halt();
            }
            any = true;
        }
        if self.send.recalls() {
            self.send.recalled(wire.recall());
            any = true;
        }
        if let Some(packet) = self.send.packet()
            && wire.send(packet)
        {
            self.send.handed();
        }
        if let Some(notice) = self.notify.next()
            && wire.notify(&notice)
        {
            self.notify.handed();
        }
        any
    }

    /// A packet may come: bulk OUT is to be read.
    const fn wants_packet(&self) -> bool {
        self.drain || self.halted || !self.clear && !self.abandon && !self.send.is_unseen() && self.receive.is_free()
    }

    /// A packet has come; true when bulk OUT is to be halted for it.
    fn packet_out(&mut self, length: usize) -> bool {
        if self.drain || self.halted {
            // the class lets go what comes before the clear has ended, but stop is stop
            self.shout |= self.split == Split::Clear && self.receive.begins_with(length, b'!');
            return false;
        }
        // who goes on has no use for the second part of a request
        self.check(self.split);
        match self.receive.take(length) {
            Brought::Data => {}
            Brought::Request(tag, size, term) => self.send.ask(tag, size, term),
            Brought::Malformed => {
                self.halted = true;
                self.give_up_message();
            }
        }
        self.halted
    }

    /// The host has cleared the halt of bulk OUT: a header comes next (USBTMC, 3.2.2.3).
    pub fn halt_cleared(&mut self) {
        if self.receive.is_active() {
            self.give_up_message();
        }
        self.halted = false;
    }

    fn give_up_message(&mut self) {
        self.receive.drop_transfer();
        self.abandon = true;
    }

    // The instrument.

    /// Goes on with the instrument, which has executed what it can. True when something has changed, for either side.
    pub fn turn<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        let mut any = false;
        if core::mem::take(&mut self.clear) {
            instrument.clear();
            self.abandon = false;
            any = true;
        }
        if core::mem::take(&mut self.shout) {
            // cleared a moment ago, it has room
            instrument.write(b"!\n", true);
            any = true;
        }
        if core::mem::take(&mut self.abandon) {
            instrument.abandon();
            any = true;
        }
        while let Some(panel) = self.panels.pop() {
            instrument.panel(panel);
        }
        instrument.hold(self.send.holds());
        any |= self.forward(instrument);
        any |= self.send.turn(instrument);
        instrument.hold(self.send.holds());
        any | self.notify.turn(instrument)
    }

    /// Hands the instrument what has come; true when it has taken something.
    fn forward<I: Instrument>(&mut self, instrument: &mut I) -> bool {
        if self.receive.is_free() {
            return false;
        }
        // whatever the host was to read, it has gone on
        self.send.drop_answer();
        if self.receive.has_trigger() {
            let done = instrument.trigger();
            if done {
                self.receive.triggered();
            }
            return done;
        }
        let (bytes, end) = self.receive.waiting();
        let taken = instrument.write(bytes, end);
        self.receive.consume(taken);
        taken > 0 || self.send.recalls()
    }

    // Requests.

    pub(crate) fn abort_out(&mut self, tag: u8) -> u8 {
        if !self.may_split(Split::AbortOut) {
            return status::SPLIT_IN_PROGRESS;
        }
        if !self.receive.is_active() {
            return status::FAILED;
        }
        if tag != self.receive.tag() {
            return status::TRANSFER_NOT_IN_PROGRESS;
        }
        self.give_up_message();
        self.drain = true;
        self.split = Split::AbortOut;
        status::SUCCESS
    }

    pub(crate) fn abort_in(&mut self, tag: u8) -> u8 {
        if !self.may_split(Split::AbortIn) {
            return status::SPLIT_IN_PROGRESS;
        }
        let active = self.send.is_active();
        if self.send.abort(tag) {
            self.split = Split::AbortIn;
            status::SUCCESS
        } else if active {
            status::TRANSFER_NOT_IN_PROGRESS
        } else {
            status::FAILED
        }
    }

    pub(crate) fn begin_clear(&mut self) -> u8 {
        self.receive.drop_transfer();
        self.send.drop_answer();
        (self.clear, self.drain) = (true, true);
        self.split = Split::Clear;
        status::SUCCESS
    }

    fn may_split(&self, split: Split) -> bool {
        self.split == Split::None || self.split == split
    }

    /// How a two-part request goes, and whether bulk IN has something that ends it.
    #[inline(never)]
    pub(crate) fn check(&mut self, split: Split) -> (u8, u8) {
        if self.split != split {
            return (status::SPLIT_NOT_IN_PROGRESS, 0);
        }
        let ending = split == Split::AbortIn;
        let busy = if ending { self.send.is_ending() } else { self.clear || self.abandon || self.drain };
        if busy {
            return (status::PENDING, u8::from(ending));
        }
        self.split = Split::None;
        (status::SUCCESS, 0)
    }

    pub(crate) fn read_status(&mut self, tag: u8) -> u8 {
        match tag {
            2..=127 if self.notify.ask(tag) => status::SUCCESS,
            2..=127 => status::INTERRUPT_IN_BUSY,
            _ => status::FAILED,
        }
    }

    pub(crate) fn panel(&mut self, panel: Panel) -> u8 {
        if self.panels.push(panel) { status::SUCCESS } else { status::FAILED }
    }
}

impl Default for Interface {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orders_of_the_panel_are_carried_out_in_turn_and_no_more_than_four_wait() {
        let mut panels = Panels::default();
        assert_eq!(panels.pop(), None);
        for panel in [Panel::LockOut, Panel::Disable, Panel::Enable, Panel::Local] {
            assert!(panels.push(panel));
        }
        assert!(!panels.push(Panel::Local));
        let order = [panels.pop(), panels.pop(), panels.pop(), panels.pop(), panels.pop()];
        assert_eq!(order, [Some(Panel::LockOut), Some(Panel::Disable), Some(Panel::Enable), Some(Panel::Local), None]);
    }
}
