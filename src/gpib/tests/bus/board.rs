//! The device under test, its gates, and firmware that runs it.
//!
//! [`Board`] is pins and gates; what looks at samples is a [`Firmware`]. [`Simple`] is the device with an exchange that
//! only counts; a real one may stand in its place.

use super::Random;
use super::ledger::{Ledger, Mark};
use super::{DEVICE, Pull, Time, between, once_in};
use stage_gpib::addressing::L;
use stage_gpib::device::{Address, Device, Drive, Event, Sample};
use stage_gpib::lines::Lines;
use stage_gpib::remote::RL;
use std::collections::VecDeque;

/// How fast the firmware runs, in nanoseconds.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Longest time from a sample to its answer on the pins.
    pub answer: Time,
    /// Longest time from there to the next sample.
    pub pause: Time,
}

impl Pace {
    pub const FAST: Pace = Pace { answer: 150, pause: 150 };
    pub const SLOW: Pace = Pace { answer: 20_000, pause: 20_000 };

    pub fn any(random: &mut Random) -> Pace {
        let choices =
            [Pace::FAST, Pace { answer: 1_000, pause: 400 }, Pace { answer: 5_000, pause: 5_000 }, Pace::SLOW];
        choices[random.bits() as usize % choices.len()]
    }
}

/// The gates of docs/GPIB-BOARD.md.
#[derive(Clone, Copy, Debug, Default)]
struct Gates {
    /// ATN as it comes out of the transceiver.
    attention: bool,
    /// The flip-flop.
    armed: bool,
    /// ATN rose: the flip-flop clears even if ATN is gone when that comes through.
    clears: bool,
}

/// A message exchange that answers late.
#[derive(Debug, Default)]
pub struct Exchange {
    pub events: Vec<Event>,
    pub clears: u32,
    pub triggers: u32,
    pub remotes: Vec<RL>,
    pub polls: Vec<(u8, bool)>,
    pub status: u8,
    pub request: bool,
    /// Bytes it still has to say.
    pub answer: VecDeque<Mark>,
    /// Never at a loss for a byte: counts on.
    pub endless: Option<u8>,
    offered: Option<Mark>,
    accept_in: u32,
    offer_in: u32,
    /// Never ready again.
    pub deaf: bool,
}

/// What runs behind the pins.
pub trait Firmware {
    /// The interface functions.
    fn device(&self) -> &Device;
    /// Looks at a sample taken at `now`; says what to drive.
    fn look(&mut self, now: Time, sample: Sample, ledger: &mut Ledger, random: &mut Random) -> Drive;
}

/// A device and an exchange that only counts.
#[derive(Debug)]
pub struct Simple {
    pub device: Device,
    pub exchange: Exchange,
}

impl Firmware for Simple {
    fn device(&self) -> &Device {
        &self.device
    }

    fn look(&mut self, now: Time, sample: Sample, ledger: &mut Ledger, random: &mut Random) -> Drive {
        let step = self.device.step(now, sample);
        if let Some(event) = step.event {
            self.exchange.hear(&mut self.device, event, ledger, random);
        }
        self.exchange.think(&mut self.device);
        step.drive
    }
}

#[derive(Debug)]
pub struct Board<F = Simple> {
    pub firmware: F,
    pace: Pace,
    /// Without the gates firmware alone has to answer ATN.
    pub fitted: bool,
    /// The processor runs; else its outputs are pulled down and the gates hold nothing.
    online: bool,
    gates: Gates,
    drive: Drive,
    gate_at: Time,
    sample_at: Time,
    /// The lines were read; the gates are read a little later.
    read: Option<(Time, Time, Lines)>,
    write: Option<(Time, Drive)>,
}

impl Board {
    pub fn new(pace: Pace) -> Board {
        let mut device = Device::new(Address::new(DEVICE).expect("an address"));
        device.accept();
        Board::with(Simple { device, exchange: Exchange::default() }, pace)
    }

    /// A processor in reset, or dead.
    pub fn unpowered() -> Board {
        Board { online: false, sample_at: Time::MAX, ..Board::new(Pace::FAST) }
    }

    /// Nothing is waiting to be written that is not on the pins.
    pub fn status(&mut self, status: u8, request: bool) {
        self.firmware.exchange.status = status;
        self.firmware.exchange.request = request;
        self.firmware.device.set_status(status, request);
    }
}

impl<F: Firmware> Board<F> {
    /// A board as after power-up.
    pub fn with(firmware: F, pace: Pace) -> Self {
        let still = firmware.device().clone().step(0, Sample { lines: Lines::NONE, armed: true }).drive;
        Board {
            firmware,
            pace,
            fitted: true,
            online: true,
            gates: Gates::default(),
            drive: still,
            gate_at: Time::MAX,
            sample_at: 100,
            read: None,
            write: None,
        }
    }

    /// Listens, as far as a source may rely on it.
    pub fn listens(&self) -> bool {
        self.firmware.device().states().addressing.listener != L::LIDS
    }

    pub fn next(&self) -> Time {
        let read_at = self.read.map_or(self.sample_at, |(at, ..)| at);
        self.gate_at.min(self.write.map_or(read_at, |(at, _)| at))
    }

    /// ATN goes through transceiver and gates in less than t2.
    pub fn notice(&mut self, now: Time, before: Lines, lines: Lines, random: &mut Random) {
        if before.has(Lines::ATN) != lines.has(Lines::ATN) {
            self.gates.clears |= lines.has(Lines::ATN);
            self.gate_at = self.gate_at.min(now + between(random, 20, 150));
        }
    }

    pub fn wake(&mut self, now: Time, lines: Lines, ledger: &mut Ledger, random: &mut Random) {
        if now == self.gate_at {
            self.gate_at = Time::MAX;
            self.gates.attention = lines.has(Lines::ATN);
            self.gates.armed &= !self.gates.clears;
            self.gates.clears = self.gates.attention;
            return;
        }
        if let Some((_, drive)) = self.write.take() {
            self.drive = drive;
            self.gates.armed |= drive.arm && !self.gates.attention;
            self.sample_at = now + between(random, 20, self.pace.pause);
        } else if let Some((_, sampled_at, lines)) = self.read.take() {
            let armed = if self.fitted { self.gates.armed } else { !lines.has(Lines::ATN) };
            let drive = self.firmware.look(sampled_at, Sample { lines, armed }, ledger, random);
            self.write = Some((now + between(random, 20, self.pace.answer), drive));
        } else {
            self.read = Some((now + between(random, 10, 100), now, lines));
        }
    }

    pub fn pull(&self) -> Pull {
        let Drive { lines, attention_seen, talk_enable, .. } = self.drive;
        let armed = self.gates.armed || !self.fitted;
        let talks = talk_enable && armed;
        let hold = self.fitted && self.online && !self.gates.armed && !(self.gates.attention && attention_seen);
        let through = if talks {
            Lines::DIO | Lines::EOI | Lines::DAV | Lines::SRQ
        } else {
            Lines::NRFD | Lines::NDAC | Lines::SRQ
        };
        Pull { lines: lines.only(through) | (Lines::NRFD | Lines::NDAC).when(hold && !talks), drives_data: talks }
    }
}

impl Exchange {
    fn hear(&mut self, device: &mut Device, event: Event, ledger: &mut Ledger, random: &mut Random) {
        self.events.push(event);
        match event {
            Event::Byte { byte, end } => {
                ledger.device.got.push((byte, end));
                self.accept_in = 1 + if once_in(random, 3) { (random.bits() % 5) as u32 } else { 0 };
            }
            Event::ByteRequested => self.offer_in = 1 + (random.bits() % 4) as u32,
            Event::Sent { end, cut } => {
                let mark = self.offered.take().expect("only what was offered leaves");
                assert_eq!(mark.1, end);
                ledger.sent(mark, cut);
                if once_in(random, 2) {
                    self.offer_in = 1;
                }
            }
            Event::Polled { status, cut } => {
                self.polls.push((status, cut));
                if status & 0x40 != 0 {
                    self.request = false;
                    device.set_status(self.status, false);
                }
            }
            Event::Clear => {
                self.clears += 1;
                // what was offered is withdrawn: it comes again as the next answer
                if let Some(mark) = self.offered.take() {
                    self.answer.push_front(mark);
                }
            }
            Event::Trigger => self.triggers += 1,
            Event::Remote(state) => self.remotes.push(state),
        }
    }

    fn think(&mut self, device: &mut Device) {
        if self.accept_in == 1 && !self.deaf {
            device.accept();
        }
        self.accept_in = self.accept_in.saturating_sub(1).max(self.deaf as u32);
        if self.offer_in == 1
            && self.offered.is_none()
            && let Some(mark) = self.answer.pop_front().or_else(|| count(&mut self.endless))
        {
            self.offered = Some(mark);
            device.offer(mark.0, mark.1);
        }
        self.offer_in = self.offer_in.saturating_sub(1);
    }
}

/// The next byte of one who counts; every seventh ends a message.
pub fn count(counter: &mut Option<u8>) -> Option<Mark> {
    let byte = (*counter)?;
    *counter = Some(byte.wrapping_add(1));
    Some((byte, byte % 7 == 6))
}
