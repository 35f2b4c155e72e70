//! How many of the errors that a stage could have are independent of each other: numerical ranks.

use super::errors::{ErrorModel, Frame};
use super::sensitivity::static_places;
use nalgebra::{DMatrix, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// Poses at which position and orientation of the fibre array are taken.
const POSES: usize = 24;
/// A singular value below this part of the largest counts as zero; those that are not lie far above it.
const ZERO: f64 = 1e-9;
/// Interfaces between bodies: the chip's mount, six stages, the mount of the fibre array.
const INTERFACES: usize = AXES + 2;

/// Numerical ranks of the identification Jacobian.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Structure {
    /// Candidates: six at each of the eight interfaces.
    pub candidates: usize,
    /// How many of them a measurement of all poses can tell apart.
    pub rank_of_candidates: usize,
    /// The nine static errors: how many of them.
    pub rank_of_static: usize,
    /// The 24 constants (nine static errors, three distances between rotary axes, two mounts): how many of them. All,
    /// and so a complete set, unless a rotary stage carries a linear one: then some of the nine may be zero shifts of
    /// that rotary stage in disguise.
    pub rank_of_constants: usize,
}

/// The ranks of an order of stages, from position and orientation of the fibre array at random poses (lengths and
/// angles of the order of 1, so that no scale is preferred).
pub fn structure(order: &[Axis; AXES]) -> Structure {
    let jacobian = jacobian(order);
    let mut constants: Vec<usize> = (0..6).chain(6 * (INTERFACES - 1)..6 * INTERFACES).collect();
    let nine: Vec<usize> =
        static_places(order).iter().map(|&(axis, about)| 6 * interface(order, axis) + 3 + about).collect();
    constants.extend(&nine);
    constants.extend(axis_distances(order));
    Structure {
        candidates: jacobian.ncols(),
        rank_of_candidates: rank(&jacobian),
        rank_of_static: rank(&jacobian.select_columns(&nine)),
        rank_of_constants: rank(&jacobian.select_columns(&constants)),
    }
}

fn interface(order: &[Axis; AXES], axis: Axis) -> usize {
    1 + order.iter().position(|&a| a == axis).expect("an order names every axis")
}

/// Columns of the three distances between rotary axes: each pair has one, along the third direction, at the later one.
fn axis_distances(order: &[Axis; AXES]) -> [usize; 3] {
    let rotary: Vec<Axis> = order.iter().copied().filter(|axis| axis.is_rotary()).collect();
    [(0, 1), (1, 2), (0, 2)].map(|(first, second)| {
        let third = 3 - (rotary[first].index() - 3) - (rotary[second].index() - 3);
        6 * interface(order, rotary[second]) + third
    })
}

/// Change of position and orientation by each candidate, all poses below each other.
fn jacobian(order: &[Axis; AXES]) -> DMatrix<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut vector = || Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
    let offsets: [Vector3<f64>; AXES] = std::array::from_fn(|_| vector());
    let fibre = vector();
    let mut rows = DMatrix::zeros(6 * POSES, 6 * INTERFACES);
    for pose in 0..POSES {
        let (lengths, angles) = (vector(), vector());
        let mut frames = vec![Frame::identity(); 2];
        for (k, &axis) in order.iter().enumerate() {
            let at = if axis.is_rotary() { angles[axis.index() - 3] } else { lengths[axis.index()] };
            let joint = frames[k + 1] * Frame::displaced(offsets[k]);
            frames[k + 1] = joint;
            frames.push(joint * ErrorModel::motion(axis, at));
        }
        let last = frames[INTERFACES - 1];
        let point = last.point(fibre);
        for (i, frame) in frames.iter().enumerate() {
            let lever = (point - frame.origin).cross_matrix();
            rows.fixed_view_mut::<3, 3>(6 * pose, 6 * i).copy_from(&frame.rotation);
            rows.fixed_view_mut::<3, 3>(6 * pose, 6 * i + 3).copy_from(&(-lever * frame.rotation));
            rows.fixed_view_mut::<3, 3>(6 * pose + 3, 6 * i + 3).copy_from(&frame.rotation);
        }
    }
    rows
}

fn rank(matrix: &DMatrix<f64>) -> usize {
    let values = matrix.clone().svd(false, false).singular_values;
    let limit = values.max() * ZERO;
    values.iter().filter(|&&v| v > limit).count()
}
