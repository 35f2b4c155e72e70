//! The command `host-sim calibrate` as a user meets it.

use stage_controller::compensation::calibration::Calibration;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A file name of its own for each test.
fn output(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn calibrate(machine: &Path, block: &Path, more: &[&str]) -> Output {
    let tool = env!("CARGO_BIN_EXE_host-sim");
    Command::new(tool).arg("calibrate").arg(machine).arg("-o").arg(block).args(more).output().expect("host-sim runs")
}

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("machines").join(name)
}

/// The paper's machine with one change, written to a file.
fn changed(name: &str, from: &str, to: &str) -> PathBuf {
    let text = std::fs::read_to_string(shipped("paper.toml")).unwrap();
    assert!(text.contains(from));
    let path = output(name);
    std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
    path
}

#[test]
fn a_machine_file_becomes_a_block_that_the_controller_accepts() {
    let block = output("long-lever.cal");
    let done = calibrate(&shipped("long-lever.toml"), &block, &[]);
    assert!(done.status.success(), "{done:?}");
    let calibration = Calibration::decode(&std::fs::read(&block).unwrap()).unwrap();
    assert_eq!(&calibration.name[..11], b"long-lever\0");
    let text = String::from_utf8(done.stdout).unwrap();
    assert!(text.contains("orientation residual") && text.contains("CRC-32"), "{text}");
}

#[test]
fn the_built_in_machine_needs_no_file() {
    let (built_in, file) = (output("built-in.cal"), output("paper.cal"));
    assert!(calibrate(Path::new("paper"), &built_in, &[]).status.success());
    assert!(calibrate(&shipped("paper.toml"), &file, &[]).status.success());
    assert_eq!(std::fs::read(built_in).unwrap(), std::fs::read(file).unwrap());
}

#[test]
fn the_report_is_json_on_demand() {
    let done = calibrate(&shipped("paper.toml"), &output("json.cal"), &["--json"]);
    let report: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(report["machine"], "paper");
    assert_eq!(report["backlash_steps"][3], 22);
    assert!(report["orientation_residual_urad"].as_f64().unwrap() < 0.1);
}

#[test]
fn a_refusal_ends_with_status_2_names_the_reason_and_writes_no_block() {
    let carried = changed("carried.toml", r#""Y", "gamma""#, r#""gamma", "Y""#);
    let mistaken = changed("mistaken.toml", "step_nm = 50", "step_nm = 0.5");
    for (machine, reason) in [(carried, "Y is carried by gamma"), (mistaken, "axes.X.step_nm = 0.5")] {
        let block = output("refused.cal");
        let done = calibrate(&machine, &block, &[]);
        assert_eq!(done.status.code(), Some(2), "{done:?}");
        let text = String::from_utf8(done.stderr).unwrap();
        assert!(text.contains(reason), "{text}");
        assert!(!block.exists());
    }
}

#[test]
fn a_file_that_cannot_be_read_ends_with_status_1_and_its_name() {
    let done = calibrate(Path::new("no-such-machine.toml"), &output("none.cal"), &[]);
    assert_eq!(done.status.code(), Some(1));
    assert!(String::from_utf8(done.stderr).unwrap().contains("no-such-machine.toml"));
}
