//! Play and rotation centres from light alone, written back as a calibration.

use host_sim::alignment::{Controller, Lab, Options, learn};
use host_sim::bench_twin::{self, Bench, Side, StageErrors};
use rayon::prelude::*;
use stage_controller::units::Axis;

const TURN_DEG: f64 = 0.3;

fn setting(name: &str, or: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(or)
}

/// How far the end of the fibre really goes in x and y when an axis turns from below to above, um per rad; come to
/// upwards both times, X and Y at last as well: within the dead band a motor that follows may rest on either flank.
/// Motors stand at whole steps: by how much that misses the pivot, the controller knows.
fn wander(lab: &mut Lab, side: Side, axis: Axis) -> [f64; 2] {
    let n = axis.index() + 1;
    let mut go = |by: f64| {
        for message in [&*format!("AXIS{n}:MOVE:REL {by}"), "POSE:REL -2,-2,0,0,0,0", "POSE:REL 2,2,0,0,0,0"] {
            Controller::new(lab, side).run(message, 20.0).unwrap();
        }
        let told = lab.board(side).front.position().0;
        let true_pose = lab.poses()[side.index()];
        std::array::from_fn::<f64, 6, _>(|i| if i < 3 { true_pose[i] - f64::from(told[i]) } else { true_pose[i] })
    };
    go(-TURN_DEG - 0.03);
    let below = go(0.03);
    let above = go(2.0 * TURN_DEG);
    go(-TURN_DEG);
    let turn = above[axis.index()] - below[axis.index()];
    [0, 1].map(|i| (above[i] - below[i]) / turn * 1e6)
}

/// Errors of what was learned of a stage: play of X and Y, nm; the four levers that are left afterwards, um.
struct Errors {
    seed: u64,
    play_nm: [f64; 2],
    before_um: [f64; 4],
    after_um: [f64; 4],
}

fn levers(lab: &mut Lab, side: Side) -> [f64; 4] {
    let [_, a] = wander(lab, side, Axis::Alpha);
    let [b, _] = wander(lab, side, Axis::Beta);
    let [c, d] = wander(lab, side, Axis::Gamma);
    [a, b, c, d]
}

fn run(seed: u64) -> Vec<Errors> {
    let stage = StageErrors { play_spread: 0.5, ..StageErrors::default() };
    let options = bench_twin::Options { stage, ..bench_twin::Options::default() };
    let bench = Bench::seeded(seed, &options);
    // the controllers know the drawing alone
    let believed = [options.drawing.clone(), options.drawing.clone()];
    let truth = Side::BOTH.map(|side| bench.machine(side).clone());
    // one that nothing is learned of, drawn back so that it can turn
    let mut fresh = Lab::new(bench.clone(), &believed, seed).unwrap();
    for side in Side::BOTH {
        Controller::new(&mut fresh, side).run("AXIS3:MOVE:REL -100", 20.0).unwrap();
    }
    let mut lab = Lab::new(bench, &believed, seed).unwrap();
    let mut before = Side::BOTH.map(|side| levers(&mut fresh, side)).into_iter();
    let learned = learn(&mut lab, &Options::default(), &believed, &mut |_| ());
    let learned = learned.unwrap_or_else(|error| panic!("{seed}: {error}"));
    let errors = Side::BOTH.into_iter().zip(learned).map(|(side, (known, learned))| {
        let play = |i: usize| learned.backlash[i].value_um * 1e3 - truth[side.index()].drives[i].backlash;
        assert!((known.drives[0].backlash - learned.backlash[0].value_um * 1e3).abs() < 1e-6);
        let (play_nm, after_um) = ([play(0), play(1)], levers(&mut lab, side));
        Errors { seed, play_nm, before_um: before.next().expect("both sides"), after_um }
    });
    errors.collect()
}

#[test]
fn play_and_rotation_centres_are_told_by_light_alone() {
    let seeds: Vec<u64> = (1..=setting("SEEDS", if cfg!(debug_assertions) { 1 } else { 50 })).collect();
    let errors: Vec<Errors> = seeds.into_par_iter().flat_map_iter(run).collect();
    let most = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |most: f64, value| most.max(value.abs()));
    for e in &errors {
        println!("{}: play {:.1?} nm, levers {:.1?} um, left {:.2?} um", e.seed, e.play_nm, e.before_um, e.after_um);
    }
    let play = most(&mut errors.iter().flat_map(|e| e.play_nm));
    let before = most(&mut errors.iter().flat_map(|e| e.before_um));
    let after = most(&mut errors.iter().flat_map(|e| e.after_um));
    println!(
        "figure: play off by at most {play:.1} nm; levers off by at most {before:.0} um before, {after:.2} um after"
    );
    assert!(play < 10.0 && after < 5.0 && before > 100.0);
}
