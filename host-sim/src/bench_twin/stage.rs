//! The true stages of a bench: a nominal machine with errors that nobody has told the controller.

use super::random::Chance;
use crate::identify::Constant;
use crate::machine::{ErrorName, Function, Kinematic, Machine, StaticErrors};
use stage_controller::units::{AXES, Axis};
use std::f64::consts::{PI, TAU};

const NRAD_PER_DEG: f64 = PI / 180.0 * 1e9;

/// How large the errors of a stage are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageErrors {
    /// Each of the nine static angles lies within plus and minus this, rad.
    pub static_rad: f64,
    /// Standard deviation of the three distances between rotary axes and of the places of chip and fibre array in each
    /// direction, um.
    pub offset_sigma_um: f64,
    /// The mounts of chip and fibre array are turned by up to this about each axis, rad.
    pub mount_rad: f64,
    /// Bound of a kinematic displacement over the travel, um.
    pub kinematic_um: f64,
    /// Bound of a kinematic rotation over the travel, rad.
    pub kinematic_rad: f64,
    /// Largest amplitude of the periodic error of a screw, nm.
    pub screw_nm: f64,
    /// Its period: the lead of the screw, um.
    pub screw_lead_um: f64,
    /// True play against that of the nominal machine: uniform within plus and minus this share.
    pub play_spread: f64,
}

impl Default for StageErrors {
    /// 50 urad, 200 um, 1 mrad, 0.3 um and 50 urad, 50 nm on 500 um; the play is that of the nominal machine.
    fn default() -> Self {
        StageErrors {
            static_rad: 50e-6,
            offset_sigma_um: 200.0,
            mount_rad: 1e-3,
            kinematic_um: 0.3,
            kinematic_rad: 50e-6,
            screw_nm: 50.0,
            screw_lead_um: 500.0,
            play_spread: 0.0,
        }
    }
}

/// A stage of the make of `nominal` with its own errors: the 24 constants, the 36 kinematic errors, play.
///
/// What `nominal` says of the constants, kinematic errors and mounts is dropped. Every kinematic error is a harmonic of
/// the position, a (sin(2 pi q / p + f) - sin f) / 2 with a uniform up to its bound, p from once to four times the
/// reach of the travel and any f: zero at home. The positioning errors of the linear stages have the harmonic of their
/// screw on top.
pub(super) fn true_stage(nominal: &Machine, sizes: &StageErrors, chance: &mut Chance) -> Machine {
    let mut machine = crate::measure::nominal(nominal);
    machine.statics = StaticErrors::from_values([0.0; 9].map(|_| chance.within(sizes.static_rad)));
    for constant in Constant::all(&machine.order).into_iter().skip(StaticErrors::NAMES.len()) {
        let value = if constant.is_angle() {
            chance.within(sizes.mount_rad)
        } else {
            1e3 * sizes.offset_sigma_um * chance.normal()
        };
        constant.set(&mut machine, value);
    }
    machine.kinematic = kinematic(&machine, sizes, chance);
    for (drive, nominal) in machine.drives.iter_mut().zip(&nominal.drives) {
        drive.backlash = nominal.backlash * (1.0 + chance.within(sizes.play_spread));
    }
    machine
}

fn kinematic(machine: &Machine, sizes: &StageErrors, chance: &mut Chance) -> Kinematic {
    let mut kinematic = Kinematic::default();
    let reach: [f64; AXES] = std::array::from_fn(|i| {
        let unit = if Axis::ALL[i].is_rotary() { NRAD_PER_DEG } else { 1e3 };
        machine.drives[i].travel.iter().fold(0.0_f64, |reach, end| reach.max(end.abs())) / unit
    });
    for name in ErrorName::all() {
        let bound = if name.component.is_angular() { sizes.kinematic_rad } else { sizes.kinematic_um };
        let amplitude = 0.5 * bound * chance.between([0.0, 1.0]);
        let period = reach[name.axis.index()] * chance.between([1.0, 4.0]);
        let mut harmonics = vec![harmonic(amplitude, period, chance)];
        if !name.axis.is_rotary() && name.component as usize == name.axis.index() {
            let amplitude = 1e-3 * sizes.screw_nm * chance.between([0.0, 1.0]);
            harmonics.push(harmonic(amplitude, sizes.screw_lead_um, chance));
        }
        let home: f64 = harmonics.iter().map(|[_, cos, _]| cos).sum();
        let function = Function::new(vec![-home], vec![], harmonics).expect("travel and lead are positive");
        kinematic.set(name, function);
    }
    kinematic
}

/// Period, cosine and sine of a harmonic of any phase.
fn harmonic(amplitude: f64, period: f64, chance: &mut Chance) -> [f64; 3] {
    let (sin, cos) = chance.between([0.0, TAU]).sin_cos();
    [period, amplitude * sin, amplitude * cos]
}
