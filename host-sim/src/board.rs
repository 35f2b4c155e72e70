//! The virtual board: both halves of the controller, the wires between them, the step output and the stage behind it.
//!
//! # Design
//! One [`Board::step`] is one segment of 256 us: the oldest segment plays, the ring is refilled, orders and reports
//! arrive. On the chip the front is a thread that the refill interrupt overtakes at any point; here a seeded
//! generator delays orders and reports by whole segments and lets the ring run low, so that every interleaving of
//! the two halves can come up, and does again with the same seed.

use crate::flash::{Flash, at_once};
use crate::machine::Machine;
use crate::twin::{Mechanics, Switches};
use stage_controller::controller::front::Front;
use stage_controller::refill::border::{Order, Orders, POWER_INPUTS, Report, Sample};
use stage_controller::refill::generator::Generator;
use stage_controller::refill::safety::{Cause, Halt, Inputs, Watch};
use stage_controller::stepgen::segment::Words;
use stage_controller::stepgen::timing::MAX_GRID;
use stage_controller::store::{Buffer, RECORD_CAPACITY, Store, service};
use stage_controller::units::{AXES, FineSteps, SEGMENT_TICKS};
use std::collections::VecDeque;

/// Segments that the board's ring holds.
pub const RING: usize = 4;
/// Longest time between a contact and the stop of the stream, ticks of 1 us.
pub const STOP_TICKS: u64 = 20;
/// The same of the emergency stop, which gates the timer in hardware.
pub const GATE_TICKS: u64 = 2;
/// Lines of all motors.
const ALL: u8 = (1 << AXES) - 1;

/// Small seeded generator (xorshift64*), for interleavings and simulated noise, not for secrets.
#[derive(Clone, Debug)]
pub struct Seeded(u64);

impl Seeded {
    /// From a seed; every seed works.
    pub fn new(seed: u64) -> Self {
        Seeded(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// The next 64 bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// A number below `n`.
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.next_u64()) * u128::from(n)) >> 64) as u64
    }
}

/// How the two halves interleave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interleaving {
    /// Orders and reports arrive with the next segment.
    Prompt,
    /// Orders and reports are late by up to this many segments, the ring runs low at random.
    Jittered(u64),
}

/// Orders that have arrived at the generator.
#[derive(Debug, Default)]
pub struct Queue(pub VecDeque<Order>);

impl Orders for Queue {
    fn peek(&self) -> Option<&Order> {
        self.0.front()
    }

    fn pop(&mut self) {
        self.0.pop_front();
    }
}

/// Factors of the words in their hash, from the same generator as [`Seeded`].
const FACTORS: [u32; SEGMENT_TICKS] = {
    let (mut factors, mut state, mut i) = ([0; SEGMENT_TICKS], 0x9E37_79B9_7F4A_7C15_u64, 0);
    while i < SEGMENT_TICKS {
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        factors[i] = (state.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32) as u32 | 1;
        i += 1;
    }
    factors
};

/// Multilinear hash of a segment: no product waits for another one.
fn multilinear(words: &[u32]) -> u64 {
    let products = words.iter().zip(&FACTORS).map(|(word, factor)| u64::from(*word) * u64::from(*factor));
    products.fold(words.len() as u64, u64::wrapping_add)
}

/// A segment that waits to be played.
struct Waiting {
    segment: u64,
    words: Words,
    motor: FineSteps,
}

/// Something that happens at the stage.
#[derive(Clone, Copy, Debug)]
enum Event {
    Stop(bool),
    Fault(u8, bool),
}

/// A stop of the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped {
    /// Why.
    pub halt: Halt,
    /// Ticks from the input to the last word.
    pub latency: u64,
}

/// What has just been played, for observers.
#[derive(Clone, Copy, Debug)]
pub struct Played<'a> {
    /// The segment.
    pub segment: u64,
    /// Its words, all or those up to an abort.
    pub words: &'a [u32],
    /// Unrounded motor positions at its end, overlay and one half included (not after an abort).
    pub motor: Option<FineSteps>,
}

/// A controller with its stage, in virtual time.
pub struct Board {
    /// The front half.
    pub front: Front,
    generator: Generator,
    twin: Mechanics,
    ring: VecDeque<Box<Waiting>>,
    /// Played segments, whose room is used again.
    spare: VecDeque<Box<Waiting>>,
    played: u64,
    orders: VecDeque<(u64, Order)>,
    arrived: Queue,
    reports: VecDeque<(u64, Report)>,
    samples: VecDeque<(u64, Sample)>,
    /// What the power inputs say, sums of conversions.
    power: [u16; POWER_INPUTS],
    now: u64,
    interleaving: Interleaving,
    seeded: Seeded,
    stop_after: Option<usize>,
    hash: u64,
    /// Where settings are kept.
    pub store: Store<Flash>,
    buffer: Box<Buffer>,
    switches: Switches,
    /// Contacts and latencies, apart from the interleaving.
    hazard: Seeded,
    /// Delays of samples, apart from both.
    light: Seeded,
    /// What happens at a tick of the next segment.
    events: Vec<(usize, Event)>,
    stop_open: bool,
    faults: u8,
    /// Lines whose limit switches, whose drivers are wired the other way round.
    inverted: (u8, u8),
    watch: Watch,
    /// The stream is about to stop: words that still play, and why.
    stopping: Option<(u64, Stopped)>,
    stopped: Option<Stopped>,
    halt: Halt,
    latched: bool,
}

impl Board {
    /// A board in front of a stage; `front` as it is after power-up.
    pub fn new(machine: &Machine, front: Front, interleaving: Interleaving, seed: u64) -> Self {
        let (law, timing) = front.generator_setup();
        Board {
            front,
            generator: Generator::new(law, timing),
            twin: Mechanics::new(machine, [false; 6]),
            ring: VecDeque::with_capacity(RING),
            spare: VecDeque::with_capacity(RING),
            played: 0,
            orders: VecDeque::new(),
            arrived: Queue::default(),
            reports: VecDeque::new(),
            samples: VecDeque::new(),
            power: [0; POWER_INPUTS],
            now: 0,
            interleaving,
            seeded: Seeded::new(seed),
            stop_after: None,
            hash: 0xcbf2_9ce4_8422_2325,
            store: Flash::blank().store(),
            buffer: Box::new([0; RECORD_CAPACITY]),
            switches: Switches::new(machine, seed),
            hazard: Seeded::new(seed ^ 0x5afe),
            light: Seeded::new(seed ^ 0x1147),
            events: Vec::new(),
            stop_open: false,
            faults: 0,
            inverted: (0, 0),
            watch: Watch::default(),
            stopping: None,
            stopped: None,
            halt: Halt::default(),
            latched: false,
        }
    }

    /// What the power inputs said at the border that was just reached, and say until they are told otherwise: sums of
    /// [`CONVERSIONS`](stage_controller::refill::border::CONVERSIONS) conversions.
    pub fn set_power(&mut self, power: [u16; POWER_INPUTS]) {
        self.power = power;
        if let Some((_, sample)) = self.samples.back_mut().filter(|(_, sample)| sample.played == self.played) {
            sample.power = power;
        }
    }

    /// The contact of the emergency stop opens or closes, at some tick of the next segment.
    pub fn press_stop(&mut self, open: bool) {
        self.happen(Event::Stop(open));
    }

    /// The driver of a motor reports a fault, or no longer, at some tick of the next segment.
    pub fn set_fault(&mut self, motor: usize, active: bool) {
        self.happen(Event::Fault(1 << motor, active));
    }

    fn happen(&mut self, event: Event) {
        let tick = self.hazard.below(SEGMENT_TICKS as u64) as usize;
        self.events.push((tick, event));
        self.events.sort_by_key(|(tick, _)| *tick);
    }

    /// Motors whose limit switches are normally open, and whose fault lines are active when high; bit n of motor n.
    pub fn rewire(&mut self, limits: u8, faults: u8) {
        self.inverted = (limits, faults);
    }

    /// The step output fails by itself, before the next segment plays.
    pub fn fail(&mut self, cause: Cause) {
        self.stopping = Some((0, Stopped { halt: Halt { cause, ..Halt::default() }, latency: 0 }));
    }

    /// Levels of the inputs. All are pulled up: a switch that is normally closed to ground is high when it is tripped.
    pub fn inputs(&self) -> Inputs {
        let [lower, upper] = self.switches.tripped();
        let (limits, faults) = self.inverted;
        Inputs {
            lower: lower ^ limits,
            upper: upper ^ limits,
            fault: self.faults ^ !faults & ALL,
            stop: self.stop_open,
        }
    }

    /// The last stop of the stream that the front had not asked for.
    pub fn last_stop(&self) -> Option<Stopped> {
        self.stopped
    }

    /// The stream stands until it is armed again.
    pub fn is_latched(&self) -> bool {
        self.latched
    }

    /// Something has happened at the stage that the front does not know yet.
    pub fn has_news(&self) -> bool {
        !self.events.is_empty() || self.stopping.is_some() || self.inputs() != self.front.report().inputs
    }

    /// One segment of virtual time; `observe` sees what is played.
    pub fn step(&mut self, mut observe: impl FnMut(Played<'_>)) {
        self.now += 1;
        if self.front.take_abort() {
            let any = self.seeded.below(SEGMENT_TICKS as u64 + 1) as usize;
            let tick = self.stop_after.unwrap_or(any).min(SEGMENT_TICKS);
            if let Some(waiting) = self.ring.pop_front() {
                self.twin.feed(&waiting.words[..tick]);
                self.stop(&waiting, tick, Halt::default(), &mut observe);
                self.spare.push_back(waiting);
            }
        }
        if self.latched {
            return self.stand();
        }
        if let Some(waiting) = self.ring.pop_front() {
            match self.feed(&waiting.words) {
                None => self.record(waiting.segment, &waiting.words, Some(waiting.motor), &mut observe),
                Some((tick, stopped)) => {
                    self.stopped = Some(stopped);
                    self.stop(&waiting, tick, stopped.halt, &mut observe);
                }
            }
            self.spare.push_back(waiting);
            if self.latched {
                return self.stand();
            }
        }
        let depth = match self.interleaving {
            Interleaving::Prompt => RING,
            // one segment always waits: less is an underrun, which is another test
            Interleaving::Jittered(_) => 1 + self.seeded.below(RING as u64) as usize,
        };
        while self.ring.len() < depth {
            self.refill();
        }
        self.carry();
        self.sample();
        // on the chip the stream stands meanwhile; here it takes no time
        at_once(service::serve(&mut self.store, &mut self.front, &mut self.buffer));
    }

    /// Steps until nothing is pending, at most `segments`; true when it came to rest.
    pub fn run(&mut self, segments: u64, mut observe: impl FnMut(Played<'_>)) -> bool {
        for _ in 0..segments {
            self.step(&mut observe);
            if !self.front.operation_pending() && self.orders.is_empty() && self.arrived.0.is_empty() {
                return true;
            }
        }
        false
    }

    /// [`Board::run`] for as long as it takes (up to six hours of virtual time), unobserved.
    pub fn settle(&mut self) -> bool {
        self.run(84_375_000, |_| ())
    }

    fn refill(&mut self) {
        self.arrive();
        let mut waiting = self.spare.pop_back().unwrap_or_else(|| {
            Box::new(Waiting { segment: 0, words: [0; SEGMENT_TICKS], motor: FineSteps::default() })
        });
        let report = self.generator.refill(&mut self.arrived, self.played, &mut waiting.words);
        waiting.motor = self.generator.motor_positions();
        waiting.segment = report.next - 1;
        self.ring.push_back(waiting);
        self.send(report);
    }

    /// Orders that have come down by now.
    fn arrive(&mut self) {
        while self.orders.front().is_some_and(|(due, _)| *due <= self.now) {
            self.arrived.0.extend(self.orders.pop_front().map(|(_, order)| order));
        }
    }

    /// A report on its way up.
    fn send(&mut self, report: Report) {
        let due = self.now + self.delay();
        let report = Report { halt: self.halt, inputs: self.inputs(), latched: self.latched, ..report };
        self.reports.push_back((due, report));
    }

    /// The power inputs are read at the border that was just reached; their sample goes up behind the next one.
    fn sample(&mut self) {
        let Report { played, counts, steps, taking_up, moving, .. } = self.generator.report(self.played);
        let late = match self.interleaving {
            Interleaving::Prompt => 0,
            Interleaving::Jittered(most) => self.light.below(most + 1),
        };
        let due = self.samples.back().map_or(0, |(due, _)| *due).max(self.now + 1 + late);
        self.samples.push_back((due, Sample { played, counts, steps, taking_up, moving, power: self.power }));
    }

    /// Reports and samples up, plans, orders down.
    fn carry(&mut self) {
        while self.reports.front().is_some_and(|(due, _)| *due <= self.now) {
            if let Some((_, report)) = self.reports.pop_front() {
                self.front.receive_report(report);
            }
        }
        while self.samples.front().is_some_and(|(due, _)| *due <= self.now) {
            if let Some((_, sample)) = self.samples.pop_front() {
                self.front.receive_sample(sample);
            }
        }
        self.front.plan();
        self.watch = self.front.watch();
        while let Some(order) = self.front.next_order() {
            let due = self.orders.back().map_or(0, |(due, _)| *due).max(self.now + self.delay());
            self.orders.push_back((due, order));
        }
    }

    fn delay(&mut self) -> u64 {
        match self.interleaving {
            Interleaving::Prompt => 0,
            Interleaving::Jittered(most) => self.seeded.below(most + 1),
        }
    }

    /// Plays the words of a segment; how many, and why, when the stream is stopped in it.
    fn feed(&mut self, words: &Words) -> Option<(usize, Stopped)> {
        let (up, down) = self.generator.stepping();
        let calm = self.events.is_empty() && self.stopping.is_none();
        if calm && self.is_far() && self.watch.halt(self.inputs(), up, down).is_none() {
            self.twin.feed(words);
            return None;
        }
        for (k, word) in words.iter().enumerate() {
            if let Some((0, stopped)) = self.stopping {
                self.stopping = None;
                return Some((k, stopped));
            }
            self.twin.feed(core::slice::from_ref(word));
            self.look(k);
            match &mut self.stopping {
                Some((left, _)) => *left -= 1,
                None => self.judge(up, down),
            }
        }
        None
    }

    fn is_far(&self) -> bool {
        self.switches.is_far(&self.twin.motors().0, self.twin.ticks())
    }

    /// What happens at a tick.
    fn look(&mut self, tick: usize) {
        while let Some((_, event)) = self.events.first().filter(|(at, _)| *at <= tick).copied() {
            self.events.remove(0);
            match event {
                Event::Stop(open) => self.stop_open = open,
                Event::Fault(motor, true) => self.faults |= motor,
                Event::Fault(motor, false) => self.faults &= !motor,
            }
        }
        self.switches.look(&self.twin.driven_steps(), self.twin.ticks());
    }

    /// The interrupt of the inputs: how long it takes is a matter of what else the processor does.
    fn judge(&mut self, up: u8, down: u8) {
        if let Some(halt) = self.watch.halt(self.inputs(), up, down) {
            let most = if halt.cause == Cause::EmergencyStop { GATE_TICKS } else { STOP_TICKS };
            let latency = self.hazard.below(most + 1);
            self.stopping = Some((latency, Stopped { halt, latency }));
        }
    }

    /// The stream stands: the generator takes orders, nothing plays.
    fn stand(&mut self) {
        self.look(SEGMENT_TICKS);
        if self.front.take_rearm() && !self.stop_open {
            self.latched = false;
        }
        self.arrive();
        let mut report = Report::default();
        self.generator.attend(&mut self.arrived, &mut report);
        self.played = report.played;
        self.send(report);
        self.carry();
    }

    /// The timer has stopped after `tick` words of a segment, which the stage has seen.
    fn stop(&mut self, waiting: &Waiting, tick: usize, halt: Halt, observe: &mut impl FnMut(Played<'_>)) {
        // the stream stands until the ring is filled anew: longer than any pulse, so that a line left high ends as one
        let mut words = waiting.words[..tick].to_vec();
        words.resize(tick + MAX_GRID as usize, 0);
        self.twin.feed(&words[tick..]);
        self.record(waiting.segment, &words, None, observe);
        self.generator.abort(waiting.segment, tick, &waiting.words);
        self.halt = halt;
        self.latched = halt.cause == Cause::EmergencyStop;
        self.stopping = None;
        self.ring.clear();
        self.reports.clear();
        self.samples.clear();
    }

    /// A segment has been played.
    fn record(&mut self, segment: u64, words: &[u32], motor: Option<FineSteps>, observe: &mut impl FnMut(Played<'_>)) {
        self.hash = (self.hash ^ multilinear(words)).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29);
        self.played = segment + 1;
        observe(Played { segment, words, motor });
    }

    /// From now on an immediate stop comes after this many words of the segment that then plays, and no longer after
    /// any number.
    pub fn stop_after(&mut self, words: usize) {
        self.stop_after = Some(words);
    }

    /// Hash of all words played so far.
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// Segments played, or cut short by an abort.
    pub fn played(&self) -> u64 {
        self.played
    }

    /// Virtual time in segments of 256 us.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// The stage behind the words.
    pub fn twin(&self) -> &Mechanics {
        &self.twin
    }

    /// The generator, for tests.
    pub fn generator(&self) -> &Generator {
        &self.generator
    }
}
