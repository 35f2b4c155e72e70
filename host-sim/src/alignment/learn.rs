//! What light alone tells of a stage: the play of its linear motors and where its rotation centres are.
//!
//! # Method
//! Play: the same peak is found with all points come to upwards, then downwards, with the compensation of backlash off;
//! the motor stands by the play apart. It is the counterpart of the reversal value of ISO 230-2, with the chip as the
//! ruler. Centre: the pivot is held by what the controller believes; a turn then moves the fibre by the turn times the
//! error of the lever, and the peak goes along. Turns are come to upwards both times. A fibre that is turned about its end
//! meets the guide's beam a little aside ([`Optics::lean_um`](super::Optics::lean_um)), which is taken off.
//!
//! What a turn does along the axis of the light is not looked at: alpha and beta tell the lever in z, gamma those in x
//! and y.

use super::bus::{Bus, BusError};
use super::program::{Options, Program, Step};
use super::scans::{End, Flank, Scan};
use super::trouble::Trouble;
use crate::bench_twin::Side;
use crate::machine::Machine;
use crate::session::block_of;
use stage_controller::units::Axis;

/// Points of a peak, and the way over which they lie, um.
const POINTS: usize = 15;
const RANGE_UM: f64 = 10.0;
/// Half of the turn by which a centre is told, degrees.
const TURN_DEG: f64 = 0.3;
/// Before a turn is come to upwards, so far below, degrees: more than any play.
const BELOW_DEG: f64 = 0.03;
/// The linear axes across the light.
const ACROSS: [Axis; 2] = [Axis::X, Axis::Y];

/// A value with its standard uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Told {
    /// um.
    pub value_um: f64,
    /// um.
    pub sigma_um: f64,
}

/// What light has told of one stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learned {
    /// Play of X and Y.
    pub backlash: [Told; 2],
    /// By how much the fibre point is farther from the axis of alpha in z than was believed.
    pub alpha_z: Told,
    /// The same of beta.
    pub beta_z: Told,
    /// The same of gamma, in x and y.
    pub gamma: [Told; 2],
}

impl Learned {
    /// The machine as it is known now.
    pub fn applied(&self, believed: &Machine) -> Machine {
        let mut machine = believed.clone();
        for (axis, told) in ACROSS.into_iter().zip(self.backlash) {
            machine.drives[axis.index()].backlash = told.value_um.max(0.0) * 1e3;
        }
        let fibre = &mut machine.mounts.fibre.offset_nm;
        fibre[0] += self.gamma[0].value_um * 1e3;
        fibre[1] += self.gamma[1].value_um * 1e3;
        fibre[2] += self.alpha_z.value_um * 1e3;
        // beta carries alpha, whose offset takes what both differ by
        machine.axis_offset_nm[Axis::Alpha.index()][2] += (self.beta_z.value_um - self.alpha_z.value_um) * 1e3;
        machine
    }
}

/// Rounds: while a lever is half a millimetre wrong, the angles at which a stage works mix its components by some um.
const ROUNDS: usize = 2;

/// Finds light, draws back, learns both stages, and loads what was learned into their controllers. `believed` is what these
/// know now; what they know then comes back, with what the last round has told.
///
/// # Errors
/// Those of the bus; a stage that no calibration can describe.
pub fn learn<B: Bus>(
    bus: &mut B,
    options: &Options,
    believed: &[Machine; 2],
    watch: &mut dyn FnMut(&Step),
) -> Result<[(Machine, Learned); 2], Trouble> {
    let mut program = Program::new(bus, options, watch);
    program.draw_back()?;
    program.angles(false)?;
    program.peaks("peaks after turning")?;
    let mut learn = |side: Side| -> Result<(Machine, Learned), Trouble> {
        let mut known = believed[side.index()].clone();
        let mut round = || -> Result<Learned, Trouble> {
            let learned = program.learn(side)?;
            known = learned.applied(&known);
            let block = block_of(&known).map_err(|reason| BusError::Calibration { side, reason })?;
            program.at(side).load(&block)?;
            Ok(learned)
        };
        (1..ROUNDS).try_for_each(|_| round().map(drop))?;
        let learned = round()?;
        Ok((known, learned))
    };
    Ok([learn(Side::Input)?, learn(Side::Output)?])
}

impl<B: Bus> Program<'_, B> {
    fn learn(&mut self, side: Side) -> Result<Learned, Trouble> {
        let gap_um = self.fall(side)?.gap_um;
        let backlash = [self.backlash(side, Axis::X)?, self.backlash(side, Axis::Y)?];
        self.done(format!("{side:?} side: play of X and Y"), None);
        let lean_um = self.options.optics.lean_um(gap_um);
        // the end of the fibre moves by turn x error; the peak goes the other way
        let [_, y] = self.turned(side, Axis::Alpha)?;
        let [x, _] = self.turned(side, Axis::Beta)?;
        let [about_z_x, about_z_y] = self.turned(side, Axis::Gamma)?;
        self.done(format!("{side:?} side: rotation centre"), None);
        let told = |told: Told, sign: f64, lean_um: f64| Told { value_um: sign * told.value_um - lean_um, ..told };
        Ok(Learned {
            backlash,
            alpha_z: told(y, 1.0, lean_um),
            beta_z: told(x, -1.0, lean_um),
            gamma: [told(about_z_y, -1.0, 0.0), told(about_z_x, 1.0, 0.0)],
        })
    }

    /// Where the light has its peak along an axis, um of the axis, and how well that is known.
    fn peak_along(&mut self, side: Side, axis: Axis, flank: Flank) -> Result<Told, Trouble> {
        let threshold_dbm = self.options.light_dbm;
        let end = End::Start;
        let scan = Scan::Parabola { channel: 1, axis, range: RANGE_UM, points: POINTS, threshold_dbm, end, flank };
        let place = self.at(side).scan(&scan)?.axes[0];
        Ok(Told { value_um: place.peak, sigma_um: place.sigma.unwrap_or(0.0) })
    }

    fn backlash(&mut self, side: Side, axis: Axis) -> Result<Told, Trouble> {
        self.at(side).run("COMP:BACK:STAT OFF", 1.0)?;
        let peaks = [Flank::Positive, Flank::Negative].map(|flank| self.peak_along(side, axis, flank));
        self.at(side).run("COMP:BACK:STAT ON", 1.0)?;
        let [up, down] = peaks;
        let (up, down) = (up?, down?);
        Ok(Told { value_um: up.value_um - down.value_um, sigma_um: up.sigma_um.hypot(down.sigma_um) })
    }

    /// How far the peaks in x and y go for each radian of a turn.
    fn turned(&mut self, side: Side, axis: Axis) -> Result<[Told; 2], Trouble> {
        let by = |degrees: f64| {
            let mut by = [0.0; 6];
            by[axis.index()] = degrees;
            by
        };
        let mut peaks = [[Told { value_um: 0.0, sigma_um: 0.0 }; 2]; 2];
        self.at(side).move_by(by(-TURN_DEG - BELOW_DEG))?;
        for (peaks, way) in peaks.iter_mut().zip([BELOW_DEG, 2.0 * TURN_DEG]) {
            self.at(side).move_by(by(way))?;
            for (peak, axis) in peaks.iter_mut().zip(ACROSS) {
                *peak = self.peak_along(side, axis, Flank::Positive)?;
            }
        }
        self.at(side).move_by(by(-TURN_DEG))?;
        let turn_rad = (2.0 * TURN_DEG).to_radians();
        let [before, after] = peaks;
        Ok(std::array::from_fn(|i| Told {
            value_um: (after[i].value_um - before[i].value_um) / turn_rad,
            sigma_um: after[i].sigma_um.hypot(before[i].sigma_um) / turn_rad,
        }))
    }
}
