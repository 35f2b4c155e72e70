//! What an identification finds, as plain data for reports and programs.

use crate::machine::Machine;
use serde::Serialize;

/// One constant or backlash with its standard uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Key of the machine file, with the component: `static_rad.S_XY`, `mount.chip.rot_rad.z`, `axes.X.backlash_nm`.
    pub name: String,
    /// Unit of `value`, `sigma` and `nominal`: rad, um, nm or nrad, as the machine file writes it.
    pub unit: &'static str,
    /// The estimate, or the held value.
    pub value: f64,
    /// Standard uncertainty (k = 1); 0 for a held value.
    pub sigma: f64,
    /// The part of it that noise makes; smaller where residuals depend on positions.
    pub noise_sigma: f64,
    /// What the nominal machine says.
    pub nominal: f64,
    /// True when it was not fitted but held at `nominal`.
    pub held: bool,
}

/// Reversal of one axis from one file of bidirectional runs, ISO 230-2.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reversal {
    /// The axis.
    pub axis: &'static str,
    /// The file.
    pub file: String,
    /// nm or nrad.
    pub unit: &'static str,
    /// Mean reversal value of the axis by ISO 230-2: mean over the targets of (mean up - mean down). Play makes it
    /// negative: approached upwards the stage stays behind. None where runs go one way and the play is held.
    pub mean_reversal: Option<f64>,
    /// Reversal value B of the axis by ISO 230-2: the largest |mean up - mean down| of a target; none as above.
    pub reversal: Option<f64>,
    /// Smallest and largest play that a single target shows, mean down less mean up: a play that depends on the
    /// position, and noise; none as above.
    pub of_targets: Option<[f64; 2]>,
    /// The play from the least squares of all runs, with drift where the file has times; of runs that go one way the
    /// held value.
    pub backlash: f64,
    /// Its standard uncertainty; infinite (in JSON null) where the runs go one way.
    pub sigma: f64,
    /// Drift of the reading per hour; none without times.
    pub drift_per_hour: Option<f64>,
    /// Standard deviation of one reading, as stated or as estimated from the runs.
    pub noise: f64,
    /// Slope of the mean deviation over the travel, 1e-6: the scale error, which the constants do not hold.
    pub scale_ppm: f64,
    /// Targets.
    pub targets: usize,
    /// Runs in each direction.
    pub runs: usize,
}

/// One file of measurements in the fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileSummary {
    /// Name of the file.
    pub file: String,
    /// What it holds: `positioning`, `fibre`, ...
    pub kind: &'static str,
    /// Readings (rows).
    pub readings: usize,
    /// Of these left out as outliers.
    pub rejected: usize,
    /// Standard deviation of one value that weighs it, nm or nrad.
    pub noise: f64,
    /// nm or nrad.
    pub unit: &'static str,
    /// False when the noise was estimated from the residuals.
    pub noise_stated: bool,
    /// Degrees of freedom that tell the noise of a file that does not state it; none for bidirectional runs.
    pub noise_freedom: Option<f64>,
    /// By how much its share of the uncertainties is larger than with that noise stated (Student); else 1.
    pub student_factor: f64,
    /// Root mean square of the residuals that count.
    pub rms: f64,
    /// What besides the constants was fitted to this file, nm or nrad (drift: per hour): name, value, sigma.
    pub nuisances: Vec<(String, f64, f64)>,
}

/// A reading that does not belong to the others.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlier {
    /// Name of the file.
    pub file: String,
    /// Line in it.
    pub line: u64,
    /// Column of the value that is worst off.
    pub column: &'static str,
    /// Measured less fitted, nm or nrad.
    pub residual: f64,
    /// The same in standard deviations of a residual left out.
    pub studentised: f64,
}

/// Measured less fitted of one value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Residual {
    /// Index into [`Identification::files`].
    pub file: usize,
    /// Line in the file.
    pub line: u64,
    /// Column of the value.
    pub column: &'static str,
    /// Measured less fitted, nm or nrad.
    pub value: f64,
    /// The same in standard deviations of the noise.
    pub normalised: f64,
    /// Left out of the fit.
    pub rejected: bool,
}

/// Result of an identification.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Identification {
    /// Name of the machine.
    pub machine_name: String,
    /// The stages from base to fibre array.
    pub order: Vec<&'static str>,
    /// The 24 constants, then the backlash of X, Y, Z, alpha, beta, gamma.
    pub estimates: Vec<Estimate>,
    /// Covariance of the estimates in their order and units; rows and columns of held ones are 0.
    pub covariance: Vec<Vec<f64>>,
    /// Numerical rank of the normalised Jacobian of all that was fitted.
    pub rank: usize,
    /// Unknowns of the fit: constants, backlash, and what belongs to single files.
    pub unknowns: usize,
    /// Ratio of the largest singular value of the normalised Jacobian to the smallest that counts for the rank,
    /// without the zeros of diagonal lines.
    pub condition: f64,
    /// Rows of all files.
    pub readings: usize,
    /// Weighted sum of squares of the residuals.
    pub chi_square: f64,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Probability of a chi-square at least this large when model and noise are right. None where the noise of a file
    /// was taken from its residuals ([`Self::noise_from_residuals`]): chi-square is then near the degrees of freedom
    /// whatever the model.
    pub probability: Option<f64>,
    /// Files whose noise was taken from their residuals: not stated, or stated smaller than they show.
    pub noise_from_residuals: Vec<String>,
    /// Reversal of each file of bidirectional runs.
    pub reversals: Vec<Reversal>,
    /// The files in the order of their names.
    pub files: Vec<FileSummary>,
    /// Rejected readings.
    pub outliers: Vec<Outlier>,
    /// All residuals, file by file.
    #[serde(skip)]
    pub residuals: Vec<Residual>,
    /// What is fixed by convention and not by measurement, in sentences.
    pub gauge: Vec<String>,
    /// What a person should look at.
    pub warnings: Vec<String>,
    /// The nominal machine with the estimates in it.
    #[serde(skip)]
    pub machine: Machine,
}

impl Identification {
    /// The estimate of a key such as `static_rad.S_XY`.
    pub fn estimate(&self, name: &str) -> Option<&Estimate> {
        self.estimates.iter().find(|estimate| estimate.name == name)
    }
}
