//! How much each reading counts: noise of the files, outliers.

use super::Refusal;
use super::bordered::Joint;
use super::fit::{Fit, LEAST_NOISE};
use super::least_squares::dot;
use super::outliers::{huber, threshold};
use super::series::Series;

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

    /// The solution of a fit that has converged.
    pub(super) fn joint(&self) -> &Joint {
        self.solution.as_ref().expect("the fit has converged")
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
                robust_noise(file, &left[index]) * (values.len() as f64 / free.max(1.0)).sqrt()
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
        for _ in 0..MOST_ROUNDS {
            let changed = self.weigh(|worst| if worst.abs() > limit { 0.0 } else { 1.0 });
            self.refuse_strange_files(HOPELESS)?;
            self.converge()?;
            let noise_changed = self.noise_unknown() && self.estimate_noise(false);
            if !changed && !noise_changed {
                break;
            }
        }
        self.refuse_strange_files(MOST_REJECTED)
    }

    /// Files whose residuals altogether are larger than the noise stated are weighted by their residuals: no reading
    /// of theirs is an outlier for what the constants do not describe. Tells whether there are such files. What is
    /// wrong with them is judged when all others stand.
    fn doubt_stated_noise(&mut self) -> bool {
        let left = self.left(self.joint());
        let mut found = false;
        for (index, file) in self.fitted() {
            let shown = robust_noise(file, &left[index]);
            let ratio = shown / self.noise[index];
            if self.estimated[index] || ratio < 1.0 + 5.0 / (file.readings.len() as f64).sqrt() {
                continue;
            }
            self.estimated[index] = true;
            self.noise[index] = shown;
            found = true;
        }
        found
    }

    /// Refuses a file of which more than a share is left out.
    fn refuse_strange_files(&mut self, share: f64) -> Result<(), Refusal> {
        for (index, file) in self.fitted() {
            let rejected = self.weights[index].iter().filter(|weight| **weight == 0.0).count();
            if rejected as f64 > share * file.readings.len() as f64 && rejected > 1 {
                self.refuse_mistakes(&[index])?;
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
        let left = self.left(self.joint());
        let mut changed = false;
        for (index, file) in self.fitted() {
            for (k, left) in left[index].iter().enumerate() {
                let worst = self.worst(index, file, k, left).1;
                // a wild one does not even pull at a robust fit
                let still_wild = self.wild[index][k] && worst.abs() > STILL_WILD;
                let now = if still_wild { 0.0 } else { weight(worst * self.caution[index]) };
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

/// Noise of a file from the median of the residuals, which outliers leave alone; of the worst of its columns.
fn robust_noise(file: &Series, left: &[Left]) -> f64 {
    let column = |c: usize| {
        let mut sizes: Vec<f64> = left.iter().map(|left| left.residual[c].abs()).collect();
        sizes.sort_by(f64::total_cmp);
        sizes[sizes.len() / 2] / MEDIAN_SIZE
    };
    (0..file.kind.columns().len()).map(column).fold(0.0, f64::max)
}
