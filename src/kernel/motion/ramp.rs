//! Velocity transitions with whole-segment durations, solved exactly.
//!
//! A ramp takes (v0, a0) to (v1, 0) through an acceleration `peak`: n1 segments from a0 to the
//! peak, n2 at it, n3 back to zero. The durations are the ideal ones rounded up; then the peak
//! follows exactly from the velocity difference and can only be milder than the ideal one.

use super::path::Point;
use crate::units::rough::Rough;
use crate::units::wide;

/// Fractional bits inside the planner. An acceleration that is off by 2^-105 for 2^24 segments
/// moves the end by 2^-57; a position of ±4 keeps 20 bits of headroom.
pub(super) const BITS: u32 = 104;
/// From Q60 to the planner's numbers.
pub(super) const FROM_Q60: u32 = BITS - 60;
/// From Q90 to the planner's numbers.
pub(super) const FROM_Q90: u32 = BITS - 90;
/// Longest profile in segments (152 hours).
pub(super) const LONGEST: u64 = 1 << 31;
/// Largest magnitude of a position at a phase border, Q60.
pub(super) const FARTHEST: i64 = 4 << 60;

/// Largest magnitudes along the path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Path per segment, Q60, 1..=2^60.
    pub velocity: i64,
    /// Path per segment², Q60, 1..=2^60.
    pub acceleration: i64,
    /// Path per segment³, Q60, 1..=2^60.
    pub jerk: i64,
}

/// The goal cannot be reached in 2^31 segments and within ±4 path, or an argument is out of range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unplannable;

/// The limits in the planner's numbers.
#[derive(Clone, Copy)]
pub(super) struct Rates {
    pub v: i128,
    pub a: i128,
    pub j: i128,
}

impl Rates {
    pub fn of(limits: Limits) -> Option<Rates> {
        let convert = |x: i64| (1..=1 << 60).contains(&x).then(|| i128::from(x) << FROM_Q60);
        Some(Rates { v: convert(limits.velocity)?, a: convert(limits.acceleration)?, j: convert(limits.jerk)? })
    }

    /// The limits that matter in whole segments: an acceleration above a change to the largest
    /// speed within one segment, or a jerk above a change to the largest acceleration, cannot be
    /// used, and a lead-in at that jerk would break the other limits.
    #[inline(never)]
    pub fn usable(self, from: Point) -> Rates {
        let speed = self.v.max(from.v.abs()).max(from.a.abs());
        let a = self.a.min(speed);
        Rates { a, j: self.j.min(a.max(from.a.abs())), ..self }
    }

    /// Velocity change while `a` falls to zero at full jerk: a·|a| / 2J, to 2^-29.
    #[inline(never)]
    pub fn forced(&self, a: i128) -> Option<i128> {
        let [size, jerk] = [a, self.j].map(|x| Rough::wide_down(x.unsigned_abs()));
        let change = size.times_down(size).over_down(jerk).shifted(-1);
        Some(wide::turned(change.wide_floor(BITS + 6)? as i128, a < 0))
    }

    /// Segments in which full jerk takes an acceleration to zero, rounded up, and what it is then.
    #[inline(never)]
    pub fn through_zero(&self, a: i128) -> Option<(u32, i128)> {
        let n = segments(wide::signed_div_up(a.abs(), self.j))?;
        Some((n, a - wide::turned(wide::times(self.j, n)?, a < 0)))
    }

    /// Segments of a symmetric ramp over `dv` that starts and ends without acceleration.
    #[inline(never)]
    pub fn symmetric(&self, dv: i128) -> Option<[u32; 3]> {
        let dv = dv.unsigned_abs();
        if dv == 0 {
            return Some([0; 3]);
        }
        let (dv, a) = (Rough::wide_up(dv), Rough::wide_down(self.a.unsigned_abs()));
        let j = Rough::wide_down(self.j.unsigned_abs());
        // both from one quotient, so that the second is never the larger one, however it was rounded
        let square = dv.over_up(j);
        let q = dv.over_up(a).ceil(0).max(square.root_up().ceil(0));
        let p = square.over_up(Rough::down(q, 0)).ceil(0);
        Some([whole(p)?, whole(q)?.checked_sub(whole(p)?)?, whole(p)?])
    }

    /// Segments of the ramp from `(v0, a0)` to `(v1, 0)`.
    #[inline(never)]
    pub fn ramp(&self, v0: i128, a0: i128, v1: i128) -> Option<[u32; 3]> {
        if a0 == 0 {
            return self.symmetric(v1 - v0);
        }
        let free = v0 + self.forced(a0)?;
        let (a0, dv) = (wide::turned(a0, v1 < free), wide::turned(v1 - v0, v1 < free));
        let over =
            |x: i128, by: i128| Rough::wide_down(x.unsigned_abs()).over_down(Rough::wide_down(by.unsigned_abs()));
        // Times, in segments, and their squares.
        let t0 = over(a0, self.j);
        let less = |t: Rough| if a0 < 0 { t.plus_up(t0) } else { t.minus_down(t0) };
        let half = t0.times_down(t0).shifted(-1);
        let square = over(dv, self.j);
        let square = if dv < 0 { half.minus_down(square) } else { half.plus_up(square) };
        let peak = square.root_up();
        let most = over(self.a, self.j);
        let n = if peak <= most {
            [nearly(less(peak))?, 0, nearly(peak)?]
        } else {
            let apart = if a0 > 0 && t0 > most { t0.minus_down(most) } else { less(most) };
            let (first, last) = (nearly(apart)?, nearly(most)?);
            let rest = 2 * dv - wide::times(a0 + self.a, first)? - wide::times(self.a, last)?;
            [first, if rest > 0 { nearly(over(rest, 2 * self.a))? } else { 0 }, last]
        };
        self.relax(a0, dv, n)
    }

    /// Lengthens a ramp over `dv` until its peak keeps the limits.
    pub fn relax(&self, a0: i128, dv: i128, n: [u32; 3]) -> Option<[u32; 3]> {
        if n == [0; 3] && a0 == 0 && dv == 0 {
            return Some(n);
        }
        self.bump(a0, dv, n, 2)
            .or_else(|| self.nearby(a0, dv, n))
            .or_else(|| self.bent(a0, dv, n))
            .or_else(|| self.bump(a0, dv, n, 12))
    }

    /// Adds a segment where the strain is, at most `times`.
    #[inline(never)]
    fn bump(&self, a0: i128, dv: i128, mut n: [u32; 3], times: u32) -> Option<[u32; 3]> {
        if n == [0; 3] {
            n = [1, 0, 1];
        }
        for _ in 0..=times {
            let peak = peak(a0, dv, n)?;
            let (rise, fall) = self.strain(a0, peak, n);
            if peak.abs() > self.a {
                // The hold is what lowers the peak without touching the jerk.
                n[1] += 1;
            } else if rise {
                n[0] += 1;
            } else if fall {
                n[2] += 1;
            } else {
                return Some(n);
            }
        }
        None
    }

    /// The shortest valid durations near `n`: where a longer first part needs a shorter hold.
    fn nearby(&self, a0: i128, dv: i128, n: [u32; 3]) -> Option<[u32; 3]> {
        let mut best: Option<([u32; 3], u32)> = None;
        for n1 in n[0]..n[0] + 4 {
            for n2 in n[1].saturating_sub(3)..n[1] + 3 {
                for n3 in n[2].saturating_sub(2)..n[2] + 3 {
                    let time = n1 + n2 + n3;
                    if best.is_some_and(|best| best.1 <= time) {
                        continue;
                    }
                    let trial = [n1, n2, n3];
                    let Some(peak) = peak(a0, dv, trial) else {
                        continue;
                    };
                    if peak.abs() <= self.a && self.strain(a0, peak, trial) == (false, false) {
                        best = Some((trial, time));
                    }
                }
            }
        }
        best.map(|best| best.0)
    }

    /// A ramp that hardly does more than end the acceleration: it falls steeply first and then
    /// less, with the corner anywhere, because a straight fall in whole segments is too long.
    fn bent(&self, a0: i128, dv: i128, n: [u32; 3]) -> Option<[u32; 3]> {
        let total = n[0].checked_add(n[1])?.checked_add(n[2])?;
        (total.saturating_sub(1)..total.saturating_add(3)).find_map(|total| {
            (1..8).find_map(|part| {
                let n1 = (u64::from(total) * part / 8) as u32;
                let trial = [n1, 0, total - n1];
                let peak = peak(a0, dv, trial)?;
                let valid = peak.abs() <= self.a.max(a0.abs());
                (valid && self.strain(a0, peak, trial) == (false, false)).then_some(trial)
            })
        })
    }

    /// [`Rates::relax`] for the ramp from a state to the velocity `v1`.
    pub fn relax_signed(&self, from: Point, v1: i128, n: [u32; 3]) -> Option<[u32; 3]> {
        self.relax(from.a, v1 - from.v, n)
    }

    /// Whether the first and the last part of a ramp ask for too much jerk.
    #[inline(never)]
    fn strain(&self, a0: i128, peak: i128, n: [u32; 3]) -> (bool, bool) {
        let most = |n: u32| wide::times(self.j, n).unwrap_or(i128::MAX);
        ((peak - a0).abs() > most(n[0]), peak.abs() > most(n[2]))
    }
}

/// Rounded up to whole segments. What is rounded were quotients of their own: a hair is forgiven, [`Rates::relax`]
/// checks.
fn nearly(t: Rough) -> Option<u32> {
    const HAIR: Rough = Rough::ONE.shifted(-13);
    whole(t.minus_down(HAIR).ceil(0))
}

/// A count of segments, refused beyond [`LONGEST`].
pub(super) fn segments(n: i128) -> Option<u32> {
    (0..=i128::from(LONGEST)).contains(&n).then_some(n as u32)
}

/// As [`segments`].
pub(super) fn whole(n: u64) -> Option<u32> {
    segments(i128::from(n))
}

/// The peak acceleration of a ramp over `dv` with these durations.
#[inline(never)]
pub(super) fn peak(a0: i128, dv: i128, n: [u32; 3]) -> Option<i128> {
    let weight = n[0] as u64 + 2 * n[1] as u64 + n[2] as u64;
    if weight == 0 {
        return None;
    }
    let known = wide::times(a0, n[0])?;
    Some(wide::signed_div(2 * dv - known, weight.into()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Where velocity is jerk times a whole square, both quotients lie on a whole number, and only their rounding
    /// decides.
    #[test]
    fn a_ramp_over_a_whole_square_of_its_jerk_has_its_durations() {
        let mut random = Random(3);
        for _ in 0..200_000 {
            let q = 1 + (random.bits() % 300) as u32;
            let j = i128::from(1 + (random.bits() >> 32)) << (20 + random.bits() % 30);
            let rates = Rates { v: i128::MAX, a: i128::from(u32::MAX) << 90, j };
            // the velocity itself, and a little less
            for dv in [0, 1 << 20].map(|less| j * i128::from(q * q) - less) {
                let n = rates.symmetric(dv).expect("it can be ramped");
                assert_eq!(n[0], n[2]);
                let needed = i128::from(n[0]) * i128::from(n[0] + n[1]);
                assert!(j * needed >= dv, "jerk within its limit: {q} {j} {n:?}");
                assert!((q..=q + 1).contains(&(n[0] + n[1])) && n[0] <= q + 1, "no longer than it must be: {q} {n:?}");
            }
        }
    }
}
