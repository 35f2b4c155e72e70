//! The maximum of a curve in dB: a parabola by least squares, in integers.
//!
//! A Gaussian beam over a Gaussian fibre is a parabola in dB (docs: the power falls by 4.343 (d/w)^2 dB). It is fitted to
//! the points near the greatest one, those within 3 dB of it, and more where these are too few. With the sums
//! m_k = sum u^k / n and t_k = sum u^k y / n of centred, scaled positions u the normal equations are solved by
//! determinants; the common divisor cancels in the position of the maximum -c1 / (2 c2).

use super::real::Real;
use super::samples::Point;
use crate::sense::{DARK, DB};

/// Points that a fit should have.
const ENOUGH: usize = 5;
/// Depth below the greatest point within which points belong to the peak.
const DEPTH: i32 = 3 * DB;
/// Fits after each of which points are left out that do not belong.
const ROUNDS: usize = 8;
/// Beyond so many standard deviations of the rest a point does not belong.
const STRAY: i64 = 3;
/// What is left over of a point that always belongs, squared: a thousandth of a dB.
const ALWAYS: i64 = 1_000_000;
/// A curvature counts from so many of its standard deviations on.
const CURVED: i64 = 6;

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

/// The points around the greatest one down to a level: to either side until two in a row lie below.
#[inline(never)]
fn around(points: &[Point], top: usize, floor: i32) -> (usize, usize) {
    let below = |n: usize| points.get(n).is_none_or(|point| point.1 < floor);
    let (mut first, mut end) = (top, top + 1);
    while first > 0 && !(below(first - 1) && (first < 2 || below(first - 2))) {
        first -= 1;
    }
    while end < points.len() && !(below(end) && below(end + 1)) {
        end += 1;
    }
    (first, end)
}

/// Coefficients of `c0 + c1 u + c2 u^2` in millionths of a dB from the greatest point, u in nm or nrad from the middle, and
/// what they are made of.
struct Fit {
    /// Least and largest position.
    reach: (i32, i32),
    middle: i32,
    c: [Real; 3],
    /// m_2 - m_1^2, m_1 m_2 - m_3, m_4 - m_2^2.
    spread: [Real; 3],
    divisor: Real,
    count: i32,
}

/// Of the points that are not below a level. None: fewer than three, or all in one place.
#[inline(never)]
fn fit(points: &[Point], floor: i32, top: i32) -> Option<Fit> {
    let (first, last) = (points.first()?.0, points.last()?.0);
    let (middle, reach) = (first.midpoint(last), (first.min(last), first.max(last)));
    let mut sums = [Real::ZERO; 8];
    let mut count = 0;
    for (x, y) in points {
        if *y < floor {
            continue;
        }
        let u = Real::whole(i64::from(*x) - i64::from(middle));
        let (mut power, y) = (Real::whole(1), Real::whole(i64::from(*y) - i64::from(top)));
        for k in 0..5 {
            sums[k] = sums[k].plus(power);
            if k < 3 {
                sums[5 + k] = sums[5 + k].plus(power.times(y));
            }
            power = power.times(u);
        }
        count += 1;
    }
    let [_, m1, m2, m3, m4, t0, t1, t2] = sums.map(|sum| sum.over(sums[0]));
    let product = |a: Real, b: Real, c: Real, d: Real| a.times(b).minus(c.times(d));
    let (a, b, c) = (product(m2, m4, m3, m3), product(m2, m3, m1, m4), product(m1, m3, m2, m2));
    let spread @ [f, e, d] =
        [m2.minus(m1.times(m1)), product(m1, m2, m3, Real::whole(1)), product(m4, Real::whole(1), m2, m2)];
    let three = |p: Real, q: Real, r: Real| t0.times(p).plus(t1.times(q)).plus(t2.times(r));
    let divisor = a.plus(m1.times(b)).plus(m2.times(c));
    // points in two places have rounding errors for a divisor
    let least = f.times(f).times(f).times(Real::new(1, -16));
    if count < 3 || !least.minus(divisor).is_negative() {
        return None;
    }
    let c = [three(a, b, c), three(b, d, e), three(c, e, f)].map(|n| n.over(divisor));
    Some(Fit { reach, middle, c, spread, divisor, count })
}

impl Fit {
    /// The parabola at a distance from the middle.
    #[inline(never)]
    fn at(&self, u: Real) -> Real {
        self.c[0].plus(u.times(self.c[1].plus(u.times(self.c[2]))))
    }

    /// What is left over of a point, millionths of a dB.
    fn left(&self, (x, y): &Point, top: i32) -> Real {
        let u = Real::whole(i64::from(*x) - i64::from(self.middle));
        Real::whole(i64::from(*y) - i64::from(top)).minus(self.at(u))
    }

    /// Variance of a coefficient or of a sum of them, by its part of the inverse of the normal equations.
    #[inline(never)]
    fn variance(&self, variance: Real, part: Real) -> Real {
        variance.times(part).over(self.divisor).over(Real::whole(self.count.into()))
    }
}

/// The peak of points in the order of their positions; the levels of those that do not belong are lost. None: fewer than
/// three.
#[inline(never)]
pub fn find(points: &mut [Point]) -> Option<Peak> {
    let top = greatest(points)?;
    if points.len() < 3 {
        return None;
    }
    let (x, level) = *points.get(top)?;
    let mut peak = Peak { x, sigma: None, level, edge: true, strays: false };
    let highest = calm(points, top);
    let (mut depth, enough) = (DEPTH, ENOUGH.min(points.len()));
    let (first, end) = loop {
        let (first, end) = around(points, top, highest - depth);
        if end - first >= enough || depth > 30 * DB {
            break (first, end);
        }
        depth *= 2;
    };
    let floor = highest - depth;
    let points = points.get_mut(first..end)?;
    for _ in 0..ROUNDS {
        let Some(fit) = fit(points, floor, highest) else { break };
        let mut squares = Real::ZERO;
        for point in points.iter().filter(|point| point.1 >= floor) {
            let left = fit.left(point, highest);
            squares = squares.plus(left.times(left));
        }
        let freedom = fit.count - 3;
        let variance = squares.over(Real::whole(freedom.max(1).into()));
        let limit = variance.times(Real::whole(STRAY * STRAY)).plus(Real::whole(ALWAYS));
        let mut fewer = false;
        for point in points.iter_mut().filter(|point| point.1 >= floor && freedom > 3) {
            let left = fit.left(point, highest);
            if limit.minus(left.times(left)).is_negative() {
                point.1 = i32::MIN;
                fewer = true;
            }
        }
        peak.strays |= fewer;
        if fewer {
            continue;
        }
        let [f, e, d] = fit.spread;
        let c2 = fit.c[2];
        // the curvature is more than noise would give: var(c2) = variance f / (n divisor)
        let noise = fit.variance(variance, f).root().times(Real::whole(CURVED));
        if !c2.plus(noise).is_negative() {
            break;
        }
        let u = fit.c[1].over(c2).times(Real::new(-1, -1));
        let x = u.plus(Real::whole(fit.middle.into())).rounded();
        let (least, most) = fit.reach;
        // var(f') = variance (4 u^2 f + 4 u e + d) / (n divisor), sigma = sqrt(var) / |2 c2|
        let twice = u.plus(u);
        let part = twice.times(twice.times(f)).plus(twice.times(e).plus(twice.times(e))).plus(d);
        let sigma = fit.variance(variance, part).root().over(c2.plus(c2)).rounded().unsigned_abs() + 1;
        // what is not known better than the points reach is no peak
        if x < least || x > most || sigma > most.abs_diff(least) / 4 + 1 {
            break;
        }
        let level = Real::whole(highest.into()).plus(fit.at(u)).rounded();
        return Some(Peak { x, sigma: (freedom > 0).then_some(sigma), level, edge: false, ..peak });
    }
    Some(peak)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::super::LEAST_POINTS;
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
            let mut points = gaussian(positions, x0, w, 0.0, &mut random);
            let peak = find(&mut points).unwrap();
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
                let mut points = gaussian(positions, x0, 5000.0, noise, &mut random);
                let peak = find(&mut points).unwrap();
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
            let peak = find(&mut points).unwrap();
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
            let mut noise: Vec<Point> =
                (0..100).map(|n| (100 * n, -60_000_000 + (500_000.0 * normal(&mut random)) as i32)).collect();
            found += u32::from(!find(&mut noise).unwrap().edge);
        }
        assert!(found < 25, "{found} of 500");
        let mut few = |count: i32| {
            let mut noise = |n| (100 * n, -60_000_000 + (500_000.0 * normal(&mut random)) as i32);
            (0..2000).filter(|_| !find(&mut (0..count).map(&mut noise).collect::<Vec<_>>()).unwrap().edge).count()
        };
        let found = [3, 4, LEAST_POINTS, 7, 9].map(&mut few);
        assert!(found[0] > 500 && found[2..].iter().all(|n| *n < 60), "{found:?} of 2000");
        for x0 in [-30_000.0, 14_000.0] {
            let mut flank = gaussian((0..100).map(|n| 100.0 * n as f64), x0, 5000.0, 0.003, &mut random);
            let peak = find(&mut flank).unwrap();
            assert!(peak.edge && peak.x == if x0 < 0.0 { 0 } else { 9_900 }, "{peak:?}");
        }
        assert!(find(&mut [(0, 0), (1, 1)]).is_none());
        assert!(find(&mut [(5, 5); 100]).unwrap().edge);
        let mut extreme = [(i32::MIN, DARK), (0, 200 * DB), (i32::MAX, DARK)];
        assert!(find(&mut extreme).is_some());
    }
}
