//! The manual, its examples and the command tree.

use host_sim::board::{Board, Interleaving};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::controller::links::Links;
use stage_controller::scpi::tree::{Command, TABLE};
use std::process::{Command as Process, Output};

/// A board with the paper's calibration and one link to it.
struct Stage {
    board: Board,
    links: Links<1>,
}

impl Stage {
    fn new() -> Self {
        let machine = Machine::paper();
        let front = power_up(&machine, false).unwrap();
        let mut board = Board::new(&machine, front, Interleaving::Prompt, 1);
        assert!(board.settle());
        let mut links = Links::new();
        links.open(0);
        Stage { board, links }
    }

    /// Sends a line, lets one second pass, and gives what was answered.
    fn say(&mut self, line: &str) -> String {
        let mut answer = Vec::new();
        assert_eq!(self.links.receive(0, format!("{line}\n").as_bytes(), 0), line.len() + 1);
        for _ in 0..8_000 {
            self.links.poll(&mut self.board.front, 0);
            let mut part = [0; 256];
            let length = self.links.transmit(0, &mut part);
            answer.extend_from_slice(&part[..length]);
            self.board.step(|_| ());
        }
        String::from_utf8_lossy(&answer).into_owned()
    }
}

#[test]
fn a_live_controller_accepts_every_example() {
    let mut stage = Stage::new();
    for entry in TABLE {
        let answer = stage.say(entry.example);
        assert_eq!(answer.is_empty(), !entry.example.contains('?'), "{}: {answer}", entry.example);
        let error = stage.say("SYST:ERR?");
        let expected = match entry.command {
            // the example is no real block, the step sizes come from the calibration, no switch is watched
            Command::CompensationLoad | Command::AxisStepSize | Command::AxisHome => "-221",
            // nothing waits for it
            Command::Trigger => "-211",
            // it is dark, and nothing has been stopped
            Command::ScanStart => "113",
            Command::ScanContinue => "-221",
            _ => "0,\"No error\"",
        };
        assert!(error.starts_with(expected), "{}: {error}", entry.example);
        let number: i16 = error.split(',').next().unwrap().parse().unwrap();
        assert!(number == 0 || entry.errors.iter().any(|e| e.code() == number), "{} is not listed", error);
        stage.say("STOP;*OPC?");
    }
}

#[test]
fn settings_take_their_least_most_and_default() {
    let mut stage = Stage::new();
    for entry in TABLE.iter().filter(|e| e.params.first().is_some_and(|p| p.extremes)) {
        let header: String = entry.pattern.replace('#', "2").chars().filter(|c| !"[]".contains(*c)).collect();
        for which in ["MIN", "MAX", "DEF"] {
            let value = stage.say(&format!("{header}? {which}"));
            let value = value.trim();
            assert!(!value.is_empty(), "{header}? {which}");
            stage.say("*CLS");
            stage.say(&format!("{header} {value}"));
            let error = stage.say("SYST:ERR?");
            // beyond the range is impossible; what else may be in the way is in the table
            let number: i16 = error.split(',').next().unwrap().parse().unwrap();
            assert!(number == 0 || entry.errors.iter().any(|e| e.code() == number), "{header} {value}: {error}");
            if number == 0 {
                assert_eq!(stage.say(&format!("{header}?")).trim(), value, "{header}");
            }
        }
    }
}

fn manual(args: &[&str]) -> Output {
    Process::new(env!("CARGO_BIN_EXE_host-sim")).arg("manual").args(args).output().unwrap()
}

#[test]
fn the_manual_in_the_repository_is_the_one_of_the_command_tree() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/COMMANDS.md");
    let done = manual(&["--check", shipped]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

#[test]
fn a_manual_that_differs_is_named_with_the_line() {
    let changed = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("changed.md");
    let text = String::from_utf8(manual(&[]).stdout).unwrap();
    std::fs::write(&changed, text.replacen("\n## Messages", "\n## Message", 1)).unwrap();
    let done = manual(&["--check", changed.to_str().unwrap()]);
    assert_eq!(done.status.code(), Some(2));
    let line = text.lines().position(|line| line == "## Messages").unwrap() + 1;
    let reason = String::from_utf8(done.stderr).unwrap();
    assert!(reason.contains(&format!("changed.md:{line}: ")), "{reason}");
}
