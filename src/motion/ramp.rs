//! Velocity transitions with whole-segment durations, solved exactly.
//!
//! A ramp takes (v0, a0) to (v1, 0) through an acceleration `peak`: n1 segments from a0 to the
//! peak, n2 at it, n3 back to zero. The durations are the ideal ones rounded up; then the peak
//! follows exactly from the velocity difference and can only be milder than the ideal one.

use super::path::Point;
use super::roots::sqrt_up;

/// Fractional bits inside the planner. An acceleration that is off by 2^-105 for 2^24 segments
/// moves the end by 2^-57; a position of ±4 keeps 20 bits of headroom.
pub(super) const BITS: u32 = 104;
/// From Q60 to the planner's numbers.
pub(super) const FROM_Q60: u32 = BITS - 60;
/// From Q90 to the planner's numbers.
pub(super) const FROM_Q90: u32 = BITS - 90;
/// Longest profile in segments (76 hours).
pub(super) const LONGEST: i128 = 1 << 31;
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
    pub fn usable(self, from: Point) -> Rates {
        let speed = self.v.max(from.v.abs()).max(from.a.abs());
        let a = self.a.min(speed);
        Rates { a, j: self.j.min(a.max(from.a.abs())), ..self }
    }

    /// Velocity change while `a` falls to zero at full jerk: a·|a| / 2J, to 2^-48.
    pub fn forced(&self, a: i128) -> Option<i128> {
        let bits = |x: u128| 128 - x.leading_zeros();
        let a_shift = bits(a.unsigned_abs()).saturating_sub(62);
        let j_shift = bits(self.j.unsigned_abs()).saturating_sub(50);
        let a_short = a.unsigned_abs() >> a_shift;
        let ratio = a_short * a_short / (2 * (self.j.unsigned_abs() >> j_shift));
        let size = if 2 * a_shift >= j_shift {
            let up = 2 * a_shift - j_shift;
            (bits(ratio) + up <= BITS + 6).then(|| ratio << up)?
        } else {
            ratio >> (j_shift - 2 * a_shift).min(127)
        };
        Some(a.signum() * size as i128)
    }

    /// Segments of a symmetric ramp over `dv` that starts and ends without acceleration.
    pub fn symmetric(&self, dv: i128) -> Option<[u32; 3]> {
        let dv = dv.unsigned_abs();
        if dv == 0 {
            return Some([0; 3]);
        }
        let (a, j) = (self.a.unsigned_abs(), self.j.unsigned_abs());
        let q = dv.div_ceil(a).max(sqrt_up(dv.div_ceil(j)));
        let p = dv.div_ceil(j.checked_mul(q)?);
        Some([segments(p as i128)?, segments((q - p) as i128)?, segments(p as i128)?])
    }

    /// Segments of the ramp from `(v0, a0)` to `(v1, 0)`.
    pub fn ramp(&self, v0: i128, a0: i128, v1: i128) -> Option<[u32; 3]> {
        if a0 == 0 {
            return self.symmetric(v1 - v0);
        }
        let free = v0 + self.forced(a0)?;
        let sign = if v1 >= free { 1 } else { -1 };
        let (a0, dv) = (sign * a0, sign * (v1 - v0));
        // Times in Q16, their squares in Q32.
        let t0 = ratio(a0, self.j, 16)?;
        let t0_squared = t0.checked_mul(t0)?;
        let square = (ratio(dv, self.j, 32)? + t0_squared / 2).max(0);
        let peak = sqrt_up(square as u128) as i128;
        let most = ratio(self.a, self.j, 16).unwrap_or(i128::MAX);
        let mut n = [0i128; 3];
        if peak <= most {
            n = [up16((peak - t0).max(0)), 0, up16(peak)];
        } else {
            n[0] = up16((most - t0).abs());
            n[2] = up16(most);
            let rest = 2 * dv - n[0].checked_mul(a0 + self.a)? - n[2].checked_mul(self.a)?;
            n[1] = div_up(rest, 2 * self.a).max(0);
        }
        let n = [segments(n[0])?, segments(n[1])?, segments(n[2])?];
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
    fn strain(&self, a0: i128, peak: i128, n: [u32; 3]) -> (bool, bool) {
        let [n1, _, n3] = n.map(i128::from);
        ((peak - a0).abs() > self.j.saturating_mul(n1), peak.abs() > self.j.saturating_mul(n3))
    }
}

/// `num / den` with `bits` (at most 32) fractional bits; the last 12 of 32 are not computed.
fn ratio(num: i128, den: i128, bits: u32) -> Option<i128> {
    let whole = num / den;
    let fine = bits.min(20);
    let fraction = ((num % den) << fine) / den;
    (whole.abs() < 1 << 80).then(|| (whole << bits) + (fraction << (bits - fine)))
}

/// Q16 rounded up to whole segments. The ratios were truncated: a hair is forgiven, [`Rates::relax`]
/// checks.
fn up16(t: i128) -> i128 {
    (t + 0xffff - 8) >> 16
}

/// Division rounded up; `den` positive.
pub(super) fn div_up(num: i128, den: i128) -> i128 {
    let quotient = num / den;
    if num % den > 0 { quotient + 1 } else { quotient }
}

/// A count of segments, refused beyond [`LONGEST`].
pub(super) fn segments(n: i128) -> Option<u32> {
    (0..=LONGEST).contains(&n).then_some(n as u32)
}

/// The peak acceleration of a ramp over `dv` with these durations.
pub(super) fn peak(a0: i128, dv: i128, n: [u32; 3]) -> Option<i128> {
    let [n1, n2, n3] = n.map(i128::from);
    let weight = n1 + 2 * n2 + n3;
    (weight > 0).then(|| a0.checked_mul(n1).map(|known| (2 * dv - known) / weight))?
}

/// Position, velocity and acceleration in the planner's numbers.
#[derive(Clone, Copy, Default)]
pub(super) struct Point {
    pub s: i128,
    pub v: i128,
    pub a: i128,
}

impl Point {
    /// After `n` segments in which the acceleration goes linearly to `a1`.
    pub fn after(self, n: u32, a1: i128) -> Option<Point> {
        let n = i128::from(n);
        let dv = n.checked_mul(self.a + a1)? >> 1;
        let bend = n.checked_mul(n)?.checked_mul(2 * self.a + a1)? / 6;
        let s = self.s.checked_add(n.checked_mul(self.v)?)?.checked_add(bend)?;
        let v = self.v + dv;
        let sane = s.abs() < 1 << (BITS + 6) && v.abs() < 1 << (BITS + 3);
        sane.then_some(Point { s, v, a: a1 })
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
    /// Acceleration at the end, segments, and the state at the start of each phase.
    phases: [(u32, i128, Point); MAX_PHASES],
    count: usize,
    /// The state reached.
    pub at: Point,
    /// Segments so far.
    pub time: u32,
}

impl Path {
    pub fn new(at: Point) -> Path {
        Path { phases: [(0, 0, Point::default()); MAX_PHASES], count: 0, at, time: 0 }
    }

    /// Goes to the acceleration `a1` in `n` segments.
    pub fn push(&mut self, n: u32, a1: i128) -> Option<()> {
        if n > 0 {
            *self.phases.get_mut(self.count)? = (n, a1, self.at);
            self.at = self.at.after(n, a1)?;
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

    /// Whether every phase keeps the limits; `v_most` and `a_most` are those of this plan.
    pub fn keeps(&self, rates: &Rates, v_most: i128, a_most: i128) -> bool {
        self.phases.iter().take(self.count).all(|&(n, a1, from)| {
            let jerk = (a1 - from.a).abs();
            let crossing = (from.a < 0) != (a1 < 0) && from.a != 0 && a1 != 0;
            // Where the acceleration crosses zero the velocity has its extreme.
            let extreme = if crossing {
                let own = Rates { j: (jerk / i128::from(n.max(1))).max(1), ..*rates };
                own.forced(from.a).map_or(i128::MAX, |dv| (from.v + dv).abs())
            } else {
                from.v.abs()
            };
            jerk <= rates.j.saturating_mul(n.into()) && a1.abs() <= a_most && extreme <= v_most
        })
    }

    /// The profile, ending exactly at `end` (Q60), mirrored if `sign` is −1.
    pub fn finish(&self, start: i64, end: i64, end_velocity: i64, sign: i128) -> Option<Profile> {
        let goal = (i128::from(end) - i128::from(start)) << FROM_Q60;
        if (sign * self.at.s - goal).abs() > 1 << (BITS - 57) {
            return None;
        }
        let mut profile =
            Profile { duration: self.time, last: end, end_position: end, end_velocity, ..Profile::default() };
        let mut time = 0;
        for (phase, &(n, a1, from)) in profile.phases.iter_mut().zip(&self.phases).take(self.count) {
            time += n;
            *phase = cubic(n, time, start, sign, from, a1)?;
        }
        profile.count = self.count as u8;
        Some(profile)
    }

    /// The same path seen from the other side.
    pub fn mirrored(mut self) -> Path {
        let flip = |at: Point| Point { s: -at.s, v: -at.v, a: -at.a };
        for phase in &mut self.phases {
            *phase = (phase.0, -phase.1, flip(phase.2));
        }
        self.at = flip(self.at);
        self
    }
}

/// The coefficients of one phase, refused where evaluation could leave an i64.
pub(super) fn cubic(n: u32, end: u32, start: i64, sign: i128, from: Point, a1: i128) -> Option<Phase> {
    // At least 1: a shift by 32 has no meaning in u32.
    let k = (32 - n.saturating_sub(1).leading_zeros()).max(1);
    let round = |x: i128, bits: u32| (x + (1 << (bits - 1))) >> bits;
    let fits = |x: i128, up: u32| (x.unsigned_abs().leading_zeros() > up + 3).then(|| x << up);
    // Three terms below 10 cannot overflow the sums of Horner's scheme at ±32.
    let narrow = |x: i128| {
        let term = round(sign * x, BITS - COEFFICIENT_BITS);
        (term.abs() < 10 << COEFFICIENT_BITS).then_some(term as i64)
    };
    let c1 = fits(from.v, k)?;
    let c2 = fits(from.a, 2 * k)? / 2;
    // Ten of the guard bits are enough below and leave room for 2^K above.
    let steep = round(fits(a1 - from.a, 2 * k)?, 36);
    let c3 = fits(fits(steep, k)? / (6 * i128::from(n.max(1))), 36)?;
    let terms = [narrow(c1)?, narrow(c2)?, narrow(c3)?];
    let c0 = i64::try_from(i128::from(start) + round(sign * from.s, FROM_Q60)).ok()?;
    // How far a phase can lead beyond its borders: not at all where it is monotone; by less than
    // v0·n where only the velocity changes its sign.
    let segments = i128::from(n);
    let drift = segments.checked_mul(from.v.abs())?;
    let bend = segments.checked_mul(segments)?.checked_mul(from.a.abs().max(a1.abs()))? / 2;
    let near = if from.a.signum() * a1.signum() < 0 {
        drift.checked_add(bend)? < ROOM
    } else {
        drift < ROOM || from.v.signum() * from.after(n, a1)?.v.signum() >= 0
    };
    let inside = c0.abs() <= FARTHEST && near;
    inside.then_some(Phase { end, shift: (32 - k) as u8, c: [c0, terms[0], terms[1], terms[2]] })
}
