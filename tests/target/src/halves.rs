//! Both halves of the controller, one link and a ring of four segments: no stage, no board, nothing allocated.
//!
//! # Design
//! One [`step`](Rig::step) is one segment, in this order: an immediate stop is carried out, the oldest segment of the
//! ring plays, the ring is refilled, reports go up, the front plans, orders go down, the link is served. Orders arrive
//! with the next refill. The large parts are borrowed, so that a program may keep them where it has room.

use crate::play::Rig;
use stage_controller::controller::front::{Front, ORDERS};
use stage_controller::controller::links::Links;
use stage_controller::refill::border::{Order, Orders};
use stage_controller::refill::generator::Generator;
use stage_controller::stepgen::segment::Words;
use stage_controller::units::{SEGMENT_NS, SEGMENT_TICKS};

/// Segments that the ring holds.
const RING: usize = 4;

/// What lies between the two halves: orders on their way, and segments that wait to be played.
#[derive(Default)]
pub struct Wires {
    orders: Queue,
    ring: heapless::Deque<(u64, Words), RING>,
}

/// A controller without a stage.
pub struct Halves<'a> {
    front: &'a mut Front,
    generator: &'a mut Generator,
    links: &'a mut Links<1>,
    wires: &'a mut Wires,
    link: usize,
    played: u64,
    now: u64,
    tick: usize,
}

#[derive(Default)]
struct Queue(heapless::Deque<Order, ORDERS>);

impl Orders for Queue {
    fn peek(&self) -> Option<&Order> {
        self.0.front()
    }

    fn pop(&mut self) {
        self.0.pop_front();
    }
}

impl<'a> Halves<'a> {
    /// As they are; a script begins with a power-up.
    pub fn new(
        front: &'a mut Front,
        generator: &'a mut Generator,
        links: &'a mut Links<1>,
        wires: &'a mut Wires,
    ) -> Self {
        Halves { front, generator, links, wires, link: 0, played: 0, now: 0, tick: 0 }
    }

    // The large parts are made one after the other, each in a function of its own: a stack of 64 KB has no room for both.

    #[inline(never)]
    fn renew_front(&mut self) {
        *self.front = Front::new();
    }

    #[inline(never)]
    fn renew_generator(&mut self) {
        let (law, timing) = self.front.generator_setup();
        *self.generator = Generator::new(law, timing);
    }

    fn now_ms(&self) -> u64 {
        self.now * SEGMENT_NS / 1_000_000
    }

    fn play(&mut self, segment: u64, words: &[u32], played: &mut impl FnMut(&[u32])) {
        self.played = segment + 1;
        played(words);
    }

    fn abort(&mut self, played: &mut impl FnMut(&[u32])) {
        let Some((segment, words)) = self.wires.ring.pop_front() else { return };
        self.play(segment, words.get(..self.tick).unwrap_or(&words), played);
        self.generator.abort(segment, self.tick, &words);
        self.wires.ring.clear();
    }

    fn refill(&mut self) {
        while !self.wires.ring.is_full() {
            let mut words = [0; SEGMENT_TICKS];
            let report = self.generator.refill(&mut self.wires.orders, self.played, &mut words);
            let _ = self.wires.ring.push_back((report.next - 1, words));
            self.front.receive_report(report);
        }
    }

    fn carry_orders(&mut self) {
        while !self.wires.orders.0.is_full() {
            let Some(order) = self.front.next_order() else { return };
            let _ = self.wires.orders.0.push_back(order);
        }
    }
}

impl Rig for Halves<'_> {
    fn power_up(&mut self, block: &[u8], cold: bool) -> bool {
        self.renew_front();
        let loaded = self.front.load(block).is_ok();
        if !cold {
            self.front.assume_homed();
        }
        self.renew_generator();
        *self.links = Links::new();
        self.link = self.links.open(0).unwrap_or_default();
        self.wires.orders.0.clear();
        self.wires.ring.clear();
        (self.played, self.now, self.tick) = (0, 0, 0);
        loaded
    }

    fn exchange(&mut self, bytes: &[u8], mut answered: impl FnMut(&[u8])) -> usize {
        let mut sent = 0;
        loop {
            let now_ms = self.now_ms();
            let taken = self.links.receive(self.link, bytes.get(sent..).unwrap_or_default(), now_ms);
            sent += taken;
            let mut progress = self.links.poll(self.front, now_ms) || taken != 0;
            let mut chunk = [0; 256];
            while let n @ 1.. = self.links.transmit(self.link, &mut chunk) {
                answered(chunk.get(..n).unwrap_or(&chunk));
                progress = true;
            }
            if !progress {
                return sent;
            }
        }
    }

    fn step(&mut self, mut played: impl FnMut(&[u32])) {
        self.now += 1;
        if self.front.take_abort() {
            self.abort(&mut played);
        }
        if let Some((segment, words)) = self.wires.ring.pop_front() {
            self.play(segment, &words, &mut played);
        }
        self.refill();
        self.front.plan();
        self.carry_orders();
        self.links.observe(self.front);
    }

    fn is_pending(&self) -> bool {
        self.front.operation_pending()
    }

    fn stop_after(&mut self, tick: usize) {
        self.tick = tick;
    }
}
