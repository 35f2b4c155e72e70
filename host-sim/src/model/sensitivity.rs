//! Sensitivity of the fibre point to every single error (tables 5 and 6 of the paper).
//!
//! A row of the 36 kinematic errors displaces its own stage by its unit and leaves the others at home; E is actual
//! minus ideal at that pose, exact. The static and mounting errors are given at home and with all six stages displaced.

use super::errors::{ErrorModel, Form, Positions, SixErrors};
use crate::machine::{Component, ErrorName, Function, Kinematic, Machine, StaticErrors};
use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// How large each error is taken to be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Magnitudes {
    /// A displacement, um.
    pub linear_um: f64,
    /// A rotation of a stage or a mount, rad.
    pub angular_rad: f64,
    /// Each of the nine static errors, rad.
    pub squareness_rad: f64,
}

impl Default for Magnitudes {
    /// Those of the paper.
    fn default() -> Self {
        Magnitudes { linear_um: 0.30, angular_rad: 50e-6, squareness_rad: 50e-6 }
    }
}

impl Magnitudes {
    /// The magnitude of a kinematic or mounting error.
    pub fn of(&self, component: Component) -> f64 {
        if component.is_angular() { self.angular_rad } else { self.linear_um }
    }
}

/// How far a stage is displaced.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UnitMotion {
    /// X, Y, Z, um.
    pub linear_um: f64,
    /// alpha, beta, gamma, rad.
    pub angle_rad: f64,
}

impl Default for UnitMotion {
    /// Those of the paper.
    fn default() -> Self {
        UnitMotion { linear_um: 1.0, angle_rad: 1.7e-3 }
    }
}

impl UnitMotion {
    fn of(&self, axis: Axis) -> f64 {
        if axis.is_rotary() { self.angle_rad } else { self.linear_um }
    }
}

/// What stands behind the single error in the column "with static errors".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// The nine static errors of the machine file.
    #[default]
    Machine,
    /// The same, and the mounts of fibre array and chip of the machine file.
    Mounted,
    /// All nine as large as [`Magnitudes::squareness_rad`].
    Uniform,
}

/// What a sensitivity analysis assumes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// The point F in the fibre array frame, um; none: that of the machine.
    pub fibre_point_um: Option<[f64; 3]>,
    /// Size of the errors.
    pub magnitudes: Magnitudes,
    /// Displacements.
    pub unit: UnitMotion,
    /// Column "with static errors".
    pub background: Background,
    /// Errors as large as the machine file says, not the magnitudes: its kinematic functions at the displaced
    /// position, its statics, its mounts.
    pub own: bool,
}

/// One kinematic error and what it does to F.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KinematicRow {
    /// Name of the paper.
    pub source: String,
    /// Name of ISO 230-1.
    pub iso: String,
    /// The stage.
    pub axis: &'static str,
    /// `linear` or `angular`.
    pub kind: &'static str,
    /// Its size, um or rad.
    pub value: f64,
    /// E at home in first order, um.
    #[serde(rename = "E_first_order")]
    pub first_order_um: [f64; 3],
    /// E of this error alone, its stage displaced, um (table 6).
    #[serde(rename = "E_no_static")]
    pub no_static_um: [f64; 3],
    /// E of this and the static errors, its stage displaced, um (table 5).
    #[serde(rename = "E_with_static")]
    pub with_static_um: [f64; 3],
}

/// One static or mounting error and what it does to F, alone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StaticRow {
    /// Name.
    pub source: String,
    /// The joint that has it: a stage, `fibre` or `chip`.
    pub joint: &'static str,
    /// The axis about which a static error turns; empty for a mount.
    pub about: &'static str,
    /// Its size, um or rad.
    pub value: f64,
    /// E at home, um.
    #[serde(rename = "E_at_home")]
    pub at_home_um: [f64; 3],
    /// E with all six stages displaced by their unit, um.
    #[serde(rename = "E_at_unit_pose")]
    pub at_unit_pose_um: [f64; 3],
    /// Change of E from home when X, Y, Z are displaced by their unit, um.
    #[serde(rename = "dE_linear_motion")]
    pub linear_motion_um: [f64; 3],
}

/// A source in the ranking of one direction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rank {
    /// Name.
    pub source: String,
    /// Name of ISO 230-1; empty for static and mounting errors.
    pub iso: String,
    /// What it does in that direction, um.
    pub effect_um: f64,
}

/// The result of a sensitivity analysis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Name of the machine.
    pub machine: String,
    /// The stages from the base to the fibre array.
    pub order: [&'static str; AXES],
    /// The point F, um.
    #[serde(rename = "F")]
    pub fibre_point_um: [f64; 3],
    /// The sizes used where the machine's own are not.
    pub magnitudes: Magnitudes,
    /// The displacements.
    pub unit: UnitMotion,
    /// Column "with static errors".
    pub background: Background,
    /// The nine static errors of that column, rad.
    pub background_statics_rad: [f64; 9],
    /// Errors as the machine file has them.
    pub own: bool,
    /// E of the background alone, at home, um.
    pub background_at_home_um: [f64; 3],
    /// The same in first order, um.
    pub background_first_order_um: [f64; 3],
    /// The 36 kinematic errors, stage by stage from the base.
    pub kinematic: Vec<KinematicRow>,
    /// The nine static and the twelve mounting errors.
    #[serde(rename = "static")]
    pub statics: Vec<StaticRow>,
    /// For x, y, z: all 57 sources, the strongest first (kinematic errors alone at their own displacement, the others
    /// with all stages displaced).
    pub ranking: [Vec<Rank>; 3],
}

/// Sensitivities of a machine's fibre point.
pub fn sensitivity(machine: &Machine, options: &Options) -> Sensitivity {
    let mut nominal = ErrorModel::nominal(machine);
    nominal.fibre_point_um = options.fibre_point_um.unwrap_or(nominal.fibre_point_um);
    let own = ErrorModel::of(machine);
    let background = background(&nominal, &own, options);
    let kinematic = kinematic_rows(&nominal, &own, &background, options);
    let statics = static_rows(&nominal, &own, options);
    let home = [0.0; AXES];
    Sensitivity {
        machine: machine.name.clone(),
        order: machine.order.map(Axis::name),
        fibre_point_um: nominal.fibre_point_um,
        magnitudes: options.magnitudes,
        unit: options.unit,
        background: options.background,
        background_statics_rad: background.statics.values(),
        own: options.own,
        background_at_home_um: background.error_at(home).position_um,
        background_first_order_um: background.first_order(home, background.fibre_point_um).position_um,
        ranking: ranking(&kinematic, &statics),
        kinematic,
        statics,
    }
}

fn background(nominal: &ErrorModel, own: &ErrorModel, options: &Options) -> ErrorModel {
    let mut model = nominal.clone();
    match options.background {
        Background::Uniform => model.statics = StaticErrors::from_values([options.magnitudes.squareness_rad; 9]),
        Background::Machine => model.statics = own.statics,
        Background::Mounted => {
            model.statics = own.statics;
            model.fibre_mount = own.fibre_mount;
            model.chip_mount = own.chip_mount;
        }
    }
    model
}

fn kinematic_rows(
    nominal: &ErrorModel,
    own: &ErrorModel,
    background: &ErrorModel,
    options: &Options,
) -> Vec<KinematicRow> {
    let names =
        nominal.order.into_iter().flat_map(|axis| Component::ALL.map(|component| ErrorName { axis, component }));
    let row = |name: ErrorName| {
        let axis = name.axis;
        let mut at = [0.0; AXES];
        at[axis.index()] = options.unit.of(axis);
        let value = if options.own {
            let errors = own.kinematic_errors(axis, at[axis.index()]);
            [errors.delta_um, errors.epsilon_rad].as_flattened()[name.component as usize]
        } else {
            options.magnitudes.of(name.component)
        };
        let with_error = |model: &ErrorModel| {
            let mut kinematic = Kinematic::default();
            kinematic.set(name, Function::constant(value));
            ErrorModel { kinematic, ..model.clone() }
        };
        let alone = with_error(nominal);
        KinematicRow {
            source: name.paper(),
            iso: name.iso(),
            axis: axis.name(),
            kind: if name.component.is_angular() { "angular" } else { "linear" },
            value,
            first_order_um: alone.first_order([0.0; AXES], alone.fibre_point_um).position_um,
            no_static_um: alone.error_at(at).position_um,
            with_static_um: with_error(background).error_at(at).position_um,
        }
    };
    names.map(row).collect()
}

/// The stage that has each of the nine static errors, and the axis about which it turns, in their order.
pub(super) fn static_places(order: &[Axis; AXES]) -> [(Axis, usize); 9] {
    std::array::from_fn(|i| {
        let mut values = [0.0; 9];
        values[i] = 1.0;
        let model = StaticErrors::from_values(values);
        let on = |k: usize| super::chain::static_vector(&model, &order[..=k]);
        let k = (0..AXES).find(|&k| on(k).norm() > 0.0).expect("every static error has a stage");
        (order[k], on(k).imax())
    })
}

fn static_rows(nominal: &ErrorModel, own: &ErrorModel, options: &Options) -> Vec<StaticRow> {
    let unit: Positions = Axis::ALL.map(|axis| options.unit.of(axis));
    let linear = [unit[0], unit[1], unit[2], 0.0, 0.0, 0.0];
    let row = |source: String, joint, about, value: f64, model: &ErrorModel| {
        let at = |pose| model.deviation(pose, model.fibre_point_um, Form::Exact).position_um;
        let (at_home_um, moved) = (at([0.0; AXES]), at(linear));
        let linear_motion_um = std::array::from_fn(|i| moved[i] - at_home_um[i]);
        StaticRow { source, joint, about, value, at_home_um, at_unit_pose_um: at(unit), linear_motion_um }
    };
    let mut rows = Vec::with_capacity(21);
    let places = static_places(&nominal.order);
    for (i, name) in StaticErrors::NAMES.into_iter().enumerate() {
        let mut values = [0.0; 9];
        values[i] = if options.own { own.statics.values()[i] } else { options.magnitudes.squareness_rad };
        let model = ErrorModel { statics: StaticErrors::from_values(values), ..nominal.clone() };
        let (axis, about) = places[i];
        rows.push(row(name.into(), axis.name(), ["x", "y", "z"][about], values[i], &model));
    }
    for (joint, mount) in [("fibre", own.fibre_mount), ("chip", own.chip_mount)] {
        for component in Component::ALL {
            let i = component as usize;
            let mut six = [0.0; 6];
            six[i] = match options.own {
                true => [mount.delta_um, mount.epsilon_rad].as_flattened()[i],
                false => options.magnitudes.of(component),
            };
            let mut model = nominal.clone();
            *if joint == "fibre" { &mut model.fibre_mount } else { &mut model.chip_mount } = SixErrors::from_array(six);
            rows.push(row(format!("{}({joint} mount)", component.paper()), joint, "", six[i], &model));
        }
    }
    rows
}

fn ranking(kinematic: &[KinematicRow], statics: &[StaticRow]) -> [Vec<Rank>; 3] {
    std::array::from_fn(|c| {
        let moving = kinematic.iter().map(|row| (&row.source, row.iso.as_str(), row.no_static_um[c]));
        let still = statics.iter().map(|row| (&row.source, "", row.at_unit_pose_um[c]));
        let mut ranks: Vec<Rank> = moving
            .chain(still)
            .map(|(source, iso, effect_um)| Rank { source: source.clone(), iso: iso.into(), effect_um })
            .collect();
        ranks.sort_by(|a, b| b.effect_um.abs().total_cmp(&a.effect_um.abs()));
        ranks
    })
}
