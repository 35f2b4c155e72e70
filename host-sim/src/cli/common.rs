//! What several subcommands begin with: a machine, a homed front, a board.

use super::Failure;
use crate::board::{Board, Interleaving};
use crate::machine::{Machine, MachineError};
use crate::session::power_up;
use std::path::Path;

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

/// A board in front of the machine's twin with its calibration, at rest; unless `cold`, homed at 0 on the reference
/// flank, and enabled.
pub fn board(machine: &Machine, cold: bool) -> Result<Board, Failure> {
    let refused = |reason: String| Failure::Refused(format!("{}: {reason}", machine.name));
    let front = power_up(machine, cold).map_err(refused)?;
    let mut board = Board::new(machine, front, Interleaving::Prompt, 0);
    board.settle();
    Ok(board)
}
