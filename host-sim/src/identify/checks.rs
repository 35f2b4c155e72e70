//! What can be wrong with measurements before anything is fitted: order of runs, number of points, units by scale.

use super::Refusal;
use super::changes::Change;
use super::jacobian::Linearised;
use super::series::{Kind, Reading, Series};
use super::units::{Quantity, Unit, plain, really};
use super::zeros::Lines;
use crate::machine::{LARGEST_STATIC, Machine, NRAD_PER_DEG};
use nalgebra::{Rotation3, Vector3};
use stage_controller::units::{AXES, Axis};

/// Motors that are measured cover at least this share of their travel.
pub(super) const LEAST_COVERED: f64 = 1.0 / 300.0;
/// Values so many times smaller than the motion do not follow it at all.
const NOTHING: f64 = 1e-4;

/// Runs go one way, and there are enough points.
pub(super) fn runs(series: &[Series]) -> Result<(), Refusal> {
    for file in series {
        match file.kind {
            Kind::Positioning(axis) | Kind::Straightness { axis, .. } => monotonic(file, axis)?,
            Kind::Diagonal => lines(file)?,
            Kind::Squareness => {
                let over = file.readings.iter().find(|r| r.values[0].abs() > LARGEST_STATIC * 1e9);
                if let Some(reading) = over {
                    let reason = format!(
                        "{:.1} urad from square, more than the {} mrad of any stage: is the unit of {} right?",
                        reading.values[0] * 1e-3,
                        LARGEST_STATIC * 1e3,
                        written(file, 0)
                    );
                    return Err(Refusal::line(file, reading.line, reason));
                }
            }
            _ => {}
        }
        if let Kind::Straightness { .. } = file.kind
            && file.readings.len() < 3
        {
            let line = file.readings[0].line;
            return Err(Refusal::line(file, line, "too few points: a straightness run has at least 3"));
        }
    }
    Ok(())
}

/// Unit in which positions of an axis are shown, and its size in nm or nrad.
fn shown(axis: Axis) -> (&'static str, f64) {
    if axis.is_rotary() { ("deg", NRAD_PER_DEG) } else { ("um", 1e3) }
}

fn monotonic(file: &Series, axis: Axis) -> Result<(), Refusal> {
    for pair in file.readings.windows(2) {
        let [before, now] = [&pair[0], &pair[1]];
        if (before.run, before.down) != (now.run, now.down) {
            continue;
        }
        let [from, to] = [before, now].map(|reading: &Reading| reading.motors[axis.index()]);
        if (to - from) * if now.down { -1.0 } else { 1.0 } <= 0.0 {
            let (unit, size) = shown(axis);
            let reason = format!(
                "run {} goes {} but the target goes from {} to {} {unit}: a run is monotonic, so that every \
                 target is reached from one side",
                now.run,
                if now.down { "down" } else { "up" },
                plain(from / size),
                plain(to / size)
            );
            return Err(Refusal::line(file, now.line, reason));
        }
    }
    Ok(())
}

fn lines(file: &Series) -> Result<(), Refusal> {
    for line in file.readings.chunk_by(|a, b| a.run == b.run) {
        let (first, number) = (&line[0], line[0].run);
        if line.len() < 2 {
            let reason = format!("too few points: line {number} has {}, at least 2 are needed", line.len());
            return Err(Refusal::line(file, first.line, reason));
        }
        let mut farthest = 0.0;
        for reading in &line[1..] {
            let away = (0..3).map(|i| (reading.motors[i] - first.motors[i]).powi(2)).sum::<f64>().sqrt();
            if away <= farthest {
                let reason = format!("line {number} is not monotonic: each point is farther from the first one");
                return Err(Refusal::line(file, reading.line, reason));
            }
            farthest = away;
        }
    }
    Ok(())
}

/// Compares what was read with what the nominal machine would give: a factor is a mistaken unit.
pub(super) fn scales(series: &[Series], nominal: &Machine) -> Result<(), Refusal> {
    for file in series {
        travel(file, nominal)?;
        let ratios = ratios(file, nominal);
        let strange =
            ratios.iter().enumerate().find_map(|(column, ratio)| Some((column, ratio.filter(|r| !plausible(*r))?)));
        let Some((column, ratio)) = strange else { continue };
        let right = |change: &Change| {
            // as many columns can be compared as before, and all of them follow the machine
            let after = super::checks::ratios(&change.applied(file), nominal);
            after.iter().flatten().count() >= ratios.iter().flatten().count()
                && after.iter().flatten().all(|r| plausible(*r))
        };
        let exchanged: Vec<String> =
            Change::exchanges(file, nominal).into_iter().filter(right).map(|change| change.said(file)).collect();
        let reason = match exchanged.as_slice() {
            [] => complaint(file, column, ratio),
            said => format!(
                "{} does not follow the machine's motion; it would with {}",
                written(file, column),
                said.join(", or with ")
            ),
        };
        return Err(Refusal::line(file, file.readings[0].line, reason));
    }
    Ok(())
}

/// Values over motion that no mistake is needed for.
fn plausible(ratio: f64) -> bool {
    (0.5..2.0).contains(&ratio)
}

/// How many times each column of values is the machine's motion, where that can be compared.
fn ratios(file: &Series, nominal: &Machine) -> Vec<Option<f64>> {
    let lines = Lines::new(file);
    let all: Vec<[f64; 3]> = (0..file.readings.len()).map(|k| predicted(file, &lines, k, nominal)).collect();
    let of = |column: usize| {
        let predicted: Vec<f64> = all.iter().map(|values| values[column]).collect();
        let measured: Vec<f64> = file.readings.iter().map(|reading| reading.values[column]).collect();
        ratio(file, column, &predicted, &measured, nominal)
    };
    (0..file.kind.columns().len()).map(of).collect()
}

pub(super) fn written(file: &Series, column: usize) -> String {
    let unit = file.units.get(column).map_or("", |unit| unit.name);
    format!("{}_{unit}", file.kind.columns()[column])
}

fn complaint(file: &Series, column: usize, ratio: f64) -> String {
    let name = written(file, column);
    let unit: Option<Unit> = file.units.get(column).copied();
    let times = ratio.abs().max(1.0 / ratio.abs());
    let digits = if times < 100.0 { 2 } else { 0 };
    let size = format!("{times:.digits$} times {}", if ratio.abs() > 1.0 { "larger" } else { "smaller" });
    match unit.and_then(|unit| really(unit, ratio)) {
        Some(real) => format!(
            "unit: the values of {name} are {size} than the machine's motion; they look like {} written as {}",
            real.name,
            unit.map_or("", |unit| unit.name)
        ),
        None if (-2.0..-0.5).contains(&ratio) => {
            format!("{name} goes against the machine's motion: the sign of the instrument or of the motor is reversed")
        }
        None if ratio.abs() < NOTHING => format!(
            "{name}: the values do not follow the machine's motion: look at the axis and the order of the columns"
        ),
        None => format!(
            "{name}: the values are {size} than the machine's motion: look at the unit, the axis and the step size"
        ),
    }
}

/// Motor positions far beyond the travel are a mistaken unit, and so are runs that cover next to nothing of it.
fn travel(file: &Series, nominal: &Machine) -> Result<(), Refusal> {
    if file.kind == Kind::Squareness {
        return Ok(());
    }
    for axis in Axis::ALL {
        let [lower, upper] = nominal.drives[axis.index()].travel;
        let span = upper - lower;
        let (unit, size) = shown(axis);
        let at = |reading: &Reading| reading.motors[axis.index()];
        if let Some(reading) = file.readings.iter().find(|r| at(r) < lower - span || at(r) > upper + span) {
            let factor = at(reading).abs() / lower.abs().max(upper.abs());
            let reason = format!(
                "unit: {} at {} {unit} is beyond its travel of {} to {} {unit}, {factor:.1} times as far from home; look \
                 at the unit of the column",
                axis.name(),
                plain(at(reading) / size),
                plain(lower / size),
                plain(upper / size)
            );
            return Err(Refusal::line(file, reading.line, reason));
        }
        let covered = file.readings.iter().map(at).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
        let covered = covered.1 - covered.0;
        let moves = matches!(file.kind, Kind::Positioning(a) | Kind::Straightness { axis: a, .. } if a == axis)
            || (covered > 0.0 && matches!(file.kind, Kind::Fibre(_)));
        if moves && covered < LEAST_COVERED * span {
            let reason = format!(
                "unit: {} covers {} {unit} of its travel of {} {unit}; measure over the travel, or correct the \
                 unit of the column",
                axis.name(),
                plain(covered / size),
                plain(span / size)
            );
            return Err(Refusal::line(file, file.readings[0].line, reason));
        }
    }
    Ok(())
}

/// What the nominal machine would show, without play and without the instrument's own zero.
fn predicted(file: &Series, lines: &Lines, k: usize, nominal: &Machine) -> [f64; 3] {
    let reading = &file.readings[k];
    let place = |motors: &[f64; AXES]| {
        let (rotation, origin) = Linearised::new(nominal, motors).array(nominal);
        (rotation, origin + rotation * Vector3::from(nominal.fibre_point_nm))
    };
    match file.kind {
        Kind::Positioning(axis) => [reading.motors[axis.index()], 0.0, 0.0],
        Kind::Fibre(_) => place(&reading.motors).1.into(),
        Kind::Orientation => (Rotation3::from_matrix_unchecked(place(&reading.motors).0).scaled_axis() * 1e9).into(),
        Kind::Diagonal => {
            let first = &file.readings[lines.start(k)];
            [(place(&reading.motors).1 - place(&first.motors).1).norm(), 0.0, 0.0]
        }
        Kind::Autocollimator(normal) => {
            let vector = Rotation3::from_matrix_unchecked(place(&reading.motors).0).scaled_axis() * 1e9;
            [vector[(normal + 1) % 3], vector[(normal + 2) % 3], 0.0]
        }
        Kind::Squareness | Kind::Straightness { .. } => [0.0; 3],
    }
}

/// How many times the measured motion is the predicted one: the median over readings far from the middle. None where
/// too little is predicted to compare.
fn ratio(file: &Series, column: usize, predicted: &[f64], measured: &[f64], nominal: &Machine) -> Option<f64> {
    let median = |values: &[f64]| {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    };
    let (middle, zero) = (median(predicted), median(measured));
    let far = predicted.iter().fold(0.0_f64, |most, value| most.max((value - middle).abs()));
    // what static errors of 20 mrad can do to this column at most
    let reach = match file.kind.quantity() {
        Quantity::Length => nominal.drives[..3].iter().map(|d| d.travel[1] - d.travel[0]).fold(0.0, f64::max),
        Quantity::Angle => nominal.drives[3..].iter().map(|d| d.travel[1] - d.travel[0]).fold(0.0, f64::max),
    };
    let largest = file.readings.iter().flat_map(|r| r.motors).fold(0.0_f64, |most, value| most.max(value.abs()));
    if column >= file.kind.columns().len() || far < 2.5 * LARGEST_STATIC * reach.min(largest) || far == 0.0 {
        return None;
    }
    let ratios: Vec<f64> = predicted
        .iter()
        .zip(measured)
        .filter(|(p, _)| (**p - middle).abs() > 0.3 * far)
        .map(|(p, m)| (m - zero) / (p - middle))
        .collect();
    Some(median(&ratios))
}
