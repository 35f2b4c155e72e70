//! The stream against hardware that plays a ring, clears it one segment behind, and waits for nobody.

use host_sim::board::{Board, Interleaving, Queue, Seeded};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use host_sim::twin::Mechanics;
use stage_controller::controller::front::Front;
use stage_controller::refill::border::Report;
use stage_controller::refill::generator::Generator;
use stage_controller::refill::safety::{Cause, Halt, Inputs, Watch};
use stage_controller::refill::stream::{AHEAD, MARGIN, RING, StepSink, Stream, Wishes};
use stage_controller::stepgen::pins::{RESET_STEPS, STEP_MASK};
use stage_controller::stepgen::segment::Words;
use stage_controller::stepgen::timing::MAX_GRID;
use stage_controller::units::{AXES, MotorSteps, SEGMENT_TICKS};

const TICKS: u64 = SEGMENT_TICKS as u64;

/// Timer, two streams of DMA, and the pins.
struct Hardware {
    ring: [Words; RING],
    played: u64,
    running: bool,
    /// Every word that reached the pins.
    pins: Vec<u32>,
    inputs: Inputs,
}

impl Hardware {
    fn new() -> Self {
        let ring = [[0xdead_beef; SEGMENT_TICKS]; RING];
        Hardware { ring, played: 0, running: false, pins: Vec::new(), inputs: Inputs::default() }
    }

    fn word(&mut self, tick: u64) -> &mut u32 {
        let at = (tick % (RING as u64 * TICKS)) as usize;
        &mut self.ring[at / SEGMENT_TICKS][at % SEGMENT_TICKS]
    }

    fn play(&mut self, ticks: u64) {
        for _ in 0..ticks {
            if !self.running || self.inputs.stop {
                return;
            }
            let behind = self.played + (RING as u64 - 1) * TICKS;
            *self.word(behind) = RESET_STEPS;
            let word = *self.word(self.played);
            self.pins.push(word);
            self.played += 1;
        }
    }
}

impl StepSink for Hardware {
    fn played(&mut self) -> u64 {
        self.played
    }

    fn slot(&mut self, slot: usize) -> &mut Words {
        &mut self.ring[slot]
    }

    fn prepare(&mut self) {
        assert!(!self.running);
        // the pins stand for longer than any pulse
        self.pins.extend([0; MAX_GRID as usize]);
        self.pins.push(RESET_STEPS);
        self.ring = [[RESET_STEPS; SEGMENT_TICKS]; RING];
    }

    fn start(&mut self) {
        self.played = 0;
        self.running = true;
    }

    fn stop(&mut self) {
        self.running = false;
    }

    fn inputs(&mut self) -> Inputs {
        self.inputs
    }
}

/// Front, stream, hardware and stage.
struct Desk {
    front: Front,
    stream: Stream,
    hardware: Hardware,
    orders: Queue,
    twin: Mechanics,
    fed: usize,
    wishes: Wishes,
    last: Report,
    /// Causes of all halts, in order.
    causes: Vec<Cause>,
}

impl Desk {
    fn new() -> Self {
        let machine = Machine::paper();
        let front = power_up(&machine, false).unwrap();
        let (law, timing) = front.generator_setup();
        let mut desk = Desk {
            front,
            stream: Stream::new(Generator::new(law, timing)),
            hardware: Hardware::new(),
            orders: Queue::default(),
            twin: Mechanics::new(&machine, [false; AXES]),
            fed: 0,
            wishes: Wishes::default(),
            last: Report::default(),
            causes: Vec::new(),
        };
        desk.service(None);
        desk.settle();
        desk
    }

    fn service(&mut self, halt: Option<Halt>) {
        let mut report = self.last;
        self.stream.service(&mut self.hardware, &mut self.orders, Watch::default(), halt, self.wishes, &mut report);
        if report.aborts != self.last.aborts {
            self.causes.push(report.halt.cause);
        }
        self.last = report;
        self.front.receive_report(report);
        self.front.plan();
        if self.front.take_abort() {
            self.hardware.stop();
            return self.service(Some(Halt::default()));
        }
        while let Some(order) = self.front.next_order() {
            self.orders.0.push_back(order);
        }
        let new = &self.hardware.pins[self.fed..];
        self.twin.feed(new);
        self.fed = self.hardware.pins.len();
    }

    /// Plays to the next border, and `late` ticks more before the refill comes.
    fn segment(&mut self, late: u64) {
        let left = TICKS - self.hardware.played % TICKS;
        self.hardware.play(left + late);
        self.service(None);
    }

    fn settle(&mut self) {
        for _ in 0..1_000_000 {
            self.segment(0);
            if !self.front.operation_pending() && self.orders.0.is_empty() {
                return;
            }
        }
        panic!("it does not come to rest");
    }

    fn check(&mut self) {
        self.settle();
        assert_eq!(self.front.motor_counts(), self.twin.motors(), "counts are the edges at the pins");
    }

    fn pose(&mut self, target: [i64; AXES]) {
        self.front.pose_absolute(target).unwrap();
    }

    fn steps_of(&self, target: [i64; AXES]) -> MotorSteps {
        self.front.law().steps(stage_controller::units::Pose(target.map(|u| u as i32)))
    }
}

const THERE: [i64; AXES] = [400_000, -300_000, 200_000, 3_000_000, -2_000_000, 1_000_000];

#[test]
fn the_words_are_those_of_the_board_in_virtual_time() {
    let mut desk = Desk::new();
    desk.pose(THERE);
    desk.hardware.pins.clear();
    desk.fed = 0;
    desk.settle();
    let mut board = Board::new(&Machine::paper(), power_up(&Machine::paper(), false).unwrap(), Interleaving::Prompt, 1);
    board.settle();
    board.front.pose_absolute(THERE).unwrap();
    let mut words = Vec::new();
    assert!(board.run(1_000_000, |played| words.extend_from_slice(played.words)));
    let from_first_set_bit = |words: &[u32]| {
        let first = words.iter().position(|word| word & 0xffff != 0).expect("it moves");
        words[first / SEGMENT_TICKS * SEGMENT_TICKS..].to_vec()
    };
    let (ours, theirs) = (from_first_set_bit(&desk.hardware.pins), from_first_set_bit(&words));
    let length = ours.len().min(theirs.len());
    assert!(length > 128_000, "{length} words");
    assert!(ours[..length] == theirs[..length]);
    desk.check();
}

#[test]
fn a_late_refill_leaves_silence_and_an_exact_position() {
    let mut seeded = Seeded::new(7);
    for _ in 0..200 {
        let mut desk = Desk::new();
        desk.pose(THERE);
        for _ in 0..10 + seeded.below(200) {
            desk.segment(0);
        }
        let late = seeded.below(12 * TICKS);
        desk.segment(late);
        let missed = late > AHEAD * TICKS - MARGIN;
        let expected: &[Cause] = if missed { &[Cause::Deadline] } else { &[] };
        assert_eq!(desk.causes, expected, "{late} ticks late");
        desk.check();
        desk.pose(THERE);
        desk.check();
        assert_eq!(desk.front.report().steps, desk.steps_of(THERE), "the next move is exact");
    }
}

#[test]
fn at_rest_a_move_begins_with_the_next_segment_that_can_be_made_in_time() {
    let mut seeded = Seeded::new(13);
    let mut desk = Desk::new();
    for n in 0..200 {
        let target = if n % 2 == 0 { THERE } else { [0; AXES] };
        let rested = seeded.below(12);
        for _ in 0..rested {
            desk.segment(0);
        }
        let tick = seeded.below(TICKS);
        desk.hardware.play(tick);
        desk.pose(target);
        // the front plans after the first, the stream takes its order in the second
        desk.service(None);
        desk.service(None);
        let wait = desk.last.begun - desk.last.played;
        let next = if TICKS - tick > MARGIN { 1 } else { 2 };
        assert!(
            wait == next || rested < AHEAD && wait <= AHEAD + 1,
            "{wait} segments at tick {tick}, {rested} at rest"
        );
        desk.check();
        assert_eq!(desk.front.report().steps, desk.steps_of(target));
        assert_eq!(desk.causes, []);
    }
}

/// What may come between the order of a move and its answer, or soon after.
#[test]
fn whatever_comes_while_a_move_from_rest_begins_leaves_counts_and_the_next_move_exact() {
    let mut seeded = Seeded::new(17);
    let mut desk = Desk::new();
    let (mut halts, mut coarse) = (0, false);
    for n in 0..600 {
        let target = if n % 2 == 0 { THERE } else { [0; AXES] };
        for _ in 0..seeded.below(6) {
            desk.segment(0);
        }
        desk.hardware.play(seeded.below(TICKS));
        if n % 5 == 4 {
            // the pulses change, and the move follows in the same breath
            coarse = !coarse;
            let mut settings = *desk.front.settings();
            let ns = if coarse { 5_000 } else { 1_000 };
            settings.axes.iter_mut().for_each(|axis| (axis.timing.high_ns, axis.timing.low_ns) = (ns, ns));
            desk.front.set_pulses(&settings).unwrap();
            desk.service(None);
            desk.hardware.play(seeded.below(40));
            desk.service(None);
        }
        desk.pose(target);
        for _ in 0..seeded.below(4) {
            desk.service(None);
            desk.hardware.play(seeded.below(40));
        }
        match n % 4 {
            0 => {
                desk.hardware.play(seeded.below(3 * TICKS));
                desk.hardware.stop();
                let cause = if seeded.below(2) == 0 { Cause::Requested } else { Cause::Limit };
                desk.service(Some(Halt { cause, ..Halt::default() }));
                halts += 1;
            }
            1 => {
                desk.wishes.pause = true;
                desk.segment(0);
                desk.wishes.pause = false;
                desk.service(None);
            }
            2 => desk.segment(seeded.below(3 * TICKS)),
            _ => {}
        }
        desk.check();
        desk.pose(target);
        desk.check();
        assert_eq!(desk.front.report().steps, desk.steps_of(target), "{n}: the next move is exact");
    }
    assert_eq!(desk.causes.iter().filter(|cause| matches!(cause, Cause::Requested | Cause::Limit)).count(), halts);
    assert!(!desk.causes.contains(&Cause::Output), "no word came too late");
}

#[test]
fn a_refill_that_never_comes_leaves_silence() {
    let mut desk = Desk::new();
    desk.pose(THERE);
    for _ in 0..100 {
        desk.segment(0);
    }
    let before = desk.hardware.pins.len();
    desk.hardware.play(100 * TICKS);
    let silent_from = before + ((AHEAD + 1) * TICKS) as usize;
    assert!(desk.hardware.pins[before..].iter().any(|word| word & STEP_MASK != 0), "it was moving");
    assert!(desk.hardware.pins[silent_from..].iter().all(|word| word & STEP_MASK == 0), "no word plays twice");
}

#[test]
fn a_halt_at_any_tick_leaves_an_exact_position() {
    let mut seeded = Seeded::new(11);
    for n in 0..300 {
        let mut desk = Desk::new();
        desk.pose(THERE);
        for _ in 0..seeded.below(150) {
            desk.segment(0);
        }
        desk.hardware.play(seeded.below(TICKS + 1));
        desk.hardware.stop();
        // the refill may come long after the stop
        desk.hardware.play(seeded.below(1000));
        desk.service(Some(Halt { cause: Cause::Requested, ..Halt::default() }));
        assert_eq!(desk.causes, [Cause::Requested], "{n}");
        desk.check();
        desk.pose(THERE);
        desk.check();
        assert_eq!(desk.front.report().steps, desk.steps_of(THERE), "{n}: the next move is exact");
    }
}

#[test]
fn the_emergency_stop_is_silent_until_it_is_armed_again() {
    let mut desk = Desk::new();
    desk.pose(THERE);
    for _ in 0..50 {
        desk.segment(0);
    }
    desk.hardware.play(50);
    desk.hardware.inputs.stop = true;
    desk.hardware.stop();
    desk.service(Some(Halt { cause: Cause::EmergencyStop, ..Halt::default() }));
    assert!(desk.last.latched);
    desk.wishes.rearm = true;
    desk.service(None);
    assert!(desk.last.latched, "the contact is still open");
    desk.wishes.rearm = false;
    desk.hardware.inputs.stop = false;
    for _ in 0..10 {
        desk.service(None);
    }
    assert!(desk.last.latched && !desk.hardware.running, "closing the contact is not enough");
    desk.wishes.rearm = true;
    desk.service(None);
    assert!(!desk.last.latched && desk.hardware.running);
    desk.wishes.rearm = false;
    assert_eq!(desk.front.motor_counts(), desk.twin.motors());
}

#[test]
fn a_pause_plays_nothing_and_loses_nothing() {
    let mut desk = Desk::new();
    desk.pose(THERE);
    desk.check();
    desk.wishes.pause = true;
    desk.segment(0);
    assert!(!desk.stream.is_running());
    let before = desk.hardware.pins.len();
    desk.hardware.play(10_000);
    assert_eq!(desk.hardware.pins.len(), before);
    desk.wishes.pause = false;
    desk.service(None);
    assert!(desk.stream.is_running() && desk.causes.is_empty());
    desk.pose([0; AXES]);
    desk.check();
    assert_eq!(desk.front.report().steps, desk.steps_of([0; AXES]));
}
