//! Motion under watch: every word and every segment border of random lives of a stage.
//!
//! `STEPS_VOLUME` (percent) sets how much is tried; by default little in debug and 100 in release.

mod support;

use host_sim::board::Interleaving;
use host_sim::machine::Machine;
use std::time::Instant;
use support::script::{Weather, storm};
use support::stage::Stage;

const BENCH: &str = include_str!("../machines/bench.toml");
const LONG_LEVER: &str = include_str!("../machines/long-lever.toml");

/// How much of `full` to do, at least 1.
fn volume(full: u64) -> u64 {
    let percent = std::env::var("STEPS_VOLUME").ok().and_then(|v| v.parse().ok());
    let percent: f64 = percent.unwrap_or(if cfg!(debug_assertions) { 1.0 } else { 100.0 });
    ((full as f64 * percent / 100.0) as u64).max(1)
}

/// A machine with faster motors, as a real one would have with a stiffer stage.
fn quicker(mut machine: Machine, v: f64, a: f64, j: f64) -> Machine {
    for drive in &mut machine.drives {
        drive.velocity = (drive.velocity * v).min(498_000.0 * drive.step);
        drive.acceleration *= a;
        drive.jerk *= j;
    }
    machine
}

fn machines() -> Vec<Machine> {
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

#[test]
fn storms_of_commands_keep_every_law() {
    let (mut segments, mut steps) = (0, 0);
    let only: Option<usize> = std::env::var("STEPS_MACHINE").ok().and_then(|v| v.parse().ok());
    for (index, machine) in machines().into_iter().enumerate() {
        if only.is_some_and(|only| only != index) {
            continue;
        }
        for (kind, interleaving) in
            [Interleaving::Prompt, Interleaving::Jittered(1), Interleaving::Jittered(6)]
                .into_iter()
                .enumerate()
        {
            let begin = Instant::now();
            let mut stage = Stage::new(&machine, interleaving, 100 * index as u64 + kind as u64 + seed());
            let weather = Weather { commands: volume(500), part: 50, aborts: true, changes: true };
            storm(&mut stage, weather);
            let used = stage.checker.trajectory.used().map(|u| 100.0 * u);
            println!(
                "{} {interleaving:?}: {} segments, {} steps in {:.1} s; used at stride 32: v {:.1} a {:.1} j {:.1} %; {} late",
                machine.name,
                stage.checker.segments,
                stage.checker.steps,
                begin.elapsed().as_secs_f64(),
                used[0],
                used[1],
                used[2],
                stage.late
            );
            segments += stage.checker.segments;
            steps += stage.checker.steps;
        }
    }
    println!("storms: {segments} segments, {steps} steps");
}

/// Another world for a search: `STEPS_SEED`.
fn seed() -> u64 {
    std::env::var("STEPS_SEED").ok().and_then(|v| v.parse().ok()).unwrap_or(0)
}
