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
use crate::units::{AXES, FinePose};

/// Path position 1.0 in Q60.
pub const PATH_ONE: i64 = 1 << 60;

/// Samples of the law along a path that turns.
const SAMPLES: i64 = 8;

/// A path: where it begins, one path unit of it, and the stretch of path positions to look at.
#[derive(Clone, Copy, Debug)]
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
    /// The same for each stretch of a path that turns, from its beginning to its end; none where it is straight, or
    /// where others turn meanwhile.
    pub stretches: heapless::Vec<[u64; AXES], { SAMPLES as usize }>,
    /// The path begins and ends at rest at 0 and 1, and is never left beyond them.
    pub rests: bool,
    /// |m''|, steps per path unit squared, Q16.
    pub curvature: [u64; AXES],
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

/// `lever * (angle/10^9)^power`, in steps of `step_q32`, Q16, with a quarter added for what the bound leaves out
/// (tilted axes, the lever's own change).
fn bent(lever_nm: u64, angles: &[u64], step_q32: u64) -> u64 {
    let mut value = u128::from(lever_nm) << 28; // 2^-28 nm
    for angle in angles {
        value = value * u128::from(*angle) / 1_000_000_000 + 1;
    }
    let steps = value * 5 / 4 * (1 << 20) / u128::from(step_q32.max(1)); // Q28 * 2^20 / Q32 = Q16
    u64::try_from(steps + 1).unwrap_or(u64::MAX)
}

impl Bounds {
    /// Bounds along a path; `others` is the angular way (nrad) that other tracks may still turn meanwhile.
    pub fn along(law: &Law, path: &Path, others: u64) -> Self {
        let mut bounds = Bounds::default();
        let turning: u64 = path.direction[3..].iter().map(|d| (d.unsigned_abs() >> 32) + u64::from(*d != 0)).sum();
        bounds.turning = turning + turning / 32;
        let turns = turning != 0;
        let (lever, second) = (law.lever_nm(), law.second_order_bound());
        for i in 0..AXES {
            let step = law.step_q32(i);
            let angle = bounds.turning;
            if !turns {
                continue;
            }
            if i < 3 {
                bounds.curvature[i] = bent(lever, &[angle, angle], step);
                bounds.third[i] = bent(lever, &[angle, angle, angle], step);
            } else {
                // q'' = second * angle^2 in radians; `second` is per radian in Q32
                let nrad = (u128::from(second) * u128::from(angle) / 1_000_000_000 * u128::from(angle)) >> 32;
                bounds.curvature[i] = u64::try_from((nrad + 1) << 48).unwrap_or(u64::MAX) / step.max(1) + 1;
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
            law.motors(&pose, &mut remembered).0
        };
        let mut samples = [[0i64; AXES]; SAMPLES as usize + 1];
        let used = &mut samples[..=count as usize];
        for (k, sample) in (0..).zip(used.iter_mut()) {
            *sample = at(if k == count { path.to } else { path.from + stretch * k });
        }
        bounds.ends = [used[0], used[count as usize]];
        (bounds.lowest, bounds.highest) = (used[0], used[0]);
        if others == 0 && count > 1 {
            for i in 0..AXES {
                bounds.straighten(law, i, used, stretch);
            }
        }
        for pair in used.windows(2) {
            let before = core::mem::take(&mut bounds.slope);
            let [last, motors] = [pair[0], pair[1]];
            for i in 0..AXES {
                let way = motors[i].abs_diff(last[i]);
                // where it does not turn back, its ends are its extremes
                let between = bend_q32(bounds.curvature[i], stretch);
                let bulge = if turns && way / 2 <= between { (between / 4 + 1) as i64 } else { 0 };
                bounds.lowest[i] = bounds.lowest[i].min(motors[i].min(last[i]) - bulge);
                bounds.highest[i] = bounds.highest[i].max(motors[i].max(last[i]) + bulge);
                bounds.raise_slope(law, i, way, stretch, turns);
            }
            if others == 0 && count > 1 {
                let between = bounds.curvature.map(|curvature| product_q60(curvature, stretch) / 2);
                let steepest = core::array::from_fn(|i| bounds.slope[i].saturating_add(between[i]));
                let _ = bounds.stretches.push(steepest);
            }
            bounds.slope = core::array::from_fn(|i| bounds.slope[i].max(before[i]));
        }
        if !turns {
            // straight: one path unit gives the slope, the same for every stretch of it
            bounds.slope = [0; AXES];
            let (from, to) = (at(0), at(PATH_ONE));
            for i in 0..AXES {
                bounds.raise_slope(law, i, to[i].abs_diff(from[i]), PATH_ONE, false);
            }
        }
        for i in 0..AXES {
            let between = product_q60(bounds.curvature[i], stretch) / 2;
            bounds.slope[i] = bounds.slope[i].saturating_add(between);
            if turns && others != 0 {
                let step = law.step_q32(i);
                let more = if i < 3 {
                    bent(lever, &[bounds.turning, others], step)
                } else {
                    bent(second_nm(second), &[bounds.turning, others], step)
                };
                bounds.slope[i] = bounds.slope[i].saturating_add(more);
            }
            if bounds.lowest[i] >> 32 != bounds.highest[i] >> 32 {
                bounds.steps |= 1 << i;
            }
        }
        bounds
    }

    /// Angle by which the path turns in whole, nrad.
    pub fn swing(&self, path: &Path) -> u64 {
        if self.turning == 0 { 0 } else { product_q60(self.turning, path.to - path.from) + 1 }
    }

    /// Lowers the curvature of a motor to what samples `stretch` apart show.
    fn straighten(&mut self, law: &Law, i: usize, samples: &[[i64; AXES]], stretch: i64) {
        let second = |three: &[[i64; AXES]]| (three[2][i] - three[1][i]).abs_diff(three[1][i] - three[0][i]);
        let largest = samples.windows(3).map(second).max().unwrap_or(u64::MAX);
        // a second difference has four times the rounding of a sample
        let noise = (1u64 << 62) / law.step_q32(i).max(1);
        // Q32 steps over a stretch squared, to Q16 steps per path unit squared
        let sum = u128::from(largest) + u128::from(noise);
        let shown = over_stretch(over_stretch(sum << 60, stretch) << 44, stretch);
        let shown = u64::try_from(shown + 1).unwrap_or(u64::MAX);
        let apart = product_q60(self.third[i], stretch).saturating_mul(2).saturating_add(1);
        self.curvature[i] = self.curvature[i].min(shown.saturating_add(apart));
    }

    /// A motor goes `way` (Q32 steps) over a stretch of the path.
    fn raise_slope(&mut self, law: &Law, i: usize, way: u64, stretch: i64, turns: bool) {
        // the law's rounding: units in the last place where it is straight, a sixteenth nm or nrad where it turns
        let noise = if turns { (1u64 << 60) / law.step_q32(i).max(1) } else { 128 };
        if !turns && way <= noise {
            return;
        }
        // Q32 steps over a stretch in Q60, to Q16 steps per path unit
        let slope = over_stretch((u128::from(way) + u128::from(noise)) << 44, stretch) + 1;
        self.slope[i] = self.slope[i].max(u64::try_from(slope).unwrap_or(u64::MAX));
    }
}

/// Division by the length of a stretch (Q60), most often an eighth of a path unit: 128-bit divisions are slow.
fn over_stretch(value: u128, stretch: i64) -> u128 {
    let stretch = stretch.unsigned_abs().max(1);
    if stretch.is_power_of_two() { value >> stretch.trailing_zeros() } else { value / u128::from(stretch) }
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
    u64::try_from((u128::from(value) * u128::from(stretch.unsigned_abs())) >> 60).unwrap_or(u64::MAX)
}
