//! Leaving the stages in a stated place when an alignment cannot go on.

use super::bus::{Bus, BusError, Controller};
use super::program::Program;
use super::trouble::{Ended, Stand, Trouble};
use crate::bench_twin::Side;

/// Answers that may still come to what was asked before, at most.
const STALE: usize = 16;
/// Longest that a command goes on which was begun before, s.
const PATIENCE_S: f64 = 30.0;

impl<B: Bus> Controller<'_, B> {
    /// Drops what is left of messages, answers and errors of before (byte 0x18, `*CLS`), waits until all has ended that
    /// goes on, and says where the stage stands, um and degrees.
    ///
    /// # Errors
    /// Those of the bus.
    pub(super) fn clear(&mut self) -> Result<[f64; 6], BusError> {
        const MESSAGE: &str = "\x18*CLS;*OPC?;:POSE?";
        self.send(MESSAGE)?;
        let mut last = String::new();
        for _ in 0..STALE {
            last = self.answer(MESSAGE, PATIENCE_S)?;
            let numbers = last.split_once(';').filter(|(one, _)| *one == "1").map(|(_, pose)| pose.split(','));
            let pose: Option<Vec<f64>> = numbers.and_then(|numbers| numbers.map(|n| n.parse().ok()).collect());
            if let Some(Ok(pose)) = pose.map(<[f64; 6]>::try_from) {
                return Ok(pose);
            }
        }
        Err(self.strange(MESSAGE, &last, "1 and a pose"))
    }
}

impl<B: Bus> Program<'_, B> {
    /// Ends an alignment: lets both stages come to rest, and draws back those that are nearer to the chip than where
    /// they were drawn back before anything turned. A stage whose controller is lost cannot be reached; after a collision
    /// everything is stopped at once and nothing moves any more.
    pub(super) fn end(&mut self, trouble: Trouble) -> Ended {
        let seconds = self.bus.seconds() - self.began;
        let after = self.steps.last().map(|step| step.name.clone());
        let stands = match trouble {
            Trouble::Bus(BusError::Collision(_)) => Side::BOTH.map(|side| {
                let stopped = self.at(side).send("ABOR");
                stopped.map_or(Stand::Unknown, |()| Stand::Stopped)
            }),
            _ => Side::BOTH.map(|side| self.rest(side)),
        };
        Ended { trouble, after, seconds, stands }
    }

    fn rest(&mut self, side: Side) -> Stand {
        let Ok(pose) = self.at(side).clear() else { return Stand::Unknown };
        match self.back_um[side.index()] {
            Some(back_um) if pose[2] > back_um => {
                let moved = self.at(side).move_by([0.0, 0.0, back_um - pose[2], 0.0, 0.0, 0.0]);
                match (moved, self.at(side).clear()) {
                    (Ok(()), Ok(pose)) => Stand::DrawnBack(pose),
                    (Err(_), Ok(pose)) => Stand::Near(pose),
                    (_, Err(_)) => Stand::Unknown,
                }
            }
            _ => Stand::Rests(pose),
        }
    }
}
