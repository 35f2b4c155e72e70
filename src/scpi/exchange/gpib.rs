//! A message exchange behind the sixteen lines of a GPIB: what the interface functions of IEEE 488.1
//! ([`stage_gpib::device`]) tell becomes what the exchange of IEEE 488.2 ([`Exchange`]) wants to know.
//!
//! ```text
//! Sample -> Interface::step -> Drive      as often as the firmware can: bytes, clear, trigger, serial poll
//!           Interface::poll               whenever something may have changed: executes, and goes on with what waits
//! ```
//!
//! - **Back-pressure.** One byte is taken at a time. While the device refuses it, NRFD stays true; interface messages
//!   (clear, serial poll, addressing) still pass. So does a trigger, which then waits in its turn.
//! - **An answer** leaves byte by byte, EOI with its last one, the LF; until that has left it waits (MAV, -410). A byte
//!   that was fetched and has not left is kept when ATN or IFC comes, and is dropped with the rest by a device clear or
//!   by the next message.
//! - **-420** is told when the controller has made the device a talker, somebody is ready to listen (NRFD false, NDAC
//!   true), and nothing was asked; once until ATN comes again. Behind END nothing more was asked for: a listener that
//!   is merely ready for another byte has not begun to read.
//! - **IFC** unaddresses and nothing else: half a message is gone on with, half an answer is read on. Who wants neither
//!   clears the device.
//! - **A serial poll** that ATN or IFC broke off may not have told RQS: service is requested once more.
//! - **Remote and local** is RL1 of the interface; the exchange shows it.

use super::{Control, Device, Exchange, Read, stb};
use crate::error::ErrorNumber;
use heapless::Deque;
use stage_gpib::addressing::T;
use stage_gpib::device::{Address, Device as Functions, Event, Sample, Step};
use stage_gpib::lines::Lines;
use stage_gpib::remote::RL;
use stage_gpib::service::SR;
use stage_gpib::timing::Nanoseconds;

/// One byte and triggers that the device has not taken.
const WAITING: usize = 8;

/// What came over the bus, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Heard {
    Byte { byte: u8, end: bool },
    Trigger,
}

/// The lines of one device, and its message exchange.
#[derive(Clone, Debug)]
pub struct Interface {
    functions: Functions,
    exchange: Exchange,
    heard: Deque<Heard, WAITING>,
    /// A byte that was taken has no room yet: NRFD is held.
    full: bool,
    asked: Asked,
}

/// What the controller wants of the talker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    /// Nothing.
    No,
    /// A byte.
    Byte,
    /// A byte that cannot come, or one behind the end: nothing until ATN is true again.
    Over,
}

impl Interface {
    /// As after power-up, at a primary address.
    pub fn new(address: Address) -> Self {
        let mut functions = Functions::new(address);
        functions.accept();
        Interface { functions, exchange: Exchange::new(), heard: Deque::new(), full: false, asked: Asked::No }
    }

    /// The interface functions, for displays.
    pub const fn functions(&self) -> &Functions {
        &self.functions
    }

    /// The key that returns to local is pressed or released.
    pub fn set_local_key(&mut self, pressed: bool) {
        self.functions.set_local_key(pressed);
    }

    /// Who has the controls.
    pub const fn control(&self) -> Control {
        self.exchange.control.control()
    }

    /// Looks at the lines once, as [`stage_gpib::device::Device::step`]; `now` is when the sample was taken. The event
    /// of the step is dealt with; it is handed out for displays.
    pub fn step(&mut self, now: Nanoseconds, sample: Sample, device: &mut impl Device) -> Step {
        let step = self.functions.step(now, sample);
        if let Some(event) = step.event {
            self.hear(event, device);
        }
        if self.functions.states().addressing.talker != T::TACS {
            self.asked = Asked::No;
        }
        self.go_on(device);
        let listened = sample.lines.has(Lines::NDAC) && !sample.lines.has(Lines::NRFD);
        if self.asked == Asked::Byte && listened {
            self.fetch(device);
        }
        self.show(device);
        step
    }

    /// Executes what can be executed, as [`Exchange::poll`].
    pub fn poll<D: Device>(&mut self, device: &mut D, execute: impl FnMut(&mut D, &mut dyn FnMut(u8)) -> bool) -> bool {
        let progress = self.exchange.poll(device, execute);
        self.go_on(device);
        self.show(device);
        progress
    }

    fn hear(&mut self, event: Event, device: &mut impl Device) {
        match event {
            Event::Byte { byte, end } => {
                // always room: no byte comes before the last one is taken, and triggers leave one place
                self.full = true;
                let _ = self.heard.push_back(Heard::Byte { byte, end });
            }
            Event::Trigger if self.heard.len() + 1 < WAITING => {
                let _ = self.heard.push_back(Heard::Trigger);
            }
            Event::Trigger => device.report(ErrorNumber::TriggerIgnored),
            Event::Clear => {
                self.heard.clear();
                self.exchange.clear(device);
            }
            Event::ByteRequested if self.asked == Asked::No => self.asked = Asked::Byte,
            Event::ByteRequested => {}
            // until its end has left, an answer waits
            Event::Sent { end: false, .. } => self.asked = Asked::Byte,
            Event::Sent { end: true, .. } => {
                self.exchange.hold(device, false);
                self.asked = Asked::Over;
            }
            Event::Polled { status, cut: false } if status & stb::MASTER_SUMMARY != 0 => {
                self.exchange.serial_poll(device);
            }
            Event::Polled { .. } => {}
            Event::Remote(state) => self.exchange.control.follow(match state {
                RL::LOCS => Control::Local,
                RL::REMS => Control::Remote,
                RL::RWLS => Control::RemoteWithLockout,
                RL::LWLS => Control::LocalWithLockout,
            }),
        }
    }

    /// Offers the device what it has not taken, in its order.
    fn go_on(&mut self, device: &mut impl Device) {
        while let Some(heard) = self.heard.front() {
            let taken = match *heard {
                Heard::Byte { byte, end } => self.exchange.write(device, &[byte], end) == 1,
                Heard::Trigger => self.exchange.trigger(device),
            };
            if !taken {
                break;
            }
            self.heard.pop_front();
        }
        if self.full && self.heard.is_empty() {
            self.full = false;
            self.functions.accept();
        }
    }

    /// The next byte of the answer, if there is one.
    fn fetch(&mut self, device: &mut impl Device) {
        let mut byte = [0];
        match self.exchange.read(device, &mut byte) {
            Read::Bytes(1.., end) => {
                self.asked = Asked::No;
                self.exchange.hold(device, true);
                self.functions.offer(byte[0], end);
            }
            Read::Bytes(..) | Read::NotYet => {}
            Read::NothingAsked => self.asked = Asked::Over,
        }
    }

    /// Tells the interface functions what the exchange has come to.
    fn show(&mut self, device: &impl Device) {
        // cleared or interrupted: what was fetched goes with the rest
        if !self.exchange.held {
            self.functions.withdraw();
        }
        let status = self.exchange.status(device);
        let states = self.functions.states();
        // rsv falls for one step behind a poll that has not told RQS: then SRQ rises anew
        let untold = states.service == SR::APRS && states.addressing.talker != T::SPAS;
        self.functions.set_status(status, self.exchange.requests_service() && !untold);
    }
}
