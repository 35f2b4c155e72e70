//! How the array's pose changes with each constant and each actuator: exact twists, first order in the change.

use super::constants::Constant;
use crate::machine::{Machine, StaticErrors};
use crate::model::{exp, static_vector};
use nalgebra::{Matrix3, Vector3};
use stage_controller::units::{AXES, Axis};

/// What a small change of one quantity does to all that is carried behind it, in chip axes.
#[derive(Clone, Copy, Debug)]
pub struct Twist {
    /// Rotation per unit.
    pub turn: Vector3<f64>,
    /// A point that the rotation leaves, nm.
    pub about: Vector3<f64>,
    /// Translation per unit, nm.
    pub shift: Vector3<f64>,
}

impl Twist {
    fn shift(shift: Vector3<f64>) -> Self {
        Twist { turn: Vector3::zeros(), about: Vector3::zeros(), shift }
    }

    fn turn(turn: Vector3<f64>, about: Vector3<f64>) -> Self {
        Twist { turn, about, shift: Vector3::zeros() }
    }

    /// How a point (nm, chip axes) that is carried moves.
    pub fn moves(&self, point: Vector3<f64>) -> Vector3<f64> {
        self.shift + self.turn.cross(&(point - self.about))
    }
}

/// `d exp([v]x) = [J dv]x exp([v]x)`: the left Jacobian of the rotations, to third order beyond what static errors
/// need (0.02 rad: 1e-10).
fn left_jacobian(v: Vector3<f64>) -> Matrix3<f64> {
    let k = v.cross_matrix();
    let (k2, k3) = (k * k, k * k * k);
    Matrix3::identity() + k * 0.5 + k2 / 6.0 + k3 / 24.0
}

/// Frames of one interface: where the constants of a stage are put in.
#[derive(Clone, Copy, Debug)]
pub struct Interface {
    /// Orientation before the static error, in chip axes.
    pub rotation: Matrix3<f64>,
    /// Origin behind the nominal translation, nm.
    pub origin: Vector3<f64>,
}

/// The chain at one position of the actuators, with all that derivatives need.
#[derive(Clone, Debug)]
pub struct Linearised {
    base: Matrix3<f64>,
    chip_turn: Matrix3<f64>,
    joints: [(Axis, Interface, Matrix3<f64>); AXES],
    /// Direction (unit) and a point of each axis, in axis order.
    axes: [(Vector3<f64>, Vector3<f64>); AXES],
    end: Interface,
    fibre_turn: Matrix3<f64>,
}

impl Linearised {
    /// At actuators in nm and nrad.
    pub fn new(machine: &Machine, actuators: &[f64; AXES]) -> Self {
        let chip_vector = Vector3::from(machine.mounts.chip.rotation_rad);
        let chip = exp(chip_vector);
        let base = chip.transpose();
        let (mut rotation, mut origin) = (base, -(base * Vector3::from(machine.mounts.chip.offset_nm)));
        let none = Interface { rotation, origin };
        let mut axes = [(Vector3::zeros(), Vector3::zeros()); AXES];
        let mut joints = [(Axis::X, none, Matrix3::identity()); AXES];
        for (k, joint) in joints.iter_mut().enumerate() {
            let axis = machine.order[k];
            let index = axis.index();
            origin += rotation * Vector3::from(machine.axis_offset_nm[index]);
            let tilt = static_vector(&machine.statics, &machine.order[..=k]);
            *joint = (axis, Interface { rotation, origin }, left_jacobian(tilt));
            rotation *= exp(tilt);
            let along: Vector3<f64> = rotation.column(index % 3).into();
            axes[index] = (along, origin);
            if axis.is_rotary() {
                rotation *= exp(Vector3::ith(index - 3, actuators[index] * 1e-9));
            } else {
                origin += along * actuators[index];
            }
        }
        origin += rotation * Vector3::from(machine.mounts.fibre.offset_nm);
        let fibre_turn = left_jacobian(machine.mounts.fibre.rotation_rad.into());
        let end = Interface { rotation, origin };
        Linearised { base, chip_turn: left_jacobian(-chip_vector), joints, axes, end, fibre_turn }
    }

    /// The array frame: its orientation and origin (nm) in chip axes.
    pub fn array(&self, machine: &Machine) -> (Matrix3<f64>, Vector3<f64>) {
        (self.end.rotation * exp(machine.mounts.fibre.rotation_rad.into()), self.end.origin)
    }

    /// What the array does when a constant grows, per rad or per nm.
    pub fn constant(&self, constant: Constant, order: &[Axis; AXES]) -> Twist {
        match constant {
            Constant::Static(i) => {
                let mut unit = [0.0; 9];
                unit[i] = 1.0;
                let unit = StaticErrors::from_values(unit);
                for (k, (_, at, jacobian)) in self.joints.iter().enumerate() {
                    let vector = static_vector(&unit, &order[..=k]);
                    if vector != Vector3::zeros() {
                        return Twist::turn(at.rotation * (jacobian * vector), at.origin);
                    }
                }
                unreachable!("every static error has its joint")
            }
            Constant::Offset(axis, c) => {
                let joint = self.joints.iter().find(|joint| joint.0 == axis).expect("six axes");
                Twist::shift(joint.1.rotation.column(c).into())
            }
            Constant::FibreOffset(c) => Twist::shift(self.end.rotation.column(c).into()),
            Constant::FibreRotation(c) => Twist::turn(self.end.rotation * self.fibre_turn.column(c), self.end.origin),
            Constant::ChipOffset(c) => Twist::shift(-self.base.column(c)),
            Constant::ChipRotation(c) => Twist::turn(-self.chip_turn.column(c), Vector3::zeros()),
        }
    }

    /// What the array does when an actuator moves, per nm or per nrad.
    pub fn actuator(&self, axis: Axis) -> Twist {
        let (along, point) = self.axes[axis.index()];
        if axis.is_rotary() { Twist::turn(along * 1e-9, point) } else { Twist::shift(along) }
    }

    /// Direction of an axis, a unit vector in chip axes.
    pub fn direction(&self, axis: Axis) -> Vector3<f64> {
        self.axes[axis.index()].0
    }

    /// How the direction of an axis turns when a constant grows: not at all when that is put in behind it.
    pub fn turns_axis(&self, constant: Constant, axis: Axis, order: &[Axis; AXES]) -> Vector3<f64> {
        let place = |axis: Axis| order.iter().position(|a| *a == axis).expect("six axes");
        let applies = match constant {
            Constant::Static(i) => {
                let mut unit = [0.0; 9];
                unit[i] = 1.0;
                let unit = StaticErrors::from_values(unit);
                (0..=place(axis)).any(|k| static_vector(&unit, &order[..=k]) != Vector3::zeros())
            }
            Constant::ChipRotation(_) => true,
            _ => false,
        };
        if applies { self.constant(constant, order).turn } else { Vector3::zeros() }
    }

    /// The frames of the eight interfaces between adjacent bodies: base-chip, base-first stage, ..., last stage-array.
    pub fn interfaces(&self) -> [Interface; 8] {
        let chip = Interface { rotation: self.base, origin: Vector3::zeros() };
        std::array::from_fn(|k| match k {
            0 => chip,
            7 => self.end,
            _ => self.joints[k - 1].1,
        })
    }
}
