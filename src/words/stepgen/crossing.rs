//! When a motor on a straight line passes whole steps.
//!
//! Time inside a segment is a `u32` whose range is the segment, Q8.24 ticks: it cannot leave the segment and `time >>
//! FRACTION_BITS` is the tick. Upwards a step falls due when the floor of the position rises, downwards when it falls:
//! after the distance `k + 1 - frac` and `k + frac + 2^-32` for the k-th (k = 0, 1, …). Steps are put one unit of 2^-32
//! step before their crossing; then the last one lies inside the segment even if the motor arrives exactly on a whole
//! step, and both directions read alike.
//!
//! # Accuracy
//! Every time is rounded down: late by nothing, early by less than 2^-20 tick (and the 2^-32 step
//! above), and at a rate v the errors stay below 1e-6/v ticks. At a rate limit of *whole steps per
//! second* two steps that are due N ticks apart or more therefore never fall into N consecutive
//! ticks, and at most v N + 1 steps do (tested). Any other limit holds with N + 2^-20 for N.
//! A period carries another 32 bits, because a segment holds up to 127 of them: cut off, they would
//! add up to four times what 499,000 steps per second leave room for.
//! The division is two 16-bit digits, or one with a third-order correction: no 64-bit division,
//! which a Cortex-M4 does not have.

use crate::units::SEGMENT_TICKS;

/// Fractional bits of a time in ticks.
pub(super) const FRACTION_BITS: u32 = 32 - SEGMENT_TICKS.ilog2();

/// Bits of a way in Q32 steps that leaves at least two ticks to a step.
const MOST_BITS: u32 = 32 + SEGMENT_TICKS.ilog2() - 1;

// A time has the range of a segment, and `several` divides by no more.
const _: () = assert!(SEGMENT_TICKS.is_power_of_two() && MOST_BITS <= 39);

/// The steps of one motor in one segment, equally spaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Crossings {
    /// Time of the first step.
    pub(super) first: u32,
    /// Time from step to step with 32 bits more, `u64::MAX` for a lone step.
    pub(super) period: u64,
}

impl Crossings {
    /// All steps at once: what waits, or motion faster than any timing allows.
    pub(super) const AT_ONCE: Crossings = Crossings { first: 0, period: 0 };

    /// The steps on the way between two positions in Q32.32 steps; `due`, not zero, is the
    /// difference of their floors.
    #[inline(always)]
    pub(super) fn new(from: i64, to: i64, due: i32) -> Crossings {
        let down = due >> 31;
        let distance = ((to.wrapping_sub(from) ^ i64::from(down)).wrapping_sub(down.into())) as u64;
        let before = from as u32 ^ !down as u32;
        if due.wrapping_abs() == 1 { lone(before, distance) } else { several(before, distance) }
    }

    /// Calls `put` with the time of each of the `count` steps; answers the time of the last.
    #[inline(always)]
    pub(super) fn each(self, count: u32, mut put: impl FnMut(u32)) -> u32 {
        let Crossings { first: mut last, period } = self;
        let mut time = u64::from(last) << 32;
        if count & 1 != 0 {
            put(last);
            time = time.wrapping_add(period);
        }
        // Times within a group are the sum of two that were rounded down: early by a unit more, never late.
        if count & 2 != 0 {
            let first = whole(time);
            last = first.wrapping_add(whole(period));
            put(first);
            put(last);
            time = time.wrapping_add(period.wrapping_mul(2));
        }
        // By fours: the loop would cost half as much as a step, and the fraction needs a carry.
        let [second, third, fourth] = [1, 2, 3].map(|n| whole(period.wrapping_mul(n)));
        for _ in 0..count >> 2 {
            let first = whole(time);
            last = first.wrapping_add(fourth);
            put(first);
            put(first.wrapping_add(second));
            put(first.wrapping_add(third));
            put(last);
            time = time.wrapping_add(period.wrapping_mul(4));
        }
        last
    }
}

/// A time without the further bits of a period.
#[inline(always)]
pub(super) const fn whole(time: u64) -> u32 {
    (time >> 32) as u32
}

/// One step: `before / distance` of a segment, with `before < distance < 2^33`.
#[inline(always)]
fn lone(before: u32, distance: u64) -> Crossings {
    // Normalised so that 16 bits of the divisor are worth 16 bits of the quotient.
    let (before, distance) = if distance >> 32 != 0 {
        // One less, for the bit that the divisor loses.
        (before.saturating_sub(1) >> 1, (distance >> 1) as u32 | 1 << 31)
    } else {
        let shift = (distance as u32).leading_zeros() & 31;
        (before << shift, (distance as u32) << shift)
    };
    // Rounding the divisor up keeps both digits from being too large.
    let divisor = (distance >> 16) + 1;
    let high = before / divisor;
    // Below 3 * 2^32, and never negative.
    let rest = (u64::from(before) << 16).wrapping_sub(u64::from(high) * u64::from(distance));
    let low = ((rest >> 2) as u32) / divisor;
    Crossings { first: (high << 16).wrapping_add(low << 2), period: u64::MAX }
}

/// Two steps or more: the period is 2^96 / distance, with `distance > 2^32`.
#[inline(always)]
fn several(before: u32, distance: u64) -> Crossings {
    if distance >> MOST_BITS != 0 {
        return Crossings::AT_ONCE;
    }
    // Estimate of 2^51 / distance, too small by less than one part in 2^11.
    let estimate = u32::MAX / ((distance >> 19) as u32 + 1);
    // 1/d = x / (1 - e) = x (1 + e + e^2 + …) with e = 1 - d x, here in units of 2^-43. The whole
    // distance counts: what a slow segment cut off would be seen by a fast one beside it.
    let error = u64::from(estimate).wrapping_mul(distance).wrapping_neg();
    let error = (error >> 8) as u32;
    let error = error.wrapping_add(multiply_high(error, error) >> 11);
    let correction = (u64::from(estimate) * u64::from(error)) << 2;
    let period = (u64::from(estimate) << 45).wrapping_add(correction);
    Crossings { first: multiply_high(before, whole(period)), period }
}

/// Upper half of the product: one UMULL.
#[inline(always)]
fn multiply_high(a: u32, b: u32) -> u32 {
    ((u64::from(a) * u64::from(b)) >> 32) as u32
}
