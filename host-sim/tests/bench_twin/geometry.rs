//! From poses to where the fibres stand before their guides.

use super::{bench, still};
use host_sim::bench_twin::{Bench, Options, Side, Start};
use host_sim::model::Truth;
use host_sim::optics::Misalignment;
use host_sim::twin::Mechanics;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use stage_controller::units::{AXES, MotorSteps};

#[test]
fn the_optimum_lies_where_the_start_says_and_the_faces_are_apart() {
    for (start, lateral) in [(Start::CAMERAS, 10.0), (Start::COARSE, 30.0)] {
        let (mut widest, mut steepest) = (0.0_f64, 0.0_f64);
        for seed in 0..100 {
            let bench = Bench::seeded(seed, &Options { start, ..Options::default() });
            for side in Side::BOTH {
                let clearance = bench.clearance_um(side, 0, &[0.0; 6]);
                assert!((15.0..30.0).contains(&clearance), "{clearance}");
                let at = bench.misalignment(side, 0, 0, &[0.0; 6]);
                widest = widest.max(at.offset_um[0].abs());
                steepest = steepest.max(at.tilt_rad[0].abs().to_degrees());
                assert!(at.gap_um > 15.0 && at.gap_um < 50.0);
            }
        }
        // core errors and the slope of the gap come on top of the drawn range
        assert!(widest > 0.9 * lateral && widest < lateral + 1.5, "{widest}");
        assert!(steepest > 0.36 && steepest < 0.41, "{steepest}");
    }
}

/// Where fibre and guide are in the stage's frame, from the poses alone: rotations by another library routine, points
/// carried one by one.
fn by_hand(
    bench: &Bench,
    side: Side,
    channel: usize,
    pose: &[f64; 6],
    straight: &[f64; 6],
    core: [f64; 2],
) -> Misalignment {
    let machine = bench.machine(side);
    let home = Truth::new(machine).place([0.0; 6]).0;
    // Z, X, Y, gamma, beta, alpha: gamma turns all, alpha the array alone
    let turn = |pose: &[f64; 6]| -> Matrix3<f64> {
        let about = |axis, angle: f64| Rotation3::from_axis_angle(&axis, angle * 1e-9);
        let rotation =
            about(Vector3::z_axis(), pose[5]) * about(Vector3::y_axis(), pose[4]) * about(Vector3::x_axis(), pose[3]);
        rotation.matrix() * home
    };
    let point = |pose: &[f64; 6], x: f64, y: f64| {
        Vector3::new(pose[0], pose[1], pose[2]) * 1e-3 + turn(pose) * Vector3::new(x, y, 0.0)
    };
    let guides = turn(straight);
    let (right, up, into) = (guides.column(0), guides.column(1), guides.column(2));
    let guide = point(straight, -250.0 * channel as f64, 0.0);
    let apart = point(pose, core[0], core[1]) - guide;
    let looks = turn(pose) * Vector3::z();
    Misalignment {
        offset_um: [apart.dot(&right), apart.dot(&up)],
        gap_um: -apart.dot(&into),
        tilt_rad: [-looks.dot(&right) / looks.dot(&into), -looks.dot(&up) / looks.dot(&into)],
    }
}

#[test]
fn fibres_stand_where_a_calculation_by_hand_puts_them() {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    // where the cores are is drawn; here they are where they are meant to be
    let options = Options { core_sigma_um: 0.0, ..Options::default() };
    for seed in 0..20 {
        let bench = Bench::seeded(seed, &options);
        for side in Side::BOTH {
            let straight = bench.seat(side);
            let there = bench.misalignment(side, 0, 0, &straight);
            let [x, y] = there.offset_um;
            assert!([x, y, there.gap_um].iter().all(|um| um.abs() < 1e-9), "{there:?}");
            for _ in 0..20 {
                let mut pose = straight;
                (0..3).for_each(|i| pose[i] += random.random_range(-2e4..2e4));
                (3..6).for_each(|i| pose[i] += random.random_range(-2e7..2e7));
                let channels = if side == Side::Input { 1 } else { 8 };
                for channel in 0..channels {
                    let a = bench.misalignment(side, channel, 0, &pose);
                    let core = [-250.0 * channel as f64, 0.0];
                    let b = by_hand(&bench, side, channel, &pose, &straight, core);
                    for i in 0..2 {
                        assert!((a.offset_um[i] - b.offset_um[i]).abs() < 1e-9, "{a:?} {b:?}");
                        assert!((a.tilt_rad[i] - b.tilt_rad[i]).abs() < 1e-12, "{a:?} {b:?}");
                    }
                    assert!((a.gap_um - b.gap_um).abs() < 1e-9, "{a:?} {b:?}");
                }
            }
        }
    }
}

#[test]
fn roll_lifts_the_last_channel_and_yaw_opens_its_gap() {
    let mut options = still();
    options.core_sigma_um = 0.0;
    let bench = Bench::seeded(2, &options);
    let best = bench.optimum().poses[1];
    let turned = |axis: usize, by: f64| {
        let mut pose = best;
        pose[axis] += by;
        let at = |pose: &[f64; 6]| bench.misalignment(Side::Output, 7, 0, pose);
        let (a, b) = (at(&pose), at(&best));
        [a.offset_um[0] - b.offset_um[0], a.offset_um[1] - b.offset_um[1], a.gap_um - b.gap_um]
    };
    // channel 8 is 1750 um to -x of the fibre point; 1 mrad
    let roll = turned(5, 1e6);
    assert!((roll[1] + 1.75).abs() < 0.05 && roll[2].abs() < 0.05, "{roll:?}");
    let yaw = turned(4, 1e6);
    assert!((yaw[2] + 1.75).abs() < 0.05 && yaw[1].abs() < 0.05, "{yaw:?}");
}

#[test]
fn the_chip_drifts_evenly_by_the_stated_speed() {
    let options = Options { drift_um_per_min: 0.1, ..still() };
    let bench = Bench::seeded(3, &options);
    let best = bench.optimum();
    let minute = 60_000_000;
    for side in Side::BOTH {
        let drift = Vector3::from(bench.drift_um(side, minute));
        assert!((drift.norm() - 0.1).abs() < 1e-12);
        let mut pose = best.poses[side.index()];
        (0..3).for_each(|i| pose[i] += drift[i] * 1e3);
        let (then, now) =
            (bench.misalignment(side, 0, minute, &pose), bench.misalignment(side, 0, 0, &best.poses[side.index()]));
        assert!((then.offset_um[0] - now.offset_um[0]).abs() < 1e-9 && (then.gap_um - now.gap_um).abs() < 1e-9);
    }
    assert_ne!(bench.drift_um(Side::Input, minute), bench.drift_um(Side::Output, minute));
}

#[test]
fn the_poses_of_the_turned_motors_are_those_that_the_light_takes() {
    let bench = bench(11);
    for side in Side::BOTH {
        let mut mechanics = Mechanics::new(bench.machine(side), [false; AXES]);
        assert!(mechanics.true_pose().iter().all(|v| v.abs() < 1e-6), "it begins at home");
        mechanics.run_to(MotorSteps([40, 0, 0, 0, 0, 0]));
        let pose = mechanics.true_pose();
        assert!((pose[0] - 2000.0).abs() < 30.0, "{pose:?}");
        let best = bench.optimum().poses[side.index()];
        let actuators = bench.actuators(side, &best).expect("within the travel");
        let reached = Truth::new(bench.machine(side)).pose(actuators);
        assert!((0..6).all(|i| (reached[i] - best[i]).abs() < 1e-2), "{reached:?} {best:?}");
        let drives = &bench.machine(side).drives;
        assert!((0..6).all(|i| (drives[i].travel[0]..drives[i].travel[1]).contains(&actuators[i])));
    }
}
