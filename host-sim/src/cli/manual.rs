//! `host-sim manual`: the manual of the language, made from the command tree.

use super::Failure;
use super::common::say;
use crate::manual;
use std::path::{Path, PathBuf};

/// Write the manual of the commands, or check that a file still is what would be written.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Where the manual is written; without it, to the standard output.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Fail when this file differs from the manual.
    #[arg(long, value_name = "FILE", conflicts_with = "output")]
    check: Option<PathBuf>,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let text = manual::text();
        match (self.output, self.check) {
            (Some(path), _) => std::fs::write(&path, text).map_err(|source| failed(&path, source)),
            (None, Some(path)) => check(&path, &text),
            (None, None) => say(text),
        }
    }
}

fn check(path: &Path, text: &str) -> Result<(), Failure> {
    let present = std::fs::read_to_string(path).map_err(|source| failed(path, source))?;
    if present == text {
        return Ok(());
    }
    let same = present.lines().zip(text.lines()).take_while(|(a, b)| a == b).count();
    Err(Failure::Refused(format!(
        "{}:{}: not what the command tree gives; make it anew with `host-sim manual -o {}`",
        path.display(),
        same + 1,
        path.display()
    )))
}

fn failed(path: &Path, source: std::io::Error) -> Failure {
    Failure::Io { path: path.display().to_string(), source }
}
