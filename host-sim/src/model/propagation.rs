//! Formula (6): the error of a point of the fibre array at any pose, E = actual − ideal, in chip axes.

use super::errors::{ErrorModel, Form, Frame, Positions};
use super::rotation::vee;
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use stage_controller::units::AXES;

/// Error of a point and of the array's orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Deviation {
    /// Actual minus ideal position, um, chip axes.
    pub position_um: [f64; 3],
    /// Rotation vector from the ideal to the actual orientation, rad, chip axes.
    pub rotation_rad: [f64; 3],
}

/// What the first-order forms miss at a pose, um.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FirstOrderGap {
    /// Exact minus the product of matrices I + `[ε]×`: length, um.
    pub matrices_um: f64,
    /// Exact minus the sum of the effects of every single error: length, um.
    pub sum_um: f64,
}

impl ErrorModel {
    /// E at a pose (um, rad) of a point of the fibre array (um): formula (6).
    pub fn deviation(&self, at: Positions, point_um: [f64; 3], form: Form) -> Deviation {
        Deviation::between(&self.ideal(at), &self.actual(at, form), point_um)
    }

    /// E of the machine's own point F, exact.
    pub fn error_at(&self, at: Positions) -> Deviation {
        self.deviation(at, self.fibre_point_um, Form::Exact)
    }

    /// E as the sum of the effects of every single error on the ideal stage:
    /// Σ R δ + (R ε) × (p_F − p), minus the same of the chip's mount.
    pub fn first_order(&self, at: Positions, point_um: [f64; 3]) -> Deviation {
        let point = self.ideal(at).point(point_um.into());
        let (mut position, mut rotation) = (Vector3::zeros(), Vector3::zeros());
        let mut add = |frame: &Frame, delta: [f64; 3], epsilon: Vector3<f64>| {
            let turn = frame.rotation * epsilon;
            position += frame.rotation * Vector3::from(delta) + turn.cross(&(point - frame.origin));
            rotation += turn;
        };
        let chip = self.chip_mount;
        add(&Frame::identity(), chip.delta_um.map(|v| -v), -Vector3::from(chip.epsilon_rad));
        let mut frame = Frame::identity();
        for k in 0..AXES {
            let axis = self.order[k];
            let q = at[axis.index()];
            frame = frame * self.mounting(axis);
            add(&frame, [0.0; 3], self.static_error(k));
            frame = frame * Self::motion(axis, q);
            let errors = self.kinematic_errors(axis, q);
            add(&frame, errors.delta_um, errors.epsilon_rad.into());
        }
        add(&frame, self.fibre_mount.delta_um, self.fibre_mount.epsilon_rad.into());
        Deviation { position_um: position.into(), rotation_rad: rotation.into() }
    }

    /// How far the first-order forms are from the exact one.
    pub fn first_order_gap(&self, at: Positions, point_um: [f64; 3]) -> FirstOrderGap {
        let exact = Vector3::from(self.deviation(at, point_um, Form::Exact).position_um);
        let matrices = Vector3::from(self.deviation(at, point_um, Form::FirstOrder).position_um);
        let sum = Vector3::from(self.first_order(at, point_um).position_um);
        FirstOrderGap { matrices_um: (exact - matrices).norm(), sum_um: (exact - sum).norm() }
    }
}

impl Deviation {
    /// Error of a point of the array (um) between two placements of it.
    pub fn between(ideal: &Frame, actual: &Frame, point_um: [f64; 3]) -> Self {
        let point = Vector3::from(point_um);
        Deviation {
            position_um: (actual.point(point) - ideal.point(point)).into(),
            rotation_rad: rotation_vector(&(actual.rotation * ideal.rotation.transpose())).into(),
        }
    }

    /// This deviation counted from another one. Rotations are subtracted as vectors: they are small.
    pub fn less(&self, other: &Deviation) -> Self {
        Deviation {
            position_um: std::array::from_fn(|i| self.position_um[i] - other.position_um[i]),
            rotation_rad: std::array::from_fn(|i| self.rotation_rad[i] - other.rotation_rad[i]),
        }
    }
}

/// The rotation vector of a rotation below 90 degrees.
fn rotation_vector(r: &Matrix3<f64>) -> Vector3<f64> {
    let sine = vee(r);
    let length = sine.norm();
    let cosine = 0.5 * (r.trace() - 1.0);
    if length == 0.0 { sine } else { sine * (length.atan2(cosine) / length) }
}
