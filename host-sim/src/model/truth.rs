//! Where the fibre array of a machine truly is: all errors that its file gives, in the units of the controller.

use super::errors::{ErrorModel, Form, Frame, Positions};
use super::rotation::Euler;
use crate::machine::Machine;
use nalgebra::{Matrix3, Vector3};
use stage_controller::units::{AXES, Axis};

/// The stage as it is: static errors, mounts and the 36 kinematic errors. Without the latter the same as the
/// [`Chain`](super::Chain).
#[derive(Clone, Debug)]
pub struct Truth {
    model: ErrorModel,
    home: Frame,
    euler: Euler,
}

impl Truth {
    /// Of a machine file.
    pub fn new(machine: &Machine) -> Self {
        let model = ErrorModel::of(machine);
        let home = model.actual([0.0; AXES], Form::Exact);
        Truth { model, home, euler: Euler::new(&machine.order) }
    }

    fn at(&self, actuators: [f64; AXES]) -> Frame {
        let positions: Positions =
            Axis::ALL.map(|axis| actuators[axis.index()] * if axis.is_rotary() { 1e-9 } else { 1e-3 });
        self.model.actual(positions, Form::Exact)
    }

    fn fibre(&self) -> Vector3<f64> {
        self.model.fibre_point_um.into()
    }

    /// Orientation of the array and the fibre point (nm) in chip axes, for actuators in nm and nrad.
    pub fn place(&self, actuators: [f64; AXES]) -> (Matrix3<f64>, Vector3<f64>) {
        let at = self.at(actuators);
        (at.rotation, at.point(self.fibre()) * 1e3)
    }

    /// Pose of the fibre point in nm and nrad, counted from home, for actuators in nm and nrad.
    pub fn pose(&self, actuators: [f64; AXES]) -> [f64; AXES] {
        let at = self.at(actuators);
        let moved = (at.point(self.fibre()) - self.home.point(self.fibre())) * 1e3;
        let turned = self.euler.decompose(&(at.rotation * self.home.rotation.transpose())).map(|angle| angle * 1e9);
        [moved.x, moved.y, moved.z, turned[0], turned[1], turned[2]]
    }
}
