//! What holds for every trajectory: position, pulse timing, rate.
extern crate std;

use super::decoder::{Random, RateRule};
use super::{Bench, DRIVERS, LONG_RUN};
use crate::units::SEGMENT_TICKS;
use std::vec::Vec;

/// Position in Q32.32 steps times [`SEGMENT_TICKS`] at a tick of the segment.
fn exact(from: i64, advance: i64, tick: usize) -> i128 {
    i128::from(from) * SEGMENT_TICKS as i128 + i128::from(advance) * tick as i128
}

/// Whole steps of such a position.
fn whole(position: i128) -> i64 {
    (position >> (32 + SEGMENT_TICKS.ilog2())) as i64
}

/// Runs a motor one way; `advance` chooses the magnitude of each segment up to the reach of `rate`.
fn one_way(
    asks: super::MotorTiming,
    rate: u32,
    segments: u32,
    random: &mut Random,
    mut advance: impl FnMut(&mut Random, u64) -> u64,
) {
    let mut bench = Bench::new(asks, random);
    let grid = bench.timing.grid();
    let reach = Bench::reach(rate);
    let sign = if random.below(2) == 1 { 1 } else { -1 };
    bench.point(sign > 0);
    let mut rule = RateRule::new(rate, grid);
    for _ in 0..segments {
        let from = bench.position;
        let step = sign * advance(random, reach) as i64;
        bench.advance(step, |tick, count| {
            rule.judge(count);
            if grid == 1 {
                // Early by less than 2^-20 tick and 2^-32 step, late by nothing.
                let due = exact(from, step, tick + 1);
                let lead = i128::from(step) / (1 << 20) + i128::from(sign) * (SEGMENT_TICKS as i128 + 1);
                let (due, early) = (whole(due), whole(due + lead));
                assert!(count == due || count == early, "{count} {due} {early}");
            }
        });
        assert_eq!(bench.emitter.waiting(), 0);
    }
}

#[test]
fn steady_motion_is_on_time_and_within_its_rate() {
    let random = &mut Random(1);
    for asks in DRIVERS {
        let ceiling = Bench::new(asks, random).timing.max_step_rate();
        for rate in [
            1, 7, 999, 7_812, 7_813, 33_333, 100_000, 111_111, 142_857, 166_666, 200_000, 249_999, 250_000, 333_333,
            400_000, 498_047, 498_999, 499_000,
        ] {
            let rate = rate.min(ceiling);
            one_way(asks, rate, LONG_RUN / 20, random, |_, reach| reach);
        }
    }
}

#[test]
fn uneven_motion_one_way_is_on_time_and_within_its_rate() {
    let random = &mut Random(2);
    for run in 0..200 {
        let asks = DRIVERS[run % DRIVERS.len()];
        let ceiling = u64::from(Bench::new(asks, random).timing.max_step_rate());
        let rate = if run % 3 == 0 { ceiling } else { 1 + random.below(ceiling) };
        one_way(asks, rate as u32, LONG_RUN / 100, random, |random, reach| {
            let slow = random.below(40);
            match random.below(6) {
                0 => 0,
                1 => random.below(reach + 1),
                2 => random.below(reach + 1) >> slow,
                3 => (reach >> 32) << 32,
                _ => reach,
            }
        });
    }
}

#[test]
fn whole_steps_from_border_to_border_stay_inside_the_segment() {
    let random = &mut Random(3);
    for steps in 1..SEGMENT_TICKS as i64 / 2 {
        for sign in [1, -1] {
            let mut bench = Bench::new(DRIVERS[0], random);
            bench.position = 0;
            for _ in 0..50 {
                bench.advance((sign * steps) << 32, |_, _| ());
            }
            assert!(bench.emitter.waiting() == 0);
        }
    }
}

/// A random walk of the speed that turns no faster than one step in the time a turn takes.
fn walk(asks: super::MotorTiming, segments: u32, random: &mut Random) -> u32 {
    let mut bench = Bench::new(asks, random);
    let limit = Bench::reach(bench.timing.max_step_rate()) as i64;
    let turn = ((SEGMENT_TICKS as i64) << 32) / i64::from(bench.turn_ticks());
    let (mut speed, mut waits, mut run) = (0i64, 0, 0);
    let (mut pull, mut borders, mut sense, mut turned) = (0, 0, 0, 0);
    for _ in 0..segments {
        if run == 0 {
            run = 1 + random.below(60);
            let slow = random.below(34);
            pull = (random.below(2 * turn as u64) as i64 - turn) >> slow;
        }
        run -= 1;
        let mut next = (speed + pull).clamp(-limit, limit);
        if next.abs() <= turn && random.below(8) == 0 {
            next = -next;
        }
        // Slow until the first step the other way has had its time.
        let up = bench.emitter.dir() != bench.decoder.inverted;
        if next.signum() * sense == -1 || up != (sense > 0) {
            turned = 0;
        }
        if turned <= bench.turn_ticks() {
            next = next.clamp(-turn, turn);
        }
        speed = next;
        sense = if speed == 0 { sense } else { speed.signum() };
        turned += SEGMENT_TICKS as u32;
        let from = bench.position;
        let before = bench.emitter;
        let mut late = false;
        bench.advance(speed, |tick, count| {
            let due = whole(exact(from, speed, tick + 1));
            assert!((count - due).abs() <= 1, "{count} {due}");
            late |= (due - count) * speed.signum() > 0;
        });
        let waiting = bench.emitter.waiting();
        assert!(waiting.abs() <= 1);
        // One step period at the speed of the turn, seen from the borders.
        let after = bench.emitter;
        let stuck = (before.waiting(), before.emitted()) == (waiting, after.emitted());
        borders = if stuck && waiting != 0 { borders + 1 } else { 0 };
        assert!(borders <= bench.turn_ticks() / SEGMENT_TICKS as u32, "waits too long");
        waits += u32::from(late);
    }
    waits
}

#[test]
fn motors_that_turn_keep_their_position_and_timing() {
    let random = &mut Random(4);
    let waits: Vec<u32> = DRIVERS.iter().map(|&asks| walk(asks, LONG_RUN, random)).collect();
    // The run means little unless steps did wait. Set-up and hold fit into a segment: hardly ever across its border.
    assert!(waits.iter().all(|waits| *waits > 0), "{waits:?}");
}

#[test]
fn a_turn_at_any_phase_delays_one_step_by_less_than_its_period() {
    let random = &mut Random(5);
    for asks in DRIVERS {
        for phase in 1..=512 {
            let mut bench = Bench::new(asks, random);
            let speed = ((SEGMENT_TICKS as i64) << 32) / i64::from(bench.turn_ticks());
            bench.position = 0;
            bench.point(true);
            bench.advance(speed * phase / 512, |_, _| ());
            for way in [-1, 1, 1, -1, -1, -1, 0, 1] {
                let (from, way) = (bench.position, way * speed);
                bench.advance(way, |tick, count| {
                    let due = whole(exact(from, way, tick + 1));
                    assert!((count - due).abs() <= 1);
                });
                assert!(bench.emitter.waiting().abs() <= 1);
            }
            bench.advance(0, |_, _| ());
            assert_eq!(bench.emitter.waiting(), 0);
        }
    }
}

#[test]
fn impossible_motion_breaks_no_pulse_and_loses_no_step() {
    let random = &mut Random(6);
    for asks in DRIVERS {
        let mut bench = Bench::new(asks, random);
        for _ in 0..LONG_RUN / 10 {
            let slow = random.below(40);
            let advance = (random.next() as i64 >> 24) >> slow;
            if random.below(4) != 0 && bench.position.abs() < 1 << 45 {
                bench.advance(advance, |_, _| ());
            } else {
                let back = -bench.position / 64;
                bench.advance(back, |_, _| ());
            }
        }
        while bench.emitter.waiting() != 0 {
            bench.advance(0, |_, _| ());
        }
    }
}

#[test]
fn a_long_rest_is_forgotten_before_the_clock_wraps() {
    let random = &mut Random(7);
    let mut bench = Bench::new(DRIVERS[5], random);
    bench.position = 0;
    bench.advance(1 << 32, |_, _| ());
    bench.advance(1 << 32, |_, _| ());
    for _ in 0..1 << 5 {
        bench.base = bench.base.wrapping_add(1 << 27);
        bench.advance(0, |_, _| ());
    }
    bench.advance(1 << 32, |_, _| ());
    assert_eq!(bench.emitter.waiting(), 0);
}
