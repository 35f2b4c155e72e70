//! Going back: to what was played when the motors were stopped, or behind silence that need not be played.

use super::Generator;
use super::first_tick;
use super::history::{HISTORY, Stepping, place_of};
use super::motor::Standing;
use crate::compensation::coupling::HALF;
use crate::stepgen::segment::Emitter;
use crate::units::SEGMENT_TICKS;

/// Where a motor was after `tick` words of a segment that went straight from one place to another, Q32.
fn at(tick: usize, from: i64, to: i64) -> i64 {
    const TICKS: i64 = SEGMENT_TICKS as i64;
    let (way, tick) = (to - from, tick as i64);
    // in two parts, of which neither is too long for 64 bits
    from + way / TICKS * tick + way % TICKS * tick / TICKS
}

impl Generator {
    /// The motors were stopped after `tick` words of `segment`: rolls back to what was played, at rest.
    /// `words` are the words of that segment, at least the `tick` first ones. The next segment is generated as the one
    /// after `segment`. In a segment that was not generated there was silence, and all that was generated before it has
    /// been played.
    pub fn abort(&mut self, segment: u64, tick: usize, words: &[u32]) {
        let start = self.start_of(segment).map(|start| start.pulsed);
        let (begun, ended) = (start.is_some(), self.start_of(segment + 1).is_some());
        let (words, tick) = if begun { (words, tick.min(SEGMENT_TICKS)) } else { (&[][..], 0) };
        self.aborts = self.aborts.wrapping_add(1);
        self.running = 0;
        let played = words.get(..tick).unwrap_or(words);
        self.compare_again(segment, start, played);
        let (base, resume) = (first_tick(segment), first_tick(segment + 1));
        for motor in &mut self.motors {
            let end = if ended { motor.starts[place_of(segment + 1)] } else { motor.now };
            let start = if begun { motor.starts[place_of(segment)] } else { motor.now };
            let emitter = Emitter::after_abort(&start.emitter, &motor.line, played, base, resume);
            let count = emitter.emitted();
            let target = at(tick, start.target, end.target) >> 32;
            let overlay = (at(tick, start.position, end.position) >> 32) - target;
            let steps = i64::from(count) - overlay;
            let mut play = start.play;
            play.abort(steps as i32, overlay as i32, motor.config.dead_band);
            let (target, position) = ((steps << 32) + HALF, (i64::from(count) << 32) + HALF);
            motor.now = Standing { target, position, emitter, play };
        }
        self.moving = 0;
        self.look_at_motors();
        self.steady = 0;
        self.segment = segment + 1;
        self.busy_until = self.segment;
        (self.halted, self.played) = (segment, self.segment);
        self.stepping = Stepping::default();
    }

    /// Takes back what was made from `segment` on, if nothing moves in it: what is to begin as soon as possible need
    /// not wait until that silence has played. The words are as hardware has cleared them, so they stay.
    #[inline(never)]
    pub fn take_back(&mut self, segment: u64) {
        let back = self.segment.saturating_sub(segment);
        if back > u64::from(self.steady) || back >= HISTORY as u64 {
            return;
        }
        self.segment = segment;
        self.steady -= back as u8;
        self.stepping.take_back(back);
        self.comparing.take_back(segment);
    }
}
