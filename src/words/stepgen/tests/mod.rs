//! Properties of the emitted words over long random trajectories.
extern crate std;

mod abort;
mod arithmetic;
mod decoder;
mod trajectories;

use super::pins::{DIR_PINS, STEP_PINS};
use super::segment::{Emitter, Words, clear};
use super::timing::{MotorTiming, Timing};
use crate::units::{AXES, SEGMENT_TICKS};
use decoder::{Decoder, Random};

/// Segments in a long run; debug builds only sample.
const LONG_RUN: u32 = if cfg!(debug_assertions) { 20_000 } else { 1_000_000 };

/// Drivers with grids of 1, 2, 4, 8 and 32 ticks, and DIR times short and long.
const DRIVERS: [MotorTiming; 6] = [
    MotorTiming { high_ns: 1_000, low_ns: 1_000, setup_ns: 2_500, hold_ns: 2_500 },
    MotorTiming { high_ns: 0, low_ns: 1, setup_ns: 0, hold_ns: 0 },
    MotorTiming { high_ns: 1_001, low_ns: 1_900, setup_ns: 200, hold_ns: 10_000 },
    MotorTiming { high_ns: 2_500, low_ns: 2_500, setup_ns: 5_000, hold_ns: 5_000 },
    MotorTiming { high_ns: 5_000, low_ns: 1_000, setup_ns: 20_000, hold_ns: 1_000 },
    MotorTiming { high_ns: 20_000, low_ns: 30_000, setup_ns: 128_000, hold_ns: 128_000 },
];

/// One motor, its words and the driver that listens.
struct Bench {
    motor: usize,
    timing: Timing,
    emitter: Emitter,
    position: i64,
    base: u32,
    words: Words,
    decoder: Decoder,
}

impl Bench {
    fn new(asks: MotorTiming, random: &mut Random) -> Bench {
        let motor = random.below(AXES as u64) as usize;
        let inverted = random.below(2) == 1;
        let timing = Timing::new([asks; AXES]).unwrap().with_inverted([inverted; AXES]);
        let base = random.next() as u32;
        Bench {
            motor,
            timing,
            emitter: Emitter::at(0, false, base),
            position: (random.next() >> 32) as i64,
            base,
            words: [0; SEGMENT_TICKS],
            decoder: Decoder::new(STEP_PINS[motor], DIR_PINS[motor], inverted, asks),
        }
    }

    /// Points DIR upwards or downwards, long before the first step.
    fn point(&mut self, up: bool) {
        let dir = up != self.decoder.inverted;
        self.emitter = Emitter::at(0, dir, self.base);
        self.decoder.dir = dir;
    }

    /// Largest advance in a segment at this rate, in Q32.32 steps.
    fn reach(steps_per_second: u32) -> u64 {
        (u64::from(steps_per_second) << 32) * SEGMENT_TICKS as u64 / 1_000_000
    }

    /// Ticks that a turn takes at most, from rising edge to rising edge.
    fn turn_ticks(&self) -> u32 {
        self.timing.setup_ticks()[self.motor] + self.timing.hold_ticks()[self.motor] + self.timing.grid()
    }

    /// Makes the words of the next segment, without playing them.
    fn generate(&mut self, advance: i64) {
        let line = &self.timing.lines()[self.motor];
        let to = self.position + advance;
        clear(&mut self.words, &self.timing);
        if self.timing.grid() == 1 {
            self.emitter.place::<true>(line, self.position, to, self.base, &mut self.words);
        } else {
            self.emitter.place::<false>(line, self.position, to, self.base, &mut self.words);
        }
        self.position = to;
        self.base = self.base.wrapping_add(SEGMENT_TICKS as u32);
    }

    /// Makes and plays the next segment; `each` sees the count after every tick.
    fn advance(&mut self, advance: i64, mut each: impl FnMut(usize, i64)) {
        self.generate(advance);
        for (tick, &word) in self.words.iter().enumerate() {
            self.decoder.play(word);
            each(tick, self.decoder.position);
        }
        let e = &self.emitter;
        assert_eq!(e.emitted() as i64, self.decoder.position);
        assert_eq!(e.emitted().wrapping_add(e.waiting()), (self.position >> 32) as i32);
        assert_eq!(e.dir(), self.decoder.dir);
    }
}
