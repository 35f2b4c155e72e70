//! Rotations: the exponential of a vector, the small rotation vector of a matrix, logical angles.

use nalgebra::{Matrix3, Vector3};
use stage_controller::units::{AXES, Axis};

/// Rotation by the vector `v` (radians, right-handed): Rodrigues with 2 sin²(θ/2) for 1 − cos θ.
pub fn exp(v: Vector3<f64>) -> Matrix3<f64> {
    let angle = v.norm();
    if angle == 0.0 {
        return Matrix3::identity();
    }
    let unit = (v / angle).cross_matrix();
    let half = (0.5 * angle).sin();
    Matrix3::identity() + unit * angle.sin() + unit * unit * (2.0 * half * half)
}

/// Half the antisymmetric part of a rotation: axis · sin θ, the rotation vector of a small rotation.
pub fn vee(r: &Matrix3<f64>) -> Vector3<f64> {
    0.5 * Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)])
}

/// The meaning of the logical angles: the product of the ideal rotations in the machine's own rotary
/// order, base to tip (docs/LAW.md 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Euler {
    /// Index (0 = alpha about x, 1 = beta about y, 2 = gamma about z) from base to tip.
    sequence: [usize; 3],
}

impl Euler {
    /// From the machine's order; the linear axes in it are skipped.
    pub fn new(order: &[Axis]) -> Self {
        let mut rotary = order.iter().filter(|axis| axis.is_rotary()).map(|axis| axis.index() - 3);
        let mut next = || rotary.next().expect("an order holds three rotary axes");
        Euler { sequence: [next(), next(), next()] }
    }

    /// Indices of the rotary axes from base to tip.
    pub fn sequence(&self) -> [usize; 3] {
        self.sequence
    }

    /// Orientation R* of the logical angles (alpha, beta, gamma) in radians.
    pub fn compose(&self, angles: [f64; 3]) -> Matrix3<f64> {
        self.sequence.iter().fold(Matrix3::identity(), |r, &i| r * exp(Vector3::ith(i, angles[i])))
    }

    /// Orientation R* of a pose, nm and nrad in axis order.
    pub fn of_pose(&self, pose: &[f64; AXES]) -> Matrix3<f64> {
        self.compose([pose[3], pose[4], pose[5]].map(|angle| angle * 1e-9))
    }

    /// Logical angles (alpha, beta, gamma) in radians of an orientation; the middle one within ±90°.
    pub fn decompose(&self, r: &Matrix3<f64>) -> [f64; 3] {
        let [i, j, k] = self.sequence;
        let sign = if (i + 1) % 3 == j { 1.0 } else { -1.0 };
        let mut angles = [0.0; 3];
        angles[i] = (-sign * r[(j, k)]).atan2(r[(k, k)]);
        angles[j] = (sign * r[(i, k)]).atan2(r[(i, i)].hypot(r[(i, j)]));
        angles[k] = (-sign * r[(i, j)]).atan2(r[(i, i)]);
        angles
    }
}
