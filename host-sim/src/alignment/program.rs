//! The alignment, step by step: first light, peaks, angles with the pivot held, roll, gap, and the last peaks.
//!
//! # Design
//! Everything goes through messages of the two controllers and the switch before the meter; nothing is known of the
//! bench but the data sheets of fibre and chip ([`Optics`]). The stages first draw back: angles are turned where no
//! corner can reach the chip. How far the faces are apart is told by how the light falls on the way back, and the last
//! approach goes no farther than that allows.

use super::bus::{Bus, BusError, Controller};
use super::geometry::{Fall, Optics, Peak, best_for_all};
use super::probe::Knob;
use super::reading::{CALM_AVERAGE, CALM_S};
use super::scans::{End, Found, Scan};
use super::trouble::{Ended, Trouble};
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
    /// Dark noise of the meter, dBm: what two readings may differ by follows from it.
    pub dark_dbm: f64,
    /// How far the stages draw back before anything turns, um.
    pub retreat_um: f64,
    /// Least distance of any corner of the faces from the chip that is wanted, um.
    pub gap_um: f64,
    /// How far corners are from the first fibre in x and in y, um, on both sides: of the blocks' data sheets.
    pub corner_um: [[f64; 2]; 2],
    /// Half of the way over which angles are probed, degrees.
    pub angle_deg: f64,
    /// Where turns take the fibre aside, so that they tell no angle: pitch and yaw stay as they were found, which may be
    /// off by so much, degrees, and the faces stay so much farther apart. None: it ends there.
    pub untold_deg: Option<f64>,
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
            dark_dbm: -60.0,
            retreat_um: 60.0,
            gap_um: 10.0,
            corner_um: [[900.0, 750.0], [2125.0, 850.0]],
            angle_deg: 0.35,
            untold_deg: None,
            detector: false,
            setup: ["SENS1:INP LOG,20,-60;RANG 2.9;DEL 36 US", "SENS2:INP LOG,20,-60;RANG 2.9;DEL 36 US"]
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
/// No light, a dead channel, too much light, an unsteady one, a limit, a lost link, a collision: with where the stages
/// stand then. docs/BENCH.md has them in a table.
pub fn align<B: Bus>(bus: &mut B, options: &Options, watch: &mut dyn FnMut(&Step)) -> Result<Alignment, Box<Ended>> {
    let mut program = Program::new(bus, options, watch);
    let levels_dbm = program.run().map_err(|trouble| Box::new(program.end(trouble)))?;
    let seconds = program.bus.seconds() - program.began;
    Ok(Alignment { levels_dbm, seconds, steps: program.steps })
}

/// Error of a scan that has found nothing.
const NO_RESULT: &str = "113,";
/// Reason of it which noise can have.
const NO_PEAK: &str = "no maximum";
/// How often a line is tried.
const LINES: usize = 3;
/// Average of a sample of a scan.
const SCAN_AVERAGE: usize = 16;

/// Way to either side of a probe in x and y, um.
const PROBE_UM: f64 = 1.5;
/// Retreats at which the light tells the gap, um.
const RETREATS_UM: [f64; 4] = [0.0, 40.0, 80.0, 140.0];
/// Between the first reading of a gap and the same one afterwards, dB: more, and something else than the gap has changed.
const SAME_DB: f64 = 0.05;
/// What a level of them is uncertain by, dB: noise, and the way aside.
const LEVEL_DB: f64 = 0.002;
/// Standard deviations that are kept from the chip, and that levels may be off the law of the gap.
const DEVIATIONS: f64 = 4.0;
/// Between two measures of a gap beside what they are uncertain by, um: the chip drifts, motors have steps.
const SAME_UM: f64 = 1.0;
/// The reach of the light against that of the data sheets: from thin modes in air to wide ones in glue.
const REACH: [f64; 2] = [0.5, 1.6];
/// Standard uncertainty of an angle at its peak, rad.
const ANGLE_RAD: f64 = 0.25e-3;
/// Farther than it was drawn back, the first fibre is as far from its guide while it turns, um.
const BEGIN_UM: f64 = 30.0;
/// A turn bends the light at most so many times as data sheets say when the fibre stays in its place: radii and index
/// larger by a tenth and a twentieth make 1.33.
const STAYS: f64 = 1.4;
/// Where turns bend it more than so many times, they tell no angle.
const ASTRAY: f64 = 2.0;
/// How often angles are turned when the fibre does not quite stay.
const ROUNDS: usize = 4;
/// Farthest that the array is put from where it stands when it is balanced, um: roll and peaks are right then.
const BALANCE_UM: f64 = 5.0;

pub(super) struct Program<'a, B> {
    pub bus: &'a mut B,
    pub options: &'a Options,
    pub(super) began: f64,
    pub(super) steps: Vec<Step>,
    watch: &'a mut dyn FnMut(&Step),
    /// What both inputs look at.
    pub(super) sees: [Sees; 2],
    /// Z of both stages after they were drawn back, um, since then.
    pub(super) back_um: [Option<f64>; 2],
    /// What pitch and yaw may be off, rad.
    tilt_rad: f64,
}

impl<'a, B: Bus> Program<'a, B> {
    pub(super) fn new(bus: &'a mut B, options: &'a Options, watch: &'a mut dyn FnMut(&Step)) -> Self {
        let (began, sees) = (bus.seconds(), [Sees::Fibre(0), Sees::Fibre(options.optics.channels - 1)]);
        Program {
            bus,
            options,
            began,
            steps: Vec::new(),
            watch,
            sees,
            back_um: [None; 2],
            tilt_rad: DEVIATIONS * ANGLE_RAD,
        }
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
    pub(super) fn draw_back(&mut self) -> Result<(), Trouble> {
        for side in Side::BOTH {
            self.at(side).clear()?;
            for message in &self.options.setup {
                self.at(side).set_up(message)?;
            }
        }
        self.average(SCAN_AVERAGE)?;
        self.look_at_ends();
        self.first_light()?;
        let back = [0.0, 0.0, -self.options.retreat_um, 0.0, 0.0, 0.0];
        self.move_both([back; 2])?;
        for side in Side::BOTH {
            self.back_um[side.index()] = Some(self.at(side).pose()?[2]);
        }
        self.average(CALM_AVERAGE)?;
        self.peaks("peaks after drawing back")
    }

    /// Puts an input before a light.
    fn look(&mut self, input: usize, sees: Sees) {
        self.sees[input] = sees;
        self.bus.look(input, sees);
    }

    /// The first and the last fibre.
    fn look_at_ends(&mut self) {
        self.look(0, Sees::Fibre(0));
        self.look(1, Sees::Fibre(self.options.optics.channels - 1));
    }

    /// All steps; the levels of all channels in the end.
    fn run(&mut self) -> Result<Vec<f64>, Trouble> {
        self.draw_back()?;
        self.pitch_and_yaw()?;
        self.roll()?;
        // a fibre without light is told before anything approaches the chip
        self.channels()?;
        for side in Side::BOTH.into_iter().rev() {
            self.gap(side)?;
        }
        self.peaks("peaks at the gap")?;
        self.balance()?;
        let knobs = [Axis::X, Axis::Y].map(|axis| Knob { side: Side::Input, axis });
        let level = self.turn_to_peak(knobs, PROBE_UM)?;
        self.done("last peak of the input", Some(level));
        self.channels()
    }

    /// Samples of a mean.
    fn average(&mut self, samples: usize) -> Result<(), Trouble> {
        for side in Side::BOTH {
            self.at(side).run(&format!("SENS1:AVER {samples};:SENS2:AVER {samples}"), 1.0)?;
        }
        Ok(())
    }

    /// Moves both stages by so much at once, um and degrees.
    pub(super) fn move_both(&mut self, by: [[f64; 6]; 2]) -> Result<(), Trouble> {
        for side in Side::BOTH {
            self.at(side).begin_move(by[side.index()])?;
        }
        for side in Side::BOTH {
            self.at(side).end_move(by[side.index()])?;
        }
        Ok(())
    }

    /// A line in motion; once more when a burst of noise has left no maximum of it.
    fn line(&mut self, side: Side, channel: usize, axis: Axis, range: f64, end: End) -> Result<Found, Trouble> {
        let threshold_dbm = self.options.light_dbm;
        let line = Scan::Line { channel, axis, range, pitch: 0.2, threshold_dbm, end };
        for _ in 1..LINES {
            match self.at(side).scan(&line) {
                Err(BusError::Refused { error, .. }) if error.starts_with(NO_RESULT) && error.contains(NO_PEAK) => {}
                other => return Ok(other?),
            }
        }
        Ok(self.at(side).scan(&line)?)
    }

    /// x and y of a side by the first channel, wherever in the range it is.
    fn lines(&mut self, side: Side) -> Result<f64, Trouble> {
        let range = 2.0 * self.options.search_um;
        self.line(side, 1, Axis::X, range, End::Peak)?;
        Ok(self.line(side, 1, Axis::Y, range, End::Peak)?.level_dbm)
    }

    /// x and y of both sides by the first channel, from near.
    pub(super) fn peaks(&mut self, name: &str) -> Result<(), Trouble> {
        let mut level = 0.0;
        for axis in [Axis::X, Axis::Y] {
            level = self.turn_to_peak(Side::BOTH.map(|side| Knob { side, axis }), PROBE_UM)?;
        }
        self.done(name, Some(level));
        Ok(())
    }

    fn first_light(&mut self) -> Result<(), Trouble> {
        if self.options.detector {
            self.look(0, Sees::Detector);
            self.light_of(&[Side::Input])?;
            self.lines(Side::Input)?;
            self.look(0, Sees::Fibre(0));
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
    fn light_of(&mut self, searched: &[Side]) -> Result<(), Trouble> {
        let (light_dbm, range) = (self.options.light_dbm, 2.0 * self.options.search_um);
        self.at(Side::Output).pause(CALM_S)?;
        let level = self.at(Side::Output).powers()?[0];
        if level >= light_dbm {
            self.done("first light: there is some", Some(self.lit(0, level)?));
            return Ok(());
        }
        let spiral = Scan::FirstLight { channel: 1, range, step: 8.0, pitch: 0.4, threshold_dbm: light_dbm };
        for side in searched {
            match self.at(*side).scan(&spiral) {
                Ok(found) => {
                    self.done("first light: spiral", Some(found.level_dbm));
                    return Ok(());
                }
                Err(BusError::Refused { error, .. }) if error.starts_with(NO_RESULT) => {}
                Err(error) => return Err(error.into()),
            }
        }
        let (from, searched) = (self.sees[0], searched.to_vec());
        Err(Trouble::Nowhere { from, searched, search_um: self.options.search_um, least_dbm: light_dbm })
    }

    /// Pitch and yaw, or as they were found where turns do not tell them.
    fn pitch_and_yaw(&mut self) -> Result<(), Trouble> {
        let mut found = [[0.0; 6]; 2];
        for side in Side::BOTH {
            found[side.index()] = self.at(side).pose()?;
        }
        let (trouble, untold_deg) = match (self.angles(true), self.options.untold_deg) {
            (
                Err(trouble @ (Trouble::Astray { .. } | Trouble::Dark { .. } | Trouble::NoPeak { .. })),
                Some(untold_deg),
            ) => (trouble, untold_deg),
            (turned, _) => return turned,
        };
        for side in Side::BOTH {
            let pose = self.at(side).pose()?;
            self.at(side).move_by(std::array::from_fn(|i| found[side.index()][i] - pose[i]))?;
        }
        self.tilt_rad = self.tilt_rad.max(untold_deg.to_radians());
        self.done(format!("pitch and yaw stay as they were found: {trouble}"), None);
        self.peaks("peaks where it began to turn")
    }

    /// Pitch and yaw of both sides with the pivots held; where these are not known yet (`centred` is false) as well as it
    /// goes.
    pub(super) fn angles(&mut self, centred: bool) -> Result<(), Trouble> {
        let (optics, step) = (self.options.optics, self.options.angle_deg);
        let gap_um = self.options.retreat_um + BEGIN_UM;
        let bend_db = 2.0 * optics.angle_db(gap_um) * step.to_radians().powi(2);
        for round in 1..=ROUNDS {
            let (mut level, mut most) = (0.0, 0.0_f64);
            for axis in [Axis::Alpha, Axis::Beta] {
                let knobs = Side::BOTH.map(|side| Knob { side, axis });
                let probe = self.turn_past_peak(knobs, step, if centred { optics.overturn(gap_um) } else { 1.0 })?;
                level = probe.level_dbm();
                let times = probe.bend_db(0) / bend_db;
                if centred && times > ASTRAY {
                    return Err(Trouble::Astray { around: format!("{axis:?}").to_lowercase(), times });
                }
                most = most.max(times);
            }
            self.done("pitch and yaw", Some(level));
            if !centred || most < STAYS || round == ROUNDS {
                break;
            }
            // where the fibre goes aside as it turns, its peak is not where it stands straight: that comes by and by
            self.peaks("peaks after turning")?;
        }
        Ok(())
    }

    /// Peaks in x and y, and the roll of the array from its first and last channel.
    fn roll(&mut self) -> Result<(), Trouble> {
        let optics = self.options.optics;
        let span = optics.channel_um(optics.channels - 1);
        self.turn_to_peak(Side::BOTH.map(|side| Knob { side, axis: Axis::X }), PROBE_UM)?;
        let probe = self.probe(Side::BOTH.map(|side| Knob { side, axis: Axis::Y }), PROBE_UM)?;
        let (first, last) = (self.peak(&probe, 0)?, self.peak(&probe, 1)?);
        let roll_rad = (last[1] - first[1]) / span;
        let mut by = probe.back();
        by[0][1] += first[0];
        by[1][1] += first[1];
        by[1][5] += roll_rad.to_degrees();
        self.move_both(by)?;
        self.done("roll by the first and the last channel", Some(probe.level_dbm()));
        Ok(())
    }

    /// Along the axis of the guides, as the angles say how it lies.
    fn along(&mut self, side: Side, way_um: f64) -> Result<(), Trouble> {
        let pose = self.at(side).pose()?;
        let (alpha, beta) = (pose[3].to_radians(), pose[4].to_radians());
        Ok(self.at(side).move_by([way_um * beta, -way_um * alpha, way_um, 0.0, 0.0, 0.0])?)
    }

    /// Goes as near as is wanted: half of the way, and then the rest, each as far as was measured just before.
    fn gap(&mut self, side: Side) -> Result<(), Trouble> {
        let far = self.measure(side)?;
        let ([x, y], tilt_rad) = (self.options.corner_um[side.index()], self.tilt_rad);
        let wanted =
            |fall: &Fall| self.options.gap_um + (x.hypot(y) * tilt_rad).hypot(DEVIATIONS * fall.um_per_db * LEVEL_DB);
        let (left_um, wanted_um) = (far.gap_um, wanted(&far));
        let way = 0.5 * (left_um - wanted_um);
        self.along(side, way)?;
        let near = self.measure(side)?;
        let apart = near.gap_um - (left_um - way);
        if apart.abs() > SAME_UM + DEVIATIONS * (far.um_per_db.hypot(near.um_per_db) * LEVEL_DB) {
            return Err(Trouble::Way { side, way_um: way, gaps_um: [left_um, near.gap_um] });
        }
        let wanted_um = wanted(&near);
        self.along(side, near.gap_um - wanted_um)?;
        self.done(format!("{side:?} side: {left_um:.1} um were left, now {wanted_um:.1}"), None);
        Ok(())
    }

    /// The gap here, on the peak: off it the light falls otherwise, and the gap would be told too wide.
    fn measure(&mut self, side: Side) -> Result<Fall, Trouble> {
        self.turn_to_peak([Axis::X, Axis::Y].map(|axis| Knob { side, axis }), PROBE_UM)?;
        self.fall(side)
    }

    /// How the light of the first input falls on the way back; only when that is as it must be. The stage is where it was
    /// then, and so it is when there was no light.
    pub(super) fn fall(&mut self, side: Side) -> Result<Fall, Trouble> {
        let (mut seen, mut back) = (Vec::new(), 0.0);
        for retreat in RETREATS_UM.into_iter().chain([0.0]) {
            self.along(side, back - retreat)?;
            back = retreat;
            seen.push((retreat, self.calm_powers()?[0]));
        }
        for (_, level) in &seen {
            self.lit(0, *level)?;
        }
        let reach = self.options.optics.reach_um();
        let reason = match Fall::of(&seen) {
            _ if (seen[0].1 - seen[RETREATS_UM.len()].1).abs() > SAME_DB => "it has changed meanwhile",
            Some(fall) if !(REACH[0]..REACH[1]).contains(&(fall.reach_um / reach)) => {
                "it falls as between other modes or in another medium"
            }
            Some(fall) if fall.residual_db < DEVIATIONS * LEVEL_DB => return Ok(fall),
            _ => "it does not fall with the distance as it must",
        };
        Err(Trouble::Gap { side, seen, reason })
    }

    /// Levels of all channels here.
    fn channels(&mut self) -> Result<Vec<f64>, Trouble> {
        let channels = self.options.optics.channels;
        let mut levels = vec![f64::NEG_INFINITY; channels];
        for pair in 0..channels.div_ceil(2) {
            let both = [2 * pair, (2 * pair + 1).min(channels - 1)];
            for (input, channel) in both.into_iter().enumerate() {
                self.look(input, Sees::Fibre(channel));
            }
            let powers = self.calm_powers()?;
            for (input, channel) in both.into_iter().enumerate() {
                levels[channel] = self.lit(input, powers[input])?;
            }
        }
        self.look_at_ends();
        Ok(levels)
    }

    /// Puts the array where the weakest channel has most light.
    fn balance(&mut self) -> Result<(), Trouble> {
        let stations = [[0.0, 0.0], [-PROBE_UM, 0.0], [PROBE_UM, 0.0], [0.0, -PROBE_UM], [0.0, PROBE_UM]];
        let mut seen = Vec::new();
        let mut here = [0.0; 2];
        for there in stations {
            self.shift(there[0] - here[0], there[1] - here[1], 0.0)?;
            here = there;
            seen.push(self.channels()?);
        }
        let peak = |channel: usize| {
            let levels: [f64; 5] = std::array::from_fn(|k| seen[k][channel]);
            let peak = Peak::of_star(levels, PROBE_UM).filter(|peak| peak.x_um.hypot(peak.y_um) < BALANCE_UM);
            peak.ok_or_else(|| Trouble::NoPeak {
                from: Sees::Fibre(channel),
                around: "X and Y of the output side".into(),
                most: format!("{BALANCE_UM} um"),
                levels_dbm: levels.into(),
            })
        };
        let peaks = (0..self.options.optics.channels).map(peak).collect::<Result<Vec<_>, _>>()?;
        let best = best_for_all(&self.options.optics, &peaks);
        self.shift(best.x_um - here[0], best.y_um - here[1], best.roll_rad)?;
        self.done("array balanced over all channels", None);
        Ok(())
    }

    fn shift(&mut self, x_um: f64, y_um: f64, roll_rad: f64) -> Result<(), Trouble> {
        Ok(self.at(Side::Output).move_by([x_um, y_um, 0.0, 0.0, 0.0, roll_rad.to_degrees()])?)
    }
}
