//! What crosses the border between the two halves: orders down, reports up. Plain data.

use super::safety::{Halt, Inputs};
use crate::compensation::backlash::{Flank, PlayConfig};
use crate::compensation::law::Law;
use crate::motion::track::Track;
use crate::stepgen::timing::Timing;
use crate::units::{AXES, MotorSteps, Pose, SEGMENT_TICKS};

/// What the generator is to do.
#[derive(Clone, Copy, Debug)]
#[allow(clippy::large_enum_variant)] // a bounded queue has no heap to box into
pub enum Action {
    /// Run a track in a slot from the segment at which it takes effect, in place of what runs there.
    Run {
        /// Which slot.
        slot: u8,
        /// The track; it begins with that segment.
        track: Track,
    },
    /// Another law. Only at standstill; an [`Action::Anchor`] follows.
    Law(Law),
    /// The pose and the counts that the stage stands at, overlay left out. Only at standstill.
    Anchor {
        /// Logical pose at rest; the law gives `steps` there.
        pose: Pose,
        /// Motor counts without overlay.
        steps: MotorSteps,
    },
    /// Another backlash configuration of a motor.
    Play {
        /// Which motor.
        motor: u8,
        /// Its configuration from now on.
        config: PlayConfig,
    },
    /// The flank of a motor is known (homed, preloaded) or unknown. Only at standstill.
    Flank {
        /// Which motor.
        motor: u8,
        /// The side on which it rests, or none.
        flank: Option<Flank>,
    },
    /// How a motor stands after a start: its flank and its overlay. Only at standstill; an [`Action::Anchor`] follows.
    Rest {
        /// Which motor.
        motor: u8,
        /// The side on which it rests, or none.
        flank: Option<Flank>,
        /// Its overlay, whole steps.
        overlay: i32,
    },
    /// Pulse timing and sense of the motors. Only at standstill.
    Pulses(Timing),
    /// Another position compare, in place of the one before.
    Compare(Compare),
}

/// Position compare: where a logical axis makes pulses, one after the other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compare {
    /// Which axis.
    pub axis: u8,
    /// Position of the first pulse, nm or nrad.
    pub start: i32,
    /// From each pulse to the next one, nm or nrad; not zero if there is another.
    pub step: i32,
    /// How many; 0 is off.
    pub count: u16,
}

/// An action and the segment at which it takes effect.
#[derive(Clone, Copy, Debug)]
pub struct Order {
    /// Number of the order, for its answer.
    pub sequence: u16,
    /// The segment with which it takes effect; an order for a segment already generated is refused.
    /// None: as soon as it is seen; a track says by [`Report::begun`] when that was.
    pub segment: Option<u64>,
    /// Aborts that the front knew of when it gave the order: an order from before an abort is refused.
    pub aborts: u16,
    /// What to do.
    pub action: Action,
}

impl Order {
    /// A track that is to begin as soon as it is seen. Other orders wait for what was made before them: after a change
    /// of pulses its words would have to be cleared on another grid.
    pub fn runs_at_once(&self) -> bool {
        self.segment.is_none() && matches!(self.action, Action::Run { .. })
    }
}

/// Where the generator takes its orders from.
pub trait Orders {
    /// The oldest order, if there is one.
    fn peek(&self) -> Option<&Order>;
    /// Drops the oldest order.
    fn pop(&mut self);
}

impl Orders for heapless::spsc::Consumer<'_, Order> {
    fn peek(&self) -> Option<&Order> {
        heapless::spsc::Consumer::peek(self)
    }

    fn pop(&mut self) {
        self.dequeue();
    }
}

/// State of the generator after a segment; every field stands alone, so that a lost report costs nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Report {
    /// The segment that is generated next.
    pub next: u64,
    /// Segments completely played.
    pub played: u64,
    /// Sequence number of the last order that was answered.
    pub answered: u16,
    /// Bit k: the order `answered - k` was refused.
    pub refused: u32,
    /// The segment with which the last track began that was to begin as soon as it was seen.
    pub begun: u64,
    /// Motor counts, overlay included, at the end of what was played.
    pub counts: MotorSteps,
    /// Motor counts without the overlay, at the end of what was played.
    pub steps: MotorSteps,
    /// Motor counts without the overlay at the end of what was generated.
    pub final_steps: MotorSteps,
    /// Bit n: axis n moves in the segment that is played now.
    pub moving: u8,
    /// Bit n: motor n takes up its play in the segment that is played now.
    pub taking_up: u8,
    /// Bit n: motor n rests on the negative flank.
    pub negative: u8,
    /// Bit n: the flank of motor n is known.
    pub known: u8,
    /// Bit n: motor n owes a take-up, which begins with the next move.
    pub owing: u8,
    /// Overlays at the end of what was generated, whole steps.
    pub overlay: [i32; AXES],
    /// Nothing moves in what was generated and not yet played.
    pub settled: bool,
    /// Aborts so far.
    pub aborts: u16,
    /// The segment in which the last abort was.
    pub halted: u64,
    /// Why the last abort was.
    pub halt: Halt,
    /// Inputs when the report was made.
    pub inputs: Inputs,
    /// The stream stands until it is armed again: the emergency stop is latched.
    pub latched: bool,
    /// Bit n: motor n may be stepping upwards in what is played or waits to be played.
    pub stepping_up: u8,
    /// Bit n: the same downwards.
    pub stepping_down: u8,
    /// Pulses of the position compare at the end of what was played.
    pub pulsed: u16,
}

/// Inputs that measure light.
pub const POWER_INPUTS: usize = 2;
/// Conversions of each input that make a sample, one after the other from the border on (12 us).
pub const CONVERSIONS: u16 = 8;
/// Greatest value of a conversion, 12 bit.
pub const CONVERSION_MAX: u16 = 4095;

/// What the power inputs say at a border between two segments, and where the motors stand there: exactly, because a
/// border is where the generator's state is known.
///
/// In the order of declaration: tests of the firmware read it in memory.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sample {
    /// Segments completely played: the tick is [`Sample::tick`].
    pub played: u64,
    /// Motor counts, overlay included.
    pub counts: MotorSteps,
    /// The same without the overlay.
    pub steps: MotorSteps,
    /// Bit n: motor n takes up its play.
    pub taking_up: u8,
    /// Bit n: axis n moves.
    pub moving: u8,
    /// Sum of [`CONVERSIONS`] conversions of each input.
    pub power: [u16; POWER_INPUTS],
}

impl Sample {
    /// The tick at which it was taken.
    pub fn tick(&self) -> u64 {
        self.played * SEGMENT_TICKS as u64
    }
}

impl Report {
    /// True when it tells of more than the march of time and counts: what moves, rests, is known or was answered.
    pub fn differs(&self, before: &Report) -> bool {
        self.marks() != before.marks()
    }

    /// What makes one report [differ](Report::differs) from another.
    #[inline(always)]
    pub fn marks(&self) -> [u32; 4] {
        let Inputs { lower, upper, fault, stop } = self.inputs;
        [
            u32::from(self.answered) << 16 | u32::from(self.aborts),
            u32::from_le_bytes([self.moving, self.taking_up, self.negative, self.known]),
            u32::from_le_bytes([self.owing, u8::from(self.settled), u8::from(self.latched), u8::from(stop)]),
            u32::from_le_bytes([lower, upper, fault, 0]),
        ]
    }
}
