//! What stops motion from outside: limit switches, drivers in fault, the emergency stop, a board in trouble.
//!
//! # Design
//! Whoever owns the step output judges the inputs by [`Front::watch`] and stops; the front hears of it by the next
//! report, tells all links why, and refuses what would go on the same way. Every event is kept as a bit until it has
//! been told: none is lost, and none is told twice.

use super::Front;
use super::homing::switch_text;
use crate::error::{Error, ErrorNumber};
use crate::refill::safety::{Cause, Watch};
use crate::settings::{Side, Wiring};
use crate::units::{AXES, Axis, Pose};

/// What the firmware found out about its board; see [`Front::set_health`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Health {
    /// The crystal does not run: the clock comes from the internal oscillator.
    pub internal_oscillator: bool,
    /// The watchdog has restarted the board.
    pub watchdog: bool,
}

impl Health {
    /// What every link is told once after a start.
    pub fn errors(self) -> impl Iterator<Item = Error> {
        let all = [
            (self.watchdog, ErrorNumber::WatchdogRestart, "the controller did not answer; position not homed"),
            (self.internal_oscillator, ErrorNumber::Clock, CLOCK),
        ];
        all.into_iter().filter(|(set, ..)| *set).map(|(_, number, text)| Error::text(number, text))
    }
}

const CLOCK: &str = "the crystal does not run, rates are off by up to 1 %";

/// Where the emergency stop stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum EmergencyStop {
    /// Motion is allowed.
    #[default]
    Armed,
    /// It was pressed.
    Latched,
    /// `SYSTem:ESTop:CLEar` was given; the board is still to say that it is armed.
    Rearming,
}

/// What the links are still to be told; bit n belongs to motor n.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Events {
    lower: u8,
    upper: u8,
    fault: u8,
    stop: bool,
    deadline: bool,
    output: bool,
    clock: bool,
    /// A homing ended without a reference.
    pub homing: Option<Error>,
    /// A scan ended without a result.
    pub scan: Option<Error>,
}

impl Events {
    fn take(&mut self) -> Option<Error> {
        let first = |mask: &mut u8| {
            let axis = Axis::from_index(mask.trailing_zeros() as usize)?;
            *mask &= *mask - 1;
            Some(axis)
        };
        let named = |number, axis, text| Some(Error::axis_text(number, axis, text));
        if core::mem::take(&mut self.stop) {
            return Some(Error::text(ErrorNumber::EmergencyStop, "latched; close the contact, then SYST:EST:CLE"));
        }
        if let Some(axis) = first(&mut self.lower) {
            return named(ErrorNumber::LimitSwitch, axis, switch_text(Side::Lower));
        }
        if let Some(axis) = first(&mut self.upper) {
            return named(ErrorNumber::LimitSwitch, axis, switch_text(Side::Upper));
        }
        if let Some(axis) = first(&mut self.fault) {
            return named(ErrorNumber::DriverFault, axis, "driver disabled");
        }
        if core::mem::take(&mut self.deadline) {
            return Some(Error::text(ErrorNumber::StepDeadline, "all motors stopped, counts are exact"));
        }
        if core::mem::take(&mut self.output) {
            return Some(Error::text(ErrorNumber::StepDeadline, "step output failed; home the axes again"));
        }
        if core::mem::take(&mut self.clock) {
            return Some(Error::text(ErrorNumber::Clock, CLOCK));
        }
        self.homing.take().or_else(|| self.scan.take())
    }
}

impl Front {
    // ---- for whoever owns the board ----

    /// What the inputs are watched for; whoever owns the step output judges them by it. Fault lines count for drivers
    /// that are enabled.
    pub fn watch(&self) -> Watch {
        self.watch
    }

    /// What the inputs are to be watched for by the settings.
    pub(super) fn refresh_watch(&mut self) {
        let mut watch = Watch::default();
        for (i, (own, on)) in self.settings.axes.iter().zip(self.enabled).enumerate() {
            let Wiring { limits_on, limits_high, fault_high, .. } = own.wiring;
            watch.limits |= u8::from(limits_on) << i;
            watch.limits_high |= u8::from(limits_high) << i;
            watch.faults |= u8::from(on) << i;
            watch.faults_high |= u8::from(fault_high) << i;
        }
        self.watch = watch;
    }

    /// Levels of the enable lines; bit n set: the line of driver n is high.
    #[inline(never)]
    pub fn enable_lines(&self) -> u8 {
        let lines = self.settings.axes.iter().zip(self.enabled).enumerate();
        lines.fold(0, |levels, (i, (own, on))| levels | u8::from(on == own.wiring.enable_high) << i)
    }

    /// The same with all drivers disabled: what a board falls back to.
    pub fn disabled_lines(&self) -> u8 {
        let lines = self.settings.axes.iter().enumerate();
        lines.fold(0, |levels, (i, own)| levels | u8::from(!own.wiring.enable_high) << i)
    }

    /// True once when the step output is to be armed again after an emergency stop.
    pub fn take_rearm(&mut self) -> bool {
        core::mem::take(&mut self.rearm)
    }

    /// What the firmware found out about its board. Call it before the links are polled for the first time: each link
    /// is told the errors once, when it is open for the first time after the start.
    pub fn set_health(&mut self, health: Health) {
        self.health = health;
    }

    /// What the firmware found out about its board.
    pub fn health(&self) -> Health {
        self.health
    }

    /// The crystal has failed on the way: the board goes on with its internal oscillator.
    pub fn report_clock_fault(&mut self) {
        self.events.clock |= !self.health.internal_oscillator;
        self.health.internal_oscillator = true;
    }

    /// An error of a motion that had been accepted, or something that happened to the machine; once. For all links.
    pub fn take_late_error(&mut self) -> Option<Error> {
        self.late_error.take().or_else(|| self.events.take())
    }

    // ---- state ----

    /// Limit switches that are active, watched or not: lower and upper ones, bit n of motor n.
    pub fn active_switches(&self) -> (u8, u8) {
        let active = self.watch().active(self.report.inputs);
        (active.lower, active.upper)
    }

    /// The same of those that are watched.
    pub(super) fn watched_switches(&self) -> (u8, u8) {
        let watch = self.watch();
        let active = watch.active(self.report.inputs);
        (active.lower & watch.limits, active.upper & watch.limits)
    }

    /// Drivers whose fault line is active, bit n of motor n.
    pub fn driver_faults(&self) -> u8 {
        self.watch().active(self.report.inputs).fault
    }

    /// The emergency stop is latched.
    pub fn is_stopped(&self) -> bool {
        self.emergency_stop != EmergencyStop::Armed
    }

    /// The contact of the emergency stop is open.
    pub fn stop_contact_open(&self) -> bool {
        self.report.inputs.stop
    }

    /// Steps have been missed since the last move began.
    pub fn missed_deadline(&self) -> bool {
        self.missed_deadline
    }

    /// Arms the step output again after an emergency stop; without one it does nothing.
    ///
    /// # Errors
    /// 103 while the contact is open.
    pub fn clear_stop(&mut self) -> Result<(), Error> {
        if self.report.inputs.stop {
            return Err(Error::text(ErrorNumber::EmergencyStop, "contact open"));
        }
        if self.emergency_stop == EmergencyStop::Latched {
            self.emergency_stop = EmergencyStop::Rearming;
            self.rearm = true;
        }
        Ok(())
    }

    // ---- what motion is refused for ----

    /// # Errors
    /// 103 while the emergency stop is latched.
    pub(super) fn armed(&self) -> Result<(), Error> {
        if self.is_stopped() {
            return Err(Error::text(ErrorNumber::EmergencyStop, "latched; SYST:EST:CLE arms again"));
        }
        Ok(())
    }

    /// A way that ends at `to` must not lead a motor towards its active switch from where it stands.
    ///
    /// # Errors
    /// 102 with the axis and the switch.
    pub(super) fn check_switches(&self, to: Pose) -> Result<(), Error> {
        let (lower, upper) = self.watched_switches();
        if lower | upper == 0 {
            return Ok(());
        }
        let (now, then) = (self.report.final_steps, self.capability.law.steps(to));
        for axis in Axis::ALL {
            let i = axis.index();
            let way = then.0[i].wrapping_sub(now.0[i]);
            let side = if way < 0 { Side::Lower } else { Side::Upper };
            let active = if way < 0 { lower } else { upper };
            if way != 0 && active >> i & 1 != 0 {
                return Err(Error::axis_text(ErrorNumber::LimitSwitch, axis, switch_text(side)));
            }
        }
        Ok(())
    }

    // ---- what a report says ----

    /// The step output was stopped: events and conditions of it. `asked`: by an abort of the front.
    pub(super) fn halted(&mut self, asked: bool) {
        let halt = self.report.halt;
        if !asked {
            // what was still unanswered may have been running
            self.planner.answer(self.report.answered, self.report.refused, self.report.begun, 0);
            self.judge_speeds(self.report.halted);
        }
        match halt.cause {
            Cause::Requested => {}
            Cause::Limit if self.is_expected(&halt) => {}
            Cause::Limit => {
                self.events.lower |= halt.lower;
                self.events.upper |= halt.upper;
            }
            Cause::DriverFault => {
                for i in (0..AXES).filter(|i| halt.fault >> i & 1 != 0) {
                    // stopped again before it was known to be disabled
                    self.events.fault |= u8::from(self.enabled[i]) << i;
                    self.enabled[i] = false;
                    // without current nothing holds the motor
                    self.uncertain[i] = true;
                }
            }
            Cause::EmergencyStop => self.latch(),
            Cause::Deadline => {
                self.events.deadline = true;
                self.missed_deadline = true;
            }
            Cause::Output => {
                self.events.output = true;
                self.missed_deadline = true;
                // nobody knows what was played of the last segment
                if asked || self.planner.is_running() {
                    self.uncertain = [true; AXES];
                }
            }
        }
    }

    fn latch(&mut self) {
        self.events.stop |= self.emergency_stop != EmergencyStop::Latched;
        self.emergency_stop = EmergencyStop::Latched;
        self.rearm = false;
    }

    /// Follows the emergency stop by what the latest report says.
    pub(super) fn follow_stop(&mut self) {
        match self.emergency_stop {
            EmergencyStop::Armed if self.report.latched => self.latch(),
            EmergencyStop::Rearming if !self.report.latched => {
                self.emergency_stop = EmergencyStop::Armed;
                self.forget_samples();
            }
            EmergencyStop::Rearming if self.report.inputs.stop => {
                self.emergency_stop = EmergencyStop::Latched;
                self.rearm = false;
            }
            _ => {}
        }
    }

    /// True while the board is still to say that it is armed again.
    pub(super) fn is_rearming(&self) -> bool {
        self.emergency_stop == EmergencyStop::Rearming
    }
}
