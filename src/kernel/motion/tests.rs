//! Properties of profiles over seeded random plans.
extern crate std;

use super::plan::{to_position, to_velocity};
use super::profile::{COEFFICIENT_BITS, Phase, Profile, State};
use super::ramp::Limits;
use super::reference::Ideal;
use crate::random::Random;
use std::{eprintln, vec::Vec};

const ONE: f64 = (1u64 << 60) as f64;
const Q90: f64 = ONE * (1 << 30) as f64;

impl Random {
    fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }
    fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }
    /// Log-uniform.
    fn scale(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }
    fn below(&mut self, n: u32) -> u32 {
        (self.bits() % u64::from(n.max(1))) as u32
    }
    /// Any magnitude up to 2^60.
    fn any(&mut self) -> i64 {
        (1i64 << self.below(60)) + (self.bits() & 0xff) as i64
    }
    /// Limits of a stage: full speed over the path in 50 to 10^5 segments.
    fn limits(&mut self) -> Limits {
        let v = 1.0 / self.scale(50.0, 1e5);
        let a = v / self.scale(1.0, 5e3);
        let j = a / self.scale(1.0, 2e3);
        Limits { velocity: q60(v), acceleration: q60(a), jerk: q60(j) }
    }
}

fn q60(x: f64) -> i64 {
    (x * ONE) as i64
}

fn ideal(l: Limits) -> Ideal {
    Ideal { v: l.velocity as f64 / ONE, a: l.acceleration as f64 / ONE, j: l.jerk as f64 / ONE }
}

fn numbers(state: State) -> (f64, f64) {
    (state.velocity as f64 / Q90, state.acceleration as f64 / Q90)
}

/// Velocity, acceleration and jerk at `n` segments into a phase.
fn rates(phase: &Phase, n: f64) -> (f64, f64, f64) {
    let l = (1u64 << (32 - phase.shift)) as f64;
    let [_, c1, c2, c3] = phase.c.map(|c| c as f64 / (1u64 << COEFFICIENT_BITS) as f64);
    let t = n / l;
    let v = (c1 + t * (2.0 * c2 + t * 3.0 * c3)) / l;
    (v, (2.0 * c2 + 6.0 * c3 * t) / (l * l), 6.0 * c3 / (l * l * l))
}

/// Checks one profile against the limits and the state it starts from.
fn check(profile: &Profile, from: State, l: Limits) {
    let ideal = ideal(l);
    let (v0, a0) = numbers(from);
    let relative = 1.0 + 1.0 / (1 << 20) as f64;
    let tiny = 1.0 / (1u64 << 55) as f64;
    // A jerk that no whole segment can use forces more.
    let speed = ideal.v.max(v0.abs()).max(a0.abs());
    let ideal = Ideal { j: ideal.j.min(ideal.a.max(a0.abs())).min(speed), ..ideal };
    let v_most = ideal.v.max(v0.abs()).max((v0 + ideal.forced(a0)).abs()) * relative + tiny;
    let a_most = ideal.a.max(a0.abs()) * relative + tiny;
    assert_eq!(profile.position(0, &mut 0), from.position);
    let (mut start, mut before) = (0, (v0, a0));
    for (index, phase) in profile.phases[..usize::from(profile.count)].iter().enumerate() {
        let n = f64::from(phase.end - start);
        let (v, a, j) = rates(phase, 0.0);
        let end = rates(phase, n);
        assert!(j.abs() <= ideal.j * relative + tiny, "jerk {j} of {l:?} in {index}");
        assert!(a.abs() <= a_most && end.1.abs() <= a_most, "acceleration {a} of {l:?} in {index}");
        let turn = if j == 0.0 { 0.0 } else { (-a / j).clamp(0.0, n) };
        for v in [v, end.0, rates(phase, turn).0] {
            assert!(v.abs() <= v_most, "velocity {v} of {v_most} in {index}: {from:?} {l:?} {profile:?}");
        }
        assert!((v - before.0).abs() <= v_most * 1e-9 + tiny, "velocity jumps in {index}");
        assert!((a - before.1).abs() <= a_most * 1e-9 + tiny, "acceleration jumps in {index}");
        let alone = Profile { count: 1, last: 0, phases: [Phase { end: u32::MAX, ..*phase }; 12], ..*profile };
        if n < f64::from(1u32 << 30) && (n as u32) < 1 << (32 - phase.shift) {
            let reached = alone.position(phase.end - start, &mut 0);
            let next = profile.position(phase.end, &mut 0);
            assert!((reached - next).abs() <= 32, "position jumps by {} in {index}", reached - next);
        }
        (start, before) = (phase.end, (end.0, end.1));
    }
    let borders: Vec<u32> = if profile.duration < 200 {
        (0..profile.duration + 2).collect()
    } else {
        let step = profile.duration / 64;
        (0..64).map(|k| k * step).collect()
    };
    let mut cursor = 0;
    for n in borders {
        let (p, q) = (profile.position(n, &mut cursor), profile.position(n + 1, &mut cursor));
        assert!((q - p).abs() as f64 <= v_most * ONE + 40.0);
    }
}

fn check_target(profile: &Profile, target: i64) {
    for beyond in [0, 1, 1000, u32::MAX - profile.duration] {
        assert_eq!(profile.position(profile.duration + beyond, &mut 0), target);
        assert_eq!(profile.state(profile.duration + beyond), State::rest(target));
    }
    assert_eq!(profile.end_position(), target);
}

/// Duration in excess of the optimum: relative to the limit of 2 % and 6 segments.
#[derive(Default)]
struct Excess {
    plans: u32,
    over: u32,
    faster: u32,
    worst: f64,
    ratios: Vec<f64>,
    example: Option<(f64, f64, State, i64, Limits)>,
}

impl Excess {
    fn add(&mut self, profile: &Profile, best: f64, from: State, target: i64, l: Limits) {
        let taken = f64::from(profile.duration);
        self.faster += u32::from(taken < best * 0.999 - 0.1);
        let ratio = (taken - best) / (0.02 * best + 6.0);
        self.plans += 1;
        self.ratios.push(ratio);
        self.over += u32::from(ratio > 1.0);
        if ratio > self.worst {
            self.worst = ratio;
            self.example = Some((taken, best, from, target, l));
        }
    }
    fn report(&mut self, name: &str) {
        self.ratios.sort_by(f64::total_cmp);
        let at = |q: f64| self.ratios[((self.ratios.len() - 1) as f64 * q) as usize];
        eprintln!(
            "{name}: {} plans, {} faster, {} over 2 % + 6 segments; of that bound: median {:.3}, 99 % {:.3}, 99.9 % {:.3}, worst {:.3} {:?}",
            self.plans,
            self.faster,
            self.over,
            at(0.5),
            at(0.99),
            at(0.999),
            self.worst,
            self.example
        );
    }
}

fn plan_checked(state: State, target: i64, l: Limits, excess: &mut Excess) -> Profile {
    let (v, a) = numbers(state);
    let far = state.position as f64 / ONE + ideal(l).ramp(v, a, 0.0).1;
    if (far - state.position as f64 / ONE).abs() > 2.0 || far.abs() > 3.0 {
        return Profile::resting(target);
    }
    let profile =
        to_position(state, target, l).unwrap_or_else(|_| panic!("no plan from {state:?} to {target} with {l:?}"));
    check(&profile, state, l);
    check_target(&profile, target);
    let (v, a) = numbers(state);
    let best = ideal(l).time(v, a, (target - state.position) as f64 / ONE);
    excess.add(&profile, best, state, target, l);
    profile
}

#[test]
fn from_rest_every_plan_keeps_the_limits_and_is_near_the_optimum() {
    let mut random = Random(1);
    let mut excess = Excess::default();
    for _ in 0..100_000 {
        let l = random.limits();
        let target = q60(random.scale(1e-8, 1.0) * random.signed().signum());
        plan_checked(State::rest(0), target, l, &mut excess);
    }
    excess.report("from rest");
    assert_eq!(excess.over, 0);
}

#[test]
fn chains_of_new_targets_overrides_and_stops_keep_the_limits() {
    let mut random = Random(2);
    let mut kinds = [Excess::default(), Excess::default(), Excess::default(), Excess::default()];
    let mut stops = Excess::default();
    for _ in 0..15_000 {
        let base = random.limits();
        let mut l = base;
        let mut target = q60(random.unit());
        let mut profile = to_position(State::rest(0), target, l).unwrap();
        for _ in 0..10 {
            let state = profile.state(random.below(profile.duration + 1));
            let kind = random.below(5);
            match kind {
                0 => target = q60(random.unit()),
                1 => {}
                2 => target = state.position + q60(random.scale(1e-9, 1.0) * random.signed().signum()) / 2,
                _ => {
                    l = base;
                    l.velocity = (base.velocity as f64 * random.scale(0.02, 1.0)) as i64;
                }
            }
            target = target.clamp(-(1 << 60), 1 << 60);
            profile = if kind == 4 && random.below(2) == 0 {
                let v1 = if random.below(3) > 0 { 0 } else { q60(random.signed() * ideal(l).v) };
                let (v, a) = numbers(state);
                let far = state.position as f64 / ONE + ideal(l).ramp(v, a, v1 as f64 / ONE).1;
                let Ok(stop) = to_velocity(state, v1, l) else {
                    assert!(
                        (far - state.position as f64 / ONE).abs() > 2.0 || far.abs() > 3.0,
                        "no change from {state:?} to {v1} with {l:?}"
                    );
                    break;
                };
                check(&stop, state, l);
                stops.add(&stop, ideal(l).ramp(v, a, v1 as f64 / ONE).0, state, v1, l);
                if v1 == 0 {
                    check_target(&stop, stop.end_position());
                }
                stop
            } else {
                plan_checked(state, target, l, &mut kinds[kind.min(3) as usize])
            };
        }
    }
    kinds[0].report("new target");
    kinds[1].report("same target");
    kinds[2].report("near target");
    kinds[3].report("override");
    stops.report("stop, jog");
    assert_eq!(stops.over, 0);
    // Known gap: some re-plans of a deceleration under way take a longer way; see `plan`.
    for (kind, share) in kinds.iter().zip([0.001, 0.03, 0.002, 0.03]) {
        assert!(f64::from(kind.over) <= share * f64::from(kind.plans));
    }
}

#[test]
fn extreme_limits_and_states_never_panic() {
    let mut random = Random(3);
    let mut planned = 0;
    for _ in 0..100_000 {
        let l = Limits { velocity: random.any(), acceleration: random.any(), jerk: random.any() };
        let (v, a) = (i128::from(random.any()) << random.below(31), i128::from(random.any()) << random.below(31));
        let position = q60(3.9 * random.signed());
        let sign = |random: &mut Random| {
            if random.below(2) > 0 { -1 } else { i128::from(random.below(2)) }
        };
        let state = State { position, velocity: v * sign(&mut random), acceleration: a * sign(&mut random) };
        let target = q60(3.9 * random.signed());
        for profile in
            [to_position(state, target, l), to_velocity(state, target >> random.below(60), l)].into_iter().flatten()
        {
            planned += 1;
            check(&profile, state, l);
            if profile.end_velocity() == 0 {
                check_target(&profile, profile.end_position());
            }
        }
    }
    eprintln!("extremes: {planned} of 200000 planned");
}

#[test]
fn moves_as_slow_as_two_to_the_thirty_segments_end_exactly() {
    for (velocity, acceleration, jerk) in [(1 << 31, 1 << 60, 1 << 60), (1 << 31, 1 << 12, 1), (1 << 40, 1 << 16, 1)] {
        let l = Limits { velocity, acceleration, jerk };
        for target in [1, -1 << 59, 1 << 60] {
            let profile = to_position(State::rest(0), target, l).unwrap();
            check(&profile, State::rest(0), l);
            check_target(&profile, target);
        }
    }
}
