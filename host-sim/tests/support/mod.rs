//! Watching a board: every segment that it plays is checked.

pub mod checker;
pub mod rates;
pub mod script;
pub mod stage;

use host_sim::machine::Machine;

const BENCH: &str = include_str!("../../machines/bench.toml");
const LONG_LEVER: &str = include_str!("../../machines/long-lever.toml");

/// The part of `full` to do, at least 1: `STEPS_VOLUME` percent, by default little in debug and all in release.
pub fn volume(full: u64) -> u64 {
    let percent = std::env::var("STEPS_VOLUME").ok().and_then(|v| v.parse().ok());
    let percent: f64 = percent.unwrap_or(if cfg!(debug_assertions) { 1.0 } else { 100.0 });
    ((full as f64 * percent / 100.0) as u64).max(1)
}

/// Another world, for a search: `STEPS_SEED`.
pub fn seed() -> u64 {
    std::env::var("STEPS_SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(0)
}

/// A machine with faster motors, as one with a stiffer stage would have.
pub fn quicker(mut machine: Machine, v: f64, a: f64, j: f64) -> Machine {
    for drive in &mut machine.drives {
        drive.velocity = (drive.velocity * v).min(498_000.0 * drive.step);
        drive.acceleration *= a;
        drive.jerk *= j;
    }
    machine
}

/// The three machines and quicker ones.
pub fn machines() -> Vec<Machine> {
    let [bench, long] = [BENCH, LONG_LEVER].map(|text| Machine::parse(text).expect("a machine"));
    vec![
        Machine::paper(),
        quicker(Machine::paper(), 8.0, 30.0, 100.0),
        bench.clone(),
        quicker(bench, 1.0, 30.0, 100.0),
        long.clone(),
        quicker(long, 2.0, 100.0, 1000.0),
    ]
}

/// Coarse steps and stiff stages: a move over the whole travel takes some 1000 segments, a small one some 20.
pub fn fast() -> Machine {
    let mut machine = quicker(Machine::paper(), 1.0, 10_000.0, 2_500_000.0);
    for drive in &mut machine.drives {
        drive.step *= 4.0;
        drive.velocity = 400_000.0 * drive.step;
        drive.jerk = drive.jerk.min(1.1e15);
    }
    machine
}
