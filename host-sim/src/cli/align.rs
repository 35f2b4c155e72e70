//! `host-sim align`: a bench by a seed in, aligned fibres and what each channel loses out.

use super::Failure;
use super::common::{say, say_json};
use crate::alignment::{Alignment, Lab, LiveLine, Options, Step, align, no_setup};
use crate::bench_twin::{self, Bench, Side, Start};
use crate::control::LightControl;
use crate::optics::{uniformity_db, worst_db};
use serde::Serialize;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Align a fibre, a 1x8 splitter chip and a fibre array on a bench in the computer, over SCPI messages alone.
///
/// Two controllers move two six-axis stages whose true errors they know from noisy measurements only; both read the
/// light through their converters. From what cameras leave: +-10 um, +-0.4 deg on both sides.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Which bench: stages, chip, array, start and noise are drawn from it.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Start +-30 um off, with a large-area detector behind the chip.
    #[arg(long)]
    coarse: bool,
    /// Sent to both controllers before, commands alone, as often as wanted: `--setup "COMP:BACK:STAT OFF"`.
    #[arg(long, value_name = "MESSAGE", value_parser = setup)]
    setup: Vec<String>,
    /// Done at the bench before, as often as wanted: `laser off`, `laser <dBm>`, `fibre <1..8> broken`.
    #[arg(long, value_name = "WORDS", value_parser = str::parse::<LightControl>)]
    hand: Vec<LightControl>,
    /// Show the light while it goes on, so many times as fast as on a real bench; 0 is as fast as it can be.
    #[arg(long, value_name = "FACTOR", num_args = 0..=1, default_missing_value = "1")]
    live: Option<f64>,
    /// Print the result as one JSON object.
    #[arg(long)]
    json: bool,
}

/// What is said in the end.
#[derive(Serialize)]
struct Report {
    seed: u64,
    #[serde(flatten)]
    alignment: Alignment,
    /// What the bench really loses, by channel, dB.
    insertion_loss_db: Vec<f64>,
    worst_db: f64,
    uniformity_db: f64,
    /// The best that this bench allows.
    best_worst_db: f64,
    best_uniformity_db: f64,
    /// Least distance of any corner of the faces from the chip, input and output side: in the end, and on the way, um.
    clearance_um: [f64; 2],
    least_clearance_um: [f64; 2],
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        if let Some(factor) = self.live.filter(|factor| !(0.0..=1e6).contains(factor)) {
            return Err(Failure::Refused(format!("--live {factor}: must be 0 to 1e6")));
        }
        let refused = |reason: String| Failure::Refused(format!("bench {}: {reason}", self.seed));
        let start = if self.coarse { Start::COARSE } else { Start::CAMERAS };
        let bench = Bench::seeded(self.seed, &bench_twin::Options { start, ..bench_twin::Options::default() });
        let optimum = bench.optimum();
        let calibrated = |side| bench.calibrated(side).map(|found| found.machine);
        let calibrated = [calibrated(Side::Input), calibrated(Side::Output)];
        let [Ok(input), Ok(output)] = calibrated else {
            let reasons = calibrated.iter().filter_map(|machine| machine.as_ref().err());
            return Err(refused(reasons.map(ToString::to_string).collect::<Vec<_>>().join("; ")));
        };
        let mut lab = Lab::new(bench, &[input, output], self.seed).map_err(refused)?;
        self.hand.iter().for_each(|hand| hand.apply(lab.bench_mut()));
        let mut options = if self.coarse { Options::with_detector() } else { Options::default() };
        options.setup.extend(self.setup.iter().cloned());
        let live = self.live.filter(|_| std::io::stderr().is_terminal());
        if let Some(factor) = live {
            show(&mut lab, factor);
        }
        let mut watch = |step: &Step| {
            if !self.json {
                let level = step.level_dbm.map_or(String::new(), |level| format!("  {level:.3} dBm"));
                let clear = if live.is_some() { "\r\x1b[K" } else { "" };
                eprintln!("{clear}{:7.2} s  {}{level}", step.seconds, step.name);
            }
        };
        let alignment = align(&mut lab, &options, &mut watch).map_err(|error| refused(error.to_string()))?;
        let insertion_loss_db = lab.losses();
        let (worst_db, uniformity_db) = (worst_db(&insertion_loss_db), uniformity_db(&insertion_loss_db));
        let report = Report {
            seed: self.seed,
            alignment,
            insertion_loss_db,
            worst_db,
            uniformity_db,
            best_worst_db: optimum.worst_db,
            best_uniformity_db: optimum.uniformity_db,
            clearance_um: lab.bench().clearances_um(),
            least_clearance_um: lab.least_clearances_um(),
        };
        if self.json { say_json(&report) } else { say(text(&report)) }
    }
}

/// A message that sets something up.
fn setup(message: &str) -> Result<String, String> {
    no_setup(message).map_or_else(|| Ok(message.to_owned()), |reason| Err(reason.to_owned()))
}

/// A line that lives on standard error.
fn show(lab: &mut Lab, factor: f64) {
    let (mut line, begun) = (LiveLine::default(), Instant::now());
    lab.show(move |moment| {
        eprint!("\r\x1b[K{}", line.line(moment));
        let _ = std::io::stderr().flush();
        if factor > 0.0 {
            let due = Duration::from_secs_f64(moment.seconds / factor);
            std::thread::sleep(due.saturating_sub(begun.elapsed()));
        }
    });
}

fn text(report: &Report) -> String {
    let row = |(i, loss): (usize, &f64)| {
        let level = report.alignment.levels_dbm.get(i).copied().unwrap_or(f64::NAN);
        format!("| CH{} | {level:.3} | {loss:.3} |", i + 1)
    };
    let rows: Vec<String> = report.insertion_loss_db.iter().enumerate().map(row).collect();
    format!(
        "| channel | level, dBm | insertion loss, dB |\n|---|---|---|\n{}\n\n\
         worst {:.3} dB, {:.3} dB above the best that this bench allows; uniformity {:.3} dB (there {:.3} dB); {:.1} s;\n\
         nearest corners {:.2} and {:.2} um from the chip, {:.2} and {:.2} um on the way",
        rows.join("\n"),
        report.worst_db,
        report.worst_db - report.best_worst_db,
        report.uniformity_db,
        report.best_uniformity_db,
        report.alignment.seconds,
        report.clearance_um[0],
        report.clearance_um[1],
        report.least_clearance_um[0],
        report.least_clearance_um[1]
    )
}
