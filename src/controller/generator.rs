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
use crate::compensation::backlash::{Flank, Play, PlayConfig};
use crate::compensation::coupling::HALF;
use crate::compensation::law::{Law, Remembered};
use crate::motion::planner::SLOTS;
use crate::motion::track::Track;
use crate::stepgen::segment::{Emitter, Words, clear, place_all};
use crate::stepgen::timing::Timing;
use crate::units::{AXES, FinePose, FineSteps, MotorSteps, SEGMENT_TICKS};

/// Segments whose start state is kept: the ring of the board, the one in the making, and slack.
pub const HISTORY: usize = 8;

/// A track and the segment with which it began.
#[derive(Clone, Copy, Debug)]
struct Running {
    track: Track,
    start: u64,
    cursor: u8,
}

/// State at the start of a segment, for reports and for the roll-back.
#[derive(Clone, Copy, Debug, Default)]
struct Start {
    segment: u64,
    /// Law's targets, half added.
    target: FineSteps,
    /// Targets plus overlay: what the steps follow.
    motor: FineSteps,
    emitters: [Emitter; AXES],
    plays: [Play; AXES],
    moving: u8,
}

/// Profile, law, backlash and placement of all motors.
pub struct Generator {
    law: Law,
    remembered: Remembered,
    base: FinePose,
    tracks: [Option<Running>; SLOTS],
    plays: [Play; AXES],
    configs: [PlayConfig; AXES],
    target: FineSteps,
    motor: FineSteps,
    emitters: [Emitter; AXES],
    timing: Timing,
    segment: u64,
    /// The last segment with a track, a take-up or a waiting step in it, plus one.
    busy_until: u64,
    answered: u16,
    refused: u32,
    aborts: u16,
    /// The segment in which the last abort was.
    halted: u64,
    /// Segments completely played, as far as known.
    played: u64,
    history: [Start; HISTORY],
    /// Motors that step up, down, in each of the segments of the history.
    stepping: [[u8; 2]; HISTORY],
}

impl Generator {
    /// At rest at pose zero, counts zero, flanks unknown.
    pub fn new(law: Law, timing: Timing) -> Self {
        let rest = FineSteps([HALF; AXES]);
        let mut generator = Generator {
            law,
            remembered: Remembered::default(),
            base: FinePose::default(),
            tracks: [None; SLOTS],
            plays: [Play::default(); AXES],
            configs: [PlayConfig::default(); AXES],
            target: rest,
            motor: rest,
            emitters: Default::default(),
            timing,
            segment: 0,
            busy_until: 0,
            answered: 0,
            refused: 0,
            aborts: 0,
            halted: 0,
            played: 0,
            history: [Start::default(); HISTORY],
            stepping: [[0; 2]; HISTORY],
        };
        generator.anchor(FinePose::default(), MotorSteps::default());
        generator
    }

    /// Writes the words of the next segment. `played`: segments completely played so far.
    pub fn refill(&mut self, orders: &mut impl Orders, played: u64, words: &mut Words) -> Report {
        self.played = played;
        self.take_orders(orders);
        let moving = self.moving_axes();
        self.remember(moving);
        let busy =
            moving != 0 || self.plays.iter().any(Play::is_taking_up) || self.emitters.iter().any(|e| e.waiting() != 0);
        if busy {
            if self.segment > self.busy_until + 2 {
                self.emitters.iter_mut().for_each(|e| e.rested(first_tick(self.segment)));
            }
            self.step(moving != 0, words);
            self.busy_until = self.segment + 1;
        } else {
            clear(words, &self.timing);
            self.stepping[(self.segment % HISTORY as u64) as usize] = [0; 2];
        }
        self.segment += 1;
        self.report(played)
    }

    /// One segment of motion.
    #[inline(always)]
    fn step(&mut self, moving: bool, words: &mut Words) {
        if moving {
            let pose = self.advance_tracks();
            self.target = self.law.motors(&pose, &mut self.remembered);
        }
        let from = self.motor;
        for i in 0..AXES {
            let target = self.target.0[i];
            let overlay = self.plays[i].advance((target >> 32) as i32, moving, &self.configs[i]);
            self.motor.0[i] = target.wrapping_add(overlay);
        }
        self.note_stepping(&from);
        place_all(&mut self.emitters, &from, &self.motor, first_tick(self.segment), &self.timing, words);
    }

    /// Which motors this segment steps, from where they stood at its start.
    #[inline(never)]
    fn note_stepping(&mut self, from: &FineSteps) {
        let mut both = [0; 2];
        for (i, (to, from)) in self.motor.0.iter().zip(&from.0).enumerate() {
            let due = ((to >> 32) as i32).wrapping_sub((from >> 32) as i32);
            let waiting = self.emitters[i].waiting();
            both[0] |= u8::from(due > 0 || waiting > 0) << i;
            both[1] |= u8::from(due < 0 || waiting < 0) << i;
        }
        self.stepping[(self.segment % HISTORY as u64) as usize] = both;
    }

    /// The pose at the end of this segment; tracks that end are merged into the base, exactly.
    #[inline(always)]
    fn advance_tracks(&mut self) -> FinePose {
        let border = self.segment + 1;
        let mut pose = self.base;
        for slot in &mut self.tracks {
            let Some(running) = slot else { continue };
            let elapsed = (border - running.start).min(u64::from(u32::MAX)) as u32;
            let ended = elapsed >= running.track.profile.duration();
            let contribution = running.track.contribution(elapsed, &mut running.cursor);
            for (u, c) in pose.0.iter_mut().zip(&contribution) {
                *u = u.wrapping_add(*c);
            }
            if ended {
                for (u, c) in self.base.0.iter_mut().zip(&contribution) {
                    *u = u.wrapping_add(*c);
                }
                *slot = None;
            }
        }
        pose
    }

    fn moving_axes(&self) -> u8 {
        self.tracks.iter().flatten().fold(0, |mask, running| mask | running.track.axes())
    }

    fn take_orders(&mut self, orders: &mut impl Orders) {
        while let Some(order) = orders.peek() {
            if order.segment.is_some_and(|segment| segment > self.segment) {
                return;
            }
            let late = order.segment.is_some_and(|segment| segment < self.segment);
            let order = *order;
            orders.pop();
            let accepted = !late && order.aborts == self.aborts && self.apply(&order);
            self.answered = order.sequence;
            self.refused = self.refused << 1 | u32::from(!accepted);
        }
    }

    /// Applies an order; false when the state does not allow it.
    fn apply(&mut self, order: &Order) -> bool {
        let at_rest = self.tracks.iter().all(Option::is_none) && !self.plays.iter().any(Play::is_taking_up);
        match order.action {
            Action::Run { slot, track } => match self.tracks.get_mut(usize::from(slot)) {
                Some(place) => {
                    *place = Some(Running { track, start: self.segment, cursor: 0 });
                    true
                }
                None => false,
            },
            Action::Play { motor, config } => match self.configs.get_mut(usize::from(motor)) {
                Some(place) => {
                    *place = config;
                    true
                }
                None => false,
            },
            _ if !at_rest => false,
            Action::Law(law) => {
                self.law = law;
                self.remembered = Remembered::default();
                true
            }
            Action::Anchor { pose, steps } => {
                self.anchor(pose.fine(), steps);
                true
            }
            Action::Flank { motor, flank } => match self.plays.get_mut(usize::from(motor)) {
                Some(play) => {
                    let target = (self.target.0[usize::from(motor)] >> 32) as i32;
                    *play = Play::resting(target, flank, play.overlay());
                    true
                }
                None => false,
            },
            Action::Rest { motor, flank, overlay } => match self.plays.get_mut(usize::from(motor)) {
                Some(play) => {
                    let target = (self.target.0[usize::from(motor)] >> 32) as i32;
                    *play = Play::resting(target, flank, overlay);
                    true
                }
                None => false,
            },
            Action::Reference { motor } => match self.plays.get_mut(usize::from(motor)) {
                Some(play) => {
                    let config = &self.configs[usize::from(motor)];
                    *play = Play::resting((self.target.0[usize::from(motor)] >> 32) as i32, Some(config.reference), 0);
                    true
                }
                None => false,
            },
            Action::Pulses(timing) => {
                self.timing = timing;
                true
            }
        }
    }

    /// Stands at a pose with these counts (overlay left out); no motor moves.
    fn anchor(&mut self, pose: FinePose, steps: MotorSteps) {
        self.base = pose;
        let law = self.law.motors(&pose, &mut self.remembered);
        for i in 0..AXES {
            let count = i64::from(steps.0[i]);
            let shift = steps.0[i].wrapping_sub((self.target.0[i] >> 32) as i32);
            self.plays[i].shift(shift);
            self.target.0[i] = if law.0[i] >> 32 == count { law.0[i] } else { (count << 32) + HALF };
            self.motor.0[i] = self.target.0[i] + (i64::from(self.plays[i].overlay()) << 32);
            self.emitters[i].set_count((self.motor.0[i] >> 32) as i32);
        }
        // what is still to be played is silence: reports and an abort in it speak of the new counts
        let Generator { target, motor, emitters, plays, .. } = *self;
        for start in &mut self.history {
            *start = Start { segment: start.segment, target, motor, emitters, plays, ..Start::default() };
        }
    }

    /// The motors were stopped after `tick` words of `segment`: rolls back to what was played, at rest.
    /// `words` are the words of that segment. The next segment is generated as the one after `segment`. In a segment
    /// that was not generated there was silence, and all that was generated before it has been played.
    pub fn abort(&mut self, segment: u64, tick: usize, words: &Words) {
        let tick = tick.min(SEGMENT_TICKS);
        let end = self.start_of(segment + 1).map_or((self.target, self.motor), |next| (next.target, next.motor));
        self.aborts = self.aborts.wrapping_add(1);
        self.tracks = [None; SLOTS];
        let (start, words, tick) = match self.start_of(segment) {
            Some(start) => (*start, words, tick),
            None => (self.now(), &[0; SEGMENT_TICKS], 0),
        };
        let at = |from: i64, to: i64| from + (((to - from) as i128 * tick as i128) / SEGMENT_TICKS as i128) as i64;
        let played = words.get(..tick).unwrap_or(words);
        let (base, resume) = (first_tick(segment), first_tick(segment + 1));
        for i in 0..AXES {
            self.emitters[i] = Emitter::after_abort(&start.emitters[i], &self.timing.lines()[i], played, base, resume);
            let count = self.emitters[i].emitted();
            let target = at(start.target.0[i], end.0.0[i]) >> 32;
            let overlay = (at(start.motor.0[i], end.1.0[i]) >> 32) - target;
            let steps = i64::from(count) - overlay;
            self.plays[i] = start.plays[i];
            self.plays[i].abort(steps as i32, overlay as i32, self.configs[i].dead_band);
            self.target.0[i] = (steps << 32) + HALF;
            self.motor.0[i] = (i64::from(count) << 32) + HALF;
        }
        self.segment = segment + 1;
        self.busy_until = self.segment;
        (self.halted, self.played) = (segment, self.segment);
    }

    fn start_of(&self, segment: u64) -> Option<&Start> {
        self.history
            .get((segment % HISTORY as u64) as usize)
            .filter(|start| start.segment == segment && segment < self.segment)
    }

    /// The state at the end of what was generated.
    fn now(&self) -> Start {
        Start {
            segment: self.segment,
            target: self.target,
            motor: self.motor,
            emitters: self.emitters,
            plays: self.plays,
            ..Start::default()
        }
    }

    #[inline(always)]
    fn remember(&mut self, moving: u8) {
        let now = Start { moving, ..self.now() };
        if let Some(place) = self.history.get_mut((self.segment % HISTORY as u64) as usize) {
            *place = now;
        }
    }

    /// Takes orders and reports, while nothing plays and no segment is made.
    pub fn attend(&mut self, orders: &mut impl Orders) -> Report {
        self.take_orders(orders);
        self.report(self.segment)
    }

    /// The segment that is generated next.
    pub fn next_segment(&self) -> u64 {
        self.segment
    }

    /// State at the end of the segments completely played, of which there are `played`.
    pub fn report(&self, played: u64) -> Report {
        let mut report = Report {
            next: self.segment,
            played,
            answered: self.answered,
            refused: self.refused,
            final_steps: self.target.floor(),
            settled: played >= self.busy_until,
            aborts: self.aborts,
            halted: self.halted,
            overlay: self.plays.map(|p| p.overlay()),
            ..Report::default()
        };
        let plays = match self.start_of(played) {
            Some(start) => {
                report.counts = counts_of(&start.emitters);
                report.steps = start.target.floor();
                report.moving = start.moving;
                &start.plays
            }
            None => {
                report.counts = counts_of(&self.emitters);
                report.steps = report.final_steps;
                report.moving = self.moving_axes();
                &self.plays
            }
        };
        (report.stepping_up, report.stepping_down) = self.stepping_from(played);
        for (i, (play, config)) in plays.iter().zip(&self.configs).enumerate() {
            report.taking_up |= u8::from(play.is_taking_up()) << i;
            report.negative |= u8::from(play.flank() == Flank::Negative) << i;
            report.known |= u8::from(play.is_known()) << i;
            report.owing |= u8::from(play.owes(config)) << i;
        }
        report
    }

    /// Motors that may be stepping up, down, in what plays or waits to be played.
    pub fn stepping(&self) -> (u8, u8) {
        self.stepping_from(self.played)
    }

    /// The same from a segment on.
    fn stepping_from(&self, first: u64) -> (u8, u8) {
        let mut both = [0; 2];
        for segment in first.max(self.segment.saturating_sub(HISTORY as u64))..self.segment {
            let [up, down] = self.stepping[(segment % HISTORY as u64) as usize];
            both = [both[0] | up, both[1] | down];
        }
        (both[0], both[1])
    }

    /// The unrounded motor positions, overlay and one half included, at the end of what was generated: for tests
    /// and telemetry.
    pub fn motor_positions(&self) -> FineSteps {
        self.motor
    }

    /// The law's unrounded targets, one half included, at the end of what was generated.
    pub fn targets(&self) -> FineSteps {
        self.target
    }

    /// Counts emitted and steps waiting of a motor at the end of what was generated.
    pub fn emitted(&self, motor: usize) -> (i32, i32) {
        let emitter = &self.emitters[motor];
        (emitter.emitted(), emitter.waiting())
    }
}

/// Tick of the first word of a segment; wraps.
fn first_tick(segment: u64) -> u32 {
    (segment as u32).wrapping_mul(SEGMENT_TICKS as u32)
}

fn counts_of(emitters: &[Emitter; AXES]) -> MotorSteps {
    MotorSteps(emitters.map(|e| e.emitted()))
}
