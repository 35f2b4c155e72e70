//! Who may use how much of a motor's velocity, acceleration and jerk.
//!
//! Every running track holds a share of every motor; a new one gets what is left and is never given more.
//! A fixed part of each motor's limits is kept for taking up play.

use super::bounds::{Bounds, MOST_STRETCHES};
use super::ramp::Limits;
use crate::units::rough::Rough;
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
    // with T = 4 q: q >= b / (2 v), q^2 >= b / (2 a), q^3 >= b / (2 j)
    let half = Rough::up(width.into(), 1);
    let over = |rate: u64| half.over_up(Rough::down(rate.max(1), RATE_BITS as i32));
    let (q1, q2) = (over(reserve.velocity), over(reserve.acceleration).root_up());
    let q = q1.max(q2).max(over(reserve.jerk).cube_root_up()).ceil(0);
    u32::try_from(q).unwrap_or(u32::MAX / 8).clamp(1, u32::MAX / 8)
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

/// Numbers that say what a motor or an axis may do, none above the exact one, per segment^k.
#[derive(Clone, Copy, Debug, Default)]
struct Least {
    velocity: Rough,
    acceleration: Rough,
    jerk: Rough,
}

impl From<&Rates> for Least {
    fn from(rates: &Rates) -> Self {
        let rough = |rate| Rough::down(rate, RATE_BITS as i32);
        Least { velocity: rough(rates.velocity), acceleration: rough(rates.acceleration), jerk: rough(rates.jerk) }
    }
}

/// A limit of the path parameter, Q60, and the same as a rough number, exactly.
fn limit(rate: Rough) -> (i64, Rough) {
    let whole = rate.min(Rough::ONE).floor(60).max(1);
    (whole as i64, Rough::up(whole, 60))
}

impl Grant {
    /// Becomes the fastest limits of a path whose motors stay within `available` and whose logical axes within `wanted`
    /// (nm and nrad per segment^k), along `direction` (nm or nrad per path unit, Q32).
    pub fn within(
        &mut self,
        bounds: &Bounds,
        available: &[Rates; AXES],
        wanted: &[Rates; AXES],
        direction: &[i64; AXES],
        others: Turning,
        crossed: &dyn Fn(usize, u128) -> u64,
    ) {
        let mut left = [Least::default(); AXES];
        let (mut velocity, mut square, mut cube) = (Rough::ONE, Rough::ONE, Rough::ONE);
        let (mut acceleration, mut jerk) = (Rough::ONE, Rough::ONE);
        for (i, left) in left.iter_mut().enumerate() {
            *left = Least::from(&available[i]);
            if direction[i] != 0 {
                let (way, wanted) = (Rough::up(direction[i].unsigned_abs(), 32), Least::from(&wanted[i]));
                velocity = velocity.least(wanted.velocity, way);
                acceleration = acceleration.least(wanted.acceleration, way);
                jerk = jerk.least(wanted.jerk, way);
            }
            // at most a quarter of the acceleration for curvature v^2, an eighth of the jerk for third v^3
            square = square.least(left.acceleration.shifted(-2), bounds.curvature[i]);
            cube = cube.least(left.jerk.shifted(-3), bounds.third[i]);
        }
        velocity = velocity.min(square.root_down()).min(cube.cube_root_down());
        let (whole, velocity) = limit(not_too_steep(velocity, bounds, &left));
        self.limits.velocity = whole;
        (self.swing, self.bent) = (0, 0);
        self.turning.velocity = turning(bounds, velocity);
        let square = velocity.times_up(velocity);
        let alone = others.velocity == 0 || self.turning.velocity == 0;
        // two rotations at once: 2 r w1 w2 of acceleration on every linear motor, less on rotary ones
        let crossed_a = 2 * u128::from(self.turning.velocity) * u128::from(others.velocity);
        for (i, left) in left.iter().enumerate() {
            let own = bounds.curvature[i].times_up(square);
            let mut bends = own.min(left.acceleration.shifted(-1));
            let mut uses = own;
            if !alone {
                let crossed = Rough::up(crossed(i, crossed_a), RATE_BITS as i32);
                (bends, uses) = (bends.plus_up(crossed), uses.plus_up(crossed));
            }
            self.uses[i].acceleration = uses.ceil(RATE_BITS as i32);
            acceleration = acceleration.least(left.acceleration.minus_down(bends), bounds.slope[i]);
            // 3 m'' v a at most a quarter of the jerk
            let per = bounds.curvature[i].times_up(velocity).times_up(TWELVE);
            acceleration = acceleration.least(left.jerk, per);
        }
        let (whole, acceleration) = limit(acceleration);
        self.limits.acceleration = whole;
        self.turning.acceleration = turning(bounds, acceleration);
        // 3 r (w1 a2 + a1 w2); the term 3 r w1 w2 (w1 + w2) is below a thousandth of it and covered by the quarter in `bent`
        let crossed_j = 3
            * (u128::from(self.turning.velocity) * u128::from(others.acceleration)
                + u128::from(self.turning.acceleration) * u128::from(others.velocity));
        let cube = velocity.times_up(square);
        let mixed = velocity.times_up(acceleration).times_up(THREE);
        for (i, left) in left.iter().enumerate() {
            let mut bends = bounds.curvature[i].times_up(mixed).plus_up(bounds.third[i].times_up(cube));
            if !alone {
                bends = bends.plus_up(Rough::up(crossed(i, crossed_j), RATE_BITS as i32));
            }
            self.uses[i].jerk = bends.ceil(RATE_BITS as i32);
            jerk = jerk.least(left.jerk.minus_down(bends), bounds.slope[i]);
        }
        let (whole, jerk) = limit(jerk);
        self.limits.jerk = whole;
        self.turning.jerk = turning(bounds, jerk);
        for (i, uses) in self.uses.iter_mut().enumerate() {
            let along = |rate| bounds.slope[i].times_up(rate).ceil(RATE_BITS as i32);
            // where the path is steeper than the velocity allows it is slower, see `not_too_steep`
            uses.velocity = along(velocity).min(available[i].velocity);
            uses.acceleration = uses.acceleration.saturating_add(along(acceleration));
            uses.jerk = uses.jerk.saturating_add(along(jerk));
        }
    }
}

const THREE: Rough = Rough::down(3, 0);
const TWELVE: Rough = Rough::down(12, 0);

/// The smaller of `most` and of the path velocity at which no motor is too fast. A path from rest to rest whose
/// acceleration stays below a goes at most at sqrt(2 a d) where the nearer of its ends is d away: stretches that are
/// steep, but too near to an end to be reached at full speed, do not slow it down.
fn not_too_steep(most: Rough, bounds: &Bounds, lefts: &[Least; AXES]) -> Rough {
    let near_rest = bounds.rests && bounds.stretches != 0;
    let mut velocity = most;
    let mut reached = None;
    for (i, left) in lefts.iter().enumerate() {
        let anywhere = velocity.least(left.velocity, bounds.slope[i]);
        if anywhere == velocity || !near_rest {
            velocity = anywhere;
            continue;
        }
        let reached = reached.get_or_insert_with(|| velocities_reached(bounds, lefts));
        for (distance, reached) in (1..=bounds.stretches / 2).zip(reached.iter()) {
            let slope = bounds.slope_at(distance, i);
            let lower = velocity.least(left.velocity, slope);
            if lower < velocity && slope.times_up(*reached) > left.velocity {
                velocity = lower;
            }
        }
    }
    velocity
}

/// The highest path velocity in the stretches at each distance from the ends of a path from rest to rest.
fn velocities_reached(bounds: &Bounds, lefts: &[Least; AXES]) -> [Rough; MOST_STRETCHES / 2] {
    // never less than the acceleration that will be granted
    let least = |most: Rough, (i, left): (usize, &Least)| most.least(left.acceleration, bounds.slope[i]);
    let most = lefts.iter().enumerate().fold(Rough::ONE, least).shifted(1);
    let first = most.times_up(bounds.stretch).root_up();
    ROOTS.map(|root| first.times_up(root))
}

/// The roots of 1 to 4, not below them.
const ROOTS: [Rough; MOST_STRETCHES / 2] =
    [Rough::ONE, Rough::up(1_518_500_250, 30), Rough::up(1_859_775_394, 30), Rough::up(2, 0)];

/// nrad per path unit times a path rate: nrad in Q20, rounded up.
fn turning(bounds: &Bounds, rate: Rough) -> u64 {
    Rough::up(bounds.turning, 0).times_up(rate).ceil(20)
}
