//! The virtual board: both halves of the controller, the wires between them, the step output and the stage behind it.
//!
//! # Design
//! One [`Board::step`] is one segment of 128 us: the oldest segment plays, the ring is refilled, orders and reports
//! arrive. On the chip the front is a thread that the refill interrupt overtakes at any point; here a seeded
//! generator delays orders and reports by whole segments and lets the ring run low, so that every interleaving of
//! the two halves can come up, and does again with the same seed.

use crate::machine::Machine;
use crate::twin::Mechanics;
use stage_controller::controller::border::{Order, Orders, Report};
use stage_controller::controller::front::Front;
use stage_controller::controller::generator::Generator;
use stage_controller::stepgen::segment::Words;
use stage_controller::stepgen::timing::MAX_GRID;
use stage_controller::units::{FineSteps, SEGMENT_TICKS};
use std::collections::VecDeque;

/// Segments that the board's ring holds.
pub const RING: usize = 4;

/// Small seeded generator (xorshift64*), for interleavings only.
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
    now: u64,
    interleaving: Interleaving,
    seeded: Seeded,
    stop_after: Option<usize>,
    hash: u64,
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
            now: 0,
            interleaving,
            seeded: Seeded::new(seed),
            stop_after: None,
            hash: 0xcbf2_9ce4_8422_2325,
        }
    }

    /// One segment of virtual time; `observe` sees what is played.
    pub fn step(&mut self, mut observe: impl FnMut(Played<'_>)) {
        self.now += 1;
        if self.front.take_abort() {
            self.abort(&mut observe);
        }
        if let Some(waiting) = self.ring.pop_front() {
            self.play(waiting.segment, &waiting.words, Some(waiting.motor), &mut observe);
            self.spare.push_back(waiting);
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

    /// [`Board::run`] for as long as it takes (up to three hours of virtual time), unobserved.
    pub fn settle(&mut self) -> bool {
        self.run(84_375_000, |_| ())
    }

    fn refill(&mut self) {
        while self.orders.front().is_some_and(|(due, _)| *due <= self.now) {
            self.arrived.0.extend(self.orders.pop_front().map(|(_, order)| order));
        }
        let mut waiting = self.spare.pop_back().unwrap_or_else(|| {
            Box::new(Waiting { segment: 0, words: [0; SEGMENT_TICKS], motor: FineSteps::default() })
        });
        let report = self.generator.refill(&mut self.arrived, self.played, &mut waiting.words);
        waiting.motor = self.generator.motor_positions();
        waiting.segment = report.next - 1;
        self.ring.push_back(waiting);
        let due = self.now + self.delay();
        self.reports.push_back((due, report));
    }

    /// Reports up, plans, orders down.
    fn carry(&mut self) {
        while self.reports.front().is_some_and(|(due, _)| *due <= self.now) {
            if let Some((_, report)) = self.reports.pop_front() {
                self.front.receive_report(report);
            }
        }
        self.front.plan();
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

    /// The timer stops after some words of the segment that would play now.
    fn abort(&mut self, observe: &mut impl FnMut(Played<'_>)) {
        let Some(waiting) = self.ring.pop_front() else { return };
        let any = self.seeded.below(SEGMENT_TICKS as u64 + 1) as usize;
        let tick = self.stop_after.unwrap_or(any).min(SEGMENT_TICKS);
        // the stream stands until the ring is filled anew: longer than any pulse, so that a line left high ends as one
        let mut words = waiting.words[..tick].to_vec();
        words.resize(tick + MAX_GRID as usize, 0);
        self.play(waiting.segment, &words, None, observe);
        self.generator.abort(waiting.segment, tick, &waiting.words);
        self.ring.clear();
        self.reports.clear();
    }

    fn play(&mut self, segment: u64, words: &[u32], motor: Option<FineSteps>, observe: &mut impl FnMut(Played<'_>)) {
        self.hash = (self.hash ^ multilinear(words)).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(29);
        self.twin.feed(words);
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

    /// Virtual time in segments of 128 us.
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
