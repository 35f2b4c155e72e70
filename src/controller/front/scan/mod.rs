//! Scans: moves and samples of light, one after the other, until the peak is known.
//!
//! # Design
//! A scan is a route of ways between points at rest. The states advance at rest only, from the reports, as those of a
//! homing do; the samples of a leg that is sampled in motion are consumed as they come. Every point of the route is
//! checked before the first step: a scan that would leave the range of an axis or the travel of a motor moves nothing.
//!
//! # Play
//! Lines are sampled in one direction. Each begins beyond its range by the play and the margin of its motor, so that the
//! play is taken up, and by what it takes to reach its speed; there the stage comes to rest, so that a take-up in time
//! has ended as well. The end, too, is approached from that side. A climb goes both ways: it is refused where the play
//! that is not compensated would swallow its steps.
//!
//! # Limitations
//! Samples of a leg are placed by the motor of its own axis, linearly between both ends of the leg: exact for linear
//! axes, to the second order of the leg for rotary ones.

mod finish;
mod route;
mod sampling;

use super::sense::{Trigger, late_segments};
use super::{Abort, Front};
use crate::error::{Error, ErrorNumber};
use crate::scan::climb::Climb;
use crate::scan::{Definition, Outcome, SCAN_AXES, SCANS, STEP, status};
use crate::units::{AXES, Axis, Pose, SEGMENT_NS};
use route::Leg;
use sampling::Block;

/// Segments beyond those of a mean after which samples are given up: a second.
const PATIENCE: u64 = 1_000_000_000 / SEGMENT_NS;
/// Ways of a route that may wait: past the play, and back through it.
const WAYS: usize = 2;

/// What follows when all ways are gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Next {
    /// A leg is sampled in motion.
    Leg,
    /// The light is measured at rest.
    Measure,
    /// The scan has ended.
    Over,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// There is no scan.
    None,
    /// Waits for `*TRG`.
    Armed,
    /// Goes the ways that wait, to what follows.
    Going,
    /// A leg is sampled in motion.
    Sampling,
    /// Light was found: stops.
    Crossing,
    /// At rest; samples up to a segment are still to come.
    Draining,
    /// At rest: samples from a segment on count.
    Settling,
    /// Stops on command.
    Stopping,
    /// Stopped on command, and can go on.
    Paused,
}

/// A scan on its way.
#[derive(Clone, Copy, Debug)]
pub struct Scan {
    id: u8,
    phase: Phase,
    /// What follows when all ways are gone.
    next: Next,
    /// The segment that it waits for; from which on samples are those of a leg.
    since: u64,
    definition: Definition,
    /// Where it began: offsets of its axes count from here.
    start: Pose,
    ways: [Option<Pose>; WAYS],
    /// Number of the leg or of the point.
    index: i32,
    leg: Leg,
    block: Block,
    climb: Climb,
    /// The greatest sample: level and offsets.
    best: (i32, [i32; SCAN_AXES]),
    /// The sample that reached the threshold.
    first: [i32; SCAN_AXES],
    /// What was found, as offsets.
    place: [i32; SCAN_AXES],
    /// Lines of a raster that have a peak.
    lines: u8,
    /// It is on its way to its end, which is repeated after a stop.
    over: bool,
    /// Why it fails, told in the end.
    fails: Option<&'static str>,
    outcome: Outcome,
}

impl Scan {
    /// None; all bytes are zero.
    pub(super) const NONE: Scan = Scan {
        id: 0,
        phase: Phase::None,
        next: Next::Leg,
        since: 0,
        definition: Definition::NONE,
        start: Pose([0; AXES]),
        ways: [None; WAYS],
        index: 0,
        leg: Leg::NONE,
        block: Block::NONE,
        climb: Climb::NONE,
        best: (0, [0; SCAN_AXES]),
        first: [0; SCAN_AXES],
        place: [0; SCAN_AXES],
        lines: 0,
        over: false,
        fails: None,
        outcome: Outcome::NONE,
    };

    pub(super) fn is_there(&self) -> bool {
        self.phase != Phase::None
    }
}

impl Front {
    // ---- definitions and results ----

    /// Keeps the definition of a scan.
    ///
    /// # Errors
    /// -213 while this one runs.
    pub fn define_scan(&mut self, id: usize, definition: Definition) -> Result<(), Error> {
        if self.light.scan().is_some_and(|scan| usize::from(scan.id) == id) {
            self.not_scanning()?;
            self.end_scan(0);
        }
        let kept = self.light.get_mut().and_then(|memory| memory.kept.get_mut(id)).ok_or(not_defined())?;
        kept.definition = definition;
        kept.outcome.status = 0;
        Ok(())
    }

    /// The definition of a scan.
    ///
    /// # Errors
    /// -221 when there is none.
    pub fn scan_definition(&self, id: usize) -> Result<&Definition, Error> {
        let kept = self.light.get().and_then(|memory| memory.kept.get(id));
        kept.map(|kept| &kept.definition).filter(|definition| definition.defined).ok_or(not_defined())
    }

    /// What a scan has given so far, and where it ended or stands.
    ///
    /// # Errors
    /// -221 when it is not defined or has never begun.
    pub fn scan_outcome(&self, id: usize) -> Result<(&Outcome, Pose), Error> {
        if let Some(scan) = self.light.scan().filter(|scan| usize::from(scan.id) == id) {
            return Ok((&scan.outcome, self.position()));
        }
        let kept = self.light.get().and_then(|memory| memory.kept.get(id));
        let outcome = kept.map(|kept| &kept.outcome).filter(|outcome| outcome.status != 0);
        let never = Error::text(ErrorNumber::SettingsConflict, "scan never started");
        outcome.map(|outcome| (outcome, Pose(outcome.ended))).ok_or(never)
    }

    /// Number and phase of the scan that runs: 0 none, 1 waits for its trigger, 2 moves, 3 samples, 4 stopped.
    pub fn scan_state(&self) -> (u8, u8) {
        let phase = |scan: &Scan| match scan.phase {
            Phase::None => 0,
            Phase::Armed => 1,
            Phase::Going | Phase::Crossing | Phase::Stopping => 2,
            Phase::Sampling | Phase::Draining | Phase::Settling => 3,
            Phase::Paused => 4,
        };
        self.light.scan().map_or((0, 0), |scan| (phase(scan), scan.id))
    }

    /// True from the start of a scan to its end; a stopped one does not run.
    pub fn is_scanning(&self) -> bool {
        self.light.scan().is_some_and(|scan| scan.phase != Phase::Paused)
    }

    pub(super) fn scan_is_armed(&self) -> bool {
        self.light.scan().is_some_and(|scan| scan.phase == Phase::Armed)
    }

    /// # Errors
    /// -213 while a scan runs.
    pub(super) fn not_scanning(&self) -> Result<(), Error> {
        if self.is_scanning() { Err(Error::text(ErrorNumber::InitIgnored, "scan running")) } else { Ok(()) }
    }

    // ---- commands ----

    /// Starts a scan, or arms it.
    ///
    /// # Errors
    /// 103 while the emergency stop is latched, -213 while a scan or a homing runs, 104 while moving, -221 when it is not
    /// defined or its steps are smaller than the play, 108, 102 and -222 as moves: nothing moves then.
    pub fn start_scan(&mut self, id: usize) -> Result<(), Error> {
        self.free_to_begin()?;
        let definition = self.scan_definition(id)?;
        let start = self.commanded();
        self.check_scan(definition, start)?;
        let (definition, channel) = (*definition, definition.channel());
        // one that was stopped has ended
        self.end_scan(0);
        if let Some(memory) = self.light.get_mut() {
            memory.scan = Scan::NONE;
            let scan = &mut memory.scan;
            (scan.id, scan.phase, scan.definition, scan.start) = (id as u8, Phase::Armed, definition, start);
            (scan.climb.step, scan.best.0, scan.outcome) = (definition.values[STEP], i32::MIN, Outcome::FRESH);
        }
        self.sense.watched |= 1 << channel;
        if self.sense.trigger == Trigger::Immediate {
            self.begin_part();
        }
        Ok(())
    }

    /// # Errors
    /// 103 while the emergency stop is latched, -213 while a scan or a homing runs, 104 while moving.
    #[inline(never)]
    pub(super) fn free_to_begin(&self) -> Result<(), Error> {
        self.armed()?;
        self.not_homing()?;
        self.not_scanning()?;
        self.standstill()
    }

    /// `*TRG`; true when a scan has waited for it.
    pub(super) fn trigger_scan(&mut self) -> Result<bool, Error> {
        let waits = self.scan_is_armed();
        if waits {
            self.armed()?;
            self.begin_part();
        }
        Ok(waits)
    }

    /// True when a scan, running or stopped, has this axis.
    pub(super) fn scan_has(&self, axis: Axis) -> bool {
        self.light.scan().is_some_and(|scan| scan.definition.axes().contains(&(axis.index() as u8)))
    }

    /// Stops a scan: what moves decelerates. It can go on.
    pub fn stop_scan(&mut self) {
        let Some(scan) = self.light.scan_mut() else { return };
        match scan.phase {
            Phase::Armed => self.end_scan(status::STOPPED),
            Phase::Paused => {}
            _ => {
                scan.phase = Phase::Stopping;
                self.planner.stop_coordinated();
            }
        }
    }

    /// Goes on with a scan that was stopped: its line, its point or its way to the end is repeated.
    ///
    /// # Errors
    /// -221 when there is none; those of [`Front::start_scan`].
    pub fn continue_stopped_scan(&mut self) -> Result<(), Error> {
        self.free_to_begin()?;
        let none = Error::text(ErrorNumber::SettingsConflict, "no stopped scan");
        let scan = self.light.scan().ok_or(none)?;
        self.check_scan(&scan.definition, scan.start)?;
        let Some(scan) = self.light.scan_mut() else { return Ok(()) };
        scan.outcome.status = scan.outcome.status & !status::STOPPED | status::RUNNING;
        if scan.over {
            self.conclude()
        } else {
            self.begin_part()
        }
        Ok(())
    }

    /// Forgets a stopped scan: its coordinates no longer mean the same.
    pub(super) fn forget_stopped_scan(&mut self) {
        if !self.is_scanning() {
            self.end_scan(0);
        }
    }

    /// Ends a scan where it stands, for the reason in `flag`; a stopped one is no longer there to go on.
    pub(super) fn end_scan(&mut self, flag: u16) {
        let ended = self.law().forward(self.report.final_steps).0;
        let Some(memory) = self.light.get_mut() else { return };
        let scan = &mut memory.scan;
        if !scan.is_there() {
            return;
        }
        let failed = scan.fails.filter(|_| flag & status::FAILED != 0);
        if let Some(kept) = memory.kept.get_mut(usize::from(scan.id)) {
            kept.outcome = scan.outcome;
            kept.outcome.status = scan.outcome.status & !status::RUNNING | flag;
            kept.outcome.ended = ended;
        }
        scan.phase = Phase::None;
        if let Some(why) = failed {
            self.events.scan = Some(Error::text(ErrorNumber::ScanFailed, why));
        }
        self.refresh();
    }

    // ---- its course ----

    /// Begins the leg or the point whose turn it is.
    fn begin_part(&mut self) {
        let Some(scan) = self.light.scan() else { return };
        let (ways, next) = self.part_of(scan);
        let Some(memory) = self.light.get_mut() else { return };
        // every line has its own samples, points belong to one
        let scan = &mut memory.scan;
        if next == Next::Leg || scan.index == 0 {
            memory.samples.clear();
        }
        (scan.ways, scan.phase, scan.next, scan.block) = (ways, Phase::Going, next, Block::NONE);
    }

    /// Advances a scan; call it when no order is awaited.
    pub(super) fn continue_scan(&mut self) {
        if self.abort != Abort::None {
            return;
        }
        let rests = !self.planner.is_moving() && self.report.settled && self.report.answered == self.sequence;
        let played = self.report.played;
        let heard = self.latest_sample().map_or(0, |sample| sample.played);
        let Some(scan) = self.light.scan_mut() else { return };
        let settings = &self.settings.sense[scan.definition.channel()];
        let wanted = u64::from(settings.average);
        match scan.phase {
            _ if !rests => {}
            Phase::None | Phase::Armed | Phase::Paused => {}
            Phase::Going => {
                if let Some(way) = scan.ways.iter_mut().find_map(Option::take) {
                    return self.go_on(way);
                }
                match scan.next {
                    Next::Leg => self.start_leg(),
                    Next::Measure => {
                        scan.since = played + late_segments(settings);
                        (scan.block, scan.phase) = (Block::NONE, Phase::Settling);
                    }
                    Next::Over => {
                        let flag = if scan.fails.is_some() { status::FAILED } else { status::DONE };
                        self.end_scan(flag);
                    }
                }
            }
            Phase::Sampling => (scan.phase, scan.since) = (Phase::Draining, played),
            Phase::Draining if heard >= scan.since => self.leg_done(),
            Phase::Settling if u64::from(scan.block.count()) >= wanted => self.measured(),
            Phase::Draining | Phase::Settling => {
                if played > scan.since + wanted + PATIENCE {
                    self.fail_scan(finish::NO_SAMPLES);
                }
            }
            Phase::Crossing => self.found_light(),
            Phase::Stopping => {
                scan.phase = Phase::Paused;
                scan.outcome.status = scan.outcome.status & !status::RUNNING | status::STOPPED;
                self.refresh();
            }
        }
    }
}

fn not_defined() -> Error {
    Error::text(ErrorNumber::SettingsConflict, "scan not defined")
}

const _: () = assert!(SCANS <= 1 << 8);
