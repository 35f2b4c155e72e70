//! Moves, jogs and stops: checked, then handed to the planner.

use super::{Abort, Front, refuse};
use crate::error::{Error, ErrorNumber};
use crate::motion::planner::Desire;
use crate::units::{AXES, Axis, Pose, SEGMENT_NS, wide};

impl Front {
    /// While an immediate stop is carried out, nobody knows yet from where a move would start; a take-up on command
    /// is not to be disturbed.
    #[inline(never)]
    fn free_to_move(&self) -> Result<(), Error> {
        self.not_homing()?;
        self.not_scanning()?;
        if self.abort == Abort::None && self.preload.is_none() { Ok(()) } else { Err(refuse(ErrorNumber::Moving)) }
    }

    /// A jog has no target that a relative move could begin from.
    fn not_jogging(&self, axis: Axis) -> Result<(), Error> {
        if self.planner.is_jogging(axis) { Err(Error::axis(ErrorNumber::Moving, axis)) } else { Ok(()) }
    }

    pub(super) fn ready(&self, axis: Axis) -> Result<(), Error> {
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
    /// 103, 101, 109, 108, 102, -222: nothing moves.
    pub fn move_absolute(&mut self, axis: Axis, to: i64) -> Result<(), Error> {
        self.armed()?;
        self.ready(axis)?;
        self.move_axis(axis, to)
    }

    /// Moves one axis by a distance from its commanded coordinate; needs no homing.
    ///
    /// # Errors
    /// 103, 104 while it jogs, 108, 102, -222: nothing moves.
    pub fn move_relative(&mut self, axis: Axis, by: i64) -> Result<(), Error> {
        self.armed()?;
        self.not_jogging(axis)?;
        self.move_axis(axis, i64::from(self.commanded().0[axis.index()]).saturating_add(by))
    }

    fn move_axis(&mut self, axis: Axis, to: i64) -> Result<(), Error> {
        self.free_to_move()?;
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
    /// 103, 101, 109, 108, 102, -222: nothing moves.
    pub fn pose_absolute(&mut self, target: [i64; AXES]) -> Result<(), Error> {
        self.armed()?;
        let target = self.homed_pose(target)?;
        self.go(target)
    }

    /// Moves all axes by distances from their commanded coordinates; needs no homing.
    ///
    /// # Errors
    /// 103, 104 while an axis jogs, 108, 102, -222: nothing moves.
    pub fn pose_relative(&mut self, by: [i64; AXES]) -> Result<(), Error> {
        self.armed()?;
        Axis::ALL.into_iter().try_for_each(|axis| self.not_jogging(axis))?;
        let mut target = by;
        for (t, from) in target.iter_mut().zip(self.commanded().0) {
            *t = t.saturating_add(i64::from(from));
        }
        let target = self.pose_in_range(target)?;
        self.go(target)
    }

    fn go(&mut self, target: Pose) -> Result<(), Error> {
        self.free_to_move()?;
        match self.legs(self.commanded(), target)? {
            Some(over) => self.planner.go(over, Some(target)),
            None => self.planner.go(target, None),
        }
        self.jog_links = [None; AXES];
        Ok(())
    }

    /// A pose to which a stage may go that is homed.
    ///
    /// # Errors
    /// 101, 109, 108, -222.
    #[inline(never)]
    pub(super) fn homed_pose(&self, pose: [i64; AXES]) -> Result<Pose, Error> {
        Axis::ALL.into_iter().try_for_each(|axis| self.ready(axis))?;
        self.pose_in_range(pose)
    }

    pub(super) fn pose_in_range(&self, pose: [i64; AXES]) -> Result<Pose, Error> {
        for (axis, value) in Axis::ALL.into_iter().zip(pose) {
            self.capability.limits.check_coordinate(&self.capability.law, axis, value)?;
        }
        Ok(Pose(pose.map(|u| u as i32)))
    }

    /// Checks a move; answers where it has to overshoot to, if a motor is to end in one direction.
    fn legs(&mut self, from: Pose, to: Pose) -> Result<Option<Pose>, Error> {
        let over = self.overshoot(from, to);
        let first = over.unwrap_or(to);
        // what is checked first is made first
        self.planner.prepare(&self.capability, from, first)?;
        self.check_switches(first)?;
        if over.is_some() {
            self.planner.check(&self.capability, first, to)?;
            self.check_switches(to)?;
        }
        Ok(over)
    }

    /// Where a move from `from` to `to` has to go first, so that every one-directional motor ends in its direction.
    pub(super) fn overshoot(&self, from: Pose, to: Pose) -> Option<Pose> {
        if self.settings.axes.iter().all(|own| own.backlash.mode.ending().is_none()) {
            return None;
        }
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
    pub(super) fn clearance(&self, axis: Axis) -> i32 {
        let own = &self.settings.axes[axis.index()];
        own.backlash_steps(&self.motor(axis)).saturating_add(own.backlash.margin)
    }

    /// Constant velocity (nm/s or nrad/s, signed) until a stop, a limit, or another jog; 0 ramps down.
    ///
    /// # Errors
    /// 103, 108 disabled, 102 towards an active switch, -222 beyond the axis' velocity or already at the limit.
    pub fn jog(&mut self, axis: Axis, velocity: i64, link: u8) -> Result<(), Error> {
        let i = axis.index();
        if velocity == 0 {
            self.stop(axis);
            return Ok(());
        }
        self.armed()?;
        self.free_to_move()?;
        if !self.enabled[i] {
            return Err(Error::axis(ErrorNumber::AxisDisabled, axis));
        }
        let most = self.settings.axes[i].velocity;
        if velocity.unsigned_abs() > most {
            let bound = if velocity < 0 { -(most as i64) } else { most as i64 };
            return Err(Error::speed(axis, velocity, bound));
        }
        let upwards = velocity > 0;
        let rest = self.planner.rest();
        let limit = self.planner.farthest(&self.capability, axis, upwards, self.report.next);
        let here = rest.rounded().0[i];
        if (velocity > 0 && limit <= here || velocity < 0 && limit >= here) && !self.planner.is_moving() {
            return Err(Error::limit(axis, i64::from(here), i64::from(limit), false));
        }
        let mut end = rest.rounded();
        end.0[i] = limit;
        self.check_switches(end)?;
        if self.planner.is_coordinated(axis) {
            self.planner.stop_coordinated();
        }
        let speed = settings_speed(velocity.unsigned_abs());
        self.planner.desire(axis, Desire::Jog { upwards, limit, speed });
        self.jog_links[i] = Some(link);
        Ok(())
    }

    /// Decelerates an axis, and every coordinated move and scan that it belongs to.
    pub fn stop(&mut self, axis: Axis) {
        self.stop_homing(axis);
        if self.scan_has(axis) {
            self.stop_scan();
        }
        if self.preload.take().is_some() {
            self.planner.stop_coordinated();
        }
        self.planner.stop(axis);
        self.jog_links[axis.index()] = None;
    }

    /// Decelerates everything.
    pub fn stop_all(&mut self) {
        Axis::ALL.into_iter().for_each(|axis| self.stop(axis));
    }

    /// Stops all motors at once, at the word that plays now.
    pub fn abort(&mut self) {
        self.abort_trace();
        if self.abort == Abort::None && !self.planner.is_running() && self.report.settled {
            // nothing has begun: there is nothing to stop, only something to forget
            self.planner.forget();
            self.preload = None;
            self.jog_links = [None; AXES];
            self.end_homing(None);
            self.end_scan(crate::scan::status::STOPPED);
        } else if self.abort == Abort::None {
            self.judge_speeds(self.report.played);
            self.planner.clear();
            self.preload = None;
            self.jog_links = [None; AXES];
            self.abort = Abort::Requested;
        }
    }

    /// What an immediate stop in this segment begins above the axis' `VEL:STAR` is uncertain from now on.
    pub(super) fn judge_speeds(&mut self, segment: u64) {
        let speeds = self.planner.speeds(segment);
        for (i, speed) in speeds.into_iter().enumerate() {
            // Q32 per segment against nm/s
            let threshold = wide::div(
                (u128::from(self.settings.axes[i].start_velocity) << 32) * u128::from(SEGMENT_NS),
                1_000_000_000,
            );
            if u128::from(speed) > threshold + (threshold >> 10) {
                self.uncertain[i] = true;
            }
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
}

/// nm/s to nm per segment in Q44.
fn settings_speed(velocity: u64) -> u64 {
    crate::motion::budget::Rates::per_segment(velocity, 1, 1, 1 << 32).velocity
}
