//! The front: plans, checks, keeps settings and answers questions. Runs in the thread executor.
//!
//! # Design
//! It never touches a word. What it knows of the motion comes from the latest [`Report`]; what it wants goes down as
//! [`Order`]s. Changes of the law, of counts and of pulses happen at standstill only and leave every motor where it is:
//! the logical pose is recomputed by the forward map.

use super::border::{Action, Order, Report};
use crate::compensation::backlash::{Flank, Play};
use crate::compensation::calibration::{BLOCK_CAPACITY, Calibration, MotorData};
use crate::compensation::law::{Law, Remembered, Switches, largest_lever_nm};
use crate::error::{Detail, Error, ErrorNumber};
use crate::motion::limits::{AxisLimits, Limits};
use crate::motion::planner::{Capability, Desire, Planner};
use crate::settings::{self, BacklashMode, Settings};
use crate::stepgen::timing::Timing;
use crate::units::{AXES, Axis, FinePose, MotorSteps, Pose, SEGMENT_NS, SEGMENT_TICKS};

/// Pivots that can be kept; number 0 is the calibration's own fibre point.
pub const PIVOTS: usize = 8;
/// Farthest that a pivot may lie from a rotary axis, nm.
pub const LEVER_LIMIT_NM: u64 = 60_000_000;
/// Orders that may wait to be taken to the generator.
pub const ORDERS: usize = 24;
/// Segments between the last generated one and the first that a new track may use; more after a refusal.
const LEAD: u64 = 2;
const LEAD_MAX: u64 = 64;
/// Samples of a path on which a dry run counts the changes of flank.
const DRY_RUN_SAMPLES: i64 = 200;

/// What `POSE:CHECk?` answers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Check {
    /// Zero, or the error that the move itself would raise.
    pub verdict: Option<Error>,
    /// Duration in us.
    pub duration_us: u64,
    /// Peak step rates, steps per second.
    pub step_rates: [u64; AXES],
    /// Changes of flank.
    pub flank_changes: [u32; AXES],
}

/// Condition of an axis, bits as in STATus:AXIS.
#[allow(missing_docs)]
pub mod axis_condition {
    pub const MOVING: u16 = 1 << 0;
    pub const HOMED: u16 = 1 << 1;
    pub const FLANK_KNOWN: u16 = 1 << 2;
    pub const TAKE_UP: u16 = 1 << 3;
    pub const SOFT_LOW: u16 = 1 << 4;
    pub const SOFT_HIGH: u16 = 1 << 5;
    pub const ENABLED: u16 = 1 << 8;
    pub const UNCERTAIN: u16 = 1 << 10;
}

/// A take-up on command, on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Preload {
    /// Away from the wanted flank.
    Away { axis: Axis, flank: Flank, back: Pose },
    /// Back onto it.
    Back,
}

/// Where an abort stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Abort {
    None,
    /// To be carried out by whoever owns the step output.
    Requested,
    /// Carried out; the report that says so is still to come.
    Underway,
}

/// Plans, checks, keeps settings and answers questions.
pub struct Front {
    calibration: Option<Calibration>,
    block: heapless::Vec<u8, BLOCK_CAPACITY>,
    /// Settings in force.
    pub(super) settings: Settings,
    pivots: [Option<[i32; 3]>; PIVOTS],
    pivot: u8,
    capability: Capability,
    timing: Timing,
    planner: Planner,
    report: Report,
    sequence: u16,
    lead: u64,
    orders: heapless::Deque<Order, ORDERS>,
    homed: [bool; AXES],
    enabled: [bool; AXES],
    uncertain: [bool; AXES],
    abort: Abort,
    preload: Option<Preload>,
    jog_links: [Option<u8>; AXES],
    /// A motion that was accepted and turned out to break a limit.
    late_error: Option<Error>,
    /// The last order that takes effect at once, while unanswered: nothing is planned before it is.
    hold: Option<u16>,
    /// Where the motors stand by an anchor that reports do not show yet.
    anchor: Option<Anchored>,
    /// Settings were set back during an abort: what follows from them is still to be ordered.
    reset_due: bool,
}

/// Counts without overlay that were named at standstill.
#[derive(Clone, Copy, Debug)]
struct Anchored {
    steps: MotorSteps,
    sequence: u16,
    /// The segment from which on reports show it, once the order is answered.
    from: Option<u64>,
}

fn refuse(number: ErrorNumber) -> Error {
    number.into()
}

impl Front {
    /// Like a board after power-up, without a calibration: not homed, disabled.
    pub fn new() -> Self {
        let settings = Settings::defaults(None);
        let motors = settings::motors(None, Some(&settings));
        let law = Law::identity(&motors);
        let mut front = Front {
            calibration: None,
            block: heapless::Vec::new(),
            settings,
            pivots: [None; PIVOTS],
            pivot: 0,
            capability: Capability {
                law,
                motors: motors.map(|m| settings::motor_rates(&m)),
                wanted: settings.axes.map(|a| a.wanted()),
                limits: Limits([NO_LIMITS; AXES]),
                override_percent: 100,
            },
            timing: Timing::default(),
            planner: Planner::at_rest(Pose::default()),
            report: Report { settled: true, ..Report::default() },
            sequence: 0,
            lead: LEAD,
            orders: heapless::Deque::new(),
            homed: [false; AXES],
            enabled: [false; AXES],
            uncertain: [false; AXES],
            abort: Abort::None,
            preload: None,
            jog_links: [None; AXES],
            late_error: None,
            hold: None,
            anchor: None,
            reset_due: false,
        };
        front.refresh();
        front
    }

    /// The law and the timing with which the generator must begin.
    pub fn generator_setup(&self) -> (Law, Timing) {
        (self.capability.law, self.timing)
    }

    // ---- the border ----

    /// The next order for the generator.
    pub fn next_order(&mut self) -> Option<Order> {
        self.orders.pop_front()
    }

    /// True when the step output must be stopped at once; whoever owns it does so, rolls the generator back and
    /// lets its reports come in.
    pub fn take_abort(&mut self) -> bool {
        let requested = self.abort == Abort::Requested;
        if requested {
            self.abort = Abort::Underway;
            self.orders.clear();
        }
        requested
    }

    /// A report of the generator.
    pub fn receive_report(&mut self, report: Report) {
        let aborted = report.aborts != self.report.aborts;
        self.report = report;
        if aborted {
            self.abort = Abort::None;
            self.orders.clear();
            self.preload = None;
            // what was ordered while it moved may be lost
            let _ = self.refresh_plays();
            self.stand_at(report.final_steps);
            if core::mem::take(&mut self.reset_due) {
                let settings = self.settings;
                let _ = self.set_pulses(&settings).and_then(|()| self.change_law());
            }
        }
        let answered = |sequence: u16| report.answered.wrapping_sub(sequence) < 0x8000;
        self.hold = self.hold.filter(|sequence| !answered(*sequence));
        if let Some(mut anchor) = self.anchor {
            if anchor.from.is_none() && answered(anchor.sequence) {
                anchor.from = Some(report.next);
            }
            let shown = anchor.from.is_some_and(|from| report.played >= from);
            self.anchor = if shown { None } else { Some(anchor) };
            if !shown {
                self.show_anchor(anchor);
            }
        }
        if self.planner.answer(report.answered, report.refused, report.next) {
            self.lead = (self.lead * 2).min(LEAD_MAX);
        }
    }

    /// Lets the report say what an anchor says, until it does so by itself.
    fn show_anchor(&mut self, anchor: Anchored) {
        let report = &mut self.report;
        report.steps = anchor.steps;
        for (count, (steps, overlay)) in report.counts.0.iter_mut().zip(anchor.steps.0.iter().zip(&report.overlay)) {
            *count = steps.wrapping_add(*overlay);
        }
        if anchor.from.is_none() {
            report.final_steps = anchor.steps;
        }
    }

    /// Plans what is to be planned. Call after every report and after every command.
    pub fn plan(&mut self) {
        if self.abort != Abort::None || self.hold.is_some() {
            return;
        }
        self.continue_preload();
        if self.hold.is_some() {
            return;
        }
        let segment = self.report.next + self.lead;
        let (orders, sequence, aborts) = (&mut self.orders, &mut self.sequence, self.report.aborts);
        let result = self.planner.plan(&self.capability, segment, |proposal| {
            *sequence = sequence.wrapping_add(1);
            let action = Action::Run { slot: proposal.slot, track: proposal.track };
            let order = Order { sequence: *sequence, segment: Some(proposal.segment), aborts, action };
            orders.push_back(order).ok().map(|()| *sequence)
        });
        if let Err(error) = result {
            self.late_error = Some(error);
            self.preload = None;
        }
        // not sooner: a track that ends within the lead counts as ended, and still runs in the generator
        if !self.planner.is_moving() && self.report.settled && self.report.answered == self.sequence {
            self.lead = LEAD;
        }
    }

    /// An error of a motion that had been accepted, once.
    pub fn take_late_error(&mut self) -> Option<Error> {
        self.late_error.take()
    }

    fn order(&mut self, action: Action) -> Result<(), Error> {
        self.sequence = self.sequence.wrapping_add(1);
        let order = Order { sequence: self.sequence, segment: None, aborts: self.report.aborts, action };
        self.orders.push_back(order).map_err(|_| Error::text(ErrorNumber::Moving, "orders still on their way"))?;
        self.hold = Some(self.sequence);
        Ok(())
    }

    // ---- state ----

    /// True while motion or take-up goes on, or is still to begin: what `*OPC` waits for.
    pub fn operation_pending(&self) -> bool {
        self.is_moving()
            || self.abort != Abort::None
            || self.preload.is_some()
            || !self.orders.is_empty()
            || self.report.answered != self.sequence
    }

    /// True while orders are on their way that a further change must wait for.
    pub fn is_busy_at_the_border(&self) -> bool {
        self.abort != Abort::None || self.orders.len() > ORDERS - 2 * AXES || self.planner.is_about_to_stop()
    }

    /// True until everything that moves, or waits to move, has come to rest in the words played.
    pub fn is_moving(&self) -> bool {
        self.planner.is_moving() || !self.report.settled
    }

    fn standstill(&self) -> Result<(), Error> {
        if self.is_moving() || self.abort != Abort::None || self.preload.is_some() {
            return Err(refuse(ErrorNumber::Moving));
        }
        Ok(())
    }

    /// Segments completely played, in ticks.
    pub fn ticks(&self) -> u64 {
        self.report.played * SEGMENT_TICKS as u64
    }

    /// The latest report.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Logical pose of the words played so far.
    pub fn position(&self) -> Pose {
        self.capability.law.forward(self.report.steps)
    }

    /// Where the axes are at last to stand.
    pub fn commanded(&self) -> Pose {
        self.planner.commanded()
    }

    /// Motor counts really played, overlay included.
    pub fn motor_counts(&self) -> MotorSteps {
        self.report.counts
    }

    /// Condition bits of an axis.
    pub fn axis_condition(&self, axis: Axis) -> u16 {
        use axis_condition::*;
        let i = axis.index();
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        let at = |mask: u8| mask >> i & 1 != 0;
        let limits = &self.capability.limits.0[i];
        let moving = at(self.report.moving | self.planner.moving_axes());
        // where the axis stands by command: what is played is the nearest step of it
        let watched = limits.soft_on && limits.homed && !moving;
        let position = self.planner.rest().rounded().0[i];
        bit(moving, MOVING)
            | bit(self.homed[i], HOMED)
            | bit(at(self.report.known) && !at(self.report.owing), FLANK_KNOWN)
            | bit(at(self.report.taking_up), TAKE_UP)
            | bit(watched && position <= limits.soft_lower, SOFT_LOW)
            | bit(watched && position >= limits.soft_upper, SOFT_HIGH)
            | bit(self.enabled[i], ENABLED)
            | bit(self.uncertain[i], UNCERTAIN)
    }

    /// Bit n: motor n takes up its play.
    pub fn taking_up(&self) -> u8 {
        self.report.taking_up
    }

    /// Settings in force.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Motor data in force.
    pub fn motors(&self) -> [MotorData; AXES] {
        settings::motors(self.calibration.as_ref(), Some(&self.settings))
    }

    /// True when a motor is enabled.
    pub fn is_enabled(&self, axis: Axis) -> bool {
        self.enabled[axis.index()]
    }

    /// True when an axis is homed.
    pub fn is_homed(&self, axis: Axis) -> bool {
        self.homed[axis.index()]
    }

    /// The law in force.
    pub fn law(&self) -> &Law {
        &self.capability.law
    }

    /// Overlay of a motor, whole steps.
    pub fn overlay_steps(&self, axis: Axis) -> i32 {
        self.report.overlay[axis.index()]
    }

    /// Flank of a motor, none while unknown.
    pub fn flank(&self, axis: Axis) -> Option<Flank> {
        let bit = |mask: u8| mask >> axis.index() & 1 != 0;
        bit(self.report.known).then(|| if bit(self.report.negative) { Flank::Negative } else { Flank::Positive })
    }

    // ---- motion ----

    /// While an immediate stop is carried out, nobody knows yet from where a move would start.
    fn not_aborting(&self) -> Result<(), Error> {
        if self.abort == Abort::None { Ok(()) } else { Err(refuse(ErrorNumber::Moving)) }
    }

    fn ready(&self, axis: Axis) -> Result<(), Error> {
        if self.uncertain[axis.index()] {
            return Err(Error::axis(ErrorNumber::PositionUncertain, axis));
        }
        if !self.homed[axis.index()] {
            return Err(Error::axis(ErrorNumber::NotHomed, axis));
        }
        Ok(())
    }

    /// Moves one axis to a logical coordinate.
    ///
    /// # Errors
    /// 101, 109, 108, -222: nothing moves.
    pub fn move_absolute(&mut self, axis: Axis, to: i64) -> Result<(), Error> {
        self.ready(axis)?;
        self.move_axis(axis, to)
    }

    /// Moves one axis by a distance from its commanded coordinate; needs no homing.
    ///
    /// # Errors
    /// 108, -222: nothing moves.
    pub fn move_relative(&mut self, axis: Axis, by: i64) -> Result<(), Error> {
        self.move_axis(axis, i64::from(self.commanded().0[axis.index()]).saturating_add(by))
    }

    fn move_axis(&mut self, axis: Axis, to: i64) -> Result<(), Error> {
        self.not_aborting()?;
        self.capability.limits.check_coordinate(&self.capability.law, axis, to)?;
        let i = axis.index();
        let from = self.commanded();
        let mut target = from;
        target.0[i] = to as i32;
        let over = self.legs(from, target)?;
        let alone = !self.planner.is_coordinated(axis);
        match over {
            None if alone => self.planner.desire(axis, Desire::Position(target.0[i], None)),
            // only this motor's own overshoot: its axis can make it alone
            Some(over) if alone && self.planner.is_moving() => {
                self.planner.desire(axis, Desire::Position(over.0[i], Some(target.0[i])));
            }
            Some(over) => self.planner.go(over, Some(target)),
            None => self.planner.go(target, None),
        }
        self.jog_links[i] = None;
        Ok(())
    }

    /// Moves all axes to a pose on one straight line.
    ///
    /// # Errors
    /// 101, 109, 108, -222: nothing moves.
    pub fn pose_absolute(&mut self, target: [i64; AXES]) -> Result<(), Error> {
        for axis in Axis::ALL {
            self.ready(axis)?;
        }
        let target = self.pose_in_range(target)?;
        self.go(target)
    }

    /// Moves all axes by distances from their commanded coordinates; needs no homing.
    ///
    /// # Errors
    /// 108, -222: nothing moves.
    pub fn pose_relative(&mut self, by: [i64; AXES]) -> Result<(), Error> {
        let mut target = by;
        for (t, from) in target.iter_mut().zip(self.commanded().0) {
            *t = t.saturating_add(i64::from(from));
        }
        let target = self.pose_in_range(target)?;
        self.go(target)
    }

    fn go(&mut self, target: Pose) -> Result<(), Error> {
        self.not_aborting()?;
        match self.legs(self.commanded(), target)? {
            Some(over) => self.planner.go(over, Some(target)),
            None => self.planner.go(target, None),
        }
        self.jog_links = [None; AXES];
        Ok(())
    }

    fn pose_in_range(&self, pose: [i64; AXES]) -> Result<Pose, Error> {
        for (axis, value) in Axis::ALL.into_iter().zip(pose) {
            self.capability.limits.check_coordinate(&self.capability.law, axis, value)?;
        }
        Ok(Pose(pose.map(|u| u as i32)))
    }

    /// Checks a move; answers where it has to overshoot to, if a motor is to end in one direction.
    fn legs(&self, from: Pose, to: Pose) -> Result<Option<Pose>, Error> {
        match self.overshoot(from, to) {
            None => self.planner.check(&self.capability, from, to).map(|_| None),
            Some(over) => {
                self.planner.check(&self.capability, from, over)?;
                self.planner.check(&self.capability, over, to)?;
                Ok(Some(over))
            }
        }
    }

    /// Where a move from `from` to `to` has to go first, so that every one-directional motor ends in its direction.
    fn overshoot(&self, from: Pose, to: Pose) -> Option<Pose> {
        let law = &self.capability.law;
        let (start, mut end) = (law.steps(from), law.steps(to));
        let mut needed = false;
        for axis in Axis::ALL {
            let i = axis.index();
            let own = &self.settings.axes[i];
            let Some(flank) = own.backlash.mode.ending() else {
                continue;
            };
            let sign = flank.sign();
            let way = end.0[i].wrapping_sub(start.0[i]).wrapping_mul(sign);
            let clear = self.clearance(axis);
            let short = way < clear && self.flank(axis) != Some(flank);
            // while it moves it may come from the other side, wherever it was to end
            if way < 0 || (way > 0 && short) || self.planner.is_moving() {
                end.0[i] = end.0[i].wrapping_sub(sign.wrapping_mul(clear));
                needed = true;
            }
        }
        needed.then(|| law.forward(end))
    }

    /// Steps of a one-directional overshoot: the play and the margin.
    fn clearance(&self, axis: Axis) -> i32 {
        let own = &self.settings.axes[axis.index()];
        own.backlash_steps(&self.motors()[axis.index()]).saturating_add(own.backlash.margin)
    }

    /// Constant velocity (nm/s or nrad/s, signed) until a stop, a limit, or another jog; 0 ramps down.
    ///
    /// # Errors
    /// 108 disabled, -222 beyond the axis' velocity or already at the limit.
    pub fn jog(&mut self, axis: Axis, velocity: i64, link: u8) -> Result<(), Error> {
        let i = axis.index();
        if velocity == 0 {
            self.stop(axis);
            return Ok(());
        }
        self.not_aborting()?;
        if !self.enabled[i] {
            return Err(Error::axis(ErrorNumber::AxisDisabled, axis));
        }
        let most = self.motors()[i].velocity;
        if velocity.unsigned_abs() > most {
            let bound = if velocity < 0 { -(most as i64) } else { most as i64 };
            return Err(Error {
                number: ErrorNumber::DataOutOfRange,
                detail: Detail::Limit { axis, value: velocity, bound, motor: true },
            });
        }
        let upwards = velocity > 0;
        let rest = self.planner.rest();
        let limit = self.capability.limits.farthest(&self.capability.law, rest, axis, upwards);
        let here = rest.rounded().0[i];
        if (velocity > 0 && limit <= here || velocity < 0 && limit >= here) && !self.planner.is_moving() {
            return Err(Error {
                number: ErrorNumber::DataOutOfRange,
                detail: Detail::Limit { axis, value: i64::from(here), bound: i64::from(limit), motor: false },
            });
        }
        if self.planner.is_coordinated(axis) {
            self.planner.stop_coordinated();
        }
        let speed = settings_speed(velocity.unsigned_abs());
        self.planner.desire(axis, Desire::Jog { upwards, limit, speed });
        self.jog_links[i] = Some(link);
        Ok(())
    }

    /// Decelerates an axis, and every coordinated move that it belongs to.
    pub fn stop(&mut self, axis: Axis) {
        self.preload = None;
        self.planner.stop(axis);
        self.jog_links[axis.index()] = None;
    }

    /// Decelerates everything.
    pub fn stop_all(&mut self) {
        Axis::ALL.into_iter().for_each(|axis| self.stop(axis));
    }

    /// Stops all motors at once, at the word that plays now.
    pub fn abort(&mut self) {
        if self.abort == Abort::None && !self.planner.is_running() && self.report.settled {
            // nothing has begun: there is nothing to stop, only something to forget
            self.planner.forget();
            self.preload = None;
            self.jog_links = [None; AXES];
        } else if self.abort == Abort::None {
            let segment = self.report.played;
            let speeds = self.planner.speeds(segment);
            for axis in Axis::ALL {
                let i = axis.index();
                // Q32 per segment against nm/s
                let threshold =
                    (u128::from(self.settings.axes[i].start_velocity) << 32) * u128::from(SEGMENT_NS) / 1_000_000_000;
                if u128::from(speeds[i]) > threshold + (threshold >> 10) {
                    self.uncertain[i] = true;
                }
            }
            self.planner.clear();
            self.preload = None;
            self.jog_links = [None; AXES];
            self.abort = Abort::Requested;
        }
    }

    /// The link has gone, or a jog's time-out has passed: its jogs end.
    pub fn end_jogs(&mut self, link: u8) {
        for axis in Axis::ALL {
            if self.jog_links[axis.index()] == Some(link) && self.planner.is_jogging(axis) {
                self.stop(axis);
            }
        }
    }

    /// True while a jog of this link runs.
    pub fn has_jog(&self, link: u8) -> bool {
        Axis::ALL.into_iter().any(|a| self.jog_links[a.index()] == Some(link) && self.planner.is_jogging(a))
    }

    /// Speed override, 1 to 100 percent, at once.
    pub fn set_override(&mut self, percent: u8) {
        self.settings.override_percent = percent.clamp(1, 100);
        self.capability.override_percent = self.settings.override_percent;
        self.planner.replan_all();
    }

    /// A dry run of a move to a pose from where everything comes to rest.
    pub fn check(&self, target: [i64; AXES]) -> Check {
        let mut check = Check::default();
        if let Err(error) = self.try_check(target, &mut check) {
            check.verdict = Some(error);
        }
        check
    }

    fn try_check(&self, target: [i64; AXES], check: &mut Check) -> Result<(), Error> {
        for axis in Axis::ALL {
            self.ready(axis)?;
        }
        let target = self.pose_in_range(target)?;
        let from = self.commanded();
        let over = self.overshoot(from, target);
        let mut plays = [Play::default(); AXES];
        let start = self.capability.law.steps(from);
        for axis in Axis::ALL {
            let i = axis.index();
            plays[i] = Play::resting(start.0[i], Some(self.flank(axis).unwrap_or_default()), 0);
        }
        let mut at = from;
        for leg in [over, Some(target)].into_iter().flatten() {
            let run = self.planner.check(&self.capability, at, leg)?;
            check.duration_us += run.segments * SEGMENT_NS / 1000;
            for (rate, new) in check.step_rates.iter_mut().zip(run.step_rates) {
                *rate = (*rate).max(per_second_q44(new));
            }
            self.count_flanks(at, leg, &mut plays, &mut check.flank_changes);
            at = leg;
        }
        Ok(())
    }

    fn count_flanks(&self, from: Pose, to: Pose, plays: &mut [Play; AXES], changes: &mut [u32; AXES]) {
        let mut remembered = Remembered::default();
        for k in 1..=DRY_RUN_SAMPLES {
            let mut pose = FinePose::default();
            for (u, (a, b)) in pose.0.iter_mut().zip(from.0.iter().zip(&to.0)) {
                let (a, b) = (i64::from(*a), i64::from(*b));
                *u = (a << 32) + ((((b - a) as i128) << 32) * i128::from(k) / i128::from(DRY_RUN_SAMPLES)) as i64;
            }
            let steps = self.capability.law.motors(&pose, &mut remembered).floor();
            for (i, play) in plays.iter_mut().enumerate() {
                let dead_band = self.settings.axes[i].backlash.dead_band;
                changes[i] += u32::from(play.turn(steps.0[i], dead_band));
            }
        }
    }

    // ---- standstill ----

    /// Stands at motor counts: the pose follows from the law, no motor moves.
    fn stand_at(&mut self, steps: MotorSteps) {
        let pose = self.capability.law.forward(steps);
        self.planner.rest_at(pose);
        // the queue was just cleared or has room: standstill comes first
        let _ = self.order(Action::Anchor { pose, steps });
        let anchor = Anchored { steps, sequence: self.sequence, from: None };
        self.anchor = Some(anchor);
        self.show_anchor(anchor);
    }

    /// Names the coordinate at which an axis stands: re-anchors the count of its motor alone.
    ///
    /// # Errors
    /// 104 while moving, -222 beyond the arithmetic's range.
    pub fn set_position(&mut self, axis: Axis, x: i64) -> Result<(), Error> {
        self.standstill()?;
        let i = axis.index();
        let law = &self.capability.law;
        let unlimited = Limits([NO_LIMITS; AXES]);
        unlimited.check_coordinate(law, axis, x)?;
        let mut steps = self.report.final_steps;
        for _ in 0..8 {
            let lack = x - i64::from(law.forward(steps).0[i]);
            let by = settings::units_to_steps(lack, law.step_q32(i));
            if by == 0 {
                break;
            }
            steps.0[i] = steps.0[i].wrapping_add(by as i32);
        }
        self.homed[i] = true;
        self.uncertain[i] = false;
        self.stand_at(steps);
        self.refresh();
        Ok(())
    }

    /// Enables or disables a motor.
    ///
    /// # Errors
    /// 104 when it is to be disabled while moving.
    pub fn set_enabled(&mut self, axis: Axis, on: bool) -> Result<(), Error> {
        if !on {
            self.standstill()?;
        }
        self.enabled[axis.index()] = on;
        self.refresh();
        Ok(())
    }

    /// Loads a calibration block: never moves a motor; backlash, travel and rates are taken from it.
    ///
    /// # Errors
    /// 104 while moving, -230 bad CRC, -221 bad version or shape, -222 a lever beyond 60 mm: the old one stays.
    pub fn load(&mut self, block: &[u8]) -> Result<(), Error> {
        self.standstill()?;
        let calibration = Calibration::decode(block)?;
        if largest_lever_nm(&calibration, calibration.fibre_point) > LEVER_LIMIT_NM {
            return Err(Error::text(ErrorNumber::DataOutOfRange, "fibre point beyond 60 mm from a rotary axis"));
        }
        let ceiling = u64::from(self.timing.max_step_rate());
        for (axis, motor) in Axis::ALL.into_iter().zip(&calibration.motors) {
            if step_rate(motor.velocity, motor.step_q32) > ceiling {
                return Err(Error::axis(ErrorNumber::SettingsConflict, axis));
            }
        }
        let bytes = heapless::Vec::from_slice(block)
            .map_err(|_| Error::text(ErrorNumber::SettingsConflict, "calibration block length"))?;
        let fresh = Settings::defaults(Some(&calibration));
        for (own, new) in self.settings.axes.iter_mut().zip(&fresh.axes) {
            let (inverted, timing) = (own.inverted, own.timing);
            *own = *new;
            (own.inverted, own.timing) = (inverted, timing);
        }
        self.pivots = [None; PIVOTS];
        self.pivot = 0;
        self.block = bytes;
        self.calibration = Some(calibration);
        self.change_law()
    }

    /// The block as loaded.
    ///
    /// # Errors
    /// 107 with nothing loaded.
    pub fn block(&self) -> Result<&[u8], Error> {
        self.calibration().map(|_| self.block.as_slice())
    }

    /// The calibration in force.
    ///
    /// # Errors
    /// 107 with nothing loaded.
    pub fn calibration(&self) -> Result<&Calibration, Error> {
        self.calibration.as_ref().ok_or(refuse(ErrorNumber::NoCalibration))
    }

    /// Switches parts of the compensation; no motor moves.
    ///
    /// # Errors
    /// 104 when coupling or pivot change while moving, 107 when a part is turned on with nothing loaded.
    pub fn set_switches(&mut self, switches: Switches) -> Result<(), Error> {
        let old = self.settings.switches;
        let linear = |s: Switches| (s.compensation && s.coupling, s.compensation && s.pivot);
        let law_changes = self.calibration.is_some() && linear(old) != linear(switches);
        if law_changes {
            self.standstill()?;
        }
        self.settings.switches = switches;
        if law_changes { self.change_law() } else { self.refresh_plays() }
    }

    /// Defines a pivot in the fibre array frame, 1/16 nm.
    ///
    /// # Errors
    /// 107 with no calibration, -222 beyond 60 mm from a rotary axis, -221 for number 0, 104 while the pivot is in
    /// use and the stage moves.
    pub fn define_pivot(&mut self, number: u8, point: [i32; 3]) -> Result<(), Error> {
        let calibration = self.calibration()?;
        if number == 0 {
            return Err(Error::text(ErrorNumber::SettingsConflict, "pivot 0 is the calibration's own"));
        }
        if largest_lever_nm(calibration, point) > LEVER_LIMIT_NM {
            return Err(Error::text(ErrorNumber::DataOutOfRange, "pivot beyond 60 mm from a rotary axis"));
        }
        let in_use = self.pivot == number;
        if in_use {
            self.standstill()?;
        }
        if let Some(place) = self.pivots.get_mut(usize::from(number)) {
            *place = Some(point);
        }
        if in_use { self.change_law() } else { Ok(()) }
    }

    /// Selects a pivot; nothing moves, the logical position is recomputed.
    ///
    /// # Errors
    /// 104 while moving, 107 with no calibration, -221 for a pivot that is not defined.
    pub fn select_pivot(&mut self, number: u8) -> Result<(), Error> {
        self.calibration()?;
        self.standstill()?;
        if number != 0 && self.pivots.get(usize::from(number)).is_none_or(Option::is_none) {
            return Err(Error::text(ErrorNumber::SettingsConflict, "pivot not defined"));
        }
        self.pivot = number;
        self.change_law()
    }

    /// The selected pivot and its point in the fibre array frame, 1/16 nm.
    ///
    /// # Errors
    /// 107 with no calibration.
    pub fn pivot(&self) -> Result<(u8, [i32; 3]), Error> {
        Ok((self.pivot, self.pivot_point(self.calibration()?)))
    }

    /// A pivot, whether selected or not, in the fibre array frame, 1/16 nm.
    ///
    /// # Errors
    /// 107 with no calibration, -221 for a pivot that is not defined.
    pub fn defined_pivot(&self, number: u8) -> Result<[i32; 3], Error> {
        let calibration = self.calibration()?;
        match self.pivots.get(usize::from(number)) {
            Some(Some(point)) if number != 0 => Ok(*point),
            _ if number == 0 => Ok(calibration.fibre_point),
            _ => Err(Error::text(ErrorNumber::SettingsConflict, "pivot not defined")),
        }
    }

    /// CRC-32 of the block as loaded.
    ///
    /// # Errors
    /// 107 with nothing loaded.
    pub fn block_crc(&self) -> Result<u32, Error> {
        self.block().map(Calibration::crc)
    }

    /// Step size that the calibration gives, Q32 nm or nrad.
    pub fn default_step_q32(&self, axis: Axis) -> Option<u64> {
        self.calibration.map(|c| c.motors[axis.index()].step_q32)
    }

    fn pivot_point(&self, calibration: &Calibration) -> [i32; 3] {
        match self.pivots.get(usize::from(self.pivot)) {
            Some(Some(point)) if self.pivot != 0 => *point,
            _ => calibration.fibre_point,
        }
    }

    /// Puts the law in force that calibration, switches and pivot ask for.
    fn change_law(&mut self) -> Result<(), Error> {
        let law = match &self.calibration {
            Some(calibration) => Law::new(calibration, self.settings.switches, self.pivot_point(calibration)),
            None => Law::identity(&self.motors()),
        };
        self.capability.law = law;
        self.order(Action::Law(law))?;
        self.refresh_plays()?;
        self.stand_at(self.report.final_steps);
        Ok(())
    }

    /// Pulse timing and sense of the motors; no motor moves.
    ///
    /// # Errors
    /// 104 while moving, -221 when a motor's velocity needs more steps per second than the timing allows, or when
    /// the times are too long.
    pub fn set_pulses(&mut self, settings: &Settings) -> Result<(), Error> {
        self.standstill()?;
        let timing = Timing::new(settings.axes.map(|a| a.timing))
            .ok_or(Error::text(ErrorNumber::DataOutOfRange, "pulse times above 32 us, or set-up or hold above 128 us"))?
            .with_inverted(settings.axes.map(|a| a.inverted));
        let ceiling = u64::from(timing.max_step_rate());
        for (axis, motor) in Axis::ALL.into_iter().zip(self.motors()) {
            if step_rate(motor.velocity, motor.step_q32) > ceiling {
                return Err(Error {
                    number: ErrorNumber::SettingsConflict,
                    detail: Detail::AxisText(axis, "step rate above what the pulse timing allows"),
                });
            }
        }
        self.order(Action::Pulses(timing))?;
        self.timing = timing;
        self.settings.axes = settings.axes;
        Ok(())
    }

    /// Takes over settings of axes: rates and limits at any time, backlash width and mode at standstill.
    ///
    /// # Errors
    /// 104 when backlash width, mode or reserve change while moving.
    pub fn set_axes(&mut self, settings: &Settings) -> Result<(), Error> {
        let reserve = |s: &Settings| s.axes.map(|a| (a.backlash.mode, a.backlash.distance, a.backlash.velocity));
        if reserve(settings) != reserve(&self.settings) {
            self.standstill()?;
        }
        self.settings.axes = settings.axes;
        self.refresh_plays()
    }

    /// Step size of a motor while no calibration is loaded; the motor stays where it is.
    ///
    /// # Errors
    /// -221 with a calibration loaded, 104 while moving.
    pub fn set_step(&mut self, axis: Axis, step_q32: u64) -> Result<(), Error> {
        if self.calibration.is_some() {
            return Err(Error::text(ErrorNumber::SettingsConflict, "the calibration gives the step size"));
        }
        self.standstill()?;
        let old = self.settings;
        self.settings.axes[axis.index()].step_q32 = step_q32;
        let ceiling = u64::from(self.timing.max_step_rate());
        if step_rate(self.motors()[axis.index()].velocity, step_q32) > ceiling {
            self.settings = old;
            return Err(Error::axis(ErrorNumber::SettingsConflict, axis));
        }
        self.change_law()
    }

    /// All settings to their defaults; calibration, home and limits stay, nothing moves.
    pub fn reset(&mut self) {
        self.abort();
        let fresh = Settings::defaults(self.calibration.as_ref());
        for (own, new) in self.settings.axes.iter_mut().zip(&fresh.axes) {
            let limits = (own.soft_lower, own.soft_upper, own.soft_on);
            let step = own.step_q32;
            *own = *new;
            (own.soft_lower, own.soft_upper, own.soft_on) = limits;
            own.step_q32 = step;
        }
        self.settings.override_percent = fresh.override_percent;
        self.settings.jog_timeout_ms = fresh.jog_timeout_ms;
        self.settings.switches = fresh.switches;
        self.pivot = 0;
        self.pivots = [None; PIVOTS];
        if self.abort == Abort::None {
            let _ = self.set_pulses(&fresh_pulses(&self.settings, &fresh)).and_then(|()| self.change_law());
        } else {
            self.settings = fresh_pulses(&self.settings, &fresh);
            self.reset_due = true;
        }
    }

    /// What follows from the settings for planning.
    fn refresh(&mut self) {
        let motors = self.motors();
        for (i, own) in self.settings.axes.iter().enumerate() {
            let motor = &motors[i];
            self.capability.motors[i] = settings::motor_rates(motor).less(own.reserve(motor, self.report.overlay[i]));
            self.capability.wanted[i] = own.wanted();
            self.capability.limits.0[i] = AxisLimits {
                soft_lower: own.soft_lower,
                soft_upper: own.soft_upper,
                soft_on: own.soft_on,
                travel_lower: motor.travel_lower,
                travel_upper: motor.travel_upper,
                homed: self.homed[i],
                enabled: self.enabled[i],
            };
        }
        self.capability.override_percent = self.settings.override_percent;
    }

    /// The same, and the generator's backlash configuration.
    fn refresh_plays(&mut self) -> Result<(), Error> {
        self.refresh();
        let motors = self.motors();
        for (i, motor) in motors.iter().enumerate() {
            let config = self.settings.axes[i].play(motor, self.settings.switches, self.report.overlay[i]);
            self.order(Action::Play { motor: i as u8, config })?;
        }
        Ok(())
    }

    // ---- flanks ----

    /// Homed at zero on the reference flank, enabled: how host-sim begins.
    pub fn assume_homed(&mut self) {
        self.homed = [true; AXES];
        self.enabled = [true; AXES];
        self.uncertain = [false; AXES];
        for motor in 0..AXES as u8 {
            let _ = self.order(Action::Flank { motor, flank: Some(Flank::Positive) });
        }
        self.refresh();
    }

    /// Takes up the play of a motor towards a flank by moving away from it and back; afterwards it is known.
    ///
    /// # Errors
    /// 104 while moving, 108 disabled, -222 when the way leaves the travel.
    pub fn preload(&mut self, axis: Axis, flank: Flank) -> Result<(), Error> {
        self.standstill()?;
        let i = axis.index();
        let back = self.commanded();
        let mut steps = self.capability.law.steps(back);
        steps.0[i] = steps.0[i].wrapping_sub(flank.sign().wrapping_mul(self.clearance(axis)));
        let away = self.capability.law.forward(steps);
        self.planner.check(&self.capability, back, away)?;
        self.planner.go(away, None);
        self.preload = Some(Preload::Away { axis, flank, back });
        Ok(())
    }

    fn continue_preload(&mut self) {
        let at_rest = !self.planner.is_moving() && self.report.settled && self.report.answered == self.sequence;
        match self.preload {
            Some(Preload::Away { axis, flank, back }) if at_rest => {
                // having come this far, it rests on the other flank for certain
                let known = Action::Flank { motor: axis.index() as u8, flank: Some(flank.opposite()) };
                if self.order(known).is_ok() {
                    self.planner.go(back, None);
                    self.preload = Some(Preload::Back);
                }
            }
            Some(Preload::Back) if at_rest => self.preload = None,
            _ => {}
        }
    }

    /// Backlash mode of a motor.
    pub fn backlash_mode(&self, axis: Axis) -> BacklashMode {
        self.settings.axes[axis.index()].backlash.mode
    }
}

impl Default for Front {
    fn default() -> Self {
        Front::new()
    }
}

const NO_LIMITS: AxisLimits = AxisLimits {
    soft_lower: 0,
    soft_upper: 0,
    soft_on: false,
    travel_lower: 0,
    travel_upper: 0,
    homed: false,
    enabled: false,
};

/// The settings with the pulse times and senses of the fresh ones.
fn fresh_pulses(own: &Settings, fresh: &Settings) -> Settings {
    let mut settings = *own;
    for (to, from) in settings.axes.iter_mut().zip(&fresh.axes) {
        (to.timing, to.inverted) = (from.timing, from.inverted);
    }
    settings
}

/// Steps per second, rounded up.
fn step_rate(velocity: u64, step_q32: u64) -> u64 {
    (u128::from(velocity) << 32).div_ceil(u128::from(step_q32.max(1))).min(u128::from(u64::MAX)) as u64
}

/// nm/s to nm per segment in Q44.
fn settings_speed(velocity: u64) -> u64 {
    crate::motion::budget::Rates::per_segment(velocity, 1, 1, 1 << 32).velocity
}

/// Steps per segment in Q44 to steps per second.
fn per_second_q44(rate: u64) -> u64 {
    ((u128::from(rate) * 1_000_000_000 / u128::from(SEGMENT_NS)) >> 44) as u64
}
