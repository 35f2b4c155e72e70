//! What the words that were played did to the motors, read back from the words themselves.
//!
//! # After an abort
//! Each committed segment keeps the emitters with which it began. If the timer stopped with `k` words
//! of a segment played, [`Emitter::after_abort`] rebuilds the emitter from that state and
//! `words[..k]`. A STEP line left high is lowered by the caller: the reset pattern that begins the
//! next cleared segment does it. The caller plays that segment no sooner than the minimum
//! high time (one grid) after the abort, which any refill exceeds.

use super::segment::Emitter;
use super::timing::Line;

/// Levels of one motor's lines.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// STEP is high.
    pub step: bool,
    /// DIR is high.
    pub dir: bool,
}

impl Levels {
    /// The levels after one more word: a set bit wins over a reset bit.
    #[must_use]
    pub fn after(self, line: &Line, word: u32) -> Levels {
        let level = |bit: u32, before: bool| word & bit != 0 || (before && word & super::pins::reset(bit) == 0);
        Levels { step: level(line.step, self.step), dir: level(line.dir, self.dir) }
    }

    /// The step that a rising edge makes at this level of DIR.
    fn sense(self, line: &Line) -> i32 {
        if self.dir != line.inverted { 1 } else { -1 }
    }
}

/// What some words did to one motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Played {
    /// Rising edges of STEP, counted with the sense that DIR had at each.
    pub steps: i32,
    /// Levels after the last word.
    pub levels: Levels,
    /// Index of the word with the last rising edge.
    pub last_rise: Option<u32>,
    /// Index of the word with the last change of DIR.
    pub last_turn: Option<u32>,
}

impl Played {
    /// Replays `words` onto the lines of one motor, which begin at the levels `start`.
    pub fn replay(words: &[u32], line: &Line, start: Levels) -> Played {
        let mut played = Played { levels: start, ..Played::default() };
        for (index, &word) in (0..).zip(words) {
            let before = played.levels;
            let after = before.after(line, word);
            played.levels = after;
            if after.dir != before.dir {
                played.last_turn = Some(index);
            }
            if after.step && !before.step {
                played.last_rise = Some(index);
                played.steps = played.steps.wrapping_add(after.sense(line));
            }
        }
        played
    }
}

/// Steps that `words` made one motor go, signed; the level of DIR at their start is `dir` and STEP
/// is low, or lowered by the first word as at every border.
pub fn edges(words: &[u32], line: &Line, dir: bool) -> i32 {
    Played::replay(words, line, Levels { step: false, dir }).steps
}

impl Emitter {
    /// The emitter after an abort in a segment that began with `start` at tick `base`, of which
    /// `words` were played. It goes on at tick `resume`, the first word of the next segment, which
    /// lies no earlier than the first word not played (see the [module](self) on a line left high).
    ///
    /// The steps are those played, a waiting step is dropped, DIR is as on the line. Low, set-up and
    /// hold times reach back to the last edges played or, if there are none, to those before.
    #[must_use]
    pub fn after_abort(start: &Emitter, line: &Line, words: &[u32], base: u32, resume: u32) -> Emitter {
        let played = Played::replay(words, line, Levels { step: false, dir: start.dir });
        // The first word on resuming may be what lowers the line: a low time must follow it.
        let mut next_rise = later(start.next_rise, resume.wrapping_add(line.grid));
        let mut next_turn = start.next_turn;
        if let Some(rise) = played.last_rise {
            let rise = base.wrapping_add(rise);
            next_rise = later(next_rise, rise.wrapping_add(line.gap()));
            next_turn = later(next_turn, rise.wrapping_add(line.hold));
        }
        if let Some(turn) = played.last_turn {
            let turn = base.wrapping_add(turn);
            next_rise = later(next_rise, turn.wrapping_add(line.setup));
            next_turn = later(next_turn, turn.wrapping_add(1));
        }
        Emitter {
            emitted: start.emitted.wrapping_add(played.steps),
            dir: played.levels.dir,
            next_rise,
            next_turn,
            ..Emitter::default()
        }
    }
}

/// The later of two ticks less than 2^31 apart.
fn later(a: u32, b: u32) -> u32 {
    if (a.wrapping_sub(b) as i32) < 0 { b } else { a }
}
