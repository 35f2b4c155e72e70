//! A controller that works off a script.

use super::Random;
use super::ledger::{Ledger, Mark};
use super::{DEVICE, INSTRUMENT, Pull, Time, between};
use stage_gpib::lines::Lines;
use stage_gpib::timing;
use std::collections::VecDeque;

/// One thing a controller does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Op {
    /// ATN true when no byte is under way (tcs).
    Attention,
    /// ATN true at once (tca).
    Seize,
    /// ATN false.
    StandBy,
    Command(u8),
    Say(u8, bool),
    /// Takes bytes until EOI or so many.
    Listen(u32),
    /// Takes one byte of a serial poll.
    TakeStatus,
    /// EOI beside ATN; notes what DIO carries.
    ParallelPoll,
    Clear(Time),
    Remote(bool),
    Pause(Time),
}

/// What a controller told everybody.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Said {
    Command(u8),
    Clear,
    Remote(bool),
}

/// How a controller loses patience.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Abuse {
    /// IFC in the middle.
    Clear,
    /// ATN in the middle, then unaddresses everybody.
    Seize,
    /// ATN true and false again without a word, for so long; then it goes on.
    Blip(Time),
    /// Stops dead for so long, then IFC.
    HangUp(Time),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Start,
    Settling { until: Time },
    Valid,
    Release,
    Until(Time),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Ear {
    Busy { until: Time },
    Ready,
    Taking { until: Time },
    Taken,
}

#[derive(Debug)]
pub struct Controller {
    pub script: VecDeque<Op>,
    phase: Phase,
    ear: Option<Ear>,
    left: u32,
    pull: Lines,
    drives: bool,
    attention_at: Time,
    first: bool,
    at: Time,
    /// Wakes that are left before it loses patience.
    pub abuse: Option<(u64, Abuse)>,
    pub abused: bool,
    pub statuses: Vec<u8>,
    pub parallel: Vec<u8>,
    /// What everybody was told.
    pub said: Vec<Said>,
    /// A command was cut: nobody knows who took it.
    pub torn: bool,
    blip: Option<Time>,
}

pub const GTL: u8 = 0x01;
pub const SDC: u8 = 0x04;
pub const PPC: u8 = 0x05;
pub const GET: u8 = 0x08;
pub const TCT: u8 = 0x09;
pub const LLO: u8 = 0x11;
pub const DCL: u8 = 0x14;
pub const PPU: u8 = 0x15;
pub const SPE: u8 = 0x18;
pub const SPD: u8 = 0x19;
pub const UNL: u8 = 0x3F;
pub const UNT: u8 = 0x5F;

pub const fn listen(address: u8) -> u8 {
    0x20 | address
}

pub const fn talk(address: u8) -> u8 {
    0x40 | address
}

impl Controller {
    pub fn new() -> Controller {
        Controller {
            script: VecDeque::new(),
            phase: Phase::Start,
            ear: None,
            left: 0,
            pull: Lines::NONE,
            drives: false,
            attention_at: 0,
            first: true,
            at: 50,
            abuse: None,
            abused: false,
            statuses: Vec::new(),
            parallel: Vec::new(),
            said: Vec::new(),
            torn: false,
            blip: None,
        }
    }

    pub fn next(&self) -> Time {
        self.at
    }

    pub fn done(&self) -> bool {
        self.script.is_empty() && self.blip.is_none()
    }

    /// Whether it shakes hands as a listener.
    pub fn listens(&self) -> bool {
        self.ear.is_some()
    }

    pub fn notice(&mut self, now: Time, random: &mut Random) {
        self.at = self.at.min(now + between(random, 10, 150));
    }

    pub fn wake(&mut self, now: Time, lines: Lines, ledger: &mut Ledger, random: &mut Random) {
        self.at = Time::MAX;
        if let Some(until) = self.blip {
            if now < until {
                self.at = until;
                return;
            }
            self.blip = None;
            self.attend(now, false);
            self.at = now + 50;
            return;
        }
        if let Some((wakes, abuse)) = self.abuse {
            self.abuse = wakes.checked_sub(1).map(|left| (left, abuse));
            if self.abuse.is_none() {
                self.lose_patience(now, abuse, ledger);
                if self.blip.is_some() {
                    return;
                }
            }
        }
        self.listen(now, lines, ledger, random);
        if let Some(op) = self.script.front().copied() {
            if self.work(op, now, lines, ledger, random) {
                self.script.pop_front();
                self.phase = Phase::Start;
                self.at = self.at.min(now + between(random, 20, 500));
            }
        } else {
            self.at = self.at.min(now + 1_000);
        }
    }

    fn lose_patience(&mut self, now: Time, abuse: Abuse, ledger: &mut Ledger) {
        self.abused = true;
        // a byte that is under way stays open
        let valid = self.phase == Phase::Valid;
        match self.script.front() {
            Some(Op::Say(byte, end)) if valid => ledger.sent((*byte, *end), true),
            Some(Op::Command(_)) if valid => self.torn = true,
            _ => {}
        }
        let attention = self.pull.has(Lines::ATN);
        if let Abuse::Blip(length) = abuse {
            // without a word: under ATN there is nothing to blip
            if !attention {
                if let Some(Op::Say(..)) = self.script.front() {
                    // the byte that was cut is not said again
                    if valid {
                        self.script.pop_front();
                    }
                    self.phase = Phase::Start;
                }
                self.quiet();
                self.attend(now, true);
                self.blip = Some(now + length);
                self.at = now + length;
            } else if valid {
                self.torn = false;
            }
            return;
        }
        self.script.clear();
        match abuse {
            Abuse::Clear => self.script.push_back(Op::Clear(timing::CLEAR_LENGTH)),
            Abuse::Seize => self.script.extend([Op::Seize, Op::Command(UNL), Op::Command(UNT), Op::Command(SPD)]),
            Abuse::HangUp(time) => self.script.extend([Op::Pause(time), Op::Clear(timing::CLEAR_LENGTH)]),
            Abuse::Blip(_) => {}
        }
        self.phase = Phase::Start;
        if !matches!(abuse, Abuse::HangUp(_)) {
            self.ear = None;
            self.quiet();
        }
    }

    /// Takes its hands off the data lines.
    fn quiet(&mut self) {
        self.pull = self.pull.only(Lines::ATN | Lines::IFC | Lines::REN);
        self.drives = false;
    }

    fn attend(&mut self, now: Time, attention: bool) {
        self.pull = self.pull.only(Lines::IFC | Lines::REN) | Lines::ATN.when(attention);
        self.drives = false;
        self.first = true;
        self.attention_at = now;
    }

    fn put(&mut self, data: Lines) {
        self.pull = self.pull.only(Lines::ATN | Lines::IFC | Lines::REN) | data;
        self.drives = true;
    }

    fn alarm(&mut self, at: Time) {
        self.at = self.at.min(at);
    }

    /// True when `op` is done.
    fn work(&mut self, op: Op, now: Time, lines: Lines, ledger: &mut Ledger, random: &mut Random) -> bool {
        match op {
            Op::Attention => {
                // its own acceptor handshake stands between two bytes
                let free = match self.ear {
                    None => !lines.has(Lines::DAV),
                    Some(Ear::Busy { .. }) => !lines.has(Lines::DAV),
                    _ => false,
                };
                if free {
                    self.ear = None;
                    self.attend(now, true);
                }
                free
            }
            Op::Seize => {
                if !self.pull.has(Lines::ATN) {
                    self.attend(now, true);
                }
                self.ear = None;
                true
            }
            Op::StandBy => {
                self.attend(now, false);
                true
            }
            Op::Command(byte) => {
                let from = self.attention_at + timing::TALKER_LEAVES;
                let done = self.source((byte, false), from, now, lines, random);
                if done {
                    self.said.push(Said::Command(byte));
                }
                done
            }
            Op::Say(byte, end) => {
                let done = self.source((byte, end), now, now, lines, random);
                if done {
                    ledger.sent((byte, end), false);
                }
                done
            }
            Op::Listen(bytes) => {
                if self.phase == Phase::Start {
                    self.phase = Phase::Valid;
                    self.left = bytes;
                    self.ear = Some(self.ear.unwrap_or(Ear::Busy { until: now + 200 }));
                    self.alarm(now + 200);
                }
                self.left == 0 && matches!(self.ear, Some(Ear::Busy { .. }))
            }
            Op::TakeStatus => {
                if self.phase == Phase::Start {
                    self.phase = Phase::Valid;
                    self.left = 1;
                    self.ear = Some(Ear::Busy { until: now + 200 });
                    self.alarm(now + 200);
                }
                self.left == 0 && matches!(self.ear, Some(Ear::Busy { .. }))
            }
            Op::ParallelPoll => match self.phase {
                Phase::Until(until) if now >= until => {
                    self.parallel.push(lines.byte());
                    self.pull = self.pull.only(Lines::ATN | Lines::IFC | Lines::REN);
                    self.attention_at = now + timing::POLL_RECOVERY;
                    true
                }
                Phase::Until(until) => {
                    self.alarm(until);
                    false
                }
                _ => {
                    self.pull |= Lines::EOI;
                    self.phase = Phase::Until(now + timing::POLL_EXECUTION);
                    self.alarm(now + timing::POLL_EXECUTION);
                    false
                }
            },
            Op::Clear(length) => match self.phase {
                Phase::Until(until) if now >= until => {
                    self.pull = self.pull.only(Lines::ATN | Lines::REN);
                    true
                }
                Phase::Until(until) => {
                    self.alarm(until);
                    false
                }
                _ => {
                    // IFC leaves the controller in charge, with ATN false
                    self.ear = None;
                    self.pull = self.pull.only(Lines::REN) | Lines::IFC;
                    self.drives = false;
                    self.said.push(Said::Clear);
                    self.phase = Phase::Until(now + length);
                    self.alarm(now + length);
                    false
                }
            },
            Op::Remote(on) => {
                self.said.push(Said::Remote(on));
                let rest = Lines::from_bits(!Lines::REN.bits());
                self.pull = self.pull.only(rest) | Lines::REN.when(on);
                true
            }
            Op::Pause(time) => match self.phase {
                Phase::Until(until) if now >= until => true,
                Phase::Until(until) => {
                    self.alarm(until);
                    false
                }
                _ => {
                    self.phase = Phase::Until(now + time);
                    self.alarm(now + time);
                    false
                }
            },
        }
    }

    fn source(&mut self, mark: Mark, from: Time, now: Time, lines: Lines, random: &mut Random) -> bool {
        let data = Lines::of_byte(mark.0) | Lines::EOI.when(mark.1);
        match self.phase {
            Phase::Start if now < from => self.alarm(from),
            Phase::Start => {
                let least = if self.first { timing::SETTLE_FIRST } else { timing::SETTLE_NEXT };
                let until = now + between(random, least, 2_500);
                self.put(data);
                self.phase = Phase::Settling { until };
                self.alarm(until);
            }
            Phase::Settling { until } if now < until => self.alarm(until),
            Phase::Settling { .. } if !lines.has(Lines::NRFD) => {
                self.first = false;
                self.put(data | Lines::DAV);
                self.phase = Phase::Valid;
                self.alarm(now + 100);
            }
            Phase::Valid if !lines.has(Lines::NDAC) => {
                self.quiet();
                return true;
            }
            _ => {}
        }
        false
    }

    fn listen(&mut self, now: Time, lines: Lines, ledger: &mut Ledger, random: &mut Random) {
        let hung = matches!(self.script.front(), Some(Op::Pause(_))) && self.abused;
        let Some(ear) = self.ear else { return };
        if hung || matches!(self.script.front(), Some(Op::Clear(_))) {
            return;
        }
        let valid = lines.has(Lines::DAV);
        let attention = self.pull.has(Lines::ATN);
        let next = match ear {
            Ear::Busy { until } if now >= until && !valid && self.left > 0 && !attention => Ear::Ready,
            Ear::Ready if valid && !attention => {
                let mark = (lines.byte(), lines.has(Lines::EOI));
                if matches!(self.script.front(), Some(Op::TakeStatus)) {
                    self.statuses.push(mark.0);
                } else {
                    ledger.controller.got.push(mark);
                }
                self.left = if mark.1 { 0 } else { self.left.saturating_sub(1) };
                Ear::Taking { until: now + between(random, 20, 3_000) }
            }
            Ear::Taking { until } if now >= until && valid => Ear::Taken,
            Ear::Taking { .. } | Ear::Taken if !valid => Ear::Busy { until: now + between(random, 50, 3_000) },
            same => same,
        };
        if let Ear::Busy { until } | Ear::Taking { until } = next {
            self.alarm(until.max(now + 50));
        }
        self.ear = Some(next);
    }

    pub fn pull(&self) -> Pull {
        let ear = match self.ear {
            None => Lines::NONE,
            Some(Ear::Busy { .. } | Ear::Taking { .. }) => Lines::NRFD | Lines::NDAC,
            Some(Ear::Ready) => Lines::NDAC,
            Some(Ear::Taken) => Lines::NRFD,
        };
        Pull { lines: self.pull | ear, drives_data: self.drives }
    }

    // ---- scripts ----

    pub fn say(&mut self, to: &[u8], text: &[Mark]) {
        self.script.extend([Op::Attention, Op::Command(UNL), Op::Command(UNT)]);
        self.script.extend(to.iter().map(|address| Op::Command(listen(*address))));
        self.script.push_back(Op::StandBy);
        self.script.extend(text.iter().map(|(byte, end)| Op::Say(*byte, *end)));
    }

    pub fn read(&mut self, from: u8, also: &[u8], bytes: u32) {
        self.script.extend([Op::Attention, Op::Command(UNL)]);
        self.script.extend(also.iter().map(|address| Op::Command(listen(*address))));
        self.script.extend([Op::Command(talk(from)), Op::StandBy, Op::Listen(bytes)]);
    }

    pub fn poll(&mut self, address: u8) {
        self.script.extend([Op::Attention, Op::Command(UNL), Op::Command(SPE), Op::Command(talk(address))]);
        self.script.extend([Op::StandBy, Op::TakeStatus, Op::Attention, Op::Command(SPD), Op::Command(UNT)]);
    }

    pub fn command(&mut self, codes: &[u8]) {
        self.script.push_back(Op::Attention);
        self.script.extend(codes.iter().map(|code| Op::Command(*code)));
    }

    /// Back to a known bus.
    pub fn recover(&mut self) {
        self.script.push_back(Op::Clear(timing::CLEAR_LENGTH));
    }
}

/// The two talkers a controller can call.
pub const TALKERS: [u8; 2] = [DEVICE, INSTRUMENT];
