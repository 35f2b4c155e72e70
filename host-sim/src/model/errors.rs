//! A stage with its errors: ideal and actual transforms between neighbouring bodies, in um and rad.
//!
//! Body k lies in the one before it by T = Tp · ΔTp · Ts(q) · ΔTs(q): where it is nominally mounted, its static error,
//! its motion, and its kinematic errors at that position. The chip stands on the base by ΔT of its mount, the fibre
//! array on the last stage by that of its own.

use super::chain::static_vector;
use super::rotation::exp;
use crate::machine::{Kinematic, Machine, Mount, StaticErrors};
use nalgebra::{Matrix3, Vector3};
use stage_controller::units::{AXES, Axis};
use std::ops::Mul;

/// Where one frame lies in another: orientation, and origin in um.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Orientation; in the first-order form not exactly a rotation.
    pub rotation: Matrix3<f64>,
    /// Origin, um.
    pub origin: Vector3<f64>,
}

impl Frame {
    /// A frame that coincides with the other.
    pub fn identity() -> Self {
        Frame { rotation: Matrix3::identity(), origin: Vector3::zeros() }
    }

    /// Displaced by `v` um.
    pub fn displaced(v: Vector3<f64>) -> Self {
        Frame { rotation: Matrix3::identity(), origin: v }
    }

    /// Turned by the matrix.
    pub fn turned(rotation: Matrix3<f64>) -> Self {
        Frame { rotation, origin: Vector3::zeros() }
    }

    /// A point of the inner frame in the outer one, um.
    pub fn point(&self, p: Vector3<f64>) -> Vector3<f64> {
        self.origin + self.rotation * p
    }

    /// The outer frame in the inner one; the orientation must not be singular.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.try_inverse().expect("errors of a stage are small rotations");
        Frame { rotation, origin: -(rotation * self.origin) }
    }
}

impl Mul for Frame {
    type Output = Frame;

    fn mul(self, inner: Frame) -> Frame {
        Frame { rotation: self.rotation * inner.rotation, origin: self.point(inner.origin) }
    }
}

/// How an error matrix is made from its six numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// Rotation `exp([ε]×)`.
    #[default]
    Exact,
    /// I + `[ε]×`, the form of the paper: second order in the angles is missing.
    FirstOrder,
}

/// Displacement and rotation of a body against where it should be.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SixErrors {
    /// Displacement, um.
    pub delta_um: [f64; 3],
    /// Rotation vector, rad.
    pub epsilon_rad: [f64; 3],
}

impl SixErrors {
    /// From three displacements (um) and three rotations (rad).
    pub fn from_array([dx, dy, dz, ex, ey, ez]: [f64; 6]) -> Self {
        SixErrors { delta_um: [dx, dy, dz], epsilon_rad: [ex, ey, ez] }
    }

    /// The error matrix: displacement, then rotation.
    pub fn frame(&self, form: Form) -> Frame {
        Frame { rotation: small_rotation(self.epsilon_rad.into(), form), origin: self.delta_um.into() }
    }
}

impl From<Mount> for SixErrors {
    fn from(mount: Mount) -> Self {
        SixErrors { delta_um: mount.offset_nm.map(|v| v * 1e-3), epsilon_rad: mount.rotation_rad }
    }
}

pub(super) fn small_rotation(epsilon: Vector3<f64>, form: Form) -> Matrix3<f64> {
    match form {
        Form::Exact => exp(epsilon),
        Form::FirstOrder => Matrix3::identity() + epsilon.cross_matrix(),
    }
}

/// Positions of the six stages in axis order: X, Y, Z in um; alpha, beta, gamma in rad.
pub type Positions = [f64; AXES];

/// All errors of a stage and its nominal geometry: what formula (6) needs.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorModel {
    /// The stages from the base to the fibre array.
    pub order: [Axis; AXES],
    /// Nominal position of each joint frame in the one before it, um, in axis order.
    pub offset_um: [[f64; 3]; AXES],
    /// The point F in the fibre array frame, um.
    pub fibre_point_um: [f64; 3],
    /// The nine static angular errors.
    pub statics: StaticErrors,
    /// The 36 kinematic errors.
    pub kinematic: Kinematic,
    /// Error of the fibre array's mount on the last stage.
    pub fibre_mount: SixErrors,
    /// Error of the chip's mount on the base.
    pub chip_mount: SixErrors,
}

impl ErrorModel {
    /// The stage of a machine file with all its errors.
    pub fn of(machine: &Machine) -> Self {
        ErrorModel {
            statics: machine.statics,
            kinematic: machine.kinematic.clone(),
            fibre_mount: machine.mounts.fibre.into(),
            chip_mount: machine.mounts.chip.into(),
            ..ErrorModel::nominal(machine)
        }
    }

    /// The same stage without any error.
    pub fn nominal(machine: &Machine) -> Self {
        ErrorModel {
            order: machine.order,
            offset_um: machine.axis_offset_nm.map(|offset| offset.map(|v| v * 1e-3)),
            fibre_point_um: machine.fibre_point_nm.map(|v| v * 1e-3),
            statics: StaticErrors::default(),
            kinematic: Kinematic::default(),
            fibre_mount: SixErrors::default(),
            chip_mount: SixErrors::default(),
        }
    }

    /// The kinematic errors of a stage at its position (um or rad).
    pub fn kinematic_errors(&self, axis: Axis, position: f64) -> SixErrors {
        let written = if axis.is_rotary() { position.to_degrees() } else { position };
        SixErrors::from_array(self.kinematic.at(axis, written))
    }

    /// The static error of the stage in place `k` of the order: the vector of its rotations, rad.
    pub fn static_error(&self, k: usize) -> Vector3<f64> {
        static_vector(&self.statics, &self.order[..=k])
    }

    /// Tp: the nominal mounting of a stage.
    pub fn mounting(&self, axis: Axis) -> Frame {
        Frame::displaced(self.offset_um[axis.index()].into())
    }

    /// Ts: the ideal motion of a stage to its position (um or rad).
    pub fn motion(axis: Axis, position: f64) -> Frame {
        if axis.is_rotary() {
            Frame::turned(exp(Vector3::ith(axis.index() - 3, position)))
        } else {
            Frame::displaced(Vector3::ith(axis.index(), position))
        }
    }

    /// Tp · ΔTp · Ts · ΔTs of the stage in place `k` of the order, at its position (um or rad).
    pub fn joint(&self, k: usize, position: f64, form: Form) -> Frame {
        let axis = self.order[k];
        self.mounting(axis)
            * Frame::turned(small_rotation(self.static_error(k), form))
            * Self::motion(axis, position)
            * self.kinematic_errors(axis, position).frame(form)
    }

    /// Tp · Ts of the stage in place `k` of the order, at its position (um or rad).
    pub fn ideal_joint(&self, k: usize, position: f64) -> Frame {
        let axis = self.order[k];
        self.mounting(axis) * Self::motion(axis, position)
    }

    /// The fibre array in chip axes, with all errors.
    pub fn actual(&self, at: Positions, form: Form) -> Frame {
        let base = self.chip_mount.frame(form).inverse();
        let last = (0..AXES).fold(base, |frame, k| frame * self.joint(k, at[self.order[k].index()], form));
        last * self.fibre_mount.frame(form)
    }

    /// The fibre array in chip axes, if there were no errors.
    pub fn ideal(&self, at: Positions) -> Frame {
        (0..AXES).fold(Frame::identity(), |frame, k| frame * self.ideal_joint(k, at[self.order[k].index()]))
    }
}
