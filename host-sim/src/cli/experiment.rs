//! `host-sim experiment`: what compensation is worth in light.

use super::Failure;
use super::bench::Clocks;
use super::common::{replace, say, say_json, with_progress, writable};
use crate::experiment::{Experiment, Prepared, Run, Search, render, tables};
use crate::report::Mode;
use std::path::PathBuf;
use std::time::Instant;

/// Align a splitter chip on many benches, with every part of the compensation, by a naive climb and by a robust search:
/// insertion loss and uniformity (dB), time (s), as Tables 7 and 8 of the paper have them.
///
/// The scenario is written in docs/EXPERIMENT.md.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Benches: seeds 1 to N.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// Write one self-contained HTML page with plots.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Print all figures and all runs as one JSON object on stdout.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        if let Some(path) = &self.output {
            writable(path)?;
        }
        let (took, simulated) = one_alignment().map_err(Failure::Refused)?;
        let begun = Instant::now();
        let experiment = with_progress(Experiment::progress_steps(self.seeds), "runs", |progress| {
            Experiment::new(self.seeds, progress)
        })
        .map_err(Failure::Refused)?;
        eprintln!(
            "one full alignment ({simulated:.1} s simulated): {:.2} s by the clock{}; {} runs in {:.0} s on {} cores",
            took.wall_s,
            took.cpu_s.map_or(String::new(), |cpu| format!(", {cpu:.2} s of one core")),
            experiment.runs.len(),
            begun.elapsed().as_secs_f64(),
            rayon::current_num_threads()
        );
        if let Some(path) = &self.output {
            let page = render(&experiment);
            replace(&[(path, page.as_bytes())])?;
            if !self.json {
                say(format!("{} bytes written to {}", page.len(), path.display()))?;
            }
        }
        if self.json { say_json(&experiment) } else { say(tables(&experiment)) }
    }
}

/// What one alignment by the robust search with everything on takes, and its simulated time, s.
fn one_alignment() -> Result<(Clocks, f64), String> {
    let prepared = Prepared::new(1)?;
    let begin = Instant::now();
    let before = Clocks::now(begin);
    let run = Run::new(&prepared, Search::Robust, Mode::All)?;
    Ok((Clocks::now(begin).since(before), run.seconds))
}
