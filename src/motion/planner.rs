//! The planner: which tracks run, where they end, and what each may use.
//!
//! # Design
//! Six single-axis slots and two for coordinated moves. A command leaves a *desire* (of an axis) or a *goal* (of all
//! axes); [`Planner::plan`] turns them into tracks, each for a segment that is not generated yet. A track that is
//! still unanswered is *in flight*: nothing that depends on it is planned before its answer, and a refused one is
//! planned again from the state at a later segment. Everything is absolute: a rest pose is the base plus the exact
//! ends of the tracks.
//!
//! A new target on the line of a running single-axis track is re-planned from its state; a goal off the line lets
//! what runs decelerate along itself and adds a new track from the common rest pose, within what is left of the
//! motors' limits; with too little left it waits.

use super::bounds::{Bounds, PATH_ONE, Path};
use super::budget::{Grant, Rates, Turning};
use super::limits::Limits;
use super::plan::{to_position, to_velocity};
use super::profile::{Profile, State};
use super::track::{SINGLE_AXIS_UNIT_BITS, Track};
use crate::compensation::law::Law;
use crate::error::{Error, ErrorNumber};
use crate::units::{AXES, Axis, FinePose, Pose};

/// Slots of coordinated tracks: the running one and one that decelerates.
const COORDINATED: usize = AXES;
/// All slots.
pub const SLOTS: usize = AXES + 2;
/// A new track waits while others leave it less than this part of its speed.
const WAIT_BELOW: i64 = 16;
/// Of what is left of a motor a single-axis track takes at most 15/16, so that axes coupled to it can still move.
const SINGLE_SHARE_1024: u32 = 960;

/// What an axis is to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Desire {
    /// Nothing new.
    #[default]
    None,
    /// Go to a logical coordinate, nm or nrad; then, if there is one, to a second one.
    Position(i32, Option<i32>),
    /// Constant velocity towards a limit: its coordinate, and the speed in nm or nrad per segment, Q44.
    Jog {
        /// Where it would end.
        limit: i32,
        /// Speed.
        speed: u64,
    },
}

/// A track that runs, with what it was granted.
#[derive(Clone, Copy, Debug)]
struct Active {
    track: Track,
    start: u64,
    grant: Grant,
    /// Speed limit asked for by a jog, path units per segment in Q60; the granted one otherwise.
    speed: i64,
    /// Path position at which it is to end.
    goal: i64,
    stopping: bool,
    jog: bool,
}

impl Active {
    fn end_segment(&self) -> u64 {
        self.start + u64::from(self.track.profile.duration())
    }

    fn state(&self, segment: u64) -> State {
        self.track.profile.state(segment.saturating_sub(self.start).min(u64::from(u32::MAX)) as u32)
    }
}

/// A track that was ordered and not yet answered.
#[derive(Clone, Copy, Debug)]
struct Flight {
    sequence: u16,
    active: Active,
    /// What it was planned for: still to be done if it is refused.
    wish: Wish,
}

/// What a track in flight was planned for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wish {
    /// A stop or a change of speed of what runs.
    Change,
    /// The desire of its axis.
    Desire(Desire),
    /// A goal.
    Goal(Pose),
}

#[derive(Clone, Copy, Debug, Default)]
struct Slot {
    active: Option<Active>,
    flight: Option<Flight>,
    stop: bool,
    replan: bool,
}

impl Slot {
    /// What will run once the answer is there, as far as known.
    fn latest(&self) -> Option<&Active> {
        self.flight.as_ref().map(|f| &f.active).or(self.active.as_ref())
    }
}

/// What the motors and axes may do; changed only at standstill, but for the wanted rates.
#[derive(Clone, Copy, Debug)]
pub struct Capability {
    /// The law.
    pub law: Law,
    /// Limits of the motors without the reserve for take-up, steps per segment^k.
    pub motors: [Rates; AXES],
    /// Wanted rates of the logical axes, nm and nrad per segment^k.
    pub wanted: [Rates; AXES],
    /// Limits of positions.
    pub limits: Limits,
    /// Speed override in percent, 1 to 100.
    pub override_percent: u8,
}

/// A track that the generator is to run.
#[derive(Clone, Copy, Debug)]
pub struct Proposal {
    /// Which slot.
    pub slot: u8,
    /// With which segment it begins.
    pub segment: u64,
    /// The track.
    pub track: Track,
}

/// Duration and peak rates of a move that is only looked at.
#[derive(Clone, Copy, Debug, Default)]
pub struct DryRun {
    /// Segments from start to rest.
    pub segments: u64,
    /// Peak step rates, steps per segment in Q44.
    pub step_rates: [u64; AXES],
}

/// Which tracks run, where they end, and what each may use.
#[derive(Clone, Copy, Debug)]
pub struct Planner {
    base: FinePose,
    slots: [Slot; SLOTS],
    desires: [Desire; AXES],
    goal: Option<Pose>,
    then_goal: Option<Pose>,
    then: [Option<i32>; AXES],
}

impl Planner {
    /// At rest at a pose.
    pub fn at_rest(pose: Pose) -> Self {
        Planner {
            base: pose.fine(),
            slots: [Slot::default(); SLOTS],
            desires: [Desire::None; AXES],
            goal: None,
            then_goal: None,
            then: [None; AXES],
        }
    }

    /// True while a track runs or one is still to be planned.
    pub fn is_moving(&self) -> bool {
        self.goal.is_some()
            || self.then_goal.is_some()
            || self.then.iter().any(Option::is_some)
            || self.desires.iter().any(|d| *d != Desire::None)
            || self.slots.iter().any(|s| s.active.is_some() || s.flight.is_some())
    }

    /// Bit n: axis n has a track or waits for one.
    pub fn moving_axes(&self) -> u8 {
        let mut mask = if self.goal.is_some() || self.then_goal.is_some() { 0x3f } else { 0 };
        for (i, slot) in self.slots.iter().enumerate() {
            if let Some(active) = slot.latest() {
                mask |= active.track.axes();
            }
            if i < AXES && (self.desires[i] != Desire::None || self.then[i].is_some()) {
                mask |= 1 << i;
            }
        }
        mask
    }

    /// Where everything ends that runs now, without goals and desires that are still to be planned.
    pub fn rest(&self) -> FinePose {
        self.rest_without(SLOTS)
    }

    fn rest_without(&self, except: usize) -> FinePose {
        let mut rest = self.base;
        for (i, slot) in self.slots.iter().enumerate() {
            if let Some(active) = slot.latest().filter(|_| i != except) {
                for (u, end) in rest.0.iter_mut().zip(&active.track.end) {
                    *u += end;
                }
            }
        }
        rest
    }

    /// The commanded pose: where the axes are at last to stand.
    pub fn commanded(&self) -> Pose {
        let mut pose = self.rest().rounded();
        if let Some(goal) = self.then_goal.or(self.goal) {
            pose = goal;
        }
        for (i, desire) in self.desires.iter().enumerate() {
            match (desire, self.then[i]) {
                (Desire::Position(x, then), _) => pose.0[i] = then.unwrap_or(*x),
                (Desire::Jog { limit, .. }, _) => pose.0[i] = *limit,
                (Desire::None, Some(x)) => pose.0[i] = x,
                (Desire::None, None) => {}
            }
        }
        pose
    }

    /// True when a coordinated move of this axis runs or waits: then a single axis cannot leave it alone.
    pub fn is_coordinated(&self, axis: Axis) -> bool {
        let runs = |slot: &Slot| slot.latest().is_some_and(|a| !a.stopping && a.track.axes() >> axis.index() & 1 != 0);
        self.goal.is_some() || self.then_goal.is_some() || self.slots[COORDINATED..].iter().any(runs)
    }

    /// True while the axis jogs.
    pub fn is_jogging(&self, axis: Axis) -> bool {
        matches!(self.desires[axis.index()], Desire::Jog { .. })
            || self.slots[axis.index()].latest().is_some_and(|a| a.jog && !a.stopping)
    }

    /// A new desire of one axis.
    pub fn desire(&mut self, axis: Axis, desire: Desire) {
        self.slots[axis.index()].stop = false;
        self.then[axis.index()] = None;
        self.desires[axis.index()] = desire;
    }

    /// A new goal of all axes, and where to go from there.
    pub fn go(&mut self, goal: Pose, then: Option<Pose>) {
        self.desires = [Desire::None; AXES];
        self.then = [None; AXES];
        self.goal = Some(goal);
        self.then_goal = then;
    }

    /// Decelerates an axis, and with it every coordinated move that it belongs to.
    pub fn stop(&mut self, axis: Axis) {
        let i = axis.index();
        self.desires[i] = Desire::None;
        self.then[i] = None;
        self.slots[i].stop = self.slots[i].latest().is_some();
        if self.is_coordinated(axis) {
            self.stop_coordinated();
        }
    }

    /// Decelerates every coordinated move.
    pub fn stop_coordinated(&mut self) {
        self.goal = None;
        self.then_goal = None;
        for slot in &mut self.slots[COORDINATED..] {
            slot.stop = slot.latest().is_some();
        }
    }

    /// The wanted speed has changed: what runs is planned again.
    pub fn replan_all(&mut self) {
        for slot in &mut self.slots {
            slot.replan = slot.latest().is_some_and(|a| !a.stopping);
        }
    }

    /// The answers of the generator: `answered` is the last order that it has seen, bit k of `refused` says that
    /// order `answered - k` was refused. What has ended before `segment` goes into the base.
    ///
    /// True when one was refused.
    pub fn answer(&mut self, answered: u16, refused: u32, segment: u64) -> bool {
        let mut any_refused = false;
        for i in 0..SLOTS {
            let slot = &mut self.slots[i];
            let Some(flight) = slot.flight else { continue };
            let age = answered.wrapping_sub(flight.sequence);
            if age >= 0x8000 {
                continue;
            }
            slot.flight = None;
            if age < 32 && refused >> age & 1 == 0 {
                slot.active = Some(flight.active);
                continue;
            }
            // planned again from the state at a later segment, unless something newer is wished for
            any_refused = true;
            match flight.wish {
                Wish::Change => {
                    slot.stop |= flight.active.stopping;
                    slot.replan |= !flight.active.stopping;
                }
                Wish::Desire(desire) if self.desires[i] == Desire::None && !slot.stop => {
                    self.desires[i] = desire;
                    self.then[i] = None;
                }
                Wish::Goal(goal) if self.goal.is_none() && !slot.stop => self.goal = Some(goal),
                _ => {}
            }
        }
        self.merge(segment);
        any_refused
    }

    /// Forgets every track, desire and goal: the motors were stopped at once.
    pub fn clear(&mut self) {
        *self = Planner::at_rest(self.rest().rounded());
    }

    /// Stands at a pose.
    pub fn rest_at(&mut self, pose: Pose) {
        *self = Planner::at_rest(pose);
    }

    /// Merges tracks that have ended by the start of `segment` into the base.
    fn merge(&mut self, segment: u64) {
        for (i, slot) in self.slots.iter_mut().enumerate() {
            let Some(active) = slot.active.filter(|a| slot.flight.is_none() && a.end_segment() <= segment) else {
                continue;
            };
            for (u, end) in self.base.0.iter_mut().zip(&active.track.end) {
                *u += end;
            }
            *slot = Slot::default();
            if i < AXES {
                if let (Some(x), Desire::None) = (self.then[i].take(), self.desires[i]) {
                    self.desires[i] = Desire::Position(x, None);
                }
            } else if self.goal.is_none() && !active.stopping {
                self.goal = self.then_goal.take();
            }
        }
    }

    /// Turns desires and goals into tracks that begin with `segment`; each is given to `order`, which answers the
    /// sequence number under which the generator was told, or none when the queue is full.
    ///
    /// # Errors
    /// The first limit that a waiting goal or desire turned out to break; it is dropped, the others go on.
    pub fn plan(
        &mut self,
        capability: &Capability,
        segment: u64,
        mut order: impl FnMut(Proposal) -> Option<u16>,
    ) -> Result<(), Error> {
        self.merge(segment);
        for slot in 0..SLOTS {
            self.plan_changes(capability, slot, segment, &mut order);
        }
        let mut result = Ok(());
        if let Some(goal) = self.goal
            && let Err(error) = self.plan_goal(capability, goal, segment, &mut order)
        {
            (self.goal, self.then_goal) = (None, None);
            result = Err(error);
        }
        for axis in Axis::ALL {
            if let Err(error) = self.plan_desire(capability, axis, segment, &mut order) {
                self.desires[axis.index()] = Desire::None;
                self.then[axis.index()] = None;
                result = result.and(Err(error));
            }
        }
        result
    }

    /// Stops and changes of speed of a track that runs.
    fn plan_changes(
        &mut self,
        capability: &Capability,
        slot: usize,
        segment: u64,
        order: &mut impl FnMut(Proposal) -> Option<u16>,
    ) {
        let entry = &mut self.slots[slot];
        if entry.flight.is_some() || !(entry.stop || entry.replan) {
            return;
        }
        let Some(mut active) = entry.active else {
            (entry.stop, entry.replan) = (false, false);
            return;
        };
        let state = active.state(segment);
        let limits = with_speed(&active.grant, active.speed, capability.override_percent);
        let planned = if entry.stop {
            to_velocity(state, 0, active.grant.limits)
        } else {
            to_position(state, active.goal, limits)
        };
        let stop = entry.stop;
        let Ok(profile) = planned else {
            // it goes on as planned, and ends there
            (entry.stop, entry.replan) = (false, false);
            return;
        };
        let remaining = active.end_segment().saturating_sub(segment);
        if stop && u64::from(profile.duration()) >= remaining {
            // it comes to rest as soon without
            if let Some(active) = &mut entry.active {
                active.stopping = true;
            }
            (entry.stop, entry.replan) = (false, false);
            return;
        }
        active.track.profile = profile;
        active.start = segment;
        if stop {
            active.track.end = active.track.at(profile.end_position());
            active.stopping = true;
        }
        if self.launch(slot, active, Wish::Change, segment, order) {
            let entry = &mut self.slots[slot];
            (entry.stop, entry.replan) = (false, false);
        }
    }

    /// Hands a track to the generator; false when its queue is full.
    fn launch(
        &mut self,
        slot: usize,
        active: Active,
        wish: Wish,
        segment: u64,
        order: &mut impl FnMut(Proposal) -> Option<u16>,
    ) -> bool {
        match order(Proposal { slot: slot as u8, segment, track: active.track }) {
            Some(sequence) => {
                self.slots[slot].flight = Some(Flight { sequence, active, wish });
                true
            }
            None => false,
        }
    }

    fn plan_goal(
        &mut self,
        capability: &Capability,
        goal: Pose,
        segment: u64,
        order: &mut impl FnMut(Proposal) -> Option<u16>,
    ) -> Result<(), Error> {
        if self.slots.iter().any(|s| s.flight.is_some()) {
            return Ok(());
        }
        // The same goal again: it is on its way.
        if let Some(slot) = (COORDINATED..SLOTS).find(|i| self.slots[*i].active.is_some_and(|a| !a.stopping))
            && self.rest().rounded() == goal
            && self.slots[..AXES].iter().all(|s| s.active.is_none())
        {
            self.goal = None;
            self.slots[slot].replan = true;
            return Ok(());
        }
        let mut running = false;
        for slot in &mut self.slots {
            if slot.active.is_some_and(|a| !a.stopping) {
                slot.stop = true;
                running = true;
            }
        }
        if running {
            return Ok(());
        }
        let Some(slot) = (COORDINATED..SLOTS).find(|i| self.slots[*i].active.is_none()) else {
            return Ok(());
        };
        let rest = self.rest();
        let target = goal.fine();
        let mut direction = [0; AXES];
        for (d, (to, from)) in direction.iter_mut().zip(target.0.iter().zip(&rest.0)) {
            *d = to - from;
        }
        if direction == [0; AXES] {
            self.goal = self.then_goal.take();
            return Ok(());
        }
        let path = Path { origin: rest, direction, from: 0, to: PATH_ONE };
        let Some(grant) = self.grant(capability, &path, SLOTS, false)? else {
            return Ok(());
        };
        let limits = with_speed(&grant, PATH_ONE, capability.override_percent);
        let profile = to_position(State::rest(0), PATH_ONE, limits).map_err(|_| unplannable())?;
        let track = Track { origin: [0; AXES], direction, end: direction, profile };
        let active =
            Active { track, start: segment, grant, speed: PATH_ONE, goal: PATH_ONE, stopping: false, jog: false };
        if self.launch(slot, active, Wish::Goal(goal), segment, order) {
            self.goal = None;
        }
        Ok(())
    }

    fn plan_desire(
        &mut self,
        capability: &Capability,
        axis: Axis,
        segment: u64,
        order: &mut impl FnMut(Proposal) -> Option<u16>,
    ) -> Result<(), Error> {
        let i = axis.index();
        let (x, then, speed) = match self.desires[i] {
            Desire::None => return Ok(()),
            Desire::Position(x, then) => (x, then, u64::MAX),
            Desire::Jog { limit, speed } => (limit, None, speed),
        };
        let coordinated = self.slots[COORDINATED..].iter().any(|s| s.flight.is_some());
        if self.slots[i].flight.is_some() || coordinated || self.slots[i].stop {
            return Ok(());
        }
        let origin = self.rest_without(i);
        let end = (i64::from(x) << 32) - origin.0[i];
        let goal = end; // Q32 nm is Q60 of the path unit, see there
        let mut direction = [0; AXES];
        direction[i] = 1 << (32 + SINGLE_AXIS_UNIT_BITS);
        let running = self.slots[i].active;
        let state = running.map_or(State::rest(0), |a| a.state(segment));
        if running.is_none() && goal == 0 {
            self.desires[i] = then.map_or(Desire::None, |x| Desire::Position(x, None));
            return Ok(());
        }
        // where it would come to rest by itself counts too: it may overshoot the new target and return
        let mut reach = [0, goal, state.position, state.position];
        if let Some(active) = &running {
            let stop = to_velocity(state, 0, active.grant.limits).map_err(|_| unplannable())?;
            reach[3] = stop.end_position();
            reach[0] = state.position;
        }
        let path = Path {
            origin,
            direction,
            from: reach.iter().copied().min().unwrap_or(0),
            to: reach.iter().copied().max().unwrap_or(0),
        };
        let Some(mut grant) = self.grant(capability, &path, i, true)? else {
            return Ok(());
        };
        if let Some(active) = &running {
            // what it may still have of its old rates stays reserved
            for (new, old) in grant.uses.iter_mut().zip(&active.grant.uses) {
                *new = new.max(*old);
            }
            grant.limits.acceleration = grant.limits.acceleration.max(active.grant.limits.acceleration);
            grant.limits.jerk = grant.limits.jerk.max(active.grant.limits.jerk);
            grant.turning = Turning {
                velocity: grant.turning.velocity.max(active.grant.turning.velocity),
                acceleration: grant.turning.acceleration.max(active.grant.turning.acceleration),
            };
        }
        // nm per segment in Q44 to path units in Q60
        let speed = ((u128::from(speed) << 16) >> SINGLE_AXIS_UNIT_BITS).clamp(1, 1 << 60) as i64;
        let limits = with_speed(&grant, speed, capability.override_percent);
        let profile = to_position(state, goal, limits).map_err(|_| unplannable())?;
        let mut track = Track { origin: [0; AXES], direction, end: [0; AXES], profile };
        track.end[i] = end;
        let jog = matches!(self.desires[i], Desire::Jog { .. });
        let active = Active { track, start: segment, grant, speed, goal, stopping: false, jog };
        if self.launch(i, active, Wish::Desire(self.desires[i]), segment, order) {
            self.desires[i] = Desire::None;
            self.then[i] = then;
            self.slots[i].replan = false;
        }
        Ok(())
    }

    /// What a path may use, or none while the others leave it too little.
    ///
    /// # Errors
    /// A limit that the path breaks.
    fn grant(&self, capability: &Capability, path: &Path, own: usize, single: bool) -> Result<Option<Grant>, Error> {
        let Capability { law, motors, wanted, limits, .. } = capability;
        let mut taken = [Rates::default(); AXES];
        let mut others = Turning::default();
        let mut remaining = 0u64;
        let mut reach = [0i64; AXES];
        for (i, slot) in self.slots.iter().enumerate() {
            let Some(active) = slot.latest().filter(|_| i != own) else {
                continue;
            };
            for (taken, uses) in taken.iter_mut().zip(&active.grant.uses) {
                *taken = taken.plus(*uses);
            }
            others.velocity += active.grant.turning.velocity;
            others.acceleration += active.grant.turning.acceleration;
            let turns: u64 = active.track.end[3..].iter().map(|e| e.unsigned_abs() >> 32).sum();
            remaining += turns;
            let _ = &mut reach;
        }
        let bounds = Bounds::along(law, path, remaining);
        limits.check_motors(law, &bounds, &reach)?;
        let mut ways = [0; AXES];
        for (way, d) in ways.iter_mut().zip(&path.direction) {
            *way = (d.unsigned_abs() >> 16) + u64::from(*d != 0);
        }
        let lever = law.lever_nm();
        let lever_steps = |i: usize, nrad2_q40: u128| {
            // lever [nm] * angle^2 [nrad^2, Q40] / 10^18 / step [Q32] in Q44, a quarter added
            let nm = nrad2_q40 / 1_000_000_000 * u128::from(lever) / 1_000_000_000 + 1;
            u64::try_from((nm << 36) / u128::from(law.step_q32(i).max(1)) * 5 / 4 + 1).unwrap_or(u64::MAX >> 1)
        };
        let share = if single { SINGLE_SHARE_1024 } else { 1024 };
        let mut left = *motors;
        for (left, taken) in left.iter_mut().zip(&taken) {
            *left = left.less(*taken).share(share);
        }
        let grant = Grant::within(&bounds, &left, wanted, &ways, others, lever_steps);
        if taken != [Rates::default(); AXES] {
            let alone = motors.map(|m| m.share(share));
            let best = Grant::within(&bounds, &alone, wanted, &ways, Turning::default(), lever_steps);
            let (a, b) = (grant.limits, best.limits);
            let enough = |have: i64, want: i64| have >= want / WAIT_BELOW && have > 1;
            if !(enough(a.velocity, b.velocity) && enough(a.acceleration, b.acceleration) && enough(a.jerk, b.jerk)) {
                return Ok(None);
            }
        }
        Ok(Some(grant))
    }

    /// Checks a move of one or all axes before it is accepted, from where everything comes to rest.
    ///
    /// # Errors
    /// -222 with the axis and the value, 108 with the disabled axis.
    pub fn check(&self, capability: &Capability, from: Pose, to: Pose) -> Result<DryRun, Error> {
        capability.limits.check_pose(&capability.law, to)?;
        let rest = from.fine();
        let mut direction = [0; AXES];
        for (d, (to, from)) in direction.iter_mut().zip(to.fine().0.iter().zip(&rest.0)) {
            *d = to - from;
        }
        if direction == [0; AXES] {
            return Ok(DryRun::default());
        }
        let path = Path { origin: rest, direction, from: 0, to: PATH_ONE };
        let idle = Planner::at_rest(from);
        let Some(grant) = idle.grant(capability, &path, SLOTS, false)? else {
            return Err(unplannable());
        };
        let limits = with_speed(&grant, PATH_ONE, capability.override_percent);
        let profile = to_position(State::rest(0), PATH_ONE, limits).map_err(|_| unplannable())?;
        let peak = peak_velocity(&profile);
        let granted = u128::from(grant.limits.velocity.unsigned_abs().max(1));
        let rate = |uses: Rates| (u128::from(uses.velocity) * peak / granted) as u64;
        Ok(DryRun { segments: u64::from(profile.duration()), step_rates: grant.uses.map(rate) })
    }

    /// Largest speed of each axis in segment `segment`, nm or nrad per segment in Q32.
    pub fn speeds(&self, segment: u64) -> [u64; AXES] {
        let mut speeds = [0u64; AXES];
        for active in self.slots.iter().filter_map(|s| s.active) {
            let elapsed = segment.saturating_sub(active.start).min(u64::from(u32::MAX - 1)) as u32;
            let (a, b) = (active.track.contribution(elapsed, &mut 0), active.track.contribution(elapsed + 1, &mut 0));
            for (speed, (a, b)) in speeds.iter_mut().zip(a.iter().zip(&b)) {
                *speed += a.abs_diff(*b);
            }
        }
        speeds
    }
}

/// Largest velocity of a profile from rest, path units per segment in Q60, from its samples.
fn peak_velocity(profile: &Profile) -> u128 {
    // the peak of a move from rest lies in its cruise, hence at half its duration
    let state = profile.state(profile.duration() / 2);
    state.velocity.unsigned_abs() >> 30
}

fn unplannable() -> Error {
    Error::text(ErrorNumber::SettingsConflict, "no profile within these rates")
}

/// The granted limits with a speed wish and the override on the velocity.
fn with_speed(grant: &Grant, speed: i64, percent: u8) -> super::ramp::Limits {
    let mut limits = grant.limits;
    let fast = limits.velocity.min(speed);
    limits.velocity = (fast / 100 * i64::from(percent.clamp(1, 100))).max(1);
    limits
}
