//! What can be mistaken about a whole file: signs, units, columns exchanged.

use super::checks::{LEAST_COVERED, written};
use super::series::{Approach, Kind, Reading, Series};
use super::units::{UNITS, Unit};
use crate::machine::Machine;
use stage_controller::units::Axis;

/// Ratios of units in which motors are written: um to nm; mrad, arcsec, deg to each other and to rad.
const LENGTH_FACTORS: [f64; 1] = [1e3];
const ANGLE_FACTORS: [f64; 5] = [1e3, 180.0 / std::f64::consts::PI, 17.453_292_5, 4.848_136_8, 3600.0];

/// One way to read a file otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Change {
    /// A motor counted the other way.
    MotorReversed(Axis),
    /// A motor's column in another unit: so many times what is written.
    MotorScaled(Axis, f64),
    /// Two motors' columns exchanged.
    MotorsExchanged(Axis, Axis),
    /// The other sign of one column of values.
    Reversed(usize),
    /// The other sign of all of them.
    AllReversed,
    /// The other sign of one pair of axes (squareness).
    PairReversed(Axis, Axis),
    /// Two columns of values exchanged.
    Exchanged(usize, usize),
    /// One column of values in another unit.
    Unit(usize, Unit),
    /// All of them.
    AllUnit(Unit),
    /// The motors came from another side.
    Approach(Approach),
}

/// The pairs of axes of a file of squarenesses, each once.
pub(super) fn pairs(file: &Series) -> Vec<(Axis, Axis)> {
    let mut pairs: Vec<_> = file.readings.iter().filter_map(|reading| reading.pair).collect();
    pairs.sort_by_key(|(a, b)| (a.index(), b.index()));
    pairs.dedup();
    pairs
}

impl Change {
    /// All that could have been mistaken in a file of a machine.
    pub(super) fn all(file: &Series, machine: &Machine) -> Vec<Change> {
        let mut all = Vec::new();
        let columns = file.kind.columns().len();
        let has_motors =
            matches!(file.kind, Kind::Diagonal | Kind::Autocollimator(_) | Kind::Fibre(_) | Kind::Orientation);
        if has_motors {
            let moves = |axis: &Axis| file.readings.iter().any(|reading| reading.motors[axis.index()] != 0.0);
            let moved: Vec<Axis> = Axis::ALL.into_iter().filter(moves).collect();
            for (n, axis) in moved.iter().enumerate() {
                all.push(Change::MotorReversed(*axis));
                let alike = |other: &&Axis| other.is_rotary() == axis.is_rotary();
                all.extend(moved[n + 1..].iter().filter(alike).map(|other| Change::MotorsExchanged(*axis, *other)));
                let factors: &[f64] = if axis.is_rotary() { &ANGLE_FACTORS } else { &LENGTH_FACTORS };
                let both = factors.iter().flat_map(|factor| [*factor, factor.recip()]);
                all.extend(both.map(|factor| Change::MotorScaled(*axis, factor)));
            }
            let others = [Approach::Up, Approach::Down, Approach::Sequence].into_iter().filter(|a| *a != file.approach);
            all.extend(others.map(Change::Approach));
        }
        if let Kind::Straightness { axis, .. } = file.kind {
            all.push(Change::MotorReversed(axis));
        }
        // a distance has no other sign
        let signed = if file.kind == Kind::Diagonal { 0 } else { columns };
        all.extend((0..signed).map(Change::Reversed));
        for a in 0..columns {
            all.extend((a + 1..columns).map(|b| Change::Exchanged(a, b)));
        }
        if columns > 1 {
            all.push(Change::AllReversed);
        }
        if file.kind == Kind::Squareness {
            all.extend(pairs(file).into_iter().map(|(a, b)| Change::PairReversed(a, b)));
        }
        for unit in UNITS.into_iter().filter(|unit| unit.quantity == file.kind.quantity()) {
            let other = |c: usize| file.units.get(c).is_some_and(|written| written.name != unit.name);
            all.extend((0..columns).filter(|c| other(*c)).map(|c| Change::Unit(c, unit)));
            if columns > 1 && (0..columns).all(other) {
                all.push(Change::AllUnit(unit));
            }
        }
        all.retain(|change| change.within(file, machine));
        all
    }

    /// Columns that were exchanged, of motors or of values.
    pub(super) fn exchanges(file: &Series, machine: &Machine) -> Vec<Change> {
        let mut all = Change::all(file, machine);
        all.retain(|change| matches!(change, Change::Exchanged(..) | Change::MotorsExchanged(..)));
        all
    }

    /// Motors stay inside their travel, or a step of a hundredth beyond, and cover enough of it for a measurement.
    fn within(self, file: &Series, machine: &Machine) -> bool {
        let axes = match self {
            Change::MotorReversed(axis) | Change::MotorScaled(axis, _) => vec![axis],
            Change::MotorsExchanged(a, b) => vec![a, b],
            _ => return true,
        };
        let inside = |reading: &Reading| {
            let motors = self.reading(reading, file).motors;
            axes.iter().all(|axis| {
                let [lower, upper] = machine.drives[axis.index()].travel;
                let over = 0.01 * (upper - lower);
                (lower - over..=upper + over).contains(&motors[axis.index()])
            })
        };
        if let Change::MotorScaled(axis, _) = self {
            let at = file.readings.iter().map(|reading| self.reading(reading, file).motors[axis.index()]);
            let (least, most) = at.fold((f64::MAX, f64::MIN), |(least, most), at| (least.min(at), most.max(at)));
            let [lower, upper] = machine.drives[axis.index()].travel;
            if most - least < LEAST_COVERED * (upper - lower) {
                return false;
            }
        }
        // an axis that may only go one way can still be counted the wrong way
        matches!(self, Change::MotorReversed(_)) || file.readings.iter().all(inside)
    }

    fn reading(self, reading: &Reading, file: &Series) -> Reading {
        let mut changed = *reading;
        match self {
            Change::MotorReversed(axis) => changed.motors[axis.index()] *= -1.0,
            Change::MotorScaled(axis, factor) => changed.motors[axis.index()] *= factor,
            Change::MotorsExchanged(a, b) => changed.motors.swap(a.index(), b.index()),
            Change::PairReversed(a, b) if reading.pair == Some((a, b)) => changed.values[0] *= -1.0,
            Change::Exchanged(a, b) => changed.values.swap(a, b),
            _ => {}
        }
        let factors = self.factors(file);
        changed.values.iter_mut().zip(factors).for_each(|(value, factor)| *value *= factor);
        changed
    }

    /// By what each column of values is multiplied.
    pub(super) fn factors(self, file: &Series) -> [f64; 3] {
        let size = |c: usize| file.units.get(c).map_or(1.0, |unit| unit.size);
        std::array::from_fn(|c| match self {
            Change::Reversed(column) if column == c => -1.0,
            Change::AllReversed => -1.0,
            Change::Unit(column, unit) if column == c => unit.size / size(c),
            Change::AllUnit(unit) => unit.size / size(c),
            _ => 1.0,
        })
    }

    /// The file as it would be read then.
    pub(super) fn applied(self, file: &Series) -> Series {
        let readings = file.readings.iter().map(|reading| self.reading(reading, file)).collect();
        let approach = if let Change::Approach(other) = self { other } else { file.approach };
        Series { readings, approach, ..file.clone() }
    }

    /// What is read how: `at_gamma counted the other way`.
    pub(super) fn said(self, file: &Series) -> String {
        let motor = |axis: Axis| match file.kind {
            Kind::Straightness { .. } => "target".to_string(),
            _ => format!("at_{}", axis.name()),
        };
        let all = || (0..file.kind.columns().len()).map(|c| written(file, c)).collect::<Vec<_>>().join(", ");
        let other_unit = |columns: String, unit: Unit| format!("{columns} in {}", unit.name);
        match self {
            Change::MotorReversed(axis) => format!("{} counted the other way", motor(axis)),
            Change::MotorScaled(axis, factor) => {
                let (way, size) = if factor > 1.0 { ("larger", factor) } else { ("smaller", factor.recip()) };
                format!("{} in another unit, {size:.4} times {way} than written", motor(axis))
            }
            Change::MotorsExchanged(a, b) => format!("{} and {} exchanged", motor(a), motor(b)),
            Change::Reversed(c) => format!("{} of the other sign", written(file, c)),
            Change::AllReversed => format!("{} all of the other sign", all()),
            Change::PairReversed(a, b) => {
                format!("{} of the pair {}{} of the other sign", written(file, 0), a.name(), b.name())
            }
            Change::Exchanged(a, b) => format!("{} and {} exchanged", written(file, a), written(file, b)),
            Change::Unit(c, unit) => other_unit(written(file, c), unit),
            Change::AllUnit(unit) => other_unit(all(), unit),
            Change::Approach(Approach::Up) => "approach: up".into(),
            Change::Approach(Approach::Down) => "approach: down".into(),
            Change::Approach(Approach::Sequence) => "approach: sequence".into(),
        }
    }
}
