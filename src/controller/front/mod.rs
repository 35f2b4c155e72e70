//! The front: plans, checks, keeps settings and answers questions. Runs in the thread executor.
//!
//! # Design
//! It never touches a word. What it knows of the motion comes from the latest [`Report`]; what it wants goes down as
//! [`Order`](crate::refill::border::Order)s. Changes of the law, of counts and of pulses happen at standstill only and
//! leave every motor where it is: the logical pose is recomputed by the forward map.

mod calibration;
mod compare;
mod dry_run;
mod flanks;
mod homing;
mod light;
mod motion;
mod orders;
mod safety;
mod scan;
mod sense;
mod standstill;
mod storage;

use compare::Comparing;
pub use dry_run::Check;
use flanks::Preload;
use homing::Homing;
pub use homing::{REFERENCE_NM, REFERENCE_NRAD, SLOW_STEP_US};
use light::Lent;
pub use light::LightMemory;
use orders::{Waiting, WaitingOrder};
pub use safety::Health;
use safety::{EmergencyStop, Events};
use sense::Sense;
pub use sense::{Format, Trigger};
use storage::Storage;
pub use storage::{Start, StorageRequest};

use crate::compensation::backlash::{Flank, PlayConfig};
use crate::compensation::calibration::{BLOCK_CAPACITY, Calibration, MotorData};
use crate::compensation::law::Law;
use crate::error::{Error, ErrorNumber};
use crate::motion::limits::{AxisLimits, Limits};
use crate::motion::planner::{Capability, Ordered, Planner, Versioned};
use crate::refill::border::Report;
use crate::refill::safety::{Inputs, Watch};
use crate::scan::status;
use crate::settings::{self, Settings};
use crate::stepgen::timing::Timing;
use crate::units::{AXES, Axis, MotorSteps, Pose, SEGMENT_TICKS, wide};

/// Pivots that can be kept; number 0 is the calibration's own fibre point.
pub const PIVOTS: usize = 8;
/// Farthest that a pivot may lie from a rotary axis, nm.
pub const LEVER_LIMIT_NM: u64 = 60_000_000;
/// Orders that may wait to be taken to the generator.
pub const ORDERS: usize = 24;
/// Orders that may be unanswered: a report tells the fate of the last 32.
const UNANSWERED: u16 = 31;
/// Segments between the last generated one and the first that a new track may use; more after a refusal: planning takes
/// its time, and a track that comes too late has to be planned anew.
const LEAD: u64 = 1;
/// An answer within this many segments (2 ms) is late by the way of orders and reports; what takes longer is planning.
const QUICK: u64 = 8;
/// 33 ms, longer than a plan takes.
const LEAD_MAX: u64 = 128;

/// Condition of an axis, bits as in STATus:AXIS.
#[allow(missing_docs)]
pub mod axis_condition {
    pub const MOVING: u16 = 1 << 0;
    pub const HOMED: u16 = 1 << 1;
    pub const FLANK_KNOWN: u16 = 1 << 2;
    pub const TAKE_UP: u16 = 1 << 3;
    pub const SOFT_LOW: u16 = 1 << 4;
    pub const SOFT_HIGH: u16 = 1 << 5;
    pub const HARD_LOW: u16 = 1 << 6;
    pub const HARD_HIGH: u16 = 1 << 7;
    pub const ENABLED: u16 = 1 << 8;
    pub const DRIVER_FAULT: u16 = 1 << 9;
    pub const UNCERTAIN: u16 = 1 << 10;
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
///
/// What is small comes first, in the order that is written: one instruction reaches 4 KB from the front's address.
#[repr(C)]
pub struct Front {
    sequence: u16,
    abort: Abort,
    pivot: u8,
    homed: [bool; AXES],
    enabled: [bool; AXES],
    uncertain: [bool; AXES],
    jog_links: [Option<u8>; AXES],
    /// The board is still to be told to arm the step output.
    rearm: bool,
    missed_deadline: bool,
    /// Settings were set back during an abort: what follows from them is still to be ordered.
    reset_due: bool,
    health: Health,
    watch: Watch,
    preload: Option<Preload>,
    /// The last order that takes effect at once, while unanswered: nothing is planned before it is.
    hold: Option<u16>,
    emergency_stop: EmergencyStop,
    lead: u64,
    /// The segment that was to be generated next when planning last began.
    planned_from: u64,
    /// Where the motors stand by an anchor that is not answered yet.
    anchor: Option<Anchored>,
    homing: Option<Homing>,
    /// A motion that was accepted and turned out to break a limit.
    late_error: Option<Error>,
    report: Report,
    sense: Sense,
    comparing: Comparing,
    events: Events,
    storage: Storage,
    pivots: [Option<[i32; 3]>; PIVOTS],
    /// Settings in force.
    pub(super) settings: Settings,
    capability: Versioned<Capability>,
    /// Backlash configurations that the generator has been told.
    told: [Option<PlayConfig>; AXES],
    timing: Timing,
    calibration: Option<Calibration>,
    orders: heapless::Deque<WaitingOrder, ORDERS>,
    block: heapless::Vec<u8, BLOCK_CAPACITY>,
    planner: Planner,
    light: Lent,
}

// Most of it is the planner's slots. It lives in static memory, of which the board has 64 KB for everything.
const _: () = assert!(size_of::<Front>() - size_of::<Lent>() <= 22 * 1024);
// Beside it, for what is seen of the light.
const _: () = assert!(size_of::<LightMemory>() <= 39 * 1024);

/// Counts without overlay that were named at standstill, and the order that says so.
#[derive(Clone, Copy, Debug)]
struct Anchored {
    steps: MotorSteps,
    sequence: u16,
}

fn refuse(number: ErrorNumber) -> Error {
    number.into()
}

impl Front {
    /// Like a board after power-up, without a calibration: not homed, disabled.
    pub fn new() -> Self {
        let mut front = Self::without_limits();
        front.refresh();
        front
    }

    /// The same in its place: a front is too large to be moved about on the stack of a board.
    #[inline(never)]
    pub fn new_in(place: &mut core::mem::MaybeUninit<Self>) -> &mut Self {
        let front = place.write(Self::without_limits());
        front.refresh();
        front
    }

    #[inline(always)] // so that it is on the stack once
    fn without_limits() -> Self {
        let settings = Settings::defaults(None);
        let motors = settings::motors(None, Some(&settings));
        let law = Law::identity(&motors);
        Front {
            calibration: None,
            block: heapless::Vec::new(),
            settings,
            pivots: [None; PIVOTS],
            pivot: 0,
            capability: Versioned::new(Capability {
                law,
                motors: motors.map(|m| settings::motor_rates(&m)),
                wanted: settings.axes.map(|a| a.wanted()),
                limits: Limits([NO_LIMITS; AXES]),
                override_percent: 100,
            }),
            timing: Timing::default(),
            planner: Planner::at_rest(Pose::default()),
            // lines that are pulled up, until they are known
            report: Report { settled: true, inputs: Inputs { fault: 0x3f, ..Inputs::default() }, ..Report::default() },
            sense: Sense::default(),
            light: Lent::default(),
            comparing: Comparing::default(),
            sequence: 0,
            lead: LEAD,
            planned_from: 0,
            orders: heapless::Deque::new(),
            homed: [false; AXES],
            enabled: [false; AXES],
            uncertain: [false; AXES],
            abort: Abort::None,
            preload: None,
            homing: None,
            events: Events::default(),
            health: Health::default(),
            emergency_stop: EmergencyStop::default(),
            rearm: false,
            missed_deadline: false,
            watch: Watch::default(),
            jog_links: [None; AXES],
            late_error: None,
            hold: None,
            anchor: None,
            told: [None; AXES],
            reset_due: false,
            storage: Storage::default(),
        }
    }

    /// The law and the timing with which the generator must begin.
    pub fn generator_setup(&self) -> (Law, Timing) {
        (self.capability.law, self.timing)
    }

    // ---- the border ----

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
            let asked = self.abort != Abort::None;
            self.halted(asked);
            let homing_goes_on = self.homing_outlives(asked);
            self.abort = Abort::None;
            self.orders.clear();
            self.preload = None;
            self.jog_links = [None; AXES];
            // what was ordered while it moved may be lost
            self.told = [None; AXES];
            self.end_scan(if asked { status::STOPPED } else { status::FAILED });
            if self.homing.is_some() && !homing_goes_on {
                self.end_homing(None);
            } else {
                let _ = self.refresh_plays();
                self.stand_at(report.final_steps);
            }
            if core::mem::take(&mut self.reset_due) {
                let settings = self.settings;
                let _ = self.set_pulses(&settings).and_then(|()| self.change_law());
            }
        }
        self.follow_compare(&report, aborted);
        self.follow_stop();
        let answered = |sequence: u16| report.answered.wrapping_sub(sequence) < 0x8000;
        self.hold = self.hold.filter(|sequence| !answered(*sequence));
        self.anchor = self.anchor.filter(|anchor| !answered(anchor.sequence));
        self.show_anchor();
        self.storage.answered(answered);
        if self.planner.answer(report.answered, report.refused, report.begun, report.next) {
            let taken = report.next.saturating_sub(self.planned_from);
            let needed = if taken < QUICK { 0 } else { taken + taken / 4 };
            self.lead = (self.lead * 2).max(needed).min(LEAD_MAX);
        }
    }

    /// Lets the report say what an anchor says, until the generator has seen it.
    pub(super) fn show_anchor(&mut self) {
        let Some(anchor) = self.anchor else { return };
        let report = &mut self.report;
        (report.steps, report.final_steps) = (anchor.steps, anchor.steps);
        for (count, (steps, overlay)) in report.counts.0.iter_mut().zip(anchor.steps.0.iter().zip(&report.overlay)) {
            *count = steps.wrapping_add(*overlay);
        }
    }

    /// Plans what is to be planned. Call after every report and after every command.
    pub fn plan(&mut self) {
        if self.abort != Abort::None || self.hold.is_some() {
            return;
        }
        self.continue_preload();
        self.continue_homing();
        self.continue_scan();
        if self.hold.is_some() {
            return;
        }
        if !self.planner.is_moving() {
            // not sooner: a track that ends within the lead counts as ended, and still runs in the generator
            if self.report.settled && self.report.answered == self.sequence {
                self.lead = LEAD;
            }
            return;
        }
        let segment = self.report.next + self.lead;
        let (orders, sequence, aborts) = (&mut self.orders, &mut self.sequence, self.report.aborts);
        let answered = self.report.answered;
        let planned_from = self.report.next;
        let stands = self.report.settled && answered == *sequence;
        let result = self.planner.plan(&self.capability, segment, &mut |proposal| {
            self.planned_from = planned_from;
            if sequence.wrapping_sub(answered) >= UNANSWERED {
                return None;
            }
            *sequence = sequence.wrapping_add(1);
            let action = Waiting::Run { slot: proposal.slot };
            let at_once = proposal.alone && stands;
            let segment = (!at_once).then_some(proposal.segment);
            let order = WaitingOrder { sequence: *sequence, segment, aborts, action };
            orders.push_back(order).ok().map(|()| Ordered { sequence: *sequence, at_once })
        });
        if let Err(error) = result {
            self.late_error = Some(error);
            self.preload = None;
            self.end_homing(None);
            self.end_scan(status::FAILED);
        }
        if self.planner.is_running() {
            self.missed_deadline = false;
        }
    }

    fn order(&mut self, action: Waiting) -> Result<(), Error> {
        self.sequence = self.sequence.wrapping_add(1);
        let order = WaitingOrder { sequence: self.sequence, segment: None, aborts: self.report.aborts, action };
        self.orders.push_back(order).map_err(|_| Error::text(ErrorNumber::Moving, "orders still on their way"))?;
        self.hold = Some(self.sequence);
        Ok(())
    }

    // ---- state ----

    /// True while motion or take-up goes on, or is still to begin, or settings are being saved: what `*OPC` waits for.
    pub fn operation_pending(&self) -> bool {
        self.motion_pending() || self.storage.is_pending()
    }

    fn motion_pending(&self) -> bool {
        self.is_moving()
            || self.abort != Abort::None
            || self.preload.is_some()
            || self.homing.is_some()
            || self.is_scanning()
            || self.is_rearming()
            || !self.orders.is_empty()
            || self.report.answered != self.sequence
    }

    /// Orders that the generator has not answered yet.
    fn unanswered(&self) -> u16 {
        self.sequence.wrapping_sub(self.report.answered)
    }

    /// True while orders are on their way that a further change must wait for.
    pub fn is_busy_at_the_border(&self) -> bool {
        self.abort != Abort::None
            || self.is_rearming()
            || self.unanswered() > UNANSWERED - 2 * AXES as u16
            || self.planner.is_about_to_stop()
    }

    /// True until everything that moves, or waits to move, has come to rest in the words played.
    pub fn is_moving(&self) -> bool {
        self.planner.is_moving() || !self.report.settled
    }

    fn standstill(&self) -> Result<(), Error> {
        if self.is_moving()
            || self.abort != Abort::None
            || self.preload.is_some()
            || self.homing.is_some()
            || self.is_scanning()
        {
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
        if self.homing.is_some() {
            return self.real_law().forward(self.report.steps);
        }
        self.capability.law.forward(self.report.steps)
    }

    /// Where the axes are at last to stand; a jog has no target, and is where it is. While an axis is homed, where its
    /// present way ends.
    pub fn commanded(&self) -> Pose {
        let commanded = self.planner.commanded(self.report.next);
        if self.homing.is_some() {
            return self.real_law().forward(self.capability.law.steps(commanded));
        }
        commanded
    }

    /// Motor counts really played, overlay included.
    pub fn motor_counts(&self) -> MotorSteps {
        self.report.counts
    }

    /// Condition bits of an axis.
    pub fn axis_condition(&self, axis: Axis) -> u16 {
        self.axis_conditions()[axis.index()]
    }

    /// Condition bits of all axes.
    pub fn axis_conditions(&self) -> [u16; AXES] {
        let watch = self.watch();
        let active = watch.active(self.report.inputs);
        let active = Inputs { lower: active.lower & watch.limits, upper: active.upper & watch.limits, ..active };
        let moving = self.report.moving | self.planner.moving_axes();
        let rest = self.planner.rest().rounded();
        core::array::from_fn(|i| self.condition_of(i, active, moving, rest.0[i]))
    }

    /// `active`: inputs that count; `moving`: bit n of axis n; `position`: where the axis stands by command.
    fn condition_of(&self, i: usize, active: Inputs, moving: u8, position: i32) -> u16 {
        use axis_condition::*;
        let bit = |set: bool, bit: u16| if set { bit } else { 0 };
        let at = |mask: u8| mask >> i & 1 != 0;
        let limits = &self.capability.limits.0[i];
        let moving = at(moving);
        // by command: what is played is the nearest step of it
        let watched = limits.soft_on && limits.homed && !moving && self.homing.is_none();
        bit(moving, MOVING)
            | bit(self.homed[i], HOMED)
            | bit(at(self.report.known) && !at(self.report.owing), FLANK_KNOWN)
            | bit(at(self.report.taking_up), TAKE_UP)
            | bit(watched && position <= limits.soft_lower, SOFT_LOW)
            | bit(watched && position >= limits.soft_upper, SOFT_HIGH)
            | bit(at(active.lower), HARD_LOW)
            | bit(at(active.upper), HARD_HIGH)
            | bit(self.enabled[i], ENABLED)
            | bit(at(active.fault), DRIVER_FAULT)
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

    /// Data of one motor.
    #[inline(never)]
    pub fn motor(&self, axis: Axis) -> MotorData {
        self.motors()[axis.index()]
    }

    /// True when a motor is enabled.
    pub fn is_enabled(&self, axis: Axis) -> bool {
        self.enabled[axis.index()]
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

/// Every motor's velocity must be within the steps per second that the pulse timing allows.
///
/// # Errors
/// -221 with the axis.
fn check_step_rates(timing: &Timing, motors: &[MotorData; AXES]) -> Result<(), Error> {
    let ceiling = u128::from(timing.max_step_rate());
    for (axis, motor) in Axis::ALL.into_iter().zip(motors) {
        if wide::div_up(u128::from(motor.velocity) << 32, u128::from(motor.step_q32.max(1))) > ceiling {
            return Err(Error::axis_text(
                ErrorNumber::SettingsConflict,
                axis,
                "step rate above what the pulse timing allows",
            ));
        }
    }
    Ok(())
}
