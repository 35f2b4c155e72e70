//! The accuracy of a machine over its travel, all of it: what `host-sim field` prints and draws.

use super::ensemble::{Ensemble, EnsembleStatistics, ensemble};
use super::errors::ErrorModel;
use super::field::{Compensation, Field, Grid, Motion, Statistics, compensated_field, error_field, statistics};
use super::propagation::{Deviation, FirstOrderGap};
use super::sensitivity::Magnitudes;
use crate::machine::Machine;
use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// Fields of a motion beside those of its two ensembles.
const FIELDS: usize = 4;

/// What an analysis of accuracy assumes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccuracyOptions {
    /// Poses along each stage, at least 2.
    pub points: usize,
    /// Linear stages from minus to plus this, um; none: their travel.
    pub linear_half_um: Option<f64>,
    /// Rotary stages from minus to plus this, rad; none: their travel.
    pub angular_half_rad: Option<f64>,
    /// Size of the errors of the ensembles.
    pub magnitudes: Magnitudes,
    /// Stages of each ensemble.
    pub stages: usize,
    /// Seed of chance.
    pub seed: u64,
}

impl Default for AccuracyOptions {
    fn default() -> Self {
        AccuracyOptions {
            points: 21,
            linear_half_um: None,
            angular_half_rad: None,
            magnitudes: Magnitudes::default(),
            stages: 300,
            seed: 1,
        }
    }
}

impl AccuracyOptions {
    /// How many fields an analysis computes: what an indicator of progress counts.
    pub fn fields(&self) -> usize {
        2 * (FIELDS + 2 * self.stages)
    }

    /// The poses of a motion.
    pub fn grid(&self, machine: &Machine, motion: Motion) -> Grid {
        let half = match motion {
            Motion::Linear => self.linear_half_um,
            Motion::Angular => self.angular_half_rad,
        };
        match half {
            Some(half) => Grid::symmetric(motion, half, self.points),
            None => Grid::travel(machine, motion, self.points),
        }
    }
}

/// Accuracy over linear or angular motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionAccuracy {
    /// Which stages move.
    pub motion: Motion,
    /// First and last coordinate of the three stages, um or degrees.
    pub ends_um_deg: [[f64; 2]; 3],
    /// Stages that would leave the machine's travel.
    pub beyond_travel: Vec<&'static str>,
    /// Poses along each stage.
    pub points: usize,
    /// The machine as its file says, against the ideal one: E of formula (6).
    pub machine: Statistics,
    /// E at home, um.
    pub home_um: [f64; 3],
    /// The same counted from home.
    pub before: Statistics,
    /// The same driven by the controller's law; none when that refuses.
    pub after: Option<Statistics>,
    /// Why the controller's law refuses.
    pub refusal: Option<String>,
    /// Driven by the exact inverse of the static errors; what it leaves is the kinematic part.
    pub after_exact: Option<Statistics>,
    /// What the first-order forms miss at the worst pose.
    pub first_order_gap: FirstOrderGap,
    /// All errors of the same sign on this geometry, as in Fig. 5.
    pub same_sign: Statistics,
    /// Stages of which only the size of the errors is known.
    pub ensembles: Vec<EnsembleStatistics>,
    /// The fields themselves.
    #[serde(skip)]
    pub fields: Fields,
}

/// The fields behind a [`MotionAccuracy`].
#[derive(Clone, Debug, PartialEq)]
pub struct Fields {
    /// Of the machine against the ideal one.
    pub machine: Field,
    /// The same counted from home.
    pub before: Field,
    /// Driven by the controller's law.
    pub after: Option<Field>,
    /// All errors of the same sign.
    pub same_sign: Field,
}

/// Accuracy of a machine.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Accuracy {
    /// Its name.
    pub machine: String,
    /// The point F, um.
    #[serde(rename = "F")]
    pub fibre_point_um: [f64; 3],
    /// Size of the errors of the ensembles.
    pub magnitudes: Magnitudes,
    /// Linear and angular motion.
    pub motions: [MotionAccuracy; 2],
}

/// Fields, ensembles and what compensation leaves. `progress` is called, by several threads, after each of the
/// [`AccuracyOptions::fields`] fields.
pub fn accuracy(machine: &Machine, options: &AccuracyOptions, progress: &(dyn Fn() + Sync)) -> Accuracy {
    let model = ErrorModel::of(machine);
    Accuracy {
        machine: machine.name.clone(),
        fibre_point_um: model.fibre_point_um,
        magnitudes: options.magnitudes,
        motions: [Motion::Linear, Motion::Angular]
            .map(|motion| motion_accuracy(machine, &model, options, motion, progress)),
    }
}

/// True when a coordinate, um or rad, lies outside of the machine's travel along an axis, by more than rounding.
pub fn beyond_travel(machine: &Machine, axis: Axis, coordinate: f64) -> bool {
    let [lower, upper] = machine.drives[axis.index()].travel;
    let nano = coordinate * if axis.is_rotary() { 1e9 } else { 1e3 };
    // a thousandth of nm or nrad
    nano < lower - 1e-3 || nano > upper + 1e-3
}

fn motion_accuracy(
    machine: &Machine,
    model: &ErrorModel,
    options: &AccuracyOptions,
    motion: Motion,
    progress: &(dyn Fn() + Sync),
) -> MotionAccuracy {
    let grid = options.grid(machine, motion);
    let home: Deviation = model.error_at([0.0; AXES]);
    let field = error_field(model, &grid);
    progress();
    let before = field.clone().from_home(&home);
    let after = compensated_field(machine, model, &grid, Compensation::Controller);
    progress();
    let exact = compensated_field(machine, model, &grid, Compensation::Exact).ok();
    progress();
    let same = error_field(&Ensemble::SameSign.stage(machine, &options.magnitudes, &grid, 0, 0), &grid);
    progress();
    let of_machine = statistics(&field);
    let ensembles = [Ensemble::RandomSigns, Ensemble::MonteCarlo]
        .map(|kind| ensemble(machine, kind, &options.magnitudes, &grid, options.stages, options.seed, progress));
    let unit = |q: f64| if motion == Motion::Angular { q.to_degrees() } else { q };
    MotionAccuracy {
        motion,
        ends_um_deg: grid.coordinates.each_ref().map(|line| [unit(line[0]), unit(line[line.len() - 1])]),
        beyond_travel: motion
            .axes()
            .into_iter()
            .zip(&grid.coordinates)
            .filter(|(axis, line)| line.iter().any(|&q| beyond_travel(machine, *axis, q)))
            .map(|(axis, _)| axis.name())
            .collect(),
        points: options.points,
        first_order_gap: model.first_order_gap(grid.pose(of_machine.norm_um.worst), model.fibre_point_um),
        machine: of_machine,
        home_um: home.position_um,
        before: statistics(&before),
        after: after.as_ref().ok().map(statistics),
        refusal: after.as_ref().err().cloned(),
        after_exact: exact.as_ref().map(statistics),
        same_sign: statistics(&same),
        ensembles: ensembles.into(),
        fields: Fields { machine: field, before, after: after.ok(), same_sign: same },
    }
}
