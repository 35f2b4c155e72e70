//! The generator: profile, law, backlash and step placement, one segment at a time.
//!
//! # Design
//! Owned by the refill interrupt alone. It takes orders from a queue, writes the words of the next segment and
//! leaves a report. It holds no pose but the base and the running tracks, all integers; the state at the start of
//! each of the last segments is kept, so that an abort at any word rolls back to what was really played.
//!
//! # Limitations
//! An abort must name a segment among the last [`HISTORY`] ones.

mod abort;
mod compare;
mod history;
mod motor;
mod orders;
mod report;

use super::border::{Orders, Report};
use crate::compensation::backlash::{Flank, PlayConfig, TakeUp};
use crate::compensation::coupling::HALF;
use crate::compensation::law::{Law, Remembered};
use crate::motion::planner::SLOTS;
use crate::motion::track::Track;
use crate::stepgen::segment::{Words, clear};
use crate::stepgen::timing::{Line, Timing};
use crate::units::{AXES, FinePose, FineSteps, MotorSteps, SEGMENT_TICKS};
use compare::Comparing;
pub use history::HISTORY;
use history::{Flags, Start, Stepping, place_of};
use motor::{Motor, Standing, follow_all};

/// A track and the segment with which it began.
#[derive(Clone, Copy, Debug, Default)]
struct Running {
    track: Track,
    start: u64,
    cursor: u8,
    /// The axes that the track moves.
    axes: u8,
}

impl Running {
    /// The border at which it ends.
    fn end(&self) -> u64 {
        self.start + u64::from(self.track.profile.duration())
    }
}

/// Profile, law, backlash and placement of all motors.
///
/// In the order of declaration: what every segment touches lies within the reach of one load.
#[repr(C)]
pub struct Generator {
    /// Bit n: slot n has a track.
    running: u8,
    /// Axes that the tracks move, bit n = axis n.
    moving: u8,
    /// A step waits.
    waiting: bool,
    /// Pulses of the position compare are still to come.
    armed: bool,
    /// The word of the next segment that ends a pulse of the position compare.
    lower: Option<u8>,
    flags: Flags,
    timing: Timing,
    segment: u64,
    /// The last segment with a track, a take-up or a waiting step in it, plus one.
    busy_until: u64,
    answered: u16,
    refused: u32,
    aborts: u16,
    /// See [`Report::begun`].
    begun: u64,
    /// The segment in which the last abort was.
    halted: u64,
    /// Segments completely played, as far as known.
    played: u64,
    stepping: Stepping,
    /// How many of the last entries of the history say what is the case now.
    steady: u8,
    base: FinePose,
    /// The first border at which a track ends.
    next_end: u64,
    /// The law's targets at the end of the segment in the making.
    ahead: FineSteps,
    remembered: Remembered,
    law: Law,
    motors: [Motor; AXES],
    history: [Start; HISTORY],
    tracks: [Running; SLOTS],
    comparing: Comparing,
}

impl Generator {
    /// At rest at pose zero, counts zero, flanks unknown.
    pub fn new(law: Law, timing: Timing) -> Self {
        let motor = |line: Line| Motor {
            now: Standing { target: HALF, position: HALF, ..Standing::default() },
            starts: [Standing::default(); HISTORY],
            take_up: TakeUp::default(),
            config: PlayConfig::default(),
            line,
        };
        let mut generator = Generator {
            law,
            remembered: Remembered::default(),
            base: FinePose::default(),
            tracks: [Running::default(); SLOTS],
            next_end: u64::MAX,
            ahead: FineSteps::default(),
            running: 0,
            moving: 0,
            motors: timing.lines().map(motor),
            waiting: false,
            armed: false,
            lower: None,
            comparing: Comparing::default(),
            flags: Flags::default(),
            timing,
            segment: 0,
            busy_until: 0,
            answered: 0,
            refused: 0,
            aborts: 0,
            begun: 0,
            halted: 0,
            played: 0,
            stepping: Stepping::default(),
            history: [Start::default(); HISTORY],
            steady: 0,
        };
        generator.anchor(FinePose::default(), MotorSteps::default());
        generator
    }

    /// Writes the words of the next segment. `played`: segments completely played so far.
    pub fn refill(&mut self, orders: &mut impl Orders, played: u64, words: &mut Words) -> Report {
        self.fill(orders, played, words, false);
        self.report(played)
    }

    /// [`Generator::refill`] for words that hardware has cleared: each is
    /// [`RESET_STEPS`](crate::stepgen::pins::RESET_STEPS), which is what [`clear`] writes on a grid of one tick.
    /// Leaves the report to [`Generator::tell`].
    #[inline(always)]
    pub fn refill_cleared(&mut self, orders: &mut impl Orders, played: u64, words: &mut Words) {
        self.fill(orders, played, words, true)
    }

    #[inline(always)]
    fn fill(&mut self, orders: &mut impl Orders, played: u64, words: &mut Words, cleared: bool) {
        self.played = played;
        if orders.peek().is_some() {
            self.take_orders(orders);
        }
        self.make(words, cleared);
    }

    /// The next segment as things stand. No part of it is generic, so that it is compiled with this crate and as this
    /// crate is: for speed.
    #[inline(never)]
    fn make(&mut self, words: &mut Words, cleared: bool) {
        if !cleared || self.timing.grid() != 1 {
            clear(words, &self.timing);
        }
        if self.lower.is_some() {
            self.lower(words);
        }
        let moving = self.running != 0;
        if moving || self.waiting || self.flags.taking_up != 0 {
            if self.segment > self.busy_until + 2 {
                self.motors.iter_mut().for_each(|motor| motor.now.emitter.rested(first_tick(self.segment)));
            }
            let pulsed = self.comparing.pulsed;
            if moving {
                let pose = self.advance_tracks();
                if self.armed {
                    self.pulse(&pose, words);
                }
                self.law.drive(&pose, &mut self.remembered, &mut self.ahead);
            } else {
                self.ahead = self.targets();
            }
            self.follow(moving, pulsed, words);
            self.busy_until = self.segment + 1;
            self.steady = 0;
        } else {
            self.stand();
        }
        self.segment += 1;
    }

    /// One segment of motion: remembers every motor, takes up its play and places its steps. Unless `moving` only
    /// the overlays move. `pulsed`: pulses of the position compare before it.
    #[inline(always)]
    fn follow(&mut self, moving: bool, pulsed: u16, words: &mut Words) {
        let base = first_tick(self.segment);
        let place = place_of(self.segment);
        self.history[place] = Start { segment: self.segment, flags: self.flags, pulsed };
        // no longer known to be a static: its address would be put together anew for every motor
        let motors = core::hint::black_box(&mut self.motors);
        let (news, mut up, mut down) = if self.timing.grid() == 1 {
            follow_all::<true>(motors, place, &self.ahead.0, moving, base, words)
        } else {
            follow_all::<false>(motors, place, &self.ahead.0, moving, base, words)
        };
        self.flags.moving = self.moving;
        if news {
            self.look_at_motors();
            (up, down) = self.stepped();
        }
        self.stepping.push(up, down);
    }

    /// Which motors this segment steps, or owes a step, when some step waits or has waited.
    #[inline(never)]
    fn stepped(&self) -> (u8, u8) {
        let (mut up, mut down) = (0, 0);
        for (i, Motor { now, starts, .. }) in self.motors.iter().enumerate() {
            let by = now.emitter.emitted().wrapping_sub(starts[place_of(self.segment)].emitter.emitted());
            let waiting = now.emitter.waiting();
            up |= u8::from(by > 0 || waiting > 0) << i;
            down |= u8::from(by < 0 || waiting < 0) << i;
        }
        (up, down)
    }

    /// A segment in which nothing moves.
    #[inline(always)]
    fn stand(&mut self) {
        self.stepping.push(0, 0);
        self.history[place_of(self.segment)].segment = self.segment;
        if usize::from(self.steady) < HISTORY {
            self.come_to_rest();
        }
    }

    /// One of the first segments in which nothing moves.
    #[inline(never)]
    fn come_to_rest(&mut self) {
        let place = place_of(self.segment);
        self.steady += 1;
        (self.history[place].flags, self.history[place].pulsed) = (self.flags, self.comparing.pulsed);
        for motor in &mut self.motors {
            motor.starts[place] = motor.now;
        }
    }

    /// What reports say of the motors and what waits, after something has happened to one.
    #[inline(never)]
    fn look_at_motors(&mut self) {
        let mut flags = Flags { moving: self.moving, ..Flags::default() };
        self.waiting = false;
        for (i, Motor { now, config, .. }) in self.motors.iter().enumerate() {
            self.waiting |= now.emitter.waiting() != 0;
            flags.taking_up |= u8::from(now.play.is_taking_up()) << i;
            flags.negative |= u8::from(now.play.flank() == Flank::Negative) << i;
            flags.known |= u8::from(now.play.is_known()) << i;
            flags.owing |= u8::from(now.play.owes(config)) << i;
        }
        self.flags = flags;
    }

    /// The pose at the end of this segment; tracks that end are merged into the base, exactly.
    #[inline(always)]
    fn advance_tracks(&mut self) -> FinePose {
        let border = self.segment + 1;
        if border >= self.next_end {
            self.end_tracks(border);
        }
        let mut pose = self.base;
        let mut left = self.running;
        while left != 0 {
            let slot = left.trailing_zeros() as usize;
            left &= left - 1;
            let Some(running) = self.tracks.get_mut(slot) else { break };
            // none that runs has ended, so that it fits
            let elapsed = border.wrapping_sub(running.start) as u32;
            let position = running.track.profile.position(elapsed, &mut running.cursor);
            running.track.add_to(&mut pose, position);
        }
        pose
    }

    /// Tracks that come to their end go into the base.
    #[cold]
    #[inline(never)]
    fn end_tracks(&mut self, border: u64) {
        for (slot, running) in self.tracks.iter().enumerate() {
            if self.running >> slot & 1 != 0 && border >= running.end() {
                for (base, end) in self.base.0.iter_mut().zip(&running.track.end) {
                    *base = base.wrapping_add(*end);
                }
                self.running &= !(1 << slot);
            }
        }
        self.look_at_tracks();
    }

    /// Which axes move, and until when nothing ends.
    #[inline(never)]
    fn look_at_tracks(&mut self) {
        (self.moving, self.next_end) = (0, u64::MAX);
        for (slot, running) in self.tracks.iter().enumerate() {
            if self.running >> slot & 1 != 0 {
                self.moving |= running.axes;
                self.next_end = self.next_end.min(running.end());
            }
        }
    }

    #[inline(always)]
    fn start_of(&self, segment: u64) -> Option<&Start> {
        let start = &self.history[place_of(segment)];
        (start.segment == segment && segment < self.segment).then_some(start)
    }

    /// The segment that is generated next.
    pub fn next_segment(&self) -> u64 {
        self.segment
    }

    /// Motors that may be stepping up, down, in what plays or waits to be played.
    pub fn stepping(&self) -> (u8, u8) {
        self.stepping.last(self.segment.saturating_sub(self.played) as u32)
    }

    /// The logical pose at the end of what was generated.
    pub fn pose(&self) -> FinePose {
        let mut pose = self.base;
        for (slot, running) in self.tracks.iter().enumerate() {
            if self.running >> slot & 1 != 0 {
                let by = running.track.contribution(self.segment.wrapping_sub(running.start) as u32, &mut 0);
                for (pose, by) in pose.0.iter_mut().zip(by) {
                    *pose = pose.wrapping_add(by);
                }
            }
        }
        pose
    }

    /// The unrounded motor positions, overlay and one half included, at the end of what was generated: for tests
    /// and telemetry.
    pub fn motor_positions(&self) -> FineSteps {
        FineSteps(self.motors.map(|motor| motor.now.position))
    }

    /// The law's unrounded targets, one half included, at the end of what was generated.
    pub fn targets(&self) -> FineSteps {
        FineSteps(self.motors.map(|motor| motor.now.target))
    }

    /// Counts emitted and steps waiting of a motor at the end of what was generated.
    pub fn emitted(&self, motor: usize) -> (i32, i32) {
        let emitter = &self.motors[motor].now.emitter;
        (emitter.emitted(), emitter.waiting())
    }
}

/// Tick of the first word of a segment; wraps.
fn first_tick(segment: u64) -> u32 {
    (segment as u32).wrapping_mul(SEGMENT_TICKS as u32)
}
