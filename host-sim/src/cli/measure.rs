//! `host-sim measure`: a machine in, measurements of it out.

use super::Failure;
use super::common::{folder, load, replace, say, say_json, spares, writable};
use crate::machine::to_toml_with;
use crate::measure::{MeasuredFile, Settings, measure, nominal};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The nominal machine beside the measurements.
const NOMINAL: &str = "nominal.toml";
/// How it begins, by which it is known again.
const NOMINAL_HEADER: &str = "What is known of the stage before it is measured.";

/// Measure a stage whose constants are known as instruments would: with noise, drift and backlash, seeded.
///
/// Writes one .csv file for each measurement of docs/CALIBRATION.md, and nominal.toml, the machine without what is to
/// be measured. `identify` takes the directory.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML) of the true stage, or `paper` for the built-in machine.
    #[arg(long, value_name = "FILE")]
    machine: PathBuf,
    /// Directory for the measurements; made if it is not there.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Start of the random numbers: the same seed gives the same files.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Standard deviation of lengths, nm.
    #[arg(long, value_name = "NM", default_value_t = 50.0)]
    noise_nm: f64,
    /// Standard deviation of angles, urad.
    #[arg(long, value_name = "URAD", default_value_t = 1.0)]
    noise_urad: f64,
    /// Largest drift of lengths, nm per hour.
    #[arg(long, value_name = "NM/H", default_value_t = 0.0)]
    drift_nm: f64,
    /// Largest drift of angles, urad per hour.
    #[arg(long, value_name = "URAD/H", default_value_t = 0.0)]
    drift_urad: f64,
    /// Poses at which the fibre point is measured.
    #[arg(long, value_name = "N", default_value_t = 300)]
    poses: usize,
    /// Poses at which the array's orientation is measured.
    #[arg(long, value_name = "N", default_value_t = 100)]
    orientations: usize,
    /// Spoil so many readings of the fibre point (at most a tenth of them); the report names them.
    #[arg(long, value_name = "N", default_value_t = 0)]
    outliers: usize,
    /// Do not write into the files how large the noise is.
    #[arg(long)]
    unstated_noise: bool,
    /// Print what was written as one JSON object.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    machine: String,
    seed: u64,
    files: Vec<MeasuredFile>,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        for (name, value) in [
            ("--noise-nm", self.noise_nm),
            ("--noise-urad", self.noise_urad),
            ("--drift-nm", self.drift_nm),
            ("--drift-urad", self.drift_urad),
        ] {
            if !(0.0..1e6).contains(&value) {
                return Err(Failure::Refused(format!("{name} {value}: must be 0 or positive, below 1e6")));
            }
        }
        let settings = Settings {
            seed: self.seed,
            noise_nm: self.noise_nm,
            noise_nrad: self.noise_urad * 1e3,
            drift_nm_per_hour: self.drift_nm,
            drift_nrad_per_hour: self.drift_urad * 1e3,
            fibre_poses: self.poses,
            orientation_poses: self.orientations,
            outliers: self.outliers,
            state_noise: !self.unstated_noise,
        };
        let mut files = measure(&machine, &settings);
        files.retain(|file| file.readings > 0);
        folder(&self.output)?;
        self.refuse_strangers(&files)?;
        let known = to_toml_with(&nominal(&machine), &[NOMINAL_HEADER.to_string()], |_| None);
        let texts = files.iter().map(|file| (file.file.as_str(), file.text.as_str()));
        let targets: Vec<(PathBuf, &[u8])> = std::iter::once((NOMINAL, known.as_str()))
            .chain(texts)
            .map(|(name, text)| (self.output.join(name), text.as_bytes()))
            .collect();
        let io = |source| Failure::Io { path: self.output.display().to_string(), source };
        // a folder that is there is looked at before anything is written, a new one takes all
        if self.output.is_dir() {
            for (path, _) in &targets {
                spares(path, &[&self.machine])?;
                writable(path)?;
            }
        }
        std::fs::create_dir_all(&self.output).map_err(io)?;
        replace(&targets)?;
        let report = Report { machine: machine.name, seed: self.seed, files };
        if self.json {
            return say_json(&report);
        }
        for file in &report.files {
            say(format!("{}: {}, {} readings", file.file, file.kind, file.readings))?;
            for spoiled in &file.spoiled {
                say(format!("  line {}: {} spoiled by {:+.1} nm", spoiled.line, spoiled.column, spoiled.by))?;
            }
        }
        say(format!("written to {}", self.output.display()))
    }

    /// `identify` reads every .csv file of the directory: none of another measurement may lie there. Nor is what was
    /// not made here overwritten.
    fn refuse_strangers(&self, files: &[MeasuredFile]) -> Result<(), Failure> {
        let Ok(entries) = std::fs::read_dir(&self.output) else {
            return Ok(());
        };
        for name in entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()) {
            if name.to_lowercase().ends_with(".csv") && !files.iter().any(|file| file.file == name) {
                let directory = self.output.display();
                let reason = format!("{directory} holds {name} of another measurement; give a directory of its own");
                return Err(Failure::Refused(reason));
            }
        }
        let names = std::iter::once(NOMINAL).chain(files.iter().map(|file| file.file.as_str()));
        for path in names.map(|name| self.output.join(name)).filter(|path| path.is_file()) {
            if !made_here(&path).map_err(|source| Failure::Io { path: path.display().to_string(), source })? {
                let reason = format!(
                    "{}: is there already and was not made by `measure`; give a directory of its own",
                    path.display()
                );
                return Err(Failure::Refused(reason));
            }
        }
        Ok(())
    }
}

/// True when one of the comment lines on top is one that `measure` writes.
fn made_here(path: &Path) -> std::io::Result<bool> {
    let text = std::fs::read(path)?;
    let text = String::from_utf8_lossy(&text);
    let mut comments = text.lines().map_while(|line| line.strip_prefix("# "));
    Ok(comments.any(|comment| comment == NOMINAL_HEADER || comment.starts_with("made by: host-sim measure")))
}
