//! The generator: profile, law, backlash and step placement, one segment at a time.
//!
//! # Design
//! Owned by the refill interrupt alone. It takes orders from a queue, writes the words of the next segment and
//! leaves a report. It holds no pose but the base and the running tracks, all integers; the state at the start of
//! each of the last segments is kept, so that an abort at any word rolls back to what was really played.
//!
//! # Limitations
//! An abort must name a segment among the last [`HISTORY`] ones.

use super::border::{Action, Order, Orders, Report};
use crate::compensation::backlash::{Flank, Play, PlayConfig, TakeUp};
use crate::compensation::coupling::HALF;
use crate::compensation::law::{Law, Remembered};
use crate::motion::planner::SLOTS;
use crate::motion::track::Track;
use crate::stepgen::segment::{Emitter, Words, clear};
use crate::stepgen::timing::{Line, Timing};
use crate::units::{AXES, FinePose, FineSteps, MotorSteps, SEGMENT_TICKS};

/// Segments whose start state is kept: the ring of the board, the one in the making, and slack.
pub const HISTORY: usize = 8;

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

/// Where a motor stands at a border of segments: what a roll-back needs, small enough to be copied in a few
/// instructions.
#[derive(Clone, Copy, Debug, Default)]
struct Standing {
    /// Law's target, half added.
    target: i64,
    /// Target plus overlay: what the steps follow.
    position: i64,
    emitter: Emitter,
    play: Play,
}

/// One motor.
#[derive(Clone, Copy, Debug)]
struct Motor {
    /// At the end of what was generated.
    now: Standing,
    /// At the start of each of the last segments.
    starts: [Standing; HISTORY],
    take_up: TakeUp,
    config: PlayConfig,
    line: Line,
}

/// What reports say of a segment, bit n = axis or motor n.
#[derive(Clone, Copy, Debug, Default)]
struct Flags {
    moving: u8,
    taking_up: u8,
    negative: u8,
    known: u8,
    owing: u8,
}

/// What reports say of the start of a segment beside where the motors stand.
#[derive(Clone, Copy, Debug, Default)]
struct Start {
    segment: u64,
    flags: Flags,
}

/// Where the start of a segment is remembered.
#[inline(always)]
fn place_of(segment: u64) -> usize {
    segment as usize % HISTORY
}

/// Motors that stepped up, down, in each of the last eight segments: a byte a segment, the last one lowest.
#[derive(Clone, Copy, Debug, Default)]
struct Stepping {
    up: u64,
    down: u64,
}

impl Stepping {
    #[inline(always)]
    fn push(&mut self, up: u8, down: u8) {
        self.up = self.up << 8 | u64::from(up);
        self.down = self.down << 8 | u64::from(down);
    }

    /// Motors that stepped up, down, in any of the last segments.
    #[inline(always)]
    fn last(&self, segments: u32) -> (u8, u8) {
        // the ring holds four: anything else is rare
        if segments > 4 {
            return self.of_many(segments);
        }
        let kept = (0xFFFF_FFFFu64 << (8 * segments) >> 32) as u32;
        (any(self.up as u32 & kept), any(self.down as u32 & kept))
    }

    #[inline(never)]
    fn of_many(&self, segments: u32) -> (u8, u8) {
        let kept = if segments < 8 { (1 << (8 * segments)) - 1 } else { u64::MAX };
        let any = |history: u64| any((history & kept) as u32 | ((history & kept) >> 32) as u32);
        (any(self.up), any(self.down))
    }
}

/// The four bytes of a word, all in one.
#[inline(always)]
fn any(bytes: u32) -> u8 {
    let half = bytes | bytes >> 16;
    (half | half >> 8) as u8
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
        let moving = self.running != 0;
        if moving || self.waiting || self.flags.taking_up != 0 {
            if self.segment > self.busy_until + 2 {
                self.motors.iter_mut().for_each(|motor| motor.now.emitter.rested(first_tick(self.segment)));
            }
            if moving {
                let pose = self.advance_tracks();
                self.law.drive(&pose, &mut self.remembered, &mut self.ahead);
            } else {
                self.ahead = self.targets();
            }
            self.follow(moving, words);
            self.busy_until = self.segment + 1;
            self.steady = 0;
        } else {
            self.stand();
        }
        self.segment += 1;
    }

    /// One segment of motion: remembers every motor, takes up its play and places its steps. Unless `moving` only
    /// the overlays move.
    #[inline(always)]
    fn follow(&mut self, moving: bool, words: &mut Words) {
        let base = first_tick(self.segment);
        let place = place_of(self.segment);
        self.history[place] = Start { segment: self.segment, flags: self.flags };
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
        self.history[place].flags = self.flags;
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

    #[inline(never)]
    fn take_orders(&mut self, orders: &mut impl Orders) {
        while let Some(order) = orders.peek() {
            if order.segment.is_some_and(|segment| segment > self.segment) {
                // what was taken before it counts all the same
                break;
            }
            let late = order.segment.is_some_and(|segment| segment < self.segment);
            let accepted = !late && order.aborts == self.aborts && self.apply(order);
            self.answered = order.sequence;
            self.refused = self.refused << 1 | u32::from(!accepted);
            orders.pop();
        }
        self.look_at_tracks();
        self.look_at_motors();
        self.steady = 0;
    }

    /// Applies an order; false when the state does not allow it.
    #[inline(never)]
    fn apply(&mut self, order: &Order) -> bool {
        let at_rest = self.running == 0 && !self.motors.iter().any(|motor| motor.now.play.is_taking_up());
        match &order.action {
            Action::Run { slot, track } => match self.tracks.get_mut(usize::from(*slot)) {
                Some(place) => {
                    place.track = *track;
                    (place.start, place.cursor, place.axes) = (self.segment, 0, track.axes());
                    self.running |= 1 << slot;
                    if order.segment.is_none() {
                        self.begun = self.segment;
                    }
                    true
                }
                None => false,
            },
            Action::Play { motor, config } => match self.motors.get_mut(usize::from(*motor)) {
                Some(motor) => {
                    motor.config = *config;
                    motor.now.play.disturb();
                    true
                }
                None => false,
            },
            _ if !at_rest => false,
            Action::Law(law) => {
                self.law = *law;
                self.remembered = Remembered::default();
                true
            }
            Action::Anchor { pose, steps } => {
                self.anchor(pose.fine(), *steps);
                true
            }
            Action::Flank { motor, flank } => match self.motors.get_mut(usize::from(*motor)) {
                Some(motor) => {
                    let now = &mut motor.now;
                    now.play = Play::resting((now.target >> 32) as i32, *flank, now.play.overlay());
                    true
                }
                None => false,
            },
            Action::Rest { motor, flank, overlay } => match self.motors.get_mut(usize::from(*motor)) {
                Some(motor) => {
                    let now = &mut motor.now;
                    now.play = Play::resting((now.target >> 32) as i32, *flank, *overlay);
                    true
                }
                None => false,
            },
            Action::Pulses(timing) => {
                self.timing = *timing;
                for (motor, line) in self.motors.iter_mut().zip(timing.lines()) {
                    motor.line = *line;
                    motor.now.emitter.disturb();
                }
                true
            }
        }
    }

    /// Stands at a pose with these counts (overlay left out); no motor moves.
    fn anchor(&mut self, pose: FinePose, steps: MotorSteps) {
        self.base = pose;
        let law = self.law.motors(&pose, &mut self.remembered);
        for (motor, (law, steps)) in self.motors.iter_mut().zip(law.0.into_iter().zip(steps.0)) {
            let now = &mut motor.now;
            let count = i64::from(steps);
            now.play.shift(steps.wrapping_sub((now.target >> 32) as i32));
            now.target = if law >> 32 == count { law } else { (count << 32) + HALF };
            now.position = now.target + (i64::from(now.play.overlay()) << 32);
            now.emitter.set_count((now.position >> 32) as i32);
        }
        self.moving = 0;
        self.look_at_motors();
        // what is still to be played is silence: reports and an abort in it speak of the new counts
        for motor in &mut self.motors {
            motor.starts = [motor.now; HISTORY];
        }
        for start in &mut self.history {
            start.flags = self.flags;
        }
    }

    /// The motors were stopped after `tick` words of `segment`: rolls back to what was played, at rest.
    /// `words` are the words of that segment. The next segment is generated as the one after `segment`. In a segment
    /// that was not generated there was silence, and all that was generated before it has been played.
    pub fn abort(&mut self, segment: u64, tick: usize, words: &Words) {
        let tick = tick.min(SEGMENT_TICKS);
        let ends = match self.start_of(segment + 1) {
            Some(_) => self.motors.map(|m| m.starts[place_of(segment + 1)]).map(|at| (at.target, at.position)),
            None => self.motors.map(|motor| (motor.now.target, motor.now.position)),
        };
        self.aborts = self.aborts.wrapping_add(1);
        self.running = 0;
        let (start, words, tick) = match self.start_of(segment) {
            Some(_) => (self.motors.map(|motor| motor.starts[place_of(segment)]), words, tick),
            None => (self.motors.map(|motor| motor.now), &[0; SEGMENT_TICKS], 0),
        };
        let at = |from: i64, to: i64| from + (((to - from) as i128 * tick as i128) / SEGMENT_TICKS as i128) as i64;
        let played = words.get(..tick).unwrap_or(words);
        let (base, resume) = (first_tick(segment), first_tick(segment + 1));
        for (i, (motor, start)) in self.motors.iter_mut().zip(&start).enumerate() {
            let emitter = Emitter::after_abort(&start.emitter, &motor.line, played, base, resume);
            let count = emitter.emitted();
            let target = at(start.target, ends[i].0) >> 32;
            let overlay = (at(start.position, ends[i].1) >> 32) - target;
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

    #[inline(always)]
    fn start_of(&self, segment: u64) -> Option<&Start> {
        let start = &self.history[place_of(segment)];
        (start.segment == segment && segment < self.segment).then_some(start)
    }

    /// Takes orders and reports, while nothing plays and no segment is made.
    pub fn attend(&mut self, orders: &mut impl Orders, report: &mut Report) {
        if orders.peek().is_some() {
            self.take_orders(orders);
        }
        self.tell(self.segment, report);
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
        self.stepping.up >>= 8 * back;
        self.stepping.down >>= 8 * back;
    }

    /// The segment that is generated next.
    pub fn next_segment(&self) -> u64 {
        self.segment
    }

    /// Motors that may be stepping up, down, in what plays or waits to be played.
    pub fn stepping(&self) -> (u8, u8) {
        self.stepping.last(self.segment.saturating_sub(self.played) as u32)
    }

    /// State at the end of the segments completely played, of which there are `played`.
    pub fn report(&self, played: u64) -> Report {
        let mut report = Report::default();
        self.tell(played, &mut report);
        report
    }

    /// The same, written over another report; what the stream knows stays.
    #[inline(never)]
    pub fn tell(&self, played: u64, report: &mut Report) {
        let flags = match self.start_of(played) {
            Some(start) => {
                let place = place_of(played);
                self.count(|motor| &motor.starts[place], report);
                &start.flags
            }
            None => {
                self.count_now(report);
                &self.flags
            }
        };
        (report.next, report.played) = (self.segment, played);
        (report.answered, report.refused) = (self.answered, self.refused);
        (report.moving, report.taking_up, report.negative) = (flags.moving, flags.taking_up, flags.negative);
        (report.known, report.owing) = (flags.known, flags.owing);
        report.settled = played >= self.busy_until;
        (report.aborts, report.halted, report.begun) = (self.aborts, self.halted, self.begun);
        (report.stepping_up, report.stepping_down) =
            self.stepping.last((self.segment as u32).wrapping_sub(played as u32));
    }

    #[cold]
    #[inline(never)]
    fn count_now(&self, report: &mut Report) {
        self.count(|motor| &motor.now, report);
    }

    /// What a report says motor by motor; `then` is where a motor stood when what was played had been played.
    #[inline(always)]
    fn count(&self, then: impl Fn(&Motor) -> &Standing, report: &mut Report) {
        // written out, because a loop over five arrays costs more than what is in it
        let mut one = |i: usize| {
            let (motor, then) = (&self.motors[i], then(&self.motors[i]));
            report.counts.0[i] = then.emitter.emitted();
            report.steps.0[i] = (then.target >> 32) as i32;
            report.final_steps.0[i] = (motor.now.target >> 32) as i32;
            report.overlay[i] = motor.now.play.overlay();
        };
        one(0);
        one(1);
        one(2);
        one(3);
        one(4);
        one(5);
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

/// One segment of every motor to new targets: true where a play or an emitter has news, and the motors that step up,
/// down, if none has. A leaf of its own with slices, lest the compiler unroll the motors and run out of registers.
/// `place`: where the start of this segment is remembered. `UNIT`: the grid is one tick.
#[inline(never)]
fn follow_all<const UNIT: bool>(
    motors: &mut [Motor],
    place: usize,
    targets: &[i64],
    moving: bool,
    base: u32,
    words: &mut Words,
) -> (bool, u8, u8) {
    let (mut any, mut signs) = (false, 0u32);
    for (Motor { now, starts, take_up, config, line }, target) in motors.iter_mut().zip(targets) {
        starts[place % HISTORY] = *now;
        now.target = *target;
        let whole = (*target >> 32) as i32;
        let overlay = if now.play.goes_on(whole) {
            i64::from(now.play.overlay()) << 32
        } else {
            let (overlay, news) = now.play.advance(take_up, whole, moving, config);
            if news {
                any = true;
            }
            overlay
        };
        let from = now.position;
        now.position = target.wrapping_add(overlay);
        let by = ((now.position >> 32) as i32).wrapping_sub((from >> 32) as i32);
        // a bit for upwards in the upper half, for downwards in the lower one; the last motor's come to lie lowest
        signs = signs << 1 | by.wrapping_neg() as u32 >> 31 << 16 | by as u32 >> 31;
        if now.emitter.place::<UNIT>(line, from, now.position, base, words) {
            any = true;
        }
    }
    let half = |signs: u32| (signs.reverse_bits() >> (32 - AXES)) as u8;
    (any, half(signs >> 16), half(signs))
}

/// Tick of the first word of a segment; wraps.
fn first_tick(segment: u64) -> u32 {
    (segment as u32).wrapping_mul(SEGMENT_TICKS as u32)
}
