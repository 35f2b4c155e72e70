//! The alignment, step by step: first light, peaks, angles with the pivot held, roll, gap, and the last peaks.
//!
//! # Design
//! Everything goes through messages of the two controllers and the switch before the meter; nothing is known of the
//! bench but the data sheets of fibre and chip ([`Optics`]). The stages first draw back: angles are turned where no
//! corner can reach the chip. How far the faces are apart is told by how the light falls on the way back, and the last
//! approach goes no farther than that allows.

use super::bus::{Bus, BusError, Controller};
use super::geometry::{Optics, Peak, best_for_all};
use super::scans::{End, Found, Scan};
use crate::bench_twin::{Sees, Side};
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
    /// How far angles are searched to either side, degrees.
    pub angle_deg: f64,
    /// What is sent to each controller first: its compensation, its inputs.
    pub setup: Vec<String>,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            optics: Optics::default(),
            search_um: 12.0,
            light_dbm: -52.0,
            retreat_um: 60.0,
            gap_um: 11.5,
            angle_deg: 0.5,
            setup: ["SENS1:INP LOG,20,-60", "SENS2:INP LOG,20,-60", "SENS1:DEL 0.000036", "SENS2:DEL 0.000036"]
                .map(String::from)
                .to_vec(),
        }
    }
}

/// A step that has ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// What it was.
    pub name: String,
    /// When it ended, s from the beginning.
    pub seconds: f64,
    /// The light after it, dBm, where it tells.
    pub level_dbm: Option<f64>,
}

/// What an alignment has given.
#[derive(Clone, Debug, PartialEq)]
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
    let mut program = Program { bus, options, began, steps: Vec::new(), watch };
    program.run()?;
    let levels_dbm = program.channels()?;
    let seconds = program.bus.seconds() - began;
    Ok(Alignment { levels_dbm, seconds, steps: program.steps })
}

/// Samples of a mean while scanning at rest and reading, of 256 us.
const CALM_AVERAGE: usize = 32;
/// Time of such a mean with the switch and the meter in front of it, s.
const CALM_S: f64 = 0.01;
/// Way to either side of a star, um.
const STAR_UM: f64 = 1.5;
/// Retreats at which the light tells the gap, um.
const RETREATS_UM: [f64; 4] = [0.0, 40.0, 80.0, 140.0];

struct Program<'a, B> {
    bus: &'a mut B,
    options: &'a Options,
    began: f64,
    steps: Vec<Step>,
    watch: &'a mut dyn FnMut(&Step),
}

impl<B: Bus> Program<'_, B> {
    fn at(&mut self, side: Side) -> Controller<'_, B> {
        Controller::new(self.bus, side)
    }

    fn done(&mut self, name: impl Into<String>, level_dbm: Option<f64>) {
        let step = Step { name: name.into(), seconds: self.bus.seconds() - self.began, level_dbm };
        (self.watch)(&step);
        self.steps.push(step);
    }

    fn run(&mut self) -> Result<(), BusError> {
        for side in Side::BOTH {
            let setup = self.options.setup.join(";:");
            self.at(side).run(&setup, 1.0)?;
        }
        self.first_light()?;
        self.peaks("coarse peaks", 2.0 * self.options.search_um, 0.1)?;
        let back = [0.0, 0.0, -self.options.retreat_um, 0.0, 0.0, 0.0];
        for side in Side::BOTH {
            self.at(side).move_by(back)?;
        }
        self.peaks("peaks after drawing back", 6.0, 0.05)?;
        for side in Side::BOTH.into_iter().rev() {
            self.angles(side)?;
        }
        self.peaks("peaks after turning", 6.0, 0.05)?;
        self.roll()?;
        for side in Side::BOTH.into_iter().rev() {
            self.gap(side)?;
        }
        self.peaks("peaks at the gap", 4.0, 0.05)?;
        self.balance()?;
        self.side_peaks(Side::Input, 3.0, 0.02)?;
        self.done("last peak of the input", None);
        Ok(())
    }

    fn line(
        &mut self,
        side: Side,
        channel: usize,
        axis: Axis,
        range: f64,
        pitch: f64,
        end: End,
    ) -> Result<Found, BusError> {
        let threshold_dbm = self.options.light_dbm;
        let mut controller = self.at(side);
        controller.scan(&Scan::Line { channel, axis, range, pitch, threshold_dbm, end })
    }

    /// x and y of a side by the first channel.
    fn side_peaks(&mut self, side: Side, range: f64, pitch: f64) -> Result<f64, BusError> {
        self.line(side, 1, Axis::X, range, pitch, End::Peak)?;
        Ok(self.line(side, 1, Axis::Y, range, pitch, End::Peak)?.level_dbm)
    }

    /// x and y of both sides.
    fn peaks(&mut self, name: &str, range: f64, pitch: f64) -> Result<(), BusError> {
        self.fast(true)?;
        self.side_peaks(Side::Output, range, pitch)?;
        let level = self.side_peaks(Side::Input, range, pitch)?;
        self.done(name, Some(level));
        Ok(())
    }

    /// Means of one sample, or of many.
    fn fast(&mut self, fast: bool) -> Result<(), BusError> {
        let average = if fast { 1 } else { CALM_AVERAGE };
        for side in Side::BOTH {
            self.at(side).run(&format!("SENS1:AVER {average};:SENS2:AVER {average}"), 1.0)?;
        }
        Ok(())
    }

    fn first_light(&mut self) -> Result<(), BusError> {
        let light_dbm = self.options.light_dbm;
        let level = self.at(Side::Output).powers()?[0];
        if level >= light_dbm {
            self.done("first light: there is some", Some(level));
            return Ok(());
        }
        let range = 2.0 * self.options.search_um;
        let spiral = Scan::FirstLight { channel: 1, range, step: 4.0, pitch: 0.2, threshold_dbm: light_dbm };
        let found = match self.at(Side::Output).scan(&spiral) {
            Err(BusError::Refused { .. }) => self.at(Side::Input).scan(&spiral)?,
            other => other?,
        };
        self.done("first light: spiral", Some(found.level_dbm));
        Ok(())
    }

    /// Pitch and yaw of a side with the pivot held.
    fn angles(&mut self, side: Side) -> Result<(), BusError> {
        self.fast(false)?;
        let mut level = 0.0;
        for axis in [Axis::Alpha, Axis::Beta] {
            let (range, threshold_dbm) = (2.0 * self.options.angle_deg, self.options.light_dbm);
            let scan = Scan::Parabola { channel: 1, axis, range, points: 5, threshold_dbm };
            level = self.at(side).scan(&scan)?.level_dbm;
        }
        self.done(format!("pitch and yaw of the {side:?} side"), Some(level));
        Ok(())
    }

    /// Roll of the array from its first and last channel.
    fn roll(&mut self) -> Result<(), BusError> {
        self.fast(true)?;
        let optics = self.options.optics;
        let span = optics.channel_um(optics.channels - 1);
        for range in [2.0 * self.options.search_um + 10.0, 6.0] {
            let first = self.line(Side::Output, 1, Axis::Y, 6.0, 0.05, End::Peak)?;
            let last = self.line(Side::Output, 2, Axis::Y, range, 0.1, End::Start)?;
            let roll_rad = (last.axes[0].peak - first.axes[0].peak) / span;
            let roll = [0.0, 0.0, 0.0, 0.0, 0.0, roll_rad.to_degrees()];
            self.at(Side::Output).move_by(roll)?;
            self.done("roll by the first and the last channel", Some(last.level_dbm));
        }
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
        self.fast(false)?;
        let mut seen = Vec::new();
        let mut back = 0.0;
        for retreat in RETREATS_UM {
            self.along(side, back - retreat)?;
            back = retreat;
            self.at(side).pause(CALM_S)?;
            seen.push((retreat, self.at(side).powers()?[0]));
        }
        let Some(gap) = self.options.optics.gap_um(&seen) else {
            return Err(self.at(side).strange(
                "SENS1:POW?",
                &format!("{seen:?}"),
                "light that falls with the distance",
            ));
        };
        self.along(side, back + gap - self.options.gap_um)?;
        self.done(format!("{side:?} side: {gap:.1} um were left, now {:.1}", self.options.gap_um), None);
        Ok(())
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
            self.at(Side::Output).pause(CALM_S)?;
            let powers = self.at(Side::Output).powers()?;
            both.into_iter().zip(powers).for_each(|(channel, level)| levels[channel] = level);
        }
        self.bus.look(0, Sees::Fibre(0));
        self.bus.look(1, Sees::Fibre(channels - 1));
        Ok(levels)
    }

    /// Puts the array where the weakest channel has most light.
    fn balance(&mut self) -> Result<(), BusError> {
        self.fast(false)?;
        let stations = [[0.0, 0.0], [-STAR_UM, 0.0], [STAR_UM, 0.0], [0.0, -STAR_UM], [0.0, STAR_UM]];
        let mut seen = Vec::new();
        let mut here = [0.0; 2];
        for there in stations {
            self.shift(there[0] - here[0], there[1] - here[1], 0.0)?;
            here = there;
            seen.push(self.channels()?);
        }
        let peaks: Option<Vec<Peak>> = (0..self.options.optics.channels)
            .map(|i| Peak::of_star(std::array::from_fn(|k| seen[k][i]), STAR_UM))
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
