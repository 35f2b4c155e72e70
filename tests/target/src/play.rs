//! Plays a script on a controller.

use crate::record::Record;
use crate::script::Step;
use crate::suite;
use core::fmt;

/// Longest answer that a script can compare, bytes.
pub const ANSWER: usize = 512;

/// As much of a wrong answer as a failure shows, bytes.
const SHOWN: usize = 80;

/// Segments after which a script gives up waiting: a minute.
const PATIENCE: u32 = 234_375;

/// A controller that a script can drive.
pub trait Rig {
    /// Power-up with a calibration block as if it were saved; unless `cold`, enabled and homed at 0. False when the
    /// block is refused.
    fn power_up(&mut self, block: &[u8], cold: bool) -> bool;
    /// Hands bytes to the one link and takes what is answered at once; no time passes. The number of bytes taken.
    fn exchange(&mut self, bytes: &[u8], answered: impl FnMut(&[u8])) -> usize;
    /// One segment of 256 us passes; `played` sees its words, up to an immediate stop.
    fn step(&mut self, played: impl FnMut(&[u32]));
    /// Something moves or is about to.
    fn is_pending(&self) -> bool;
    /// From now on an immediate stop comes after this many words of the segment that then plays.
    fn stop_after(&mut self, tick: usize);
}

/// Why a script cannot be played to its end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The line is no step of a script.
    Unreadable,
    /// No such machine, or its block is refused.
    NoMachine,
    /// The link takes no more bytes.
    Full,
    /// There is no answer.
    Silent,
    /// Another answer, and how it begins.
    Answered(heapless::String<SHOWN>),
    /// It does not come to rest.
    Restless,
}

/// A line of a script that cannot be played, from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure<'a> {
    /// Its number.
    pub number: usize,
    /// Its text.
    pub line: &'a str,
    /// What is wrong with it.
    pub reason: Reason,
}

impl fmt::Display for Failure<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}, {:?}: ", self.number, self.line)?;
        match &self.reason {
            Reason::Unreadable => f.write_str("no message, no = answer and no known @ directive"),
            Reason::NoMachine => f.write_str("no calibration block of that name, or the controller refuses it"),
            Reason::Full => f.write_str("the link does not take it; wait before it"),
            Reason::Silent => f.write_str("no answer came"),
            Reason::Answered(text) => write!(f, "the answer was {text:?}"),
            Reason::Restless => f.write_str("it does not come to rest"),
        }
    }
}

/// Plays a script; `played` sees every segment.
///
/// # Errors
/// The first line that cannot be played.
pub fn play<'a>(script: &'a str, rig: &mut impl Rig, played: impl FnMut(&[u32])) -> Result<Record, Failure<'a>> {
    let mut player = Player { rig, played, record: Record::default(), answer: heapless::Vec::new() };
    for (number, line) in (1..).zip(script.lines()) {
        let failed = |reason| Failure { number, line, reason };
        if let Some(step) = Step::parse(line).map_err(|_| failed(Reason::Unreadable))? {
            player.step(step).map_err(failed)?;
        }
    }
    Ok(player.record)
}

fn beginning(text: &str) -> heapless::String<SHOWN> {
    let mut shown = heapless::String::new();
    // ends with the first character that has no room
    let _ = text.chars().try_for_each(|character| shown.push(character));
    shown
}

struct Player<'r, R, P> {
    rig: &'r mut R,
    played: P,
    record: Record,
    /// What has been answered since the last message was sent.
    answer: heapless::Vec<u8, ANSWER>,
}

impl<R: Rig, P: FnMut(&[u32])> Player<'_, R, P> {
    fn step(&mut self, step: Step<'_>) -> Result<(), Reason> {
        match step {
            Step::PowerUp { machine, cold } => {
                let block = suite::block(machine).ok_or(Reason::NoMachine)?;
                self.rig.power_up(block, cold).then_some(()).ok_or(Reason::NoMachine)
            }
            Step::Wait(segments) => {
                (0..segments).for_each(|_| self.segment());
                Ok(())
            }
            Step::Rest => {
                self.segment();
                self.wait(|player| !player.rig.is_pending()).ok_or(Reason::Restless)
            }
            Step::Tick(tick) => {
                self.rig.stop_after(usize::from(tick));
                Ok(())
            }
            Step::Load(machine) => {
                let block = suite::block(machine).ok_or(Reason::NoMachine)?;
                let length = block.len();
                let digits = [100, 10, 1].map(|unit| b'0' + (length / unit % 10) as u8);
                self.answer.clear();
                self.send(b"COMP:LOAD #3")?;
                self.send(&digits)?;
                self.send(block)?;
                self.send(b"\n")
            }
            Step::Expect(text) => {
                self.wait(|player| player.answer.ends_with(b"\n")).ok_or(Reason::Silent)?;
                let answer = core::str::from_utf8(&self.answer).unwrap_or("bytes that are no text").trim_end();
                if answer == text { Ok(()) } else { Err(Reason::Answered(beginning(answer))) }
            }
            Step::Message(text) => {
                self.answer.clear();
                self.send(text.as_bytes())?;
                self.send(b"\n")
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), Reason> {
        let taken = self.exchange(bytes);
        if taken == bytes.len() { Ok(()) } else { Err(Reason::Full) }
    }

    fn exchange(&mut self, bytes: &[u8]) -> usize {
        let Player { rig, record, answer, .. } = self;
        rig.exchange(bytes, |bytes| {
            record.add_answer(bytes);
            // what is longer is compared by its hash alone
            let _ = answer.extend_from_slice(bytes);
        })
    }

    fn segment(&mut self) {
        let Player { rig, played, record, .. } = self;
        rig.step(|words| {
            record.add_words(words);
            played(words);
        });
        self.exchange(b"");
    }

    /// Lets time pass until `done`; none when that never comes.
    fn wait(&mut self, done: impl Fn(&Self) -> bool) -> Option<()> {
        (0..PATIENCE).find_map(|_| {
            if done(self) {
                return Some(());
            }
            self.segment();
            None
        })
    }
}
