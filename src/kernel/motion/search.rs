//! The cruise velocity of a move that starts in motion.

use super::path::{Path, Point};
use super::plan::lead_in;
use super::ramp::{Rates, segments};
use crate::units::wide;

/// Bisection steps for the cruise velocity: what they leave is made up by a short cruise.
const STEPS: u32 = 24;

/// A way to the target, in whole: ramp to `vc`, cruise, ramp to rest.
#[derive(Clone, Copy)]
struct Shape {
    up: [u32; 3],
    cruise: u32,
    down: [u32; 3],
}

impl Shape {
    fn way(&self, from: Point, vc: i128) -> Option<i128> {
        Some(from.after_ramp(self.up, vc)?.after(self.cruise, 0)?.after_ramp(self.down, 0)?.s)
    }

    fn push(&self, path: &mut Path, vc: i128) -> Option<()> {
        path.push_ramp(self.up, vc)?;
        path.push(self.cruise, 0)?;
        path.push_ramp(self.down, 0)
    }
}

/// The shape without cruise, and its way, for a cruise velocity.
#[inline(never)]
fn shape(from: Point, vc: i128, rates: &Rates) -> Option<(Shape, i128)> {
    let up = rates.ramp(from.v, from.a, vc)?;
    let down = rates.symmetric(vc)?;
    let shape = Shape { up, cruise: 0, down };
    Some((shape, shape.way(from, vc)?))
}

/// The path from its present end to `way`, which lies ahead of where a stop would end.
///
/// With `lead` an acceleration that has to change its sign does so at exactly full jerk first:
/// slower by a segment or so, but the velocity never goes beyond what the state forces.
#[inline(never)]
pub(super) fn direct(mut path: Path, way: i128, mut rates: Rates, lead: bool) -> Option<Path> {
    let at = path.at;
    let free = at.v + rates.forced(at.a)?;
    let slowing = at.a < 0 && free > 0;
    let too_fast = free.max(at.v) > rates.v;
    let full = shape(at, rates.v, &rates)?.1;
    if slowing && (free <= rates.v || full > way) && shape(at, free, &rates)?.1 > way {
        return ease(path, way, &rates);
    }
    let keep_speed = too_fast && full > way && (!slowing || free > rates.v);
    if keep_speed {
        // Braking to the limit first and again to rest would pass the target: the speed that is
        // forced in any case is kept for the little that remains before the stop.
        rates.v = if slowing { free } else { free.max(at.v) };
    }
    let near_limit = free > rates.v - (rates.v >> 3);
    let crossing = at.a < 0 && (!slowing || free <= rates.v) || at.a > 0 && near_limit;
    if lead && crossing {
        lead_in(&mut path, &rates)?;
    }
    let at = path.at;
    if shape(at, rates.v, &rates)?.1 <= way {
        return cruise_at(path, rates.v, way, &rates);
    }
    let free = at.v + rates.forced(at.a)?;
    let (mut low, mut high) = (wide::within(free, 0, rates.v), rates.v);
    for _ in 0..STEPS {
        // shifted: a compiler for size calls a division of 128 bits even for a half
        let middle = low + ((high - low) >> 1);
        let (found, reach) = shape(at, middle, &rates)?;
        if reach > way {
            high = middle;
            continue;
        }
        low = middle;
        let ramps = found.up.iter().chain(&found.down).fold(0, |sum: u32, n| sum.saturating_add(*n));
        if way - reach <= wide::times(middle, 1 + (ramps >> 8)).unwrap_or(i128::MAX) {
            break;
        }
    }
    let found = cruise_at(path, low, way, &rates);
    if free <= 0 || low > free + (free >> 2) {
        return found;
    }
    // Hardly anything to gain from a rise: the stop alone may fit better.
    let level = super::sloped::cruise(path, free, way, &rates);
    let stop = super::sloped::stop(path, way, &rates);
    shorter(shorter(found, level), stop)
}

/// The one that takes less time, the first of equals.
#[inline(never)]
fn shorter(first: Option<Path>, second: Option<Path>) -> Option<Path> {
    match (&first, &second) {
        (Some(one), Some(other)) if other.time < one.time => second,
        (None, _) => second,
        _ => first,
    }
}

/// Fixes the durations for a cruise velocity near `wanted` and solves the rest exactly.
#[inline(never)]
fn cruise_at(path: Path, wanted: i128, way: i128, rates: &Rates) -> Option<Path> {
    if wanted <= 0 {
        return None;
    }
    let near = cruise_near(path, wanted, way, rates);
    let (ideal, reach) = shape(path.at, wanted, rates)?;
    let segments = ideal.up.iter().chain(&ideal.down).map(|n| i128::from(*n)).sum::<i128>();
    let fair = i128::from(path.time) + segments + wide::signed_div(way - reach, wanted) + 2;
    if near.is_some_and(|near| i128::from(near.time) <= fair) {
        return near;
    }
    // Ramps to a velocity a little lower can cost more than the cruise gives.
    let sloped = super::sloped::cruise(path, wanted, way, rates);
    shorter(near, sloped)
}

/// The solution in which the cruise velocity absorbs the rounding of the durations.
fn cruise_near(mut path: Path, wanted: i128, way: i128, rates: &Rates) -> Option<Path> {
    let at = path.at;
    if wanted <= 0 {
        return None;
    }
    let mut vc = wanted;
    let (mut shape, reach) = shape(at, vc, rates)?;
    shape.cruise = segments(wide::signed_div_up((way - reach).max(0), vc))?;
    if shape.up == [0; 3] {
        shape.up = [1, 0, 1];
    }
    for _ in 0..10 {
        vc = solve(&|vc| shape.way(at, vc), vc, way)?;
        if vc > rates.v.max(at.v) || vc <= 0 {
            shape.cruise += 1;
            continue;
        }
        let longer = |from: Point, v1: i128, n: [u32; 3]| match rates.relax_signed(from, v1, n) {
            Some(same) if same == n => Some(n),
            // A few segments more may not be enough: what this velocity needs is known.
            _ => {
                let need = rates.ramp(from.v, from.a, v1)?;
                let n = [n[0].max(need[0]), n[1].max(need[1]), n[2].max(need[2])];
                rates.relax_signed(from, v1, n)
            }
        };
        let up = longer(at, vc, shape.up)?;
        let down = longer(Point { s: 0, v: vc, a: 0 }, 0, shape.down)?;
        if up == shape.up && down == shape.down {
            shape.push(&mut path, vc)?;
            return Some(path);
        }
        // The longer ramps cover way too: less is left to the cruise.
        shape = Shape { up, cruise: 0, down };
        shape.cruise = segments(wide::signed_div_up((way - shape.way(at, wanted)?).max(0), wanted))?;
    }
    None
}

/// The argument near `x` at which the affine function `f` is `goal`.
#[inline(never)]
pub(super) fn solve(f: &dyn Fn(i128) -> Option<i128>, mut x: i128, goal: i128) -> Option<i128> {
    // A step that is large against the rounding of f, small against its range.
    let step = 1 << 70;
    let slope = (f(x + step)? - f(x)?) >> 30;
    if slope <= 0 {
        return None;
    }
    // The slope is known to about 2^-40, every round gains as much.
    for _ in 0..4 {
        let error = goal - f(x)?;
        if error.abs() < slope >> 41 {
            break;
        }
        let shift = error.unsigned_abs().leading_zeros().saturating_sub(2).min(40);
        x += wide::signed_div(error << shift, slope) << (40 - shift);
    }
    Some(x)
}

/// Eases the deceleration off for some segments, then stops: for a target between where a stop
/// ends and where it ends after the acceleration has been zero once.
#[inline(never)]
fn ease(path: Path, way: i128, rates: &Rates) -> Option<Path> {
    let at = path.at;
    let most = segments(wide::signed_div(at.a.abs(), rates.j))?;
    let eased = |m: u32| at.after(m, at.a + wide::times(rates.j, m)?);
    let stop = |m: u32| -> Option<([u32; 3], i128)> {
        let point = eased(m)?;
        let n = rates.ramp(point.v, point.a, 0)?;
        Some((n, point.after_ramp(n, 0)?.s))
    };
    let (mut low, mut high) = (0, most + 1);
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        match stop(middle) {
            Some((_, reach)) if reach <= way => low = middle,
            _ => high = middle,
        }
    }
    let (n, _) = stop(low)?;
    let mut best: Option<Path> = None;
    for m in low.max(1)..low + 3 {
        for n1 in n[0].saturating_sub(1)..n[0] + 2 {
            for n2 in n[1].saturating_sub(2)..n[1] + 2 {
                for n3 in n[2]..n[2] + 2 {
                    let time = m + n1 + n2 + n3;
                    if best.is_some_and(|found| found.time <= path.time + time) {
                        continue;
                    }
                    best = eased_path(path, m, [n1, n2, n3], way, rates).or(best);
                }
            }
        }
    }
    // Easing at full jerk, and a sloped stop for the rest.
    for m in [low, low.saturating_sub(1), low.saturating_sub(3), low - low / 8] {
        let mut eased = path;
        eased.push(m, at.a + wide::times(rates.j, m)?)?;
        let found = super::sloped::stop(eased, way, rates);
        best = shorter(best, found);
    }
    best
}

/// The stop with these durations that ends exactly at `way`, if it keeps the limits.
fn eased_path(mut path: Path, m: u32, n: [u32; 3], way: i128, rates: &Rates) -> Option<Path> {
    if n[0] == 0 || n[2] == 0 {
        return None;
    }
    let at = path.at;
    let a1 = solve(&|a1| Some(at.after(m, a1)?.after_ramp(n, 0)?.s), at.a, way)?;
    let middle = at.after(m, a1)?;
    if a1 > 0 || (a1 - at.a).abs() > wide::times(rates.j, m)? {
        return None;
    }
    if rates.relax_signed(middle, 0, n)? != n {
        return None;
    }
    path.push(m, a1)?;
    path.push_ramp(n, 0)?;
    Some(path)
}
