//! Two whole controllers at addresses 5 and 6 and who controls them, on the sixteen lines of one GPIB.
//!
//! The bus, its gates and the one in control are those of the tests of `stage-gpib`; behind the pins are a real
//! message exchange, a real session and a real front half.
#![allow(dead_code)]

#[path = "../../../src/gpib/tests/bus/mod.rs"]
pub mod bus;

use bus::board::{Board as Pins, Firmware, Pace};
use bus::controller::{Abuse, Controller, Op, SDC, UNL, listen};
use bus::ledger::Ledger;
use bus::watch::Watch;
use bus::{Random, Time, once_in};
use host_sim::board::{Board, Interleaving};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::scpi::exchange::gpib::Interface;
use stage_controller::scpi::session::Session;
use stage_gpib::device::{Address, Device, Drive, Sample};
use stage_gpib::lines::Lines;
use stage_gpib::timing;

/// Time on the bus in which a segment of 256 us passes on the stages, ns: they are fast, so that the tests are.
const SEGMENT: Time = 20_000;
/// A healthy bus is through with anything that waits for no motion, ns.
const PATIENCE: Time = 200_000_000;
/// The firmware executes once in so many looks at least.
const LOOKS: u32 = 6;

/// A controller of a stage with its link to the bus.
pub struct Stage {
    pub board: Board,
    pub session: Session,
    pub interface: Interface,
    /// Time passes though nothing moves.
    pub runs: bool,
    segment_at: Time,
    looks: u32,
}

impl Stage {
    fn new(address: u8) -> Self {
        let machine = Machine::paper();
        let front = power_up(&machine, false).expect("a machine");
        let mut board = Board::new(&machine, front, Interleaving::Prompt, address.into());
        board.settle();
        let interface = Interface::new(Address::new(address).expect("an address"));
        Stage { board, session: Session::new(0), interface, runs: false, segment_at: 0, looks: 0 }
    }

    fn poll(&mut self) {
        let Stage { board, session, interface, .. } = self;
        interface.poll(session, |session, see| session.poll_message(&mut board.front, see));
    }

    pub fn moves(&self) -> bool {
        self.board.front.operation_pending()
    }
}

impl Firmware for Stage {
    fn device(&self) -> &Device {
        self.interface.functions()
    }

    fn look(&mut self, now: Time, sample: Sample, _: &mut Ledger, random: &mut Random) -> Drive {
        let step = self.interface.step(now, sample, &mut self.session);
        // the loop that executes is not the one that looks at the pins
        self.looks += 1;
        if step.event.is_some() && once_in(random, 2) || self.looks == LOOKS {
            self.looks = 0;
            self.poll();
        }
        if now >= self.segment_at {
            self.segment_at = now + SEGMENT;
            if self.runs || self.moves() || self.board.has_news() {
                self.board.step(|_| ());
                self.poll();
            }
        }
        step.drive
    }
}

/// Two stages and one controller on a bus.
pub struct Bench {
    pub now: Time,
    pub lines: Lines,
    pub stages: [Pins<Stage>; 2],
    pub controller: Controller,
    ledger: Ledger,
    watches: [Watch; 2],
    pub random: Random,
    /// The controller gives up when nothing has come for so long.
    time_out: Time,
    broke_off: bool,
}

/// Bytes with END on the last, or without.
pub fn marks(text: &[u8], end: bool) -> Vec<(u8, bool)> {
    text.iter().enumerate().map(|(at, byte)| (*byte, end && at + 1 == text.len())).collect()
}

impl Bench {
    pub fn new(seed: u64, pace: Pace) -> Self {
        let mut bench = Bench {
            now: 0,
            lines: Lines::NONE,
            stages: [5, 6].map(|address| Pins::with(Stage::new(address), pace)),
            controller: Controller::new(),
            ledger: Ledger::default(),
            watches: Default::default(),
            random: Random(seed),
            time_out: 20_000 + 100 * (200 + pace.answer + pace.pause),
            broke_off: false,
        };
        bench.controller.script.extend([Op::Remote(true), Op::Clear(timing::CLEAR_LENGTH)]);
        bench.finish();
        bench
    }

    pub fn stage(&mut self, address: u8) -> &mut Stage {
        &mut self.stages[usize::from(address - 5)].firmware
    }

    /// Lets the next party act.
    pub fn tick(&mut self) {
        let Bench { now, lines, stages, controller, ledger, random, .. } = self;
        let next = [stages[0].next(), stages[1].next(), controller.next()];
        let (who, at) = next.iter().enumerate().min_by_key(|(_, at)| **at).expect("three parties");
        assert!(*at >= *now && *at != Time::MAX, "time goes on");
        *now = *at;
        match who {
            2 => controller.wake(*now, *lines, ledger, random),
            board => stages[board].wake(*now, *lines, ledger, random),
        }
        self.settle();
    }

    fn settle(&mut self) {
        let [five, six, controller] = [self.stages[0].pull(), self.stages[1].pull(), self.controller.pull()];
        let lines = five.lines | six.lines | controller.lines;
        self.watches[0].look(self.now, lines, [five, six, controller]);
        self.watches[1].look(self.now, lines, [six, five, controller]);
        if lines != self.lines {
            for stage in &mut self.stages {
                stage.notice(self.now, self.lines, lines, &mut self.random);
            }
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
        let limit = self.now + PATIENCE;
        while !self.controller.done() {
            self.tick();
            assert!(self.now < limit, "wedged: {}", self.describe());
        }
    }

    /// Runs until something is so.
    pub fn until(&mut self, what: impl Fn(&mut Bench) -> bool) {
        let limit = self.now + PATIENCE;
        while !what(self) {
            self.tick();
            assert!(self.now < limit, "it never comes: {}", self.describe());
        }
    }

    /// Nothing moves any more.
    pub fn stand(&mut self) {
        self.until(|bench| bench.stages.iter().all(|stage| !stage.firmware.moves()));
    }

    pub fn rest(&mut self, time: Time) {
        let until = self.now + time;
        while self.now < until {
            self.tick();
        }
    }

    pub fn describe(&self) -> String {
        let states = self.stages.iter().map(|stage| format!("{:?}", stage.firmware.interface)).collect::<Vec<_>>();
        format!("at {} ns lines {:?}\n {states:#?}\n {:?}", self.now, self.lines, self.controller)
    }

    // ---- what a controller does ----

    /// Sends bytes, with END on the last or without.
    pub fn put(&mut self, to: u8, text: &[u8], end: bool) {
        self.controller.say(&[to], &marks(text, end));
        self.finish();
    }

    pub fn write(&mut self, to: u8, text: impl AsRef<[u8]>) {
        self.put(to, text.as_ref(), true);
    }

    /// Commands under ATN.
    pub fn command(&mut self, codes: &[u8]) {
        self.controller.command(codes);
        self.finish();
    }

    /// Reads up to END or so many bytes; gives up when nothing comes. With END: true.
    pub fn read(&mut self, from: u8, most: u32) -> (Vec<u8>, bool) {
        let before = self.ledger.controller.got.len();
        self.controller.read(from, &[], most);
        self.follow();
        self.got(before)
    }

    /// Works the script off as far as something goes on; then takes the bus back. So many parties acted.
    pub fn follow(&mut self) -> u64 {
        let (mut seen, mut since, mut edges) = (0, self.now, 0);
        while !self.controller.done() {
            self.tick();
            edges += 1;
            let now = self.heard() + self.controller.script.len();
            if now != seen || matches!(self.controller.script.front(), Some(Op::Pause(_) | Op::Clear(_))) {
                (seen, since) = (now, self.now);
            }
            if self.now > since + self.time_out {
                self.broke_off = self.controller.abused;
                self.seize();
                return edges;
            }
        }
        self.broke_off = self.controller.abused;
        self.calm();
        edges
    }

    /// The controller takes the bus at once, whatever is under way.
    pub fn seize(&mut self) {
        self.calm();
        self.controller.abuse = Some((0, Abuse::Seize));
        self.controller.notice(self.now, &mut self.random);
        self.until(|bench| bench.controller.abused);
        self.finish();
        self.calm();
    }

    /// In the last script that was followed the controller lost its patience.
    pub fn broke_off(&self) -> bool {
        self.broke_off
    }

    /// What the controller has lost its patience about is over.
    fn calm(&mut self) {
        (self.controller.abuse, self.controller.abused, self.controller.torn) = (None, false, false);
    }

    /// Bytes that were read so far, for [`Bench::got`].
    pub fn heard(&self) -> usize {
        self.ledger.controller.got.len()
    }

    /// What was read behind the first `before` bytes, and whether END came, as the last of them.
    pub fn got(&mut self, before: usize) -> (Vec<u8>, bool) {
        let got = &self.ledger.controller.got[before..];
        assert!(got.iter().rev().skip(1).all(|(_, end)| !end), "END before the last byte");
        (got.iter().map(|(byte, _)| *byte).collect(), got.last().is_some_and(|(_, end)| *end))
    }

    /// The answer up to END.
    pub fn answer(&mut self, from: u8) -> Option<String> {
        let (bytes, end) = self.read(from, 100_000);
        end.then(|| String::from_utf8_lossy(&bytes).into_owned())
    }

    pub fn ask(&mut self, of: u8, text: impl AsRef<[u8]>) -> String {
        self.write(of, text);
        self.answer(of).unwrap_or_else(|| panic!("no answer: {}", self.describe()))
    }

    /// Numbers of the queued errors.
    pub fn errors(&mut self, of: u8) -> Vec<i32> {
        let mut found = Vec::new();
        loop {
            let told = self.ask(of, "SYST:ERR?");
            match told.split(',').next().and_then(|number| number.parse().ok()) {
                Some(0) => return found,
                Some(number) => found.push(number),
                None => panic!("{told}"),
            }
        }
    }

    /// Serial poll.
    pub fn poll(&mut self, address: u8) -> u8 {
        self.controller.poll(address);
        self.finish();
        self.controller.statuses.pop().expect("a status byte")
    }

    pub fn requests_service(&self) -> bool {
        self.lines.has(Lines::SRQ)
    }

    /// Selected device clear.
    pub fn clear(&mut self, address: u8) {
        self.command(&[UNL, listen(address), SDC]);
    }

    /// IFC.
    pub fn interface_clear(&mut self) {
        self.controller.recover();
        self.finish();
    }

    /// The times of the standard were kept.
    pub fn check(&self) {
        for watch in &self.watches {
            assert!(watch.late.is_empty(), "{:?}", watch.late.first());
        }
    }
}
