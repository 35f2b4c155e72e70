//! The experiment: what compensation is worth in light, for a naive climb and for a robust search.

use host_sim::alignment::{Bus, Controller, Lab};
use host_sim::bench_twin::Side;
use host_sim::experiment::climb::{Coordinate, Log, Probe, climb as climb_by_hand};
use host_sim::experiment::mechanism::{Mechanisms, carried_um, is_trapped, mechanisms};
use host_sim::experiment::witness::{Snapshot, Witness};
use host_sim::experiment::{Experiment, Kind, Prepared, Run, STEPS_UM, Search, Verdict, bench, groups, switches};
use host_sim::report::Mode;
use rayon::prelude::*;
use serde_json::Value;
use stage_controller::units::Axis;
use std::path::Path;
use std::process::Command;
use std::sync::OnceLock;

/// Benches of a comparison: fewer while debugging.
fn benches() -> std::ops::RangeInclusive<u64> {
    let count = if cfg!(debug_assertions) { 3 } else { 12 };
    println!("figure: {count} of 12 benches");
    1..=count
}

/// What the controllers of a bench believe, and its optimum: made once for all tests.
fn prepared(seed: u64) -> &'static Prepared {
    static BENCHES: [OnceLock<Prepared>; 13] = [const { OnceLock::new() }; 13];
    BENCHES[seed as usize].get_or_init(|| Prepared::new(seed).expect("the stage can be calibrated"))
}

/// Runs of some searches and compensations on some benches, in the order of searches, compensations, seeds.
fn runs(seeds: std::ops::RangeInclusive<u64>, searches: &[Search], modes: &[Mode]) -> Vec<Run> {
    let prepared: Vec<&Prepared> = seeds.map(prepared).collect();
    let plan: Vec<(Search, Mode, &Prepared)> = searches
        .iter()
        .flat_map(|search| modes.iter().map(move |mode| (*search, *mode)))
        .flat_map(|(search, mode)| prepared.iter().map(move |prepared| (search, mode, *prepared)))
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
fn with_backlash_compensation_no_climb_is_trapped_in_play() {
    let play_um = 0.3;
    let searches: Vec<Search> = STEPS_UM.into_iter().filter(|step| *step <= play_um).map(climb).collect();
    assert_eq!(searches.len(), 3, "above the play none is trapped without it either");
    let runs = runs(benches(), &searches, &[Mode::Backlash, Mode::All]);
    for search in searches {
        for mode in [Mode::Backlash, Mode::All] {
            assert_eq!(trapped(&of(&runs, search, mode)), 0, "{search:?} {mode:?}");
        }
    }
}

#[test]
fn a_trapped_climb_rests_inside_the_play_and_a_longer_step_would_have_brought_light() {
    let mut seen = 0;
    for seed in benches() {
        let prepared = prepared(seed);
        for step_um in [0.1, 0.2] {
            let bench = bench(seed, climb(step_um));
            let noise_db = bench.options().meter.noise_db;
            let judge = bench.clone();
            let loss = |tick: u64, poses: &[[f64; 6]; 2]| judge.losses(tick, poses)[0];
            let mut lab = Lab::new(bench, &prepared.calibrated, seed).unwrap();
            let mut log = Log::default();
            climb_by_hand(&mut lab, &switches(Mode::None), step_um, &mut log).unwrap();
            let Some(probe) = log.last_lateral().find(|probe| is_trapped(probe, &loss, noise_db)).copied() else {
                assert_eq!(log.climbs, 1);
                continue;
            };
            seen += 1;
            let (side, axis) = (probe.at.side, probe.at.axis.index());
            let drive = &judge.machine(side).drives[axis];
            // on the positive flank the driven side is where the motor is, on the negative one the play further
            let lag =
                |at: &Snapshot| at.driven[side.index()][axis] - f64::from(at.motors[side.index()][axis]) * drive.step;
            let rest = lab.snapshot();
            for at in [&probe.after, &rest] {
                assert!((-1.0..=drive.backlash + 1.0).contains(&lag(at)), "seed {seed}: {} nm", lag(at));
            }
            let lost = (lag(&probe.after) - lag(&probe.before)).abs();
            assert!(lost > 49.0 && lost <= drive.backlash + 1.0, "seed {seed}: {lost} nm of the step were lost");
            let here = lab.losses()[0];
            let mut least = f64::INFINITY;
            for part in [probe.way, 0.15 * probe.way.signum(), 0.15 * probe.way.signum()] {
                let mut by = [0.0; 6];
                by[axis] = part;
                Controller::new(&mut lab, side).move_by(by).unwrap();
                lab.pause(0.05).unwrap();
                least = least.min(lab.losses()[0]);
            }
            assert!(least < here, "seed {seed}, {step_um} um: {here} dB, and {least} dB behind the play");
        }
    }
    assert!(seen > 0, "these benches have no trap at all: nothing was tested");
}

#[test]
fn coupling_and_rotation_centre_have_nothing_to_do_in_a_climb_over_x_and_y() {
    let search = climb(0.2);
    let runs = runs(1..=2, &[search], &[Mode::Coupling, Mode::Pivot]);
    for (coupling, pivot) in of(&runs, search, Mode::Coupling).iter().zip(of(&runs, search, Mode::Pivot)) {
        assert_eq!(coupling.losses_db, pivot.losses_db, "messages as long, nothing corrected: the same to the bit");
    }
    assert!(!search.is_touched_by(Mode::Coupling) && !search.is_touched_by(Mode::Pivot));
    assert!(search.is_touched_by(Mode::Backlash) && search.is_touched_by(Mode::All));
    assert!(Mode::ALL[1..].iter().all(|mode| Search::AngleClimb.is_touched_by(*mode)));
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
fn an_angle_climb_is_confounded_where_the_rotation_centre_is_off_and_never_with_everything_on() {
    let runs = runs(1..=3, &[Search::AngleClimb], &[Mode::None, Mode::All]);
    for (none, all) in of(&runs, Search::AngleClimb, Mode::None).iter().zip(of(&runs, Search::AngleClimb, Mode::All)) {
        let (none, all) = (none.climb.unwrap(), all.climb.unwrap());
        assert!(none.mechanisms.pivot_confounding && !all.mechanisms.pivot_confounding);
        assert!(all.carried_radii < none.carried_radii, "{} {}", all.carried_radii, none.carried_radii);
    }
}

#[test]
fn the_robust_search_with_everything_on_comes_within_a_tenth_of_a_decibel() {
    let runs = runs(benches(), &[Search::Robust], &[Mode::All]);
    for run in &runs {
        assert_eq!(run.failure, None, "seed {}: {} um from the chip", run.seed, run.clearance_um);
        assert!(run.above_optimum_db > -0.02, "nothing is much better than the optimum: seed {}", run.seed);
    }
    let mut above: Vec<f64> = runs.iter().map(|run| run.above_optimum_db).collect();
    above.sort_by(f64::total_cmp);
    assert!(above[above.len() * 9 / 10] < 0.10, "{above:?}");
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
    // taken although nothing moved, so that the way down was not tried
    let up = at(1000.0, 0.0, 22);
    assert!(judged(Axis::X, 0.1, true, [best, best, up]).trapped_in_play, "noise tossed");
    assert_eq!(judged(Axis::X, 0.1, true, [best, best, at(1100.0, 0.0, 22)]).words(), "none");
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
fn failures_are_counted_with_their_cause_and_stay_in_the_percentiles() {
    use host_sim::experiment::Failure;
    let search = climb(1.0);
    let mut runs = runs(1..=3, &[search], &[Mode::None, Mode::All]);
    for run in runs.iter_mut().filter(|run| run.compensation == Mode::All) {
        run.failure = (run.seed < 3).then(|| Failure {
            kind: Kind::Collision,
            cause: "made up".into(),
            when: Some("in \u{201c}gap\u{201d}".into()),
            error: Some(format!("made up at tick {}", run.seed)),
        });
    }
    let groups = groups(&runs);
    let group = groups.iter().find(|group| group.of == search && group.compensation == Mode::All).unwrap();
    assert_eq!((group.runs, group.failures.collision, group.failures.all()), (3, 2, 2));
    let [cause] = &group.causes[..] else { panic!("{:?}", group.causes) };
    assert_eq!((cause.runs, cause.seed, cause.cause.as_str()), (2, 1, "made up in \u{201c}gap\u{201d}"));
    assert_eq!(group.worst_db.median, None, "two of three have no end");
    assert_eq!(group.gain_db.median, None);
    assert_eq!(group.gain_verdict, Some(Verdict::TooFew), "three benches say nothing");
    assert!(group.better_worse[1] >= 2, "a bench without an end is worse");
    let bare = groups.iter().find(|group| group.of == search && group.compensation == Mode::None).unwrap();
    assert!(bare.worst_db.median.is_some() && bare.gain_verdict.is_none());
}

/// A run that ended early says what the search said and in which step; one that ended too far away what is left, and in a
/// climb the mechanism.
fn names_its_cause(run: &Value) {
    let failure = &run["failure"];
    let Some(kind) = failure["kind"].as_str() else { return assert!(failure.is_null(), "{run}") };
    let cause = failure["cause"].as_str().unwrap();
    assert!(!cause.is_empty() && !cause.contains(|c: char| c.is_ascii_digit()), "{cause}");
    match kind {
        "error" | "collision" => {
            assert!(failure["when"].as_str().unwrap().contains('\u{201c}'), "{failure}");
            assert!(failure["error"].as_str().unwrap().len() > 20, "{failure}");
        }
        "far" if !run["climb"].is_null() => {
            for (key, words) in [("trapped_in_play", "trapped in play"), ("pivot_confounding", "pivot confounding")] {
                assert_eq!(run["climb"][key], cause.contains(words), "{run}");
            }
        }
        _ => assert!(["far", "close", "late"].contains(&kind), "{kind}"),
    }
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
    // the same seed gives the same runs, in another process and in another order
    let again = runs(1..=1, &[Search::Robust, climb(0.2)], &[Mode::None, Mode::All]);
    for run in again {
        let printed = json["runs"].as_array().unwrap().iter();
        // through the same text: what reads it back rounds
        let run: Value = serde_json::from_str(&serde_json::to_string(&run).unwrap()).unwrap();
        let mut same =
            printed.filter(|other| ["search", "compensation", "seed"].iter().all(|key| other[key] == run[key]));
        assert_eq!(same.next(), Some(&run));
        assert_eq!(same.next(), None);
    }
    for run in json["runs"].as_array().unwrap() {
        names_its_cause(run);
    }
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
    let direction = json["findings"][1]["text"].as_str().unwrap();
    assert!(direction.ends_with("too few benches to say."), "one bench reproduces nothing: {direction}");
    assert!(!page.contains("reproduced.") && page.contains("can not act: chance"));
    for outside in ["http://", "https://", "<script", "<img", "url("] {
        assert!(!page.contains(outside), "the page needs nothing from outside: {outside}");
    }
}
