//! What the controller knows of the stages, and how far it comes with that.

use super::{SEGMENT, bench};
use host_sim::bench_twin::{Bench, Side};
use host_sim::board::{Board, Interleaving};
use host_sim::calibrate::calibrate;
use host_sim::machine::Machine;
use host_sim::measure::nominal;
use host_sim::model::{Chain, Truth};
use host_sim::session::power_up;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use stage_controller::compensation::law::Switches;
use std::hint::black_box;
use std::time::Instant;

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
            assert_eq!(believed.kinematic, Default::default(), "the kinematic errors are not told");
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
