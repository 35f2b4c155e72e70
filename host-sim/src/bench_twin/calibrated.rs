//! What the controller believes of a stage: fitted to noisy measurements of the true one.

use crate::identify::{Identification, Options, Refusal, identify, parse};
use crate::machine::Machine;
use crate::measure::{Settings, measure, nominal};

/// How the stages of a bench are measured.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredWith {
    /// Standard deviation of a length, nm.
    pub noise_nm: f64,
    /// Standard deviation of an angle, nrad.
    pub noise_nrad: f64,
    /// Poses at which the fibre point is measured.
    pub fibre_poses: usize,
    /// Poses at which the orientation of the array is measured.
    pub orientation_poses: usize,
}

impl Default for MeasuredWith {
    /// 50 nm, 1 urad, 120 and 40 poses.
    fn default() -> Self {
        MeasuredWith { noise_nm: 50.0, noise_nrad: 1000.0, fibre_poses: 120, orientation_poses: 40 }
    }
}

/// Measures the true stage and fits the constants of `drawing` to that. Nothing else goes from one to the other. The
/// noise is not stated: the fit takes it from its residuals, in which the kinematic errors are.
pub(super) fn calibrated(
    truth: &Machine,
    drawing: &Machine,
    with: &MeasuredWith,
    seed: u64,
) -> Result<Identification, Refusal> {
    let settings = Settings {
        seed,
        noise_nm: with.noise_nm,
        noise_nrad: with.noise_nrad,
        fibre_poses: with.fibre_poses,
        orientation_poses: with.orientation_poses,
        state_noise: false,
        ..Settings::default()
    };
    let files = measure(truth, &settings);
    let series =
        files.iter().map(|file| parse(&file.file, &file.text, &drawing.order)).collect::<Result<Vec<_>, _>>()?;
    identify(&series, &nominal(drawing), &Options::default(), &mut |_| ())
}
