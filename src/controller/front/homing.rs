//! Homing an axis on a limit switch.
//!
//! # Design
//! Fast towards the switch until it stops the motors; back until it has opened, and a little farther; slowly towards it
//! again; then away from it to the reference point, which is reached in the positive direction, so that the play rests
//! on the reference flank. The reference lies [`REFERENCE_NM`] from the slow trip. Meanwhile the identity law is in
//! force and the overlay of the motor stands, so that exactly one motor turns; calibration, switches and pivot come
//! back at the end, whatever the end is. The states advance at rest only, from the reports.
//!
//! # Repeatability
//! In the slow approach a step takes [`SLOW_STEP_US`]. Stopping takes 20 us at most after the contact has opened, so
//! that no further step falls into it: the count at the stop is the one of the step that tripped the switch. What is
//! left is the switch's own scatter, and one step where that scatter meets a step.
//!
//! # Limitations
//! A switch that needs more than the reference distance to open again cannot be homed on (102).

use super::orders::Waiting;
use super::{Front, refuse};
use crate::compensation::backlash::Flank;
use crate::compensation::law::Law;
use crate::error::{Error, ErrorNumber};
use crate::motion::planner::Desire;
use crate::refill::safety::{Cause, Halt};
use crate::settings::Side;
use crate::units::steps::units_to_steps;
use crate::units::{Axis, COORDINATE_LIMIT, MotorSteps, SEGMENT_NS};

/// Distance of the reference point from the switch, nm: beyond what a snap-action switch takes to open again.
pub const REFERENCE_NM: i64 = 200_000;
/// The same of a rotary axis, nrad: 0.2 degrees.
pub const REFERENCE_NRAD: i64 = 3_490_659;
/// Time of a step in the slow approach: ten times the longest way from contact to stop.
pub const SLOW_STEP_US: u64 = 200;
/// Segments for which the switch must be open before it is approached again: 10 ms, longer than contacts bounce.
const QUIET_SEGMENTS: u64 = 10_000_000_u64.div_ceil(SEGMENT_NS);
/// Beyond the travel the switch is looked for over this part of it, besides twice the reference distance.
const BEYOND: i64 = 10;
/// Steps added to the backlash on the ways that must take it up.
const SLACK: i32 = 10;

/// What errors call the switch of a side.
pub(super) const fn switch_text(side: Side) -> &'static str {
    match side {
        Side::Lower => "lower limit switch",
        Side::Upper => "upper limit switch",
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// The identity law is on its way.
    Prepare,
    /// Fast towards the switch.
    Fast,
    /// Stopped by the switch, or begun on it.
    Tripped,
    /// Away from the switch.
    BackOff,
    /// At rest, the switch open since a segment.
    Quiet { since: u64 },
    /// Some way farther, so that the slow approach takes up the play.
    Clear,
    /// Slowly towards the switch.
    Slow,
    /// Stopped by it: the count that matters.
    Found { trip: i32 },
    /// Away from it, past the reference if that must be reached upwards.
    Leave { trip: i32 },
    /// To the reference.
    Return,
    /// Ends as soon as it stands.
    Stopping,
}

/// A homing on its way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Homing {
    axis: Axis,
    side: Side,
    phase: Phase,
    /// Velocity of the present phase, nm/s or nrad/s.
    velocity: u64,
    /// Count at which the switch was seen open.
    opened: i32,
}

impl Homing {
    /// The sign of a way towards the switch.
    fn towards(&self) -> i64 {
        match self.side {
            Side::Lower => -1,
            Side::Upper => 1,
        }
    }
}

impl Front {
    /// Homes an axis on the limit switch that `HOME:TYPE` names.
    ///
    /// # Errors
    /// 103 while the emergency stop is latched, -213 while a homing runs, 104 while moving, 108 disabled, -221 when the
    /// switches of the axis are not watched, 102 when both are active, -222 when the counts cannot be named without the
    /// calibration.
    pub fn home(&mut self, axis: Axis) -> Result<(), Error> {
        self.free_to_begin()?;
        let i = axis.index();
        let own = &self.settings.axes[i];
        if !self.enabled[i] {
            return Err(Error::axis(ErrorNumber::AxisDisabled, axis));
        }
        if !own.wiring.limits_on {
            return Err(Error::axis_text(
                ErrorNumber::SettingsConflict,
                axis,
                "limit switches not watched; set LIM:HARD:STAT ON",
            ));
        }
        let (lower, upper) = self.watched_switches();
        if lower & upper & 1 << i != 0 {
            return Err(Error::axis_text(ErrorNumber::LimitSwitch, axis, "both limit switches; see LIM:HARD:POL"));
        }
        let identity = Law::identity(&self.motors());
        self.check_standing(&identity)?;
        let (velocity, side) = (own.home.velocity, own.home.side);
        self.homing = Some(Homing { axis, side, phase: Phase::Prepare, velocity, opened: 0 });
        self.homed[i] = false;
        self.put_law(identity, self.report.final_steps)
    }

    /// The axis that is being homed.
    pub fn homing_axis(&self) -> Option<Axis> {
        self.homing.map(|homing| homing.axis)
    }

    /// # Errors
    /// -213 while a homing runs.
    pub(super) fn not_homing(&self) -> Result<(), Error> {
        match self.homing {
            Some(homing) => Err(Error::axis_text(ErrorNumber::InitIgnored, homing.axis, "homing")),
            None => Ok(()),
        }
    }

    pub(super) fn is_homing(&self, motor: usize) -> bool {
        self.homing.is_some_and(|homing| homing.axis.index() == motor)
    }

    /// What a homing changes of what planning goes by: no limit means anything, and the speed is its own.
    pub(super) fn refresh_homing(&mut self) {
        let Some(homing) = self.homing else { return };
        let i = homing.axis.index();
        let mut own = self.settings.axes[i];
        own.velocity = homing.velocity;
        self.capability.wanted[i] = own.wanted();
        self.capability.limits.0[i].homed = false;
    }

    /// A halt that a homing has waited for.
    pub(super) fn is_expected(&self, halt: &Halt) -> bool {
        self.homing.is_some_and(|homing| {
            let own = 1 << homing.axis.index();
            let hit = match homing.side {
                Side::Lower => (halt.lower, halt.upper) == (own, 0),
                Side::Upper => (halt.lower, halt.upper) == (0, own),
            };
            halt.cause == Cause::Limit && hit && matches!(homing.phase, Phase::Fast | Phase::Slow)
        })
    }

    /// After a halt, before the counts are named anew. True when the homing goes on.
    pub(super) fn homing_outlives(&mut self, asked: bool) -> bool {
        let expected = !asked && self.is_expected(&self.report.halt);
        let Some(homing) = &mut self.homing else { return false };
        let trip = self.report.final_steps.0[homing.axis.index()];
        homing.phase = match homing.phase {
            Phase::Fast => Phase::Tripped,
            _ => Phase::Found { trip },
        };
        expected
    }

    /// STOP of an axis: its homing ends as soon as it stands.
    pub(super) fn stop_homing(&mut self, axis: Axis) {
        if let Some(homing) = self.homing.as_mut().filter(|homing| homing.axis == axis) {
            homing.phase = Phase::Stopping;
        }
    }

    /// Ends a homing at rest: the law that calibration, switches and pivot ask for comes back. Does nothing without
    /// one.
    pub(super) fn end_homing(&mut self, error: Option<Error>) {
        let Some(homing) = self.homing.take() else { return };
        self.events.homing = error.or(self.events.homing);
        let law = self.real_law();
        let mut steps = self.report.final_steps;
        if !law.names(steps) {
            // it was not homed and stands beyond what the law can name: the count means nothing anyway
            steps.0[homing.axis.index()] = 0;
        }
        // the queue has room at rest
        let _ = self.put_law(law, steps);
    }

    /// Advances a homing; call it when no order is awaited.
    pub(super) fn continue_homing(&mut self) {
        let Some(homing) = self.homing else { return };
        let i = homing.axis.index();
        let (lower, upper) = self.watched_switches();
        let active = match homing.side {
            Side::Lower => lower,
            Side::Upper => upper,
        } >> i
            & 1
            != 0;
        let at = self.report.final_steps.0[i];
        if homing.phase == Phase::BackOff && !active {
            self.planner.stop(homing.axis);
            self.homing_phase(Phase::Quiet { since: u64::MAX }, at);
            return;
        }
        if self.planner.is_moving() || !self.report.settled || self.report.answered != self.sequence {
            return;
        }
        let named = |number, text| Some(Error::axis_text(number, homing.axis, text));
        let play = self.clearance(homing.axis).saturating_add(SLACK);
        let reference = self.reference_steps(homing.axis);
        match homing.phase {
            Phase::Prepare if !active => {
                self.homing_way(Phase::Fast, homing.towards() * self.search_steps(homing.axis))
            }
            Phase::Prepare | Phase::Tripped => {
                self.homing_way(Phase::BackOff, -homing.towards() * self.search_steps(homing.axis));
            }
            Phase::Fast => {
                let text = match homing.side {
                    Side::Lower => "lower limit switch not found within the travel and a tenth",
                    Side::Upper => "upper limit switch not found within the travel and a tenth",
                };
                self.end_homing(named(ErrorNumber::NotHomed, text));
            }
            Phase::BackOff => {
                self.end_homing(named(ErrorNumber::LimitSwitch, "limit switch does not open; see LIM:HARD:POL"));
            }
            // it closes again, or still bounces
            Phase::Quiet { .. } if active => {
                self.homing_way(Phase::BackOff, -homing.towards() * self.search_steps(homing.axis));
            }
            Phase::Quiet { since } if since == u64::MAX => {
                self.homing_phase(Phase::Quiet { since: self.report.played }, homing.opened);
            }
            Phase::Quiet { since } => {
                if self.report.played.saturating_sub(since) >= QUIET_SEGMENTS {
                    self.homing_way(Phase::Clear, -homing.towards() * i64::from(play));
                }
            }
            Phase::Clear => {
                let slow = (own_step(self, i) * 1_000_000 / SLOW_STEP_US) >> 32;
                if let Some(homing) = &mut self.homing {
                    homing.velocity = homing.velocity.min(slow.max(1));
                }
                self.refresh();
                let way = i64::from(at.abs_diff(homing.opened)) + 2 * reference + 2 * i64::from(play);
                self.homing_way(Phase::Slow, homing.towards() * way);
            }
            Phase::Slow => self.end_homing(named(ErrorNumber::NotHomed, "limit switch not found a second time")),
            Phase::Found { trip } => {
                if let Some(running) = &mut self.homing {
                    running.velocity = self.settings.axes[i].home.velocity;
                }
                self.refresh();
                self.homing_way(Phase::Leave { trip }, self.leave_steps(&homing, trip, at, reference, play));
            }
            Phase::Leave { trip } if homing.side == Side::Upper => {
                let way = i64::from(trip) - reference - i64::from(at);
                self.homing_way(Phase::Return, way);
            }
            Phase::Leave { .. } | Phase::Return if active => {
                self.end_homing(named(ErrorNumber::LimitSwitch, "limit switch still active at the reference"));
            }
            Phase::Leave { .. } | Phase::Return => self.finish_homing(homing.axis),
            Phase::Stopping => self.end_homing(None),
        }
    }

    /// From where it stands to where the reference is reached upwards from, or to the reference itself.
    fn leave_steps(&self, homing: &Homing, trip: i32, at: i32, reference: i64, play: i32) -> i64 {
        let back = i64::from(trip) - i64::from(at);
        match homing.side {
            // the switch was met on the other flank: the play lies between
            Side::Lower => back + self.play_steps(homing.axis) + reference,
            Side::Upper => back - reference - i64::from(play),
        }
    }

    fn play_steps(&self, axis: Axis) -> i64 {
        self.settings.axes[axis.index()].backlash_steps(&self.motor(axis)).into()
    }

    fn reference_steps(&self, axis: Axis) -> i64 {
        let distance = if axis.is_rotary() { REFERENCE_NRAD } else { REFERENCE_NM };
        units_to_steps(distance, own_step(self, axis.index()))
    }

    /// How far the switch is looked for.
    fn search_steps(&self, axis: Axis) -> i64 {
        let motor = self.motor(axis);
        let travel = i64::from(motor.travel_upper) - i64::from(motor.travel_lower);
        units_to_steps(travel + travel / BEYOND, motor.step_q32) + 2 * self.reference_steps(axis)
    }

    fn homing_phase(&mut self, phase: Phase, opened: i32) {
        if let Some(homing) = &mut self.homing {
            (homing.phase, homing.opened) = (phase, opened);
        }
    }

    /// Goes a way in steps from where it stands.
    fn homing_way(&mut self, phase: Phase, steps: i64) {
        let Some(homing) = &mut self.homing else { return };
        homing.phase = phase;
        let (axis, i) = (homing.axis, homing.axis.index());
        let mut there = self.report.final_steps;
        let most = units_to_steps(COORDINATE_LIMIT.into(), self.capability.law.step_q32(i)) - 1;
        there.0[i] = (i64::from(there.0[i]) + steps).clamp(-most, most) as i32;
        let x = self.capability.law.forward(there).0[i];
        self.planner.desire(axis, Desire::Position(x, None));
    }

    /// At the reference: the motor stands where `HOME:OFFSet` says, on the reference flank.
    fn finish_homing(&mut self, axis: Axis) {
        let i = axis.index();
        let motor = self.motor(axis);
        let mut steps: MotorSteps = self.report.final_steps;
        let offset = self.settings.axes[i].home.reference(&motor);
        steps.0[i] = units_to_steps(offset.into(), motor.step_q32) as i32;
        let law = self.real_law();
        if !law.names(steps) {
            let text = "HOME:OFFS is beyond the range of coordinates";
            return self.end_homing(Some(Error::axis_text(ErrorNumber::DataOutOfRange, axis, text)));
        }
        if self.order(Waiting::Rest { motor: i as u8, flank: Some(Flank::Positive), overlay: 0 }).is_err() {
            return self.end_homing(Some(refuse(ErrorNumber::Moving)));
        }
        self.homing = None;
        self.homed[i] = true;
        self.uncertain[i] = false;
        // the queue has room at rest
        let _ = self.put_law(law, steps);
    }
}

/// Size of a motor step, Q32 nm or nrad.
fn own_step(front: &Front, motor: usize) -> u64 {
    front.capability.law.step_q32(motor)
}
