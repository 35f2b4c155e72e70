//! The alignment from what the cameras leave to the best that the bench allows.

use host_sim::alignment::{Alignment, Ended, Lab, Options, align};
use host_sim::bench_twin::{self, Bench, Optimum, Side, Start};
use rayon::prelude::*;
use std::time::Instant;

/// What became of one bench.
struct Outcome {
    seed: u64,
    result: Result<Alignment, Box<Ended>>,
    optimum: Optimum,
    losses_db: Vec<f64>,
    wall_s: f64,
}

impl Outcome {
    fn worst_db(&self) -> f64 {
        self.losses_db.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    fn uniformity_db(&self) -> f64 {
        self.worst_db() - self.losses_db.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn excess_db(&self) -> f64 {
        self.worst_db() - self.optimum.worst_db
    }

    fn seconds(&self) -> f64 {
        self.result.as_ref().map_or(f64::INFINITY, |result| result.seconds)
    }
}

fn setting(name: &str, or: u64) -> u64 {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(or)
}

fn run(seed: u64, bench: &bench_twin::Options, options: &Options) -> Outcome {
    let bench = Bench::seeded(seed, bench);
    let optimum = bench.optimum();
    let calibrated = Side::BOTH.map(|side| bench.calibrated(side).expect("a stage that can be measured").machine);
    let mut lab = Lab::new(bench, &calibrated, seed).expect("a stage that can be calibrated");
    let start = Instant::now();
    let mut steps = Vec::new();
    let result = align(&mut lab, options, &mut |step| steps.push(step.clone()));
    let wall_s = start.elapsed().as_secs_f64();
    if setting("SHOW_STEPS", 0) != 0 {
        steps.iter().for_each(|step| println!("{seed}: {step:?}"));
    }
    Outcome { seed, result, optimum, losses_db: lab.losses(), wall_s }
}

/// Value below which this share lies.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

fn judge(name: &str, outcomes: &[Outcome], limit_s: f64) {
    for outcome in outcomes {
        if let Err(error) = &outcome.result {
            println!("{}: {error}", outcome.seed);
        }
    }
    let of = |value: fn(&Outcome) -> f64| outcomes.iter().map(value).collect::<Vec<_>>();
    let excess = of(Outcome::excess_db);
    let uniformity = of(|outcome| (outcome.uniformity_db() - outcome.optimum.uniformity_db).abs());
    let show = |what: &str, values: &[f64]| {
        let [median, high, most] = [0.5, 0.9, 1.0].map(|share| quantile(values.to_vec(), share));
        println!("figure: {name}: {what}: median {median:.4}, 90 % {high:.4}, most {most:.4}");
    };
    show("worst channel above the best, dB", &excess);
    show("uniformity off that of the best, dB", &uniformity);
    show("simulated time, s", &of(Outcome::seconds));
    show("wall time, s", &of(|outcome| outcome.wall_s));
    let failed: Vec<u64> = outcomes
        .iter()
        .filter(|o| o.result.is_err() || o.excess_db() > 0.5 || o.seconds() > limit_s)
        .map(|outcome| outcome.seed)
        .collect();
    println!("figure: {name}: failures {} of {} {failed:?}", failed.len(), outcomes.len());
    assert!(failed.is_empty(), "{failed:?}");
    assert!(quantile(excess.clone(), 0.5) <= 0.05 && quantile(excess, 0.9) <= 0.10);
    assert!(quantile(uniformity, 0.9) <= 0.02);
}

fn seeds(some: u64, many: u64) -> Vec<u64> {
    let first = setting("FIRST_SEED", 1);
    let count = setting("SEEDS", if cfg!(debug_assertions) { some } else { many });
    (first..first + count).collect()
}

#[test]
fn from_what_cameras_leave_the_array_comes_to_the_best_in_20_seconds() {
    let outcomes: Vec<_> = seeds(2, 40)
        .into_par_iter()
        .map(|seed| run(seed, &bench_twin::Options::default(), &Options::default()))
        .collect();
    judge("10 um", &outcomes, 20.0);
}

#[test]
fn from_three_times_as_far_a_detector_behind_the_chip_helps() {
    let bench = bench_twin::Options { start: Start::COARSE, ..bench_twin::Options::default() };
    let outcomes: Vec<_> =
        seeds(2, 20).into_par_iter().map(|seed| run(seed, &bench, &Options::with_detector())).collect();
    judge("30 um", &outcomes, 40.0);
}
