//! Another talker and listener: fast, and written on its own.

use super::Random;
use super::board::count;
use super::ledger::{Ledger, Mark};
use super::{INSTRUMENT, Pull, Time, between};
use stage_gpib::lines::Lines;
use std::collections::VecDeque;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Ear {
    Off,
    Busy { until: Time },
    Ready,
    Taking { until: Time },
    Taken,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mouth {
    Off,
    Empty,
    Settling { until: Time, byte: u8, end: bool },
    Valid { byte: u8, end: bool },
}

#[derive(Debug)]
pub struct Instrument {
    /// Switched off: pulls nothing, hears nothing.
    pub powered: bool,
    listening: bool,
    talking: bool,
    polled: bool,
    attention: bool,
    ear: Ear,
    mouth: Mouth,
    pub answer: VecDeque<Mark>,
    pub endless: Option<u8>,
    pub commands: Vec<u8>,
    at: Time,
}

/// Its status byte.
pub const STATUS: u8 = 0x11;

impl Instrument {
    pub fn new(powered: bool) -> Instrument {
        Instrument {
            powered,
            listening: false,
            talking: false,
            polled: false,
            attention: false,
            ear: Ear::Off,
            mouth: Mouth::Off,
            answer: VecDeque::new(),
            endless: None,
            commands: Vec::new(),
            at: Time::MAX,
        }
    }

    pub fn next(&self) -> Time {
        self.at
    }

    pub fn listens(&self) -> bool {
        self.listening
    }

    pub fn notice(&mut self, now: Time, random: &mut Random) {
        if self.powered {
            self.at = self.at.min(now + between(random, 10, 150));
        }
    }

    pub fn wake(&mut self, now: Time, lines: Lines, ledger: &mut Ledger, random: &mut Random) {
        self.at = Time::MAX;
        if lines.has(Lines::IFC) {
            (self.listening, self.talking, self.polled) = (false, false, false);
        }
        let attention = lines.has(Lines::ATN);
        let risen = attention && !self.attention;
        self.attention = attention;
        self.speak(now, lines, ledger, random);
        self.hear(now, lines, risen, ledger, random);
    }

    fn alarm(&mut self, at: Time) {
        self.at = self.at.min(at);
    }

    fn speak(&mut self, now: Time, lines: Lines, ledger: &mut Ledger, random: &mut Random) {
        if !self.talking || self.attention {
            if let Mouth::Valid { byte, end } = self.mouth
                && !self.polled
            {
                ledger.sent((byte, end), true);
            }
            // a byte that only settled has not left
            if let Mouth::Settling { byte, end, .. } = self.mouth
                && !self.polled
            {
                self.answer.push_front((byte, end));
            }
            self.mouth = Mouth::Off;
            return;
        }
        match self.mouth {
            Mouth::Off | Mouth::Empty => {
                let first = self.mouth == Mouth::Off;
                let next = if self.polled {
                    Some((STATUS, false))
                } else {
                    self.answer.pop_front().or_else(|| count(&mut self.endless))
                };
                self.mouth = Mouth::Empty;
                if let Some((byte, end)) = next {
                    let until = now + between(random, if first { 1_100 } else { 500 }, 2_500);
                    self.mouth = Mouth::Settling { until, byte, end };
                    self.alarm(until);
                } else {
                    self.alarm(now + 1_000);
                }
            }
            Mouth::Settling { until, .. } if now < until => self.alarm(until),
            Mouth::Settling { byte, end, .. } if !lines.has(Lines::NRFD) && lines.has(Lines::NDAC) => {
                self.mouth = Mouth::Valid { byte, end }
            }
            Mouth::Valid { byte, end } if !lines.has(Lines::NDAC) => {
                if !self.polled {
                    ledger.sent((byte, end), false);
                }
                self.mouth = Mouth::Empty;
                self.alarm(now + between(random, 50, 2_000));
            }
            _ => {}
        }
    }

    fn hear(&mut self, now: Time, lines: Lines, risen: bool, ledger: &mut Ledger, random: &mut Random) {
        if !self.attention && !self.listening {
            self.ear = Ear::Off;
            return;
        }
        let valid = lines.has(Lines::DAV);
        self.ear = match self.ear {
            Ear::Off => Ear::Busy { until: now + between(random, 250, 1_000) },
            // what stands on the bus when ATN comes is not for it
            Ear::Ready if risen => Ear::Busy { until: now + 300 },
            Ear::Busy { until } if now >= until && !valid => Ear::Ready,
            Ear::Ready if valid => {
                if self.attention {
                    self.obey(lines.byte() & 0x7F);
                } else {
                    ledger.instrument.got.push((lines.byte(), lines.has(Lines::EOI)));
                }
                Ear::Taking { until: now + between(random, 20, 3_000) }
            }
            Ear::Taking { until } if now >= until && valid => Ear::Taken,
            Ear::Taking { .. } | Ear::Taken if !valid => Ear::Busy { until: now + between(random, 250, 3_000) },
            same => same,
        };
        if let Ear::Busy { until } | Ear::Taking { until } = self.ear {
            self.alarm(until.max(now + 50));
        }
    }

    fn obey(&mut self, code: u8) {
        self.commands.push(code);
        match code {
            0x18 => self.polled = true,
            0x19 => self.polled = false,
            0x3F => self.listening = false,
            _ if code == 0x20 | INSTRUMENT => (self.listening, self.talking) = (true, false),
            _ if code == 0x40 | INSTRUMENT => (self.listening, self.talking) = (false, true),
            0x40..=0x5F => self.talking = false,
            _ => {}
        }
    }

    pub fn pull(&self) -> Pull {
        let ear = match self.ear {
            Ear::Off => Lines::NONE,
            Ear::Busy { .. } | Ear::Taking { .. } => Lines::NRFD | Lines::NDAC,
            Ear::Ready => Lines::NDAC,
            Ear::Taken => Lines::NRFD,
        };
        let (mouth, valid) = match self.mouth {
            Mouth::Off | Mouth::Empty => (Lines::NONE, false),
            Mouth::Settling { byte, end, .. } => (Lines::of_byte(byte) | Lines::EOI.when(end), false),
            Mouth::Valid { byte, end } => (Lines::of_byte(byte) | Lines::EOI.when(end), true),
        };
        Pull { lines: ear | mouth | Lines::DAV.when(valid), drives_data: self.mouth != Mouth::Off }
    }
}
