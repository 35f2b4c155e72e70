//! How much each reading counts: noise of the files, outliers.

use super::Refusal;
use super::bordered::Joint;
use super::changes::pairs;
use super::fit::{Fit, LEAST_NOISE};
use super::least_squares::dot;
use super::outliers::{huber, threshold};
use super::series::{Kind, Series};
use super::suspicions::{believable, few_repeats};
use stage_controller::units::Axis;

/// Rounds in which unstated noise is estimated anew.
const NOISE_ROUNDS: usize = 4;
/// Median of the size of normal noise, in standard deviations.
pub(super) const MEDIAN_SIZE: f64 = 0.6745;
/// Residuals so many times the stated noise are not taken for noise where they are also larger than what is believed of
/// the kind: errors of 0.5 to 2 um of a stage are ordinary, and 10 to 40 times the noise of a probe of 50 nm.
pub(super) const HOPELESS_NOISE: f64 = 20.0;
/// Most rounds in which weights are given anew.
const MOST_ROUNDS: usize = 30;
/// Largest share of a file that may be left out.
pub(super) const MOST_REJECTED: f64 = 0.2;
/// The same while the fit is not yet at its end.
const HOPELESS: f64 = 0.5;

/// A reading that was set aside before the fit stays there while its residual has so many standard deviations.
const STILL_WILD: f64 = 100.0;

/// One reading after a fit.
#[derive(Clone, Copy, Default)]
pub(super) struct Left {
    pub residual: [f64; 3],
    pub leverage: [f64; 3],
}

impl Left {
    /// The largest of a reading's residuals, nm or nrad.
    fn size(&self, columns: usize) -> f64 {
        largest(&self.residual[..columns])
    }
}

/// The size of the largest residual.
pub(super) fn largest(residuals: &[f64]) -> f64 {
    residuals.iter().fold(0.0, |most, residual| residual.abs().max(most))
}

impl Fit<'_> {
    /// Residuals and leverages of all readings, rejected ones included.
    pub(super) fn left(&self, joint: &Joint) -> Vec<Vec<Left>> {
        let mut all: Vec<Vec<Left>> = self.series.iter().map(|_| Vec::new()).collect();
        for (index, file) in self.fitted() {
            let root = joint.root(index);
            let variance = self.noise[index].powi(2);
            all[index].reserve(file.readings.len());
            self.each_reading(&self.state, index, |_, block| {
                let mut left = Left { residual: block.residual, leverage: [0.0; 3] };
                for c in 0..file.kind.columns().len() {
                    let across = |column: &[f64]| dot(&block.rows[c], column).powi(2);
                    let shared: f64 = root.as_slice().chunks_exact(root.nrows()).map(across).sum();
                    left.leverage[c] = shared / variance + block.eliminated;
                }
                all[index].push(left);
            });
        }
        all
    }

    /// Files of which what is not left out shows more than is believed of their kind: the state is none of a stage.
    pub(super) fn beyond_belief(&self) -> bool {
        let left = self.left(self.joint());
        self.fitted().any(|(index, file)| {
            let columns = file.kind.columns().len();
            let kept = left[index].iter().zip(&self.weights[index]).filter(|(_, weight)| **weight > 0.0);
            let (count, sum) = kept.fold((0.0, 0.0), |(n, sum), (left, _)| (n + 1.0, sum + left.size(columns).powi(2)));
            sum > count * believable(file.kind).powi(2)
        })
    }

    /// The solution of a fit that has converged.
    pub(super) fn joint(&self) -> &Joint {
        self.solution.as_ref().expect("the fit has converged")
    }

    /// How many values of a file the fit takes: the sum of the leverages of what counts.
    pub(super) fn taken(&self, index: usize, left: &[Left]) -> f64 {
        let counting = left.iter().zip(&self.weights[index]);
        counting.map(|(left, weight)| weight * left.leverage.iter().sum::<f64>()).sum()
    }

    /// Residual in standard deviations of what a reading that is not rejected (or, if it is, a new one) would show.
    fn studentised(&self, index: usize, k: usize, left: &Left) -> [f64; 3] {
        let weight = self.weights[index][k];
        std::array::from_fn(|c| {
            let leverage = left.leverage[c];
            // 1 - h of a reading that counts fully, 1 + h of one that does not count
            let share = (1.0 + leverage * (1.0 - 2.0 * weight)).max(1e-6);
            left.residual[c] / (self.noise[index] * share.sqrt())
        })
    }

    /// Noise of files that do not state theirs, from the residuals and what the fit has taken from them.
    /// Tells whether it changed by more than a hundredth.
    fn estimate_noise(&mut self, robust: bool) -> bool {
        let mut changed = false;
        let left = self.left(self.joint());
        for (index, file) in self.fitted() {
            if !self.estimated[index] {
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
                // the fit has taken its share of the noise
                robust_noise(file, &readings_of(&left[index])) * (values.len() as f64 / free.max(1.0)).sqrt()
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
        self.fitted().any(|(index, _)| self.estimated[index])
    }

    pub(super) fn run(&mut self) -> Result<(), Refusal> {
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
        self.caution = self.caution(limit);
        let none_is_out = self.weights.iter().flatten().all(|weight| *weight == 1.0);
        if none_is_out && !self.any_beyond(limit) {
            return Ok(());
        }
        (self.progress)("looking for outliers");
        loop {
            for _ in 0..MOST_ROUNDS {
                self.weigh(|worst| huber(worst).max(1e-6));
                let moved = self.converge()?;
                let noise_changed = self.noise_unknown() && self.estimate_noise(true);
                if moved < 0.3 && !noise_changed {
                    break;
                }
            }
            if !self.doubt_stated_noise() {
                break;
            }
        }
        self.judge_doubted()?;
        loop {
            for _ in 0..MOST_ROUNDS {
                let changed = self.weigh(|worst| if worst.abs() > limit { 0.0 } else { 1.0 });
                let strange = self.judge_strange_files(HOPELESS)?;
                self.converge()?;
                let noise_changed = self.noise_unknown() && self.estimate_noise(false);
                if !changed && !noise_changed && !strange {
                    break;
                }
            }
            if !self.judge_strange_files(MOST_REJECTED)? {
                return Ok(());
            }
        }
    }

    /// Files whose residuals altogether are larger than the noise stated are weighted by their residuals: no reading
    /// of theirs is an outlier for what the constants do not describe. Tells whether there are such files. What is
    /// wrong with them is judged when all others stand.
    fn doubt_stated_noise(&mut self) -> bool {
        let left = self.left(self.joint());
        let mut found = false;
        for (index, file) in self.fitted() {
            let shown = robust_noise(file, &readings_of(&left[index]));
            let ratio = shown / self.noise[index];
            if self.estimated[index] || ratio < 1.0 + few_repeats(file) {
                continue;
            }
            self.estimated[index] = true;
            self.noise[index] = shown;
            found = true;
        }
        found
    }

    /// Files of which more than a share would be left out. Readings that no stage can show are refused; what a stage's
    /// own errors can show is believed: then the noise is doubted, and the readings come back. Tells whether there are
    /// such files.
    fn judge_strange_files(&mut self, share: f64) -> Result<bool, Refusal> {
        let mut found = false;
        for (index, file) in self.fitted() {
            let out = self.weights[index].iter().filter(|weight| **weight == 0.0).count();
            if out as f64 <= share * file.readings.len() as f64 || out <= 1 || self.believed[index].is_some() {
                continue;
            }
            self.refuse_mistakes(&[index])?;
            let left = &self.left(self.joint())[index];
            let columns = file.kind.columns().len();
            let most = believable(file.kind);
            let beyond =
                (0..left.len()).filter(|k| self.weights[index][*k] == 0.0 && left[*k].size(columns) > most).count();
            let gross = 2 * beyond > out;
            if gross {
                let reason = format!(
                    "{out} of {} readings do not fit the other files within a noise of {:.3} {}: look for a wrong \
                     unit, sign, axis or point, or a noise stated too small",
                    file.readings.len(),
                    self.noise[index],
                    file.kind.quantity().unit()
                );
                self.misread(index, reason)?;
            }
            // the few beyond all belief stay outliers
            let most = if gross { f64::INFINITY } else { most };
            let inside = left.iter().filter(|left| left.size(columns) <= most);
            let squares = inside.flat_map(|left| &left.residual[..columns]).map(|r| r * r);
            let (count, sum) = squares.fold((0.0, 0.0), |(count, sum), square| (count + 1.0, sum + square));
            self.noise[index] = (sum / f64::max(count, 1.0)).sqrt().max(LEAST_NOISE);
            self.estimated[index] = true;
            self.believed[index] = Some(most);
            self.weights[index].iter_mut().zip(left).for_each(|(weight, left)| {
                *weight = if left.size(columns) <= most { 1.0 } else { 0.0 };
            });
            found = true;
        }
        Ok(found)
    }

    /// Gives every reading the weight of its worst value; tells whether one changed.
    fn weigh(&mut self, weight: impl Fn(f64) -> f64) -> bool {
        let left = self.left(self.joint());
        let mut changed = false;
        for (index, file) in self.fitted() {
            for (k, left) in left[index].iter().enumerate() {
                let worst = self.worst(index, file, k, left).1;
                // a wild one does not even pull at a robust fit
                let still_wild = self.wild[index][k] && worst.abs() > STILL_WILD;
                let now = match (still_wild, weight(worst * self.caution[index]), self.believed[index]) {
                    (true, _, _) => 0.0,
                    (_, weight, None) => weight,
                    (_, _, Some(most)) if left.size(file.kind.columns().len()) > most => 0.0,
                    (_, weight, Some(_)) => {
                        if weight > 0.0 {
                            weight
                        } else {
                            1.0
                        }
                    }
                };
                changed |= now != self.weights[index][k];
                self.weights[index][k] = now;
            }
        }
        changed
    }

    pub(super) fn worst(&self, index: usize, file: &Series, k: usize, left: &Left) -> (usize, f64) {
        let studentised = self.studentised(index, k, left);
        let columns = 0..file.kind.columns().len();
        let worst = columns.max_by(|a, b| studentised[*a].abs().total_cmp(&studentised[*b].abs())).unwrap_or(0);
        (worst, studentised[worst])
    }

    fn any_beyond(&self, limit: f64) -> bool {
        let left = self.left(self.joint());
        self.fitted().any(|(index, file)| {
            (0..file.readings.len())
                .any(|k| self.worst(index, file, k, &left[index][k]).1.abs() * self.caution[index] > limit)
        })
    }
}

/// All readings of a file with their residuals.
fn readings_of(left: &[Left]) -> Vec<(usize, [f64; 3])> {
    left.iter().map(|left| left.residual).enumerate().collect()
}

/// Noise of a file from the median of the residuals (of readings by their number), which outliers leave alone; of the
/// worst of its columns. Squareness has a few readings of each of three pairs, and a median over all would not see a
/// pair that stands apart: there each pair has its own, and the worst counts.
pub(super) fn robust_noise(file: &Series, residuals: &[(usize, [f64; 3])]) -> f64 {
    let of = |column: usize, pair: Option<(Axis, Axis)>| {
        let of_pair = residuals.iter().filter(|(k, _)| pair.is_none() || file.readings[*k].pair == pair);
        let mut sizes: Vec<f64> = of_pair.map(|(_, residual)| residual[column].abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes.get(sizes.len().saturating_sub(1) / 2).map_or(0.0, |size| size / MEDIAN_SIZE)
    };
    if file.kind == Kind::Squareness {
        return pairs(file).into_iter().map(|pair| of(0, Some(pair))).fold(0.0, f64::max);
    }
    (0..file.kind.columns().len()).map(|column| of(column, None)).fold(0.0, f64::max)
}
