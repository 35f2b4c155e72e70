//! The stream of words: keeps the ring of the step output filled, and finds out what was played when it stops.
//!
//! # Design
//! The hardware plays a ring of [`RING`] segments over and over, one word a tick, and clears what it has played, one
//! segment behind: a processor that is late or stopped leaves silence, and no word plays twice. While segment k plays,
//! the refill makes segment k + [`AHEAD`]; the room of segment k - 2 has been cleared by then. All of it runs in the
//! refill interrupt; the hardware is a [`StepSink`].
//!
//! # At rest
//! A track that is to begin as soon as it is seen does not wait for the silence that was made ahead: that is taken
//! back, as far as there is time to make it anew.
//!
//! # When it stops
//! Whoever stops the hardware says why by a [`Halt`]; the next [`Stream::service`] rolls the generator back to the word
//! that was really played, and starts anew. After an emergency stop it stays silent until it is armed again.
//!
//! # A missed deadline
//! A segment is begun only while [`MARGIN`] ticks are left before it plays; otherwise it is not written at all, what
//! played instead was silence, and the position stays exact ([`Cause::Deadline`]). If the processor is held up *while*
//! it writes, some of the words may have come too late: [`Cause::Output`], the position is uncertain.

use super::border::{Order, Orders, Report};
use super::generator::Generator;
use super::safety::{Cause, Halt, Inputs, Watch};
use crate::stepgen::segment::Words;
use crate::units::SEGMENT_TICKS;

/// Segments in the ring.
pub const RING: usize = 4;
/// The segment that is made while segment k plays is k + 2.
pub const AHEAD: u64 = 2;
/// Ticks before a segment plays at which it is no longer begun: more than the dearest segment takes to make.
pub const MARGIN: u64 = 112;

/// Hardware that plays the ring.
pub trait StepSink {
    /// Words played since the last start.
    fn played(&mut self) -> u64;
    /// Words of one place of the ring.
    fn slot(&mut self, slot: usize) -> &mut Words;
    /// Clears the ring and lowers what a stop left high, no sooner than the longest pulse after it.
    fn prepare(&mut self);
    /// Plays the ring from its first place.
    fn start(&mut self);
    /// No word plays after this.
    fn stop(&mut self);
    /// Levels of the inputs.
    fn inputs(&mut self) -> Inputs;
}

/// What the thread asks of the stream.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wishes {
    /// The stream is to stand, at standstill, for as long as this is set.
    pub pause: bool,
    /// Arm the stream again after an emergency stop, if the contact is closed.
    pub rearm: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Not started yet.
    Idle,
    Running,
    /// Stands until it is armed again.
    Latched,
    /// Stands while the thread wishes so.
    Paused,
}

/// The first segment that can still be made while the named one plays, of which so many words have.
fn in_time((segment, tick): (u64, usize)) -> u64 {
    let next = segment + 1;
    if SEGMENT_TICKS - tick > MARGIN as usize { next } else { next + 1 }
}

/// Keeps the ring filled.
#[repr(C)] // the large part last, so that the rest lies within the reach of one load
pub struct Stream {
    /// Segment in the first place of the ring at the last start.
    origin: u64,
    state: State,
    halt: Halt,
    generator: Generator,
}

impl Stream {
    /// A stream that has not begun.
    pub fn new(generator: Generator) -> Self {
        Stream { generator, origin: 0, state: State::Idle, halt: Halt::default() }
    }

    /// True while words play.
    pub fn is_running(&self) -> bool {
        self.state == State::Running
    }

    /// Does what is due; call once a segment, and after every stop. `halt`: why somebody has stopped the hardware.
    /// `report`: the last one, which is written over.
    #[inline(always)]
    pub fn service(
        &mut self,
        sink: &mut impl StepSink,
        orders: &mut impl Orders,
        watch: Watch,
        halt: Option<Halt>,
        wishes: Wishes,
        report: &mut Report,
    ) {
        let inputs = sink.inputs();
        let mut playing = None;
        if self.state == State::Running {
            let at = self.position(sink);
            let (up, down) = (report.stepping_up, report.stepping_down);
            // nothing hides an open contact
            let open = inputs.stop.then_some(Halt { cause: Cause::EmergencyStop, ..Halt::default() });
            let halt = open.or(halt).or_else(|| watch.halt(inputs, up, down)).or_else(|| self.late(at));
            match halt {
                Some(halt) => self.roll_back(sink, orders, halt),
                None if wishes.pause => {
                    sink.stop();
                    self.state = State::Paused;
                }
                None => {
                    if orders.peek().is_some_and(Order::runs_at_once) {
                        self.generator.take_back(in_time(at));
                    }
                    playing = self.fill(sink, orders, at.0);
                }
            }
        } else if halt.is_some_and(|halt| halt.cause == Cause::EmergencyStop) && self.state == State::Paused {
            self.latch(Halt { cause: Cause::EmergencyStop, ..Halt::default() });
        }
        if let Some(segment) = playing {
            self.generator.tell(segment, report);
        } else {
            self.stand(sink, orders, inputs, wishes, report);
        }
        (report.halt, report.inputs, report.latched) = (self.halt, inputs, self.state == State::Latched);
    }

    /// Nothing was filled, because the stream stands or was begun anew.
    #[inline(never)]
    fn stand(
        &mut self,
        sink: &mut impl StepSink,
        orders: &mut impl Orders,
        inputs: Inputs,
        wishes: Wishes,
        report: &mut Report,
    ) {
        match self.state {
            State::Idle if inputs.stop => self.latch(Halt { cause: Cause::EmergencyStop, ..Halt::default() }),
            State::Idle => self.restart(sink, orders),
            State::Paused if !wishes.pause => self.restart(sink, orders),
            State::Latched if wishes.rearm && !inputs.stop => self.restart(sink, orders),
            State::Running | State::Latched | State::Paused => {}
        }
        match self.state {
            State::Running => self.generator.tell(self.position(sink).0, report),
            _ => self.generator.attend(orders, report),
        }
    }

    /// The segment that plays, and the words of it that have.
    #[inline(always)]
    fn position(&self, sink: &mut impl StepSink) -> (u64, usize) {
        let played = sink.played();
        (self.origin + played / SEGMENT_TICKS as u64, (played % SEGMENT_TICKS as u64) as usize)
    }

    /// What there is to say when the next segment cannot be ready in time.
    #[inline(always)]
    fn late(&self, (segment, tick): (u64, usize)) -> Option<Halt> {
        let due = self.generator.next_segment();
        // ticks left; neither lies far from the other
        let left = (due.wrapping_sub(segment) as i32).wrapping_mul(SEGMENT_TICKS as i32) - tick as i32;
        (left < MARGIN as i32).then_some(Halt { cause: Cause::Deadline, ..Halt::default() })
    }

    /// Makes what is missing while a segment plays; answers which plays afterwards, none when it has come too late.
    #[inline(always)]
    fn fill(&mut self, sink: &mut impl StepSink, orders: &mut impl Orders, segment: u64) -> Option<u64> {
        let mut plays = segment;
        // neither lies far from the other
        while (self.generator.next_segment() as u32).wrapping_sub(segment as u32) as i32 <= AHEAD as i32 {
            let made = self.generator.next_segment();
            self.make(sink, orders, segment);
            let played = self.position(sink);
            plays = played.0;
            // the hardware reads a word ahead
            if plays >= made || plays + 1 == made && played.1 >= SEGMENT_TICKS - 2 {
                self.roll_back(sink, orders, Halt { cause: Cause::Output, ..Halt::default() });
                return None;
            }
        }
        Some(plays)
    }

    #[inline(never)]
    fn make(&mut self, sink: &mut impl StepSink, orders: &mut impl Orders, played: u64) {
        let slot = (self.generator.next_segment() - self.origin) % RING as u64;
        self.generator.refill_cleared(orders, played, sink.slot(slot as usize));
    }

    #[cold]
    #[inline(never)]
    fn roll_back(&mut self, sink: &mut impl StepSink, orders: &mut impl Orders, halt: Halt) {
        sink.stop();
        let (segment, tick) = self.position(sink);
        let slot = (segment - self.origin) % RING as u64;
        self.generator.abort(segment, tick, sink.slot(slot as usize));
        self.halt = halt;
        if halt.cause == Cause::EmergencyStop {
            self.state = State::Latched;
        } else {
            self.restart(sink, orders);
        }
    }

    /// An emergency stop while nothing plays.
    #[cold]
    #[inline(never)]
    fn latch(&mut self, halt: Halt) {
        let next = self.generator.next_segment();
        self.generator.abort(next, 0, &[]);
        self.halt = halt;
        self.state = State::Latched;
    }

    #[cold]
    #[inline(never)]
    fn restart(&mut self, sink: &mut impl StepSink, orders: &mut impl Orders) {
        sink.prepare();
        if sink.inputs().stop {
            return self.latch(Halt { cause: Cause::EmergencyStop, ..Halt::default() });
        }
        self.origin = self.generator.next_segment();
        for _ in 0..=AHEAD {
            let origin = self.origin;
            self.make(sink, orders, origin);
        }
        self.state = State::Running;
        sink.start();
    }
}
