//! The 36 kinematic errors of a machine: what a stage does wrong as a function of where it stands (ISO 230-1).
//!
//! In a machine file, `[kinematic.X] EYX = {poly = [...], table = [[position, value], ...], fourier = [[period, cos,
//! sin], ...]}`; the forms that are given are added. Positions are those of the stage itself, in um or degrees;
//! values in um (E·X, E·Y, E·Z) or rad (E·A, E·B, E·C).

use super::file::Row;
use super::{LARGEST_STATIC, MachineError};
use serde::Deserialize;
use stage_controller::units::{AXES, Axis};
use std::f64::consts::TAU;

/// Largest displacement that is taken for an error of a stage, um: beyond it a unit was mistaken (nm for um).
pub const LARGEST_KINEMATIC_UM: f64 = 200.0;
/// A table of positions that reaches less than this part of a linear travel was written in mm.
const NARROWEST_LINEAR: f64 = 1.0 / 200.0;
/// The same of a rotary travel, written in rad.
const NARROWEST_ROTARY: f64 = 1.0 / 40.0;
/// A table that reaches farther than so many travels was written in nm or nrad.
const WIDEST: f64 = 100.0;
/// Points along the travel at which values are checked.
const CHECKED_POINTS: usize = 257;

/// One kinematic error as a function of the stage's position: the sum of three forms, each of which may be absent.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(try_from = "FunctionFile")]
pub struct Function {
    poly: Vec<f64>,
    table: Vec<[f64; 2]>,
    fourier: Vec<[f64; 3]>,
}

/// A function as written, unchecked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FunctionFile {
    poly: Option<Vec<f64>>,
    table: Option<Vec<Row<2>>>,
    fourier: Option<Vec<Row<3>>>,
}

impl TryFrom<FunctionFile> for Function {
    type Error = String;

    fn try_from(file: FunctionFile) -> Result<Self, String> {
        if file.poly.is_none() && file.table.is_none() && file.fourier.is_none() {
            return Err("an error needs poly = [...], table = [[position, value], ...] or fourier = [[period, cos, \
                        sin], ...]"
                .into());
        }
        let table = file.table.unwrap_or_default().into_iter().map(|row| row.0).collect();
        let fourier = file.fourier.unwrap_or_default().into_iter().map(|row| row.0).collect();
        Function::new(file.poly.unwrap_or_default(), table, fourier)
    }
}

impl Function {
    /// The sum of a polynomial (coefficients of rising powers of the position, the constant first), a table of
    /// (position, value) and harmonics (period, cosine, sine).
    ///
    /// Between two entries of the table the value runs straight; before the first and behind the last it stays.
    ///
    /// # Errors
    /// When a number is not finite, the positions of the table do not rise, or a period is not positive.
    pub fn new(poly: Vec<f64>, table: Vec<[f64; 2]>, fourier: Vec<[f64; 3]>) -> Result<Self, String> {
        let numbers = poly.iter().chain(table.as_flattened()).chain(fourier.as_flattened());
        if let Some(bad) = numbers.copied().find(|v| !v.is_finite()) {
            return Err(format!("{bad} is not a finite number"));
        }
        if let Some(pair) = table.windows(2).find(|pair| pair[0][0] >= pair[1][0]) {
            return Err(format!(
                "the positions of a table must rise, but {} is followed by {}",
                pair[0][0], pair[1][0]
            ));
        }
        if let Some([period, ..]) = fourier.iter().find(|row| row[0] <= 0.0) {
            return Err(format!("the period {period} must be positive"));
        }
        Ok(Function { poly, table, fourier })
    }

    /// The same error everywhere.
    pub fn constant(value: f64) -> Self {
        Function { poly: vec![value], ..Function::default() }
    }

    /// The error at a position (um or degrees), um or rad.
    pub fn value(&self, position: f64) -> f64 {
        let poly = self.poly.iter().rev().fold(0.0, |sum, c| sum * position + c);
        let harmonic = |[period, cos, sin]: &[f64; 3]| {
            let (s, c) = (TAU * position / period).sin_cos();
            cos * c + sin * s
        };
        poly + self.tabulated(position) + self.fourier.iter().map(harmonic).sum::<f64>()
    }

    fn tabulated(&self, position: f64) -> f64 {
        let behind = self.table.partition_point(|row| row[0] <= position);
        match (behind.checked_sub(1).map(|i| self.table[i]), self.table.get(behind)) {
            (Some([p0, v0]), Some([p1, v1])) => v0 + (v1 - v0) * ((position - p0) / (p1 - p0)),
            (Some([_, last]), None) => last,
            (None, Some([_, first])) => *first,
            (None, None) => 0.0,
        }
    }

    /// Its coefficients of rising powers, the entries of its table, its harmonics: what [`Function::new`] takes.
    pub fn parts(&self) -> (&[f64], &[[f64; 2]], &[[f64; 3]]) {
        (&self.poly, &self.table, &self.fourier)
    }

    /// True when nothing is given: the error is zero everywhere.
    pub fn is_absent(&self) -> bool {
        self.poly.is_empty() && self.table.is_empty() && self.fourier.is_empty()
    }

    /// Refuses what no stage does over `travel` (um or degrees): values and positions of a mistaken unit.
    fn check(&self, name: ErrorName, travel: [f64; 2]) -> Result<(), MachineError> {
        let refused = |value: String, reason: String| Err(MachineError::value(name.key(), value, reason));
        let rotary = name.axis.is_rotary();
        let reach = travel[0].abs().max(travel[1].abs());
        if let (Some(first), Some(last)) = (self.table.first(), self.table.last()) {
            let span = first[0].abs().max(last[0].abs());
            let (narrowest, unit, mistaken) =
                if rotary { (NARROWEST_ROTARY, "deg", "rad") } else { (NARROWEST_LINEAR, "um", "mm") };
            if self.table.len() > 1 && span < narrowest * reach {
                let reason =
                    format!("positions are in {unit} and the travel reaches {reach} {unit}: was {mistaken} meant?");
                return refused(format!("table from {} to {}", first[0], last[0]), reason);
            }
            if span > WIDEST * reach {
                let reason = format!("positions are in {unit} and the travel reaches only {reach} {unit}");
                return refused(format!("table from {} to {}", first[0], last[0]), reason);
            }
        }
        let (largest, unit) =
            if name.component.is_angular() { (LARGEST_STATIC, "rad") } else { (LARGEST_KINEMATIC_UM, "um") };
        let step = (travel[1] - travel[0]) / (CHECKED_POINTS - 1) as f64;
        let along = (0..CHECKED_POINTS).map(|i| travel[0] + step * i as f64);
        for position in along.chain(self.table.iter().map(|row| row[0])) {
            let value = self.value(position);
            if !(-largest..=largest).contains(&value) {
                let at = if rotary { "deg" } else { "um" };
                let reason = format!("that is its value at {position} {at}; at most {largest} {unit} is believed");
                return refused(format!("{value} {unit}"), reason);
            }
        }
        Ok(())
    }
}

/// One of the six ways in which a body can move: three displacements, three rotations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// Displacement along x.
    DeltaX,
    /// Displacement along y.
    DeltaY,
    /// Displacement along z.
    DeltaZ,
    /// Rotation about x.
    EpsilonX,
    /// Rotation about y.
    EpsilonY,
    /// Rotation about z.
    EpsilonZ,
}

impl Component {
    /// Displacements, then rotations.
    pub const ALL: [Component; 6] = [
        Component::DeltaX,
        Component::DeltaY,
        Component::DeltaZ,
        Component::EpsilonX,
        Component::EpsilonY,
        Component::EpsilonZ,
    ];

    /// True for a rotation (rad), false for a displacement (um).
    pub const fn is_angular(self) -> bool {
        self as usize >= 3
    }

    /// 0, 1, 2 for x, y, z.
    pub const fn direction(self) -> usize {
        self as usize % 3
    }

    /// The name of the paper, such as `delta_x`.
    pub const fn paper(self) -> &'static str {
        ["delta_x", "delta_y", "delta_z", "epsilon_x", "epsilon_y", "epsilon_z"][self as usize]
    }

    /// The letter of ISO 230-1: X, Y, Z for displacements, A, B, C for rotations.
    pub const fn letter(self) -> char {
        ['X', 'Y', 'Z', 'A', 'B', 'C'][self as usize]
    }
}

/// Which of the 36 kinematic errors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorName {
    /// The stage whose position it depends on.
    pub axis: Axis,
    /// What it displaces or turns.
    pub component: Component,
}

impl ErrorName {
    /// All 36, stage by stage in axis order.
    pub fn all() -> impl Iterator<Item = ErrorName> {
        Axis::ALL.into_iter().flat_map(|axis| Component::ALL.map(|component| ErrorName { axis, component }))
    }

    /// The name of ISO 230-1: E, the direction, the stage. `EYX` is the straightness of X along y.
    pub fn iso(self) -> String {
        format!("E{}{}", self.component.letter(), ['X', 'Y', 'Z', 'A', 'B', 'C'][self.axis.index()])
    }

    /// The name of the paper, such as `delta_y(X)`.
    pub fn paper(self) -> String {
        format!("{}({})", self.component.paper(), self.axis.name())
    }

    /// What it is called in the trade (ISO 230-1).
    pub fn meaning(self) -> &'static str {
        let own = self.component.direction() == self.axis.index() % 3;
        match (self.axis.is_rotary(), self.component.is_angular(), own) {
            (false, false, true) => "positioning",
            (false, false, false) => "straightness",
            (false, true, true) => "roll",
            (false, true, false) if self.is_pitch() => "pitch",
            (false, true, false) => "yaw",
            (true, false, true) => "axial",
            (true, false, false) => "radial run-out",
            (true, true, true) => "angular positioning",
            (true, true, false) => "wobble",
        }
    }

    /// Of the two tilts of a horizontal stage the one about the other horizontal axis; of Z the one about x. Height
    /// is Y on this stage.
    fn is_pitch(self) -> bool {
        self.component.direction() == if self.axis == Axis::X { 2 } else { 0 }
    }

    /// The key in a machine file, such as `kinematic.X.EYX`.
    pub fn key(self) -> String {
        format!("kinematic.{}.{}", self.axis.name(), self.iso())
    }

    /// Unit of the values.
    pub const fn unit(self) -> &'static str {
        if self.component.is_angular() { "rad" } else { "um" }
    }
}

/// The 36 kinematic errors of a machine.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Kinematic {
    functions: [[Function; 6]; AXES],
}

impl Kinematic {
    /// One of the errors.
    pub fn get(&self, name: ErrorName) -> &Function {
        &self.functions[name.axis.index()][name.component as usize]
    }

    /// Replaces one of the errors.
    pub fn set(&mut self, name: ErrorName, function: Function) {
        self.functions[name.axis.index()][name.component as usize] = function;
    }

    /// The six errors of a stage at its position (um or degrees): three displacements in um, three rotations in rad.
    pub fn at(&self, axis: Axis, position: f64) -> [f64; 6] {
        self.functions[axis.index()].each_ref().map(|f| f.value(position))
    }
}

macro_rules! six_errors {
    ($name:ident: $($field:ident)*) => {
        #[derive(Clone, Debug, Default, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        #[allow(non_snake_case)]
        struct $name { $($field: Function),* }

        impl $name {
            fn six(self) -> [Function; 6] { [$(self.$field),*] }
        }
    };
}

six_errors!(OfX: EXX EYX EZX EAX EBX ECX);
six_errors!(OfY: EXY EYY EZY EAY EBY ECY);
six_errors!(OfZ: EXZ EYZ EZZ EAZ EBZ ECZ);
six_errors!(OfAlpha: EXA EYA EZA EAA EBA ECA);
six_errors!(OfBeta: EXB EYB EZB EAB EBB ECB);
six_errors!(OfGamma: EXC EYC EZC EAC EBC ECC);

/// The table `[kinematic]` of a machine file, its values not yet checked against the travel.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case)]
pub(super) struct KinematicFile {
    X: OfX,
    Y: OfY,
    Z: OfZ,
    #[serde(alias = "A")]
    alpha: OfAlpha,
    #[serde(alias = "B")]
    beta: OfBeta,
    #[serde(alias = "C")]
    gamma: OfGamma,
}

impl KinematicFile {
    /// The errors, when they can be believed over the travels (um or degrees, axis order).
    pub(super) fn check(self, travels: [[f64; 2]; AXES]) -> Result<Kinematic, MachineError> {
        let functions = [self.X.six(), self.Y.six(), self.Z.six(), self.alpha.six(), self.beta.six(), self.gamma.six()];
        let kinematic = Kinematic { functions };
        for name in ErrorName::all() {
            kinematic.get(name).check(name, travels[name.axis.index()])?;
        }
        Ok(kinematic)
    }
}
