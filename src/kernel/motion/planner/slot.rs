//! What runs in a slot, and what is on its way to run there.

use super::Desire;
use crate::motion::budget::Grant;
use crate::motion::profile::{Profile, State};
use crate::motion::track::Track;
use crate::units::Pose;

/// A track that runs, with what it was granted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Active {
    pub track: Track,
    pub start: u64,
    pub grant: Grant,
    /// Speed limit asked for by a jog, path units per segment in Q60; the granted one otherwise.
    pub speed: i64,
    /// Path position at which it is to end.
    pub goal: i64,
    /// Lowest and highest path position on the way, when it does not run straight to its end.
    pub detour: Option<(i64, i64)>,
    pub stopping: bool,
    pub jog: bool,
}

impl Active {
    pub fn end_segment(&self) -> u64 {
        self.start + u64::from(self.track.profile.duration())
    }

    pub fn state(&self, segment: u64) -> State {
        self.track.profile.state(segment.saturating_sub(self.start).min(u64::from(u32::MAX)) as u32)
    }

    /// Lowest and highest path position from a segment on.
    pub fn extent(&self, segment: u64) -> (i64, i64) {
        let (at, end) = (self.state(segment).position, self.track.profile.end_position());
        let (low, high) = self.detour.unwrap_or((at, at));
        (low.min(at).min(end), high.max(at).max(end))
    }

    /// Whether another profile from that segment on stays on the way that was checked for this one.
    pub fn covers(&self, profile: &Profile, segment: u64) -> bool {
        beyond(self.extent(segment), profile) == (false, false)
    }
}

/// Path (Q60) by which the evaluation of a profile may round beyond its ends.
const ROUNDING: i64 = 1 << 12;

/// Whether a profile leads below and above a stretch of the path. Whole segments make what a moving track can do
/// differ from one segment to the next: a stop ends up to two segments later, or it turns back later.
pub(super) fn beyond((low, high): (i64, i64), profile: &Profile) -> (bool, bool) {
    let (lowest, highest) = profile.extent();
    (lowest < low.saturating_sub(ROUNDING), highest > high.saturating_add(ROUNDING))
}

/// What a track on its way is for: wanted again if the generator refuses it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) enum Intent {
    /// Superseded meanwhile.
    #[default]
    None,
    /// A stop or another speed.
    Change,
    /// A desire of the slot's axis.
    Desire(Desire),
    /// A goal of all axes.
    Goal(Pose),
}

/// A track that was ordered and not yet answered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flight {
    pub sequence: u16,
    pub intent: Intent,
    /// It begins as soon as the generator sees it; until the answer its start is a guess, and nothing is planned.
    pub at_once: bool,
}

/// Room for two tracks, neither of which is ever moved: they are large.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slot {
    tracks: [Active; 2],
    /// Which of them runs; the other one is made ready, or on its way.
    second: bool,
    /// One runs.
    runs: bool,
    /// The other one is on its way.
    pub flight: Option<Flight>,
    pub stop: bool,
    pub replan: bool,
}

impl Slot {
    /// Nothing runs, nothing is on its way.
    pub fn clear(&mut self) {
        (self.runs, self.flight) = (false, None);
        (self.stop, self.replan) = (false, false);
    }

    /// The track that runs, and room for the next one, which must not be on its way.
    fn parts(&mut self) -> (&mut Active, &mut Active) {
        let [first, second] = &mut self.tracks;
        if self.second { (second, first) } else { (first, second) }
    }

    /// What runs.
    pub fn active(&self) -> Option<&Active> {
        self.runs.then_some(&self.tracks[usize::from(self.second)])
    }

    /// What runs.
    pub fn active_mut(&mut self) -> Option<&mut Active> {
        if self.runs { Some(self.parts().0) } else { None }
    }

    /// What is on its way, or will be once it is ready.
    pub fn next(&self) -> &Active {
        &self.tracks[usize::from(!self.second)]
    }

    /// Where the next track is made ready; not while one is on its way.
    pub fn next_mut(&mut self) -> &mut Active {
        self.parts().1
    }

    /// The next track, until now the same as the one that runs.
    pub fn next_like_active(&mut self) -> &mut Active {
        let (active, next) = self.parts();
        *next = *active;
        next
    }

    /// What is on its way runs from now on.
    pub fn take(&mut self) {
        (self.second, self.runs, self.flight) = (!self.second, true, None);
    }

    /// What will run once the answer is there, as far as known.
    #[inline(always)]
    pub fn latest(&self) -> Option<&Active> {
        if self.is_taken() { Some(self.newest()) } else { None }
    }

    #[inline(never)]
    fn newest(&self) -> &Active {
        &self.tracks[usize::from(self.second != self.flight.is_some())]
    }

    /// Something runs, or is on its way.
    #[inline(always)]
    pub const fn is_taken(&self) -> bool {
        self.flight.is_some() || self.runs
    }

    /// What runs and what is on its way.
    pub fn each_mut(&mut self) -> impl Iterator<Item = &mut Active> {
        let (runs, flies) = (self.runs, self.flight.is_some());
        let (active, next) = self.parts();
        [(active, runs), (next, flies)].into_iter().filter_map(|(track, is)| is.then_some(track))
    }

    /// What is on its way is no longer wanted for itself.
    pub fn supersede(&mut self) {
        if let Some(flight) = &mut self.flight {
            flight.intent = Intent::None;
        }
    }

    /// Lowest and highest path position from a segment on, relative to where it is to end; whether or not what is
    /// on its way is refused.
    pub fn reach(&self, segment: u64) -> (i64, i64) {
        let Some(latest) = self.latest() else { return (0, 0) };
        let end = latest.track.profile.end_position();
        let mut reach = (0, 0);
        for active in [self.active(), Some(latest)].into_iter().flatten() {
            let (low, high) = active.extent(segment);
            reach = (reach.0.min(low.saturating_sub(end)), reach.1.max(high.saturating_sub(end)));
        }
        reach
    }
}
