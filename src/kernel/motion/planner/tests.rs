//! Tracks that are planned again on their way never lead where nobody has checked the way.

use super::*;
use crate::compensation::calibration::{Calibration, MotorData, ScrewAxis};
use crate::compensation::law::Switches;
use crate::motion::limits::AxisLimits;
use crate::motion::plan::{to_position, to_velocity};

/// End of the travel on both sides, nm or nrad.
const END: i32 = 10_000_000;

/// One of its motors.
const MOTOR: MotorData = MotorData {
    step_q32: 100 << 32,
    row_bits: 36,
    backlash_steps: 0,
    travel_lower: -END,
    travel_upper: END,
    velocity: 49_800_000,
    acceleration: 10_470_000_000,
    jerk: 698_000_000_000,
};

/// A stiff stage without coupling: it takes some ten segments to its largest velocity.
fn stiff() -> Versioned<Capability> {
    let (motor, step_q32) = (MOTOR, MOTOR.step_q32);
    let axis = AxisLimits {
        soft_lower: -END,
        soft_upper: END,
        soft_on: true,
        travel_lower: -END,
        travel_upper: END,
        homed: true,
        enabled: true,
    };
    let rates = |step_q32| Rates::per_segment(motor.velocity, motor.acceleration, motor.jerk, step_q32);
    Versioned::new(Capability {
        law: Law::identity(&[motor; AXES]),
        motors: [rates(step_q32); AXES],
        wanted: [rates(1 << 32); AXES],
        limits: Limits([axis; AXES]),
        override_percent: 100,
    })
}

/// A planner whose orders are all accepted at once.
fn plan(planner: &mut Planner, capability: &Versioned<Capability>, segment: u64) {
    planner
        .plan(capability, segment, &mut |_| Some(Ordered { sequence: 1, at_once: false }))
        .expect("nothing in the way");
    planner.answer(1, 0, 0, segment);
}

/// Lowest and highest X from a segment on until everything has come to rest, and where that is; nm in Q32.
fn way(planner: &Planner, capability: &Versioned<Capability>, from: u64) -> (i64, i64, i64) {
    let (mut planner, mut segment) = (*planner, from);
    let (mut low, mut high) = (i64::MAX, i64::MIN);
    while planner.is_moving() {
        plan(&mut planner, capability, segment);
        let x = planner.pose_at(segment).0[0];
        (low, high, segment) = (low.min(x), high.max(x), segment + 1);
    }
    (low, high, planner.rest().0[0])
}

/// What rounding may add, nm in Q32: a millionth of a nanometre.
const ROUNDING: i64 = 4096;

#[test]
fn another_speed_on_the_way_never_leads_beyond_the_target() {
    let mut tempted = 0;
    for coordinated in [false, true] {
        for target in [85_763, 400_000] {
            let mut capability = stiff();
            let mut planner = Planner::at_rest(Pose::default());
            let pose = Pose([target, 0, 0, 0, 0, 0]);
            if coordinated {
                planner.go(pose, None)
            } else {
                planner.desire(Axis::X, Desire::Position(target, None))
            }
            plan(&mut planner, &capability, 0);
            let active = planner.slots[if coordinated { COORDINATED } else { 0 }].active().copied().expect("it moves");
            for segment in 1..active.end_segment() {
                for percent in [100, 40] {
                    let mut planner = planner;
                    capability.override_percent = percent;
                    let limits = with_speed(&active.grant, active.speed, percent);
                    let again = to_position(active.state(segment), active.goal, limits).expect("a profile");
                    tempted += u32::from(again.extent().1 > active.goal + ROUNDING);
                    planner.replan_all();
                    let (_, high, rest) = way(&planner, &capability, segment);
                    let goal = i64::from(target) << 32;
                    assert_eq!(rest, goal);
                    assert!(high <= goal + ROUNDING, "{} of {target} nm, {percent} % in {segment}", high >> 32);
                }
            }
        }
    }
    assert!(tempted > 20, "whole segments led beyond in {tempted} plans");
}

#[test]
fn a_stop_while_it_turns_back_stays_on_the_way_that_was_checked() {
    let capability = stiff();
    let mut tempted = 0;
    for turned in (20..140).step_by(9) {
        let mut planner = Planner::at_rest(Pose::default());
        planner.desire(Axis::X, Desire::Position(END, None));
        plan(&mut planner, &capability, 0);
        planner.desire(Axis::X, Desire::Position(-END, None));
        plan(&mut planner, &capability, turned);
        let active = planner.slots[0].active().copied().expect("it turns back");
        let (_, highest) = active.detour.expect("it turns back");
        assert!(active.track.profile.extent().1 <= highest + ROUNDING, "turned in {turned}");
        for segment in (turned + 1..turned + 100).step_by(3) {
            let mut planner = planner;
            let stop = to_velocity(active.state(segment), 0, active.grant.limits).expect("a stop");
            tempted += u32::from(stop.extent().1 > highest + ROUNDING);
            planner.stop(Axis::X);
            let (_, high, rest) = way(&planner, &capability, segment);
            assert!(high <= highest + ROUNDING, "{} of {} nm in {turned}, {segment}", high >> 32, highest >> 32);
            assert!(rest > i64::from(-END / 2) << 32, "it stops, in {turned}, {segment}");
        }
    }
    assert!(tempted > 20, "whole segments led beyond in {tempted} plans");
}

#[test]
fn an_axis_turns_back_only_where_it_can_do_so_within_its_limits() {
    let mut tempted = 0;
    for (soft_on, jog) in [(true, true), (true, false), (false, true), (false, false)] {
        let mut capability = stiff();
        for limits in &mut capability.limits.0 {
            limits.soft_on = soft_on;
        }
        let mut planner = Planner::at_rest(Pose::default());
        let upwards = Desire::Jog { upwards: true, limit: END, speed: u64::MAX };
        planner.desire(Axis::X, if jog { upwards } else { Desire::Position(END, None) });
        plan(&mut planner, &capability, 0);
        let active = planner.slots[0].active().copied().expect("it moves");
        let end = i64::from(END) << 32;
        // without soft limits the nearest whole step decides
        let room = if soft_on { ROUNDING } else { 51 << 32 };
        for segment in active.end_segment() - 200..active.end_segment() - 1 {
            let mut planner = planner;
            let stop = to_velocity(active.state(segment), 0, active.grant.limits).expect("a stop");
            tempted += u32::from(stop.extent().1 > end + room);
            let downwards = Desire::Jog { upwards: false, limit: -END, speed: u64::MAX };
            planner.desire(Axis::X, if jog { downwards } else { Desire::Position(END / 2, None) });
            let (low, high, _) = way(&planner, &capability, segment);
            assert!(low < end / 2 + ROUNDING, "it turned back, in {segment}");
            assert!(high <= end + room, "{} nm in {segment}, soft {soft_on}, jog {jog}", high >> 32);
            // a stop on the way back goes on to where it could stop before
            for later in segment..segment + 4 {
                plan(&mut planner, &capability, later);
            }
            planner.stop(Axis::X);
            let (_, high, _) = way(&planner, &capability, segment + 4);
            assert!(high <= end + room, "stopped at {} nm in {segment}, soft {soft_on}, jog {jog}", high >> 32);
        }
    }
    assert!(tempted > 20, "whole segments led beyond in {tempted} plans");
}

/// A fibre point 58.7 mm above the middle of the rotary stages, held while they turn.
fn with_lever() -> Versioned<Capability> {
    let mut capability = stiff();
    let one = 1 << 30;
    let unit = |i: usize| core::array::from_fn(|k| if k == i { one } else { 0 });
    let screw = |axis, i| ScrewAxis { axis, direction: unit(i), point: [0; 3] };
    let calibration = Calibration {
        name: *b"lever           ",
        order: Axis::ALL,
        motors: [MOTOR; AXES],
        inverse_slides: [[0; 3]; 3],
        rotary_gain: [0; 3],
        tilt: [[0; 3]; 3],
        second_order: [[0; 6]; 3],
        screws: [screw(Axis::Gamma, 2), screw(Axis::Beta, 1), screw(Axis::Alpha, 0)],
        home_rotation: [unit(0), unit(1), unit(2)],
        home_origin: [0, 0, 58_700_000 * 16],
        fibre_point: [0; 3],
    };
    let switches = Switches { coupling: false, ..Switches::default() };
    capability.law = Law::new(&calibration, switches, [0; 3]);
    for limits in &mut capability.limits.0 {
        (limits.soft_lower, limits.soft_upper) = (-87_266_463, 87_266_463);
        (limits.travel_lower, limits.travel_upper) = (-200_000_000, 200_000_000);
    }
    capability
}

#[test]
fn a_jog_that_turns_holds_what_it_needs_of_every_motor() {
    let mut capability = with_lever();
    assert!(capability.law.lever_nm() >= 58_700_000);
    for (axis, upwards) in Axis::ALL[3..].iter().flat_map(|axis| [(*axis, false), (*axis, true)]) {
        let mut pose = Pose([0, 0, 0, 40_000_000, 40_000_000, 40_000_000]);
        pose.0[axis.index()] = if upwards { -86_800_000 } else { 86_800_000 };
        // it may go a few milliradians only, far from the middle
        let own = &mut capability.limits.0[axis.index()];
        (own.soft_lower, own.soft_upper) = if upwards { (-87_266_463, -84_000_000) } else { (84_000_000, 87_266_463) };
        let mut planner = Planner::at_rest(pose);
        planner.desire(axis, Desire::Jog { upwards, limit: 0, speed: u64::MAX });
        plan(&mut planner, &capability, 0);
        let grant = planner.slots[axis.index()].active().copied().expect("it jogs").grant;
        let motors = |pose: Pose| capability.law.targets(&pose.fine(), &mut Default::default()).0;
        let (here, mut next) = (motors(pose), pose);
        next.0[axis.index()] += if upwards { 1_000_000 } else { -1_000_000 };
        for (i, (here, there)) in here.iter().zip(motors(next)).enumerate() {
            // Q32 steps over a milliradian at that speed, path units of 2^28 nrad in Q60, to Q44 steps
            let way = u128::from(here.abs_diff(there)) * u128::from(grant.limits.velocity.unsigned_abs());
            let needed = (way / 1_000_000) >> 20;
            let held = u128::from(grant.uses[i].velocity);
            assert!(held + 2 >= needed, "{axis:?} upwards {upwards}: motor {i} needs {needed}, holds {held}");
        }
    }
}
