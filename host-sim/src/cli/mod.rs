//! The command line: one file per subcommand, each with its `Args` and a `run`.

mod align;
mod bench;
mod calibrate;
mod common;
mod experiment;
mod field;
mod identify;
mod load;
mod manual;
mod measure;
mod move_pose;
mod report;
mod sensitivity;
mod serve;
mod sheet;
mod topology;
mod trace;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Motion controller for six-axis fibre alignment stages, on the desktop.
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// Without a subcommand: `serve`.
    #[command(flatten)]
    serve: serve::Args,
}

#[derive(Debug, Subcommand)]
enum Command {
    Serve(serve::Args),
    Calibrate(calibrate::Args),
    Identify(identify::Args),
    Measure(measure::Args),
    Manual(manual::Args),
    Load(load::Args),
    Move(move_pose::Args),
    Report(report::Args),
    Trace(trace::Args),
    Align(align::Args),
    Bench(bench::Args),
    Experiment(experiment::Args),
    Topology(topology::Args),
    Sensitivity(sensitivity::Args),
    Field(field::Args),
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
    let cli = Cli::parse();
    let result = match cli.command.unwrap_or(Command::Serve(cli.serve)) {
        Command::Serve(args) => args.run(),
        Command::Calibrate(args) => args.run(),
        Command::Identify(args) => args.run(),
        Command::Measure(args) => args.run(),
        Command::Manual(args) => args.run(),
        Command::Load(args) => args.run(),
        Command::Move(args) => args.run(),
        Command::Report(args) => args.run(),
        Command::Trace(args) => args.run(),
        Command::Align(args) => args.run(),
        Command::Bench(args) => args.run(),
        Command::Experiment(args) => args.run(),
        Command::Topology(args) => args.run(),
        Command::Sensitivity(args) => args.run(),
        Command::Field(args) => args.run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("host-sim: {failure}");
            ExitCode::from(failure.status())
        }
    }
}
