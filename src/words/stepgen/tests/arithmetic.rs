//! The crossing times against exact fractions, and the timing of drivers.
extern crate std;

use super::decoder::Random;
use super::{Bench, DRIVERS, LONG_RUN};
use crate::stepgen::crossing::Crossings;
use crate::stepgen::pins::{DIR_MASK, RESET_STEPS, STEP_MASK};
use crate::stepgen::segment::{Emitter, clear, place_all};
use crate::stepgen::timing::{MotorTiming, Timing};
use crate::units::{AXES, FineSteps, SEGMENT_TICKS};

/// 2^-20 tick in units of 2^-32 segment.
const EARLY: u128 = (1 << (32 - 20)) / SEGMENT_TICKS as u128;

/// Checks all steps of one segment; answers the largest error in 2^-32 step, as it would count at
/// 499 k steps/s: a slow segment may border on a fast one. Times are in units of 2^-32 segment.
fn check(from: i64, to: i64) -> u128 {
    let due = (to >> 32) as i32 - (from >> 32) as i32;
    let distance = u128::from((to - from).unsigned_abs());
    let before = if due > 0 { !from as u32 } else { from as u32 };
    let (mut worst, mut k, mut most) = (0, 0, 0);
    let last = Crossings::new(from, to, due).each(due.unsigned_abs(), |time| {
        // a time that left the segment would be early by as much
        let time = u128::from(time);
        let exact = (u128::from(before) + (k << 32)) << 32;
        assert!(time * distance <= exact, "late");
        let error = exact - time * distance;
        assert!(error < distance * EARLY, "early by 2^-20 tick");
        worst = worst.max(error * 499_000 * SEGMENT_TICKS as u128 / 1_000_000 / distance);
        (k, most) = (k + 1, time);
    });
    assert_eq!((k, most), (due.unsigned_abs().into(), last.into()));
    worst
}

#[test]
fn crossings_are_never_late_and_early_by_less_than_a_millionth_of_a_step() {
    let random = &mut Random(20);
    let fastest = Bench::reach(499_000);
    let mut worst = 0;
    for _ in 0..LONG_RUN {
        let slow = random.below(40);
        let advance = match random.below(4) {
            0 => random.below(fastest + 1),
            1 => fastest - random.below(1000),
            _ => random.below(fastest + 1) >> slow,
        } as i64;
        let from = match random.below(3) {
            0 => (random.next() as i64 >> 8) & -(1 << 32),
            1 => -((random.next() >> 50) as i64),
            _ => random.next() as i64 >> 8,
        };
        let to = if random.below(2) == 0 { from + advance } else { from - advance };
        if to >> 32 != from >> 32 {
            worst = worst.max(check(from, to));
        }
    }
    std::eprintln!("early by at most {:.1e} step", worst as f64 / (1u64 << 32) as f64);
    // 1e-6 step: why a rate limit of whole steps per second is kept to the letter.
    assert!(worst < (1u128 << 32) / 1_000_000, "{worst}");
}

#[test]
fn the_shortest_ways_over_a_step_are_in_time() {
    for length in 1..2_000i64 {
        for offset in 0..length.min(40) {
            for whole in [-5i64 << 32, 0, 7 << 32] {
                check(whole - 1 - offset, whole - 1 - offset + length);
                check(whole + offset, whole + offset - length);
            }
        }
    }
}

#[test]
fn timing_covers_what_drivers_ask_for() {
    let grids = DRIVERS.map(|asks| Timing::new([asks; AXES]).unwrap().grid());
    assert_eq!(grids, [1, 1, 2, 4, 8, 32]);
    let timing = Timing::new([MotorTiming::default(); AXES]).unwrap();
    assert_eq!(timing, Timing::default());
    assert_eq!((timing.setup_ticks(), timing.hold_ticks()), ([3; AXES], [3; AXES]));
    assert_eq!(timing.max_step_rate(), 499_000);
    let mut mixed = [MotorTiming::default(); AXES];
    mixed[4].low_ns = 3_001;
    assert_eq!(Timing::new(mixed).unwrap().grid(), 4);
    assert_eq!(Timing::new(mixed).unwrap().hold_ticks(), [4; AXES]);
    for wrong in [32_001, 1_000_000, u32::MAX] {
        mixed[4].low_ns = wrong;
        assert_eq!(Timing::new(mixed), None);
    }
    mixed[4] = MotorTiming { setup_ns: 128_000, hold_ns: 127_001, ..MotorTiming::default() };
    let timing = Timing::new(mixed).unwrap();
    assert_eq!((timing.setup_ticks()[4], timing.hold_ticks()[4]), (128, 128));
    mixed[4] = MotorTiming { setup_ns: 128_001, ..MotorTiming::default() };
    assert_eq!(Timing::new(mixed), None);
}

#[test]
fn a_cleared_segment_lowers_all_steps_on_the_grid_and_nothing_else() {
    for asks in DRIVERS {
        let timing = Timing::new([asks; AXES]).unwrap();
        let mut words = [0x1234_5678; SEGMENT_TICKS];
        clear(&mut words, &timing);
        for (tick, word) in words.into_iter().enumerate() {
            let on_grid = tick % timing.grid() as usize == 0;
            assert_eq!(word, if on_grid { RESET_STEPS } else { 0 });
        }
    }
}

#[test]
fn six_motors_share_the_words_without_disturbing_each_other() {
    let random = &mut Random(21);
    let timing = Timing::default();
    let mut together = [Emitter::default(); AXES];
    let mut alone = together;
    let mut from = FineSteps::default();
    for segment in 0..LONG_RUN / 50 {
        let base = segment * SEGMENT_TICKS as u32;
        let to = FineSteps(from.0.map(|m| m + (random.next() as i64 >> 26)));
        let mut words = [0; SEGMENT_TICKS];
        place_all(&mut together, &from, &to, base, &timing, &mut words);
        let mut union = [0; SEGMENT_TICKS];
        for (motor, emitter) in alone.iter_mut().enumerate() {
            let mut own = [0; SEGMENT_TICKS];
            clear(&mut own, &timing);
            let (from, to) = (from.0[motor], to.0[motor]);
            emitter.place::<false>(&timing.lines()[motor], from, to, base, &mut own);
            for (all, own) in union.iter_mut().zip(own) {
                *all |= own;
            }
        }
        assert_eq!(words, union);
        assert!(words.iter().all(|word| word & !(RESET_STEPS | STEP_MASK | (DIR_MASK * 0x1_0001)) == 0));
        from = to;
    }
    assert_eq!(together, alone);
}
