//! What several subcommands begin with: a machine, a homed front, a board.

use super::Failure;
use crate::board::{Board, Interleaving};
use crate::calibrate::calibrate;
use crate::machine::{Machine, MachineError};
use stage_controller::compensation::calibration::BLOCK_CAPACITY;
use stage_controller::controller::front::Front;
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

/// A controller with the machine's own calibration, homed at 0 on the reference flank, enabled.
pub fn homed_front(machine: &Machine) -> Result<Front, Failure> {
    let refused = |reason: String| Failure::Refused(format!("{}: {reason}", machine.name));
    let (calibration, _) = calibrate(machine).map_err(|refusal| refused(refusal.to_string()))?;
    let mut block = [0; BLOCK_CAPACITY];
    let length = calibration.encode(&mut block).expect("a block fits its capacity");
    let mut front = Front::new();
    front.load(&block[..length]).map_err(|error| refused(error.to_string()))?;
    front.assume_homed();
    Ok(front)
}

/// The same on a board in front of the machine's twin, at rest.
pub fn board(machine: &Machine) -> Result<Board, Failure> {
    let mut board = Board::new(machine, homed_front(machine)?, Interleaving::Prompt, 0);
    board.settle();
    Ok(board)
}
