//! The controller's law in f64: W⁻¹ and the second-order term, the pivot, D⁻¹ (docs/LAW.md 2).

use super::second_order::{SecondOrder, products};
use crate::machine::Machine;
use crate::model::{Chain, Screw, exp};
use nalgebra::{Matrix3, Vector3};
use stage_controller::compensation::calibration::Calibration;
use stage_controller::units::AXES;

/// The law with its coefficients either as computed or as the block holds them.
#[derive(Clone, Debug, PartialEq)]
pub struct Law {
    /// D⁻¹.
    pub inverse_slides: Matrix3<f64>,
    /// W⁻¹.
    pub inverse_axes: Matrix3<f64>,
    /// Second-order term per rad.
    pub second_order: SecondOrder,
    /// Gains of the rotary motors; 1 but for rounding.
    pub rotary_gain: [f64; 3],
    /// Rotary axes from tip to base; lengths in nm.
    pub screws: [Screw; 3],
    /// The fibre point at home, nm.
    pub fibre_home: Vector3<f64>,
}

impl Law {
    /// The law of a machine, unrounded. The point of each screw is the one nearest to F at home, which
    /// keeps the numbers of the rotation-centre law as small as the lever.
    pub fn new(
        machine: &Machine,
        chain: &Chain,
        inverse_slides: Matrix3<f64>,
        inverse_axes: Matrix3<f64>,
        second_order: SecondOrder,
    ) -> Self {
        let fibre_home = chain.fibre_home();
        let screws = chain.screws();
        let tip_to_base = [machine.order[5], machine.order[4], machine.order[3]];
        let screws = tip_to_base.map(|axis| {
            let screw = screws[axis.index() - 3];
            Screw { point: screw.nearest(fibre_home), ..screw }
        });
        Law { inverse_slides, inverse_axes, second_order, rotary_gain: [1.0; 3], screws, fibre_home }
    }

    /// The law as a block holds it. `steps`: true step sizes in nm and nrad.
    pub fn of_block(block: &Calibration, steps: [f64; AXES]) -> Self {
        let folded =
            |motor: usize, c: i32| f64::from(c) * steps[motor] / 2f64.powi(i32::from(block.motors[motor].row_bits));
        let vector = |v: [i32; 3], unit: f64| Vector3::from(v.map(|c| f64::from(c) * unit));
        let unit_q30 = 2f64.powi(-30);
        let rotation = Matrix3::from_fn(|i, j| f64::from(block.home_rotation[i][j]) * unit_q30);
        Law {
            inverse_slides: Matrix3::from_fn(|i, j| folded(i, block.inverse_slides[i][j])),
            inverse_axes: Matrix3::from_fn(|i, j| {
                f64::from(block.tilt[i][j]) * 2f64.powi(-32) + f64::from(u8::from(i == j))
            }),
            second_order: SecondOrder::from_fn(|i, j| f64::from(block.second_order[i][j]) * 1e9 * 2f64.powi(-60)),
            rotary_gain: std::array::from_fn(|i| folded(i + 3, block.rotary_gain[i])),
            screws: block.screws.map(|s| Screw {
                axis: s.axis,
                direction: vector(s.direction, unit_q30),
                point: vector(s.point, 0.0625),
            }),
            fibre_home: vector(block.home_origin, 0.0625) + rotation * vector(block.fibre_point, 0.0625),
        }
    }

    /// Actuator angles (rad) of logical angles (rad).
    pub fn actuator_angles(&self, logical: [f64; 3]) -> [f64; 3] {
        (self.inverse_axes * Vector3::from(logical) + self.second_order * products(logical)).into()
    }

    /// Displacement of F by the rotary stages alone, nm; actuator angles in rad.
    pub fn pivot(&self, angles: [f64; 3]) -> Vector3<f64> {
        let turn = |v: Vector3<f64>, screw: &Screw| {
            let angle = angles[screw.axis.index() - 3];
            screw.point + exp(screw.direction * angle) * (v - screw.point)
        };
        self.screws.iter().fold(self.fibre_home, turn) - self.fibre_home
    }

    /// Actuators (nm and nrad, before the rounding to steps) of a pose (nm and nrad).
    pub fn actuators(&self, pose: [f64; AXES]) -> [f64; AXES] {
        let [x, y, z, a, b, g] = pose;
        let angles = self.actuator_angles([a * 1e-9, b * 1e-9, g * 1e-9]);
        let q = self.inverse_slides * (Vector3::new(x, y, z) - self.pivot(angles));
        let turned: [f64; 3] = std::array::from_fn(|i| angles[i] * 1e9 * self.rotary_gain[i]);
        [q.x, q.y, q.z, turned[0], turned[1], turned[2]]
    }
}
