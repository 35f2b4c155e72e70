//! Who may use how much of a motor's velocity, acceleration and jerk.
//!
//! Every running track holds a share of every motor; a new one gets what is left and is never given more.
//! A fixed part of each motor's limits is kept for taking up play.

use super::bounds::{Bounds, MOST_STRETCHES, PATH_ONE};
use super::ramp::Limits;
use crate::units::{AXES, SEGMENT_TICKS, TICKS_PER_SECOND, wide};

/// Fractional bits of rates: steps (or nm, nrad) per segment, per segment squared and cubed.
pub const RATE_BITS: u32 = 44;

/// Velocity, acceleration and jerk of something counted in steps or in nm/nrad, per segment^k in Q44.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rates {
    /// Per segment.
    pub velocity: u64,
    /// Per segment squared.
    pub acceleration: u64,
    /// Per segment cubed.
    pub jerk: u64,
}

impl Rates {
    /// From rates per second^k in nm or nrad, counted in steps of `step_q32` (1 << 32: in nm or nrad themselves).
    #[inline(never)]
    pub fn per_segment(velocity: u64, acceleration: u64, jerk: u64, step_q32: u64) -> Self {
        const T: u128 = SEGMENT_TICKS as u128;
        const F: u128 = TICKS_PER_SECOND as u128;
        let step = u128::from(step_q32.max(1));
        // Each division by F keeps at least 40 fractional bits, so that nothing overflows 128 bits.
        let v = wide::div((u128::from(velocity) * T) << 40, F);
        let a = wide::div((u128::from(acceleration) * T * T) << 40, F * F);
        let j = wide::div((wide::div((u128::from(jerk) * T * T) << 20, F) * T) << 20, F * F);
        let in_steps = |value: u128| u64::try_from(wide::div(value << 36, step)).unwrap_or(u64::MAX >> 1).max(1);
        Rates { velocity: in_steps(v), acceleration: in_steps(a), jerk: in_steps(j) }
    }

    /// A share of each, in 1/1024.
    pub fn share(self, of_1024: u32) -> Self {
        let part = |value: u64| ((u128::from(value) * u128::from(of_1024)) >> 10) as u64;
        Rates { velocity: part(self.velocity), acceleration: part(self.acceleration), jerk: part(self.jerk) }
    }

    /// What is left when `other` is taken away.
    pub fn less(self, other: Self) -> Self {
        Rates {
            velocity: self.velocity.saturating_sub(other.velocity),
            acceleration: self.acceleration.saturating_sub(other.acceleration),
            jerk: self.jerk.saturating_sub(other.jerk),
        }
    }

    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Rates {
            velocity: self.velocity.saturating_add(other.velocity),
            acceleration: self.acceleration.saturating_add(other.acceleration),
            jerk: self.jerk.saturating_add(other.jerk),
        }
    }

    /// True when none of the other's is larger.
    pub fn covers(&self, other: &Self) -> bool {
        other.velocity <= self.velocity && other.acceleration <= self.acceleration && other.jerk <= self.jerk
    }

    /// The larger of each.
    pub fn max(self, other: Self) -> Self {
        Rates {
            velocity: self.velocity.max(other.velocity),
            acceleration: self.acceleration.max(other.acceleration),
            jerk: self.jerk.max(other.jerk),
        }
    }
}

/// A quarter of the duration, in segments, of a take-up of `width` steps within `reserve`
/// (peaks 2 b/T, 8 b/T^2, 32 b/T^3 with T four quarters).
pub fn take_up_quarter(width: u32, reserve: Rates) -> u32 {
    let b = u128::from(width) << RATE_BITS;
    let over = |rate: u64| wide::div_up(b, u128::from(rate.max(1)));
    // with T = 4 q: q >= b / (2 v), q^2 >= b / (2 a), q^3 >= b / (2 j)
    let half = |value: u128| value.div_ceil(2);
    let q1 = half(over(reserve.velocity));
    let a = half(over(reserve.acceleration));
    let q2 = u128::from(wide::isqrt(a)) + 1;
    let j = half(over(reserve.jerk));
    let q3 = u128::from(wide::cube_root(j)) + 1;
    u32::try_from(q1.max(q2).max(q3)).unwrap_or(u32::MAX / 8).clamp(1, u32::MAX / 8)
}

/// Angular rates of a track, nrad per segment^k in Q20, summed over the rotary axes: what tracks that run at the
/// same time need to know of each other, since a rotation bends what another one does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Turning {
    /// nrad per segment, Q20.
    pub velocity: u64,
    /// nrad per segment squared, Q20.
    pub acceleration: u64,
    /// nrad per segment cubed, Q20.
    pub jerk: u64,
}

impl Turning {
    /// Both together.
    pub fn plus(self, other: Self) -> Self {
        Turning {
            velocity: self.velocity.saturating_add(other.velocity),
            acceleration: self.acceleration.saturating_add(other.acceleration),
            jerk: self.jerk.saturating_add(other.jerk),
        }
    }

    /// The larger of each.
    pub fn max(self, other: Self) -> Self {
        Turning {
            velocity: self.velocity.max(other.velocity),
            acceleration: self.acceleration.max(other.acceleration),
            jerk: self.jerk.max(other.jerk),
        }
    }
}

/// What a track has been granted.
#[derive(Clone, Copy, Debug, Default)]
pub struct Grant {
    /// Limits on its path parameter.
    pub limits: Limits,
    /// What it uses of each motor at most.
    pub uses: [Rates; AXES],
    /// Its own angular rates.
    pub turning: Turning,
    /// Angle by which it turns in whole, nrad.
    pub swing: u64,
    /// Angle by which others turn or have turned since, nrad: what that adds is in `uses`.
    pub bent: u64,
}

/// value (Q16 per path unit) times rate (Q60): Q44, rounded up.
fn times(value: u64, rate: i64) -> u64 {
    wide::mul_shift(value, rate.unsigned_abs(), 32).saturating_add(1)
}

/// The smaller of `most` and of a quotient, rounded down; of two of the limits in Q60. `divisor` below 2^68.
#[inline(never)]
fn least(most: i64, dividend: u128, divisor: u128) -> i64 {
    // most quotients are larger than the smallest one: a product says so for less than a division
    if dividend >= u128::from(most.unsigned_abs()) * divisor { most } else { wide::div(dividend, divisor) as i64 }
}

/// The smaller of `most` and of a rate (Q44) over a value (Q16 per path unit), Q60.
fn least_rate(most: i64, rate: u64, value: u64) -> i64 {
    least(most, u128::from(rate) << 32, value.into())
}

impl Grant {
    /// The fastest limits of a path whose motors stay within `available` and whose logical axes within `wanted`
    /// (nm and nrad per segment^k; `ways`: |direction| of each axis, nm or nrad per path unit in Q16).
    pub fn within(
        bounds: &Bounds,
        available: &[Rates; AXES],
        wanted: &[Rates; AXES],
        ways: &[u64; AXES],
        others: Turning,
        crossed: &dyn Fn(usize, u128) -> u64,
    ) -> Self {
        const ONE: i64 = 1 << 60;
        let (mut velocity, mut square, mut cube) = (ONE, ONE, ONE);
        for i in 0..AXES {
            velocity = least_rate(velocity, wanted[i].velocity, ways[i]);
            // at most a quarter of the acceleration for curvature v^2, an eighth of the jerk for third v^3
            square = least(square, u128::from(available[i].acceleration) << 30, bounds.curvature[i].into()); // Q60 / 4
            cube = least(cube, u128::from(available[i].jerk) << 29, bounds.third[i].into()); // Q60 / 8
        }
        if square < ONE {
            velocity = velocity.min(wide::isqrt(u128::from(square.unsigned_abs()) << 60) as i64);
        }
        if cube < ONE {
            velocity = velocity.min((wide::cube_root(u128::from(cube.unsigned_abs()) << 60) << 20) as i64);
        }
        let velocity = not_too_steep(velocity, bounds, available);
        let velocity = velocity.max(1);
        let square = product_q60(velocity, velocity);
        let cube = product_q60(velocity, square);
        let turning_v = turning(bounds.turning, velocity);
        // two rotations at once: 2 r w1 w2 of acceleration on every linear motor, less on rotary ones
        let crossed_a = |i: usize| {
            if others.velocity == 0 || turning_v == 0 {
                return 0;
            }
            crossed(i, 2 * u128::from(turning_v) * u128::from(others.velocity))
        };
        let mut acceleration = ONE;
        let (mut bends_a, mut bends_j) = ([0; AXES], [0; AXES]);
        for i in 0..AXES {
            let (own, crossed) = (times(bounds.curvature[i], square), crossed_a(i));
            bends_a[i] = own + crossed;
            let left = available[i].acceleration.saturating_sub(own.min(available[i].acceleration / 2) + crossed);
            acceleration = least_rate(acceleration, left, bounds.slope[i]);
            acceleration = least_rate(acceleration, wanted[i].acceleration, ways[i]);
            if bounds.curvature[i] != 0 {
                // 3 m'' v a at most a quarter of the jerk
                let per = u128::from(times(bounds.curvature[i], velocity)) * 12; // Q44 per path unit of a
                acceleration = least(acceleration, u128::from(available[i].jerk) << 60, per);
            }
        }
        let acceleration = acceleration.max(1);
        let turning_a = turning(bounds.turning, acceleration);
        let crossed_j = |i: usize| {
            if others.velocity == 0 || turning_v == 0 {
                return 0;
            }
            let (v1, v2) = (u128::from(turning_v), u128::from(others.velocity));
            let (a1, a2) = (u128::from(turning_a), u128::from(others.acceleration));
            // 3 r (w1 a2 + a1 w2); the term 3 r w1 w2 (w1 + w2) is below a thousandth of it and covered by the quarter in `bent`
            crossed(i, 3 * (v1 * a2 + a1 * v2))
        };
        let mixed = product_q60(velocity, acceleration);
        let mut jerk = ONE;
        for i in 0..AXES {
            let third = times(bounds.third[i], cube);
            bends_j[i] = times(bounds.curvature[i], mixed).saturating_mul(3).saturating_add(third) + crossed_j(i);
            let left = available[i].jerk.saturating_sub(bends_j[i]);
            jerk = least_rate(jerk, left, bounds.slope[i]);
            jerk = least_rate(jerk, wanted[i].jerk, ways[i]);
        }
        let jerk = jerk.max(1);
        let mut uses = [Rates::default(); AXES];
        for (i, rates) in uses.iter_mut().enumerate() {
            *rates = Rates {
                // where the path is steeper than the velocity allows it is slower, see `slow_near_rest`
                velocity: times(bounds.slope[i], velocity).min(available[i].velocity),
                acceleration: times(bounds.slope[i], acceleration) + bends_a[i],
                jerk: times(bounds.slope[i], jerk).saturating_add(bends_j[i]),
            };
        }
        Grant {
            limits: Limits { velocity, acceleration, jerk },
            uses,
            turning: Turning { velocity: turning_v, acceleration: turning_a, jerk: turning(bounds.turning, jerk) },
            swing: 0,
            bent: 0,
        }
    }
}

/// The smaller of `most` and of the path velocity (Q60) at which no motor is too fast. A path from rest to rest whose
/// acceleration stays below a goes at most at sqrt(2 a d) where the nearer of its ends is d away: stretches that are
/// steep, but too near to an end to be reached at full speed, do not slow it down.
fn not_too_steep(most: i64, bounds: &Bounds, available: &[Rates; AXES]) -> i64 {
    let near_rest = bounds.rests && !bounds.ways.is_empty();
    let mut velocity = most;
    let mut reached = None;
    for i in 0..AXES {
        let anywhere = least_rate(velocity, available[i].velocity, bounds.slope[i]);
        if anywhere == velocity || !near_rest {
            velocity = anywhere;
            continue;
        }
        let reached = reached.get_or_insert_with(|| velocities_reached(bounds, available));
        for (ways, reached) in bounds.ways.iter().zip(reached.iter()) {
            let slope = bounds.slope_within(ways, i);
            if times(slope, *reached) > available[i].velocity {
                velocity = least_rate(velocity, available[i].velocity, slope);
            }
        }
    }
    velocity
}

/// The highest path velocity (Q60) in each stretch of a path from rest to rest.
#[inline(never)]
fn velocities_reached(bounds: &Bounds, available: &[Rates; AXES]) -> [i64; MOST_STRETCHES] {
    const ONE: i64 = 1 << 60;
    let count = bounds.ways.len();
    // never less than the acceleration that will be granted
    let most = (0..AXES).fold(ONE, |most, i| least_rate(most, available[i].acceleration, bounds.slope[i]));
    let mut reached = [ONE; MOST_STRETCHES];
    for (k, reached) in reached.iter_mut().enumerate().take(count) {
        let distance = ((k + 1).min(count - k) as u64 * (PATH_ONE as u64 / count as u64)) + 2 * count as u64;
        *reached = wide::isqrt(2 * u128::from(most.unsigned_abs()) * u128::from(distance)).min(ONE as u64) as i64;
    }
    reached
}

/// nrad per path unit times a path rate in Q60: nrad in Q20, rounded up.
fn turning(angle: u64, rate: i64) -> u64 {
    if angle == 0 { 0 } else { wide::mul_shift(angle, rate.unsigned_abs(), 40).saturating_add(1) }
}

/// Product of two numbers in Q60 that are not negative, rounded down.
fn product_q60(a: i64, b: i64) -> i64 {
    wide::mul_shift(a.unsigned_abs(), b.unsigned_abs(), 60) as i64
}
