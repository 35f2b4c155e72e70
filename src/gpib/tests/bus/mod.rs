//! A bus of wired-or lines. Every party acts at moments of its own, so each order of the edges comes up.
//!
//! - [`board`]: the device under test behind its gates, run by firmware that is slow and uneven.
//! - [`instrument`]: another talker and listener, fast, written from the text of the standard and not from the device.
//! - [`controller`]: works off a script, and can lose patience at any moment.
//! - [`ledger`]: who sent what, who took what.
//! - [`watch`]: the rules that hold at every edge.
#![allow(dead_code)]

pub mod board;
pub mod controller;
pub mod instrument;
pub mod ledger;
pub mod watch;

use board::Board;
use controller::Controller;
use instrument::Instrument;
use ledger::Ledger;
use stage_gpib::lines::Lines;
use watch::Watch;

/// Nanoseconds.
pub type Time = u64;

/// Primary address of the device under test.
pub const DEVICE: u8 = 5;
/// Primary address of the other instrument.
pub const INSTRUMENT: u8 = 9;

/// Seeded numbers (splitmix64).
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }
}

/// A number from `least` to `most`.
pub fn between(random: &mut Random, least: Time, most: Time) -> Time {
    least + random.bits() % (most - least + 1)
}

/// True once in `n`.
pub fn once_in(random: &mut Random, n: u64) -> bool {
    random.bits().is_multiple_of(n)
}

/// What a party does to the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pull {
    /// Lines it makes true.
    pub lines: Lines,
    /// It holds the three-state drivers of DIO, DAV and EOI.
    pub drives_data: bool,
}

/// All parties on one bus.
pub struct Bench {
    pub now: Time,
    pub lines: Lines,
    pub board: Board,
    pub instrument: Instrument,
    pub controller: Controller,
    pub ledger: Ledger,
    pub watch: Watch,
    pub random: Random,
}

impl Bench {
    pub fn new(seed: u64, board: Board, instrument: Instrument) -> Bench {
        Bench {
            now: 0,
            lines: Lines::NONE,
            board,
            instrument,
            controller: Controller::new(),
            ledger: Ledger::default(),
            watch: Watch::default(),
            random: Random(seed),
        }
    }

    /// Lets the next party act.
    pub fn tick(&mut self) {
        let next = [self.board.next(), self.instrument.next(), self.controller.next()];
        let (who, at) = next.iter().enumerate().min_by_key(|(_, at)| **at).expect("three parties");
        assert!(*at >= self.now && *at != Time::MAX, "time goes on: {next:?} at {}", self.now);
        self.now = *at;
        match who {
            0 => self.board.wake(self.now, self.lines, &mut self.ledger, &mut self.random),
            1 => self.instrument.wake(self.now, self.lines, &mut self.ledger, &mut self.random),
            _ => self.controller.wake(self.now, self.lines, &mut self.ledger, &mut self.random),
        }
        self.settle();
    }

    fn settle(&mut self) {
        let pulls = [self.board.pull(), self.instrument.pull(), self.controller.pull()];
        let lines = pulls.iter().fold(Lines::NONE, |all, pull| all | pull.lines);
        self.watch.look(self.now, lines, pulls);
        if lines != self.lines {
            if lines.has(Lines::DAV) && !self.lines.has(Lines::DAV) && !lines.has(Lines::ATN) {
                self.ledger.listened = [self.board.listens(), self.instrument.listens(), self.controller.listens()];
            }
            self.board.notice(self.now, self.lines, lines, &mut self.random);
            self.instrument.notice(self.now, &mut self.random);
            self.controller.notice(self.now, &mut self.random);
            self.lines = lines;
        }
    }

    /// Runs until the controller has worked off its script.
    ///
    /// # Panics
    ///
    /// If that takes longer than any healthy bus does: it is wedged.
    pub fn finish(&mut self) {
        let limit = self.now + 200_000_000;
        while !self.controller.done() {
            self.tick();
            assert!(self.now < limit, "wedged: {}", self.describe());
        }
    }

    /// Lets everything come to rest.
    pub fn rest(&mut self, time: Time) {
        let until = self.now + time;
        while self.now < until {
            self.tick();
        }
    }

    /// Whether every byte is where it belongs and every time was kept.
    pub fn check(&self) {
        self.ledger.balance();
        assert!(self.watch.late.is_empty(), "{:?}", self.watch.late.first());
    }

    pub fn describe(&self) -> String {
        format!(
            "at {} ns lines {:?}\n board {:?}\n instrument {:?}\n controller {:?}",
            self.now, self.lines, self.board, self.instrument, self.controller
        )
    }
}
