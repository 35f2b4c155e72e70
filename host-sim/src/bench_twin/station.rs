//! One side of the bench: a true stage, the array on it and the chip before it.

use super::port::{Parts, Place, Port};
use super::random::Chance;
use super::settling::Settling;
use super::{Options, Side, stage};
use crate::machine::Machine;
use crate::model::{Euler, Truth};
use crate::optics::{Adc, Array, Pair};
use nalgebra::Vector3;

/// Ticks of 1 us in a minute.
const TICKS_PER_MINUTE: f64 = 60e6;

/// One side as it moves.
#[derive(Clone, Debug)]
pub(super) struct Station {
    pub machine: Machine,
    pub port: Port,
    pub settling: Settling,
    /// um per tick.
    pub drift: Vector3<f64>,
    /// As seen last.
    pub place: Place,
    pub clearance_um: f64,
    /// Inputs of this side's board.
    pub adc: [Adc; 2],
}

impl Station {
    /// Where its array is at a tick and a true pose (nm, nrad).
    pub fn place(&self, tick: u64, pose: &[f64; 6]) -> Place {
        self.port.place(pose, self.drift * tick as f64)
    }

    /// A true stage before its side of the chip, at home.
    pub fn draw(side: Side, (array, pair): (Array, Pair), options: &Options, chance: &mut Chance) -> Self {
        let machine = stage::true_stage(&options.drawing, &options.stage, chance);
        let truth = Truth::new(&machine);
        let start = options.start;
        let port = Port::new(Parts {
            euler: Euler::new(&machine.order),
            home: truth.place([0.0; 6]).0,
            offset_um: [0; 2].map(|_| chance.within(start.lateral_um)),
            angles_rad: [start.angle_deg, start.angle_deg, start.roll_deg]
                .map(|reach| chance.within(reach.to_radians())),
            clearance_um: chance.between(start.clearance_um),
            face: options.faces[side.index()],
            pair,
            array,
            pitch_um: options.splitter.pitch_um,
        });
        let direction = loop {
            let direction = Vector3::from_fn(|_, _| chance.normal());
            if direction.norm() > 1e-3 {
                break direction.normalize();
            }
        };
        let adc = [0; 2].map(|_| Adc { noise_lsb: options.adc_noise_lsb, source: chance.bits() });
        let drift = direction * (options.drift_um_per_min / TICKS_PER_MINUTE);
        let place = port.place(&[0.0; 6], Vector3::zeros());
        let clearance_um = port.clearance(&place);
        Station { machine, port, settling: Settling::default(), drift, place, clearance_um, adc }
    }
}
