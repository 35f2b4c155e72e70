//! `host-sim report`: everything about a machine on one page.

use super::Failure;
use super::common::{load, replace, say, say_json, spares, with_progress, writable};
use crate::report::{Report, render};
use std::path::PathBuf;

/// Write one self-contained HTML page about a machine: chain and tables, sensitivities (um), errors over the travel
/// (um, urad), what each compensation buys (um), what fixed point costs (nm), the numbers of the paper.
#[derive(Debug, clap::Args)]
#[group(skip)]
#[command(group(clap::ArgGroup::new("result").args(["output", "json"]).required(true).multiple(true)))]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    machine: PathBuf,
    /// Where the page is written.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print the figures of the page as one JSON object on stdout.
    #[arg(long)]
    json: bool,
    /// Date that the page bears, as text; without it the page bears none (nothing looks at a clock).
    #[arg(long, value_name = "TEXT")]
    date: Option<String>,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        if let Some(path) = &self.output {
            writable(path)?;
            spares(path, &[&self.machine])?;
        }
        let file = self.machine.file_name().map_or_else(|| machine.name.clone(), |name| name.to_string_lossy().into());
        let report = with_progress(Report::progress_steps(), "fields", |progress| {
            Report::new(&machine, &file, self.date.as_deref(), progress)
        });
        if let Some(path) = &self.output {
            let page = render(&report);
            replace(&[(path, page.as_bytes())])?;
            if !self.json {
                say(format!("{} bytes written to {}", page.len(), path.display()))?;
            }
        }
        if self.json {
            say_json(&report)?;
        }
        Ok(())
    }
}
