//! Machine files: what is accepted, and errors that name the key and the value.

use host_sim::machine::Machine;
use stage_controller::units::Axis;

const PAPER: &str = include_str!("../machines/paper.toml");

/// The message for the paper's machine with one line changed.
fn refusal(from: &str, to: &str) -> String {
    assert!(PAPER.contains(from), "{from}");
    match Machine::parse(&PAPER.replacen(from, to, 1)) {
        Ok(_) => panic!("accepted: {to}"),
        Err(error) => error.to_string(),
    }
}

fn names(message: &str, key: &str, value: &str) {
    assert!(message.contains(key) && message.contains(value), "{message}");
}

#[test]
fn the_paper_machine_is_read_in_nanometres_and_nanoradians() {
    let machine = Machine::paper();
    assert_eq!(machine.name, "paper");
    assert_eq!(machine.order, [Axis::Z, Axis::X, Axis::Y, Axis::Gamma, Axis::Beta, Axis::Alpha]);
    assert_eq!(machine.fibre_point_nm, [875e3, 100e3, 500e3]);
    assert_eq!(machine.drives[0].travel, [-5e6, 5e6]);
    assert_eq!(machine.drives[0].velocity, 2e6);
    assert!((machine.drives[5].travel[1] - 52_359_877.56).abs() < 0.01);
    assert_eq!(machine.statics.values(), [5e-5; 9]);
}

#[test]
fn a_step_may_be_whole_or_not() {
    let machine = Machine::parse(&PAPER.replacen("step_nm = 50", "step_nm = 62.5", 1)).unwrap();
    assert_eq!(machine.drives[0].step, 62.5);
    assert_eq!(machine.drives[1].step, 50.0);
}

#[test]
fn absent_static_errors_and_offsets_are_zero() {
    let end = PAPER.find("[axis_offset_um]").unwrap();
    let axes = PAPER.find("[axes.X]").unwrap();
    let machine = Machine::parse(&format!("{}{}", &PAPER[..end], &PAPER[axes..])).unwrap();
    assert_eq!(machine.statics.values(), [0.0; 9]);
    assert_eq!(machine.axis_offset_nm, [[0.0; 3]; 6]);
}

#[test]
fn an_unknown_key_is_named_with_its_value() {
    names(&refusal("S_ZX = 5.0e-05", "S_YX = 7.0e-05"), "S_YX", "7.0e-05");
    names(&refusal("step_nm = 50", "step_um = 50"), "step_um", "50");
    names(&refusal("[axes.gamma]", "[axes.delta]"), "delta", "expected");
    names(&refusal("[axis_offset_um]", "[axis_offset_um]\ndelta = [1.5, 0, 0]"), "delta", "1.5");
}

#[test]
fn a_missing_key_is_named() {
    names(&refusal("max_jerk_deg_s3 = 400.0", ""), "max_jerk_deg_s3", "missing");
    names(&refusal("name = \"paper\"", ""), "name", "missing");
}

#[test]
fn a_value_of_the_wrong_kind_is_shown() {
    names(&refusal("backlash_nm = 300", "backlash_nm = \"much\""), "backlash_nm", "much");
    names(&refusal("[-5000.0, 5000.0]", "[-5000.0]"), "travel_um", "-5000.0");
}

#[test]
fn values_that_no_stage_can_have_are_refused_by_key_and_value() {
    names(&refusal("step_nm = 50", "step_nm = 1.9"), "axes.X.step_nm", "1.9");
    names(&refusal("step_nrad = 4000", "step_nrad = -4000"), "axes.alpha.step_nrad", "-4000");
    names(&refusal("step_nrad = 4000", "step_nrad = 32768"), "axes.alpha.step_nrad", "32768");
    names(&refusal("backlash_nm = 300", "backlash_nm = -1"), "axes.X.backlash_nm", "-1");
    names(&refusal("[-5000.0, 5000.0]", "[5000.0, -5000.0]"), "axes.X.travel_um", "[5000, -5000]");
    names(&refusal("max_jerk_um_s3 = 400000.0", "max_jerk_um_s3 = 0.0"), "axes.X.max_jerk_um_s3", "0");
    names(&refusal("max_velocity_deg_s = 2.0", "max_velocity_deg_s = nan"), "axes.alpha.max_velocity_deg_s", "NaN");
    names(&refusal("S_ZY = 5.0e-05", "S_ZY = 0.5"), "static_rad.S_ZY", "0.5");
    names(&refusal("S_ZY = 5.0e-05", "S_ZY = nan"), "static_rad.S_ZY", "NaN");
    names(&refusal("[875.0, 100.0, 500.0]", "[875.0, inf, 500.0]"), "fibre_point_um", "inf");
}

#[test]
fn a_step_rate_beyond_the_pulse_timing_is_refused_with_the_axis_and_the_rate() {
    let message = refusal("max_velocity_um_s = 2000.0", "max_velocity_um_s = 24950.1");
    names(&message, "axes.X.max_velocity_um_s", "24950.1");
    names(&message, "499002 steps/s", "499000");
    Machine::parse(&PAPER.replacen("max_velocity_um_s = 2000.0", "max_velocity_um_s = 24950.0", 1)).unwrap();
}

#[test]
fn an_order_that_is_no_permutation_is_refused() {
    names(&refusal("\"Z\", \"X\"", "\"Z\", \"Z\""), "order", "Z is named twice");
    names(&refusal("\"Z\", \"X\"", "\"Z\", \"W\""), "order", "\"W\"");
    names(&refusal("\"Z\", \"X\"", "\"Z\""), "order", "all six");
}

#[test]
fn a_name_beyond_sixteen_characters_or_ascii_is_refused() {
    names(&refusal("name = \"paper\"", "name = \"seventeen letters\""), "name", "seventeen letters");
    names(&refusal("name = \"paper\"", "name = \"µ-stage\""), "name", "µ-stage");
    names(&refusal("name = \"paper\"", "name = \"\""), "name", "\"\"");
}

#[test]
fn limit_switches_lie_a_little_beyond_the_travel_or_where_the_file_says() {
    let paper = Machine::paper();
    assert_eq!(paper.drives[0].switches, [-5.2e6, 5.2e6]);
    assert!((paper.drives[3].switches[1] - 3.2f64.to_radians() * 1e9).abs() < 1.0, "3 degrees of travel, 0.2 beyond");
    let own = "step_nm = 50\nswitches_um = [-5500.0, 4000.0]";
    let machine = Machine::parse(&PAPER.replacen("step_nm = 50", own, 1)).unwrap();
    assert_eq!((machine.drives[0].switches, machine.drives[1].switches), ([-5.5e6, 4e6], [-5.2e6, 5.2e6]));
    let swapped = refusal("step_nm = 50", "step_nm = 50\nswitches_um = [1.0, -1.0]");
    names(&swapped, "axes.X.switches_um", "[1, -1]");
}

#[test]
fn the_block_with_which_the_refill_is_measured_is_that_of_the_bench_machine() {
    let machine = Machine::parse(include_str!("../machines/bench.toml")).expect("valid");
    let block = host_sim::session::block_of(&machine).expect("can be calibrated");
    assert!(block == include_bytes!("../../tests/target/bench.block"), "make it anew: host-sim calibrate");
}
