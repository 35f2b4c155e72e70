//! How many of the constants that a chain could have can be told apart from outside.

use super::constants::{CONSTANTS, Constant};
use super::jacobian::{Linearised, Twist};
use crate::machine::Machine;
use nalgebra::{DMatrix, DVector, Vector3};
use serde::Serialize;
use stage_controller::units::AXES;

/// Poses at which the array's position and orientation are compared.
const POSES: usize = 60;
/// Singular values below this share of the largest count as zero: far above rounding, far below what is real.
const ZERO: f64 = 1e-9;
/// Length that makes an angle a position, nm: the size of a stage.
const SIZE: f64 = 5e7;

/// Numerical ranks of sets of constants, seen by position and orientation of the array at any pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ranks {
    /// Of the 48: eight interfaces with six each.
    pub candidates: usize,
    /// Smallest singular value of the 48 that counts, and the largest that does not, as shares of the largest.
    pub gap: (f64, f64),
    /// Of the nine static angles alone.
    pub statics: usize,
    /// Of the 24 that are fitted.
    pub chosen: usize,
}

/// The ranks for a machine's order and constants; its travel does not matter.
pub fn ranks(machine: &Machine) -> Ranks {
    let poses = poses();
    let all = Constant::all(&machine.order);
    let constants = |count: usize| {
        singular_values(machine, &poses, |at| {
            all[..count].iter().map(|constant| at.constant(*constant, &machine.order)).collect()
        })
    };
    let candidates = singular_values(machine, &poses, interface_twists);
    let rank = rank_of(&candidates);
    let share = |i: usize| candidates.get(i).map_or(0.0, |value| value / candidates[0]);
    Ranks {
        candidates: rank,
        gap: (share(rank - 1), share(rank)),
        statics: rank_of(&constants(9)),
        chosen: rank_of(&constants(CONSTANTS)),
    }
}

fn rank_of(values: &DVector<f64>) -> usize {
    values.iter().filter(|value| **value > ZERO * values[0]).count()
}

/// Poses of low discrepancy (Kronecker sequence) over +-20 mm and +-0.5 rad, in nm and nrad.
fn poses() -> Vec<[f64; AXES]> {
    // fractional parts of multiples of the roots of primes fill the cube evenly
    let roots = [2.0_f64, 3.0, 5.0, 7.0, 11.0, 13.0].map(f64::sqrt);
    let reach = [2e7, 2e7, 2e7, 5e8, 5e8, 5e8];
    (1..=POSES).map(|n| std::array::from_fn(|i| reach[i] * (2.0 * (n as f64 * roots[i]).fract() - 1.0))).collect()
}

/// Three shifts and three turns in each of the eight interfaces.
fn interface_twists(at: &Linearised) -> Vec<Twist> {
    let mut twists = Vec::with_capacity(48);
    for interface in at.interfaces() {
        for c in 0..3 {
            let column: Vector3<f64> = interface.rotation.column(c).into();
            twists.push(Twist { turn: Vector3::zeros(), about: interface.origin, shift: column });
            twists.push(Twist { turn: column, about: interface.origin, shift: Vector3::zeros() });
        }
    }
    twists
}

/// Singular values, largest first, of the Jacobian with columns of unit length.
fn singular_values(
    machine: &Machine,
    poses: &[[f64; AXES]],
    twists: impl Fn(&Linearised) -> Vec<Twist>,
) -> DVector<f64> {
    let mut rows: Vec<Vec<f64>> = Vec::with_capacity(6 * poses.len());
    for pose in poses {
        let at = Linearised::new(machine, pose);
        let (rotation, origin) = at.array(machine);
        let point = origin + rotation * Vector3::from(machine.fibre_point_nm);
        let twists = twists(&at);
        for c in 0..3 {
            rows.push(twists.iter().map(|twist| twist.moves(point)[c]).collect());
            rows.push(twists.iter().map(|twist| twist.turn[c] * SIZE).collect());
        }
    }
    let mut jacobian = DMatrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j]);
    for mut column in jacobian.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    let mut values = jacobian.singular_values();
    values.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
    values
}

/// Those of some constants that depend on the ones before them at this machine; empty where all can be told apart.
pub fn dependent(constants: &[Constant], machine: &Machine) -> Vec<Constant> {
    let poses = poses();
    let mut kept: Vec<Constant> = Vec::new();
    let mut dependent = Vec::new();
    for constant in constants {
        kept.push(*constant);
        let twists = |at: &Linearised| kept.iter().map(|constant| at.constant(*constant, &machine.order)).collect();
        if rank_of(&singular_values(machine, &poses, twists)) < kept.len() {
            dependent.push(*constant);
            kept.pop();
        }
    }
    dependent
}
