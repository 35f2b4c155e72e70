//! The accuracy field: E of the fibre point over a grid of linear or angular motion, its statistics, and what the
//! controller's law leaves of it.

use super::chain::Chain;
use super::errors::{ErrorModel, Form, Frame, Positions};
use super::propagation::Deviation;
use crate::calibrate::{Law, calibrate};
use crate::machine::Machine;
use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// Errors this close to each other (um, urad) are the same error: rounding must not choose the worst pose.
const TIE: f64 = 1e-9;

/// Which stages move; the others stay at home.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Motion {
    /// X, Y, Z.
    Linear,
    /// alpha, beta, gamma.
    Angular,
}

impl Motion {
    /// The three stages.
    pub const fn axes(self) -> [Axis; 3] {
        match self {
            Motion::Linear => Axis::LINEAR,
            Motion::Angular => Axis::ROTARY,
        }
    }
}

/// A box of poses: coordinates of the three stages that move, in um or rad, rising.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Which stages.
    pub motion: Motion,
    /// Coordinates along each.
    pub coordinates: [Vec<f64>; 3],
}

impl Grid {
    /// `points` (at least 2) along each stage from -`half` to +`half` (um or rad).
    pub fn symmetric(motion: Motion, half: f64, points: usize) -> Self {
        Self::between(motion, [[-half, half]; 3], points)
    }

    /// `points` (at least 2) along each stage over the machine's travel.
    pub fn travel(machine: &Machine, motion: Motion, points: usize) -> Self {
        let unit = match motion {
            Motion::Linear => 1e-3,
            Motion::Angular => 1e-9,
        };
        Self::between(
            motion,
            motion.axes().map(|axis| machine.drives[axis.index()].travel.map(|end| end * unit)),
            points,
        )
    }

    /// `points` (at least 2) along each stage between the ends given (um or rad).
    pub fn between(motion: Motion, ends: [[f64; 2]; 3], points: usize) -> Self {
        assert!(points >= 2, "a grid has two ends");
        let last = (points - 1) as f64;
        let along = |[from, to]: [f64; 2]| (0..points).map(|i| from + (to - from) * (i as f64 / last)).collect();
        Grid { motion, coordinates: ends.map(along) }
    }

    /// Number of poses.
    pub fn len(&self) -> usize {
        self.coordinates.iter().map(Vec::len).product()
    }

    /// True when there is no pose.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Place along each stage of the pose with a number: the last stage counts fastest.
    pub fn places(&self, number: usize) -> [usize; 3] {
        let [_, m, n] = self.coordinates.each_ref().map(Vec::len);
        [number / (m * n), number / n % m, number % n]
    }

    /// The pose with a number, um and rad.
    pub fn pose(&self, number: usize) -> Positions {
        let mut pose = [0.0; AXES];
        for ((axis, line), place) in self.motion.axes().iter().zip(&self.coordinates).zip(self.places(number)) {
            pose[axis.index()] = line[place];
        }
        pose
    }
}

/// Errors of the fibre point over a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Where.
    pub grid: Grid,
    /// E and the orientation error of each pose, in the order of the grid.
    pub deviations: Vec<Deviation>,
}

impl Field {
    /// The same field without its value at home: what alignment at home leaves.
    pub fn from_home(mut self, home: &Deviation) -> Self {
        for deviation in &mut self.deviations {
            *deviation = deviation.less(home);
        }
        self
    }

    /// E (um) at the places along the three stages.
    pub fn at(&self, [i, j, k]: [usize; 3]) -> [f64; 3] {
        let [_, m, n] = self.grid.coordinates.each_ref().map(Vec::len);
        self.deviations[(i * m + j) * n + k].position_um
    }
}

/// The field of a stage as it is: E of formula (6), exact, at the machine's own point F.
pub fn error_field(model: &ErrorModel, grid: &Grid) -> Field {
    let chain = Tabulated::new(model, grid);
    let deviations = (0..grid.len())
        .into_par_iter()
        .map(|number| Deviation::between(&chain.ideal(number), &chain.actual(number), model.fibre_point_um))
        .collect();
    Field { grid: grid.clone(), deviations }
}

/// The transforms of all stages at all coordinates of a grid, so that a pose costs only their product.
pub(super) struct Tabulated<'a> {
    grid: &'a Grid,
    base: Frame,
    actual: Vec<Vec<Frame>>,
    ideal: Vec<Vec<Frame>>,
    mount: Frame,
    /// For each stage from the base the moving one that it is, if any.
    moving: [Option<usize>; AXES],
}

impl<'a> Tabulated<'a> {
    pub(super) fn new(model: &ErrorModel, grid: &'a Grid) -> Self {
        let axes = grid.motion.axes();
        let moving = model.order.map(|axis| axes.iter().position(|&a| a == axis));
        let home = [0.0];
        let line = |k: usize| moving[k].map_or(&home[..], |i| &grid.coordinates[i]);
        let table = |joint: &dyn Fn(usize, f64) -> Frame| {
            (0..AXES).map(|k| line(k).iter().map(|&q| joint(k, q)).collect()).collect()
        };
        Tabulated {
            grid,
            base: model.chip_mount.frame(Form::Exact).inverse(),
            actual: table(&|k, q| model.joint(k, q, Form::Exact)),
            ideal: table(&|k, q| model.ideal_joint(k, q)),
            mount: model.fibre_mount.frame(Form::Exact),
            moving,
        }
    }

    fn product(&self, first: Frame, joints: &[Vec<Frame>], number: usize) -> Frame {
        let places = self.grid.places(number);
        (0..AXES).fold(first, |frame, k| frame * joints[k][self.moving[k].map_or(0, |i| places[i])])
    }

    pub(super) fn actual(&self, number: usize) -> Frame {
        self.product(self.base, &self.actual, number) * self.mount
    }

    pub(super) fn ideal(&self, number: usize) -> Frame {
        self.product(Frame::identity(), &self.ideal, number)
    }
}

/// By what law the motors are driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Compensation {
    /// The controller's: the coefficients of its calibration block, motors at whole steps.
    Controller,
    /// The exact inverse of the static errors, motors anywhere.
    Exact,
}

/// What a law leaves of the field, counted from home: the fibre point is sent to where the ideal stage would carry it,
/// by a law that knows the static errors, offsets and mounts of `machine` but not its kinematic errors.
///
/// `model` is the stage as it really is. Play is taken up, as the controller's overlay does.
///
/// # Errors
/// With the reason when the law does not serve such a stage or pose.
pub fn compensated_field(
    machine: &Machine,
    model: &ErrorModel,
    grid: &Grid,
    compensation: Compensation,
) -> Result<Field, String> {
    let chain = Chain::new(machine);
    let steps = machine.drives.map(|drive| drive.step);
    let law = match compensation {
        Compensation::Exact => None,
        Compensation::Controller => {
            let (block, _) = calibrate(machine).map_err(|refusal| refusal.to_string())?;
            Some(Law::of_block(&block, steps))
        }
    };
    let motors = |pose: [f64; AXES]| match &law {
        None => chain.exact_inverse(pose).ok_or("the exact law has no solution over this travel"),
        Some(law) => {
            let exact = law.actuators(pose);
            Ok(std::array::from_fn(|i| (exact[i] / steps[i]).round() * steps[i]))
        }
    };
    let point = Vector3::from(model.fibre_point_um);
    let home = model.ideal([0.0; AXES]).point(point);
    let start = model.error_at([0.0; AXES]);
    let residual = |number: usize| {
        let pose = grid.pose(number);
        let ideal = model.ideal(pose);
        let target = (ideal.point(point) - home) * 1e3;
        let [.., a, b, g] = pose;
        let q = motors([target.x, target.y, target.z, a * 1e9, b * 1e9, g * 1e9])?;
        let at = [q[0] * 1e-3, q[1] * 1e-3, q[2] * 1e-3, q[3] * 1e-9, q[4] * 1e-9, q[5] * 1e-9];
        Ok(Deviation::between(&ideal, &model.actual(at, Form::Exact), model.fibre_point_um).less(&start))
    };
    let deviations = (0..grid.len()).into_par_iter().map(residual).collect::<Result<_, &str>>()?;
    Ok(Field { grid: grid.clone(), deviations })
}

/// How large something is over a field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Size {
    /// Largest magnitude.
    pub max: f64,
    /// Root of the mean square.
    pub rms: f64,
    /// Half of the poses lie below.
    pub p50: f64,
    /// 95 % of the poses lie below.
    pub p95: f64,
    /// 99 % of the poses lie below.
    pub p99: f64,
    /// Number of the pose with the largest magnitude.
    #[serde(skip)]
    pub worst: usize,
    /// The pose with the largest magnitude: um and degrees.
    pub worst_pose_um_deg: [f64; AXES],
}

/// Statistics of a field: magnitudes of the components and of the whole error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Statistics {
    /// |Ex|, um.
    pub x_um: Size,
    /// |Ey|, um.
    pub y_um: Size,
    /// |Ez|, um.
    pub z_um: Size,
    /// Length of E, um.
    pub norm_um: Size,
    /// Orientation error, urad.
    pub rotation_urad: Size,
}

impl Statistics {
    /// Largest |Ex|, |Ey|, |Ez|, um.
    pub fn max_um(&self) -> [f64; 3] {
        [self.x_um.max, self.y_um.max, self.z_um.max]
    }
}

/// Statistics over all poses of a field.
pub fn statistics(field: &Field) -> Statistics {
    let size = |of: &dyn Fn(&Deviation) -> f64| {
        let values: Vec<f64> = field.deviations.iter().map(of).collect();
        let worst = worst_pose(&field.grid, &values);
        let pose = field.grid.pose(worst);
        let mut sorted = values;
        let rms = (sorted.iter().map(|v| v * v).sum::<f64>() / sorted.len() as f64).sqrt();
        sorted.sort_by(f64::total_cmp);
        Size {
            max: percentile(&sorted, 1.0),
            rms,
            p50: percentile(&sorted, 0.50),
            p95: percentile(&sorted, 0.95),
            p99: percentile(&sorted, 0.99),
            worst,
            worst_pose_um_deg: std::array::from_fn(|i| if i < 3 { pose[i] } else { pose[i].to_degrees() }),
        }
    };
    let norm = |v: [f64; 3]| Vector3::from(v).norm();
    Statistics {
        x_um: size(&|d| d.position_um[0].abs()),
        y_um: size(&|d| d.position_um[1].abs()),
        z_um: size(&|d| d.position_um[2].abs()),
        norm_um: size(&|d| norm(d.position_um)),
        rotation_urad: size(&|d| norm(d.rotation_rad) * 1e6),
    }
}

/// Number of the pose with the largest value; of poses as bad as that the one nearest to home.
pub(super) fn worst_pose(grid: &Grid, values: &[f64]) -> usize {
    let largest = values.iter().copied().fold(0.0, f64::max);
    let distance = |&number: &usize| grid.pose(number).iter().map(|q| q * q).sum::<f64>();
    let as_bad = (0..values.len()).filter(|&n| values[n] >= largest - TIE * (1.0 + largest));
    as_bad.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
}

/// The value below which a part of the sorted values lies, straight between neighbours; 0 without any.
pub fn percentile(sorted: &[f64], part: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return 0.0;
    };
    let place = part * last as f64;
    let below = (place.floor() as usize).min(last);
    let above = (below + 1).min(last);
    sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64)
}
