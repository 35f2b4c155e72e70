//! `host-sim calibrate`: machine file in, calibration block out.

use super::Failure;
use super::common::{load, replace, say, say_json, spares};
use crate::calibrate::calibrate;
use stage_controller::compensation::calibration::BLOCK_CAPACITY;
use std::path::PathBuf;

/// Compute the calibration block of a machine, and say how exact it is.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    machine: PathBuf,
    /// Where the block is written.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Print the report as JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        spares(&self.output, &[&self.machine])?;
        let named = |reason: String| Failure::Refused(format!("{}: {reason}", self.machine.display()));
        let (calibration, report) = calibrate(&machine).map_err(|refusal| named(refusal.to_string()))?;
        let mut block = [0; BLOCK_CAPACITY];
        let length = calibration.encode(&mut block).expect("a block fits its capacity");
        replace(&[(&self.output, &block[..length])])?;
        if self.json {
            say_json(&report)
        } else {
            say(format!("{report}\n{length} bytes written to {}", self.output.display()))
        }
    }
}
