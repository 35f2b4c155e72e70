//! The commands `host-sim move`, `trace` and `bench` as a user meets them.

mod stage;

use serde::Deserialize;
use stage_controller::units::AXES;
use std::path::Path;
use std::process::{Command, Output};

#[derive(Deserialize)]
struct Run {
    commanded_nm_nrad: [i64; AXES],
    motor_steps: [i32; AXES],
    steps_without_overlay: [i32; AXES],
    q_a_nrad: [f64; 3],
    true_pose_nm_nrad: [f64; AXES],
    error_nm_nrad: [f64; AXES],
}

#[derive(Deserialize)]
struct Runs {
    on: Run,
    off: Run,
}

fn host_sim(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).args(args).output().expect("host-sim runs")
}

fn moved(machine: &str, pose: &str) -> Runs {
    let done = host_sim(&["move", "--machine", machine, "--pose", pose, "--json"]);
    assert!(done.status.success(), "{done:?}");
    serde_json::from_slice(&done.stdout).expect("one JSON object")
}

fn refusal(args: &[&str]) -> String {
    let done = host_sim(args);
    assert_eq!(done.status.code(), Some(2), "{done:?}");
    assert!(done.stdout.is_empty(), "{done:?}");
    String::from_utf8(done.stderr).unwrap()
}

#[test]
fn home_is_the_true_pose_zero() {
    let runs = moved("paper", "0,0,0,0,0,0");
    for run in [runs.on, runs.off] {
        assert_eq!((run.motor_steps, run.steps_without_overlay), ([0; AXES], [0; AXES]));
        assert!(run.true_pose_nm_nrad.iter().all(|u| u.abs() < 1e-6));
    }
}

#[test]
fn with_the_compensation_on_the_stage_stands_where_it_was_sent() {
    let file = stage::golden_path("machines/lever-52mm.toml");
    let runs = moved(file.to_str().unwrap(), "-1234.567,2000,1500.25,1.5,-2.25,0.75");
    let on = runs.on;
    assert_eq!(on.commanded_nm_nrad[..3], [-1_234_567, 2_000_000, 1_500_250]);
    assert_eq!(on.commanded_nm_nrad[4], -39_269_908);
    assert!(on.error_nm_nrad[..3].iter().all(|e| e.abs() < 150.0), "{:?}", on.error_nm_nrad);
    assert!(runs.off.error_nm_nrad[..3].iter().any(|e| e.abs() > 100_000.0), "{:?}", runs.off.error_nm_nrad);
    // off: each motor follows its own coordinate, nothing is overlaid
    assert_eq!(runs.off.motor_steps, runs.off.steps_without_overlay);
    assert_eq!(runs.off.q_a_nrad, [3, 4, 5].map(|i| on.commanded_nm_nrad[i] as f64));
    // on: motors that ended in the negative direction stand off by their play
    assert_ne!(on.motor_steps, on.steps_without_overlay);
    assert!(on.q_a_nrad.iter().any(|q| q.fract() != 0.0));
    for (truth, (error, commanded)) in
        on.true_pose_nm_nrad.iter().zip(on.error_nm_nrad.iter().zip(on.commanded_nm_nrad))
    {
        assert!((truth - commanded as f64 - error).abs() < 1e-6);
    }
}

#[test]
fn a_refused_move_names_axis_and_value_and_ends_with_status_2() {
    let beyond = refusal(&["move", "--pose", "0,6200,0,0,0,0"]);
    assert!(beyond.contains("Y: -222") && beyond.contains("6200.000 um above 5000.000 um"), "{beyond}");
    let text = refusal(&["move", "--pose", "0,0,0,0,0.1x,0"]);
    assert!(text.contains("beta") && text.contains("0.1x"), "{text}");
    let five = refusal(&["move", "--pose", "0,0,0,0,0"]);
    assert!(five.contains("six numbers"), "{five}");
    let motor = refusal(&["move", "--pose", "-4990,4990,4990,3,-3,3"]);
    assert!(motor.contains("motor -3.0002"), "{motor}");

    let bad = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bad-machine.toml");
    let text = std::fs::read_to_string(stage::golden_path("machines/eight-mrad.toml")).unwrap();
    std::fs::write(&bad, text.replacen("S_XY", "S_YX", 1)).unwrap();
    let machine = refusal(&["move", "--machine", bad.to_str().unwrap(), "--pose", "0,0,0,0,0,0"]);
    assert!(machine.contains("S_YX"), "{machine}");
}

#[test]
fn a_trace_counts_the_same_steps_as_the_motors() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("demo.vcd");
    let script = Path::new(env!("CARGO_TARGET_TMPDIR")).join("demo.scpi");
    std::fs::write(&script, "POSE 20,-10,5,0.1,-0.1,0.05\n*WAI\n").unwrap();
    let done = host_sim(&["trace", "--script", script.to_str().unwrap(), "-o", file.to_str().unwrap()]);
    assert!(done.status.success(), "{done:?}");
    let text = std::fs::read_to_string(&file).unwrap();
    assert!(text.starts_with("$timescale 1 us $end"), "{text:.200}");

    let mut names = std::collections::HashMap::new();
    let (mut levels, mut counts) = (std::collections::HashMap::new(), [0i32; AXES]);
    let mut last = 0;
    for line in text.lines() {
        if let Some(wire) = line.strip_prefix("$var wire 1 ") {
            let mut words = wire.split(' ');
            names.insert(words.next().unwrap().to_string(), words.next().unwrap().to_string());
        } else if let Some(time) = line.strip_prefix('#') {
            let time: u64 = time.parse().unwrap();
            assert!(time >= last);
            last = time;
        } else if let Some((level, name)) = line.split_at_checked(1).and_then(|(l, id)| Some((l, names.get(id)?))) {
            let rose = level == "1" && levels.insert(name.clone(), true) != Some(true);
            if level == "0" {
                levels.insert(name.clone(), false);
            }
            let axes = ["X", "Y", "Z", "alpha", "beta", "gamma"];
            if let Some(axis) = name.strip_prefix("STEP_").filter(|_| rose) {
                let up = levels.get(&format!("DIR_{axis}")) == Some(&true);
                counts[axes.iter().position(|a| *a == axis).unwrap()] += if up { 1 } else { -1 };
            }
        }
    }
    assert_eq!(counts, moved("paper", "20,-10,5,0.1,-0.1,0.05").on.motor_steps);

    let unknown = Path::new(env!("CARGO_TARGET_TMPDIR")).join("unknown.scpi");
    std::fs::write(&unknown, "*WAI\nJUMP 3\n").unwrap();
    let done = host_sim(&["trace", "--script", unknown.to_str().unwrap(), "-o", file.to_str().unwrap()]);
    assert_eq!(done.status.code(), Some(2));
    let text = String::from_utf8(done.stderr).unwrap();
    assert!(text.contains("-113") && text.contains("JUMP"), "{text}");
}

#[test]
fn the_bench_prints_its_figures() {
    let done = host_sim(&["bench", "--seconds", "0.01", "--json"]);
    assert!(done.status.success(), "{done:?}");
    let figures: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    for kind in ["simulation", "generator_alone"] {
        let run = &figures[kind][0];
        let reached = &run["reached_steps_per_s"];
        // the ways of the motors are curved: their rates differ by a tenth
        assert!(reached[0].as_f64().unwrap() > 85e3 && reached[1].as_f64().unwrap() < 115e3, "{run}");
        assert!(run["times_real_time"].as_f64().unwrap() > 0.0 && run["steps"].as_u64().unwrap() > 0);
    }
    let counted = !figures["instructions"].as_array().unwrap().is_empty();
    assert_ne!(counted, figures["instructions_note"].is_string(), "counted, or a reason why not");
}
