//! What a script has played and answered, summed up.

use core::fmt;
use stage_controller::stepgen::pins::{STEP_MASK, STEP_PINS};
use stage_controller::units::AXES;

/// Offset and prime of the 64-bit Fowler-Noll-Vo hash (draft-eastlake-fnv).
const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0000_0100_0000_01b3;

/// Sum of everything that was played and answered; two are equal when every word and every byte was.
///
/// # Design
/// The hash is FNV-1a with whole words in place of bytes. Each of its steps can be undone, so one different word always
/// gives another hash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// Segments played, whole or up to an immediate stop.
    pub segments: u32,
    /// Steps of each motor, in either direction.
    pub steps: [u32; AXES],
    /// Hash of all words and of how many each segment had.
    pub words: u64,
    /// Hash of all bytes answered.
    pub answers: u64,
}

impl Default for Record {
    fn default() -> Self {
        Record { segments: 0, steps: [0; AXES], words: OFFSET, answers: OFFSET }
    }
}

impl Record {
    /// Adds the words of one segment, all or those up to a stop.
    pub fn add_words(&mut self, words: &[u32]) {
        self.segments += 1;
        let mut hash = fold(self.words, words.len() as u32);
        for &word in words {
            hash = fold(hash, word);
            if word & STEP_MASK != 0 {
                for (steps, pin) in self.steps.iter_mut().zip(STEP_PINS) {
                    *steps += word >> pin & 1;
                }
            }
        }
        self.words = hash;
    }

    /// Adds bytes of an answer.
    pub fn add_answer(&mut self, bytes: &[u8]) {
        self.answers = bytes.iter().fold(self.answers, |hash, byte| fold(hash, u32::from(*byte)));
    }

    /// The record of a script in a table as [`Record`]'s `Display` writes it, a line each after the script's name.
    pub fn find(table: &str, script: &str) -> Option<Record> {
        table.lines().find_map(|line| {
            let mut fields = line.split_whitespace();
            (fields.next() == Some(script)).then(|| Record::parse(fields)).flatten()
        })
    }

    fn parse<'a>(mut fields: impl Iterator<Item = &'a str>) -> Option<Record> {
        let mut record = Record { segments: fields.next()?.parse().ok()?, ..Record::default() };
        for steps in &mut record.steps {
            *steps = fields.next()?.parse().ok()?;
        }
        for hash in [&mut record.words, &mut record.answers] {
            *hash = u64::from_str_radix(fields.next()?, 16).ok()?;
        }
        fields.next().is_none().then_some(record)
    }
}

impl fmt::Display for Record {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:>7}", self.segments)?;
        for steps in self.steps {
            write!(f, " {steps:>7}")?;
        }
        write!(f, " {:016x} {:016x}", self.words, self.answers)
    }
}

fn fold(hash: u64, word: u32) -> u64 {
    (hash ^ u64::from(word)).wrapping_mul(PRIME)
}
