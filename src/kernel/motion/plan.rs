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
use super::ramp::{FARTHEST, FROM_Q60, FROM_Q90, Limits, Rates, Unplannable, segments, whole};
use crate::units::rough::Rough;
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
    let mut profile = Profile::default();
    velocity_profile(state, v1, limits, &mut profile).map(|()| profile).ok_or(Unplannable)
}

/// Moves to `target` (path, Q60) and ends there at rest, exactly, from any state.
///
/// Faster than the velocity limit, the profile first decelerates to it; too fast to stop before
/// the target, it overshoots and returns.
pub fn to_position(state: State, target: i64, limits: Limits) -> Result<Profile, Unplannable> {
    let mut profile = Profile::default();
    position_profile(state, target, limits, &mut profile).map(|()| profile).ok_or(Unplannable)
}

/// The start of a plan at path 0, refused where later sums could overflow.
#[inline(never)]
fn start(state: State) -> Option<Point> {
    let small = |x: i128| x.abs() <= 1 << 91;
    let ok = small(state.velocity) && small(state.acceleration) && state.position.abs() <= FARTHEST;
    ok.then_some(Point { s: 0, v: state.velocity << FROM_Q90, a: state.acceleration << FROM_Q90 })
}

/// [`to_velocity`], written over another profile: without a copy.
pub(super) fn velocity_profile(state: State, v1: i64, limits: Limits, profile: &mut Profile) -> Option<()> {
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
        let room = i128::from(FARTHEST) - RUN_ON_ROOM - wide::turned(end.into(), v1 < 0);
        let n = wide::signed_div(room.max(0), i128::from(v1.abs())).min(RUN_ON);
        path.push(segments(n)?, 0)?;
    }
    let last = state.position as i128 + (path.at.s >> FROM_Q60);
    path.finish(state.position, i64::try_from(last).ok()?, v1, false, profile)?;
    (profile.duration, profile.end_position) = (duration, end);
    Some(())
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
    let (n, swing) = rates.through_zero(path.at.a)?;
    path.push(n, swing)
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
    let (n, swing) = rates.through_zero(from.a)?;
    let a_most = rates.a.max(from.a.abs());
    let mut found = None;
    // The ninth way stops one segment short at full jerk and rounds that one off.
    for eighths in [0, 4, 8, 6, 7, 5, 2, 3, 1, 9] {
        let mut path = Path::new(from);
        if eighths == 9 {
            path.push(n - 1, swing + wide::turned(rates.j, from.a < 0))?;
        } else {
            path.push(n, wide::times(swing >> 3, eighths)?)?;
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
    Some(most + (most >> 28) + (1 << 30))
}

/// [`to_position`], written over another profile: without a copy.
pub(super) fn position_profile(state: State, target: i64, limits: Limits, profile: &mut Profile) -> Option<()> {
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
        return path.finish(state.position, target, 0, way < 0, profile);
    }
    let stop = change(from, 0, &rates)?;
    let rest = way - stop.at.s;
    if rest == 0 {
        return stop.finish(state.position, target, 0, false, profile);
    }
    let v_most = most(from, &rates)?;
    let a_most = rates.a.max(from.a.abs());
    let back = rest < 0;
    let mirrored = Point { s: 0, v: wide::turned(from.v, back), a: wide::turned(from.a, back) };
    let way = wide::turned(way, back);
    let keeps = |path: &Path| path.keeps(&rates, v_most, a_most);
    let mut found = None;
    // The shortest of them, the first of equals.
    let mut consider = |path: Path| {
        if found.is_none_or(|time| path.time < time) {
            let mut candidate = Profile::default();
            if path.finish(state.position, target, 0, back, &mut candidate).is_some() {
                *profile = candidate;
                found = Some(path.time);
            }
        }
    };
    for lead in [false, true] {
        if !lead || from.a != 0 {
            let direct = super::search::direct(Path::new(mirrored), way, rates, lead);
            direct.filter(keeps).into_iter().for_each(&mut consider);
        }
    }
    // Where a stop ends almost at the target, bending it there beats every other way.
    if rest.abs() < stop.at.s.abs() {
        let bent = super::sloped::stop(Path::new(mirrored), way, &rates);
        bent.filter(keeps).into_iter().for_each(&mut consider);
    }
    // Stop, then go: always possible, and the better way when the rest is tiny.
    let mut detour = if back { stop.mirrored() } else { stop };
    if rest_to_rest(&mut detour, rest.abs(), &rates).is_some() {
        consider(detour);
    }
    found.map(|_| ())
}

/// From rest to rest over `way > 0`.
///
/// The velocity is `way` smoothed by three boxes of p <= q segments and r >= p + q: r bounds the
/// velocity (way / r), q·r the acceleration and p·q·r the jerk.
fn rest_to_rest(path: &mut Path, way: i128, rates: &Rates) -> Option<()> {
    let [v, a, j] = [rates.v, rates.a, rates.j].map(|rate| Rough::wide_down(rate.unsigned_abs()));
    let d = Rough::wide_up(way.unsigned_abs());
    let up = |time: Rough| whole(time.ceil(0));
    let jerky = up(d.shifted(2).over_up(j).cube_root_up())?;
    let mut r = up(d.over_up(v))?.max(jerky);
    // Half of that r at full jerk would exceed the acceleration limit: it is held instead.
    if Rough::up(jerky.into(), 0).times_up(j) > a.shifted(1) {
        let p = a.over_up(j);
        let hold = p.times_up(p).plus_up(d.shifted(2).over_up(a));
        r = r.max(up(p.plus_up(hold.root_up()).shifted(-1))?);
    }
    for _ in 0..8 {
        // at most what the limits would be with these durations
        let over = |rate: Rough, n: u32| d.over_up(rate.times_down(Rough::down(n.into(), 0)));
        let q = up(over(a, r))?.max(up(over(j, r).root_up())?);
        let p = up(over(j, r).over_up(Rough::down(q.into(), 0)))?;
        if u64::from(p) + u64::from(q) <= u64::from(r) {
            let cruise = wide::over_small(way, r);
            let peak = wide::over_small(cruise, q);
            let (hold, cruising) = (q.checked_sub(p)?, r - p - q);
            for (n, a1) in [(p, peak), (hold, peak), (p, 0)] {
                path.push(n, a1)?;
            }
            path.at.v = cruise;
            for (n, a1) in [(cruising, 0), (p, -peak), (hold, -peak), (p, 0)] {
                path.push(n, a1)?;
            }
            path.at.v = 0;
            return Some(());
        }
        r = p.checked_add(q)?;
    }
    None
}
