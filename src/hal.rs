//! The seam: what the controller's thread needs of a board. A board implements it; the controller knows no pin.
//!
//! The step output has a seam of its own, [`StepSink`](crate::refill::stream::StepSink), because the refill owns it.

use crate::refill::border::{Order, Report, Sample};
use crate::refill::safety::{Halt, Watch};
#[cfg(feature = "bus")]
use crate::scpi::{exchange::Attached, session::Session};
use crate::store::Standstill;

/// The thread's side of the step output, of the drivers and of the lights.
pub trait Hal {
    /// The oldest report that was not taken yet.
    fn report(&mut self) -> Option<Report>;
    /// The oldest sample of light that was not taken yet. One is taken at every border of the running stream; those that
    /// find no room are lost, which shows by their numbers.
    fn sample(&mut self) -> Option<Sample>;
    /// True when an order can be taken.
    fn can_order(&self) -> bool;
    /// Takes an order down; only when [`Hal::can_order`].
    fn order(&mut self, order: Order);
    /// Stops all motors at once; a later report says where.
    fn halt(&mut self, halt: Halt);
    /// Arms the step output again after an emergency stop.
    fn rearm(&mut self);
    /// What the inputs are judged by.
    fn set_watch(&mut self, watch: Watch);
    /// Levels of the enable lines, and those that disable all drivers: what the board falls back to. Bit n: line n is
    /// high.
    fn set_enables(&mut self, levels: u8, disabled: u8);
    /// Keeps where the motors stand in memory that outlives a reset, where that has changed.
    fn keep(&mut self, standstill: Standstill);
    /// Shows a person what goes on.
    fn show(&mut self, signs: Signs);
}

/// What a person sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Signs {
    /// Something moves.
    pub moving: bool,
    /// Stopped for a fault or an emergency.
    pub fault: bool,
    /// Bytes came or went.
    pub traffic: bool,
}

/// What happened on a port, beside bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortEvent {
    /// Somebody is there.
    Opened,
    /// Nobody is there any more.
    Closed,
    /// Who is there sleeps, or his cable is out, which looks the same (USB 2.0, 7.1.7.6): nobody watches a jog. All
    /// else stays, for he may wake up.
    Asleep,
    /// BREAK: the input so far is to be forgotten.
    Break,
    /// Bytes were lost: they came faster than they were taken.
    Overrun,
    /// A byte came damaged and the ones around it are lost.
    Framing,
}

/// A port of the board: bytes both ways, never waiting.
pub trait Port {
    /// The next event.
    fn event(&mut self) -> Option<PortEvent>;
    /// Bytes that came, as many as lie together.
    fn received(&mut self) -> &[u8];
    /// Drops the first bytes of those.
    fn consume(&mut self, count: usize);
    /// Bytes that [`Port::send`] takes now.
    fn room(&self) -> usize;
    /// Sends bytes, at most [`Port::room`].
    fn send(&mut self, bytes: &[u8]);
    /// Goes on with what it has begun; called in every turn.
    fn attend(&mut self) {}
    /// The port as a bus, if it is one: then it has neither bytes nor room.
    #[cfg(feature = "bus")]
    fn bus(&mut self) -> Option<&mut dyn BusPort> {
        None
    }
}

/// A port on which one side speaks at a time. It deals with the message exchange, not with bytes.
#[cfg(feature = "bus")]
pub trait BusPort {
    /// Goes on with the exchange of its link; true when something has changed for either.
    fn turn(&mut self, link: &mut Attached<'_, Session>) -> bool;
}
