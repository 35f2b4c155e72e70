//! The alignment, step by step: first light, peaks, angles with the pivot held, roll, gap, and the last peaks.
//!
//! # Design
//! Everything goes through messages of the two controllers and the switch before the meter; nothing is known of the
//! bench but the data sheets of fibre and chip ([`Optics`]). The stages first draw back: angles are turned where no
//! corner can reach the chip. How far the faces are apart is told by how the light falls on the way back, and the last
//! approach goes no farther than that allows.

use super::bus::{Bus, BusError, Controller};
use super::geometry::{Optics, Peak, best_for_all};
use super::probe::Knob;
use super::scans::{End, Found, Scan};
use crate::bench_twin::{Sees, Side};
use serde::Serialize;
use stage_controller::units::Axis;

/// What may be chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Data sheets.
    pub optics: Optics,
    /// How far the first light is looked for on each side, um.
    pub search_um: f64,
    /// Level that counts as light, dBm.
    pub light_dbm: f64,
    /// How far the stages draw back before anything turns, um.
    pub retreat_um: f64,
    /// Gap that is wanted between the faces, um.
    pub gap_um: f64,
    /// Half of the way over which angles are probed, degrees.
    pub angle_deg: f64,
    /// There is a large-area detector behind the chip: the input is brought to its light first, alone.
    pub detector: bool,
    /// What is sent to each controller first: its compensation, its inputs.
    pub setup: Vec<String>,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            optics: Optics::default(),
            search_um: 13.0,
            light_dbm: -52.0,
            retreat_um: 60.0,
            gap_um: 12.5,
            angle_deg: 0.35,
            detector: false,
            setup: ["SENS1:INP LOG,20,-60", "SENS2:INP LOG,20,-60", "SENS1:DEL 0.000036", "SENS2:DEL 0.000036"]
                .map(String::from)
                .to_vec(),
        }
    }
}

impl Options {
    /// For a start that is farther off, with a large-area detector behind the chip.
    pub fn with_detector() -> Self {
        Options { search_um: 36.0, detector: true, ..Options::default() }
    }
}

/// A step that has ended.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// What it was.
    pub name: String,
    /// When it ended, s from the beginning.
    pub seconds: f64,
    /// The light after it, dBm, where it tells.
    pub level_dbm: Option<f64>,
}

/// What an alignment has given.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Alignment {
    /// Level of every channel in the end, dBm.
    pub levels_dbm: Vec<f64>,
    /// How long it took, s.
    pub seconds: f64,
    /// Its steps.
    pub steps: Vec<Step>,
}

/// Aligns. `watch` is told of every step that has ended.
///
/// # Errors
/// Those of the bus: no light, a dead channel, a limit, a lost link, a collision.
pub fn align<B: Bus>(bus: &mut B, options: &Options, watch: &mut dyn FnMut(&Step)) -> Result<Alignment, BusError> {
    let began = bus.seconds();
    let mut program = Program::new(bus, options, watch);
    program.run()?;
    let levels_dbm = program.channels()?;
    let seconds = program.bus.seconds() - began;
    Ok(Alignment { levels_dbm, seconds, steps: program.steps })
}

/// Samples of a mean at rest, of 256 us.
const CALM_AVERAGE: usize = 32;
/// Time of such a mean with the meter in front of it, s.
const CALM_S: f64 = 0.01;
/// Way to either side of a probe in x and y, um.
const PROBE_UM: f64 = 1.5;
/// Retreats at which the light tells the gap, um.
const RETREATS_UM: [f64; 4] = [0.0, 40.0, 80.0, 140.0];

pub(super) struct Program<'a, B> {
    pub bus: &'a mut B,
    pub options: &'a Options,
    began: f64,
    steps: Vec<Step>,
    watch: &'a mut dyn FnMut(&Step),
}

impl<'a, B: Bus> Program<'a, B> {
    pub(super) fn new(bus: &'a mut B, options: &'a Options, watch: &'a mut dyn FnMut(&Step)) -> Self {
        let began = bus.seconds();
        Program { bus, options, began, steps: Vec::new(), watch }
    }

    pub(super) fn at(&mut self, side: Side) -> Controller<'_, B> {
        Controller::new(self.bus, side)
    }

    pub(super) fn done(&mut self, name: impl Into<String>, level_dbm: Option<f64>) {
        let step = Step { name: name.into(), seconds: self.bus.seconds() - self.began, level_dbm };
        (self.watch)(&step);
        self.steps.push(step);
    }

    /// Light, far enough from the chip to turn.
    pub(super) fn draw_back(&mut self) -> Result<(), BusError> {
        for side in Side::BOTH {
            let setup = self.options.setup.join(";:");
            self.at(side).run(&setup, 1.0)?;
        }
        self.first_light()?;
        let back = [0.0, 0.0, -self.options.retreat_um, 0.0, 0.0, 0.0];
        self.move_both([back; 2])?;
        self.average(CALM_AVERAGE)?;
        self.peaks("peaks after drawing back")
    }

    fn run(&mut self) -> Result<(), BusError> {
        self.draw_back()?;
        self.angles()?;
        self.roll()?;
        for side in Side::BOTH.into_iter().rev() {
            self.gap(side)?;
        }
        self.peaks("peaks at the gap")?;
        self.balance()?;
        let knobs = [Axis::X, Axis::Y].map(|axis| Knob { side: Side::Input, axis });
        let level = self.turn_to_peak(knobs, PROBE_UM)?[0];
        self.done("last peak of the input", Some(level));
        Ok(())
    }

    /// Samples of a mean.
    fn average(&mut self, samples: usize) -> Result<(), BusError> {
        for side in Side::BOTH {
            self.at(side).run(&format!("SENS1:AVER {samples};:SENS2:AVER {samples}"), 1.0)?;
        }
        Ok(())
    }

    /// Moves both stages by so much at once, um and degrees.
    pub(super) fn move_both(&mut self, by: [[f64; 6]; 2]) -> Result<(), BusError> {
        for side in Side::BOTH {
            self.at(side).begin_move(by[side.index()])?;
        }
        for side in Side::BOTH {
            self.at(side).end_move(by[side.index()])?;
        }
        Ok(())
    }

    /// Both power inputs where the stages stand now, dBm.
    pub(super) fn calm_powers(&mut self) -> Result<[f64; 2], BusError> {
        let mut controller = self.at(Side::Output);
        controller.pause(CALM_S)?;
        controller.powers()
    }

    fn line(&mut self, side: Side, channel: usize, axis: Axis, range: f64, end: End) -> Result<Found, BusError> {
        let threshold_dbm = self.options.light_dbm;
        self.at(side).scan(&Scan::Line { channel, axis, range, pitch: 0.2, threshold_dbm, end })
    }

    /// x and y of a side by the first channel, wherever in the range it is.
    fn lines(&mut self, side: Side) -> Result<f64, BusError> {
        let range = 2.0 * self.options.search_um;
        self.line(side, 1, Axis::X, range, End::Peak)?;
        Ok(self.line(side, 1, Axis::Y, range, End::Peak)?.level_dbm)
    }

    /// x and y of both sides by the first channel, from near.
    pub(super) fn peaks(&mut self, name: &str) -> Result<(), BusError> {
        let mut level = 0.0;
        for axis in [Axis::X, Axis::Y] {
            level = self.turn_to_peak(Side::BOTH.map(|side| Knob { side, axis }), PROBE_UM)?[0];
        }
        self.done(name, Some(level));
        Ok(())
    }

    fn first_light(&mut self) -> Result<(), BusError> {
        if self.options.detector {
            self.bus.look(0, Sees::Detector);
            self.light_of(&[Side::Input])?;
            self.lines(Side::Input)?;
            self.bus.look(0, Sees::Fibre(0));
            self.light_of(&[Side::Output])?;
            self.lines(Side::Output)?;
        } else {
            self.light_of(&[Side::Output, Side::Input])?;
            self.lines(Side::Output)?;
            self.lines(Side::Input)?;
        }
        Ok(())
    }

    /// Looks for light: here, and if there is none in spirals of these sides, one after the other.
    fn light_of(&mut self, searched: &[Side]) -> Result<(), BusError> {
        let (light_dbm, range) = (self.options.light_dbm, 2.0 * self.options.search_um);
        let level = self.calm_powers()?[0];
        if level >= light_dbm {
            self.done("first light: there is some", Some(level));
            return Ok(());
        }
        let spiral = Scan::FirstLight { channel: 1, range, step: 8.0, pitch: 0.4, threshold_dbm: light_dbm };
        let mut refused = None;
        for side in searched {
            match self.at(*side).scan(&spiral) {
                Ok(found) => {
                    self.done("first light: spiral", Some(found.level_dbm));
                    return Ok(());
                }
                Err(error @ BusError::Refused { .. }) => refused = Some(error),
                Err(error) => return Err(error),
            }
        }
        refused.map_or(Ok(()), Err)
    }

    /// Pitch and yaw of both sides with the pivots held.
    pub(super) fn angles(&mut self) -> Result<(), BusError> {
        let mut level = 0.0;
        for axis in [Axis::Alpha, Axis::Beta] {
            let knobs = Side::BOTH.map(|side| Knob { side, axis });
            level = self.turn_to_peak(knobs, self.options.angle_deg)?[0];
        }
        self.done("pitch and yaw", Some(level));
        Ok(())
    }

    /// Peaks in x and y, and the roll of the array from its first and last channel.
    fn roll(&mut self) -> Result<(), BusError> {
        let optics = self.options.optics;
        let span = optics.channel_um(optics.channels - 1);
        self.turn_to_peak(Side::BOTH.map(|side| Knob { side, axis: Axis::X }), PROBE_UM)?;
        let probe = self.probe(Side::BOTH.map(|side| Knob { side, axis: Axis::Y }), PROBE_UM)?;
        let [first, last] = [0, 1].map(|input| probe.peaks[input]);
        let first = first.ok_or_else(|| self.no_peak(&probe))?;
        let last = last.ok_or_else(|| self.no_peak(&probe))?;
        let roll_rad = (last[1] - first[1]) / span;
        let mut by = probe.back();
        by[0][1] += first[0];
        by[1][1] += first[1];
        by[1][5] += roll_rad.to_degrees();
        self.move_both(by)?;
        self.done("roll by the first and the last channel", Some(probe.levels_dbm[0]));
        Ok(())
    }

    /// Along the axis of the guides, as the angles say how it lies.
    fn along(&mut self, side: Side, way_um: f64) -> Result<(), BusError> {
        let pose = self.at(side).pose()?;
        let (alpha, beta) = (pose[3].to_radians(), pose[4].to_radians());
        self.at(side).move_by([way_um * beta, -way_um * alpha, way_um, 0.0, 0.0, 0.0])
    }

    /// Finds how far the faces are apart, and goes as near as is wanted.
    fn gap(&mut self, side: Side) -> Result<(), BusError> {
        let gap = self.measure_gap(side)?;
        self.along(side, gap - self.options.gap_um)?;
        self.done(format!("{side:?} side: {gap:.1} um were left, now {:.1}", self.options.gap_um), None);
        Ok(())
    }

    /// The gap here, um, told by how the light falls on the way back.
    pub(super) fn measure_gap(&mut self, side: Side) -> Result<f64, BusError> {
        let mut seen = Vec::new();
        let mut back = 0.0;
        for retreat in RETREATS_UM {
            self.along(side, back - retreat)?;
            back = retreat;
            seen.push((retreat, self.calm_powers()?[0]));
        }
        self.along(side, back)?;
        let falls = "light that falls with the distance";
        let gap = self.options.optics.gap_um(&seen);
        gap.ok_or_else(|| self.at(side).strange("SENS1:POW?", &format!("{seen:?}"), falls))
    }

    /// Levels of all channels here.
    fn channels(&mut self) -> Result<Vec<f64>, BusError> {
        let channels = self.options.optics.channels;
        let mut levels = vec![f64::NEG_INFINITY; channels];
        for pair in 0..channels.div_ceil(2) {
            let both = [2 * pair, (2 * pair + 1).min(channels - 1)];
            for (input, channel) in both.into_iter().enumerate() {
                self.bus.look(input, Sees::Fibre(channel));
            }
            let powers = self.calm_powers()?;
            both.into_iter().zip(powers).for_each(|(channel, level)| levels[channel] = level);
        }
        self.bus.look(0, Sees::Fibre(0));
        self.bus.look(1, Sees::Fibre(channels - 1));
        Ok(levels)
    }

    /// Puts the array where the weakest channel has most light.
    fn balance(&mut self) -> Result<(), BusError> {
        let stations = [[0.0, 0.0], [-PROBE_UM, 0.0], [PROBE_UM, 0.0], [0.0, -PROBE_UM], [0.0, PROBE_UM]];
        let mut seen = Vec::new();
        let mut here = [0.0; 2];
        for there in stations {
            self.shift(there[0] - here[0], there[1] - here[1], 0.0)?;
            here = there;
            seen.push(self.channels()?);
        }
        let peaks: Option<Vec<Peak>> = (0..self.options.optics.channels)
            .map(|i| Peak::of_star(std::array::from_fn(|k| seen[k][i]), PROBE_UM))
            .collect();
        let Some(peaks) = peaks else {
            return Err(self.at(Side::Output).strange("SENS1:POW?", &format!("{seen:?}"), "a peak in every channel"));
        };
        let best = best_for_all(&self.options.optics, &peaks);
        self.shift(best.x_um - here[0], best.y_um - here[1], best.roll_rad)?;
        self.done("array balanced over all channels", None);
        Ok(())
    }

    fn shift(&mut self, x_um: f64, y_um: f64, roll_rad: f64) -> Result<(), BusError> {
        self.at(Side::Output).move_by([x_um, y_um, 0.0, 0.0, 0.0, roll_rad.to_degrees()])
    }
}
