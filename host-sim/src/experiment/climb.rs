//! The naive search: one coordinate after the other, step by step, by moves of the host.

use super::witness::{Snapshot, Witness};
use crate::alignment::{BusError, Controller};
use crate::bench_twin::Side;
use stage_controller::units::{AXES, Axis};

/// A pass that gains less than this is the last one, dB.
const ENOUGH_DB: f64 = 0.05;
/// Passes after which a climb that goes on gaining is stopped: what drift and noise could feed.
const MOST_PASSES: usize = 100;
/// From the end of a move to the reading, s: settling, delay of the meter, and the mean itself.
const CALM_S: f64 = 0.01;
/// Samples of a mean, of 256 us.
const AVERAGE: usize = 32;
/// Step in x and y of the angle climb, um: above the play.
const FREE_STEP_UM: f64 = 0.5;
/// Step of its angles, degrees.
const ANGLE_STEP_DEG: f64 = 0.1;
/// Gap to which it closes, um.
const GAP_UM: f64 = 10.0;

/// A coordinate of a stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coordinate {
    /// Whose.
    pub side: Side,
    /// Which.
    pub axis: Axis,
}

/// A reading after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probe {
    /// What was stepped.
    pub at: Coordinate,
    /// Commanded way from the best place, um or degrees.
    pub way: f64,
    /// Of which climb over two coordinates, from 0 in the order in which they begin: an angle climb has several, and a
    /// re-peaked one has others within.
    pub climb: usize,
    /// The pass, from 0 in each climb.
    pub pass: usize,
    /// There was more light than at the best place.
    pub taken: bool,
    /// At the best place so far.
    pub best: Snapshot,
    /// Before the step.
    pub before: Snapshot,
    /// After it.
    pub after: Snapshot,
}

/// What a climb has done.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Log {
    /// All probes.
    pub probes: Vec<Probe>,
    /// Moves commanded.
    pub moves: usize,
    /// Readings of the light.
    pub readings: usize,
    /// What it is at, or was in the end.
    pub step: &'static str,
    /// Climbs begun.
    pub climbs: usize,
    /// After every turn it went back to the peak in x and y.
    pub repeaked: bool,
}

impl Log {
    /// Probes of the last pass of the last climb in x and y.
    pub fn last_lateral(&self) -> impl Iterator<Item = &Probe> {
        let lateral = || self.probes.iter().filter(|probe| !probe.at.axis.is_rotary());
        let last = lateral().next_back().map(|probe| (probe.climb, probe.pass));
        lateral().filter(move |probe| Some((probe.climb, probe.pass)) == last)
    }

    /// Probes of angles right after the turn; none where it went back to the peak first.
    pub fn turns(&self) -> impl Iterator<Item = &Probe> {
        self.probes.iter().filter(|probe| !self.repeaked && probe.at.axis.is_rotary())
    }
}

/// Climbs in x and y of both sides with steps of `step_um`, patience 1.
///
/// # Errors
/// Those of the bus; what was done so far is in the log.
pub fn climb<B: Witness>(bus: &mut B, setup: &[String], step_um: f64, log: &mut Log) -> Result<(), BusError> {
    let mut climber = Climber::new(bus, log, 1);
    climber.prepare(setup)?;
    climber.log.step = "x and y";
    climber.passes([Axis::X, Axis::Y], step_um)
}

/// Climbs in x and y, then in pitch and yaw, closes the gap, climbs in x and y again. `repeak`: after every turn it goes
/// back to the peak of that side in x and y before it reads.
///
/// # Errors
/// Those of the bus; what was done so far is in the log.
pub fn angle_climb<B: Witness>(bus: &mut B, setup: &[String], repeak: bool, log: &mut Log) -> Result<(), BusError> {
    let mut climber = Climber::new(bus, log, 1);
    climber.prepare(setup)?;
    climber.log.step = "x and y";
    climber.passes([Axis::X, Axis::Y], FREE_STEP_UM)?;
    climber.log.step = "pitch and yaw";
    climber.repeak = repeak;
    climber.log.repeaked = repeak;
    climber.passes([Axis::Alpha, Axis::Beta], ANGLE_STEP_DEG)?;
    climber.repeak = false;
    climber.log.step = "gap";
    for side in Side::BOTH {
        let along = climber.bus.gap_um(side) - GAP_UM;
        climber.step(Coordinate { side, axis: Axis::Z }, along)?;
    }
    climber.log.step = "x and y at the gap";
    climber.passes([Axis::X, Axis::Y], FREE_STEP_UM)
}

struct Climber<'a, B> {
    bus: &'a mut B,
    log: &'a mut Log,
    patience: usize,
    /// Back to the peak in x and y after every turn.
    repeak: bool,
}

impl<'a, B: Witness> Climber<'a, B> {
    fn new(bus: &'a mut B, log: &'a mut Log, patience: usize) -> Self {
        Climber { bus, log, patience, repeak: false }
    }

    fn prepare(&mut self, setup: &[String]) -> Result<(), BusError> {
        self.log.step = "setup";
        for side in Side::BOTH {
            let mut controller = Controller::new(self.bus, side);
            controller.run(&setup.join(";:"), 1.0)?;
            controller.run(&format!("SENS1:AVER {AVERAGE};:SENS2:AVER {AVERAGE}"), 1.0)?;
        }
        Ok(())
    }

    /// Light of channel 1, dBm, and the truth at that moment.
    fn read(&mut self) -> Result<(f64, Snapshot), BusError> {
        self.bus.pause(CALM_S)?;
        let level = Controller::new(self.bus, Side::Output).powers()?[0];
        self.log.readings += 1;
        Ok((level, self.bus.snapshot()))
    }

    fn step(&mut self, at: Coordinate, by: f64) -> Result<(), BusError> {
        let mut way = [0.0; AXES];
        way[at.axis.index()] = by;
        self.log.moves += 1;
        Controller::new(self.bus, at.side).move_by(way)
    }

    /// A step, and after a turn to the peak in x and y again where that is wanted.
    fn go(&mut self, at: Coordinate, by: f64) -> Result<(), BusError> {
        self.step(at, by)?;
        if self.repeak && at.axis.is_rotary() {
            self.climb_over(&[at.side], [Axis::X, Axis::Y], FREE_STEP_UM)
        } else {
            Ok(())
        }
    }

    /// Passes over some axes of both sides until one gains too little.
    fn passes(&mut self, axes: [Axis; 2], step: f64) -> Result<(), BusError> {
        self.climb_over(&[Side::Output, Side::Input], axes, step)
    }

    fn climb_over(&mut self, sides: &[Side], axes: [Axis; 2], step: f64) -> Result<(), BusError> {
        let climb = self.log.climbs;
        self.log.climbs += 1;
        let mut level = self.read()?.0;
        for pass in 0..MOST_PASSES {
            for &side in sides {
                for axis in axes {
                    self.along(Coordinate { side, axis }, step, [climb, pass])?;
                }
            }
            let now = self.read()?.0;
            if now - level < ENOUGH_DB {
                break;
            }
            level = now;
        }
        Ok(())
    }

    /// To the best place along one coordinate, in this climb and pass.
    fn along(&mut self, at: Coordinate, step: f64, [climb, pass]: [usize; 2]) -> Result<(), BusError> {
        let (mut level, mut best) = self.read()?;
        let (mut before, mut here) = (best, 0.0);
        // counted in whole steps, so that nothing adds up
        let mut top = 0.0;
        for direction in [1.0, -1.0] {
            let from = top;
            let mut misses = 0;
            while misses < self.patience {
                let next = top + direction * (misses + 1) as f64;
                self.go(at, (next - here) * step)?;
                let (now, after) = self.read()?;
                let taken = now > level;
                self.log.probes.push(Probe { at, way: (next - top) * step, climb, pass, taken, best, before, after });
                (here, before) = (next, after);
                if taken {
                    (level, best, top, misses) = (now, after, next, 0);
                } else {
                    misses += 1;
                }
            }
            if top != from {
                break;
            }
        }
        if here != top { self.go(at, (top - here) * step) } else { Ok(()) }
    }
}
