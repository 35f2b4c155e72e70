//! From desires and goals to tracks.

use super::share::{Asking, Left};
use super::slot::{Flight, Intent, beyond};
use super::{
    COORDINATED, Capability, Desire, Ordered, Planner, Proposal, SLOTS, Versioned, go_along, straight, unplannable,
    with_speed,
};
use crate::error::Error;
use crate::motion::bounds::{PATH_ONE, Path};
use crate::motion::budget::{Grant, Turning};
use crate::motion::plan::{position_profile, to_velocity, velocity_profile};
use crate::motion::profile::State;
use crate::motion::ramp;
use crate::motion::track::SINGLE_AXIS_UNIT_BITS;
use crate::units::{AXES, Axis, Pose, wide};

/// A jog ends after this many segments (76 hours) at the latest: a profile is not made for more.
const LONGEST_JOG: i64 = 1 << 30;

impl Planner {
    /// Turns desires and goals into tracks that begin with `segment`; each is given to `order`, which answers how
    /// the generator was told, or none when the queue is full.
    ///
    /// # Errors
    /// The first limit that a waiting goal or desire turned out to break; it is dropped, the others go on.
    pub fn plan(
        &mut self,
        capability: &Versioned<Capability>,
        segment: u64,
        order: &mut dyn FnMut(Proposal) -> Option<Ordered>,
    ) -> Result<(), Error> {
        self.merge(segment);
        if self.slots.iter().any(|s| s.flight.is_some_and(|flight| flight.at_once)) {
            return Ok(());
        }
        for slot in 0..SLOTS {
            self.plan_changes(capability, slot, segment, order);
        }
        let mut refused = None;
        if let Some(goal) = self.goal
            && let Err(error) = self.plan_goal(capability, goal, segment, order)
        {
            refused = Some((None, error));
        }
        for axis in Axis::ALL {
            if let Err(error) = self.plan_desire(capability, axis, segment, order) {
                refused = refused.or(Some((Some(axis), error)));
            }
        }
        let Some((axis, error)) = refused else {
            return Ok(());
        };
        // What is in the way may be where another axis still stands: while any moves, it waits.
        if self.is_running() {
            return Ok(());
        }
        match axis {
            None => (self.goal, self.then_goal) = (None, None),
            Some(axis) => {
                self.desires[axis.index()] = Desire::None;
                self.then[axis.index()] = None;
            }
        }
        Err(error)
    }

    /// Stops and changes of speed of a track that runs.
    #[inline(never)]
    fn plan_changes(
        &mut self,
        capability: &Capability,
        slot: usize,
        segment: u64,
        order: &mut dyn FnMut(Proposal) -> Option<Ordered>,
    ) {
        let entry = &mut self.slots[slot];
        let (stop, replan) = (entry.stop, entry.replan);
        if entry.flight.is_some() || !(stop || replan) {
            return;
        }
        (entry.stop, entry.replan) = (false, false);
        if entry.active().is_none() {
            return;
        }
        let active = entry.next_like_active();
        let state = active.state(segment);
        let limits = with_speed(&active.grant, active.speed, capability.override_percent);
        let remaining = active.end_segment().saturating_sub(segment);
        let profile = &mut active.track.profile;
        let planned = if stop {
            velocity_profile(state, 0, active.grant.limits, profile)
        } else {
            position_profile(state, active.goal, limits, profile)
        };
        if planned.is_none() {
            // it goes on as planned; a stop is tried again from where it is then
            entry.stop = stop;
            return;
        }
        // Whole segments make a stop longer than the ideal one, by up to two: it may end beyond the goal. (One that
        // overshoots its goal anyway and has still to return is stopped all the same.)
        let duration = u64::from(profile.duration());
        let ahead = active.goal.saturating_sub(state.position).signum();
        let beyond = profile.end_position().saturating_sub(active.goal).signum() == ahead;
        if stop && (duration >= remaining || beyond && remaining <= duration + duration / 8 + 16) {
            // it comes to rest as soon without
            if let Some(active) = entry.active_mut() {
                active.stopping = true;
            }
            return;
        }
        if !entry.active().is_some_and(|now| now.covers(&entry.next().track.profile, segment)) {
            // A track that runs straight is about to brake, and comes to rest where it was to; one that has to turn
            // back does so as planned, and obeys then.
            (entry.stop, entry.replan) = (stop, replan && entry.next().detour.is_some());
            return;
        }
        let active = entry.next_mut();
        active.start = segment;
        if stop {
            active.track.end = active.track.at(active.track.profile.end_position());
            active.stopping = true;
        }
        if !self.launch(slot, Intent::Change, segment, order) {
            let entry = &mut self.slots[slot];
            (entry.stop, entry.replan) = (stop, replan);
        }
    }

    /// Hands the next track of a slot to the generator; false when its queue is full.
    fn launch(
        &mut self,
        slot: usize,
        intent: Intent,
        segment: u64,
        order: &mut dyn FnMut(Proposal) -> Option<Ordered>,
    ) -> bool {
        let Some(Ordered { sequence, at_once }) = order(Proposal { slot: slot as u8, segment, alone: self.is_alone() })
        else {
            return false;
        };
        self.slots[slot].flight = Some(Flight { sequence, intent, at_once });
        true
    }

    /// Nothing runs, and one thing only is to begin.
    fn is_alone(&self) -> bool {
        let wanted =
            self.desires.iter().filter(|desire| **desire != Desire::None).count() + usize::from(self.goal.is_some());
        wanted == 1 && !self.is_running()
    }

    #[inline(never)]
    fn plan_goal(
        &mut self,
        capability: &Versioned<Capability>,
        goal: Pose,
        segment: u64,
        order: &mut dyn FnMut(Proposal) -> Option<Ordered>,
    ) -> Result<(), Error> {
        if self.slots.iter().any(|s| s.flight.is_some()) {
            return Ok(());
        }
        // The same goal again: it is on its way.
        if let Some(slot) = (COORDINATED..SLOTS).find(|i| self.slots[*i].active().is_some_and(|a| !a.stopping))
            && self.rest().rounded() == goal
            && self.slots[..AXES].iter().all(|s| s.active().is_none())
            && !self.slots[slot].stop
        {
            self.goal = None;
            self.slots[slot].replan = true;
            return Ok(());
        }
        let mut running = false;
        for slot in &mut self.slots {
            if slot.active().is_some_and(|a| !a.stopping) {
                slot.stop = true;
                running = true;
            }
        }
        if running {
            return Ok(());
        }
        let Some(slot) = (COORDINATED..SLOTS).find(|i| self.slots[*i].active().is_none()) else {
            return Ok(());
        };
        let path = straight(&self.rest(), &goal.fine());
        let direction = path.direction;
        if path.goes_nowhere() {
            self.goal = self.then_goal.take();
            return Ok(());
        }
        let checked = &self.checked;
        let as_checked = checked.valid
            && !self.is_running()
            && checked.version == capability.version()
            && checked.to == goal
            && checked.from.fine().0.iter().zip(&path.origin.0).all(|(a, b)| a == b);
        if as_checked {
            let next = self.slots[slot].next_mut();
            (next.grant, next.track.profile) = (checked.grant, checked.profile);
        } else {
            let starts_high = Some(false);
            let asking = Asking { path: &path, region: None, slot: SLOTS, segment, single: false, starts_high };
            let Some(grant) = self.grant(capability, &asking)? else {
                return Ok(());
            };
            let next = self.slots[slot].next_mut();
            next.grant = grant;
            go_along(capability, &grant, &mut next.track.profile).ok_or_else(unplannable)?;
        }
        let next = self.slots[slot].next_mut();
        (next.track.origin, next.track.direction, next.track.end) = ([0; AXES], direction, direction);
        (next.start, next.speed, next.goal) = (segment, PATH_ONE, PATH_ONE);
        (next.detour, next.stopping, next.jog) = (None, false, false);
        let swing = next.grant.swing;
        if self.launch(slot, Intent::Goal(goal), segment, order) {
            self.bend_others(capability, slot, swing);
            self.goal = None;
        }
        Ok(())
    }

    #[inline(never)]
    fn plan_desire(
        &mut self,
        capability: &Capability,
        axis: Axis,
        segment: u64,
        order: &mut dyn FnMut(Proposal) -> Option<Ordered>,
    ) -> Result<(), Error> {
        let i = axis.index();
        if self.desires[i] == Desire::None {
            return Ok(());
        }
        let coordinated = self.slots[COORDINATED..].iter().any(|s| s.flight.is_some());
        if self.slots[i].flight.is_some() || coordinated || self.slots[i].stop {
            return Ok(());
        }
        let (x, then, speed) = match self.desires[i] {
            Desire::None => return Ok(()),
            Desire::Position(x, then) => (x, then, u64::MAX),
            Desire::Jog { upwards, speed, .. } => {
                let limit = self.farthest(capability, axis, upwards, segment);
                self.desires[i] = Desire::Jog { upwards, limit, speed };
                (limit, None, speed)
            }
        };
        let origin = self.rest_without(i);
        // Q32 nm is Q60 of the path unit, see there
        let goal = (i64::from(x) << 32) - origin.0[i];
        let mut direction = [0; AXES];
        direction[i] = 1 << (32 + SINGLE_AXIS_UNIT_BITS);
        let running = self.slots[i].active();
        let state = running.map_or(State::rest(0), |a| a.state(segment));
        if running.is_none() && goal == 0 {
            self.desires[i] = then.map_or(Desire::None, |x| Desire::Position(x, None));
            return Ok(());
        }
        // where it would come to rest by itself counts too: it may overshoot the new target and return
        let stop = match running {
            Some(active) => stop_end(state, active.grant.limits)?,
            None => state.position,
        };
        let own = capability.limits.range(&capability.law, axis);
        let (lower, upper) = match self.desires[i] {
            // a motor's travel may end before the axis' own limit
            Desire::Jog { upwards: true, limit, .. } => (own.0, limit),
            Desire::Jog { upwards: false, limit, .. } => (limit, own.1),
            _ => own,
        };
        if running.is_some() {
            let rest = origin.0[i].saturating_add(stop);
            let beyond = rest < i64::from(lower) << 32 || rest > i64::from(upper) << 32;
            if beyond && (origin.0[i] + stop - self.rest().0[i]).signum() == i64::from(stop > state.position) * 2 - 1 {
                // turning back now would lead beyond the limit; where it goes lies before it
                return Ok(());
            }
        }
        let low = 0.min(goal).min(state.position).min(stop);
        let high = 0.max(goal).max(state.position).max(stop);
        let (from, to) = match running {
            Some(_) => (goal.min(state.position).min(stop), goal.max(state.position).max(stop)),
            None => (low, high),
        };
        let path = Path { origin, direction, from, to };
        // an axis that turns is granted the same wherever it goes, so that a new target never asks for less speed
        let region = if axis.is_rotary() {
            // and not farther than the axis goes: beyond, where angles wrap, the law means nothing
            let at = |x: i32| (i64::from(x) << 32) - origin.0[i];
            Some(Path { from: path.from.min(at(own.0)), to: path.to.max(at(own.1)), ..path })
        } else {
            None
        };
        let asking = Asking {
            path: &path,
            region: region.as_ref(),
            slot: i,
            segment,
            single: true,
            starts_high: [(to, true), (from, false)].iter().find(|end| end.0 == state.position).map(|end| end.1),
        };
        let granted = self.grant(capability, &asking)?;
        let grant = match (running, granted) {
            (None, None) => return Ok(()),
            (None, Some(grant)) => grant,
            (Some(active), granted) => {
                let swing = if axis.is_rotary() { ((to - from) >> 32).unsigned_abs() + 1 } else { 0 };
                match granted.filter(|new| agrees(state, new, (from, to))) {
                    Some(new) => joined(&new, &active.grant),
                    None if self.can_keep(capability, i, segment, swing) => kept(granted, &active.grant, swing),
                    None => return Ok(()),
                }
            }
        };
        // nm per segment in Q44 to path units in Q60
        let speed = (speed >> (SINGLE_AXIS_UNIT_BITS - 16)).clamp(1, 1 << 60) as i64;
        let limits = with_speed(&grant, speed, capability.override_percent);
        let jog = matches!(self.desires[i], Desire::Jog { .. });
        let goal = if jog {
            let way = limits.velocity.saturating_mul(LONGEST_JOG);
            goal.clamp(stop.saturating_sub(way), stop.saturating_add(way))
        } else {
            goal
        };
        let runs = running.is_some();
        let mut detour = runs.then_some((from, to));
        let next = self.slots[i].next_mut();
        position_profile(state, goal, limits, &mut next.track.profile).ok_or_else(unplannable)?;
        if runs
            && let (below, above) = beyond((from, to), &next.track.profile)
            && (below || above)
        {
            // it turns back a little behind where it could stop: that has to be free too
            let (lowest, highest) = next.track.profile.extent();
            let wider = (from.min(lowest), to.max(highest));
            if below && origin.0[i] + lowest < i64::from(lower) << 32
                || above && origin.0[i] + highest > i64::from(upper) << 32
            {
                return Ok(());
            }
            let path = Path { from: wider.0, to: wider.1, ..path };
            let region = region.map(|all| Path { from: all.from.min(wider.0), to: all.to.max(wider.1), ..all });
            self.grant(capability, &Asking { path: &path, region: region.as_ref(), ..asking })?;
            detour = Some(wider);
        }
        let next = self.slots[i].next_mut();
        (next.track.origin, next.track.direction, next.track.end) = ([0; AXES], direction, [0; AXES]);
        next.track.end[i] = goal;
        (next.grant, next.start, next.speed, next.goal) = (grant, segment, speed, goal);
        (next.detour, next.stopping, next.jog) = (detour, false, jog);
        if self.launch(i, Intent::Desire(self.desires[i]), segment, order) {
            self.bend_others(capability, i, grant.swing);
            self.desires[i] = Desire::None;
            self.then[i] = then;
            self.slots[i].replan = false;
        }
        Ok(())
    }

    /// Whether a running track may go on with what it was granted when it turns by `swing` nrad more.
    fn can_keep(&self, capability: &Capability, slot: usize, segment: u64, swing: u64) -> bool {
        let Some(active) = self.slots[slot].active() else {
            return false;
        };
        let mut left = Left { motors: capability.motors, others: Turning::default(), remaining: 0 };
        self.left(capability, slot, segment, swing, &mut left);
        left.motors.iter().zip(&active.grant.uses).all(|(left, uses)| left.covers(uses))
    }
}

/// Where a stop from a state ends.
fn stop_end(state: State, limits: ramp::Limits) -> Result<i64, Error> {
    to_velocity(state, 0, limits).map(|p| p.end_position()).map_err(|_| unplannable())
}

/// Whether a state lies within new limits, so that a profile from it never leaves them nor the stretch.
fn agrees(state: State, new: &Grant, (from, to): (i64, i64)) -> bool {
    let (v, a) = (state.velocity >> 30, state.acceleration >> 30);
    let limits = new.limits;
    let (v_most, a_most, j) = (i128::from(limits.velocity), i128::from(limits.acceleration), i128::from(limits.jerk));
    // the velocity that is reached while the acceleration falls to zero
    let forced = v + wide::signed_div(a * a.abs(), 2 * j);
    v.abs() < v_most
        && a.abs() < a_most
        && forced.abs() < v_most
        && stop_end(state, limits).is_ok_and(|end| (from..=to).contains(&end))
}

/// A new grant beside the old one, which stays reserved: the new track may be refused.
fn joined(new: &Grant, old: &Grant) -> Grant {
    let mut grant = *new;
    for (new, old) in grant.uses.iter_mut().zip(&old.uses) {
        *new = new.max(*old);
    }
    grant.turning = new.turning.max(old.turning);
    grant.bent = old.bent;
    grant
}

/// The old grant, which holds for every target of the axis; slower if the new one would be.
fn kept(new: Option<Grant>, old: &Grant, swing: u64) -> Grant {
    let mut grant = *old;
    if let Some(new) = new {
        grant.limits.velocity = grant.limits.velocity.min(new.limits.velocity);
    }
    grant.swing = swing;
    grant
}
