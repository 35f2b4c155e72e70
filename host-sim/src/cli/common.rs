//! What several subcommands begin with: a machine, a homed front, a board; and how they show progress.

use super::Failure;
use crate::board::{Board, Interleaving};
use crate::machine::{Machine, MachineError};
use crate::session::power_up;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::Once;
use std::time::{Duration, Instant};

/// What takes longer shows a bar.
const PATIENCE: Duration = Duration::from_secs(1);

/// A machine file, or the built-in machine by its name when there is no such file.
pub fn load(path: &Path) -> Result<Machine, Failure> {
    if path == Path::new("paper") && !path.exists() {
        return Ok(Machine::paper());
    }
    Machine::load(path).map_err(|error| match error {
        MachineError::Read { path, source } => Failure::Io { path, source },
        other => Failure::Refused(format!("{}: {other}", path.display())),
    })
}

/// Writes a line or several to standard output. A reader that has seen enough and went away is no failure.
pub fn say(text: impl Display) -> Result<(), Failure> {
    let mut text = text.to_string();
    if !text.ends_with('\n') {
        text.push('\n');
    }
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(source) if source.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Io { path: "standard output".into(), source })
        }
        _ => Ok(()),
    }
}

/// The same of a result as one JSON object.
pub fn say_json(result: &impl serde::Serialize) -> Result<(), Failure> {
    say(serde_json::to_string_pretty(result).expect("a result is plain data"))
}

/// A board in front of the machine's twin with its calibration, at rest; unless `cold`, homed at 0 on the reference
/// flank, and enabled.
pub fn board(machine: &Machine, cold: bool) -> Result<Board, Failure> {
    let refused = |reason: String| Failure::Refused(format!("{}: {reason}", machine.name));
    let front = power_up(machine, cold).map_err(refused)?;
    let mut board = Board::new(machine, front, Interleaving::Prompt, 0);
    board.settle();
    Ok(board)
}

/// Work that calls back `total` times, from any thread. On a terminal a bar shows when it takes longer than a second.
pub fn with_progress<T>(total: u64, things: &str, work: impl FnOnce(&(dyn Fn() + Sync)) -> T) -> T {
    let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
    let template = format!("{{wide_bar}} {{pos}}/{{len}} {things}, {{eta}} left");
    bar.set_style(ProgressStyle::with_template(&template).expect("the template is valid"));
    let (begun, shown) = (Instant::now(), Once::new());
    let result = work(&|| {
        bar.inc(1);
        if begun.elapsed() > PATIENCE {
            shown.call_once(|| bar.set_draw_target(ProgressDrawTarget::stderr()));
        }
    });
    bar.finish_and_clear();
    result
}
