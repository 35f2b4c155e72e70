//! Whether all that tells the backlash of one motor tells the same.

use super::Refusal;
use super::constants::backlash_name;
use super::fit::{Fit, LEAST_NOISE};
use super::play::actuators;
use super::result::Reversal;
use super::reversal::Runs;
use nalgebra::DMatrix;
use stage_controller::units::Axis;

/// Two values so many standard deviations apart are worth a warning.
const DOUBTFUL: f64 = 3.5;
/// So many are no common value any more.
const CONTRADICTORY: f64 = 10.0;
/// Files that tell the play a hundred times worse than the runs have no say: rounding would decide.
const LEAST_SHARE: f64 = 1e-4;

/// What one source tells of a backlash, nm or nrad.
struct Told<'a> {
    by: &'a str,
    value: f64,
    sigma: f64,
    /// How far the targets of runs are apart: a play that depends on the position is no contradiction.
    spread: f64,
}

impl<'a> Told<'a> {
    fn runs(reversal: &'a Reversal) -> Self {
        let spread = reversal.of_targets.map_or(0.0, |[least, most]| most - least);
        Told { by: &reversal.file, value: reversal.backlash, sigma: reversal.sigma.max(LEAST_NOISE), spread }
    }
}

/// A warning where two sources differ, a refusal where they have nothing in common.
fn compare(axis: Axis, a: &Told, b: &Told) -> Result<Option<String>, Refusal> {
    let pull = (a.value - b.value).abs() / a.sigma.hypot(b.sigma);
    if pull <= DOUBTFUL {
        return Ok(None);
    }
    let unit = if axis.is_rotary() { "nrad" } else { "nm" };
    let sentence = format!(
        "{}: {} says {:.1} +- {:.1} {unit}, {} says {:.1} +- {:.1} {unit}, {pull:.1} standard deviations apart",
        backlash_name(axis),
        a.by,
        a.value,
        a.sigma,
        b.by,
        b.value,
        b.sigma
    );
    let spread = a.spread.max(b.spread);
    if pull > CONTRADICTORY && (a.value - b.value).abs() <= spread {
        return Ok(Some(format!(
            "{sentence}, but single targets of the runs differ by {spread:.1} {unit}: the play depends on the position; \
             what is written lies between them, and its uncertainty is too small."
        )));
    }
    if pull > CONTRADICTORY {
        let advice = "no common value: leave out the file that was measured in another state of the stage, or look at \
                      its directions, approach and noise";
        return Err(Refusal::Result(format!("{sentence}; {advice}")));
    }
    Ok(Some(format!("{sentence}: what is written lies between them, and its uncertainty is too small.")))
}

impl Fit<'_> {
    /// Compares files of runs with one another and with all other files; gives warnings.
    /// `alone`: covariance by noise, with which the sources are weighted; `whole`: what is believed of the result.
    pub(super) fn agreement(
        &self,
        runs: &[Option<Runs>],
        alone: &DMatrix<f64>,
        whole: &DMatrix<f64>,
    ) -> Result<Vec<String>, Refusal> {
        let mut warnings = Vec::new();
        for axis in Axis::ALL {
            let of_axis: Vec<&Reversal> =
                runs.iter().flatten().map(|runs| &runs.reversal).filter(|r| r.axis == axis.name()).collect();
            for (i, a) in of_axis.iter().enumerate() {
                for b in &of_axis[i + 1..] {
                    warnings.extend(compare(axis, &Told::runs(a), &Told::runs(b))?);
                }
            }
            let (Some(column), false) = (self.layout.play_columns[axis.index()], of_axis.is_empty()) else { continue };
            // all runs together, and what the fit knows beyond them
            let weight: f64 = of_axis.iter().map(|r| Told::runs(r).sigma.powi(-2)).sum();
            let value = of_axis.iter().map(|r| r.backlash * Told::runs(r).sigma.powi(-2)).sum::<f64>() / weight;
            let rest = alone[(column, column)].recip() - weight;
            if rest.is_nan() || rest < LEAST_SHARE * weight {
                continue;
            }
            let fitted = self.state.machine.drives[axis.index()].backlash;
            let others = value + (fitted - value) * (rest + weight) / rest;
            let files: Vec<&str> = of_axis.iter().map(|r| r.file.as_str()).collect();
            let spread = of_axis.iter().map(|r| Told::runs(r).spread).fold(0.0, f64::max);
            let together = Told { by: &files.join(" with "), value, sigma: weight.sqrt().recip(), spread };
            let by = self.tell_play(axis).join(" with ");
            // what position-dependent errors add is all of the others': the runs take means of each target
            let added = (whole[(column, column)] - alone[(column, column)]).max(0.0).sqrt() * (rest + weight) / rest;
            let others = Told { by: &by, value: others, sigma: rest.sqrt().recip().hypot(added), spread: 0.0 };
            warnings.extend(compare(axis, &together, &others)?);
        }
        Ok(warnings)
    }

    /// Files besides the runs with readings on the other flank of an axis.
    fn tell_play(&self, axis: Axis) -> Vec<&str> {
        let play = self.state.machine.drives.map(|drive| drive.backlash);
        let other_flank = |file: &super::series::Series| {
            actuators(file, play).iter().any(|behind| behind.per_play[axis.index()] != 0.0)
        };
        self.fitted().filter(|(_, file)| other_flank(file)).map(|(_, file)| file.file.as_str()).collect()
    }
}
