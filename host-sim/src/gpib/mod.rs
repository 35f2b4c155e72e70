//! A GPIB bus in the computer, and the gateway through which a program on the network controls it.
//!
//! # The way of the data
//! ```text
//! bytes of a client -> Lines      -> Line::Command(text), Line::Data(bytes)
//! Line              -> Queue      -> waits for those in front of it, with its address
//! Queue             -> Gateway    -> one operation at a time: write, read, serial poll, trigger, ...
//! operation         -> Instrument -> (bytes, END), serial poll, clear     at an address of a Bus
//! Instrument        -> Exchange   -> bytes in, bytes out, status byte     of a controller or a meter
//! ```
//!
//! [`Gateway`] is one client's; it holds no socket and no clock. What is at the addresses does not know that it is on a
//! bus.

mod claims;
mod command;
mod gateway;
mod lines;
mod queue;
mod settings;

pub use claims::Claims;
pub use gateway::Gateway;

use stage_controller::scpi::exchange::{Device, Exchange, Read};
use std::time::Duration;

/// What a bus can tell an instrument about remote and local.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Panel {
    /// The line REN.
    Enable(bool),
    /// Addressed to listen.
    Remote,
    /// Go to local (GTL).
    Local,
    /// Local lockout (LLO).
    LockOut,
}

/// An instrument on a bus.
pub trait Instrument {
    /// Sends bytes, `end`: with END (EOI) on the last. Says how many are taken; the others are to be offered again,
    /// first and unchanged. Who gives the rest up clears the instrument.
    fn write(&mut self, bytes: &[u8], end: bool) -> usize;
    /// Asks for bytes of an answer.
    fn read(&mut self, to: &mut [u8]) -> Read;
    /// Something is executed, or waits to be.
    fn is_busy(&mut self) -> bool;
    /// Nothing is executed and no answer waits.
    fn is_idle(&mut self) -> bool;
    /// An answer waits, or is being made: what is sent now interrupts it.
    fn awaits_reader(&mut self) -> bool;
    /// The link has an answer that its reader has not; until then it waits.
    fn hold(&mut self, held: bool);
    /// A held answer is not interrupted by what comes.
    fn overlap(&mut self, overlaps: bool);
    /// A `!` is `coming` behind what the link holds back: aborts at once. False: none is on its way any more.
    fn foresee_abort(&mut self, coming: bool);
    /// The rest of a message was refused: forgets what has begun of it. Only when nothing is executed.
    fn drop_message(&mut self);
    /// A message has begun and has not ended.
    fn is_partial(&mut self) -> bool;
    /// The status byte with RQS.
    fn status(&mut self) -> u8;
    /// The status byte with RQS, which this clears.
    fn serial_poll(&mut self) -> u8;
    /// It pulls SRQ.
    fn requests_service(&mut self) -> bool;
    /// Selected device clear.
    fn clear(&mut self);
    /// Group execute trigger. False: to be said again.
    fn trigger(&mut self) -> bool;
    /// Remote and local.
    fn panel(&mut self, panel: Panel);
}

/// Instruments by their primary address, 0 to 30.
pub trait Bus {
    /// Where there are instruments.
    fn addresses(&self) -> Vec<u8>;
    /// The instrument at an address, `wall` time since the start.
    fn instrument(&mut self, address: u8, wall: Duration) -> Option<Box<dyn Instrument + '_>>;
    /// Who has begun a jog at an address has gone: it ends.
    fn release(&mut self, address: u8);
    /// Who of several clients has which instrument.
    fn claims(&mut self) -> &mut Claims;

    /// Ends jogs that begin when their client has gone already, for they have waited for something else. To be called
    /// in every round, `wall` time since the start.
    fn end_late_jogs(&mut self, wall: Duration) {
        for address in self.claims().late_jogs() {
            let waits = self.instrument(address, wall).is_some_and(|mut instrument| instrument.is_busy());
            self.release(address);
            if !waits {
                self.claims().no_late_jogs(address);
            }
        }
    }
}

/// Instruments by their places, 0, 1, ..., of which every client has a link of its own.
pub trait Ports {
    /// How many there are.
    fn places(&self) -> usize;
    /// Opens a link as after power-up; its number, none when all are taken or there is no such place.
    fn open(&mut self, place: usize, wall: Duration) -> Option<usize>;
    /// Closes a link: its input is dropped, its jogs end.
    fn close(&mut self, place: usize, port: usize);
    /// The instrument on a link, `wall` time since the start.
    fn port(&mut self, place: usize, port: usize, wall: Duration) -> Option<Box<dyn Instrument + '_>>;
}

/// A device with its exchange; `poll` executes what can be executed.
pub struct Wired<'a, D, P> {
    /// The exchange.
    pub exchange: &'a mut Exchange,
    /// The device.
    pub device: &'a mut D,
    /// Polls the device, and shows every status byte on the way.
    pub poll: P,
}

impl<D: Device, P: FnMut(&mut D, &mut dyn FnMut(u8)) -> bool> Wired<'_, D, P> {
    fn poll(&mut self) {
        self.exchange.poll(self.device, &mut self.poll);
    }
}

impl<D: Device, P: FnMut(&mut D, &mut dyn FnMut(u8)) -> bool> Instrument for Wired<'_, D, P> {
    fn write(&mut self, bytes: &[u8], end: bool) -> usize {
        let taken = self.exchange.write(self.device, bytes, end);
        self.poll();
        taken
    }

    fn read(&mut self, to: &mut [u8]) -> Read {
        self.poll();
        let read = self.exchange.read(self.device, to);
        self.poll();
        read
    }

    fn is_busy(&mut self) -> bool {
        self.poll();
        self.device.is_busy()
    }

    fn is_idle(&mut self) -> bool {
        self.poll();
        self.exchange.is_idle(self.device)
    }

    fn awaits_reader(&mut self) -> bool {
        self.poll();
        self.exchange.awaits_reader(self.device)
    }

    fn hold(&mut self, held: bool) {
        self.exchange.hold(self.device, held);
    }

    fn overlap(&mut self, overlaps: bool) {
        self.exchange.overlap(overlaps);
    }

    fn foresee_abort(&mut self, coming: bool) {
        self.device.foresee_abort(coming);
        self.poll();
    }

    fn drop_message(&mut self) {
        self.exchange.drop_message(self.device);
    }

    fn is_partial(&mut self) -> bool {
        self.device.is_partial()
    }

    fn status(&mut self) -> u8 {
        self.poll();
        self.exchange.status(self.device)
    }

    fn serial_poll(&mut self) -> u8 {
        self.poll();
        self.exchange.serial_poll(self.device)
    }

    fn requests_service(&mut self) -> bool {
        self.poll();
        self.exchange.requests_service()
    }

    fn clear(&mut self) {
        self.exchange.clear(self.device);
    }

    fn trigger(&mut self) -> bool {
        let done = self.exchange.trigger(self.device);
        self.poll();
        done
    }

    fn panel(&mut self, panel: Panel) {
        let control = self.exchange.control();
        match panel {
            Panel::Enable(enabled) => control.enable(enabled),
            Panel::Remote => control.listens(),
            Panel::Local => control.go_to_local(),
            Panel::LockOut => control.lock_out(),
        }
    }
}
