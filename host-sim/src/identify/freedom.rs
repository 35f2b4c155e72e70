//! Noise that is told by few readings: refused where it is hardly told, widened for where it is told by some.

use super::Refusal;
use super::bordered::Joint;
use super::covariance::{Covariance, Products};
use super::fit::Fit;
use super::series::Series;
use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Fewest degrees of freedom that a file must have left for its noise: 10 tell a standard deviation to 22 %.
const LEAST: f64 = 10.0;
/// Share of its values that must be left for single readings to be judged by a noise that nobody states.
const JUDGED: f64 = 0.6;

impl Fit<'_> {
    /// Files whose noise nobody states.
    fn unstated(&self, index: usize) -> bool {
        self.estimated[index] && self.series[index].noise.is_none()
    }

    /// Degrees of freedom that the fit leaves to each file: values less their leverages.
    fn freedom(&self, joint: &Joint) -> Vec<f64> {
        let left = self.left(joint);
        let mut freedom = vec![0.0; self.series.len()];
        for (index, file) in self.fitted() {
            let kept = left[index].iter().zip(&self.weights[index]).filter(|(_, weight)| **weight > 0.0);
            let columns = file.kind.columns().len();
            freedom[index] = kept.flat_map(|(left, _)| &left.leverage[..columns]).map(|h| (1.0 - h).max(0.0)).sum();
        }
        freedom
    }

    /// Refuses files that state no noise and are too short to tell it, before they spoil a fit.
    pub(super) fn refuse_untold_noise(&self) -> Result<(), Refusal> {
        if !self.fitted().any(|(index, _)| self.unstated(index)) {
            return Ok(());
        }
        let freedom = self.freedom(&self.assemble(&self.state).0.solve());
        for (index, file) in self.fitted().filter(|(index, _)| self.unstated(*index)) {
            if freedom[index] < LEAST {
                let (count, columns) = (file.readings.len(), file.kind.columns().len() as f64);
                let reason = format!(
                    "too few points to tell the noise: {count} readings leave {:.1} degrees of freedom, at least {LEAST} \
                     are needed; state the noise (# noise_{}), or measure at least {} readings",
                    freedom[index],
                    if file.kind.quantity().unit() == "nm" { "um" } else { "urad" },
                    count + ((LEAST - freedom[index]) / columns).ceil() as usize,
                );
                return Err(Refusal::line(file, file.readings[0].line, reason));
            }
        }
        Ok(())
    }

    /// Factors for studentised residuals: below 1 where few readings tell the noise, so that the limit of normal ones
    /// stands for that of Student's distribution; 0 where the fit takes so much of the file that its residuals cannot
    /// tell which reading is wrong. Wild ones are left out all the same.
    pub(super) fn caution(&self, limit: f64) -> Vec<f64> {
        let freedom = self.freedom(self.joint());
        let factor = |free: f64| (1.0 / student_factor(free, limit)).min(1.0);
        let of = |(index, file): (usize, &Series)| {
            let values = (file.readings.len() * file.kind.columns().len()) as f64;
            match self.unstated(index) {
                true if freedom[index] < JUDGED * values => 0.0,
                true => factor(freedom[index]),
                false => 1.0,
            }
        };
        self.series.iter().enumerate().map(of).collect()
    }

    /// Of each file that states no noise: degrees of freedom that tell it, and the factor by which its share of the
    /// uncertainties is widened, so that three sigma hold what three sigma of known noise would (Student).
    pub(super) fn student(&self) -> Vec<Option<(f64, f64)>> {
        let freedom = self.freedom(self.joint());
        let factor = |free: f64| student_factor(free, 3.0);
        let of = |index: usize| (freedom[index] > 0.0).then(|| (freedom[index], factor(freedom[index])));
        (0..self.series.len()).map(|index| if self.unstated(index) { of(index) } else { None }).collect()
    }

    /// The covariance with the share of each such file widened.
    pub(super) fn with_student(&self, joint: &Joint, student: &[Option<(f64, f64)>]) -> Covariance {
        let mut covariance = Covariance::new(joint, self.series.len());
        let common = self.layout.common();
        // of each such file what it adds to its own block
        let mut added: Vec<Option<DMatrix<f64>>> = vec![None; self.series.len()];
        let mut to_common = DMatrix::zeros(common, common);
        for (index, file) in self.fitted() {
            let Some((_, factor)) = student[index] else { continue };
            let mut products = Products::new(self.touched(index).len());
            self.each_reading(&self.state, index, |k, block| {
                let scale = self.weights[index][k].sqrt() / self.noise[index];
                for row in block.rows[..file.kind.columns().len()].iter().filter(|_| scale > 0.0) {
                    products.push(row.iter().map(|value| value * scale));
                }
            });
            let own = &covariance.files[index];
            let more = (factor * factor - 1.0) * (own * products.sum() * own);
            to_common += more.view((0, 0), (common, common));
            added[index] = Some(more);
        }
        if added.iter().all(Option::is_none) {
            return covariance;
        }
        for (index, block) in covariance.files.iter_mut().enumerate() {
            let mut of_others = to_common.clone();
            if let Some(more) = &added[index] {
                of_others -= more.view((0, 0), (common, common));
                *block += more;
            }
            let follow = joint.follow(index);
            *block += &follow * of_others * follow.transpose();
        }
        covariance.common += to_common;
        covariance
    }
}

/// By how much a limit in standard deviations grows when so many degrees of freedom tell the standard deviation.
pub(super) fn student_factor(freedom: f64, limit: f64) -> f64 {
    let student = StudentsT::new(0.0, 1.0, freedom.max(1.0)).expect("a positive number of degrees of freedom");
    student.inverse_cdf(Normal::standard().cdf(limit)) / limit
}
