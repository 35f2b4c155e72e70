//! A profile under construction: exact states at the borders of its phases.

use super::profile::{COEFFICIENT_BITS, MAX_PHASES, Phase, Profile};
use super::ramp::{BITS, FARTHEST, FROM_Q60, Rates, peak, segments};
use crate::units::wide;

/// How far a phase may lead beyond its borders: ±4 and this fit a Q60 position.
const ROOM: i128 = 31 << (BITS - 3);

/// Position, velocity and acceleration in the planner's numbers.
#[derive(Clone, Copy, Default)]
pub(super) struct Point {
    pub s: i128,
    pub v: i128,
    pub a: i128,
}

impl Point {
    /// After `n` segments in which the acceleration goes linearly to `a1`.
    pub fn after(mut self, n: u32, a1: i128) -> Option<Point> {
        self.advance(n, a1).map(|()| self)
    }

    /// Goes on for `n` segments in which the acceleration goes linearly to `a1`.
    #[inline(never)]
    fn advance(&mut self, n: u32, a1: i128) -> Option<()> {
        let mut s = wide::times(self.v, n)?;
        let mut v = self.v;
        if self.a == a1 {
            if a1 != 0 {
                let dv = wide::times(a1, n)?;
                v += dv;
                s = s.checked_add(wide::times(dv, n)? >> 1)?;
            }
        } else {
            v += wide::times(self.a + a1, n)? >> 1;
            s = s.checked_add(wide::sixth(wide::times(wide::times(2 * self.a + a1, n)?, n)?))?;
        }
        let s = self.s.checked_add(s)?;
        let sane = s.abs() < 1 << (BITS + 6) && v.abs() < 1 << (BITS + 3);
        *self = Point { s, v, a: a1 };
        sane.then_some(())
    }

    /// After a ramp to `v1`.
    pub fn after_ramp(self, n: [u32; 3], v1: i128) -> Option<Point> {
        if n == [0; 3] {
            return Some(self);
        }
        let peak = peak(self.a, v1 - self.v, n)?;
        let end = self.after(n[0], peak)?.after(n[1], peak)?.after(n[2], 0)?;
        // The peak was rounded; the velocity it was made for is the exact one.
        Some(Point { v: v1, ..end })
    }
}

/// Phases under construction, in a frame that may be mirrored.
#[derive(Clone, Copy)]
pub(super) struct Path {
    /// Segments of each phase.
    lengths: [u32; MAX_PHASES],
    /// The state at the start of each phase.
    starts: [Point; MAX_PHASES],
    count: usize,
    /// The state reached.
    pub at: Point,
    /// Segments so far.
    pub time: u32,
}

impl Path {
    #[inline(never)]
    pub fn new(at: Point) -> Path {
        Path { lengths: [0; MAX_PHASES], starts: [Point { s: 0, v: 0, a: 0 }; MAX_PHASES], count: 0, at, time: 0 }
    }

    /// Goes to the acceleration `a1` in `n` segments.
    #[inline(never)]
    pub fn push(&mut self, n: u32, a1: i128) -> Option<()> {
        if n > 0 {
            *self.lengths.get_mut(self.count)? = n;
            let Point { s, v, a } = self.at;
            *self.starts.get_mut(self.count)? = Point { s, v, a };
            self.at.advance(n, a1)?;
            self.count += 1;
            self.time = segments(i128::from(self.time) + i128::from(n))?;
        }
        Some(())
    }

    /// Goes to the velocity `v1` in a ramp with these durations.
    pub fn push_ramp(&mut self, n: [u32; 3], v1: i128) -> Option<()> {
        if n != [0; 3] {
            let peak = peak(self.at.a, v1 - self.at.v, n)?;
            self.push(n[0], peak)?;
            self.push(n[1], peak)?;
            self.push(n[2], 0)?;
            self.at.v = v1;
        }
        Some(())
    }

    /// Segments, first and last state of each phase.
    fn phases(&self) -> impl Iterator<Item = (u32, &Point, &Point)> {
        let starts = self.starts.get(..self.count).unwrap_or_default();
        let ends = starts.iter().skip(1).chain([&self.at]);
        self.lengths.iter().zip(starts).zip(ends).map(|((n, from), to)| (*n, from, to))
    }

    /// Whether every phase keeps the limits; `v_most` and `a_most` are those of this plan.
    pub fn keeps(&self, rates: &Rates, v_most: i128, a_most: i128) -> bool {
        self.phases().all(|(n, from, to)| {
            let a1 = to.a;
            let jerk = (a1 - from.a).abs();
            let crossing = turns_round(from.a, a1);
            // Where the acceleration crosses zero the velocity has its extreme.
            let extreme = if crossing {
                let own = Rates { j: wide::over_small(jerk, n.max(1)).max(1), ..*rates };
                own.forced(from.a).map_or(i128::MAX, |dv| (from.v + dv).abs())
            } else {
                from.v.abs()
            };
            jerk <= wide::times(rates.j, n).unwrap_or(i128::MAX) && a1.abs() <= a_most && extreme <= v_most
        })
    }

    /// The profile, ending exactly at `end` (Q60), mirrored if it is to go `back`. What is not one is left unfinished.
    pub fn finish(&self, start: i64, end: i64, end_velocity: i64, back: bool, profile: &mut Profile) -> Option<()> {
        let goal = (i128::from(end) - i128::from(start)) << FROM_Q60;
        if (wide::turned(self.at.s, back) - goal).abs() > 1 << (BITS - 57) {
            return None;
        }
        let mut time = 0;
        for (phase, (n, from, to)) in profile.phases.iter_mut().zip(self.phases()) {
            time += n;
            cubic(phase, n, start, back, from, to)?;
            phase.end = time;
        }
        profile.count = self.count as u8;
        (profile.duration, profile.last) = (self.time, end);
        (profile.end_position, profile.end_velocity) = (end, end_velocity);
        Some(())
    }

    /// The same path seen from the other side.
    pub fn mirrored(mut self) -> Path {
        let flip = |at: Point| Point { s: -at.s, v: -at.v, a: -at.a };
        for start in &mut self.starts {
            *start = flip(*start);
        }
        self.at = flip(self.at);
        self
    }
}

/// `x / 2^bits` to nearest.
fn round(x: i128, bits: u32) -> i128 {
    (x + (1 << (bits - 1))) >> bits
}

/// Whether one is above zero and the other below.
fn turns_round(a: i128, b: i128) -> bool {
    (a ^ b) < 0 && a != 0 && b != 0
}

/// What a coefficient must stay below: three terms below 10 cannot overflow the sums of Horner's scheme at ±32.
const STEEPEST: u64 = 10 << COEFFICIENT_BITS;

/// `x * 2^up` as a coefficient, to nearest.
#[inline(never)]
fn coefficient(x: i128, up: i32) -> Option<i64> {
    if x == 0 {
        return Some(0);
    }
    let size = x.unsigned_abs();
    let down = (BITS - COEFFICIENT_BITS) as i32 - up;
    if size.leading_zeros() as i32 + down <= 64 {
        return None;
    }
    let term = match down {
        1.. => wide::shifted_down(size, down as u32 - 1).saturating_add(1) >> 1,
        _ => (size as u64) << -down,
    };
    (term < STEEPEST).then_some(if x < 0 { -(term as i64) } else { term as i64 })
}

/// The coefficients of one phase, refused where evaluation could leave an i64.
#[inline(never)]
fn cubic(phase: &mut Phase, n: u32, start: i64, back: bool, from: &Point, to: &Point) -> Option<()> {
    // At least 1: a shift by 32 has no meaning in u32.
    let k = (32 - n.saturating_sub(1).leading_zeros()).max(1) as i32;
    let c1 = coefficient(from.v, k)?;
    let c2 = coefficient(from.a, 2 * k - 1)?;
    let rise = to.a - from.a;
    let c3 = if rise == 0 {
        0
    } else {
        // 96 bits over 34 at most are as fine as a coefficient
        let up = rise.unsigned_abs().leading_zeros().saturating_sub(32);
        let sixth = match n.checked_mul(6) {
            Some(by) => wide::over_small(rise << up, by),
            None => wide::sixth(wide::over_small(rise << up, n)),
        };
        coefficient(sixth, 3 * k - up as i32)?
    };
    let c0 = i64::try_from(i128::from(start) + round(wide::turned(from.s, back), FROM_Q60)).ok()?;
    // How far a phase can lead beyond its borders: not at all where it is monotone; by less than
    // v0·n where only the velocity changes its sign.
    let swings = turns_round(from.a, to.a);
    let near = !swings && !turns_round(from.v, to.v) || {
        let drift = wide::times(from.v.abs(), n)?;
        let bend = if swings { wide::times(wide::times(from.a.abs().max(to.a.abs()), n)?, n)? >> 1 } else { 0 };
        drift.checked_add(bend)? < ROOM
    };
    let turned = |c: i64| if back { -c } else { c };
    (phase.shift, phase.c) = ((32 - k) as u8, [c0, turned(c1), turned(c2), turned(c3)]);
    (c0.abs() <= FARTHEST && near).then_some(())
}
