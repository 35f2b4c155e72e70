//! Tables 3 and 4 of the paper: the 36 kinematic errors, and the characteristic matrices of each pair of bodies.

use super::sensitivity::static_places;
use super::topology::coordinate;
use crate::machine::{ErrorName, StaticErrors};
use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// A row of table 3.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ErrorRow {
    /// Name of ISO 230-1.
    pub iso: String,
    /// Name of the paper.
    pub paper: String,
    /// The stage.
    pub axis: &'static str,
    /// What it is called in the trade.
    pub meaning: &'static str,
    /// Unit of its values.
    pub unit: &'static str,
}

/// One of the nine static errors.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct StaticErrorRow {
    /// Name in machine files.
    pub name: &'static str,
    /// The stage that has it.
    pub joint: &'static str,
    /// The axis about which it turns.
    pub about: &'static str,
    /// What it is.
    pub meaning: &'static str,
}

/// A row of table 4: the transform of a pair of bodies is Tp · dTp · Ts · dTs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CharacteristicRow {
    /// Carrying and carried body.
    pub pair: [usize; 2],
    /// What moves.
    pub stage: &'static str,
    /// Tp: nominal mounting.
    pub mounting: String,
    /// ΔTp: static error.
    pub static_error: String,
    /// Ts: ideal motion.
    pub motion: String,
    /// ΔTs: kinematic error.
    pub kinematic_error: String,
}

/// Table 3: the 36 kinematic errors, stage by stage from the base.
pub fn kinematic_errors(order: &[Axis; AXES]) -> Vec<ErrorRow> {
    let row = |name: ErrorName| ErrorRow {
        iso: name.iso(),
        paper: name.paper(),
        axis: name.axis.name(),
        meaning: name.meaning(),
        unit: name.unit(),
    };
    order.iter().flat_map(|&axis| ErrorName::all().filter(move |name| name.axis == axis)).map(row).collect()
}

/// The nine static errors with the stage that has each in this order, from the base.
pub fn static_errors(order: &[Axis; AXES]) -> Vec<StaticErrorRow> {
    const MEANINGS: [&str; 9] = [
        "squareness Z-X",
        "squareness Z-Y",
        "squareness X-Y",
        "gamma axis not parallel to Z",
        "gamma axis not parallel to Z",
        "beta axis not parallel to Y",
        "beta axis not parallel to Y",
        "alpha axis not parallel to X",
        "alpha axis not parallel to X",
    ];
    let places = static_places(order);
    let of_stage = |axis: Axis| (0..9).filter(move |&i| places[i].0 == axis).map(move |i| (i, places[i]));
    order
        .iter()
        .flat_map(|&axis| of_stage(axis))
        .map(|(i, (axis, about))| StaticErrorRow {
            name: StaticErrors::NAMES[i],
            joint: axis.name(),
            about: ["x", "y", "z"][about],
            meaning: MEANINGS[i],
        })
        .collect()
}

/// Table 4: the characteristic matrices of every pair of bodies of a serial order; `I` is the unit matrix.
pub fn characteristic_matrices(order: &[Axis; AXES], offset_um: &[[f64; 3]; AXES]) -> Vec<CharacteristicRow> {
    let places = static_places(order);
    let unit = || "I".to_string();
    let mount = |pair: [usize; 2], stage: &'static str| CharacteristicRow {
        pair,
        stage,
        mounting: unit(),
        static_error: format!("Trans(offset) exp([rotation]x) of mount.{stage}"),
        motion: unit(),
        kinematic_error: unit(),
    };
    let mut rows = vec![mount([0, 1], "chip")];
    for (k, &axis) in order.iter().enumerate() {
        let [x, y, z] = offset_um[axis.index()];
        let mut vector = ["0"; 3];
        for (i, (_, about)) in places.iter().enumerate().filter(|(_, place)| place.0 == axis) {
            vector[*about] = StaticErrors::NAMES[i];
        }
        let along = ["x", "y", "z"][axis.index() % 3];
        let q = coordinate(axis);
        let mut shift = ["0"; 3];
        shift[axis.index() % 3] = q;
        let name = axis.name();
        rows.push(CharacteristicRow {
            pair: [if k == 0 { 0 } else { k + 1 }, k + 2],
            stage: name,
            mounting: if [x, y, z] == [0.0; 3] { unit() } else { format!("Trans({x}, {y}, {z})") },
            static_error: if vector == ["0"; 3] { unit() } else { format!("exp([{}]x)", vector.join(", ")) },
            motion: if axis.is_rotary() { format!("R_{along}({q})") } else { format!("Trans({})", shift.join(", ")) },
            kinematic_error: format!("Trans(delta({name})) exp([epsilon({name})]x)"),
        });
    }
    rows.push(mount([7, 8], "fibre"));
    rows
}
