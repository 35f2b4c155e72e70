//! Play of an axis from bidirectional runs, ISO 230-2: reversal value and its uncertainty.

use super::constants::backlash_name;
use super::outliers::{huber, threshold};
use super::per_target::PerTarget;
use super::result::{Identification, Outlier, Residual, Reversal};
use super::series::{Kind, Reading, Series};
use super::suspicions::hopeless;
use super::units::HOUR;
use super::weights::{MEDIAN_SIZE, MOST_REJECTED};
use super::{Options, Refusal};

/// Fewest targets that runs must visit from both sides.
const TARGETS: usize = 3;
/// Targets closer than this are one, nm or nrad: digits lost in writing, not another step.
const SAME: f64 = 1.0;
/// Most rounds in which the readings are weighted before the noise stated is believed.
const HUBER_ROUNDS: usize = 30;

/// What a file of runs tells.
pub(super) struct Runs {
    pub reversal: Reversal,
    pub residuals: Vec<Residual>,
    pub outliers: Vec<Outlier>,
    pub chi_square: f64,
    pub degrees_of_freedom: usize,
    /// The noise stated is so much too small that the residuals' own is taken.
    pub doubted: bool,
}

/// Fits deviation = mean of the target + play on the way down + drift. `index`: of the file, for its residuals; `held`:
/// the play (nm or nrad) where that is not fitted: then the runs may go one way.
pub(super) fn reversal(series: &Series, index: usize, options: &Options, held: Option<f64>) -> Result<Runs, Refusal> {
    let Kind::Positioning(axis) = series.kind else { unreachable!("only of positioning runs") };
    let targets = targets(series, axis.index());
    let nearest = |reading: &Reading| targets.partition_point(|t| *t < reading.motors[axis.index()] - SAME);
    let place: Vec<usize> = series.readings.iter().map(nearest).collect();
    let mut reached = vec![[false; 2]; targets.len()];
    series.readings.iter().zip(&place).for_each(|(reading, t)| reached[*t][usize::from(reading.down)] = true);
    let both = reached.iter().filter(|ways| **ways == [true; 2]).count();
    let one_way = held.filter(|_| both < TARGETS && targets.len() >= TARGETS);
    if both < TARGETS && one_way.is_none() {
        let reason = format!(
            "too few points: {both} targets are reached both upwards and downwards, at least {TARGETS} are needed \
             (ISO 230-2 asks for 5, and 5 runs); runs one way tell the scale alone: --hold {} for them",
            backlash_name(axis)
        );
        return Err(Refusal::line(series, series.readings[0].line, reason));
    }
    let drift = options.drift && series.shows_drift();
    let deviation = |reading: &Reading| {
        let play = one_way.filter(|_| reading.down).unwrap_or(0.0);
        reading.values[0] - reading.motors[axis.index()] - play
    };
    let system = PerTarget {
        targets: targets.len(),
        place,
        down: series.readings.iter().map(|r| if r.down && one_way.is_none() { 1.0 } else { 0.0 }).collect(),
        hours: drift.then(|| series.readings.iter().map(|reading| reading.time_s / HOUR).collect()),
        deviation: series.readings.iter().map(deviation).collect(),
    };
    let unknowns = system.unknowns();
    let mut kept = vec![true; series.readings.len()];
    let limit = threshold(kept.len());
    let shown = if options.reject { more_than_stated(series, &system)? } else { None };
    loop {
        let weights: Vec<f64> = kept.iter().map(|kept| if *kept { 1.0 } else { 0.0 }).collect();
        let count = kept.iter().filter(|kept| **kept).count();
        let enough = count > unknowns || (count == unknowns && series.noise.is_some());
        let Some(solved) = system.solve(&weights).filter(|_| enough) else {
            let reason = format!(
                "too few points: {count} readings for {unknowns} unknowns (a mean for each target{}{}); \
                 measure more runs",
                if one_way.is_none() { ", the play" } else { "" },
                if drift { ", the drift" } else { "" }
            );
            return Err(Refusal::line(series, series.readings[0].line, reason));
        };
        let left = &solved.left;
        let squares: f64 = (0..kept.len()).filter(|k| kept[*k]).map(|k| left[k] * left[k]).sum();
        let dof = count - unknowns;
        let scatter = (squares / dof.max(1) as f64).sqrt();
        let noise = shown.or(series.noise).unwrap_or(scatter);
        let studentised: Vec<f64> = (0..kept.len())
            .map(|k| {
                let leverage = solved.leverage[k];
                // one that is left out has its own noise and that of the prediction
                let share = if kept[k] { (1.0 - leverage).max(1e-6) } else { 1.0 + leverage };
                if noise > 0.0 { left[k] / (noise * share.sqrt()) } else { 0.0 }
            })
            .collect();
        let worst =
            (0..kept.len()).filter(|k| kept[*k]).max_by(|a, b| studentised[*a].abs().total_cmp(&studentised[*b].abs()));
        if let Some(worst) = worst.filter(|k| studentised[*k].abs() > limit && options.reject) {
            kept[worst] = false;
            let rejected = kept.len() + 1 - count;
            if rejected > 1 && rejected as f64 > MOST_REJECTED * kept.len() as f64 {
                let reason = format!(
                    "more than {:.0} % of {} readings do not fit the others within a noise of {noise:.3} {}: look for \
                     targets in disorder, a stage that creeps, or a noise stated too small",
                    100.0 * MOST_REJECTED,
                    kept.len(),
                    series.kind.quantity().unit()
                );
                return Err(Refusal::line(series, series.readings[worst].line, reason));
            }
            continue;
        }
        // outliers cannot enlarge it any more
        let noise = match (shown, series.noise) {
            (Some(_), Some(stated)) => scatter.max(stated),
            _ => noise,
        };
        let sigma = noise * solved.play_sigma;
        let unit = series.kind.quantity().unit();
        let residual = |k: usize| Residual {
            file: index,
            line: series.readings[k].line,
            column: "measured",
            value: left[k],
            normalised: if noise > 0.0 { left[k] / noise } else { 0.0 },
            rejected: !kept[k],
        };
        let outlier = |k: usize| Outlier {
            file: series.file.clone(),
            line: series.readings[k].line,
            column: "measured",
            residual: left[k],
            studentised: studentised[k],
        };
        let defined = by_definition(&system, &kept);
        let ways = [false, true].map(|down| {
            let way = series.readings.iter().filter(|reading| reading.down == down);
            way.map(|reading| reading.run).collect::<std::collections::BTreeSet<_>>().len()
        });
        // one way: those of the way there is
        let runs = if one_way.is_some() { ways[0].max(ways[1]) } else { ways[0] };
        return Ok(Runs {
            reversal: Reversal {
                axis: axis.name(),
                file: series.file.clone(),
                unit,
                mean_reversal: defined.as_ref().map(|defined| defined.mean_reversal),
                reversal: defined.as_ref().map(|defined| defined.reversal),
                of_targets: defined.as_ref().map(|defined| defined.of_targets),
                backlash: one_way.unwrap_or(solved.play),
                sigma,
                drift_per_hour: drift.then_some(solved.drift),
                noise,
                scale_ppm: slope(&targets, &solved.means) * 1e6,
                targets: targets.len(),
                runs,
            },
            residuals: (0..kept.len()).map(residual).collect(),
            outliers: (0..kept.len()).filter(|k| !kept[*k]).map(outlier).collect(),
            chi_square: if noise > 0.0 { squares / (noise * noise) } else { 0.0 },
            degrees_of_freedom: dof,
            doubted: shown.is_some(),
        });
    }
}

/// The noise that the residuals show where that is clearly more than the file states. Outliers must not make it: the
/// fit is weighted by Huber's rule, and the noise is told from the median.
fn more_than_stated(series: &Series, system: &PerTarget) -> Result<Option<f64>, Refusal> {
    let (Some(stated), count) = (series.noise, system.place.len()) else { return Ok(None) };
    let dof = count.saturating_sub(system.unknowns());
    let Some(mut solved) = system.solve(&vec![1.0; count]).filter(|_| dof > 0) else { return Ok(None) };
    for _ in 0..HUBER_ROUNDS {
        let before = solved.play;
        let weights: Vec<f64> = solved.left.iter().map(|left| huber(left / stated).max(1e-6)).collect();
        let Some(next) = system.solve(&weights) else { return Ok(None) };
        solved = next;
        if (solved.play - before).abs() < 1e-3 * stated {
            break;
        }
    }
    let mut sizes: Vec<f64> = solved.left.iter().map(|left| left.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    // the fit has taken its share of the noise
    let shown = sizes[count / 2] / MEDIAN_SIZE * (count as f64 / dof as f64).sqrt();
    let (ratio, unit) = (shown / stated, series.kind.quantity().unit());
    if hopeless(series, shown) {
        let reason = format!(
            "the runs do not repeat: residuals of {shown:.1} {unit} are {ratio:.0} times the noise stated, {stated:.3} \
             {unit}; look for a wrong unit (of the noise too) or targets in disorder"
        );
        return Err(Refusal::line(series, series.readings[0].line, reason));
    }
    Ok((ratio > 1.0 + 5.0 / (dof as f64).sqrt()).then_some(shown))
}

fn targets(series: &Series, motor: usize) -> Vec<f64> {
    let mut all: Vec<f64> = series.readings.iter().map(|reading| reading.motors[motor]).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| (*a - *b).abs() <= SAME);
    all
}

/// Says of which runs the reversal was not evaluated.
pub(super) fn warn_of_one_way(result: &mut Identification) {
    for r in result.reversals.iter().filter(|r| r.reversal.is_none()) {
        result.warnings.push(format!(
            "{}: {} comes to its targets from one side only, so there is no reversal value; its play is held at {} {}, \
             the scale is {:+.1} ppm.",
            r.file, r.axis, r.backlash, r.unit, r.scale_ppm
        ));
    }
}

/// What ISO 230-2 says of an axis, and the smallest and largest play of a target.
struct Defined {
    mean_reversal: f64,
    reversal: f64,
    of_targets: [f64; 2],
}

/// Mean reversal value and reversal value of the axis as ISO 230-2 defines them, over targets with both directions;
/// none without such targets.
fn by_definition(system: &PerTarget, kept: &[bool]) -> Option<Defined> {
    let mut sums = vec![[(0.0, 0.0); 2]; system.targets];
    for k in (0..kept.len()).filter(|k| kept[*k]) {
        let (count, sum) = &mut sums[system.place[k]][usize::from(system.down[k] > 0.0)];
        *count += 1.0;
        *sum += system.deviation[k];
    }
    let both = sums.iter().filter(|[up, down]| up.0 > 0.0 && down.0 > 0.0);
    let values: Vec<f64> = both.map(|[up, down]| up.1 / up.0 - down.1 / down.0).collect();
    let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let play = values.iter().fold([f64::MAX, f64::MIN], |[low, high], value| [low.min(-value), high.max(-value)]);
    (!values.is_empty()).then(|| Defined {
        mean_reversal: values.iter().sum::<f64>() / values.len() as f64,
        reversal: largest,
        of_targets: play,
    })
}

/// Slope of a straight line through points.
pub(super) fn slope(x: &[f64], y: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mx, my) = (mean(x), mean(y));
    let (mut xy, mut xx) = (0.0, 0.0);
    for (x, y) in x.iter().zip(y) {
        xy += (x - mx) * (y - my);
        xx += (x - mx) * (x - mx);
    }
    if xx > 0.0 { xy / xx } else { 0.0 }
}
