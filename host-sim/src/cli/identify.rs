//! `host-sim identify`: measurements in, machine file out.

use super::Failure;
use super::common::{Spinner, folder, load, replace, say, say_json, spares, writable};
use crate::identify::{
    Identification, Options, ReadError, Refusal, Series, backlash_name, identify, is_measurement, plots, read_directory,
};
use crate::machine::{Machine, MachineError, StaticErrors, to_toml_with};
use stage_controller::units::Axis;
use std::path::{Path, PathBuf};

/// Fit the constants of a stage and the backlash of its motors to measurements, and write them as a machine file.
///
/// Reads every .csv file of a directory; docs/CALIBRATION.md says what to measure and how the files look. Lengths are
/// in um or nm and angles in urad, deg or arcsec, as the names of the columns say. The result is for `calibrate`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Directory with the measurements (*.csv).
    #[arg(long, value_name = "DIR")]
    measurements: PathBuf,
    /// Machine file with what is known: order, travels, steps, fibre point, offsets of the drawing. Default: the file
    /// nominal.toml beside the measurements.
    #[arg(long, value_name = "FILE")]
    nominal: Option<PathBuf>,
    /// Where the machine file is written.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Do not fit these: NAME keeps the nominal value, NAME=VALUE is in rad, um, nm or nrad as in the machine file;
    /// a beginning such as mount.fibre.rot_rad stands for all under it, `backlash` for every motor's.
    #[arg(long, value_name = "NAME[=VALUE],...", value_delimiter = ',', allow_hyphen_values = true)]
    hold: Vec<String>,
    /// Do not fit a drift to files with times.
    #[arg(long)]
    no_drift: bool,
    /// Keep readings that do not belong to the others.
    #[arg(long)]
    keep_outliers: bool,
    /// Write a picture of the residuals of each file (SVG) into this directory.
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    /// Print the report as one JSON object (values and sigmas in rad, um, nm, nrad).
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let (nominal, source) = self.nominal_machine()?;
        let options = Options { hold: self.held()?, drift: !self.no_drift, reject: !self.keep_outliers };
        let series = read_directory(&self.measurements, &nominal.order).map_err(|error| self.failure(error.into()))?;
        self.check_outputs(&series)?;
        let mut progress = Spinner::new();
        let mut result = identify(&series, &nominal, &options, &mut |what| progress.show(what))
            .map_err(|refusal| self.failure(refusal))?;
        progress.clear();
        result.gauge.push(format!("What is not fitted is as in {source}."));
        let text = machine_file(&result);
        Machine::parse(&text).map_err(|error| Failure::Refused(impossible(&error)))?;
        // nothing is written before everything is known to be good
        let mut files = Vec::new();
        if let Some(directory) = &self.plots {
            std::fs::create_dir_all(directory).map_err(|source| io(directory, source))?;
            for (index, file) in result.files.iter().enumerate() {
                if let Some(svg) = plots::residuals(&result, index) {
                    files.push((picture(directory, &file.file), svg));
                }
            }
        }
        files.push((self.output.clone(), text));
        replace(&files.iter().map(|(path, text)| (path, text.as_bytes())).collect::<Vec<_>>())?;
        if self.json { say_json(&result) } else { say(format!("{result}written to {}", self.output.display())) }
    }

    /// Everything can be written, and nothing that was read is lost by it.
    fn check_outputs(&self, series: &[Series]) -> Result<(), Failure> {
        let mut read: Vec<PathBuf> = series.iter().map(|series| self.measurements.join(&series.file)).collect();
        read.push(self.nominal.clone().unwrap_or_else(|| self.beside()));
        let mut outputs = vec![self.output.clone()];
        if let Some(directory) = &self.plots {
            folder(directory)?;
            outputs.extend(series.iter().map(|series| picture(directory, &series.file)));
        }
        for output in &outputs {
            spares(output, &read)?;
            // the folder of the pictures may still have to be made
            if output.parent() != self.plots.as_deref() || output.exists() {
                writable(output)?;
            }
        }
        self.refuse_measurement(&self.output)
    }

    /// A file that the next run would read as a measurement is no place for the result.
    fn refuse_measurement(&self, output: &Path) -> Result<(), Failure> {
        let folder = output.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (Ok(folder), Ok(measurements)) = (folder.canonicalize(), self.measurements.canonicalize()) else {
            return Ok(());
        };
        if is_measurement(output) && folder == measurements {
            return Err(Failure::Refused(format!(
                "{}: the next run would read it as a measurement, as every .csv file of {}; name a .toml file",
                output.display(),
                self.measurements.display()
            )));
        }
        Ok(())
    }

    /// The nominal machine beside the measurements.
    fn beside(&self) -> PathBuf {
        self.measurements.join("nominal.toml")
    }

    fn nominal_machine(&self) -> Result<(Machine, String), Failure> {
        let beside = self.beside();
        match &self.nominal {
            Some(path) => Ok((load(path)?, path.display().to_string())),
            None if beside.exists() => Ok((load(&beside)?, beside.display().to_string())),
            None => {
                let reason = format!(
                    "no nominal machine: give --nominal FILE, or put {} beside the measurements (order of the axes, \
                     travels, steps, fibre point)",
                    beside.display()
                );
                Err(Failure::Refused(reason))
            }
        }
    }

    fn held(&self) -> Result<Vec<(String, Option<f64>)>, Failure> {
        let one = |text: &String| match text.split_once('=') {
            None => Ok((text.trim().to_string(), None)),
            Some((name, value)) => match value.trim().parse::<f64>() {
                Ok(value) if value.is_finite() => Ok((name.trim().to_string(), Some(value))),
                _ => Err(Failure::Refused(format!("--hold {text}: {value:?} is no number"))),
            },
        };
        self.hold.iter().map(one).collect()
    }

    fn failure(&self, refusal: Refusal) -> Failure {
        match refusal {
            Refusal::Read(ReadError::Io { path, source }) => Failure::Io { path, source },
            Refusal::Read(ReadError::Line { .. }) => {
                Failure::Refused(format!("{}/{refusal}", self.measurements.display()))
            }
            other => Failure::Refused(other.to_string()),
        }
    }
}

fn io(path: &Path, source: std::io::Error) -> Failure {
    Failure::Io { path: path.display().to_string(), source }
}

/// Where the picture of a file's residuals is.
fn picture(directory: &Path, file: &str) -> PathBuf {
    directory.join(format!("residuals-{}.svg", file.trim_end_matches(".csv")))
}

fn impossible(error: &MachineError) -> String {
    format!("the fit ends where no stage is: {error}; look for a wrong unit, sign or axis in the measurements")
}

/// The machine with the uncertainty of every fitted value behind it.
fn machine_file(result: &Identification) -> String {
    let mut header = vec![format!(
        "Fitted to {} readings: chi-square {:.1} at {} degrees of freedom. Behind the values: standard uncertainties.",
        result.readings, result.chi_square, result.degrees_of_freedom
    )];
    header.extend(result.gauge.iter().map(|sentence| format!("Gauge: {sentence}")));
    let sigma = |name: &str| {
        let estimate = result.estimate(name)?;
        Some(if estimate.held { "held".to_string() } else { format!("{:.2e}", estimate.sigma) })
    };
    let note = |key: &str| {
        let parts: Vec<Option<String>> = ["x", "y", "z"].iter().map(|c| sigma(&format!("{key}.{c}"))).collect();
        if parts.iter().any(Option::is_some) {
            let parts: Vec<String> = parts.into_iter().map(|part| part.unwrap_or_else(|| "nominal".into())).collect();
            return Some(format!("+- {}", parts.join(", ")));
        }
        let fitted = StaticErrors::NAMES.iter().any(|name| key == format!("static_rad.{name}"))
            || Axis::ALL.iter().any(|axis| key == backlash_name(*axis));
        sigma(key).filter(|_| fitted).map(|sigma| format!("+- {sigma}"))
    };
    to_toml_with(&result.machine, &header, note)
}
