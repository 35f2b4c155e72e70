//! What an instrument would read at a stage with given constants, and how that changes with each of them.

use super::constants::{CONSTANTS, Constant};
use super::jacobian::{Linearised, Twist};
use super::play::{Behind, actuators};
use super::position_errors::PositionErrors;
use super::series::{Kind, Reading, Series};
use super::units::HOUR;
use super::zeros::{Centred, Equation, Lines};
use crate::machine::Machine;
use crate::model::{Chain, exp, vee};
use nalgebra::{Matrix3, Vector3};
use stage_controller::units::{AXES, Axis};
use std::cell::OnceCell;
use std::f64::consts::FRAC_PI_2;

/// A mirror is glued to the array within this, rad; it keeps its tilt from running away where nothing tells it.
pub const MIRROR_SIGMA: f64 = 0.02;

/// Something besides the constants that belongs to one file.
#[derive(Clone, Debug, PartialEq)]
pub struct Nuisance {
    /// For the report: `drift of x per hour`.
    pub name: String,
    /// Standard deviation that is known beforehand, if any.
    pub prior: Option<f64>,
}

fn nuisance(name: impl Into<String>) -> Nuisance {
    Nuisance { name: name.into(), prior: None }
}

/// What is fitted to a file besides the constants, but for the zeros of lines (`zeros.rs`). Values: nm or nrad, drift
/// per hour, slopes as they are, tilts rad.
pub fn nuisances(series: &Series, drift: bool) -> Vec<Nuisance> {
    let mut all = match series.kind {
        // these are evaluated on their own
        Kind::Positioning(_) => return Vec::new(),
        Kind::Straightness { to_chip: false, .. } => vec![nuisance("offset"), nuisance("slope")],
        Kind::Straightness { to_chip: true, .. } => vec![nuisance("offset")],
        Kind::Autocollimator(_) => {
            let tilt = |c: &str| Nuisance { name: format!("tilt of the mirror {c}"), prior: Some(MIRROR_SIGMA) };
            let [a, b] = [0, 1].map(|i| series.kind.columns()[i]);
            vec![nuisance(format!("zero {a}")), nuisance(format!("zero {b}")), tilt(a), tilt(b)]
        }
        _ => Vec::new(),
    };
    if drift && series.shows_drift() {
        let columns = series.kind.columns().iter();
        all.extend(columns.map(|column| nuisance(format!("drift of {column} per hour"))));
    }
    all
}

/// Where everything stands among the unknowns.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Order of the axes.
    pub order: [Axis; AXES],
    /// The 24.
    pub constants: [Constant; CONSTANTS],
    /// Column of each that is fitted.
    pub constant_columns: [Option<usize>; CONSTANTS],
    /// The same of the motors' plays.
    pub play_columns: [Option<usize>; AXES],
    /// First column of each file's own.
    pub first: Vec<usize>,
    /// All columns.
    pub width: usize,
}

impl Layout {
    /// How many columns all files have in common, those of constants and plays: they come first.
    pub fn common(&self) -> usize {
        self.first.first().copied().unwrap_or(self.width)
    }
}

/// The stage and the files' own values, at which is linearised.
#[derive(Clone, Debug)]
pub struct State {
    /// The nominal machine with the present constants and plays.
    pub machine: Machine,
    /// Of each file.
    pub own: Vec<Vec<f64>>,
}

/// Measured less computed of one reading, with the derivatives of what is computed.
#[derive(Clone, Debug)]
pub struct Block {
    /// nm or nrad, as many as the kind has columns.
    pub residual: [f64; 3],
    /// One row for each column of the file.
    pub rows: [Vec<f64>; 3],
    /// Variance of what was fitted to the reading and eliminated, per one of a reading of weight 1.
    pub eliminated: f64,
}

impl Block {
    /// Empty rows for the common columns and a file's own behind them.
    pub fn new(width: usize) -> Self {
        Block { residual: [0.0; 3], rows: std::array::from_fn(|_| vec![0.0; width]), eliminated: 0.0 }
    }
}

/// The stage at one reading.
struct Place {
    rotation: Matrix3<f64>,
    point: Vector3<f64>,
    at: Linearised,
}

/// Evaluates the readings of one file at one state.
pub struct Observer<'a> {
    layout: &'a Layout,
    series: &'a Series,
    machine: &'a Machine,
    own: &'a [f64],
    first: usize,
    drift: bool,
    chain: Chain,
    behind: Vec<Behind>,
    lines: Lines,
    /// Of diagonals: all readings without the zeros of their lines.
    centred: OnceCell<Centred>,
    weights: &'a [f64],
    /// And their first column.
    beyond: Option<(&'a PositionErrors, usize)>,
}

impl<'a> Observer<'a> {
    /// For the file with this index, whose readings count with these weights.
    pub fn new(
        layout: &'a Layout,
        state: &'a State,
        series: &'a Series,
        index: usize,
        drift: bool,
        weights: &'a [f64],
    ) -> Self {
        let play = state.machine.drives.map(|drive| drive.backlash);
        Observer {
            layout,
            series,
            machine: &state.machine,
            own: &state.own[index],
            first: layout.common(),
            drift: drift && series.shows_drift(),
            chain: Chain::new(&state.machine),
            behind: actuators(series, play),
            lines: Lines::new(series),
            weights,
            centred: OnceCell::new(),
            beyond: None,
        }
    }

    /// Fills columns of position-dependent errors too.
    pub(super) fn with_position_errors(self, errors: &'a PositionErrors) -> Self {
        let first = self.first + self.own.len();
        Observer { beyond: Some((errors, first)), ..self }
    }

    /// Of diagonals: all readings with so many columns, without the zeros of their lines.
    pub fn centred(&self, width: usize) -> Option<&Centred> {
        let evaluate = || {
            let mut block = Block::new(width);
            let equation = |k: usize| {
                self.reading(k, &mut block);
                Equation { residual: block.residual[0], row: block.rows[0].clone() }
            };
            let equations = (0..self.series.readings.len()).map(equation).collect();
            Centred::new(self.lines.clone(), equations, self.weights)
        };
        (self.series.kind == Kind::Diagonal).then(|| self.centred.get_or_init(evaluate))
    }

    /// The same for good.
    pub(super) fn into_centred(mut self, width: usize) -> Option<Centred> {
        self.centred(width)?;
        self.centred.take()
    }

    fn place(&self, k: usize, point: [f64; 3]) -> Place {
        let q = self.behind[k].actuators;
        let (rotation, origin) = self.chain.array(q);
        Place { rotation, point: origin + rotation * Vector3::from(point), at: Linearised::new(self.machine, &q) }
    }

    /// Calls back with each fitted column and what it does to the array at a reading.
    fn each_twist(&self, at: &Linearised, k: usize, mut use_it: impl FnMut(usize, Twist)) {
        for (constant, column) in self.layout.constants.iter().zip(self.layout.constant_columns) {
            if let Some(column) = column {
                use_it(column, at.constant(*constant, &self.layout.order));
            }
        }
        for axis in Axis::ALL {
            let (column, share) = (self.layout.play_columns[axis.index()], self.behind[k].per_play[axis.index()]);
            if let Some(column) = column.filter(|_| share != 0.0) {
                use_it(column, at.actuator(axis));
            }
        }
        if let Some((errors, first)) = self.beyond {
            errors.each_twist(at, &self.layout.order, &self.behind[k].actuators, first, use_it);
        }
    }

    /// Fills the rows of reading `k`.
    pub fn fill(&self, k: usize, block: &mut Block) {
        match self.centred(block.rows[0].len()) {
            Some(centred) => centred.fill(k, block),
            None => self.reading(k, block),
        }
    }

    /// The same with the zeros of lines.
    pub(super) fn reading(&self, k: usize, block: &mut Block) {
        block.rows.iter_mut().for_each(|row| row.fill(0.0));
        let reading = &self.series.readings[k];
        match self.series.kind {
            Kind::Positioning(_) => unreachable!("runs are evaluated on their own"),
            Kind::Squareness => self.squareness(reading, block),
            Kind::Diagonal => self.diagonal(k, reading, block),
            Kind::Straightness { axis, direction, to_chip } => {
                let place = self.place(k, self.machine.fibre_point_nm);
                let along = reading.motors[axis.index()];
                let home = self.chain.fibre_home();
                let own = self.own[0] + if to_chip { 0.0 } else { self.own[1] * along };
                block.residual[0] = reading.values[0] - (place.point[direction] - home[direction]) - own;
                block.rows[0][self.first] = 1.0;
                if !to_chip {
                    block.rows[0][self.first + 1] = along;
                }
                let start = Linearised::new(self.machine, &[0.0; AXES]);
                self.each_twist(&place.at, k, |c, twist| block.rows[0][c] += twist.moves(place.point)[direction]);
                for (constant, column) in self.layout.constants.iter().zip(self.layout.constant_columns) {
                    if let Some(column) = column {
                        let twist = start.constant(*constant, &self.layout.order);
                        block.rows[0][column] -= twist.moves(home)[direction];
                    }
                }
            }
            Kind::Autocollimator(normal) => self.autocollimator(k, normal, reading, block),
            Kind::Fibre(point) => {
                let place = self.place(k, point.unwrap_or(self.machine.fibre_point_nm));
                for c in 0..3 {
                    block.residual[c] = reading.values[c] - place.point[c];
                }
                self.each_twist(&place.at, k, |column, twist| {
                    let moved = twist.moves(place.point);
                    (0..3).for_each(|c| block.rows[c][column] = moved[c]);
                });
            }
            Kind::Orientation => {
                let place = self.place(k, self.machine.fibre_point_nm);
                let measured = exp(Vector3::from(reading.values) * 1e-9);
                let off = vee(&(measured * place.rotation.transpose())) * 1e9;
                (0..3).for_each(|c| block.residual[c] = off[c]);
                self.each_twist(&place.at, k, |column, twist| {
                    (0..3).for_each(|c| block.rows[c][column] = twist.turn[c] * 1e9);
                });
            }
        }
        if self.drift {
            let columns = self.series.kind.columns().len();
            let skip = self.own.len() - columns;
            for c in 0..columns {
                block.rows[c][self.first + skip + c] = reading.time_s / HOUR;
                block.residual[c] -= self.own[skip + c] * reading.time_s / HOUR;
            }
        }
    }

    /// The angle between two slides at home, less 90 degrees.
    fn squareness(&self, reading: &Reading, block: &mut Block) {
        let (a, b) = reading.pair.expect("every row of squareness has its pair");
        let at = Linearised::new(self.machine, &[0.0; AXES]);
        let (along_a, along_b) = (at.direction(a), at.direction(b));
        let cosine = along_a.dot(&along_b);
        block.residual[0] = reading.values[0] - (cosine.acos() - FRAC_PI_2) * 1e9;
        let order = &self.layout.order;
        for (constant, column) in self.layout.constants.iter().zip(self.layout.constant_columns) {
            if let Some(column) = column {
                let turned_a = at.turns_axis(*constant, a, order).cross(&along_a);
                let turned_b = at.turns_axis(*constant, b, order).cross(&along_b);
                let grown = turned_a.dot(&along_b) + along_a.dot(&turned_b);
                block.rows[0][column] = -grown / (1.0 - cosine * cosine).sqrt() * 1e9;
            }
        }
    }

    /// Distance from the first point of the line.
    fn diagonal(&self, k: usize, reading: &Reading, block: &mut Block) {
        let first = self.lines.start(k);
        let point = self.machine.fibre_point_nm;
        let (start, here) = (self.place(first, point), self.place(k, point));
        let way = here.point - start.point;
        let distance = way.norm();
        block.residual[0] = reading.values[0] - distance;
        if distance > 1.0 {
            let along = way / distance;
            self.each_twist(&here.at, k, |c, twist| block.rows[0][c] += along.dot(&twist.moves(here.point)));
            self.each_twist(&start.at, first, |c, twist| block.rows[0][c] -= along.dot(&twist.moves(start.point)));
        }
    }

    /// Angles of the mirror's normal about the two chip axes across it.
    fn autocollimator(&self, k: usize, normal: usize, reading: &Reading, block: &mut Block) {
        let (i, j) = ((normal + 1) % 3, (normal + 2) % 3);
        let place = self.place(k, self.machine.fibre_point_nm);
        let tilt = Vector3::ith(i, self.own[2]) + Vector3::ith(j, self.own[3]);
        let n = place.rotation * exp(tilt) * Vector3::ith(normal, 1.0);
        let angles = [(-n[j]).atan2(n[normal]), n[i].atan2(n[normal])];
        for (c, angle) in angles.into_iter().enumerate() {
            block.residual[c] = reading.values[c] - angle * 1e9 - self.own[c];
            block.rows[c][self.first + c] = 1.0;
        }
        let mut turn = |column: usize, turn: Vector3<f64>| {
            let d = turn.cross(&n);
            block.rows[0][column] = (n[j] * d[normal] - d[j] * n[normal]) / (n[j].powi(2) + n[normal].powi(2)) * 1e9;
            block.rows[1][column] = (d[i] * n[normal] - n[i] * d[normal]) / (n[i].powi(2) + n[normal].powi(2)) * 1e9;
        };
        self.each_twist(&place.at, k, |column, twist| turn(column, twist.turn));
        turn(self.first + 2, place.rotation.column(i).into());
        turn(self.first + 3, place.rotation.column(j).into());
    }
}
