//! The command line: one file per subcommand, each with its `Args` and a `run`.

mod bench;
mod calibrate;
mod common;
mod move_pose;
mod trace;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Motion controller for six-axis fibre alignment stages, on the desktop.
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Bench(bench::Args),
    Calibrate(calibrate::Args),
    Move(move_pose::Args),
    Trace(trace::Args),
}

/// Why a subcommand failed, and with it the exit status.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Failure {
    /// The input is refused: status 2.
    #[error("{0}")]
    Refused(String),
    /// A file cannot be read or written: status 1.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
}

impl Failure {
    /// Exit status of the process.
    pub fn status(&self) -> u8 {
        match self {
            Failure::Refused(_) => 2,
            Failure::Io { .. } => 1,
        }
    }
}

/// Parses the arguments of the process and runs the subcommand.
pub fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Bench(args) => args.run(),
        Command::Calibrate(args) => args.run(),
        Command::Move(args) => args.run(),
        Command::Trace(args) => args.run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("host-sim: {failure}");
            ExitCode::from(failure.status())
        }
    }
}
