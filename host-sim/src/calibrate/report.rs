//! How good a calibration is, for people and for programs.

use super::{Fit, Law};
use crate::machine::Machine;
use serde::Serialize;
use stage_controller::compensation::calibration::{BLOCK_CAPACITY, Calibration};
use stage_controller::units::{AXES, Axis};
use std::fmt;

/// Points along each linear and rotary travel at which the rounded law is compared.
const POINTS: usize = 3;

/// What the rounding and the second-order term leave, and what the block could not hold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Name of the machine.
    pub machine: String,
    /// The stages from base to fibre array.
    pub order: [&'static str; AXES],
    /// Worst change of each motor's position over the travel by rounding the coefficients, nm or nrad.
    pub quantisation: [f64; AXES],
    /// Largest rotation between commanded and achieved orientation over the angular travel, urad.
    pub orientation_residual_urad: f64,
    /// The same without the second-order term.
    pub linear_orientation_residual_urad: f64,
    /// Play of each motor in whole steps.
    pub backlash_steps: [u32; AXES],
    /// Play that whole steps leave uncorrected, nm or nrad (true minus corrected).
    pub backlash_remainder: [f64; AXES],
    /// The rotary axis farthest from the fibre point.
    pub lever_axis: &'static str,
    /// Its distance, mm.
    pub lever_mm: f64,
    /// CRC-32 of the block, what `COMP:CRC?` answers.
    pub crc: u32,
}

impl Report {
    pub(super) fn new(machine: &Machine, exact: &Law, block: &Calibration, fit: &Fit, lever: (Axis, f64)) -> Self {
        let mut bytes = [0; BLOCK_CAPACITY];
        let length = block.encode(&mut bytes).expect("a block fits its capacity");
        let steps = block.motors.map(|motor| motor.backlash_steps);
        Report {
            machine: machine.name.clone(),
            order: machine.order.map(Axis::name),
            quantisation: quantisation(machine, exact, block),
            orientation_residual_urad: fit.residual_urad,
            linear_orientation_residual_urad: fit.linear_residual_urad,
            backlash_steps: steps,
            backlash_remainder: std::array::from_fn(|i| {
                machine.drives[i].backlash - f64::from(steps[i]) * machine.drives[i].step
            }),
            lever_axis: lever.0.name(),
            lever_mm: lever.1 * 1e-6,
            crc: Calibration::crc(&bytes[..length]),
        }
    }
}

fn quantisation(machine: &Machine, exact: &Law, block: &Calibration) -> [f64; AXES] {
    let held = Law::of_block(block, machine.drives.map(|drive| drive.step));
    let mut worst = [0.0_f64; AXES];
    for corner in 0..POINTS.pow(AXES as u32) {
        let mut rest = corner;
        let pose = machine.drives.map(|drive| {
            let at = rest % POINTS;
            rest /= POINTS;
            drive.travel[0] + (drive.travel[1] - drive.travel[0]) * at as f64 / (POINTS - 1) as f64
        });
        let (a, b) = (exact.actuators(pose), held.actuators(pose));
        for i in 0..AXES {
            worst[i] = worst[i].max((a[i] - b[i]).abs());
        }
    }
    worst
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "machine {}: {}", self.machine, self.order.join(" -> "))?;
        writeln!(f, "largest lever: {:.3} mm from the {} axis", self.lever_mm, self.lever_axis)?;
        writeln!(
            f,
            "orientation residual over the travel: {:.3} urad (without the second-order term {:.3} urad)",
            self.orientation_residual_urad, self.linear_orientation_residual_urad
        )?;
        writeln!(f, "motor  rounding of coefficients  backlash          left uncorrected")?;
        for axis in Axis::ALL {
            let i = axis.index();
            let unit = if axis.is_rotary() { "nrad" } else { "nm" };
            writeln!(
                f,
                "{:<5}  {:>12.4} {unit:<4}         {:>6} steps      {:>+10.1} {unit}",
                axis.name(),
                self.quantisation[i],
                self.backlash_steps[i],
                self.backlash_remainder[i],
            )?;
        }
        write!(f, "block CRC-32: {} (0x{:08X}), as COMP:CRC? answers it", self.crc, self.crc)
    }
}
