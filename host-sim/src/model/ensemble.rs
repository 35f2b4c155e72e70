//! Ensembles: stages of which only the size of the errors is known, drawn by a seed, and how accurate they are.

use super::errors::ErrorModel;
use super::field::{Grid, Tabulated, percentile};
use super::sensitivity::Magnitudes;
use crate::machine::{Component, ErrorName, Function, Machine, StaticErrors};
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use std::f64::consts::TAU;

/// Stages of which only the size of the errors is known. The nine static errors and the eighteen kinematic ones of the
/// stages that move take part; those of a stage that stays at home are part of the alignment there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ensemble {
    /// One stage: every error as large as its magnitude and positive, at every pose.
    SameSign,
    /// Every error as large as its magnitude, at every pose, with a sign by chance.
    RandomSigns,
    /// Static errors anywhere between plus and minus their magnitude; each kinematic error zero at home and one
    /// harmonic of the position, a (sin(2 pi q / p + f) - sin f) / 2, with a between plus and minus its magnitude, a
    /// period p of 1 to 4 times the reach of the grid, and any phase f.
    MonteCarlo,
}

/// How a figure is spread over the stages of an ensemble.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Half of the stages lie below.
    pub median: f64,
    /// 95 % of the stages lie below.
    pub p95: f64,
    /// The worst stage.
    pub max: f64,
}

/// Result of an ensemble.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EnsembleStatistics {
    /// Which.
    pub ensemble: Ensemble,
    /// Number of stages.
    pub stages: usize,
    /// Seed of chance; the same seed gives the same stages.
    pub seed: u64,
    /// Largest |Ex|, |Ey|, |Ez| over the field of a stage, um.
    pub max_um: [Spread; 3],
    /// Largest length of E over the field of a stage, um.
    pub norm_max_um: Spread,
    /// Root mean square of the length of E over the field of a stage, um.
    pub norm_rms_um: Spread,
}

impl Ensemble {
    /// One stage of the ensemble, with geometry and F of the machine. `number` from 0; the same seed and number give
    /// the same stage.
    pub fn stage(
        self,
        machine: &Machine,
        magnitudes: &Magnitudes,
        grid: &Grid,
        seed: u64,
        number: usize,
    ) -> ErrorModel {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(number as u64);
        let mut sized = |magnitude: f64| match self {
            Ensemble::SameSign => magnitude,
            Ensemble::RandomSigns => magnitude * if random.random::<bool>() { 1.0 } else { -1.0 },
            Ensemble::MonteCarlo => magnitude * random.random_range(-1.0..1.0),
        };
        let mut model = ErrorModel::nominal(machine);
        model.statics = StaticErrors::from_values(std::array::from_fn(|_| sized(magnitudes.squareness_rad)));
        let mut sizes = [[0.0; 6]; 3];
        for six in &mut sizes {
            *six = Component::ALL.map(|component| sized(magnitudes.of(component)));
        }
        for (i, axis) in grid.motion.axes().into_iter().enumerate() {
            let reach = grid.coordinates[i].iter().fold(0.0_f64, |reach, q| reach.max(q.abs()));
            let reach = if axis.is_rotary() { reach.to_degrees() } else { reach };
            for component in Component::ALL {
                let size = sizes[i][component as usize];
                let function = match self {
                    Ensemble::MonteCarlo => {
                        let (sin, cos) = random.random_range(0.0..TAU).sin_cos();
                        let period = reach * random.random_range(1.0..4.0);
                        let rows = vec![[period, 0.5 * size * sin, 0.5 * size * cos]];
                        Function::new(vec![-0.5 * size * sin], vec![], rows).expect("a grid has a reach")
                    }
                    _ => Function::constant(size),
                };
                model.kinematic.set(ErrorName { axis, component }, function);
            }
        }
        model
    }
}

/// Fields of an ensemble of stages with geometry and F of the machine. `progress` is called after each stage, by
/// several threads.
pub fn ensemble(
    machine: &Machine,
    kind: Ensemble,
    magnitudes: &Magnitudes,
    grid: &Grid,
    stages: usize,
    seed: u64,
    progress: &(dyn Fn() + Sync),
) -> EnsembleStatistics {
    let stages = if kind == Ensemble::SameSign { 1 } else { stages };
    let one = |number: usize| {
        let model = kind.stage(machine, magnitudes, grid, seed, number);
        let chain = Tabulated::new(&model, grid);
        let point = Vector3::from(model.fibre_point_um);
        let (mut max, mut norm_max, mut squares) = ([0.0_f64; 3], 0.0_f64, 0.0);
        for pose in 0..grid.len() {
            let e = chain.actual(pose).point(point) - chain.ideal(pose).point(point);
            max = std::array::from_fn(|c| max[c].max(e[c].abs()));
            norm_max = norm_max.max(e.norm());
            squares += e.norm_squared();
        }
        progress();
        [max[0], max[1], max[2], norm_max, (squares / grid.len() as f64).sqrt()]
    };
    let results: Vec<[f64; 5]> = (0..stages).into_par_iter().map(one).collect();
    let spread = |column: usize| {
        let mut values: Vec<f64> = results.iter().map(|row| row[column]).collect();
        values.sort_by(f64::total_cmp);
        Spread { median: percentile(&values, 0.5), p95: percentile(&values, 0.95), max: percentile(&values, 1.0) }
    };
    EnsembleStatistics {
        ensemble: kind,
        stages,
        seed,
        max_um: [spread(0), spread(1), spread(2)],
        norm_max_um: spread(3),
        norm_rms_um: spread(4),
    }
}
