//! How steep the law is along a path: bounds on every motor's rates and range, in integers, conservative.
//!
//! A motor's position over the path parameter s has slope m', curvature m'' and third derivative m'''.
//! Linear axes make it straight; rotary ones bend it through the rotation centre: with a lever r and an angular
//! way theta per path unit, |c''| <= r theta^2 and |c'''| <= r theta^3 (sums over the rotary axes), to which the
//! second-order term of q_a adds its own part. The slope is taken from samples of the law itself; between two
//! samples h apart it differs from their mean by at most m'' h / 2. Where nothing else turns meanwhile the curvature
//! is taken from the samples too: a second difference is the curvature somewhere between its three samples, from
//! which it differs by at most m''' 2 h.

use crate::compensation::law::{Law, Remembered};
use crate::motion::track::scale;
use crate::units::{AXES, FinePose, wide};

/// Path position 1.0 in Q60.
pub const PATH_ONE: i64 = 1 << 60;

/// Samples of the law along a path that turns.
const SAMPLES: i64 = 8;
/// Stretches between the samples, at most.
pub const MOST_STRETCHES: usize = SAMPLES as usize;

/// A path: where it begins, one path unit of it, and the stretch of path positions to look at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Path {
    /// Pose at path position 0, nm and nrad in Q32.
    pub origin: FinePose,
    /// One path unit, nm and nrad in Q32.
    pub direction: [i64; AXES],
    /// Lowest path position, Q60.
    pub from: i64,
    /// Highest path position, Q60.
    pub to: i64,
}

/// Bounds of all motors along a path.
#[derive(Clone, Debug, Default)]
pub struct Bounds {
    /// |m'|, steps per path unit, Q16.
    pub slope: [u64; AXES],
    /// Ways of the motors over each stretch of a path that turns, from its beginning to its end, Q32 steps; none where
    /// it is straight, or where others turn meanwhile.
    pub ways: heapless::Vec<[u64; AXES], MOST_STRETCHES>,
    /// Length of a stretch, Q60.
    stretch: i64,
    /// Rounding of the law, Q32 steps.
    noise: [u64; AXES],
    /// The path begins and ends at rest at 0 and 1, and is never left beyond them.
    pub rests: bool,
    /// |m''|, steps per path unit squared, Q16.
    pub curvature: [u64; AXES],
    /// The same however others turn meanwhile.
    bent: [u64; AXES],
    /// |m'''|, steps per path unit cubed, Q16.
    pub third: [u64; AXES],
    /// Lowest motor position, Q32 steps, one half included.
    pub lowest: [i64; AXES],
    /// Highest motor position, Q32 steps, one half included.
    pub highest: [i64; AXES],
    /// Motor positions at the two ends of the stretch, Q32 steps, one half included.
    pub ends: [[i64; AXES]; 2],
    /// Bit n: motor n makes at least one step.
    pub steps: u8,
    /// Angular way of one path unit, nrad, summed over the rotary axes.
    pub turning: u64,
}

/// A length (2^-28 nm) turned by an angle (nrad), rounded up.
#[inline(never)]
fn turned(length: u128, angle: u64) -> u128 {
    wide::div(length * u128::from(angle), 1_000_000_000) + 1
}

/// A length (2^-28 nm) in steps of `step_q32`, Q16, with a quarter added for what the bound leaves out (tilted axes, the
/// lever's own change).
#[inline(never)]
fn in_steps(length: u128, step_q32: u64) -> u64 {
    let steps = wide::div(length * 5 / 4 * (1 << 20), u128::from(step_q32.max(1))); // Q28 * 2^20 / Q32 = Q16
    wide::narrow(steps + 1)
}

/// A lever in nm as 2^-28 nm.
fn fine(lever_nm: u64) -> u128 {
    u128::from(lever_nm) << 28
}

impl Bounds {
    /// Bounds along a path, while nothing else turns.
    pub fn along(law: &Law, path: &Path) -> Self {
        let mut bounds = Bounds::default();
        let turning: u64 = path.direction[3..].iter().map(|d| (d.unsigned_abs() >> 32) + u64::from(*d != 0)).sum();
        bounds.turning = turning + turning / 32;
        let turns = turning != 0;
        let (lever, second) = (fine(law.lever_nm()), law.second_order_bound());
        if turns {
            let angle = bounds.turning;
            let curvature = turned(turned(lever, angle), angle);
            let third = turned(curvature, angle);
            // q'' = second * angle^2 in radians; `second` is per radian in Q32
            let nrad = (wide::div(u128::from(second) * u128::from(angle), 1_000_000_000) * u128::from(angle)) >> 32;
            let nrad = wide::narrow((nrad + 1) << 48);
            for i in 0..AXES {
                let step = law.step_q32(i);
                if i < 3 {
                    (bounds.curvature[i], bounds.third[i]) = (in_steps(curvature, step), in_steps(third, step));
                } else {
                    bounds.curvature[i] = nrad / step.max(1) + 1;
                }
            }
        }
        // a milliradian bends the slope by less than a thousandth: samples would only add their rounding
        let count = if product_q60(turning, path.to - path.from) > 1_000_000 { SAMPLES } else { 1 };
        let stretch = (path.to - path.from) / count;
        let mut remembered = Remembered::default();
        let mut at = |s: i64| {
            let mut pose = path.origin;
            for (u, d) in pose.0.iter_mut().zip(&path.direction) {
                *u = u.saturating_add(scale(*d, s));
            }
            law.targets(&pose, &mut remembered).0
        };
        let mut samples = [[0i64; AXES]; SAMPLES as usize + 1];
        let used = samples.get_mut(..=count as usize).unwrap_or_default();
        for (k, sample) in (0..).zip(used.iter_mut()) {
            *sample = at(if k == count { path.to } else { path.from + stretch * k });
        }
        let (first, last) = (used.first().copied().unwrap_or_default(), used.last().copied().unwrap_or_default());
        bounds.ends = [first, last];
        (bounds.lowest, bounds.highest) = (first, first);
        bounds.stretch = stretch;
        bounds.bent = bounds.curvature;
        if count > 1 {
            (0..AXES).for_each(|i| bounds.straighten(law, i, used));
        }
        let mut ways = [0; AXES];
        let between = bounds.curvature.map(|curvature| bend_q32(curvature, stretch));
        for pair in used.windows(2) {
            let [last, motors] = *pair else { continue };
            let mut way = [0; AXES];
            for i in 0..AXES {
                way[i] = motors[i].abs_diff(last[i]);
                // where it does not turn back, its ends are its extremes
                let bulge = if turns && way[i] / 2 <= between[i] { (between[i] / 4 + 1) as i64 } else { 0 };
                bounds.lowest[i] = bounds.lowest[i].min(motors[i].min(last[i]) - bulge);
                bounds.highest[i] = bounds.highest[i].max(motors[i].max(last[i]) + bulge);
                ways[i] = ways[i].max(way[i]);
            }
            if count > 1 {
                let _ = bounds.ways.push(way);
            }
        }
        let mut over = stretch;
        if !turns {
            // straight: one path unit gives the slope, the same for every stretch of it
            let [from, to] = if (path.from, path.to) == (0, PATH_ONE) { bounds.ends } else { [at(0), at(PATH_ONE)] };
            ways = core::array::from_fn(|i| to[i].abs_diff(from[i]));
            over = PATH_ONE;
        }
        for (i, way) in ways.into_iter().enumerate() {
            bounds.noise[i] = if turns { (1 << 60) / law.step_q32(i).max(1) } else { 2 };
            bounds.slope[i] = if turns || way > bounds.noise[i] { slope(way, bounds.noise[i], over) } else { 0 };
            bounds.slope[i] = bounds.slope[i].saturating_add(product_q60(bounds.curvature[i], stretch) / 2);
            if bounds.lowest[i] >> 32 != bounds.highest[i] >> 32 {
                bounds.steps |= 1 << i;
            }
        }
        bounds
    }

    /// Lowers the curvature of a motor to what the samples show.
    fn straighten(&mut self, law: &Law, i: usize, samples: &[[i64; AXES]]) {
        let second = |three: &[[i64; AXES]]| match three {
            [a, b, c] => (c[i] - b[i]).abs_diff(b[i] - a[i]),
            _ => u64::MAX,
        };
        let largest = samples.windows(3).map(second).max().unwrap_or(u64::MAX);
        // a second difference has four times the rounding of a sample
        let noise = (1u64 << 62) / law.step_q32(i).max(1);
        // Q32 steps over a stretch squared, to Q16 steps per path unit squared
        let sum = u128::from(largest) + u128::from(noise);
        let shown = over_stretch(over_stretch(sum << 60, self.stretch) << 44, self.stretch);
        let apart = product_q60(self.third[i], self.stretch).saturating_mul(2).saturating_add(1);
        self.curvature[i] = self.curvature[i].min(wide::narrow(shown + 1).saturating_add(apart));
    }

    /// |m'| of a motor within one of the stretches of [`Bounds::ways`], steps per path unit in Q16.
    pub fn slope_within(&self, ways: &[u64; AXES], i: usize) -> u64 {
        slope(ways[i], self.noise[i], self.stretch).saturating_add(product_q60(self.curvature[i], self.stretch) / 2)
    }

    /// The same while other tracks may turn by `others` nrad, which bends the path.
    pub fn among(mut self, law: &Law, others: u64) -> Self {
        if self.turning == 0 || others == 0 {
            return self;
        }
        for i in 0..AXES {
            // where others turn meanwhile the samples do not show all of the curvature, nor where it is steep
            let hidden = self.bent[i] - self.curvature[i].min(self.bent[i]);
            let hidden = product_q60(hidden, self.stretch) / 2 + 1;
            self.curvature[i] = self.bent[i];
            let lever = if i < 3 { law.lever_nm() } else { second_nm(law.second_order_bound()) };
            let more = in_steps(turned(turned(fine(lever), self.turning), others), law.step_q32(i));
            self.slope[i] = self.slope[i].saturating_add(more).saturating_add(hidden);
        }
        self.ways.clear();
        self
    }

    /// Angle by which the path turns in whole, nrad.
    pub fn swing(&self, path: &Path) -> u64 {
        if self.turning == 0 { 0 } else { product_q60(self.turning, path.to - path.from) + 1 }
    }
}

/// Slope of a motor that goes at most `way` (Q32 steps) over stretches of the path, steps per path unit in Q16. `noise`:
/// the law's rounding, units in the last place where it is straight, a sixteenth nm or nrad where it turns.
#[inline(never)]
fn slope(way: u64, noise: u64, stretch: i64) -> u64 {
    // Q32 steps over a stretch in Q60, to Q16 steps per path unit
    wide::narrow(over_stretch((u128::from(way) + u128::from(noise)) << 44, stretch) + 1)
}

/// Division by the length of a stretch (Q60): a whole path is a power of two, and so is its eighth.
fn over_stretch(value: u128, stretch: i64) -> u128 {
    let stretch = stretch.unsigned_abs().max(1);
    if stretch.is_power_of_two() { value >> stretch.trailing_zeros() } else { wide::div(value, stretch.into()) }
}

/// The second-order term (per radian, Q32) as a lever in nm: what it makes of two angles is in nrad.
fn second_nm(second_q32: u64) -> u64 {
    ((u128::from(second_q32) * 1_000_000_000) >> 32) as u64 + 1
}

/// Curvature (Q16) times half the square of a stretch (Q60): Q32 steps.
fn bend_q32(curvature: u64, stretch: i64) -> u64 {
    product_q60(product_q60(curvature, stretch), stretch).saturating_mul(1 << 15)
}

/// `value` times a path stretch in Q60.
fn product_q60(value: u64, stretch: i64) -> u64 {
    wide::mul_shift(value, stretch.unsigned_abs(), 60)
}
