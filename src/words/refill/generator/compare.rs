//! Position compare: a pulse on the trigger line in the word in which a logical axis passes a position.
//!
//! # Design
//! Between two borders the axis is taken to go straight, as the motors are when their steps are placed; the word is the
//! one in whose microsecond it passes the position, either way. What it stands on exactly at a border counts as above,
//! so that a turn there is one crossing or none. The pulse goes into the words as a step does: what is not played
//! because of an abort is taken back with them, and is due again. After an abort the axis stands where its whole steps
//! say, up to half a step from where it was on its way: positions in between count as passed with the next motion.
//!
//! The line is lowered one grid later, by a bit of its own: words without a pulse are as they were before there was
//! this.

use super::Generator;
use super::history::HISTORY;
use crate::refill::border::Compare;
use crate::stepgen::pins::{TRIGGER, reset};
use crate::stepgen::segment::Words;
use crate::units::{FinePose, SEGMENT_TICKS};

/// Ways that are remembered: of the segment that plays, those made ahead, and one more.
const WAYS: usize = 4;

/// The way of the axis in a segment.
#[derive(Clone, Copy, Debug, Default)]
struct Way {
    segment: u64,
    from: i64,
    to: i64,
}

/// A [`Compare`] and how far it has come.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Comparing {
    wanted: Compare,
    /// Pulses in what was generated.
    pub(super) pulsed: u16,
    /// The segment from which on pulses are its own.
    since: u64,
    /// Where the axis stood at the end of what was generated, or where an abort met it.
    at: i64,
    /// The next anchor names what an abort has left.
    aborted: bool,
    ways: [Way; WAYS],
}

impl Comparing {
    /// Takes what was generated from `segment` on as not its own any more, because it is generated anew.
    pub(super) fn take_back(&mut self, segment: u64) {
        self.since = self.since.min(segment);
    }

    /// Pulses are still to come.
    fn is_armed(&self) -> bool {
        self.pulsed < self.wanted.count
    }
}

/// The word, of those of a segment, in which an axis has gone `way` of `distance`, both below 2^62: the last one of which
/// it has gone less before, or, `early`, the one at whose end it has gone as much at the latest.
fn tick_of(mut way: u64, distance: u64, early: bool) -> usize {
    // one bit of the quotient after the other: what is left stays below the distance, or is at most that
    let (least, mut tick) = (distance.wrapping_add(early.into()), 0);
    for _ in 0..SEGMENT_TICKS.ilog2() {
        (way, tick) = (way << 1, tick << 1);
        if way >= least {
            (way, tick) = (way.wrapping_sub(distance), tick | 1);
        }
    }
    tick
}

impl Generator {
    /// Begins a compare, in place of the one before.
    #[inline(never)]
    pub(super) fn compare(&mut self, wanted: Compare) {
        let at = self.pose().0.get(usize::from(wanted.axis)).copied().unwrap_or(0);
        self.comparing = Comparing { wanted, since: self.segment, at, ..Comparing::default() };
        self.armed = self.comparing.is_armed();
        for start in &mut self.history {
            start.pulsed = 0;
        }
    }

    /// The axis stands elsewhere without having gone there.
    pub(super) fn compare_from(&mut self, pose: &FinePose) {
        let comparing = &mut self.comparing;
        if let (false, Some(at)) = (comparing.aborted, pose.0.get(usize::from(comparing.wanted.axis))) {
            comparing.at = *at;
        }
        comparing.aborted = false;
    }

    /// The pulses of a segment at whose end the axes stand at `pose`.
    #[cold]
    #[inline(never)]
    pub(super) fn pulse(&mut self, pose: &FinePose, words: &mut Words) {
        let width = self.timing.grid() as usize;
        let Comparing { wanted, pulsed, at, ways, aborted, .. } = &mut self.comparing;
        let Some(&to) = pose.0.get(usize::from(wanted.axis)) else { return };
        let from = core::mem::replace(at, to);
        *aborted = false;
        ways[self.segment as usize % WAYS] = Way { segment: self.segment, from, to };
        let (up, distance) = (to > from, to.wrapping_sub(from).unsigned_abs());
        while *pulsed < wanted.count {
            let position =
                i64::from(wanted.start).wrapping_add(i64::from(wanted.step).wrapping_mul((*pulsed).into())) << 32;
            if (from >= position) == (to >= position) {
                break;
            }
            // upwards it may arrive at the end of the segment exactly, which is the last word of this one
            let way = if up { position.wrapping_sub(from) } else { from.wrapping_sub(position) };
            let tick = tick_of(way as u64, distance, up);
            if let Some(word) = words.get_mut(tick) {
                *word |= TRIGGER;
            }
            match words.get_mut(tick + width) {
                Some(word) => *word |= reset(TRIGGER),
                None => self.lower = Some((tick + width - SEGMENT_TICKS) as u8),
            }
            *pulsed = pulsed.wrapping_add(1);
            if (wanted.step > 0) != up {
                // the next one lies behind: the axis has to turn
                break;
            }
        }
        self.armed = self.comparing.is_armed();
    }

    /// Ends the last pulse of the segment before.
    #[cold]
    #[inline(never)]
    pub(super) fn lower(&mut self, words: &mut Words) {
        if let Some(word) = self.lower.take().and_then(|tick| words.get_mut(usize::from(tick))) {
            *word |= reset(TRIGGER);
        }
    }

    /// After an abort in a segment of which `words` were played and before which were `before` pulses, none if it was
    /// not generated: what was not played is due again, from where the axis was then.
    pub(super) fn compare_again(&mut self, segment: u64, before: Option<u16>, words: &[u32]) {
        let comparing = &mut self.comparing;
        if segment < comparing.since {
            comparing.pulsed = 0;
        } else if let Some(before) = before {
            let played = words.iter().filter(|word| **word & TRIGGER != 0).count();
            comparing.pulsed = before.wrapping_add(played as u16);
        }
        if comparing.wanted.count != 0 {
            // what was left high
            self.lower = Some(0);
            comparing.aborted = segment >= comparing.since;
            let next = comparing.ways.iter().filter(|way| way.segment >= segment).min_by_key(|way| way.segment);
            if let Some(&Way { segment: of, from, to }) = next {
                let played = if of == segment { words.len() as i64 } else { 0 };
                comparing.at = from.wrapping_add(to.wrapping_sub(from).wrapping_mul(played) >> SEGMENT_TICKS.ilog2());
            }
            comparing.ways = [Way::default(); WAYS];
        }
        self.armed = comparing.is_armed();
    }
}

const _: () = assert!(HISTORY > 2 && SEGMENT_TICKS.is_power_of_two());
