//! What a report says.

use super::Generator;
use super::history::place_of;
use super::motor::{Motor, Standing};
use crate::refill::border::Report;

impl Generator {
    /// State at the end of the segments completely played, of which there are `played`.
    pub fn report(&self, played: u64) -> Report {
        let mut report = Report::default();
        self.tell(played, &mut report);
        report
    }

    /// The same, written over another report; what the stream knows stays.
    #[inline(never)]
    pub fn tell(&self, played: u64, report: &mut Report) {
        let flags = match self.start_of(played) {
            Some(start) => {
                let place = place_of(played);
                self.count(|motor| &motor.starts[place], report);
                report.pulsed = start.pulsed;
                &start.flags
            }
            None => {
                self.count_now(report);
                report.pulsed = self.comparing.pulsed;
                &self.flags
            }
        };
        (report.next, report.played) = (self.segment, played);
        (report.answered, report.refused) = (self.answered, self.refused);
        (report.moving, report.taking_up, report.negative) = (flags.moving, flags.taking_up, flags.negative);
        (report.known, report.owing) = (flags.known, flags.owing);
        report.settled = played >= self.busy_until;
        (report.aborts, report.halted, report.begun) = (self.aborts, self.halted, self.begun);
        (report.stepping_up, report.stepping_down) =
            self.stepping.last((self.segment as u32).wrapping_sub(played as u32));
    }

    #[cold]
    #[inline(never)]
    fn count_now(&self, report: &mut Report) {
        self.count(|motor| &motor.now, report);
    }

    /// What a report says motor by motor; `then` is where a motor stood when what was played had been played.
    #[inline(always)]
    fn count(&self, then: impl Fn(&Motor) -> &Standing, report: &mut Report) {
        // written out, because a loop over five arrays costs more than what is in it
        let mut one = |i: usize| {
            let (motor, then) = (&self.motors[i], then(&self.motors[i]));
            report.counts.0[i] = then.emitter.emitted();
            report.steps.0[i] = (then.target >> 32) as i32;
            report.final_steps.0[i] = (motor.now.target >> 32) as i32;
            report.overlay[i] = motor.now.play.overlay();
        };
        one(0);
        one(1);
        one(2);
        one(3);
        one(4);
        one(5);
    }
}
