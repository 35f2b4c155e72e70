//! The fit of all files together.

use super::checks;
use super::constants::{CONSTANTS, Constant, backlash_name};
use super::gauge::{Gauge, gauge, per_unit};
use super::least_squares::{Rows, Solution};
use super::observe::{Block, Layout, Nuisance, Observer, State, nuisances};
use super::outliers::{huber, threshold};
use super::result::{Estimate, FileSummary, Identification, Outlier, Residual};
use super::reversal::{Runs, reversal};
use super::series::{Kind, Series};
use super::units::Quantity;
use super::{Options, Refusal};
use crate::machine::{LARGEST_STATIC, Machine};
use nalgebra::{DMatrix, DVector};
use stage_controller::units::{AXES, Axis};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Most steps of a fit; three or four are usual.
const MOST_STEPS: usize = 60;
/// A step below this many standard deviations ends the fit.
const CONVERGED: f64 = 1e-3;
/// Noise below which an estimate is not taken seriously, nm or nrad.
const LEAST_NOISE: f64 = 1e-3;
/// Rounds in which unstated noise is estimated anew.
const NOISE_ROUNDS: usize = 4;
/// Most rounds in which weights are given anew.
const MOST_ROUNDS: usize = 30;
/// Largest share of a file that may be left out.
const MOST_REJECTED: f64 = 0.2;
/// An uncertainty above these says that the measurements do not tell, rad and nm; a tenth of it is worth a warning.
const VAGUE_ANGLE: f64 = 0.5 * LARGEST_STATIC;
const VAGUE_LENGTH: f64 = 1e7;

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
        let positioning = matches!(file.kind, Kind::Positioning(_));
        runs.push(if positioning { Some(reversal(file, index, options)?) } else { None });
    }
    let mut fit = Fit::new(series, &gauge, &runs, options, progress);
    fit.refuse_undetermined()?;
    fit.run()?;
    fit.result(nominal, gauge, runs)
}

/// Knowledge from elsewhere on one column: value and standard deviation.
struct Prior {
    column: usize,
    value: f64,
    sigma: f64,
}

/// One reading after a fit.
#[derive(Clone, Copy, Default)]
struct Left {
    residual: [f64; 3],
    leverage: [f64; 3],
}

struct Fit<'a> {
    series: &'a [Series],
    options: &'a Options,
    progress: &'a mut dyn FnMut(&str),
    layout: Layout,
    own: Vec<Vec<Nuisance>>,
    priors: Vec<Prior>,
    state: State,
    noise: Vec<f64>,
    /// 0 for rejected readings.
    weights: Vec<Vec<f64>>,
    solution: Option<Solution>,
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
        Fit {
            series,
            options,
            progress,
            layout,
            own,
            priors,
            state,
            noise: series.iter().map(first_guess).collect(),
            weights: series.iter().map(|file| vec![1.0; file.readings.len()]).collect(),
            solution: None,
        }
    }

    /// Files that the common fit evaluates, all but the bidirectional runs.
    fn fitted(&self) -> impl Iterator<Item = (usize, &'a Series)> + use<'a> {
        self.series.iter().enumerate().filter(|(_, file)| !matches!(file.kind, Kind::Positioning(_)))
    }

    /// Columns that the rows of a file can touch: all constants and plays, and its own.
    fn touched(&self, index: usize) -> Vec<usize> {
        let common = self.layout.first.first().copied().unwrap_or(self.layout.width);
        let first = self.layout.first[index];
        (0..common).chain(first..first + self.own[index].len()).collect()
    }

    /// The linear system at a state, and its weighted sum of squares.
    fn assemble(&self, state: &State) -> (Rows, f64) {
        let mut rows = Rows::new(self.layout.width);
        let mut cost = 0.0;
        let mut block = Block::new(self.layout.width);
        let mut whole = vec![0.0; self.layout.width];
        for (index, file) in self.fitted() {
            let observer = Observer::new(&self.layout, state, file, index, self.options.drift);
            // a triangle of its own, without the columns of other files
            let touched = self.touched(index);
            let mut own = Rows::new(touched.len());
            let mut row = vec![0.0; touched.len()];
            for (k, weight) in self.weights[index].iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
                observer.fill(k, &mut block);
                let scale = weight.sqrt() / self.noise[index];
                for c in 0..file.kind.columns().len() {
                    row.iter_mut().zip(&touched).for_each(|(value, column)| *value = block.rows[c][*column] * scale);
                    let right = block.residual[c] * scale;
                    cost += right * right;
                    own.push(&row, right);
                }
            }
            own.triangle(|row, right| {
                whole.fill(0.0);
                touched.iter().zip(row).for_each(|(column, value)| whole[*column] = *value);
                rows.push(&whole, right);
            });
        }
        let mut row = vec![0.0; self.layout.width];
        for prior in &self.priors {
            row[prior.column] = 1.0 / prior.sigma;
            let right = (prior.value - self.value(state, prior.column)) / prior.sigma;
            cost += right * right;
            rows.push(&row, right);
            row[prior.column] = 0.0;
        }
        (rows, cost)
    }

    fn value(&self, state: &State, column: usize) -> f64 {
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

    fn moved(&self, step: &DVector<f64>) -> State {
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
    fn converge(&mut self) -> Result<f64, Refusal> {
        let (rows, mut cost) = self.assemble(&self.state);
        let mut solution = rows.solve();
        let mut damping = 0.0;
        let mut first = None;
        for number in 1..=MOST_STEPS {
            (self.progress)(&format!("fitting, step {number}"));
            let step = solution.step(damping);
            let length = solution.sigmas(&step);
            let first = *first.get_or_insert(length);
            if length < CONVERGED {
                self.solution = Some(solution);
                return Ok(first);
            }
            let trial = self.moved(&step);
            let (rows, trial_cost) = self.assemble(&trial);
            if trial_cost <= cost * (1.0 + 1e-12) + 1e-9 {
                self.state = trial;
                cost = trial_cost;
                solution = rows.solve();
                damping = if damping < 1e-9 { 0.0 } else { damping * 0.1 };
            } else {
                damping = if damping == 0.0 { 1e-6 } else { damping * 10.0 };
            }
        }
        Err(Refusal::Result(
            "the fit does not come to an end: the measurements contradict each other or the nominal machine \
             (order of the axes, fibre point, signs of the motors)"
                .into(),
        ))
    }

    /// Residuals and leverages of all readings, rejected ones included.
    fn left(&self, root: &DMatrix<f64>) -> Vec<Vec<Left>> {
        let mut all: Vec<Vec<Left>> = self.series.iter().map(|_| Vec::new()).collect();
        let mut block = Block::new(self.layout.width);
        let mut across = vec![0.0; root.ncols()];
        for (index, file) in self.fitted() {
            let observer = Observer::new(&self.layout, &self.state, file, index, self.options.drift);
            let touched = self.touched(index);
            for k in 0..file.readings.len() {
                observer.fill(k, &mut block);
                let mut left = Left { residual: block.residual, leverage: [0.0; 3] };
                for c in 0..file.kind.columns().len() {
                    across.iter_mut().for_each(|sum| *sum = 0.0);
                    for (sum, column) in across.iter_mut().zip(root.column_iter()) {
                        *sum = touched.iter().map(|j| block.rows[c][*j] * column[*j]).sum();
                    }
                    left.leverage[c] = across.iter().map(|sum| sum * sum).sum::<f64>() / self.noise[index].powi(2);
                }
                all[index].push(left);
            }
        }
        all
    }

    fn root(&self) -> DMatrix<f64> {
        self.solution.as_ref().expect("the fit has converged").root()
    }

    /// Residual in standard deviations of what a reading that is not rejected (or, if it is, a new one) would show.
    fn studentised(&self, index: usize, k: usize, left: &Left) -> [f64; 3] {
        let kept = self.weights[index][k] > 0.0;
        std::array::from_fn(|c| {
            let leverage = left.leverage[c];
            let share = if kept { (1.0 - leverage).max(1e-6) } else { 1.0 + leverage };
            left.residual[c] / (self.noise[index] * share.sqrt())
        })
    }

    /// Noise of files that do not state theirs, from the residuals and what the fit has taken from them.
    /// Tells whether it changed by more than a hundredth.
    fn estimate_noise(&mut self, robust: bool) -> bool {
        let mut changed = false;
        let left = self.left(&self.root());
        for (index, file) in self.fitted() {
            if file.noise.is_some() {
                continue;
            }
            let columns = file.kind.columns().len();
            let kept = (0..file.readings.len()).filter(|k| self.weights[index][*k] > 0.0);
            let values: Vec<(f64, f64)> = kept
                .flat_map(|k| (0..columns).map(move |c| (k, c)))
                .map(|(k, c)| (left[index][k].residual[c], left[index][k].leverage[c]))
                .collect();
            let free: f64 = values.iter().map(|(_, leverage)| (1.0 - leverage).max(0.0)).sum();
            let estimate = if robust {
                let mut sizes: Vec<f64> = values.iter().map(|(residual, _)| residual.abs()).collect();
                sizes.sort_by(f64::total_cmp);
                // the median of |normal noise| is 0.6745 of its standard deviation
                sizes[sizes.len() / 2] / 0.6745
            } else {
                (values.iter().map(|(residual, _)| residual * residual).sum::<f64>() / free.max(1e-9)).sqrt()
            };
            if free > 0.5 && estimate.is_finite() {
                let estimate = estimate.max(LEAST_NOISE);
                changed |= (estimate / self.noise[index] - 1.0).abs() > 0.01;
                self.noise[index] = estimate;
            }
        }
        changed
    }

    fn noise_unknown(&self) -> bool {
        self.fitted().any(|(_, file)| file.noise.is_none())
    }

    fn run(&mut self) -> Result<(), Refusal> {
        self.converge()?;
        if self.noise_unknown() {
            self.estimate_noise(true);
            self.converge()?;
        }
        if self.options.reject {
            self.reject()?;
        }
        if self.noise_unknown() {
            for _ in 0..NOISE_ROUNDS {
                self.estimate_noise(false);
                self.converge()?;
            }
            if self.options.reject {
                self.reject()?;
            }
        }
        Ok(())
    }

    /// Leaves out what does not belong: weighted by Huber's rule until the fit stands, then by studentised residuals.
    fn reject(&mut self) -> Result<(), Refusal> {
        let values = self.fitted().map(|(_, file)| file.readings.len() * file.kind.columns().len()).sum();
        let limit = threshold(values);
        if !self.any_beyond(limit) {
            return Ok(());
        }
        (self.progress)("looking for outliers");
        for _ in 0..MOST_ROUNDS {
            self.weigh(|worst| huber(worst).max(1e-6));
            let moved = self.converge()?;
            let noise_changed = self.noise_unknown() && self.estimate_noise(true);
            if moved < 0.3 && !noise_changed {
                break;
            }
        }
        for _ in 0..MOST_ROUNDS {
            let changed = self.weigh(|worst| if worst.abs() > limit { 0.0 } else { 1.0 });
            self.converge()?;
            let noise_changed = self.noise_unknown() && self.estimate_noise(false);
            if !changed && !noise_changed {
                break;
            }
        }
        for (index, file) in self.fitted() {
            let rejected = self.weights[index].iter().filter(|weight| **weight == 0.0).count();
            if rejected as f64 > MOST_REJECTED * file.readings.len() as f64 && rejected > 1 {
                let reason = format!(
                    "{rejected} of {} readings do not fit the other files within a noise of {:.3} {}: look for a wrong \
                     unit, sign, axis or point, or a noise stated too small",
                    file.readings.len(),
                    self.noise[index],
                    file.kind.quantity().unit()
                );
                return Err(Refusal::line(file, file.readings[0].line, reason));
            }
        }
        Ok(())
    }

    /// Gives every reading the weight of its worst value; tells whether one changed.
    fn weigh(&mut self, weight: impl Fn(f64) -> f64) -> bool {
        let left = self.left(&self.root());
        let mut changed = false;
        for (index, file) in self.fitted() {
            for k in 0..file.readings.len() {
                let now = weight(self.worst(index, file, k, &left[index][k]).1);
                changed |= now != self.weights[index][k];
                self.weights[index][k] = now;
            }
        }
        changed
    }

    fn worst(&self, index: usize, file: &Series, k: usize, left: &Left) -> (usize, f64) {
        let studentised = self.studentised(index, k, left);
        let columns = 0..file.kind.columns().len();
        let worst = columns.max_by(|a, b| studentised[*a].abs().total_cmp(&studentised[*b].abs())).unwrap_or(0);
        (worst, studentised[worst])
    }

    fn any_beyond(&self, limit: f64) -> bool {
        let left = self.left(&self.root());
        self.fitted().any(|(index, file)| {
            (0..file.readings.len()).any(|k| self.worst(index, file, k, &left[index][k]).1.abs() > limit)
        })
    }

    /// Names of the columns of constants and plays.
    fn names(&self) -> Vec<(usize, String)> {
        let constants = self.layout.constants.iter().zip(self.layout.constant_columns);
        let plays = Axis::ALL.into_iter().zip(self.layout.play_columns);
        let mut names: Vec<_> = constants.filter_map(|(c, column)| Some((column?, c.to_string()))).collect();
        names.extend(plays.filter_map(|(axis, column)| Some((column?, backlash_name(axis)))));
        names
    }

    /// Refuses what changes no reading, by name, before anything is fitted.
    fn refuse_undetermined(&self) -> Result<(), Refusal> {
        // somewhere beside the nominal machine, where nothing is by chance exactly straight
        let mut state = self.state.clone();
        for (n, constant) in self.layout.constants.iter().enumerate() {
            let some = if constant.is_angle() { 1e-5 } else { 1e3 };
            let value = constant.of(&state.machine) + some * (1.0 + n as f64 * 0.37).sin();
            constant.set(&mut state.machine, value);
        }
        let solution = self.assemble(&state).0.solve();
        self.refuse(&solution.null_space(), |_| false)
    }

    fn refuse(&self, null: &[DVector<f64>], vague: impl Fn(usize) -> bool) -> Result<(), Refusal> {
        let names = self.names();
        let share = |column: usize| null.iter().map(|vector| vector[column] * vector[column]).sum::<f64>().sqrt();
        let seen: Vec<&(usize, String)> = names.iter().filter(|(c, _)| share(*c) > 1e-3 || vague(*c)).collect();
        if seen.is_empty() {
            return Ok(());
        }
        // Gauss-Jordan over the null space: hold mounts rather than angles of the stage
        let mut rest: Vec<DVector<f64>> = null.to_vec();
        let mut hold: Vec<String> = seen.iter().filter(|(c, _)| vague(*c)).map(|(_, name)| name.clone()).collect();
        let rank_of = |name: &str| {
            let classes = ["mount.fibre.rot", "mount.chip.rot", "mount.chip", "mount.fibre", "axis_offset", "axes", ""];
            classes.iter().position(|class| name.starts_with(class)).unwrap_or(classes.len())
        };
        let mut preferred = seen.clone();
        preferred.sort_by_key(|(_, name)| rank_of(name));
        for (column, name) in preferred {
            let largest = (0..rest.len()).max_by(|a, b| rest[*a][*column].abs().total_cmp(&rest[*b][*column].abs()));
            if let Some(pivot) = largest.filter(|i| rest[*i][*column].abs() > 1e-3) {
                let pivot = rest.swap_remove(pivot);
                for vector in &mut rest {
                    let factor = vector[*column] / pivot[*column];
                    *vector -= &pivot * factor;
                }
                hold.push(name.clone());
            }
        }
        let undetermined: Vec<String> = seen.into_iter().map(|(_, name)| name.clone()).collect();
        Err(Refusal::Undetermined { advice: self.advice(&undetermined), undetermined, hold })
    }

    fn advice(&self, undetermined: &[String]) -> String {
        let has = |kind: fn(&Kind) -> bool| self.fitted().any(|(_, file)| kind(&file.kind));
        let lacks = |start: &str| undetermined.iter().any(|name| name.starts_with(start));
        let mut advice = Vec::new();
        if !has(|kind| matches!(kind, Kind::Fibre(_))) {
            advice.push("measure fibre positions (kind: fibre) at poses that use all six axes".to_string());
        } else if lacks("mount.fibre.rot") && !has(|kind| matches!(kind, Kind::Orientation)) {
            advice.push(
                "measure the array's orientation (kind: orientation) or positions of two more of its points (point_um)"
                    .to_string(),
            );
        } else if lacks("static") || lacks("axis_offset") || lacks("mount") {
            advice.push("add poses at which more axes, and each on its own, are away from home".to_string());
        }
        let plays = Axis::ALL.into_iter().filter(|axis| undetermined.contains(&backlash_name(*axis)));
        let plays: Vec<&str> = plays.map(Axis::name).collect();
        if !plays.is_empty() {
            advice.push(format!("add bidirectional runs (kind: positioning) of {}", plays.join(", ")));
        }
        advice.join("; ")
    }

    fn result(self, nominal: &Machine, gauge: Gauge, runs: Vec<Option<Runs>>) -> Result<Identification, Refusal> {
        let solution = self.solution.as_ref().expect("the fit has converged");
        let covariance = solution.covariance();
        let vague = |column: usize, share: f64| {
            let constant = self.layout.constant_columns.iter().position(|c| *c == Some(column));
            let limit = constant.map(|i| if self.layout.constants[i].is_angle() { VAGUE_ANGLE } else { VAGUE_LENGTH });
            limit.is_some_and(|limit| covariance[(column, column)].sqrt() > share * limit)
        };
        self.refuse(&solution.null_space(), |column| vague(column, 1.0))?;
        let columns: Vec<Option<usize>> =
            self.layout.constant_columns.iter().chain(&self.layout.play_columns).copied().collect();
        let mut machine = gauge.start.clone();
        let mut warnings = Vec::new();
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
            let sigma = column.map_or(0.0, |column| covariance[(column, column)].sqrt()) / per_unit;
            let value = if column.is_some() { of(&self.state.machine) / per_unit } else { of(&machine) / per_unit };
            if let Some(column) = column {
                if vague(*column, 0.1) {
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
            estimates.push(Estimate { name, unit, value, sigma, nominal, held: column.is_none() });
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
        let mut result = Identification {
            machine_name: machine.name.clone(),
            order: machine.order.map(Axis::name).to_vec(),
            estimates,
            covariance: covariance_of,
            rank: solution.rank(),
            unknowns: self.layout.width,
            condition: solution.condition(),
            readings: self.series.iter().map(|file| file.readings.len()).sum(),
            chi_square: 0.0,
            degrees_of_freedom: 0,
            probability: 1.0,
            reversals: Vec::new(),
            files: Vec::new(),
            outliers: Vec::new(),
            residuals: Vec::new(),
            gauge: gauge.sentences,
            warnings,
            machine,
        };
        self.files(&mut result, runs, &covariance);
        Ok(result)
    }

    /// Residuals, outliers and sums, file by file.
    fn files(&self, result: &mut Identification, runs: Vec<Option<Runs>>, covariance: &DMatrix<f64>) {
        let left = self.left(&self.root());
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
                let column = self.layout.first[index] + k;
                (nuisance.name.clone(), self.state.own[index][k], covariance[(column, column)].sqrt())
            });
            result.files.push(FileSummary {
                file: file.file.clone(),
                kind: file.kind.name(),
                readings: file.readings.len(),
                rejected: result.outliers.len() - outliers_before,
                noise,
                unit: file.kind.quantity().unit(),
                noise_stated: file.noise.is_some(),
                rms: (squares / count.max(1) as f64).sqrt(),
                nuisances: own.collect(),
            });
        }
        for prior in &self.priors {
            chi_square += ((prior.value - self.value(&self.state, prior.column)) / prior.sigma).powi(2);
        }
        // what is known beforehand counts like a measurement
        let dof =
            (counted + self.priors.len()).saturating_sub(self.solution.as_ref().map_or(0, Solution::rank)) + run_dof;
        result.chi_square = chi_square;
        result.degrees_of_freedom = dof;
        if let Ok(distribution) = ChiSquared::new(dof as f64) {
            result.probability = distribution.sf(chi_square);
        }
        if result.probability < 1e-3 {
            result.warnings.push(format!(
                "The residuals are larger than the stated noise (chi-square {chi_square:.0} at {dof} degrees of \
                 freedom): the stage has errors that the constants do not describe, or the noise is stated too small; \
                 the uncertainties are then too small as well."
            ));
        }
        for reversal in &result.reversals {
            if reversal.scale_ppm.abs() > 1000.0 {
                result.warnings.push(format!(
                    "{}: {} moves {:+.0} ppm more than commanded; correct step_{} in the machine file.",
                    reversal.file, reversal.axis, reversal.scale_ppm, reversal.unit
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
