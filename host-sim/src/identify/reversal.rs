//! Play of an axis from bidirectional runs, ISO 230-2: reversal value and its uncertainty.

use super::least_squares::Rows;
use super::outliers::threshold;
use super::result::{Outlier, Residual, Reversal};
use super::series::{Kind, Series};
use super::{Options, Refusal};

/// Fewest targets that runs must visit from both sides.
const TARGETS: usize = 3;
/// Targets closer than this are one, nm or nrad: digits lost in writing, not another step.
const SAME: f64 = 1.0;
const HOUR: f64 = 3600.0;

/// What a file of runs tells.
pub(super) struct Runs {
    pub reversal: Reversal,
    pub residuals: Vec<Residual>,
    pub outliers: Vec<Outlier>,
    pub chi_square: f64,
    pub degrees_of_freedom: usize,
}

/// Fits deviation = mean of the target + play on the way down + drift. `index`: of the file, for its residuals.
pub(super) fn reversal(series: &Series, index: usize, options: &Options) -> Result<Runs, Refusal> {
    let Kind::Positioning(axis) = series.kind else { unreachable!("only of positioning runs") };
    let targets = targets(series, axis.index());
    let place = |target: f64| targets.partition_point(|t| *t < target - SAME);
    let both = (0..targets.len())
        .filter(|t| {
            [true, false]
                .iter()
                .all(|down| series.readings.iter().any(|r| r.down == *down && place(r.motors[axis.index()]) == *t))
        })
        .count();
    if both < TARGETS {
        let reason = format!(
            "too few points: {both} targets are reached both upwards and downwards, at least {TARGETS} are needed \
             (ISO 230-2 asks for 5, and 5 runs)"
        );
        return Err(Refusal::line(series, series.readings[0].line, reason));
    }
    let drift = series.timed && options.drift;
    let unknowns = targets.len() + 1 + usize::from(drift);
    let row = |k: usize| {
        let reading = &series.readings[k];
        let mut row = vec![0.0; unknowns];
        let target = reading.motors[axis.index()];
        row[place(target)] = 1.0;
        row[targets.len()] = if reading.down { 1.0 } else { 0.0 };
        if drift {
            row[targets.len() + 1] = reading.time_s / HOUR;
        }
        (row, reading.values[0] - target)
    };
    let mut kept = vec![true; series.readings.len()];
    let limit = threshold(kept.len());
    loop {
        let mut rows = Rows::new(unknowns);
        for k in (0..kept.len()).filter(|k| kept[*k]) {
            let (row, right) = row(k);
            rows.push(&row, right);
        }
        let count = rows.clone().solve().rows;
        let solution = rows.solve();
        if solution.rank() < unknowns || (count <= unknowns && series.noise.is_none()) {
            let reason = format!(
                "too few points: {count} readings for {unknowns} unknowns (a mean for each target, the play{}); \
                 measure more runs",
                if drift { ", the drift" } else { "" }
            );
            return Err(Refusal::line(series, series.readings[0].line, reason));
        }
        let (found, root) = (solution.step(0.0), solution.root());
        let left: Vec<f64> = (0..kept.len())
            .map(|k| {
                let (row, right) = row(k);
                right - row.iter().zip(found.iter()).map(|(a, x)| a * x).sum::<f64>()
            })
            .collect();
        let squares: f64 = (0..kept.len()).filter(|k| kept[*k]).map(|k| left[k] * left[k]).sum();
        let dof = count - unknowns;
        let noise = series.noise.unwrap_or((squares / dof.max(1) as f64).sqrt());
        let studentised: Vec<f64> = (0..kept.len())
            .map(|k| {
                let leverage = (root.transpose() * nalgebra::DVector::from(row(k).0)).norm_squared();
                // one that is left out has its own noise and that of the prediction
                let share = if kept[k] { (1.0 - leverage).max(1e-6) } else { 1.0 + leverage };
                if noise > 0.0 { left[k] / (noise * share.sqrt()) } else { 0.0 }
            })
            .collect();
        let worst =
            (0..kept.len()).filter(|k| kept[*k]).max_by(|a, b| studentised[*a].abs().total_cmp(&studentised[*b].abs()));
        if let Some(worst) = worst.filter(|k| studentised[*k].abs() > limit && options.reject) {
            kept[worst] = false;
            continue;
        }
        let sigma = noise * root.row(targets.len()).norm();
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
        let (mean_reversal, reversal) = by_definition(series, axis.index(), &targets, &kept);
        let up = series.readings.iter().filter(|r| !r.down);
        let runs = up.map(|r| r.run).collect::<std::collections::BTreeSet<_>>().len();
        return Ok(Runs {
            reversal: Reversal {
                axis: axis.name(),
                file: series.file.clone(),
                unit,
                mean_reversal,
                reversal,
                backlash: found[targets.len()],
                sigma,
                drift_per_hour: drift.then(|| found[targets.len() + 1]),
                noise,
                scale_ppm: slope(&targets, &found.as_slice()[..targets.len()]) * 1e6,
                targets: targets.len(),
                runs,
            },
            residuals: (0..kept.len()).map(residual).collect(),
            outliers: (0..kept.len()).filter(|k| !kept[*k]).map(outlier).collect(),
            chi_square: if noise > 0.0 { squares / (noise * noise) } else { 0.0 },
            degrees_of_freedom: dof,
        });
    }
}

fn targets(series: &Series, motor: usize) -> Vec<f64> {
    let mut all: Vec<f64> = series.readings.iter().map(|reading| reading.motors[motor]).collect();
    all.sort_by(f64::total_cmp);
    all.dedup_by(|a, b| (*a - *b).abs() <= SAME);
    all
}

/// Mean reversal value and reversal value of the axis as ISO 230-2 defines them, over targets with both directions.
fn by_definition(series: &Series, motor: usize, targets: &[f64], kept: &[bool]) -> (f64, f64) {
    let mean = |target: f64, down: bool| {
        let of = |(reading, kept): (&super::series::Reading, &bool)| {
            let here = *kept && reading.down == down && (reading.motors[motor] - target).abs() <= SAME;
            here.then(|| reading.values[0] - reading.motors[motor])
        };
        let values: Vec<f64> = series.readings.iter().zip(kept).filter_map(of).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let values: Vec<f64> =
        targets.iter().filter_map(|target| Some(mean(*target, false)? - mean(*target, true)?)).collect();
    let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    (values.iter().sum::<f64>() / values.len().max(1) as f64, largest)
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
