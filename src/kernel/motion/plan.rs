//! Planning: from a state and a goal to a profile.
//!
//! All durations are whole segments. They are found first, from the ideal profile rounded up;
//! with them fixed the way is affine in the remaining amplitude, which is then solved exactly.
//! Candidates are compared by their duration; stop and rest-to-rest move always exists.
//!
//! Limitation: from rest, and for every change of velocity, the duration is within 2 % and 6
//! segments of the optimum in continuous time. Where a deceleration under way is re-planned, 2 to
//! 3 % of plans exceed that, because its exact way leaves whole segments no freedom.

use super::path::{Path, Point};
use super::profile::{Profile, State};
use super::ramp::{FARTHEST, FROM_Q60, FROM_Q90, Limits, Rates, Unplannable, segments};
use super::roots::{cbrt_up, sqrt_up};
use crate::units::wide;

/// Longest continuation of a jog behind its ramp, in segments.
const RUN_ON: i128 = 1 << 30;

/// Room in front of ±4 path at which the continuation of a jog ends, Q60.
const RUN_ON_ROOM: i128 = 1 << 56;

/// Changes the velocity to `v1` (path per segment, Q60; 0 is a stop) and ends there without
/// acceleration.
///
/// With `v1 = 0` the profile ends at rest. Otherwise it goes on at `v1`, for at most 2^30
/// segments or until just before ±4 path, and then stands: the caller re-plans before that.
/// `v1` beyond the velocity limit is cut to it.
pub fn to_velocity(state: State, v1: i64, limits: Limits) -> Result<Profile, Unplannable> {
    velocity_profile(state, v1, limits).ok_or(Unplannable)
}

/// Moves to `target` (path, Q60) and ends there at rest, exactly, from any state.
///
/// Faster than the velocity limit, the profile first decelerates to it; too fast to stop before
/// the target, it overshoots and returns.
pub fn to_position(state: State, target: i64, limits: Limits) -> Result<Profile, Unplannable> {
    position_profile(state, target, limits).ok_or(Unplannable)
}

/// The start of a plan at path 0, refused where later sums could overflow.
#[inline(never)]
fn start(state: State) -> Option<Point> {
    let small = |x: i128| x.abs() <= 1 << 91;
    let ok = small(state.velocity) && small(state.acceleration) && state.position.abs() <= FARTHEST;
    ok.then_some(Point { s: 0, v: state.velocity << FROM_Q90, a: state.acceleration << FROM_Q90 })
}

fn velocity_profile(state: State, v1: i64, limits: Limits) -> Option<Profile> {
    let from = start(state)?;
    let rates = Rates::of(limits)?.usable(from);
    let v1 = v1.clamp(-limits.velocity, limits.velocity);
    let mut path = change(from, i128::from(v1) << FROM_Q60, &rates)?;
    let way = (path.at.s + (1 << (FROM_Q60 - 1))) >> FROM_Q60;
    let end = state.position.checked_add(i64::try_from(way).ok()?)?;
    // The rounding of the end to Q60 is the position's, not the path's.
    path.at.s = (i128::from(end) - i128::from(state.position)) << FROM_Q60;
    let duration = path.time;
    if v1 != 0 {
        let room = i128::from(FARTHEST) - RUN_ON_ROOM - i128::from(v1.signum()) * i128::from(end);
        let n = wide::signed_div(room.max(0), i128::from(v1.abs())).min(RUN_ON);
        path.push(segments(n)?, 0)?;
    }
    let last = state.position as i128 + (path.at.s >> FROM_Q60);
    let profile = path.finish(state.position, i64::try_from(last).ok()?, v1, 1)?;
    Some(Profile { duration, end_position: end, ..profile })
}

/// The path of a velocity change.
#[inline(never)]
fn change(from: Point, v1: i128, rates: &Rates) -> Option<Path> {
    let v_most = most(from, rates)?;
    let a_most = rates.a.max(from.a.abs());
    for lead in [false, true] {
        let quick = quick_change(from, v1, rates, lead);
        if let Some(path) = quick.filter(|path| path.keeps(rates, v_most, a_most)) {
            return Some(path);
        }
    }
    let mut path = settled(from, rates, v_most)?;
    path.push_ramp(rates.symmetric(v1 - path.at.v)?, v1)?;
    Some(path)
}

#[inline(never)]
fn quick_change(from: Point, v1: i128, rates: &Rates, lead: bool) -> Option<Path> {
    let mut path = Path::new(from);
    if lead {
        lead_in(&mut path, rates)?;
    }
    path.push_ramp(rates.ramp(path.at.v, path.at.a, v1)?, v1)?;
    Some(path)
}

/// Takes the acceleration through zero at exactly full jerk: any milder slope would let the
/// velocity rise above what the state forces.
pub(super) fn lead_in(path: &mut Path, rates: &Rates) -> Option<()> {
    let a = path.at.a;
    let n = wide::signed_div_up(a.abs(), rates.j);
    path.push(segments(n)?, a - a.signum() * rates.j.checked_mul(n)?)
}

/// The path that only takes the acceleration to zero: always possible.
///
/// How far the acceleration swings through zero first decides both the extreme of the velocity
/// and its end; with ramps of a few segments neither full swing nor none need keep the limit.
#[inline(never)]
fn settled(from: Point, rates: &Rates, v_most: i128) -> Option<Path> {
    if from.a == 0 {
        return Some(Path::new(from));
    }
    let n = wide::signed_div_up(from.a.abs(), rates.j);
    let swing = from.a - from.a.signum() * rates.j.checked_mul(n)?;
    let a_most = rates.a.max(from.a.abs());
    let mut found = None;
    // The ninth way stops one segment short at full jerk and rounds that one off.
    for eighths in [0, 4, 8, 6, 7, 5, 2, 3, 1, 9] {
        let mut path = Path::new(from);
        if eighths == 9 {
            path.push(segments(n - 1)?, swing + from.a.signum() * rates.j)?;
        } else {
            path.push(segments(n)?, swing / 8 * eighths)?;
        }
        if path.at.a != 0 {
            path.push(1, 0)?;
        }
        found = Some(path);
        if path.keeps(rates, v_most, a_most) && path.at.v.abs() <= v_most {
            break;
        }
    }
    found
}

/// Largest speed a plan from this state may have: the limit, or what the state forces.
fn most(from: Point, rates: &Rates) -> Option<i128> {
    let forced = (from.v + rates.forced(from.a)?).abs();
    let most = rates.v.max(from.v.abs()).max(forced);
    // What the rounding of `forced` and of the state can add.
    Some(most + (most >> 40) + (1 << 30))
}

/// [`to_position`] without the copy that another type of answer takes.
pub(super) fn position_profile(state: State, target: i64, limits: Limits) -> Option<Profile> {
    let from = start(state)?;
    let rates = Rates::of(limits)?.usable(from);
    if target.abs() > FARTHEST {
        return None;
    }
    let way = (i128::from(target) - i128::from(state.position)) << FROM_Q60;
    if from.v == 0 && from.a == 0 {
        let mut path = Path::new(from);
        if way != 0 {
            rest_to_rest(&mut path, way.abs(), &rates)?;
        }
        return path.finish(state.position, target, 0, if way < 0 { -1 } else { 1 });
    }
    let stop = change(from, 0, &rates)?;
    let rest = way - stop.at.s;
    if rest == 0 {
        return stop.finish(state.position, target, 0, 1);
    }
    let v_most = most(from, &rates)?;
    let a_most = rates.a.max(from.a.abs());
    let sign = rest.signum();
    let mirrored = Point { s: 0, v: sign * from.v, a: sign * from.a };
    let finish = |path: Path, sign| path.finish(state.position, target, 0, sign);
    let direct = |lead| {
        super::search::direct(Path::new(mirrored), sign * way, rates, lead)
            .filter(|path| path.keeps(&rates, v_most, a_most))
            .and_then(|path| Some((path.time, finish(path, sign)?)))
    };
    let led = if from.a == 0 { None } else { direct(true) };
    // Where a stop ends almost at the target, bending it there beats every other way.
    let bent = (rest.abs() < stop.at.s.abs())
        .then(|| super::sloped::stop(Path::new(mirrored), sign * way, &rates))
        .flatten()
        .filter(|path| path.keeps(&rates, v_most, a_most))
        .and_then(|path| Some((path.time, finish(path, sign)?)));
    // Stop, then go: always possible, and the better way when the rest is tiny.
    let mut detour = if sign < 0 { stop.mirrored() } else { stop };
    let detour =
        rest_to_rest(&mut detour, rest.abs(), &rates).and_then(|()| Some((detour.time, finish(detour, sign)?)));
    [direct(false), led, bent, detour].into_iter().flatten().min_by_key(|found| found.0).map(|found| found.1)
}

/// From rest to rest over `way > 0`.
///
/// The velocity is `way` smoothed by three boxes of p <= q segments and r >= p + q: r bounds the
/// velocity (way / r), q·r the acceleration and p·q·r the jerk.
fn rest_to_rest(path: &mut Path, way: i128, rates: &Rates) -> Option<()> {
    let (v, a, j) = (rates.v.unsigned_abs(), rates.a.unsigned_abs(), rates.j.unsigned_abs());
    let d = way.unsigned_abs();
    let jerky = cbrt_up(wide::div_up(4 * d, j));
    let mut r = wide::div_up(d, v).max(u128::from(jerky));
    // Half of that r at full jerk would exceed the acceleration limit: it is held instead.
    if u128::from(jerky).checked_mul(j)? > 2 * a {
        let p = wide::div(a << 8, j);
        let hold = p.checked_mul(p)?.checked_add(wide::div_up(4 * d, a) << 16)?;
        r = r.max((p + u128::from(wide::isqrt(hold))).div_ceil(512));
    }
    for _ in 0..8 {
        let hold = wide::div_up(d, wide::product(a, r)?);
        let jr = wide::product(j, r)?;
        let q = hold.max(sqrt_up(wide::div_up(d, jr)));
        let p = wide::div_up(d, wide::product(jr, q).unwrap_or(u128::MAX));
        if p + q <= r {
            let cruise = wide::signed_div(way, r as i128);
            let peak = wide::signed_div(cruise, q as i128);
            let [pn, hold, cruising] = [p, q - p, r - p - q].map(|n| segments(n as i128));
            let (pn, hold, cruising) = (pn?, hold?, cruising?);
            for (n, a1) in [(pn, peak), (hold, peak), (pn, 0)] {
                path.push(n, a1)?;
            }
            path.at.v = cruise;
            for (n, a1) in [(cruising, 0), (pn, -peak), (hold, -peak), (pn, 0)] {
                path.push(n, a1)?;
            }
            path.at.v = 0;
            return Some(());
        }
        r = p + q;
    }
    None
}
