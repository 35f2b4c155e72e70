//! The twin of the alignment bench: geometry, errors, light, contact, and the best that it allows.

use host_sim::bench_twin::{Bench, Options, STARTS, Sees, Side, StageErrors, Start};
use host_sim::board::{Board, Interleaving};
use host_sim::calibrate::calibrate;
use host_sim::machine::{ErrorName, Machine, to_toml};
use host_sim::measure::nominal;
use host_sim::model::{Chain, Truth};
use host_sim::optics::{Adc, Burst, DARK_DBM, FrontEnd, Misalignment, Mode, Pair};
use host_sim::session::power_up;
use host_sim::twin::Mechanics;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use stage_controller::compensation::law::Switches;
use stage_controller::units::{AXES, Axis, MotorSteps};
use std::hint::black_box;
use std::time::Instant;

const HOME: [[f64; 6]; 2] = [[0.0; 6]; 2];
const SEGMENT: u64 = 256;

fn bench(seed: u64) -> Bench {
    Bench::seeded(seed, &Options::default())
}

/// Stands still and sees its light through a meter without noise.
fn still() -> Options {
    let mut options = Options { drift_um_per_min: 0.0, adc_noise_lsb: 0.0, ..Options::default() };
    options.meter.noise_db = 0.0;
    options.settling.share = 0.0;
    options
}

#[test]
fn a_seed_gives_one_bench_and_another_seed_another_one() {
    let poses = [[100.0, 200.0, 300.0, 4e4, 5e4, 6e4]; 2];
    let see = |seed: u64| {
        let mut bench = bench(seed);
        let machines = Side::BOTH.map(|side| to_toml(bench.machine(side)));
        bench.light(0, HOME);
        let light = bench.light(SEGMENT, poses);
        (machines, light, bench.readings(), Side::BOTH.map(|side| bench.codes(side)), bench.losses(0, &poses))
    };
    assert_eq!(see(3), see(3));
    assert_ne!(see(3).0, see(4).0);
    assert_ne!(see(3).4, see(4).4);
    let [input, output] = see(3).0;
    assert_ne!(input, output, "each side has a stage of its own");
}

#[test]
fn the_true_stages_have_errors_of_the_stated_size_that_vanish_at_home() {
    let sizes = StageErrors::default();
    let (mut offsets, mut count, mut largest) = (0.0, 0.0, [0.0_f64; 2]);
    for seed in 0..40 {
        let bench = bench(seed);
        for side in Side::BOTH {
            let machine = bench.machine(side);
            assert!(machine.statics.values().iter().all(|v| v.abs() <= sizes.static_rad && *v != 0.0));
            for name in ErrorName::all() {
                let error = machine.kinematic.get(name);
                assert!(error.value(0.0).abs() < 1e-15, "{}", name.iso());
                let [lower, upper] = machine.drives[name.axis.index()].travel;
                let unit = if name.axis.is_rotary() { 1e9 / 180.0 * std::f64::consts::PI } else { 1e3 };
                let bound = if name.component.is_angular() { sizes.kinematic_rad } else { sizes.kinematic_um };
                let screw = if name.component as usize == name.axis.index() { 2e-3 * sizes.screw_nm } else { 0.0 };
                for k in 0..=200 {
                    let at = (lower + (upper - lower) * f64::from(k) / 200.0) / unit;
                    let value = error.value(at).abs();
                    assert!(value <= bound + screw, "{} {value}", name.iso());
                    let kind = usize::from(name.component.is_angular());
                    largest[kind] = largest[kind].max(value / bound);
                }
            }
            for offset in machine.mounts.fibre.offset_nm.iter().chain(&machine.mounts.chip.offset_nm) {
                offsets += (offset * 1e-3_f64).powi(2);
                count += 1.0;
            }
            assert_eq!(machine.drives, Machine::paper().drives, "steps, play and travel are those of the drawing");
            assert_eq!(Machine::parse(&to_toml(machine)).unwrap().drives, machine.drives, "a machine file can hold it");
        }
    }
    assert!(((offsets / count).sqrt() / 200.0 - 1.0_f64).abs() < 0.1);
    assert!(largest[0] > 0.8 && largest[1] > 0.8, "the bounds are used: {largest:?}");
}

#[test]
fn the_screw_makes_an_error_with_its_lead_as_period() {
    let mut options = Options::default();
    options.stage.kinematic_um = 0.0;
    let bench = Bench::seeded(1, &options);
    let machine = bench.machine(Side::Output);
    for (axis, iso) in Axis::LINEAR.into_iter().zip(["EXX", "EYY", "EZZ"]) {
        let name = ErrorName::all().find(|name| name.iso() == iso).unwrap();
        let error = machine.kinematic.get(name);
        let values: Vec<f64> = (0..500).map(|um| error.value(f64::from(um))).collect();
        let range = values.iter().fold(0.0_f64, |m, v| m.max(*v)) - values.iter().fold(0.0_f64, |m, v| m.min(*v));
        assert!(range > 1e-4 && range <= 0.1 + 1e-9, "{} {range}", axis.name());
        assert!((error.value(137.0) - error.value(637.0)).abs() < 1e-12);
    }
}

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
fn an_array_that_looks_at_the_guide_loses_less_than_one_that_looks_away() {
    let mut options = still();
    options.core_sigma_um = 0.0;
    let bench = Bench::seeded(2, &options);
    let best = bench.optimum().poses;
    let loss = |beta: f64| {
        let mut poses = best;
        // 600 um back, 30 um to the side: the guide is to the left
        poses[1][0] += 30e3;
        poses[1][2] -= 590e3;
        poses[1][4] += beta;
        bench.losses(0, &poses)[0]
    };
    assert!(loss(-5e7) < loss(0.0) && loss(0.0) < loss(5e7), "{} {} {}", loss(-5e7), loss(0.0), loss(5e7));
}

#[test]
fn the_loss_of_a_channel_is_splitter_and_both_couplings() {
    let options = still();
    let bench = Bench::seeded(6, &options);
    let pair = Pair::new(Mode::round(4.8), Mode::round(5.2), options.medium);
    let mut excess = Vec::new();
    for poses in [HOME, bench.optimum().poses] {
        let input = pair.loss_db(&bench.misalignment(Side::Input, 0, 0, &poses[0]));
        let losses = bench.losses(0, &poses);
        excess.push([0, 3, 7].map(|i| {
            losses[i]
                - input
                - pair.loss_db(&bench.misalignment(Side::Output, i, 0, &poses[1]))
                - 10.0 * 8.0_f64.log10()
        }));
    }
    for i in 0..3 {
        assert!((excess[0][i] - excess[1][i]).abs() < 1e-9, "what is left belongs to the chip: {excess:?}");
        assert!((excess[0][i] - 0.6).abs() < 0.25, "{excess:?}");
    }
}

#[test]
fn the_meter_sees_the_fibre_or_the_detector_that_it_is_put_before() {
    let mut bench = Bench::seeded(8, &still());
    let best = bench.optimum();
    bench.connect(0, Sees::Fibre(2));
    bench.connect(1, Sees::Detector);
    let light = bench.light(0, best.poses);
    assert!((light[0] + best.losses_db[2]).abs() < 1e-9, "{light:?}");
    assert!((light[1] + 0.6).abs() < 0.2, "all outputs together: {light:?}");
    // the detector needs no array
    let mut aside = best.poses;
    aside[1][0] += 100e3;
    let far = bench.light(SEGMENT, aside);
    assert!(far[0] < -100.0);
    assert!((far[1] - light[1]).abs() < 1e-12);
    bench.break_fibre(2, true);
    assert_eq!(bench.light(2 * SEGMENT, best.poses)[0], DARK_DBM);
    bench.break_fibre(2, false);
    bench.laser(None);
    let dark = bench.light(3 * SEGMENT, best.poses);
    assert!(dark.iter().all(|dbm| *dbm < -190.0), "{dark:?}");
    bench.laser(Some(3.0));
    let bright = bench.light(4 * SEGMENT, best.poses);
    assert!((bright[0] - light[0] - 3.0).abs() < 1e-9);
    bench.connect(1, Sees::Nothing);
    assert_eq!(bench.light(5 * SEGMENT, best.poses)[1], DARK_DBM);
}

#[test]
fn the_boards_read_the_power_through_either_front_end() {
    for (front_end, tolerance) in [(FrontEnd::LOGARITHMIC, 0.01), (FrontEnd::LINEAR, 0.004)] {
        let mut bench = Bench::seeded(9, &Options { front_end, ..still() });
        let best = bench.optimum();
        let light = bench.light(0, best.poses);
        for side in Side::BOTH {
            for (code, light) in bench.codes(side).into_iter().zip(light) {
                let power = front_end.power(Adc::volts(code));
                assert!((10.0 * power.log10() - light).abs() < tolerance, "{code}: {power} mW, {light} dBm");
            }
        }
        assert_eq!(bench.codes(Side::Input), bench.codes(Side::Output), "without noise both boards see the same");
    }
    let mut bench = Bench::seeded(9, &Options::default());
    bench.light(0, HOME);
    let best = bench.optimum().poses;
    let mut differ = 0;
    for k in 1..100 {
        bench.light(k * SEGMENT, best);
        assert_eq!(bench.codes(Side::Input), bench.codes(Side::Input), "a sample is not taken twice");
        differ += u32::from(bench.codes(Side::Input) != bench.codes(Side::Output));
    }
    assert!(differ > 80, "each board has a converter of its own");
}

#[test]
fn bursts_and_the_end_of_the_range_reach_the_reading() {
    let mut bench = Bench::seeded(9, &Options::default());
    let best = bench.optimum().poses;
    bench.light(0, best);
    bench.disturb(0, Some(Burst { from: 0, until: 1000 * SEGMENT, noise_db: 1.0 }));
    let mut off = [0.0_f64; 2];
    for k in 1..1000 {
        let light = bench.light(k * SEGMENT, best);
        let readings = bench.readings();
        (0..2).for_each(|i| off[i] = off[i].max((readings[i] - light[i]).abs()));
    }
    assert!(off[0] > 2.0 && off[1] < 0.1, "{off:?}");
    bench.laser(Some(16.0));
    for k in 1000..1010 {
        bench.light(k * SEGMENT, best);
    }
    assert!(bench.is_saturated(0) && bench.is_saturated(1));
    assert!(bench.readings().iter().all(|dbm| (dbm - 3.0).abs() < 1e-9));
}

#[test]
fn a_contact_is_latched_with_time_side_and_pose() {
    let mut bench = Bench::seeded(5, &still());
    let mut poses = HOME;
    bench.light(0, poses);
    let open = bench.clearance_um(Side::Output, 0, &poses[1]);
    let mut tick = 0;
    while poses[1][2] < open * 1e3 - 300.0 {
        tick += SEGMENT;
        poses[1][2] += 200.0;
        bench.light(tick, poses);
        assert_eq!(bench.check(), Ok(()), "{}", bench.clearance_um(Side::Output, tick, &poses[1]));
    }
    poses[1][2] += 400.0;
    bench.light(tick + SEGMENT, poses);
    let collision = bench.collision().expect("it has touched");
    assert_eq!((collision.side, collision.tick, collision.pose), (Side::Output, tick + SEGMENT, poses[1]));
    assert!(collision.clearance_um <= 0.0 && collision.clearance_um > -0.4);
    bench.light(tick + 2 * SEGMENT, HOME);
    assert_eq!(bench.check(), Err(collision), "going back mends nothing");
    assert!(collision.to_string().contains("output side"), "{collision}");
}

#[test]
fn a_tilted_array_touches_with_a_corner_long_before_its_fibres_are_there() {
    let bench = Bench::seeded(5, &still());
    let mut pose = bench.optimum().poses[1];
    // 10 mrad to this side and to that: one end of the array is 375 um from the fibre point, the other 2125 um
    pose[4] -= 10e6;
    let near = bench.clearance_um(Side::Output, 0, &pose);
    assert!((near - (10.0 - 0.010 * 375.0)).abs() < 0.2, "{near}");
    pose[4] += 20e6;
    let far = bench.clearance_um(Side::Output, 0, &pose);
    assert!((far - (10.0 - 0.010 * 2125.0)).abs() < 0.2, "{far}");
    assert!(far < 0.0 && bench.misalignment(Side::Output, 0, 0, &pose).gap_um > 9.0);
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

/// Largest error of the fibre point (nm) and the angles (nrad) when a believed machine serves poses near home.
fn served(truth: &Machine, believed: &Machine) -> [f64; 2] {
    let (chain, truth) = (Chain::new(believed), Truth::new(truth));
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut worst = [0.0_f64; 2];
    for _ in 0..200 {
        let pose: [f64; 6] =
            std::array::from_fn(
                |i| if i < 3 { random.random_range(-2e4..2e4) } else { random.random_range(-7e6..7e6) },
            );
        let reached = truth.pose(chain.exact_inverse(pose).unwrap());
        (0..6).for_each(|i| worst[i / 3] = worst[i / 3].max((reached[i] - pose[i]).abs()));
    }
    worst
}

#[test]
fn the_controller_knows_its_stages_from_measurements_that_are_not_exact() {
    let seeds = std::env::var("BENCH_SEEDS").ok().and_then(|v| v.parse().ok()).unwrap_or(10_u64);
    let results: Vec<_> = (0..seeds)
        .flat_map(|seed| Side::BOTH.map(|side| (seed, side)))
        .map(|(seed, side)| {
            let bench = bench(seed);
            let start = Instant::now();
            let found = bench.calibrated(side).expect("a stage that can be measured");
            let time = start.elapsed().as_secs_f64();
            let (truth, believed) = (bench.machine(side), &found.machine);
            assert_ne!(truth.statics, believed.statics);
            assert!(believed.kinematic.is_absent(), "the kinematic errors are not told");
            assert_eq!(
                nominal(believed),
                nominal(&bench.options().drawing),
                "what is not measured is as in the drawing"
            );
            calibrate(believed).expect("the controller takes it");
            let play = (0..6).map(|i| believed.drives[i].backlash - truth.drives[i].backlash);
            let play: Vec<f64> = play.map(f64::abs).collect();
            let linear = play[..3].iter().copied().fold(0.0, f64::max);
            let rotary = play[3..].iter().copied().fold(0.0, f64::max);
            assert!(linear > 0.0, "no measurement is exact");
            let [nm, nrad] = served(truth, believed);
            let drawn = served(truth, &nominal(&bench.options().drawing))[0];
            [time, linear, rotary * 1e-3, nm, nrad * 1e-3, drawn]
        })
        .collect();
    let worst = |figure: usize| results.iter().map(|r| r[figure]).fold(0.0, f64::max);
    println!(
        "figure: {} stages measured and fitted in at most {:.2} s each; play off by at most {:.0} nm, {:.1} urad; \
         20 um and 0.4 degrees around home the fibre is off by at most {:.0} nm and {:.1} urad, as drawn {:.0} nm",
        results.len(),
        worst(0),
        worst(1),
        worst(2),
        worst(3),
        worst(4),
        worst(5),
    );
    assert!(worst(3) < 0.3 * worst(5), "measured is better than drawn");
    if !cfg!(debug_assertions) {
        assert!(worst(0) < 2.0, "seconds on a busy machine");
    }
}

/// Both boards step until they rest, the bench looks at every segment; segments, and the true poses.
fn run(bench: &mut Bench, boards: &mut [Board; 2], first: u64) -> (u64, [[f64; 6]; 2]) {
    let mut poses = boards.each_ref().map(|board| board.twin().true_pose());
    let mut motors = boards.each_ref().map(|board| board.twin().motors());
    for segment in first.. {
        for i in 0..2 {
            boards[i].step(|_| ());
            if boards[i].twin().motors() != motors[i] {
                motors[i] = boards[i].twin().motors();
                poses[i] = boards[i].twin().true_pose();
            }
        }
        bench.light(segment * SEGMENT, poses);
        black_box(Side::BOTH.map(|side| bench.codes(side)));
        if !boards.iter().any(|board| board.front.operation_pending()) {
            return (segment, poses);
        }
    }
    unreachable!("the segments do not end")
}

#[test]
fn boards_that_know_their_stages_from_measurements_come_to_the_optimum_when_told_where_it_is() {
    let seeds = if cfg!(debug_assertions) { 0..3 } else { 0..20 };
    let mut above = [Vec::new(), Vec::new()];
    let (mut segments, mut seconds) = (0, 0.0);
    for seed in seeds {
        for (compensation, above) in [true, false].into_iter().zip(&mut above) {
            let mut bench = bench(seed);
            let best = bench.optimum();
            let mut boards = Side::BOTH.map(|side| {
                let believed = bench.calibrated(side).expect("a calibration").machine;
                let front = power_up(&believed, false).expect("the controller takes it");
                Board::new(bench.machine(side), front, Interleaving::Prompt, seed)
            });
            let start = Instant::now();
            for (board, pose) in boards.iter_mut().zip(&best.poses) {
                board.front.set_switches(Switches { compensation, ..Switches::default() }).expect("at rest");
                assert!(board.settle());
                board.front.pose_absolute(pose.map(|v| v.round() as i64)).expect("within the travel");
            }
            let (last, poses) = run(&mut bench, &mut boards, 0);
            segments += last;
            seconds += start.elapsed().as_secs_f64();
            let losses = bench.losses(last * SEGMENT, &poses);
            above.push(losses.into_iter().fold(0.0, f64::max) - best.worst_db);
            if compensation {
                assert_eq!(bench.check(), Ok(()));
            }
        }
    }
    above.iter_mut().for_each(|values| values.sort_by(f64::total_cmp));
    let [on, off] = above.each_ref().map(|values| (values[values.len() / 2], values[values.len() - 1]));
    println!(
        "figure: sent straight to the true optimum: with compensation {:.4} dB above it (median, worst {:.4}), without \
         {:.2} dB (worst {:.2}); {:.2} us of wall time a segment of two boards and the bench",
        on.0,
        on.1,
        off.0,
        off.1,
        seconds * 1e6 / segments as f64
    );
    assert!(on.1 < 0.1, "{on:?}");
    assert!(off.0 > 10.0 * on.0, "{off:?}");
}

/// The worst loss of a bench with one stage displaced from a pose, moved along z until its corners keep their distance.
struct Around<'a> {
    bench: &'a Bench,
    poses: [[f64; 6]; 2],
    side: Side,
}

impl Around<'_> {
    /// By um, um, um beyond the working gap, mrad, mrad, mrad.
    fn worst(&self, by: [f64; 6]) -> f64 {
        let mut poses = self.poses;
        let pose = &mut poses[self.side.index()];
        for i in [0, 1] {
            pose[i] += by[i] * 1e3;
        }
        (3..6).for_each(|i| pose[i] += by[i] * 1e6);
        let gap = self.bench.options().working_gap_um + by[2];
        pose[2] += (self.bench.clearance_um(self.side, 0, pose) - gap) * 1e3;
        let losses = self.bench.losses(0, &poses);
        losses.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }
}

#[test]
fn no_point_of_a_dense_grid_is_better_than_the_optimum_by_2_millidecibel() {
    let seeds = if cfg!(debug_assertions) { 0..2_u64 } else { 0..10 };
    let figures: Vec<String> = seeds
        .into_par_iter()
        .map(|seed| {
            let bench = bench(seed);
            let start = Instant::now();
            let best = bench.optimum();
            let time = start.elapsed().as_secs_f64();
            assert_eq!(best.agreeing, [STARTS; 2], "every start ends there");
            let largest = best.losses_db.iter().copied().fold(0.0, f64::max);
            let least = best.losses_db.iter().copied().fold(99.0, f64::min);
            assert_eq!((best.worst_db, best.uniformity_db), (largest, largest - least));
            assert_eq!(bench.losses(0, &best.poses), best.losses_db);
            for side in Side::BOTH {
                let clearance = bench.clearance_um(side, 0, &best.poses[side.index()]);
                assert!((clearance - 10.0).abs() < 1e-6, "{clearance}");
            }
            let mut gained = f64::NEG_INFINITY;
            let mut points = 0;
            for side in Side::BOTH {
                let around = Around { bench: &bench, poses: best.poses, side };
                assert!((around.worst([0.0; 6]) - best.worst_db).abs() < 1e-6);
                // fine around the optimum: 20 nm and, at the last channel, 35 nm apart
                let fine = |k: i32, step: f64| (-k..=k).map(move |i| step * f64::from(i));
                for (x, y) in fine(5, 0.02).flat_map(|x| fine(5, 0.02).map(move |y| (x, y))) {
                    for gamma in fine(5, 0.02) {
                        for (alpha, beta) in fine(3, 0.2).flat_map(|a| fine(3, 0.2).map(move |b| (a, b))) {
                            for gap in [0.0, 0.3] {
                                if [x, y, gap, alpha, beta, gamma].iter().all(|by| by.abs() < 1e-9) {
                                    continue;
                                }
                                gained = gained.max(best.worst_db - around.worst([x, y, gap, alpha, beta, gamma]));
                                points += 1;
                            }
                        }
                    }
                }
                // coarse and by chance far around it, for another valley
                for (x, y) in fine(12, 0.25).flat_map(|x| fine(12, 0.25).map(move |y| (x, y))) {
                    for gamma in fine(10, 0.3).filter(|gamma| [x, y, *gamma].iter().any(|by| by.abs() > 1e-9)) {
                        gained = gained.max(best.worst_db - around.worst([x, y, 0.0, 0.0, 0.0, gamma]));
                        points += 1;
                    }
                }
                let mut random = ChaCha8Rng::seed_from_u64(seed);
                for _ in 0..20_000 {
                    let by = [2.0, 2.0, 10.0, 5.0, 5.0, 3.0].map(|r: f64| random.random_range(-r..r));
                    gained = gained.max(best.worst_db - around.worst([by[0], by[1], by[2].abs(), by[3], by[4], by[5]]));
                    points += 1;
                }
            }
            assert!(gained < 0.002, "seed {seed}: a grid point is better by {gained} dB");
            format!(
                "figure: seed {seed}: best worst channel {:.4} dB, uniformity {:.4} dB, {:.2} s; of {points} points \
                 the best is {:+.5} dB above",
                best.worst_db, best.uniformity_db, time, -gained
            )
        })
        .collect();
    figures.iter().for_each(|figure| println!("{figure}"));
}

#[test]
fn a_segment_of_light_costs_little() {
    let mut bench = bench(1);
    let best = bench.optimum().poses;
    let count = if cfg!(debug_assertions) { 20_000 } else { 1_000_000_u64 };
    bench.light(0, best);
    let mut tick = 0;
    let mut time = |what: &mut dyn FnMut(&mut Bench, u64)| {
        let start = Instant::now();
        for _ in 0..count {
            tick += SEGMENT;
            what(&mut bench, tick);
        }
        start.elapsed().as_secs_f64() * 1e9 / count as f64
    };
    let resting = time(&mut |bench, tick| {
        black_box(bench.light(tick, best));
    });
    let moving = time(&mut |bench, tick| {
        let mut poses = best;
        poses.iter_mut().for_each(|pose| pose[0] += (tick % 4096) as f64);
        black_box(bench.light(tick, poses));
    });
    let codes = time(&mut |bench, _| {
        black_box((bench.codes(Side::Input), bench.codes(Side::Output)));
    });
    let mut mechanics = Mechanics::new(bench_machine(), [false; AXES]);
    let mut k = 0;
    let pose = time(&mut |_, _| {
        k += 1;
        mechanics.run_to(MotorSteps([k % 100; 6]));
        black_box(mechanics.true_pose());
    });
    println!(
        "figure: light of a segment at rest {resting:.0} ns, in motion {moving:.0} ns; samples of both boards \
         {codes:.0} ns; true pose of a stage {pose:.0} ns"
    );
    if !cfg!(debug_assertions) {
        assert!(resting < 3000.0 && moving < 9000.0, "three times the aim, for busy machines");
    }
}

fn bench_machine() -> &'static Machine {
    static MACHINE: std::sync::OnceLock<Machine> = std::sync::OnceLock::new();
    MACHINE.get_or_init(|| bench(1).machine(Side::Output).clone())
}
