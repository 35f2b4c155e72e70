//! Position compare: every pulse lies in the word in which the axis passes its position, and none plays twice.

use host_sim::board::{Queue, Seeded};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::controller::front::Front;
use stage_controller::error::ErrorNumber;
use stage_controller::refill::border::{Action, Compare, Report};
use stage_controller::refill::generator::Generator;
use stage_controller::stepgen::pins::{TRIGGER, reset};
use stage_controller::stepgen::segment::Words;
use stage_controller::units::{AXES, Axis, FinePose, SEGMENT_TICKS};
use std::collections::VecDeque;

/// A segment that waits to be played, and the pose at its borders.
struct Made {
    segment: u64,
    words: Words,
    from: FinePose,
    to: FinePose,
}

/// What the pulses are to be, found word by word from the poses alone.
#[derive(Default)]
struct Expected {
    compare: Compare,
    next: i128,
}

impl Expected {
    /// Whether a pulse belongs into word `tick` of a segment.
    fn pulse(&mut self, from: &FinePose, to: &FinePose, tick: usize) -> bool {
        if self.next >= i128::from(self.compare.count) {
            return false;
        }
        let axis = usize::from(self.compare.axis);
        let (from, to) = (i128::from(from.0[axis]), i128::from(to.0[axis]));
        let at = |tick: usize| from * SEGMENT_TICKS as i128 + (to - from) * tick as i128;
        let position = (i128::from(self.compare.start) + i128::from(self.compare.step) * self.next) << 32;
        let is_above = |at: i128| at >= position * SEGMENT_TICKS as i128;
        let passes = is_above(at(tick)) != is_above(at(tick + 1));
        self.next += i128::from(passes);
        passes
    }
}

/// Front and generator with the ring of the board between, and a listener at the trigger line.
struct Desk {
    front: Box<Front>,
    generator: Box<Generator>,
    orders: Queue,
    ring: VecDeque<Made>,
    expected: Expected,
    /// A new compare counts from the segment that is made when its order arrives.
    due: VecDeque<(u64, Compare)>,
    /// Where an abort met the axes on their way, until they move on.
    met: Option<FinePose>,
    played: u64,
    /// Words played, without the trigger's bits.
    steps: Vec<u32>,
    record: bool,
    pulses: u64,
    high: Option<usize>,
    tick: usize,
    last: Report,
}

const AHEAD: usize = 3;

impl Desk {
    fn new() -> Self {
        let front = Box::new(power_up(&Machine::paper(), false).unwrap());
        let (law, timing) = front.generator_setup();
        let mut desk = Desk {
            front,
            generator: Box::new(Generator::new(law, timing)),
            orders: Queue::default(),
            ring: VecDeque::new(),
            expected: Expected::default(),
            due: VecDeque::new(),
            met: None,
            played: 0,
            steps: Vec::new(),
            record: false,
            pulses: 0,
            high: None,
            tick: 0,
            last: Report::default(),
        };
        desk.run(20);
        desk
    }

    fn make(&mut self) {
        while self.ring.len() < AHEAD {
            let mut words = [0; SEGMENT_TICKS];
            let segment = self.generator.next_segment();
            let mut from = self.generator.pose();
            let before: Vec<Action> = self.orders.0.iter().map(|order| order.action).collect();
            self.last = self.generator.refill(&mut self.orders, self.played, &mut words);
            let taken = &before[..before.len() - self.orders.0.len()];
            let anchors = taken.iter().any(|action| matches!(action, Action::Anchor { .. } | Action::Law(_)));
            for action in taken {
                if let Action::Compare(compare) = action {
                    self.due.push_back((segment, *compare));
                }
            }
            let to = self.generator.pose();
            if anchors {
                // it stands elsewhere by name, not by a way
                from = to;
            }
            self.ring.push_back(Made { segment, words, from, to });
            self.front.receive_report(self.last);
        }
    }

    /// Plays the oldest segment, or some words of it, and looks at every one.
    fn play(&mut self, words: usize) -> Made {
        let mut made = self.ring.pop_front().unwrap();
        while self.due.front().is_some_and(|(segment, _)| *segment <= made.segment) {
            self.expected = Expected { compare: self.due.pop_front().unwrap().1, next: 0 };
            self.met = None;
        }
        if made.from != made.to {
            made.from = self.met.take().unwrap_or(made.from);
        }
        let width = self.front.generator_setup().1.grid() as usize;
        for (tick, word) in made.words[..words].iter().enumerate() {
            let expected = self.expected.pulse(&made.from, &made.to, tick);
            let axis = usize::from(self.expected.compare.axis);
            assert_eq!(
                word & TRIGGER != 0,
                expected,
                "word {tick} of segment {}: {:?}, pulse {}, from {} to {}",
                made.segment,
                self.expected.compare,
                self.expected.next,
                made.from.0[axis],
                made.to.0[axis]
            );
            if let Some(since) = self.high {
                let ends = word & (reset(TRIGGER) | TRIGGER) == reset(TRIGGER);
                assert_eq!(ends, self.tick - since >= width, "high for one grid");
            }
            if word & TRIGGER != 0 {
                assert_eq!(self.high.replace(self.tick), None, "each pulse begins from low");
                self.pulses += 1;
            } else if word & reset(TRIGGER) != 0 {
                self.high = None;
            }
            self.tick += 1;
            if self.record {
                self.steps.push(word & !(TRIGGER | reset(TRIGGER)));
            }
        }
        self.played = made.segment + 1;
        made
    }

    /// One segment; the motors are stopped after `stop` words of it.
    fn step(&mut self, stop: Option<usize>) {
        self.make();
        match stop {
            None => {
                self.play(SEGMENT_TICKS);
            }
            Some(words) => {
                let made = self.play(words);
                self.generator.abort(made.segment, words, &made.words);
                let at = |i: usize| {
                    made.from.0[i] + ((made.to.0[i] - made.from.0[i]) * words as i64).div_euclid(SEGMENT_TICKS as i64)
                };
                self.met = Some(FinePose(core::array::from_fn(at)));
                // an order that was taken counts, although its segment did not play
                if let Some((_, compare)) = self.due.drain(..).next_back() {
                    self.expected = Expected { compare, next: 0 };
                    self.met = None;
                }
                self.ring.clear();
                self.orders.0.clear();
                // the board waits for longer than a pulse, and the next word lowers the line
                self.high = self.high.map(|_| self.tick.wrapping_sub(self.front.generator_setup().1.grid() as usize));
            }
        }
        self.make();
        self.front.plan();
        while let Some(order) = self.front.next_order() {
            self.orders.0.push_back(order);
        }
    }

    fn run(&mut self, segments: usize) {
        for _ in 0..segments {
            self.step(None);
        }
    }

    /// Stops the motors at some word, as `!` does.
    fn abort(&mut self, words: usize) {
        self.front.abort();
        if self.front.take_abort() {
            self.step(Some(words));
        }
    }

    fn settle(&mut self) {
        for _ in 0..40_000 {
            if !self.front.operation_pending() && self.front.report().settled {
                return self.run(AHEAD + 2);
            }
            self.step(None);
        }
        panic!("it does not come to rest");
    }

    /// Pulses of so many microseconds, a power of two.
    fn set_grid(&mut self, us: u32) {
        let mut settings = *self.front.settings();
        settings.axes[0].timing.high_ns = us * 1_000;
        self.front.set_pulses(&settings).unwrap();
        self.settle();
        assert_eq!(self.front.generator_setup().1.grid(), us);
    }

    fn refused(&mut self, compare: Compare) -> Option<ErrorNumber> {
        self.front.set_compare(compare).err().map(|error| error.number)
    }
}

/// A compare around where the axis stands, coarse enough.
fn any_compare(desk: &Desk, random: &mut Seeded) -> Compare {
    let axis = random.below(AXES as u64) as usize;
    let range = [200, 2_000, 20_000][random.below(3) as usize];
    let start = desk.front.position().0[axis] + random.below(2 * range) as i32 - range as i32;
    let least = 2 * 2_000_000 * desk.front.generator_setup().1.grid() / 1_000_000;
    let coarse = [20, 100, 1_000][random.below(3) as usize];
    let step = least as i32 + random.below(coarse) as i32;
    let step = if random.below(2) == 0 { step } else { -step };
    Compare { axis: axis as u8, start, step, count: 1 + random.below(2_000) as u16 }
}

/// A move somewhere near of the axis that is compared, or of all.
fn any_move(desk: &mut Desk, random: &mut Seeded, axis: usize) {
    let target = |now: i32, random: &mut Seeded| i64::from(now) + random.below(60_000) as i64 - 30_000;
    let now = desk.front.commanded().0;
    let _ = if random.below(3) == 0 {
        let pose = core::array::from_fn(|i| target(now[i] / 2, random));
        desk.front.pose_absolute(pose)
    } else {
        let to = target(now[axis] / 2, random);
        desk.front.move_absolute(Axis::ALL[axis], to)
    };
}

fn volume() -> u64 {
    if cfg!(debug_assertions) { 300 } else { 3_000 }
}

#[test]
fn every_pulse_is_in_the_word_of_its_crossing_over_random_moves_both_ways_with_aborts_and_continuation() {
    let (mut pulses, mut aborts, mut again) = (0, 0, 0);
    for seed in 0..volume() {
        let mut random = Seeded::new(seed);
        let mut desk = Desk::new();
        desk.set_grid([1, 1, 2, 4, 8][random.below(5) as usize]);
        let mut axis = 0;
        for _ in 0..8 {
            if random.below(3) == 0 || desk.expected.compare.count == 0 {
                let compare = any_compare(&desk, &mut random);
                axis = usize::from(compare.axis);
                // refused where its end lies beyond what an axis may have, or its velocity is higher
                let _ = desk.refused(compare);
            }
            any_move(&mut desk, &mut random, axis);
            match random.below(3) {
                0 => {
                    let segments = 15 + random.below(60) as usize;
                    desk.run(segments);
                    let before = desk.generator.report(desk.generator.next_segment()).pulsed;
                    let words = random.below(SEGMENT_TICKS as u64 + 1) as usize;
                    desk.abort(words);
                    aborts += 1;
                    again += u64::from(desk.generator.report(desk.generator.next_segment()).pulsed < before);
                }
                1 => desk.run(random.below(400) as usize),
                _ => desk.settle(),
            }
        }
        desk.settle();
        assert_eq!(i128::from(desk.front.compare_pulses()), desk.expected.next, "seed {seed}");
        pulses += desk.pulses;
    }
    println!("figure: position compare: {pulses} pulses in their words, {aborts} aborts, {again} took pulses back");
    assert!(
        pulses > 100 * volume() && again > volume() / 30,
        "{pulses} pulses, {again} of {aborts} aborts took some back"
    );
}

#[test]
fn a_way_that_is_aborted_again_and_again_makes_each_pulse_of_a_dense_comb_once() {
    let (mut aborts, mut again) = (0, 0);
    for (seed, up) in (0..20).zip([true, false].into_iter().cycle()) {
        let mut random = Seeded::new(seed);
        let mut desk = Desk::new();
        let sign = if up { 1 } else { -1 };
        assert_eq!(desk.refused(Compare { axis: 1, start: sign * 100, step: sign * 20, count: 4_000 }), None);
        while desk.front.position().0[1] * sign < 79_000 {
            desk.front.move_absolute(Axis::Y, i64::from(sign) * 82_000).unwrap();
            desk.run(60 + random.below(60) as usize);
            let before = desk.generator.report(desk.generator.next_segment()).pulsed;
            desk.abort(random.below(SEGMENT_TICKS as u64 + 1) as usize);
            aborts += 1;
            again += u64::from(desk.generator.report(desk.generator.next_segment()).pulsed < before);
            desk.settle();
        }
        desk.front.move_absolute(Axis::Y, i64::from(sign) * 82_000).unwrap();
        desk.settle();
        // an abort stands on whole steps: what lies between is not lost
        assert_eq!((desk.pulses, desk.expected.next), (4_000, 4_000));
    }
    println!("figure: position compare: {again} of {aborts} aborts in a dense comb took pulses back");
    assert!(again > aborts / 2, "{again} of {aborts}");
}

#[test]
fn without_a_compare_there_is_no_pulse_and_with_one_no_step_is_another() {
    let play = |compare: bool| {
        let mut desk = Desk::new();
        desk.record = true;
        if compare {
            assert_eq!(desk.refused(Compare { axis: 0, start: 100, step: 40, count: 200 }), None);
        }
        // its order takes a segment
        desk.run(10);
        for target in [10_000, -12_000, 7_000] {
            desk.front.move_absolute(Axis::X, target).unwrap();
            desk.settle();
        }
        (desk.steps, desk.pulses)
    };
    let (plain, none) = play(false);
    let (with, pulses) = play(true);
    assert_eq!((none, pulses), (0, 200));
    assert!(plain.iter().filter(|word| **word & 0xffff != 0).count() > 500);
    assert_eq!(plain, with);
}

#[test]
fn pulses_come_in_order_and_wait_for_the_axis_to_turn_where_the_next_lies_behind() {
    let mut desk = Desk::new();
    // upwards over 2 um, then the next ones lie below
    assert_eq!(desk.refused(Compare { axis: 0, start: 2_000, step: -500, count: 4 }), None);
    for (target, pulses) in [(1_000, 0), (10_000, 1), (1_800, 1), (-10_000, 4), (10_000, 4)] {
        desk.front.move_absolute(Axis::X, target).unwrap();
        desk.settle();
        assert_eq!((desk.pulses, desk.front.compare_pulses()), (pulses, pulses as u16), "at {target}");
    }
}

#[test]
fn a_turn_on_the_very_position_is_one_crossing_and_not_three() {
    let mut desk = Desk::new();
    assert_eq!(desk.refused(Compare { axis: 0, start: 2_000, step: 1_000, count: 2 }), None);
    for (target, pulses) in [(2_000, 1), (0, 1), (2_000, 1), (2_999, 1), (3_000, 2)] {
        desk.front.move_absolute(Axis::X, target).unwrap();
        desk.settle();
        assert_eq!(desk.pulses, pulses, "at {target}");
    }
}

#[test]
fn steps_so_fine_that_pulses_would_merge_are_refused_and_the_least_step_that_is_not_keeps_them_apart() {
    let mut desk = Desk::new();
    let velocity = desk.front.settings().axes[0].velocity;
    let least = (2 * velocity).div_ceil(1_000_000) as i32;
    let compare = |step| Compare { axis: 0, start: 100, step, count: 1_000 };
    let before = desk.front.compare();
    for step in [0, 1, least - 1, 1 - least] {
        assert_eq!(desk.refused(compare(step)), Some(ErrorNumber::DataOutOfRange), "{step}");
    }
    assert_eq!(desk.refused(Compare { start: i32::MAX / 4, ..compare(10_000_000) }), Some(ErrorNumber::DataOutOfRange));
    assert_eq!(desk.front.compare(), before, "what is refused changes nothing");
    assert_eq!(desk.refused(compare(least)), None);
    desk.front.move_absolute(Axis::X, 1_000_000).unwrap();
    desk.settle();
    assert_eq!(desk.pulses, 1_000);
}

#[test]
fn a_compare_that_is_given_right_before_an_abort_is_in_force_behind_it_and_a_reset_ends_it() {
    let mut desk = Desk::new();
    desk.front.move_absolute(Axis::X, 50_000).unwrap();
    desk.run(100);
    let compare = Compare { axis: 0, start: desk.front.position().0[0] + 20_000, step: 0, count: 1 };
    assert_eq!(desk.refused(compare), None);
    desk.abort(77);
    desk.settle();
    assert_eq!((desk.front.compare(), desk.front.compare_pulses()), (compare, 0));
    desk.front.move_relative(Axis::X, 50_000).unwrap();
    desk.settle();
    assert_eq!((desk.pulses, desk.front.compare_pulses()), (1, 1));
    assert_eq!(desk.refused(compare), None);
    desk.front.reset();
    desk.settle();
    desk.front.move_relative(Axis::X, -50_000).unwrap();
    desk.settle();
    assert_eq!((desk.pulses, desk.front.compare().count), (1, 0));
}
