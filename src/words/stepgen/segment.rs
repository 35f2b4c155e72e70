//! Step placement: from the motor positions at the two ends of a segment to its BSRR words.
//!
//! # Design
//! The buffer is cleared to a pattern that lowers all STEP lines on every multiple of the grid, and
//! a step only ever *sets* a bit. In BSRR a set bit wins, so a pulse is one grid wide and there is
//! nothing to carry over the border. The steps due in a segment are the difference of the
//! floors of its two positions, each at the tick in which the straight line between them crosses
//! the whole step. Nothing else is remembered, hence no rounding can add up:
//! `emitted + waiting` equals the floor of the position at every border.
//!
//! # Waiting
//! A step for which there is no legal tick (the motor has just turned: DIR hold and set-up) goes out at
//! the first legal one, also across the border, in order. Steps of opposite sense that meet while
//! waiting cancel. At most one step waits if a motor, around its first step the other way, makes no
//! more than one within its hold and set-up time, which any sane acceleration sees to: it
//! turns at rest. Beyond that more steps wait, and none is lost. DIR changes in the segment that owes
//! the first step, not at the turn itself: a motor that dithers within a step toggles nothing.
//!
//! # Limitations
//! The clock of ticks wraps. It may jump ahead between segments by less than 2^30 ticks, never back.
//! Faster motion than [`Timing::max_step_rate`](super::timing::Timing::max_step_rate) obeys the
//! timing and waits.

use super::crossing::{Crossings, FRACTION_BITS, whole};
use super::pins::{RESET_STEPS, reset};
use super::timing::{Line, Timing};
use crate::units::{AXES, FineSteps, SEGMENT_TICKS};

/// No heading: what comes next takes the detour.
const UNSURE: i32 = 1;

/// The BSRR words of one segment, one per tick.
pub type Words = [u32; SEGMENT_TICKS];

/// What has gone out to one motor, and when more may.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Emitter {
    /// Steps emitted, signed: upwards minus downwards.
    pub(super) emitted: i32,
    /// Steps due and not yet emitted, signed.
    pub(super) waiting: i32,
    /// Where DIR points while nothing waits: 0 upwards, -1 downwards, else [`UNSURE`].
    pub(super) heading: Heading,
    /// Level of the DIR line.
    pub(super) dir: bool,
    /// First tick in which STEP may rise.
    pub(super) next_rise: u32,
    /// First tick in which DIR may change.
    pub(super) next_turn: u32,
}

/// See [`Emitter`]. It follows from the rest and the sense of DIR, so that it tells no two emitters apart.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heading(i32);

impl Default for Heading {
    fn default() -> Self {
        Heading(UNSURE)
    }
}

impl PartialEq for Heading {
    fn eq(&self, _: &Heading) -> bool {
        true
    }
}

impl Eq for Heading {}

impl Emitter {
    /// An emitter that stands at `steps` at tick `base`, with its DIR line at level `dir`, which has
    /// been steady for the set-up time, and its STEP line low.
    pub fn at(steps: i32, dir: bool, base: u32) -> Emitter {
        Emitter { emitted: steps, dir, next_rise: base, next_turn: base, ..Emitter::default() }
    }

    /// Steps emitted, signed; wraps.
    pub fn emitted(&self) -> i32 {
        self.emitted
    }

    /// Steps due and not yet emitted, signed: -1, 0 or 1 under legal motion.
    pub fn waiting(&self) -> i32 {
        self.waiting
    }

    /// Level of the DIR line after the last segment.
    pub fn dir(&self) -> bool {
        self.dir
    }

    /// The sense of DIR may have changed.
    pub fn disturb(&mut self) {
        self.heading = Heading::default();
    }

    /// Puts the steps of one segment, from position `from` to `to` (Q32.32 steps), into its words.
    /// True when something unusual happened, so that a step may [wait](Emitter::waiting) or wait no longer.
    ///
    /// `words` has been [cleared](clear); `base` is the tick of its first word. `from` is the `to` of
    /// the segment before, and the two lie less than 2^31 steps apart. `UNIT`: the grid is one tick, which saves an
    /// instruction per step; false is right for every grid.
    #[inline(always)]
    pub fn place<const UNIT: bool>(&mut self, line: &Line, from: i64, to: i64, base: u32, words: &mut Words) -> bool {
        let due = ((to >> 32) as i32).wrapping_sub((from >> 32) as i32);
        if due == 0 {
            if self.waiting != 0 {
                self.detour(line, Crossings::AT_ONCE, 0, base, words);
                return true;
            }
            if base.wrapping_sub(self.next_rise) as i32 > 1 << 30 {
                self.forget(base);
            }
            return false;
        }
        if self.heading.0 != due >> 31 {
            self.turn(line, from, to, base, words);
            return true;
        }
        let crossings = Crossings::new(from, to, due);
        let ready = self.next_rise.wrapping_sub(base) as i32;
        let (gap, on_grid) = if UNIT { (2, u32::MAX) } else { (line.gap(), line.on_grid(u32::MAX)) };
        let tick = |time: u32| time >> FRACTION_BITS & on_grid;
        if whole(crossings.period) < gap << FRACTION_BITS || (tick(crossings.first) as i32) < ready {
            self.detour(line, crossings, due, base, words);
            return true;
        }
        let step = line.step;
        let last = crossings.each(due.unsigned_abs(), |time| {
            if let Some(word) = words.get_mut(tick(time) as usize) {
                *word |= step;
            }
        });
        let last = base.wrapping_add(tick(last));
        self.emitted = (to >> 32) as i32;
        self.next_rise = last.wrapping_add(gap);
        self.next_turn = last.wrapping_add(line.hold);
        false
    }

    /// The motor does not go on as before.
    #[inline(never)]
    #[cold]
    fn turn(&mut self, line: &Line, from: i64, to: i64, base: u32, words: &mut Words) {
        let due = ((to >> 32) as i32).wrapping_sub((from >> 32) as i32);
        self.detour(line, Crossings::new(from, to, due), due, base, words);
    }

    /// Everything unusual: a turn, a step that waits, a border too near, motion too fast.
    #[inline(never)]
    #[cold]
    fn detour(&mut self, line: &Line, crossings: Crossings, due: i32, base: u32, words: &mut Words) {
        self.emit(line, crossings, due, base, words);
        let upwards = self.dir != line.inverted;
        self.heading = Heading(if self.waiting != 0 { UNSURE } else { i32::from(upwards) - 1 });
    }

    #[inline(always)]
    fn emit(&mut self, line: &Line, crossings: Crossings, due: i32, base: u32, words: &mut Words) {
        let before = self.waiting;
        let owed = before.wrapping_add(due);
        self.waiting = owed;
        if owed == 0 {
            return;
        }
        let mut ready = until(self.next_rise, base);
        let dir = (owed > 0) != line.inverted;
        if dir != self.dir {
            let turn = until(self.next_turn, base);
            let Some(word) = words.get_mut(turn as usize) else {
                return;
            };
            *word |= if dir { line.dir } else { reset(line.dir) };
            self.dir = dir;
            ready = ready.max(turn + line.setup);
            self.next_rise = base.wrapping_add(ready);
            // The next change comes in a later segment anyhow; this keeps the tick near the clock.
            self.next_turn = base.wrapping_add(turn + 1);
        }
        // The crossings of this segment that no waiting step cancelled are the last of those owed;
        // what comes before them is due at once.
        let left = owed.unsigned_abs();
        let fresh = if (due ^ owed) < 0 { 0 } else { left.min(due.unsigned_abs()) };
        let cancelled = due.unsigned_abs().wrapping_sub(fresh);
        let mut late = left.wrapping_sub(fresh);
        let mut time = (u64::from(crossings.first) << 32).wrapping_add(crossings.period.wrapping_mul(cancelled.into()));
        let one = if owed > 0 { 1 } else { -1 };
        while self.waiting != 0 {
            let tick = if late > 0 { 0 } else { line.on_grid(whole(time) >> FRACTION_BITS) };
            let tick = tick.max(line.on_grid(ready + line.grid - 1));
            let Some(word) = words.get_mut(tick as usize) else {
                return;
            };
            *word |= line.step;
            if late > 0 {
                late -= 1;
            } else {
                time = time.saturating_add(crossings.period);
            }
            ready = tick + line.gap();
            self.next_rise = base.wrapping_add(ready);
            self.next_turn = base.wrapping_add(tick + line.hold);
            self.waiting -= one;
            self.emitted = self.emitted.wrapping_add(one);
        }
    }

    /// Long at rest: before the clock wraps, the last edge must not look like one to come.
    #[inline(never)]
    #[cold]
    fn forget(&mut self, base: u32) {
        self.next_rise = base;
        self.next_turn = base;
    }
}

/// Ticks from `base` until `tick`, zero if that has passed.
fn until(tick: u32, base: u32) -> u32 {
    (tick.wrapping_sub(base) as i32).max(0) as u32
}

/// Clears the words of a segment: all STEP lines are lowered on the grid.
#[inline(never)]
pub fn clear(words: &mut Words, timing: &Timing) {
    let grid = timing.grid();
    let odd = if grid == 1 { RESET_STEPS } else { 0 };
    let even = if grid <= 2 { RESET_STEPS } else { 0 };
    for pair in words.as_chunks_mut::<2>().0 {
        *pair = [even, odd];
    }
    if grid > 2 {
        for word in words.iter_mut().step_by(grid as usize) {
            *word = RESET_STEPS;
        }
    }
}

/// Makes the words of one segment for all motors: [`clear`], then [`Emitter::place`] for each.
pub fn place_all(
    emitters: &mut [Emitter; AXES],
    from: &FineSteps,
    to: &FineSteps,
    base: u32,
    timing: &Timing,
    words: &mut Words,
) {
    clear(words, timing);
    let ways = from.0.iter().zip(&to.0);
    for ((emitter, line), (&from, &to)) in emitters.iter_mut().zip(timing.lines()).zip(ways) {
        emitter.place::<false>(line, from, to, base, words);
    }
}
