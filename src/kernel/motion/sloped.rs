//! Stops whose hold is not level: they absorb the rounding of the durations where the cruise
//! velocity cannot, because there is hardly any cruise or the start already has that velocity.

use super::path::{Path, Point};
use super::ramp::{Rates, segments};
use super::search::solve;
use crate::units::wide;

/// By how much a stop is lengthened in turn, in segments: each leaves more room for the slope.
const LONGER: [u32; 12] = [0, 1, 2, 3, 4, 6, 9, 14, 21, 32, 64, 128];

/// Ramp to exactly `vc`, cruise for whole segments, and a stop that makes up for the rest.
pub(super) fn cruise(mut path: Path, vc: i128, way: i128, rates: &Rates) -> Option<Path> {
    if vc <= 0 {
        return None;
    }
    let up = rates.ramp(path.at.v, path.at.a, vc)?;
    path.push_ramp(up, vc)?;
    let [p, hold, _] = rates.symmetric(vc)?;
    LONGER.into_iter().find_map(|longer| {
        // A triangle has no hold to slope: its sides become longer too.
        let n = [p + longer.div_ceil(2), hold + longer.max(1), p + longer.div_ceil(2)];
        let stop = Point { s: 0, ..path.at }.after_ramp(n, 0)?.s;
        let left = way - path.at.s - stop;
        if left < 0 {
            return None;
        }
        let cruise = segments(wide::signed_div(left, vc))?;
        [cruise, cruise + 1].into_iter().find_map(|cruise| {
            let mut path = path;
            path.push(cruise, 0)?;
            stop_at(&path, n, way, rates)
        })
    })
}

/// The stop from the present state, without touching zero acceleration before its end.
pub(super) fn stop(path: Path, way: i128, rates: &Rates) -> Option<Path> {
    let n = rates.ramp(path.at.v, path.at.a, 0)?;
    let [n1, n2, n3] = n;
    // A stop that is already under way has the durations of its own plan left, which may be
    // shorter than those found afresh.
    let level = n1 + n2;
    for less in 0..4u32 {
        let middle = (level + 1).saturating_sub(less).max(1);
        let short = (n2 + 1).saturating_sub(less);
        for n in [[1, middle - 1, n3], [1, middle - 1, n3 + 1], [n1.max(1), short, n3]] {
            if let Some(found) = stop_at(&path, n, way, rates) {
                return Some(found);
            }
        }
    }
    for longer in LONGER {
        let half = longer.div_ceil(2);
        let hold = n2 + longer;
        for n in [
            [n1.max(1), hold, n3 + 1],
            [n1 + 1, hold.max(1), n3],
            [n1 + half, hold.max(1), n3 + half],
            [n1 + longer, n2.max(1), n3 + 1],
        ] {
            if let Some(found) = stop_at(&path, n, way, rates) {
                return Some(found);
            }
        }
    }
    None
}

/// The stop with these durations that ends exactly at `way`, if it keeps the limits.
#[inline(never)]
pub(super) fn stop_at(path: &Path, n: [u32; 3], way: i128, rates: &Rates) -> Option<Path> {
    let at = path.at;
    let [n1, n2, n3] = n;
    // The second corner follows from the first and the velocity.
    let known = -2 * at.v - wide::times(at.a, n1)?;
    let (before, behind) = (n1.checked_add(n2)?, i128::from(n2) + i128::from(n3));
    if behind == 0 {
        return None;
    }
    let second = |first: i128| Some(wide::signed_div(known.checked_sub(wide::times(first, before)?)?, behind));
    let end = |first: i128| at.after(n[0], first)?.after(n[1], second(first)?)?.after(n[2], 0);
    let first = solve(&|first| Some(end(first)?.s), at.a, way)?;
    let second = second(first)?;
    let corners = [at.a, first, second, 0];
    let steep =
        corners.windows(2).zip(n).any(|(a, n)| (a[1] - a[0]).abs() > wide::times(rates.j, n).unwrap_or(i128::MAX));
    if steep || first.abs().max(second.abs()) > rates.a {
        return None;
    }
    let mut path = *path;
    path.push(n[0], first)?;
    path.push(n[1], second)?;
    path.push(n[2], 0)?;
    path.at.v = 0;
    Some(path)
}
