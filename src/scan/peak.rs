//! The maximum of a curve in dB: a parabola by least squares, in integers.
//!
//! A Gaussian beam over a Gaussian fibre is a parabola in dB (docs: the power falls by 4.343 (d/w)^2 dB). It is fitted to
//! the points near the greatest one, those within 3 dB of it, and more where these are too few. With the sums
//! m_k = sum u^k / n and t_k = sum u^k y / n of centred, scaled positions u the normal equations are solved by
//! determinants; the common divisor cancels in the position of the maximum -c1 / (2 c2).
//!
//! # Numbers
//! |u| <= 2^16 by a shift, levels in millionths of a dB from the greatest one within 2^26: every determinant and every
//! sum of three products stays below 2^124.

use super::samples::{CAPACITY, Point};
use crate::sense::{DARK, DB};
use crate::units::rough::Rough;
use crate::units::wide;

/// Half width of the scaled positions, bits.
const SCALE: u32 = 16;
/// Largest depth of a level, millionths of a dB.
const LEVELS: i32 = 1 << 26;
/// Least divisor: points that are spread over the whole half width give 2^91.
const LEAST_DIVISOR: i128 = 1 << 84;
/// Points that a fit should have.
const ENOUGH: usize = 5;
/// Depth below the greatest point within which points belong to the peak.
const DEPTH: i32 = 3 * DB;
/// Fits after each of which points are left out that do not belong.
const ROUNDS: usize = 4;
/// Beyond so many standard deviations of the rest a point does not belong.
const STRAY: u64 = 4;
/// What is left over of a point that always belongs, squared: a thousandth of a dB.
const ALWAYS: u128 = 1_000_000;
/// A curvature counts from so many of its standard deviations on.
const CURVED: u64 = 6;

/// A maximum.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Peak {
    /// Where, nm or nrad from where the scan began.
    pub x: i32,
    /// Its standard uncertainty, from what is left over; none with three points alone.
    pub sigma: Option<u32>,
    /// Level, millionths of a dBm.
    pub level: i32,
    /// It lies outside of the points, or no parabola that opens downwards fits: the greatest point then.
    pub edge: bool,
    /// Points were left out.
    pub strays: bool,
}

/// Which points belong.
type Mask = [u32; CAPACITY / 32];

fn has(mask: &Mask, n: usize) -> bool {
    mask.get(n / 32).is_some_and(|word| word >> (n % 32) & 1 != 0)
}

fn set(mask: &mut Mask, n: usize, on: bool) {
    if let Some(word) = mask.get_mut(n / 32) {
        *word = *word & !(1 << (n % 32)) | u32::from(on) << (n % 32);
    }
}

/// The middle one of a point's level and its neighbours': a single stray is no maximum.
fn calm(points: &[Point], n: usize) -> i32 {
    let level = |n: usize| points.get(n).map(|point| point.1);
    let own = level(n).unwrap_or(DARK);
    match (n.checked_sub(1).and_then(level), level(n + 1)) {
        (Some(a), Some(b)) => own.max(a.min(b)).min(a.max(b)),
        (Some(other), None) | (None, Some(other)) => own.min(other),
        (None, None) => own,
    }
}

/// The greatest point, strays aside.
fn greatest(points: &[Point]) -> Option<usize> {
    (0..points.len()).max_by_key(|n| (calm(points, *n), points.get(*n).map(|point| point.1)))
}

/// The points around the greatest one down to a depth: to either side until two in a row lie below.
fn around(points: &[Point], top: usize, depth: i32) -> (Mask, usize) {
    let mut mask = Mask::default();
    let floor = calm(points, top).saturating_sub(depth);
    let mut count = 0;
    let mut go = |range: &mut dyn Iterator<Item = usize>| {
        let mut below = 0;
        for n in range {
            let belongs = points.get(n).is_some_and(|point| point.1 >= floor);
            below = if belongs { 0 } else { below + 1 };
            if below >= 2 {
                break;
            }
            set(&mut mask, n, belongs);
            count += usize::from(belongs);
        }
    };
    go(&mut (top..points.len()));
    go(&mut (0..top).rev());
    (mask, count)
}

/// How far a level lies from the greatest one.
fn below(y: i32, highest: i32) -> i32 {
    y.saturating_sub(highest).clamp(-LEVELS, LEVELS)
}

fn rough(x: i128) -> Rough {
    Rough::wide_up(x.max(0).unsigned_abs())
}

/// Coefficients of a parabola through scaled positions.
struct Fit {
    /// Numerators of c0, c1 and c2, and their divisor.
    n: [i128; 3],
    divisor: i128,
    /// m_1 .. m_4.
    m: [i128; 5],
    count: i64,
}

/// Scaled positions: `(x - middle) * 2^up`, shifted down where `up` is negative.
#[derive(Clone, Copy)]
struct Scale {
    middle: i32,
    up: i32,
}

impl Scale {
    fn of(points: &[Point], mask: &Mask) -> Option<Scale> {
        let used = || points.iter().enumerate().filter(|(n, _)| has(mask, *n)).map(|(_, point)| point.0);
        let (least, most) = (used().min()?, used().max()?);
        let half = (i64::from(most) - i64::from(least)).unsigned_abs() / 2 + 1;
        let bits = 64 - half.leading_zeros() as i32;
        Some(Scale { middle: least.midpoint(most), up: SCALE as i32 - bits })
    }

    fn scaled(&self, x: i32) -> i64 {
        let u = i64::from(x) - i64::from(self.middle);
        if self.up < 0 { (u + (1 << (-self.up - 1))) >> -self.up } else { u << self.up }
    }

    /// Back to nm or nrad, from Q4.
    fn real(&self, u_q4: i64) -> i32 {
        let down = self.up + 4;
        let x = if down > 0 { (u_q4 + (1 << (down - 1))) >> down } else { u_q4 << -down };
        (i64::from(self.middle) + x).clamp(i32::MIN.into(), i32::MAX.into()) as i32
    }
}

#[inline(never)]
fn fit(points: &[Point], mask: &Mask, scale: Scale, top: i32) -> Option<Fit> {
    let mut sums = [0i128; 8];
    for (_, (x, y)) in points.iter().enumerate().filter(|(n, _)| has(mask, *n)) {
        let (mut power, u, y) = (1i128, i128::from(scale.scaled(*x)), i128::from(below(*y, top)));
        for k in 0..5 {
            sums[k] += power;
            if k < 3 {
                sums[5 + k] += power * y;
            }
            power *= u;
        }
    }
    let count = sums[0];
    if count < 3 {
        return None;
    }
    let mean = sums.map(|sum| wide::signed_div(sum, count));
    let [_, m1, m2, m3, m4, t0, t1, t2] = mean;
    let (a, b, c) = (m2 * m4 - m3 * m3, m2 * m3 - m1 * m4, m1 * m3 - m2 * m2);
    let (d, e, f) = (m4 - m2 * m2, m1 * m2 - m3, m2 - m1 * m1);
    let divisor = a + m1 * b + m2 * c;
    let n = [t0 * a + t1 * b + t2 * c, t0 * b + t1 * d + t2 * e, t0 * c + t1 * e + t2 * f];
    (divisor >= LEAST_DIVISOR).then_some(Fit { n, divisor, m: [1, m1, m2, m3, m4], count: count as i64 })
}

impl Fit {
    /// c0 in millionths of a dB, c1 in Q30 and c2 in Q48 of that per scaled unit.
    fn coefficients(&self) -> [i128; 3] {
        // a determinant has far more digits than its quotient
        let bits = 128 - self.divisor.leading_zeros();
        let down = bits.saturating_sub(70);
        let by = self.divisor >> down;
        let part = |n: i128, up: u32| wide::signed_div((n >> down) << up, by);
        [part(self.n[0], 0), part(self.n[1], 30), part(self.n[2], 48)]
    }

    /// The curvature is more than noise would give: var(c2) = variance / n * (m2 - m1^2) / divisor.
    #[inline(never)]
    fn is_curved(&self, c: &[i128; 3], variance: u128) -> bool {
        let [_, m1, m2, ..] = self.m;
        let noise = Rough::wide_up(variance).times_up(rough(m2 - m1 * m1)).over_up(rough(self.divisor));
        let noise = noise.over_up(Rough::up(self.count.unsigned_abs(), 0)).root_up();
        noise.times_up(Rough::up(CURVED, 0)).shifted(48) < rough(-c[2])
    }

    /// What is left over of a point.
    fn rest(c: &[i128; 3], u: i64, y: i64) -> i64 {
        let u = i128::from(u);
        let model = c[0] + ((c[1] * u) >> 30) + (((c[2] * u) >> 16) * u >> 32);
        (i128::from(y) - model).clamp(-(1 << 31), 1 << 31) as i64
    }
}

/// The peak of points in the order of their positions. None: fewer than three.
#[inline(never)]
pub fn find(points: &[Point]) -> Option<Peak> {
    let top = greatest(points)?;
    if points.len() < 3 {
        return None;
    }
    let at_top = Peak { x: points.get(top)?.0, sigma: None, level: points.get(top)?.1, edge: true, strays: false };
    let highest = calm(points, top);
    let mut depth = DEPTH;
    let (mut mask, mut count) = around(points, top, depth);
    while count < ENOUGH.min(points.len()) && depth < 30 * DB {
        depth *= 2;
        (mask, count) = around(points, top, depth);
    }
    let mut strays = false;
    for round in 1.. {
        let Some(scale) = Scale::of(points, &mask) else { return Some(at_top) };
        let Some(fit) = fit(points, &mask, scale, highest) else { return Some(at_top) };
        let c = fit.coefficients();
        let left = |(x, y): &Point| Fit::rest(&c, scale.scaled(*x), below(*y, highest).into());
        let used = || points.iter().enumerate().filter(|(n, _)| has(&mask, *n));
        let squares: u128 = used().map(|(_, point)| u128::from((left(point).unsigned_abs()).pow(2))).sum();
        let freedom = (fit.count - 3).max(0) as u64;
        let variance = wide::div(squares, u128::from(freedom.max(1)));
        // a stray among n points makes their deviation a part of it that goes with the root of n
        let limit = variance.saturating_mul(u128::from(STRAY * STRAY)).max(ALWAYS);
        let mut better = mask;
        for (n, point) in used() {
            if u128::from(left(point).unsigned_abs().pow(2)) > limit && freedom > 3 {
                set(&mut better, n, false);
            }
        }
        if better != mask && round < ROUNDS {
            (mask, strays) = (better, true);
            continue;
        }
        if c[2] >= 0 || !fit.is_curved(&c, variance) {
            return Some(Peak { strays, ..at_top });
        }
        let u_q4 = wide::signed_div(-(fit.n[1] >> 8) << 3, fit.n[2] >> 8);
        let bound = 1i128 << (SCALE + 8);
        let u_q4 = wide::within(u_q4, -bound, bound) as i64;
        let x = scale.real(u_q4);
        let (first, last) = (points.first()?.0, points.last()?.0);
        let (least, most) = (first.min(last), first.max(last));
        if x < least || x > most {
            return Some(Peak { strays, ..at_top });
        }
        let u = i128::from(u_q4);
        let gain = ((c[1] * u) >> 34) + (((c[2] * u) >> 20) * u >> 36);
        let level = (i128::from(highest) + c[0] + gain).clamp(DARK.into(), 2 * i128::from(DB) * 100) as i32;
        let sigma = (freedom > 0).then(|| uncertainty(&fit, &c, variance, u_q4, scale));
        // what is not known better than the points reach is no peak
        let reach = most.abs_diff(least);
        let edge = sigma.is_some_and(|sigma| sigma > reach / 4);
        return Some(if edge { Peak { strays, ..at_top } } else { Peak { x, sigma, level, edge, strays } });
    }
    None
}

/// Standard uncertainty of the position, nm or nrad: the slope's at the maximum over the curvature.
/// var(f') = variance / n * (4 u^2 (m2 - m1^2) + 4 u (m1 m2 - m3) + (m4 - m2^2)) / divisor, sigma = sqrt(var) / |2 c2|.
#[inline(never)]
fn uncertainty(fit: &Fit, c: &[i128; 3], variance: u128, u_q4: i64, scale: Scale) -> u32 {
    let [_, m1, m2, m3, m4] = fit.m;
    let u = i128::from(u_q4 >> 4);
    let spread = 4 * u * u * (m2 - m1 * m1) + 4 * u * (m1 * m2 - m3) + (m4 - m2 * m2);
    let slope = Rough::wide_up(variance).times_up(rough(spread)).over_up(rough(fit.divisor));
    let slope = slope.over_up(Rough::up(fit.count.unsigned_abs(), 0)).root_up();
    // c2 is Q48, and the scaled unit 2^up to a nm
    let curvature = rough(-2 * c[2]);
    let sigma = slope.shifted(48 - scale.up).over_up(curvature);
    sigma.ceil(0).min(u64::from(u32::MAX)) as u32
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::vec::Vec;

    /// Seeded numbers (xorshift64*).
    struct Random(u64);

    impl Random {
        fn bits(&mut self) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
        }
    }

    fn uniform(random: &mut Random) -> f64 {
        (random.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Normal by the sum of twelve.
    fn normal(random: &mut Random) -> f64 {
        (0..12).map(|_| uniform(random)).sum::<f64>() - 6.0
    }

    fn gaussian(positions: impl Iterator<Item = f64>, x0: f64, w: f64, noise: f64, random: &mut Random) -> Vec<Point> {
        let level = |x: f64| -20e6 - 4.342_944_8e6 * ((x - x0) / w).powi(2);
        positions
            .map(|x| (x.round() as i32, (level(x.round()) + noise * 1e6 * normal(random)).round() as i32))
            .collect()
    }

    #[test]
    fn the_peak_of_a_gaussian_is_found_at_any_scale_and_place() {
        let mut random = Random(1);
        for case in 0..3000 {
            let w = 10f64.powf(1.5 + 5.5 * uniform(&mut random));
            let half = w * (0.3 + 4.0 * uniform(&mut random));
            let x0 = half * (1.6 * uniform(&mut random) - 0.8);
            let count = 5 + (uniform(&mut random) * 250.0) as usize;
            let positions = (0..count).map(|n| -half + 2.0 * half * n as f64 / (count - 1) as f64);
            let points = gaussian(positions, x0, w, 0.0, &mut random);
            let peak = find(&points).unwrap();
            let room = 1.0 + half / 20_000.0 + 300.0 / w;
            assert!(!peak.edge && (f64::from(peak.x) - x0).abs() <= room, "{case}: w {w} half {half} x0 {x0} {peak:?}");
            assert!((f64::from(peak.level) + 20e6).abs() < 1000.0 + 1e6 / w, "{case}: w {w} {peak:?}");
        }
    }

    #[test]
    fn its_uncertainty_is_the_scatter_that_it_has() {
        let mut random = Random(3);
        for (count, noise) in [(9, 0.003), (21, 0.003), (101, 0.01), (250, 0.003)] {
            let (mut squares, mut told, runs) = (0.0, 0.0, 1000);
            for _ in 0..runs {
                let x0 = 800.0 * (uniform(&mut random) - 0.5);
                let positions = (0..count).map(|n| -4000.0 + 8000.0 * n as f64 / (count - 1) as f64);
                let points = gaussian(positions, x0, 5000.0, noise, &mut random);
                let peak = find(&points).unwrap();
                squares += (f64::from(peak.x) - x0).powi(2);
                told += f64::from(peak.sigma.unwrap());
            }
            let (scatter, told) = ((squares / runs as f64).sqrt(), told / runs as f64);
            assert!((told - scatter).abs() < 0.12 * scatter + 1.0, "{count}: {scatter} {told}");
        }
    }

    #[test]
    fn strays_are_left_out() {
        let mut random = Random(5);
        let mut missed = 0;
        for case in 0..500 {
            let positions = (0..200).map(|n| -10_000.0 + 100.0 * n as f64);
            let x0 = 8000.0 * (uniform(&mut random) - 0.5);
            let mut points = gaussian(positions, x0, 5000.0, 0.003, &mut random);
            for _ in 0..4 {
                let at = (uniform(&mut random) * 200.0) as usize;
                points[at].1 += if uniform(&mut random) < 0.5 { 2_000_000 } else { -30_000_000 };
            }
            let peak = find(&points).unwrap();
            // two of them side by side may look like a maximum of their own
            missed += u32::from(peak.edge);
            assert!(peak.edge || (f64::from(peak.x) - x0).abs() < 20.0, "{case}: {x0} {peak:?}");
        }
        assert!(missed <= 5, "{missed} of 500");
    }

    #[test]
    fn noise_alone_and_flanks_alone_are_no_peak() {
        let mut random = Random(7);
        let mut found = 0;
        for _ in 0..500 {
            let noise: Vec<Point> =
                (0..100).map(|n| (100 * n, -60_000_000 + (500_000.0 * normal(&mut random)) as i32)).collect();
            found += u32::from(!find(&noise).unwrap().edge);
        }
        assert!(found < 25, "{found} of 500");
        for x0 in [-30_000.0, 14_000.0] {
            let flank = gaussian((0..100).map(|n| 100.0 * n as f64), x0, 5000.0, 0.003, &mut random);
            let peak = find(&flank).unwrap();
            assert!(peak.edge && peak.x == if x0 < 0.0 { 0 } else { 9_900 }, "{peak:?}");
        }
        assert!(find(&[(0, 0), (1, 1)]).is_none());
        assert!(find(&[(5, 5); 100]).unwrap().edge);
        let extreme = [(i32::MIN, DARK), (0, 200 * DB), (i32::MAX, DARK)];
        assert!(find(&extreme).is_some());
    }
}
