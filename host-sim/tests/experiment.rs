//! The experiment: what compensation is worth in light, for a naive climb and for a robust search.

use host_sim::bench_twin::Side;
use host_sim::experiment::climb::{Coordinate, Log, Probe};
use host_sim::experiment::mechanism::{Mechanisms, carried_um, mechanisms};
use host_sim::experiment::witness::Snapshot;
use host_sim::experiment::{Experiment, Prepared, Quantiles, Run, STEPS_UM, Search, bench, groups};
use host_sim::report::Mode;
use rayon::prelude::*;
use serde_json::Value;
use stage_controller::units::Axis;
use std::path::Path;
use std::process::Command;

const PLAY_UM: f64 = 0.3;

/// Benches of a comparison: half of them while debugging.
fn benches() -> std::ops::RangeInclusive<u64> {
    let count = if cfg!(debug_assertions) { 6 } else { 12 };
    println!("figure: {count} of 12 benches");
    1..=count
}

/// Runs of some searches and compensations on some benches, in the order of searches, compensations, seeds.
fn runs(seeds: std::ops::RangeInclusive<u64>, searches: &[Search], modes: &[Mode]) -> Vec<Run> {
    let prepared: Vec<Prepared> =
        seeds.into_par_iter().map(|seed| Prepared::new(seed).expect("the stage can be calibrated")).collect();
    let plan: Vec<(Search, Mode, &Prepared)> = searches
        .iter()
        .flat_map(|search| modes.iter().map(move |mode| (*search, *mode)))
        .flat_map(|(search, mode)| prepared.iter().map(move |prepared| (search, mode, prepared)))
        .collect();
    plan.par_iter().map(|(search, mode, prepared)| Run::new(prepared, *search, *mode).unwrap()).collect()
}

fn climb(step_um: f64) -> Search {
    Search::Climb { step_um }
}

fn of(runs: &[Run], search: Search, mode: Mode) -> Vec<&Run> {
    runs.iter().filter(|run| run.search == search.name() && run.compensation == mode).collect()
}

fn trapped(runs: &[&Run]) -> usize {
    runs.iter().filter(|run| run.climb.unwrap().mechanisms.trapped_in_play).count()
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    Quantiles::of(values.map(Some)).median.unwrap()
}

#[test]
fn every_search_of_a_seed_has_the_same_stages_and_the_same_optimum() {
    for seed in [2, 5] {
        let benches = [Search::Robust, Search::RobustNear, Search::AngleClimb].map(|search| bench(seed, search));
        let [cameras, near, tilted] = benches.each_ref().map(|bench| bench.optimum());
        for other in [near, tilted] {
            assert!((other.worst_db - cameras.worst_db).abs() < 5e-4, "{} {}", other.worst_db, cameras.worst_db);
        }
        for side in Side::BOTH {
            assert_eq!(benches[0].machine(side), benches[1].machine(side));
            assert_eq!(benches[0].machine(side), benches[2].machine(side));
            let straight = benches[1].seat(side);
            assert!(straight[..2].iter().all(|nm| nm.abs() <= 3000.0), "{straight:?}");
            assert!(benches[2].seat(side) != straight, "tilted");
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_runs() {
    let once = || runs(3..=3, &[climb(0.2), Search::AngleClimb, Search::Robust], &[Mode::None, Mode::All]);
    let (first, second) = (once(), once());
    assert_eq!(first, second);
    assert_ne!(first[0].losses_db, first[1].losses_db, "compensation makes a difference, or the switches do nothing");
}

#[test]
fn a_climb_in_steps_up_to_the_play_gains_by_compensation_because_it_is_no_longer_trapped() {
    let small: Vec<f64> = STEPS_UM.into_iter().filter(|step| *step <= PLAY_UM).collect();
    assert_eq!(small.len(), 3);
    let searches: Vec<Search> = small.iter().map(|step| climb(*step)).collect();
    let runs = runs(benches(), &searches, &[Mode::None, Mode::All]);
    let mut caught = 0;
    for search in searches {
        let (none, all) = (of(&runs, search, Mode::None), of(&runs, search, Mode::All));
        let gain = median(none.iter().zip(&all).map(|(none, all)| none.worst_db - all.worst_db));
        assert!(gain > 0.0, "{search:?}: {gain} dB");
        assert!(all.iter().all(|run| run.failure.is_none()), "{search:?}");
        assert_eq!(trapped(&all), 0, "{search:?}");
        caught += trapped(&none);
    }
    let climbs = runs.len() / 2;
    assert!(6 * caught > climbs, "{caught} of {climbs} climbs within the play were caught in it");
}

#[test]
fn a_climb_in_steps_above_the_play_is_never_trapped() {
    let searches = [climb(0.5), climb(1.0)];
    let runs = runs(benches(), &searches, &[Mode::None]);
    for search in searches {
        assert_eq!(trapped(&of(&runs, search, Mode::None)), 0, "{search:?}");
    }
}

#[test]
fn an_angle_climb_that_does_not_go_back_to_the_peak_needs_the_rotation_centre() {
    let runs = runs(1..=6, &[Search::AngleClimb], &[Mode::None, Mode::Backlash, Mode::All]);
    let above = |mode| median(of(&runs, Search::AngleClimb, mode).iter().map(|run| run.above_optimum_db));
    let confounded = |mode| {
        of(&runs, Search::AngleClimb, mode).iter().filter(|run| run.climb.unwrap().mechanisms.pivot_confounding).count()
    };
    assert!(above(Mode::All) < above(Mode::None) - 0.2, "{} {}", above(Mode::All), above(Mode::None));
    assert!(above(Mode::Backlash) > above(Mode::All) + 0.2, "backlash compensation is no help here");
    assert_eq!(confounded(Mode::None), 6);
    assert!(confounded(Mode::All) < confounded(Mode::None));
}

#[test]
fn the_robust_search_with_everything_on_comes_within_a_tenth_of_a_decibel() {
    let runs = runs(benches(), &[Search::Robust], &[Mode::All]);
    for run in &runs {
        assert_eq!(run.failure, None, "seed {}", run.seed);
    }
    let above = Quantiles::of(runs.iter().map(|run| Some(run.above_optimum_db)));
    assert!(above.p90.unwrap() < 0.10, "{above:?}");
    assert!(above.p10.unwrap() > -0.02, "nothing is much better than the optimum: {above:?}");
}

/// A fibre before a guide: 0.15 dB at 1 um aside, 0.35 dB at a degree, both about 0.
fn loss(_tick: u64, poses: &[[f64; 6]; 2]) -> f64 {
    let [x, y, _, alpha, beta, _] = poses[1];
    let degree = 1e9_f64.to_radians();
    0.15 * 1e-6 * (x * x + y * y) + 0.35 * (alpha * alpha + beta * beta) / (degree * degree)
}

/// The output side at x (nm) and beta (nrad) with its X motor at so many steps of 50 nm.
fn at(x: f64, beta: f64, motor: i32) -> Snapshot {
    let mut snapshot = Snapshot::default();
    (snapshot.poses[1][0], snapshot.driven[1][0]) = (x, x);
    snapshot.poses[1][4] = beta;
    snapshot.motors[1][0] = motor;
    snapshot
}

fn judged(axis: Axis, way: f64, taken: bool, [best, before, after]: [Snapshot; 3]) -> Mechanisms {
    let probe =
        Probe { at: Coordinate { side: Side::Output, axis }, way, climb: 0, pass: 0, taken, best, before, after };
    let log = Log { probes: vec![probe], ..Log::default() };
    mechanisms(&log, &loss, 0.003)
}

#[test]
fn a_reversed_step_that_moved_only_the_motor_is_named_a_trap() {
    // the peak is at 0, best at 1000 nm; up to 1100 was worse, down again the driven side stays there
    let (best, up, down) = (at(1000.0, 0.0, 20), at(1100.0, 0.0, 22), at(1100.0, 0.0, 18));
    assert_eq!(judged(Axis::X, -0.1, false, [best, up, down]).words(), "trapped in play");
    // it moved, but not past the best place
    assert!(judged(Axis::X, -0.1, false, [best, up, at(1020.0, 0.0, 18)]).trapped_in_play);
    // it moved where it should: whatever the reading said, the play is not to blame
    assert_eq!(judged(Axis::X, -0.1, false, [best, up, at(900.0, 0.0, 18)]).words(), "none");
    // the motor did not turn either
    assert_eq!(judged(Axis::X, -0.1, false, [best, up, at(1100.0, 0.0, 22)]).words(), "none");
    // noise let it on all the same
    assert_eq!(judged(Axis::X, -0.1, true, [best, up, down]).words(), "none");
    // at the peak there was nothing to gain
    let (best, up, down) = (at(30.0, 0.0, 0), at(130.0, 0.0, 2), at(130.0, 0.0, -2));
    assert_eq!(judged(Axis::X, -0.1, false, [best, up, down]).words(), "none");
}

#[test]
fn a_trap_on_the_way_is_not_one_at_the_end() {
    let (best, up, down) = (at(1000.0, 0.0, 20), at(1100.0, 0.0, 22), at(1100.0, 0.0, 18));
    let caught = |climb, pass| Probe {
        at: Coordinate { side: Side::Output, axis: Axis::X },
        way: -0.1,
        climb,
        pass,
        taken: false,
        best,
        before: up,
        after: down,
    };
    // the last climb has one pass, as each one has that went back to the peak after a turn
    let free = |climb, pass| Probe { after: at(900.0, 0.0, 18), ..caught(climb, pass) };
    let judged = |probes| mechanisms(&Log { probes, ..Log::default() }, &loss, 0.003).trapped_in_play;
    assert!(!judged(vec![caught(4, 0), free(5, 0)]), "an earlier climb");
    assert!(!judged(vec![caught(5, 0), free(5, 1)]), "an earlier pass");
    assert!(judged(vec![free(4, 0), caught(5, 0), free(5, 0)]));
}

#[test]
fn a_turn_that_is_judged_by_the_way_of_the_fibre_point_is_named_confounding() {
    let degree = 1e9_f64.to_radians();
    let tilted = at(0.0, degree, 0);
    // towards straight, but the fibre point goes 1.7 um aside
    let turned = at(1700.0, 0.9 * degree, 0);
    assert_eq!(judged(Axis::Beta, -0.1, false, [tilted, tilted, turned]).words(), "pivot confounding");
    // the same about the fibre point would have been taken
    let held = at(0.0, 0.9 * degree, 0);
    assert_eq!(judged(Axis::Beta, -0.1, true, [tilted, tilted, held]).words(), "none");
    // away from straight, taken because the fibre point came nearer
    let (aside, nearer) = (at(2000.0, degree, 0), at(500.0, 1.1 * degree, 0));
    assert_eq!(judged(Axis::Beta, 0.1, true, [aside, aside, nearer]).words(), "pivot confounding");
    // given up where there was nothing to gain
    let straight = at(0.0, 0.0, 0);
    assert_eq!(judged(Axis::Beta, 0.1, false, [straight, straight, turned]).words(), "none");
    let probe = |after| Probe {
        at: Coordinate { side: Side::Output, axis: Axis::Beta },
        way: 0.1,
        climb: 0,
        pass: 0,
        taken: false,
        best: tilted,
        before: tilted,
        after,
    };
    let log = Log { probes: vec![probe(turned), probe(held)], ..Log::default() };
    assert!((carried_um(&log) - 1.7).abs() < 1e-9);
}

#[test]
fn failures_are_counted_and_stay_in_the_percentiles() {
    use host_sim::experiment::Failure;
    let mut runs = runs(1..=3, &[Search::RobustNear], &[Mode::None, Mode::All]);
    let name = Search::RobustNear.name();
    for run in runs.iter_mut().filter(|run| run.seed < 3 && run.compensation == Mode::All) {
        run.failure = Some(Failure::Collision("made up".into()));
    }
    let groups = groups(&runs);
    let group = groups.iter().find(|group| group.search == name && group.compensation == Mode::All).unwrap();
    assert_eq!((group.runs, group.failures.collision, group.failures.all()), (3, 2, 2));
    assert_eq!(group.worst_db.median, None, "two of three have no end");
    assert_eq!(group.gain_db.median, None);
    assert!(group.better_worse[1] >= 2, "a bench without an end is worse");
    let bare = groups.iter().find(|group| group.search == name && group.compensation == Mode::None).unwrap();
    assert!(bare.worst_db.median.is_some());
}

#[test]
fn the_command_writes_one_page_and_one_object_of_the_same_figures() {
    let page = Path::new(env!("CARGO_TARGET_TMPDIR")).join("experiment.html");
    let done = Command::new(env!("CARGO_BIN_EXE_host-sim"))
        .args(["experiment", "--seeds", "1", "--json", "-o"])
        .arg(&page)
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    let json: Value = serde_json::from_slice(&done.stdout).unwrap();
    let all = Search::all().len() * Mode::ALL.len();
    assert_eq!(json["runs"].as_array().unwrap().len(), all);
    assert_eq!(Experiment::progress_steps(1), 1 + all as u64);
    for run in json["runs"].as_array().unwrap() {
        assert_eq!(run["losses_db"].as_array().unwrap().len(), 8);
    }
    let page = std::fs::read_to_string(page).unwrap();
    for part in ["<!DOCTYPE html>", "Table 7", "Table 8", "What cannot be derived", "<svg", "11.14", "9.92"] {
        assert!(page.contains(part), "{part}");
    }
    for finding in json["findings"].as_array().unwrap() {
        let text = finding["text"].as_str().unwrap();
        assert!(page.contains(&text.replace('>', "&gt;").replace('<', "&lt;")), "{text}");
    }
    for outside in ["http://", "https://", "<script", "<img", "url("] {
        assert!(!page.contains(outside), "the page needs nothing from outside: {outside}");
    }
}
