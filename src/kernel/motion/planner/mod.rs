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

mod checked;
mod launch;
mod share;
mod slot;
#[cfg(test)]
mod tests;

use super::bounds::{PATH_ONE, Path};
use super::budget::{Grant, Rates};
use super::limits::Limits;
use super::plan::position_profile;
use super::profile::{Profile, State};
use super::track::Track;
use crate::compensation::law::Law;
use crate::error::{Error, ErrorNumber};
use crate::units::{AXES, Axis, FinePose, Pose};
use checked::Checked;
pub use checked::Versioned;
use slot::{Active, Intent, Slot};

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
    /// Constant velocity towards the limit of that side; the speed in nm or nrad per segment, Q44.
    Jog {
        /// In the positive direction.
        upwards: bool,
        /// Where it would end, as far as known.
        limit: i32,
        /// Speed.
        speed: u64,
    },
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

/// A track that the generator is to run: the latest of its slot.
#[derive(Clone, Copy, Debug)]
pub struct Proposal {
    /// Which slot.
    pub slot: u8,
    /// With which segment it begins.
    pub segment: u64,
    /// Nothing else runs or is to begin: if the stage stands it may as well begin as soon as the generator sees it.
    pub alone: bool,
}

/// How a proposal was ordered.
#[derive(Clone, Copy, Debug)]
pub struct Ordered {
    /// Sequence number of the order.
    pub sequence: u16,
    /// The track begins as soon as the generator sees it.
    pub at_once: bool,
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
    /// The move that was checked last.
    checked: Checked,
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
            checked: Checked::default(),
        }
    }

    /// True while a track runs or one is still to be planned.
    pub fn is_moving(&self) -> bool {
        self.goal.is_some()
            || self.then_goal.is_some()
            || self.then.iter().any(Option::is_some)
            || self.desires.iter().any(|d| *d != Desire::None)
            || self.slots.iter().any(|s| s.is_taken())
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

    /// How far a jog can take an axis. The others may still be on their way: at both ends of it no motor may leave its
    /// travel, and between them it goes straight.
    pub fn farthest(&self, capability: &Capability, axis: Axis, upwards: bool, segment: u64) -> i32 {
        let reach = |pose| capability.limits.farthest(&capability.law, pose, axis, upwards);
        let rest = self.rest();
        let (here, at_rest, now) = (rest.rounded().0[axis.index()], reach(rest), reach(self.pose_at(segment)));
        if upwards { at_rest.min(now).max(here) } else { at_rest.max(now).min(here) }
    }

    /// Where everything that runs is at the begin of a segment.
    fn pose_at(&self, segment: u64) -> FinePose {
        let mut pose = self.base;
        for active in self.slots.iter().filter_map(Slot::latest) {
            let elapsed = segment.saturating_sub(active.start).min(u64::from(u32::MAX)) as u32;
            for (u, now) in pose.0.iter_mut().zip(active.track.contribution(elapsed, &mut 0)) {
                *u += now;
            }
        }
        pose
    }

    /// The commanded pose: where the axes are at last to stand. A jog has no target: where it is at `segment`.
    pub fn commanded(&self, segment: u64) -> Pose {
        let mut rest = self.rest();
        for active in self.slots.iter().filter_map(Slot::latest).filter(|a| a.jog && !a.stopping) {
            let elapsed = segment.saturating_sub(active.start).min(u64::from(u32::MAX)) as u32;
            let now = active.track.contribution(elapsed, &mut 0);
            for (u, (now, end)) in rest.0.iter_mut().zip(now.iter().zip(&active.track.end)) {
                *u += now - end;
            }
        }
        let mut pose = rest.rounded();
        if let Some(goal) = self.then_goal.or(self.goal) {
            pose = goal;
        }
        for (i, desire) in self.desires.iter().enumerate() {
            match (desire, self.then[i]) {
                (Desire::Position(x, then), _) => pose.0[i] = then.unwrap_or(*x),
                (Desire::None, Some(x)) => pose.0[i] = x,
                (Desire::Jog { .. } | Desire::None, _) => {}
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
        self.slots[axis.index()].supersede();
        self.then[axis.index()] = None;
        self.desires[axis.index()] = desire;
    }

    /// A new goal of all axes, and where to go from there.
    pub fn go(&mut self, goal: Pose, then: Option<Pose>) {
        self.slots.iter_mut().for_each(Slot::supersede);
        // also if the goal is taken back before it is planned: what it supersedes must not go on
        for slot in &mut self.slots[..AXES] {
            slot.stop = slot.is_taken();
        }
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
        self.slots[i].stop = self.slots[i].is_taken();
        self.slots[i].supersede();
        if self.is_coordinated(axis) {
            self.stop_coordinated();
        }
    }

    /// Decelerates every coordinated move.
    #[inline(never)]
    pub fn stop_coordinated(&mut self) {
        self.goal = None;
        self.then_goal = None;
        for slot in &mut self.slots[COORDINATED..] {
            slot.stop = slot.is_taken();
            slot.supersede();
        }
    }

    /// True while a stop is still to be planned: until then where it ends is not known.
    pub fn is_about_to_stop(&self) -> bool {
        self.slots.iter().any(|s| s.stop && s.is_taken())
    }

    /// True while a track runs or is on its way.
    #[inline(never)]
    pub fn is_running(&self) -> bool {
        self.slots.iter().any(|s| s.is_taken())
    }

    /// The track that was ordered under this number, while it is unanswered.
    pub fn on_its_way(&self, slot: u8, sequence: u16) -> Option<&Track> {
        let slot = self.slots.get(usize::from(slot))?;
        slot.flight.filter(|flight| flight.sequence == sequence)?;
        Some(&slot.next().track)
    }

    /// The wanted speed has changed: what runs is planned again.
    pub fn replan_all(&mut self) {
        for slot in &mut self.slots {
            slot.replan = slot.latest().is_some_and(|a| !a.stopping);
        }
    }

    /// The answers of the generator: `answered` is the last order that it has seen, bit k of `refused` says that
    /// order `answered - k` was refused. `begun`: where the track began that was to begin as soon as it was seen. What
    /// has ended before `segment` goes into the base.
    ///
    /// True when one was refused.
    pub fn answer(&mut self, answered: u16, refused: u32, begun: u64, segment: u64) -> bool {
        let mut any_refused = false;
        for i in 0..SLOTS {
            let Some(flight) = self.slots[i].flight else { continue };
            let age = answered.wrapping_sub(flight.sequence);
            if age >= 0x8000 {
                continue;
            }
            if age < 32 && refused >> age & 1 == 0 {
                self.slots[i].take();
                if let Some(active) = self.slots[i].active_mut().filter(|_| flight.at_once) {
                    active.start = begun;
                }
            } else {
                any_refused = true;
                self.slots[i].flight = None;
                self.want_again(i, flight.intent, self.slots[i].next().stopping);
            }
        }
        self.merge(segment);
        any_refused
    }

    /// A refused track is planned again from the state at a later segment.
    fn want_again(&mut self, i: usize, intent: Intent, stopping: bool) {
        let slot = &mut self.slots[i];
        match intent {
            _ if slot.active().is_none() && slot.stop => slot.stop = false,
            Intent::Change => {
                slot.stop |= stopping;
                slot.replan |= !stopping;
            }
            // it comes to rest where it was to before
            _ if slot.stop => {}
            Intent::Desire(desire) if i < AXES => {
                self.desires[i] = desire;
                self.then[i] = None;
            }
            Intent::Goal(goal) => self.goal = Some(goal),
            Intent::None | Intent::Desire(_) => {}
        }
    }

    /// Forgets what is still to be planned.
    pub fn forget(&mut self) {
        self.desires = [Desire::None; AXES];
        self.then = [None; AXES];
        (self.goal, self.then_goal) = (None, None);
    }

    /// Forgets every track, desire and goal: the motors were stopped at once.
    pub fn clear(&mut self) {
        self.rest_at(self.rest().rounded());
    }

    /// Stands at a pose.
    pub fn rest_at(&mut self, pose: Pose) {
        // in place: a planner is too large to be made on the stack of a board
        self.base = pose.fine();
        self.slots.iter_mut().for_each(Slot::clear);
        self.desires = [Desire::None; AXES];
        (self.goal, self.then_goal, self.then) = (None, None, [None; AXES]);
    }

    /// Merges tracks that have ended by the start of `segment` into the base.
    fn merge(&mut self, segment: u64) {
        for (i, slot) in self.slots.iter_mut().enumerate() {
            let ended = slot.active().filter(|a| slot.flight.is_none() && a.end_segment() <= segment);
            let Some(&Active { track: Track { ref end, .. }, stopping, .. }) = ended else {
                continue;
            };
            for (u, end) in self.base.0.iter_mut().zip(end) {
                *u += end;
            }
            slot.clear();
            if i < AXES {
                if let (Some(x), Desire::None) = (self.then[i].take(), self.desires[i]) {
                    self.desires[i] = Desire::Position(x, None);
                }
            } else if self.goal.is_none() && !stopping {
                self.goal = self.then_goal.take();
            }
        }
    }

    /// Checks a move of one or all axes from where everything comes to rest.
    ///
    /// # Errors
    /// -222 with the axis and the value, 108 with the disabled axis.
    pub fn check(&self, capability: &Versioned<Capability>, from: Pose, to: Pose) -> Result<DryRun, Error> {
        let mut checked = Checked::default();
        checked.look_at(capability, from, to)?;
        Ok(checked.dry_run())
    }

    /// [`Planner::check`] of a move that is to be made: it need not be planned again if it begins as it was checked.
    ///
    /// # Errors
    /// Those of [`Planner::check`].
    pub fn prepare(&mut self, capability: &Versioned<Capability>, from: Pose, to: Pose) -> Result<(), Error> {
        self.checked.look_at(capability, from, to)
    }

    /// Largest speed of each axis in segment `segment`, nm or nrad per segment in Q32.
    pub fn speeds(&self, segment: u64) -> [u64; AXES] {
        let mut speeds = [0u64; AXES];
        for active in self.slots.iter().filter_map(Slot::active) {
            let elapsed = segment.saturating_sub(active.start).min(u64::from(u32::MAX - 1)) as u32;
            let (a, b) = (active.track.contribution(elapsed, &mut 0), active.track.contribution(elapsed + 1, &mut 0));
            for (speed, (a, b)) in speeds.iter_mut().zip(a.iter().zip(&b)) {
                *speed += a.abs_diff(*b);
            }
        }
        speeds
    }
}

/// The straight way between two poses at rest.
#[inline(never)]
fn straight(from: &FinePose, to: &FinePose) -> Path {
    let mut direction = [0; AXES];
    for (d, (to, from)) in direction.iter_mut().zip(to.0.iter().zip(&from.0)) {
        *d = to - from;
    }
    Path { origin: *from, direction, from: 0, to: PATH_ONE }
}

/// From rest to rest over a whole path.
fn go_along(capability: &Capability, grant: &Grant, profile: &mut Profile) -> Option<()> {
    let limits = with_speed(grant, PATH_ONE, capability.override_percent);
    position_profile(State::rest(0), PATH_ONE, limits, profile)
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
