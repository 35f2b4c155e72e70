//! From a fit that has converged to its result.

use super::Refusal;
use super::bordered::Joint;
use super::constants::{CONSTANTS, backlash_name};
use super::covariance::Covariance;
use super::fit::Fit;
use super::gauge::{Gauge, per_unit};
use super::result::{Estimate, FileSummary, Identification, Outlier, Residual};
use super::reversal::Runs;
use super::suspicions::noise_unit;
use crate::machine::{LARGEST_STATIC, Machine};
use nalgebra::DMatrix;
use stage_controller::units::{AXES, Axis};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// An uncertainty above these says that the measurements do not tell, rad and nm; a tenth of it is worth a warning.
const VAGUE_ANGLE: f64 = 0.5 * LARGEST_STATIC;
const VAGUE_LENGTH: f64 = 1e7;

impl Fit<'_> {
    pub(super) fn result(
        self,
        nominal: &Machine,
        gauge: Gauge,
        runs: Vec<Option<Runs>>,
    ) -> Result<Identification, Refusal> {
        let solution = self.solution.as_ref().expect("the fit has converged");
        let student = self.student();
        let by_noise = self.with_student(solution, &student);
        let widening = self.widening(solution);
        let mut widened = by_noise.clone();
        if let Some(widening) = &widening {
            widened.common += &widening.added.common;
            widened.files.iter_mut().zip(&widening.added.files).for_each(|(block, added)| *block += added);
        }
        let (alone, covariance) = (&by_noise.common, &widened.common);
        let vague_of = |covariance: &DMatrix<f64>, column: usize, share: f64| {
            let constant = self.layout.constant_columns.iter().position(|c| *c == Some(column));
            let limit = constant.map(|i| if self.layout.constants[i].is_angle() { VAGUE_ANGLE } else { VAGUE_LENGTH });
            limit.is_some_and(|limit| covariance[(column, column)].sqrt() > share * limit)
        };
        let beyond_belief = self.beyond_belief();
        let beyond = |column: usize| {
            let constant = self.layout.constant_columns.iter().position(|c| *c == Some(column));
            !beyond_belief && constant.is_some_and(|i| self.hardly_told(self.layout.constants[i], column, covariance))
        };
        self.refuse(&solution.null_space(), |column| vague_of(alone, column, 1.0) || beyond(column))?;
        self.refuse_impossible()?;
        let columns: Vec<Option<usize>> =
            self.layout.constant_columns.iter().chain(&self.layout.play_columns).copied().collect();
        let mut machine = gauge.start.clone();
        let mut warnings: Vec<String> = widening.iter().flat_map(|widening| widening.warnings.clone()).collect();
        warnings.extend(self.agreement(&runs, alone, covariance)?);
        warnings.splice(0..0, self.said.iter().map(|(_, said)| said.clone()));
        // what does not fit may be what is held
        let held = self.held();
        warnings.iter_mut().for_each(|warning| warning.push_str(&held));
        let mut estimates = Vec::new();
        for (i, column) in columns.iter().enumerate() {
            let constant = self.layout.constants.get(i).copied();
            let (name, per_unit, unit) = match constant {
                Some(c) => (c.to_string(), per_unit(c), if c.is_angle() { "rad" } else { "um" }),
                None => {
                    let axis = Axis::ALL[i - CONSTANTS];
                    (backlash_name(axis), 1.0, if axis.is_rotary() { "nrad" } else { "nm" })
                }
            };
            let of = |machine: &Machine| match constant {
                Some(constant) => constant.of(machine),
                None => machine.drives[i - CONSTANTS].backlash,
            };
            let sigma_of = |from: &DMatrix<f64>| column.map_or(0.0, |column| from[(column, column)].sqrt()) / per_unit;
            let (sigma, noise_sigma) = (sigma_of(covariance), sigma_of(alone));
            let value = if column.is_some() { of(&self.state.machine) / per_unit } else { of(&machine) / per_unit };
            if let Some(column) = column {
                if vague_of(covariance, *column, 0.1) {
                    warnings.push(format!(
                        "{name} is only known to {sigma:.2e} {unit}: these measurements hardly show it."
                    ));
                }
                let written = rounded(value, sigma);
                match constant {
                    Some(constant) => constant.set(&mut machine, written * per_unit),
                    None => machine.drives[i - CONSTANTS].backlash = written.max(0.0),
                }
                if constant.is_none() && value < -3.0 * sigma {
                    warnings.push(format!(
                        "{name}: {value:.1} +- {sigma:.1} {unit} is negative, which no play is: are up and down \
                         exchanged? 0 is written."
                    ));
                }
            }
            let nominal = of(nominal) / per_unit;
            estimates.push(Estimate { name, unit, value, sigma, noise_sigma, nominal, held: column.is_none() });
        }
        let entry = |i: usize, j: usize| match (columns[i], columns[j]) {
            (Some(a), Some(b)) => {
                let scale = |i: usize| self.layout.constants.get(i).map_or(1.0, |c| per_unit(*c));
                covariance[(a, b)] / (scale(i) * scale(j))
            }
            _ => 0.0,
        };
        let size = CONSTANTS + AXES;
        let covariance_of = (0..size).map(|i| (0..size).map(|j| entry(i, j)).collect()).collect();
        let held_plays: Vec<_> = Axis::ALL.into_iter().filter(|axis| gauge.held_plays[axis.index()]).collect();
        for runs in runs.iter().flatten() {
            let axis = held_plays.iter().find(|axis| axis.name() == runs.reversal.axis);
            if let Some(axis) = axis {
                let held = machine.drives[axis.index()].backlash;
                if (runs.reversal.backlash - held).abs() > 3.0 * runs.reversal.sigma {
                    warnings.push(format!(
                        "{} is held at {held} {unit}, but {} says {:.1} +- {:.1} {unit}.",
                        backlash_name(*axis),
                        runs.reversal.file,
                        runs.reversal.backlash,
                        runs.reversal.sigma,
                        unit = runs.reversal.unit
                    ));
                }
            }
        }
        if solution.rank() < self.layout.width {
            warnings.push(format!(
                "{} of {} unknowns cannot be told (rank {}): not the constants or backlash, but zeros, slopes or drifts of \
                 single files; look whether their times and poses change independently.",
                self.layout.width - solution.rank(),
                self.layout.width,
                solution.rank()
            ));
        }
        let mut result = Identification {
            machine_name: machine.name.clone(),
            order: machine.order.map(Axis::name).to_vec(),
            estimates,
            covariance: covariance_of,
            rank: solution.rank() + self.zeros_told(),
            unknowns: self.layout.width + self.zeros_told(),
            condition: solution.condition(),
            readings: self.series.iter().map(|file| file.readings.len()).sum(),
            chi_square: 0.0,
            degrees_of_freedom: 0,
            probability: None,
            noise_from_residuals: Vec::new(),
            reversals: Vec::new(),
            files: Vec::new(),
            outliers: Vec::new(),
            residuals: Vec::new(),
            gauge: gauge.sentences,
            warnings,
            machine,
        };
        self.files(&mut result, runs, &widened, &student, widening.is_some());
        Ok(result)
    }

    /// Residuals, outliers and sums, file by file.
    fn files(
        &self,
        result: &mut Identification,
        runs: Vec<Option<Runs>>,
        covariance: &Covariance,
        student: &[Option<(f64, f64)>],
        widened: bool,
    ) {
        let left = self.left(self.joint());
        let (mut chi_square, mut counted, mut run_dof) = (0.0, 0, 0);
        for (index, (file, runs)) in self.series.iter().zip(runs).enumerate() {
            let mut noise = self.noise[index];
            let residuals_before = result.residuals.len();
            let outliers_before = result.outliers.len();
            if let Some(runs) = runs {
                noise = runs.reversal.noise;
                chi_square += runs.chi_square;
                run_dof += runs.degrees_of_freedom;
                result.residuals.extend(runs.residuals);
                result.outliers.extend(runs.outliers);
                result.reversals.push(runs.reversal);
            } else {
                for (k, left) in left[index].iter().enumerate() {
                    let rejected = self.weights[index][k] == 0.0;
                    for (c, column) in file.kind.columns().iter().enumerate() {
                        let (value, normalised) = (left.residual[c], left.residual[c] / noise);
                        if !rejected {
                            chi_square += normalised * normalised;
                            counted += 1;
                        }
                        let line = file.readings[k].line;
                        result.residuals.push(Residual { file: index, line, column, value, normalised, rejected });
                    }
                    if rejected {
                        let (worst, studentised) = self.worst(index, file, k, left);
                        result.outliers.push(Outlier {
                            file: file.file.clone(),
                            line: file.readings[k].line,
                            column: file.kind.columns()[worst],
                            residual: left.residual[worst],
                            studentised,
                        });
                    }
                }
            }
            let here = result.residuals[residuals_before..].iter().filter(|residual| !residual.rejected);
            let (count, squares) = here.fold((0usize, 0.0), |(n, sum), r| (n + 1, sum + r.value * r.value));
            let own = self.own[index].iter().enumerate().map(|(k, nuisance)| {
                (nuisance.name.clone(), self.state.own[index][k], covariance.own(index, k).sqrt())
            });
            result.files.push(FileSummary {
                file: file.file.clone(),
                kind: file.kind.name(),
                readings: file.readings.len(),
                rejected: result.outliers.len() - outliers_before,
                noise,
                unit: file.kind.quantity().unit(),
                noise_stated: file.noise.is_some() && !self.estimated[index],
                noise_freedom: student[index].map(|(freedom, _)| freedom),
                student_factor: student[index].map_or(1.0, |(_, factor)| factor),
                rms: (squares / count.max(1) as f64).sqrt(),
                nuisances: self.zeros(index, &covariance.files[index]).into_iter().chain(own).collect(),
            });
        }
        for prior in &self.priors {
            chi_square += ((prior.value - self.value(&self.state, prior.column)) / prior.sigma).powi(2);
        }
        // what is known beforehand counts like a measurement
        let fitted = self.solution.as_ref().map_or(0, Joint::rank) + self.zeros_told();
        let dof = (counted + self.priors.len()).saturating_sub(fitted) + run_dof;
        result.chi_square = chi_square;
        result.degrees_of_freedom = dof;
        let from_residuals = result.files.iter().filter(|file| !file.noise_stated);
        result.noise_from_residuals = from_residuals.map(|file| file.file.clone()).collect();
        let probability = ChiSquared::new(dof as f64).map_or(1.0, |distribution| distribution.sf(chi_square));
        result.probability = result.noise_from_residuals.is_empty().then_some(probability);
        if probability < 1e-3 {
            let then = if widened {
                "the uncertainties are widened for those that depend on positions."
            } else {
                "the uncertainties are then too small as well."
            };
            result.warnings.push(format!(
                "The residuals are larger than the stated noise (chi-square {chi_square:.0} at {dof} degrees of \
                 freedom): the stage has errors that the constants do not describe, or the noise is stated too small; \
                 {then}{}",
                self.held()
            ));
        }
        for (index, file) in self.series.iter().enumerate() {
            let (Some(stated), true) = (file.noise, self.estimated[index]) else { continue };
            result.warnings.push(format!(
                "{}: the residuals are {:.1} times the noise stated, {stated:.1} {unit}; the file is weighted by what they \
                 show. The stage has errors that the constants do not describe, or the noise is stated too small{}.{}",
                file.file,
                self.noise[index] / stated,
                noise_unit(file, self.noise[index] / stated)
                    .map_or(String::new(), |(real, written)| format!(" (it looks like {real} written as {written})")),
                self.held(),
                unit = file.kind.quantity().unit()
            ));
        }
        result.warnings.extend(self.unheard());
        for file in result.files.iter().filter(|file| file.noise_stated && file.readings >= 10) {
            if file.rms < 0.2 * file.noise {
                result.warnings.push(format!(
                    "{}: the residuals are {:.0} times smaller than the noise stated: is its unit right?",
                    file.file,
                    file.noise / file.rms
                ));
            }
        }
        for reversal in &result.reversals {
            if reversal.scale_ppm.abs() > 1000.0 {
                result.warnings.push(format!(
                    "{}: {} moves {:.0} ppm {} than commanded; correct step_{} in the machine file.",
                    reversal.file,
                    reversal.axis,
                    reversal.scale_ppm.abs(),
                    if reversal.scale_ppm > 0.0 { "more" } else { "less" },
                    reversal.unit
                ));
            }
        }
    }
}

/// A value with as many digits as its uncertainty deserves, and three more.
fn rounded(value: f64, sigma: f64) -> f64 {
    if sigma <= 0.0 || !sigma.is_finite() {
        return value;
    }
    let digits = (3.0 - sigma.log10().floor()).clamp(0.0, 15.0) as usize;
    format!("{value:.digits$}").parse().unwrap_or(value)
}
