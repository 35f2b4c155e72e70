//! The commands `topology`, `sensitivity` and `field` as a user meets them.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn host_sim(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_host-sim")).args(args).output().expect("host-sim runs")
}

/// Standard output of a run that must succeed and say nothing else.
fn said(args: &[&str]) -> String {
    let done = host_sim(args);
    assert!(done.status.success(), "{args:?}: {done:?}");
    assert_eq!(String::from_utf8_lossy(&done.stderr), "", "{args:?}");
    String::from_utf8(done.stdout).unwrap()
}

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&said(&[args, &["--json"]].concat())).unwrap()
}

/// Standard error of a run that must be refused with status 2 and print no result.
fn refused(args: &[&str]) -> String {
    let done = host_sim(args);
    assert_eq!(done.status.code(), Some(2), "{args:?}: {done:?}");
    assert!(done.stdout.is_empty(), "{args:?}");
    String::from_utf8(done.stderr).unwrap()
}

fn temporary(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

/// The paper's machine with kinematic errors, in a file.
fn with_kinematic(name: &str, kinematic: &str) -> String {
    let path = temporary(name);
    std::fs::write(&path, format!("{}\n{kinematic}\n", include_str!("../machines/paper.toml"))).unwrap();
    path.display().to_string()
}

/// Cells of the row of a Markdown table that begins with `first`.
fn row(markdown: &str, first: &str) -> Vec<String> {
    let line = markdown.lines().find(|line| line.starts_with(&format!("| {first} "))).expect(first);
    line.trim_matches('|').split('|').map(|cell| cell.trim().to_string()).collect()
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let mut tool = Command::new(env!("CARGO_BIN_EXE_host-sim"));
    let tool = tool.args(["report", "paper", "--json"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut running = tool.spawn().expect("host-sim runs");
    drop(running.stdout.take());
    let done = running.wait_with_output().unwrap();
    assert!(done.status.success() && done.stderr.is_empty(), "{done:?}");
}

#[test]
fn report_says_in_its_usage_that_it_needs_a_page_or_json() {
    let either = "<--output <FILE>|--json>";
    assert!(said(&["report", "--help"]).lines().any(|line| line.starts_with("Usage:") && line.contains(either)));
    assert!(refused(&["report", "paper"]).contains(either));
}

#[test]
fn topology_prints_the_three_orders_of_the_paper() {
    let text = said(&["topology"]);
    assert_eq!(text.matches("## Table 1").count(), 3);
    assert_eq!(row(&text, "L^3"), ["L^3", "0", "0", "0", "0", "2", "3", "4", "5"]);
    assert_eq!(text.matches("Y lies behind gamma: the coupling depends on the pose").count(), 1);
    assert_eq!(row(&text, "six at each of the eight interfaces")[1..], ["48", "24"]);
    assert_eq!(row(&text, "EYX"), ["EYX", "delta_y(X)", "X", "straightness", "um"]);
    let object = json(&["topology"]);
    assert_eq!(object["topologies"].as_array().unwrap().len(), 3);
    assert_eq!(object["kinematic_errors"].as_array().unwrap().len(), 36);
    assert_eq!(object["topologies"][1]["pose_dependent"][0], "Y lies behind gamma: the coupling depends on the pose");
}

#[test]
fn topology_takes_machines_orders_and_trees() {
    let object = json(&["topology", "machines/long-lever.toml", "--order", "gamma,X,Y,Z,beta,alpha"]);
    assert!(object["topologies"][0]["name"].as_str().unwrap().starts_with("long-lever"));
    assert_eq!(object["topologies"][0]["characteristic_matrices"][5]["mounting"], "Trans(120, 0, 0)");
    assert_eq!(object["topologies"][1]["pose_dependent"].as_array().unwrap().len(), 3);
    let tree = json(&["topology", "--tree", "-:2 gamma:0 X:0 Y:3 Z:4 -:5"]);
    assert_eq!(tree["topologies"][0]["low_order_array"][1], serde_json::json!([2, 0, 0, 3, 4, 5]));
    assert_eq!(tree["topologies"][0]["degrees_of_freedom"], 4);
}

#[test]
fn topology_refuses_what_is_none() {
    assert!(refused(&["topology", "--order", "X,Y,Z,alpha,beta"]).contains("all six"));
    assert!(refused(&["topology", "--order", "X,Y,Z,alpha,beta,delta"]).contains("delta"));
    assert!(refused(&["topology", "--order", "X,Y,Z,alpha,beta,X"]).contains("X is named twice"));
    assert!(refused(&["topology", "--tree", "-:0 X:7"]).contains("body 2 stands on body 7"));
    assert!(refused(&["topology", "--tree", "-:0 X"]).contains("JOINT:BODY"));
}

#[test]
fn sensitivity_says_the_same_in_all_three_ways() {
    let markdown = said(&["sensitivity", "paper"]);
    assert!(markdown.contains("## Table 5, with static errors") && markdown.contains("## Table 6, without"));
    assert_eq!(row(&markdown, "delta_z(Z)"), ["delta_z(Z)", "EZZ", "0.3", "0.059985", "0.056262", "0.183753"]);
    let object = json(&["sensitivity", "paper"]);
    assert_eq!(object["kinematic"][2]["iso"], "EZZ");
    assert!((object["kinematic"][2]["E_with_static"][2].as_f64().unwrap() - 0.183753).abs() < 1e-6);
    assert_eq!(object["kinematic"][3]["value"], 5e-5);
    let csv = said(&["sensitivity", "paper", "--csv"]);
    let first = csv.split("\n\n").next().unwrap();
    let mut reader = csv::Reader::from_reader(first.as_bytes());
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 36);
    assert_eq!(
        rows[2].iter().skip(1).collect::<Vec<_>>(),
        ["delta_z(Z)", "EZZ", "0.3", "0.059985", "0.056262", "0.183753"]
    );
}

#[test]
fn sensitivity_takes_its_inputs_from_the_command_line() {
    let object = json(&[
        "sensitivity",
        "paper",
        "--fibre-point-um",
        "0,0,-1000",
        "--error-um",
        "0.1",
        "--error-urad",
        "10",
        "--unit-um",
        "2",
        "--unit-mrad",
        "1",
        "--static-urad",
        "20",
        "--background",
        "uniform",
    ]);
    assert_eq!(object["F"], serde_json::json!([0.0, 0.0, -1000.0]));
    let near = |value: &Value, wanted: f64| (value.as_f64().unwrap() - wanted).abs() < 1e-9;
    // 10 urad about y at -1 mm; three times 20 urad of static errors
    assert!(near(&object["kinematic"][4]["E_first_order"][0], -0.01));
    assert!(near(&object["background_first_order_um"][0], -0.06));
    let wrong = refused(&["sensitivity", "paper", "--fibre-point-um", "1,2"]);
    assert!(wrong.contains("3 numbers"), "{wrong}");
    assert!(refused(&["sensitivity", "paper", "--error-um", "NaN"]).contains("finite"));
    for command in ["sensitivity", "field"] {
        for (option, most) in
            [("--error-um", "200 um"), ("--error-urad", "20000 urad"), ("--static-urad", "20000 urad")]
        {
            for value in ["1e300", "-20001"] {
                let said = refused(&[command, "paper", option, value]);
                let number = value.parse::<f64>().unwrap();
                let unit = most.split(' ').nth(1).unwrap();
                let reason = format!("{number:e} {unit} is no error of a stage: at most {most}");
                assert!(said.contains(option) && said.contains(&reason), "{said}");
            }
        }
    }
    assert!(refused(&["sensitivity", "paper", "--unit-um", "0"]).contains("above zero"));
}

#[test]
fn sensitivity_lists_the_numbers_of_the_paper_on_demand() {
    let text = said(&["sensitivity", "paper", "--paper-numbers"]);
    assert_eq!(row(&text, "static errors amplify Z by 0.1838 um")[1..5], ["0.1838", "0.18375", "um", "reproduced"]);
    assert_eq!(row(&text, "0.15 dB for 16 um of gap")[4], "not reproduced");
    assert!(json(&["sensitivity", "paper"]).get("paper_numbers").is_none());
}

#[test]
fn field_says_maximum_rms_percentiles_worst_pose_and_ensembles() {
    let args = ["field", "paper", "--points", "5", "--stages", "20", "--linear-um", "5000", "--angular-deg", "1"];
    let object = json(&args);
    let linear = &object["motions"][0];
    let near = |value: &Value, wanted: f64, digits: f64| (value.as_f64().unwrap() - wanted).abs() < 0.5 * digits;
    assert!(near(&linear["same_sign"]["x_um"]["max"], 1.770, 0.001), "{linear}");
    assert!(near(&linear["same_sign"]["z_um"]["max"], 1.918, 0.001));
    assert!(near(&object["motions"][1]["same_sign"]["y_um"]["max"], 1.039, 0.001));
    assert!(linear["after"]["norm_um"]["max"].as_f64() < linear["before"]["norm_um"]["max"].as_f64());
    for key in ["max", "rms", "p50", "p95", "p99", "worst_pose_um_deg"] {
        assert!(!linear["machine"]["norm_um"][key].is_null(), "{key}");
    }
    assert_eq!(linear["ensembles"][0]["stages"], 20);
    assert_eq!(said(&args), said(&args), "the same seed gives the same stages");
    let other = json(&[&args[..], &["--seed", "2"]].concat());
    assert_ne!(other["motions"][0]["ensembles"], linear["ensembles"]);
    assert_eq!(other["motions"][0]["machine"], linear["machine"]);
}

#[test]
fn compensation_leaves_the_kinematic_errors() {
    let file = with_kinematic("wavy.toml", "[kinematic.X]\nEYX = {fourier = [[10000, 0, 2.0]]}");
    let object = json(&["field", &file, "--stages", "1", "--points", "9"]);
    let linear = &object["motions"][0];
    assert!((linear["after_exact"]["y_um"]["max"].as_f64().unwrap() - 2.0).abs() < 1e-3, "{}", linear["after_exact"]);
    assert!(linear["after_exact"]["x_um"]["max"].as_f64().unwrap() < 1e-3);
    // half a step of 50 nm
    assert!(linear["after"]["x_um"]["max"].as_f64().unwrap() <= 0.0251);
}

#[test]
fn field_draws_a_figure_that_is_well_formed() {
    let path = temporary("fig5.svg");
    said(&["field", "paper", "--stages", "1", "--points", "7", "-o", path.to_str().unwrap()]);
    let svg = std::fs::read_to_string(path).unwrap();
    assert!(svg.starts_with("<svg xmlns=") && svg.ends_with("</svg>\n"));
    assert_eq!(svg.matches("(um) at ").count(), 18, "six fields, three panels each");
    for text in ["all errors of the same sign (Fig. 5)", "not compensated", "compensated by the controller"] {
        assert_eq!(svg.matches(text).count(), 2, "{text}");
    }
    // the extremes of the field stand at the scale: Ez over +-5 mm
    assert!(svg.contains(">+1.9176<"), "no scale to 1.9176 um");
    assert!(!svg.contains("NaN") && !svg.contains("inf"));
}

#[test]
fn field_gives_the_error_at_single_poses() {
    let poses = ["field", "paper", "--pose", "0,0,0,0,0,0", "--pose=-1000,2000,0,0,0,0"];
    let object = json(&poses);
    let e = |i: usize, c: usize| object["poses"][i]["E_um"][c].as_f64().unwrap();
    assert!((e(0, 0) - 0.059985).abs() < 1e-6 && (e(0, 2) + 0.116247).abs() < 1e-6);
    // squareness of 50 urad over the way: -y S_XY along x, -x S_ZX + y S_ZY along z
    assert!((e(1, 0) - e(0, 0) + 0.1).abs() < 1e-4 && (e(1, 2) - e(0, 2) - 0.15).abs() < 1e-4);
    let turned = object["poses"][0]["rotation_rad"][0].as_f64().unwrap();
    assert!((turned - 1.5e-4).abs() < 1e-7);
    assert!(row(&said(&poses), "0 0 0 0 0 0")[1].starts_with("0.05998"));
    assert!(refused(&["field", "paper", "--pose", "0,0,0"]).contains("6 numbers"));
}

#[test]
fn field_refuses_coordinates_that_no_machine_has_and_marks_those_beyond_the_travel() {
    for (option, value, reason) in [
        ("--linear-um", "1e300", "at most 536870.912 um"),
        ("--linear-um", "536871", "536871 um is beyond"),
        ("--angular-deg", "31", "31 deg is beyond"),
        ("--pose", "0,0,-1e9,0,0,0", "Z: -1000000000 um is beyond"),
        ("--pose", "0,0,0,0,90,0", "beta: 90 deg is beyond"),
    ] {
        let message = refused(&["field", "paper", &format!("{option}={value}")]);
        assert!(message.contains(reason), "{message}");
    }
    let small = ["field", "paper", "--points", "3", "--stages", "1"];
    assert!(!said(&small).contains("beyond"), "the travel itself is not beyond the travel");
    let far = json(&[&small[..], &["--linear-um", "536870", "--angular-deg", "30"]].concat());
    assert_eq!(far["motions"][0]["beyond_travel"], serde_json::json!(["X", "Y", "Z"]));
    assert!(far["motions"][0]["machine"]["norm_um"]["max"].as_f64().unwrap() > 1.0);
    let text = said(&[&small[..], &["--angular-deg", "4"]].concat());
    assert!(text.contains("beyond the machine's travel of alpha, beta, gamma"), "{text}");
    let text = said(&["field", "paper", "--pose", "0,6000,0,0,0,0", "--pose", "0,5000,0,0,0,0"]);
    assert!(
        text.contains("0 6000* 0") && text.contains("0 5000 0") && text.contains("*: beyond the machine's"),
        "{text}"
    );
}

#[test]
fn field_dumps_every_pose() {
    let csv = said(&["field", "paper", "--dump", "--points", "3", "--stages", "1"]);
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    assert_eq!(reader.headers().unwrap().iter().nth(8), Some("Ex_um"));
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 2 * 27);
    assert!(rows.iter().all(|row| row.iter().skip(2).all(|cell| cell.parse::<f64>().is_ok())));
}

#[test]
fn field_says_why_the_controller_cannot_compensate() {
    let path = temporary("turned.toml");
    let text = include_str!("../machines/paper.toml").replacen(r#""Y", "gamma""#, r#""gamma", "Y""#, 1);
    std::fs::write(&path, text).unwrap();
    let object = json(&["field", path.to_str().unwrap(), "--stages", "1", "--points", "3"]);
    assert!(object["motions"][0]["refusal"].as_str().unwrap().contains("Y is carried by gamma"));
    assert!(object["motions"][0]["after"].is_null() && !object["motions"][0]["after_exact"].is_null());
}

#[test]
fn a_machine_file_that_is_none_is_refused_with_file_line_and_key() {
    let unknown = with_kinematic("unknown.toml", "[kinematic.X]\nEXY = {poly = [0.1]}");
    let mistaken = with_kinematic("mistaken.toml", "[kinematic.X]\nEXX = {poly = [300]}");
    for tool in ["sensitivity", "field", "topology"] {
        let message = refused(&[tool, &unknown]);
        assert!(message.contains("unknown.toml") && message.contains("line") && message.contains("EXY"), "{message}");
        let message = refused(&[tool, &mistaken]);
        assert!(message.contains("mistaken.toml") && message.contains("kinematic.X.EXX = 300 um"), "{message}");
    }
    let done = host_sim(&["field", "no-such-file.toml"]);
    assert_eq!(done.status.code(), Some(1));
}

#[test]
fn the_help_of_each_tool_names_units() {
    for tool in ["topology", "sensitivity", "field"] {
        let help = said(&[tool, "--help"]);
        assert!(help.contains("um") && help.contains("--json"), "{help}");
    }
    assert!(said(&["field", "--help"]).contains("degrees"));
}
