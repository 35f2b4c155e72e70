//! Motors, play and chain behind the step words.
//!
//! # Design
//! Play does not depend on speed: over a run of steps in one direction only the last position counts.
//! So edges are only *counted* word by word, six lanes in one u64, and the play is worked out when a
//! direction changes and at the end of a call. The pose is computed when it is asked for.
//!
//! # Limitations
//! A motor follows every edge: no stall, no missed step however short the pulse ([`super::Timing`]
//! tells). A direction line that changes in the same word as a step edge counts with its new level.

use super::after_word;
use crate::machine::Machine;
use crate::model::Truth;
use stage_controller::stepgen::pins::{DIR_MASK, DIR_PINS, STEP_MASK, STEP_PINS};
use stage_controller::units::{AXES, MotorSteps};

/// Words that are skipped together when none of them sets a bit.
const CHUNK: usize = 16;
/// Bits of one motor's counter.
const LANE: u32 = 10;
/// Chunks after which a counter could overflow.
const CHUNKS_PER_COUNT: usize = ((1 << LANE) - 1) / CHUNK;
/// Edges of one word as counter increments, by bits 5–7 and 13–15 of the port.
const LANES: [u64; 64] = lanes();

const _: () = assert!(STEP_MASK == 0xe0e0, "the table of increments is made for PE5-7 and PE13-15");

const fn lane_index(rising: u32) -> usize {
    (((rising >> 5) & 7) | ((rising >> 10) & 0x38)) as usize
}

const fn lanes() -> [u64; 64] {
    let mut table = [0; 64];
    let mut motor = 0;
    while motor < AXES {
        let bit = lane_index(1 << STEP_PINS[motor]);
        let mut i = 0;
        while i < 64 {
            if i & bit != 0 {
                table[i] += 1 << (LANE * motor as u32);
            }
            i += 1;
        }
        motor += 1;
    }
    table
}

/// One motor and the play behind it, in steps.
#[derive(Clone, Copy, Debug)]
struct Drive {
    motor: i32,
    /// Driven side of the play.
    driven: f64,
    half_play: f64,
}

impl Drive {
    fn turn(&mut self, steps: i32) {
        self.motor += steps;
        let motor = f64::from(self.motor);
        self.driven = self.driven.clamp(motor - self.half_play, motor + self.half_play);
    }
}

/// The stage as the step words move it.
#[derive(Clone, Debug)]
pub struct Mechanics {
    truth: Truth,
    steps: [f64; AXES],
    drives: [Drive; AXES],
    /// Port bits of the DIR lines whose sense is inverted.
    inverted: u32,
    lines: u32,
    ticks: u64,
}

impl Mechanics {
    /// A stage at home on the positive (reference) flank of every play, all lines low, with the
    /// machine's true backlash. `inverted`: motors whose DIR line means positive when low.
    pub fn new(machine: &Machine, inverted: [bool; AXES]) -> Self {
        let mut inverted_lines = 0;
        for (pin, invert) in DIR_PINS.into_iter().zip(inverted) {
            inverted_lines |= u32::from(invert) << pin;
        }
        Mechanics {
            truth: Truth::new(machine),
            steps: machine.drives.map(|drive| drive.step),
            drives: machine.drives.map(|drive| {
                let half_play = 0.5 * drive.backlash / drive.step;
                Drive { motor: 0, driven: -half_play, half_play }
            }),
            inverted: inverted_lines,
            lines: 0,
            ticks: 0,
        }
    }

    /// Plays words, one per tick.
    pub fn feed(&mut self, words: &[u32]) {
        self.ticks += words.len() as u64;
        words.chunks(usize::from(u8::MAX)).for_each(|block| self.feed_block(block));
    }

    /// At most 255 words: an edge counter has a byte for each motor.
    fn feed_block(&mut self, words: &[u32]) {
        let (mut all, mut any) = (u32::MAX, 0);
        for word in words {
            all &= word;
            any |= word;
        }
        // Every word lowers every STEP line and none touches another: the usual segment on a grid of one tick. Then a
        // line is high after a word exactly if that word sets it, and no word waits for the one before.
        if all >> 16 & STEP_MASK == STEP_MASK && any & !(STEP_MASK | STEP_MASK << 16) == 0 {
            self.count_edges(words);
        } else {
            self.feed_any(words);
        }
    }

    /// Rising edges of STEP lines when each word lowers all of them: bits 5 to 7 and 13 to 15, a byte for each.
    fn count_edges(&mut self, words: &[u32]) {
        let (Some((first, later)), Some(last)) = (words.split_first(), words.last()) else {
            return;
        };
        let count = |counts: [u32; 3], before: u32, word: u32| {
            let rising = word & !before;
            [counts[0] + (rising >> 5 & 0x0101), counts[1] + (rising >> 6 & 0x0101), counts[2] + (rising >> 7 & 0x0101)]
        };
        let start = count([0; 3], self.lines, *first);
        let counts = words.iter().zip(later).fold(start, |counts, (before, word)| count(counts, *before, *word));
        self.lines = after_word(self.lines & !STEP_MASK, *last);
        let mut by_motor = 0;
        for (motor, pin) in STEP_PINS.into_iter().enumerate() {
            let edges = counts[(pin as usize - 5) % 8] >> (pin & 8) & 0xff;
            by_motor |= u64::from(edges) << (LANE * motor as u32);
        }
        self.settle(by_motor);
    }

    /// Words of any kind.
    fn feed_any(&mut self, words: &[u32]) {
        let mut counts = 0u64;
        for block in words.chunks(CHUNK * CHUNKS_PER_COUNT) {
            for chunk in block.chunks(CHUNK) {
                let any = chunk.iter().fold(0, |any, word| any | word);
                if any & 0xffff == 0 {
                    // Without set bits no edge rises, but a DIR line may fall.
                    if self.lines & (any >> 16) & DIR_MASK != 0 {
                        self.settle(counts);
                        counts = 0;
                    }
                    self.lines &= !(any >> 16);
                } else {
                    counts = self.play(chunk, counts);
                }
            }
            self.settle(counts);
            counts = 0;
        }
    }

    /// Counts the rising edges of a chunk on top of `counts`.
    #[inline]
    fn play(&mut self, chunk: &[u32], mut counts: u64) -> u64 {
        let mut lines = self.lines;
        for &word in chunk {
            let next = after_word(lines, word);
            if (next ^ lines) & DIR_MASK != 0 {
                self.settle(counts);
                counts = 0;
                self.lines = next;
            }
            counts += LANES[lane_index(next & !lines)];
            lines = next;
        }
        self.lines = lines;
        counts
    }

    /// Turns the motors by counted edges in the present directions.
    fn settle(&mut self, counts: u64) {
        if counts == 0 {
            return;
        }
        let positive = self.lines ^ self.inverted;
        for (motor, drive) in self.drives.iter_mut().enumerate() {
            let edges = (counts >> (LANE * motor as u32)) as i32 & ((1 << LANE) - 1);
            if edges != 0 {
                drive.turn(if positive >> DIR_PINS[motor] & 1 == 1 { edges } else { -edges });
            }
        }
    }

    /// Turns every motor straight to a count, as any words do that never turn one back on the way.
    pub fn run_to(&mut self, motors: MotorSteps) {
        for (drive, count) in self.drives.iter_mut().zip(motors.0) {
            drive.turn(count - drive.motor);
        }
    }

    /// Ticks played.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Levels of the port's lines.
    pub fn lines(&self) -> u32 {
        self.lines
    }

    /// Motor positions in steps from home.
    pub fn motors(&self) -> MotorSteps {
        MotorSteps(self.drives.map(|drive| drive.motor))
    }

    /// Positions of the driven sides in steps: on the positive flank those of the motors.
    pub fn driven_steps(&self) -> [f64; AXES] {
        self.drives.map(|drive| drive.driven + drive.half_play)
    }

    /// Actuator positions behind the play in nm and nrad; on the positive flank motor · step.
    pub fn actuators(&self) -> [f64; AXES] {
        std::array::from_fn(|i| (self.drives[i].driven + self.drives[i].half_play) * self.steps[i])
    }

    /// True pose of the fibre point in nm and nrad, with all errors that the machine file gives: [`Truth::pose`].
    pub fn true_pose(&self) -> [f64; AXES] {
        self.truth.pose(self.actuators())
    }
}
