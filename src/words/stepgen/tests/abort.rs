//! An abort after any word: what was played is known, and what follows is legal.
extern crate std;

use super::decoder::Random;
use super::{Bench, DRIVERS, LONG_RUN};
use crate::stepgen::played::{Levels, Played, edges};
use crate::stepgen::segment::Emitter;
use crate::units::SEGMENT_TICKS;

#[test]
fn an_abort_at_any_word_counts_what_was_played_and_goes_on_legally() {
    let random = &mut Random(10);
    for asks in DRIVERS {
        let mut bench = Bench::new(asks, random);
        let limit = Bench::reach(bench.timing.max_step_rate());
        let mut speed = 0;
        for _ in 0..LONG_RUN / 10 {
            if random.below(3) == 0 {
                let slow = random.below(8);
                speed = (random.below(2 * limit) as i64 - limit as i64) >> slow;
            }
            if random.below(4) != 0 {
                bench.advance(speed, |_, _| ());
                continue;
            }
            let (start, base) = (bench.emitter, bench.base);
            bench.generate(speed);
            let line = &bench.timing.lines()[bench.motor];
            let played = &bench.words[..random.below(SEGMENT_TICKS as u64 + 1) as usize];
            for &word in played {
                bench.decoder.play(word);
            }
            let resume = base.wrapping_add(played.len() as u32 + random.below(300) as u32);
            let emitter = Emitter::after_abort(&start, line, played, base, resume);
            assert_eq!(i64::from(emitter.emitted()), bench.decoder.position);
            assert_eq!(emitter.emitted(), start.emitted() + edges(played, line, start.dir()));
            assert_eq!((emitter.dir(), emitter.waiting()), (bench.decoder.dir, 0));
            // The minimum high time passes at least.
            let idle = resume.wrapping_sub(base) - played.len() as u32;
            bench.decoder.pause(idle.max(bench.timing.grid()));
            bench.emitter = emitter;
            bench.base = resume;
            bench.position = i64::from(emitter.emitted()) << 32 | (random.next() >> 32) as i64;
        }
    }
}

#[test]
fn levels_after_every_word_are_those_of_the_lines() {
    let random = &mut Random(11);
    let mut bench = Bench::new(DRIVERS[3], random);
    for advance in [5i64 << 32, -3 << 31, 7 << 32, -9 << 32] {
        let start = Levels { step: false, dir: bench.emitter.dir() };
        bench.generate(advance);
        let line = &bench.timing.lines()[bench.motor];
        for k in 0..=SEGMENT_TICKS {
            let played = Played::replay(&bench.words[..k], line, start);
            let mut level = start;
            for &word in &bench.words[..k] {
                level = level.after(line, word);
            }
            assert_eq!(played.levels, level);
        }
        assert_eq!(Played::replay(&bench.words, line, start).levels.dir, bench.emitter.dir());
    }
}
