//! The fit of all files together: the linear system, least squares, Levenberg-Marquardt.

use super::bordered::{Bordered, Joint};
use super::checks;
use super::constants::Constant;
use super::evaluated::Evaluated;
use super::gauge::{Gauge, gauge, per_unit};
use super::least_squares::Rows;
use super::observe::{Layout, Nuisance, State, nuisances};
use super::result::Identification;
use super::reversal::{Runs, reversal, warn_of_one_way};
use super::series::{Kind, Series};
use super::units::Quantity;
use super::wild::Farthest;
use super::{Options, Refusal};
use crate::machine::{FARTHEST_UM, LARGEST_STATIC, Machine};
use nalgebra::{DMatrix, DVector};
use stage_controller::units::Axis;

/// Most steps of a fit; three or four are usual.
const MOST_STEPS: usize = 60;
/// A step below this many standard deviations ends the fit.
const CONVERGED: f64 = 1e-3;
/// Noise below which an estimate is not taken seriously, and no file may state it, nm or nrad.
pub(super) const LEAST_NOISE: f64 = 1e-3;

/// A standard deviation of this share of what is possible does not tell whether a value is.
const SIZEABLE: f64 = 0.1;

/// Largest size of a constant that a machine file can hold, rad or um.
fn limit(constant: Constant) -> f64 {
    if constant.is_angle() { LARGEST_STATIC } else { FARTHEST_UM }
}

/// A stage can have it: a value in rad or um.
pub(super) fn possible(constant: Constant, value: f64) -> bool {
    value.abs() <= limit(constant)
}

/// Fits the constants to the measurements. `progress` is told what is being done.
///
/// # Errors
/// What is wrong with a file, what the measurements do not tell, or a gauge that contradicts itself.
pub fn identify(
    series: &[Series],
    nominal: &Machine,
    options: &Options,
    progress: &mut dyn FnMut(&str),
) -> Result<Identification, Refusal> {
    progress("checking");
    checks::runs(series)?;
    checks::scales(series, nominal)?;
    let gauge = gauge(nominal, options)?;
    let mut runs = Vec::new();
    for (index, file) in series.iter().enumerate() {
        let Kind::Positioning(axis) = file.kind else {
            runs.push(None);
            continue;
        };
        runs.push(Some(reversal(file, index, options, gauge.held_play(axis))?));
    }
    let mut fit = Fit::new(series, &gauge, &runs, options, progress);
    fit.refuse_undetermined()?;
    fit.refuse_untold_noise()?;
    fit.set_wild_ones_aside();
    fit.run()?;
    fit.judge_unstated()?;
    let mut result = fit.result(nominal, gauge, runs)?;
    warn_of_one_way(&mut result);
    Ok(result)
}

/// Knowledge from elsewhere on one column: value and standard deviation.
pub(super) struct Prior {
    pub column: usize,
    pub value: f64,
    pub sigma: f64,
}

/// Rows of the common columns with their right-hand sides.
pub(super) type Told = Vec<(Vec<f64>, f64)>;

/// A fit on its way.
pub(super) struct Fit<'a> {
    pub(super) series: &'a [Series],
    pub(super) options: &'a Options,
    pub(super) progress: &'a mut dyn FnMut(&str),
    pub(super) layout: Layout,
    pub(super) own: Vec<Vec<Nuisance>>,
    pub(super) priors: Vec<Prior>,
    pub(super) state: State,
    pub(super) noise: Vec<f64>,
    /// Files whose noise is taken from their residuals.
    pub(super) estimated: Vec<bool>,
    /// 0 for rejected readings.
    pub(super) weights: Vec<Vec<f64>>,
    /// Readings that were set aside before the first fit.
    pub(super) wild: Vec<Vec<bool>>,
    /// Factor for the studentised residuals of each file when outliers are looked for.
    pub(super) caution: Vec<f64>,
    /// The value that was farthest from its file then.
    pub(super) farthest: Option<Farthest>,
    pub(super) solution: Option<Joint>,
    pub(super) evaluated: Evaluated,
    /// Files of which no reading is an outlier but one whose residual is larger than this, nm or nrad.
    pub(super) believed: Vec<Option<f64>>,
    /// Warnings on the way, each with the number of its file.
    pub(super) said: Vec<(usize, String)>,
}

impl<'a> Fit<'a> {
    fn new(
        series: &'a [Series],
        gauge: &Gauge,
        runs: &[Option<Runs>],
        options: &'a Options,
        progress: &'a mut dyn FnMut(&str),
    ) -> Self {
        let mut width = 0;
        let mut column = |held: bool| {
            width += usize::from(!held);
            (!held).then(|| width - 1)
        };
        let constant_columns = gauge.held_constants.map(&mut column);
        let play_columns = gauge.held_plays.map(&mut column);
        let own: Vec<Vec<Nuisance>> = series.iter().map(|file| nuisances(file, options.drift)).collect();
        let mut first = Vec::new();
        let mut priors = Vec::new();
        for own in &own {
            first.push(width);
            for (k, nuisance) in own.iter().enumerate() {
                if let Some(sigma) = nuisance.prior {
                    priors.push(Prior { column: width + k, value: 0.0, sigma });
                }
            }
            width += own.len();
        }
        let order = gauge.start.order;
        let layout = Layout { order, constants: Constant::all(&order), constant_columns, play_columns, first, width };
        for (file, runs) in series.iter().zip(runs) {
            if let (Kind::Positioning(axis), Some(runs)) = (file.kind, runs)
                && let Some(column) = play_columns[axis.index()]
            {
                let sigma = runs.reversal.sigma.max(LEAST_NOISE);
                priors.push(Prior { column, value: runs.reversal.backlash, sigma });
            }
        }
        let mut start = gauge.start.clone();
        for axis in Axis::ALL {
            // a play of zero has no flank to tell it from
            let estimates = series.iter().zip(runs).filter(|(file, _)| file.kind == Kind::Positioning(axis));
            let play = estimates.filter_map(|(_, runs)| runs.as_ref()).map(|runs| runs.reversal.backlash).next();
            if let Some(play) = play.filter(|_| play_columns[axis.index()].is_some()) {
                start.drives[axis.index()].backlash = play;
            }
        }
        let state = State { machine: start, own: own.iter().map(|own| vec![0.0; own.len()]).collect() };
        let first_guess = |file: &Series| {
            file.noise.unwrap_or(match file.kind.quantity() {
                Quantity::Length => 100.0,
                Quantity::Angle => 2000.0,
            })
        };
        let noise = |(file, runs): (&Series, &Option<Runs>)| {
            runs.as_ref().map_or_else(|| first_guess(file), |runs| runs.reversal.noise)
        };
        let doubted = |(file, runs): (&Series, &Option<Runs>)| {
            file.noise.is_none() || runs.as_ref().is_some_and(|runs| runs.doubted)
        };
        Fit {
            series,
            options,
            progress,
            layout,
            own,
            priors,
            state,
            noise: series.iter().zip(runs).map(noise).collect(),
            estimated: series.iter().zip(runs).map(doubted).collect(),
            weights: series.iter().map(|file| vec![1.0; file.readings.len()]).collect(),
            wild: series.iter().map(|file| vec![false; file.readings.len()]).collect(),
            caution: vec![1.0; series.len()],
            farthest: None,
            solution: None,
            believed: vec![None; series.len()],
            said: Vec::new(),
            evaluated: Evaluated::default(),
        }
    }

    /// Files that the common fit evaluates, all but the bidirectional runs.
    pub(super) fn fitted(&self) -> impl Iterator<Item = (usize, &'a Series)> + use<'a> {
        self.series.iter().enumerate().filter(|(_, file)| !matches!(file.kind, Kind::Positioning(_)))
    }

    /// Columns that the rows of a file can touch: all constants and plays, and its own.
    pub(super) fn touched(&self, index: usize) -> Vec<usize> {
        let first = self.layout.first[index];
        (0..self.layout.common()).chain(first..first + self.own[index].len()).collect()
    }

    /// The linear system at a state, and its weighted sum of squares.
    pub(super) fn assemble(&self, state: &State) -> (Bordered, f64) {
        let (system, _, cost) = self.assemble_with_parts(state, &self.noise);
        (system, cost)
    }

    /// The same with the noise that is given, and what each file and the priors on common columns (last) tell these.
    pub(super) fn assemble_with_parts(&self, state: &State, noise: &[f64]) -> (Bordered, Vec<Told>, f64) {
        let common = self.layout.common();
        let mut system = Bordered::new(&self.layout.first, common, self.layout.width);
        let mut parts = vec![Told::new(); self.series.len() + 1];
        let mut cost = 0.0;
        for (index, file) in self.fitted() {
            let own = self.own[index].len();
            let mut rows = Rows::new(own + common);
            let mut row = vec![0.0; own + common];
            self.each_reading(state, index, |k, block| {
                let weight = self.weights[index][k];
                if weight <= 0.0 {
                    return;
                }
                let scale = weight.sqrt() / noise[index];
                for c in 0..file.kind.columns().len() {
                    // what is eliminated comes first
                    let values = block.rows[c][common..].iter().chain(&block.rows[c][..common]);
                    row.iter_mut().zip(values).for_each(|(entry, value)| *entry = value * scale);
                    let right = block.residual[c] * scale;
                    cost += right * right;
                    rows.push(&row, right);
                }
            });
            let first = self.layout.first[index];
            for prior in self.priors.iter().filter(|prior| (first..first + own).contains(&prior.column)) {
                row.fill(0.0);
                row[prior.column - first] = 1.0 / prior.sigma;
                let right = (prior.value - self.value(state, prior.column)) / prior.sigma;
                cost += right * right;
                rows.push(&row, right);
            }
            parts[index] = system.add(index, rows);
        }
        let mut row = vec![0.0; common];
        for prior in self.priors.iter().filter(|prior| prior.column < common) {
            row[prior.column] = 1.0 / prior.sigma;
            let right = (prior.value - self.value(state, prior.column)) / prior.sigma;
            cost += right * right;
            system.push(&row, right);
            parts[self.series.len()].push((row.clone(), right));
            row[prior.column] = 0.0;
        }
        (system, parts, cost)
    }

    pub(super) fn value(&self, state: &State, column: usize) -> f64 {
        let layout = &self.layout;
        if let Some(i) = layout.constant_columns.iter().position(|c| *c == Some(column)) {
            return layout.constants[i].of(&state.machine);
        }
        if let Some(i) = layout.play_columns.iter().position(|c| *c == Some(column)) {
            return state.machine.drives[i].backlash;
        }
        let index = layout.first.partition_point(|first| *first <= column) - 1;
        state.own[index][column - layout.first[index]]
    }

    pub(super) fn moved(&self, step: &DVector<f64>) -> State {
        let mut state = self.state.clone();
        for (constant, column) in self.layout.constants.iter().zip(self.layout.constant_columns) {
            if let Some(column) = column {
                constant.set(&mut state.machine, constant.of(&self.state.machine) + step[column]);
            }
        }
        for (drive, column) in state.machine.drives.iter_mut().zip(self.layout.play_columns) {
            if let Some(column) = column {
                drive.backlash += step[column];
            }
        }
        for (own, first) in state.own.iter_mut().zip(&self.layout.first) {
            for (k, value) in own.iter_mut().enumerate() {
                *value += step[first + k];
            }
        }
        state
    }

    /// Linear least squares, then Levenberg-Marquardt until a step is nothing. Returns the length of the first step in
    /// standard deviations.
    pub(super) fn converge(&mut self) -> Result<f64, Refusal> {
        let (rows, mut cost) = self.assemble(&self.state);
        let mut solution = rows.solve();
        let mut damping = 0.0;
        let mut first = None;
        for number in 1..=MOST_STEPS {
            (self.progress)(&format!("fitting, step {number}"));
            let step = solution.step(damping);
            let length = solution.sigmas(&step);
            let first = *first.get_or_insert(length);
            // residuals larger than the stated noise make every step of theirs larger too
            let scale = (cost / solution.rows().max(1) as f64).sqrt().max(1.0);
            if length < CONVERGED * scale {
                self.solution = Some(solution);
                return Ok(first);
            }
            let trial = self.moved(&step);
            let (rows, trial_cost) = self.assemble(&trial);
            if trial_cost <= cost * (1.0 + 1e-9) + 1e-9 {
                self.state = trial;
                cost = trial_cost;
                solution = rows.solve();
                damping = if damping < 1e-9 { 0.0 } else { damping * 0.1 };
            } else {
                damping = if damping == 0.0 { 1e-6 } else { damping * 10.0 };
            }
        }
        Err(self.astray("the fit does not come to an end"))
    }

    /// A value beyond what a stage can have, that may be a possible one as far as the measurements tell it.
    pub(super) fn hardly_told(&self, constant: Constant, column: usize, covariance: &DMatrix<f64>) -> bool {
        let most = limit(constant);
        let value = constant.of(&self.state.machine) / per_unit(constant);
        let sigma = covariance[(column, column)].sqrt() / per_unit(constant);
        !possible(constant, value) && (value.abs() - 3.0 * sigma <= most || sigma > SIZEABLE * most)
    }

    /// Refuses what no machine file can hold.
    pub(super) fn refuse_impossible(&self) -> Result<(), Refusal> {
        for (constant, column) in self.layout.constants.iter().zip(self.layout.constant_columns) {
            let (unit, most) = (if constant.is_angle() { "rad" } else { "um" }, limit(*constant));
            let value = constant.of(&self.state.machine) / per_unit(*constant);
            if column.is_some() && !possible(*constant, value) {
                let what = format!(
                    "the fit ends at {constant} = {value:.4} {unit}, where no stage is (at most {most} {unit})"
                );
                return Err(self.astray(&what));
            }
        }
        Ok(())
    }

    /// The measurements lead nowhere: what may be the matter.
    fn astray(&self, what: &str) -> Refusal {
        let farthest = self.farthest_reading().map_or(String::new(), |reading| format!("; {reading}"));
        Refusal::Result(format!(
            "{what}: the measurements contradict each other or the nominal machine (order of the axes, fibre point, signs \
             of the motors){farthest}{}",
            self.held()
        ))
    }
}
