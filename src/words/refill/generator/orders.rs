//! Orders: what changes between two segments.

use super::Generator;
use super::history::HISTORY;
use crate::compensation::backlash::Play;
use crate::compensation::coupling::HALF;
use crate::compensation::law::Remembered;
use crate::refill::border::{Action, Order, Orders, Report};
use crate::units::{FinePose, MotorSteps};

impl Generator {
    #[inline(never)]
    pub(super) fn take_orders(&mut self, orders: &mut impl Orders) {
        while let Some(order) = orders.peek() {
            if order.segment.is_some_and(|segment| segment > self.segment) {
                // what was taken before it counts all the same
                break;
            }
            let late = order.segment.is_some_and(|segment| segment < self.segment);
            let accepted = !late && order.aborts == self.aborts && self.apply(order);
            self.answered = order.sequence;
            self.refused = self.refused << 1 | u32::from(!accepted);
            orders.pop();
        }
        self.look_at_tracks();
        self.look_at_motors();
        self.steady = 0;
    }

    /// Applies an order; false when the state does not allow it.
    #[inline(never)]
    fn apply(&mut self, order: &Order) -> bool {
        let at_rest = self.running == 0 && !self.motors.iter().any(|motor| motor.now.play.is_taking_up());
        match &order.action {
            Action::Run { slot, track } => match self.tracks.get_mut(usize::from(*slot)) {
                Some(place) => {
                    place.track = *track;
                    (place.start, place.cursor, place.axes) = (self.segment, 0, track.axes());
                    self.running |= 1 << slot;
                    if order.segment.is_none() {
                        self.begun = self.segment;
                    }
                    true
                }
                None => false,
            },
            Action::Play { motor, config } => match self.motors.get_mut(usize::from(*motor)) {
                Some(motor) => {
                    motor.config = *config;
                    motor.now.play.disturb();
                    true
                }
                None => false,
            },
            Action::Compare(compare) => {
                self.compare(*compare);
                true
            }
            _ if !at_rest => false,
            Action::Law(law) => {
                self.law = *law;
                self.remembered = Remembered::default();
                true
            }
            Action::Anchor { pose, steps } => {
                self.anchor(pose.fine(), *steps);
                true
            }
            Action::Flank { motor, flank } => match self.motors.get_mut(usize::from(*motor)) {
                Some(motor) => {
                    let now = &mut motor.now;
                    now.play = Play::resting((now.target >> 32) as i32, *flank, now.play.overlay());
                    true
                }
                None => false,
            },
            Action::Rest { motor, flank, overlay } => match self.motors.get_mut(usize::from(*motor)) {
                Some(motor) => {
                    let now = &mut motor.now;
                    now.play = Play::resting((now.target >> 32) as i32, *flank, *overlay);
                    true
                }
                None => false,
            },
            Action::Pulses(timing) => {
                self.timing = *timing;
                for (motor, line) in self.motors.iter_mut().zip(timing.lines()) {
                    motor.line = *line;
                    motor.now.emitter.disturb();
                }
                true
            }
        }
    }

    /// Stands at a pose with these counts (overlay left out); no motor moves.
    pub(super) fn anchor(&mut self, pose: FinePose, steps: MotorSteps) {
        self.base = pose;
        self.compare_from(&pose);
        let law = self.law.targets(&pose, &mut self.remembered);
        for (motor, (law, steps)) in self.motors.iter_mut().zip(law.0.into_iter().zip(steps.0)) {
            let now = &mut motor.now;
            let count = i64::from(steps);
            now.play.shift(steps.wrapping_sub((now.target >> 32) as i32));
            now.target = if law >> 32 == count { law } else { (count << 32) + HALF };
            now.position = now.target + (i64::from(now.play.overlay()) << 32);
            now.emitter.set_count((now.position >> 32) as i32);
        }
        self.moving = 0;
        self.look_at_motors();
        // what is still to be played is silence: reports and an abort in it speak of the new counts
        for motor in &mut self.motors {
            motor.starts = [motor.now; HISTORY];
        }
        for start in &mut self.history {
            start.flags = self.flags;
        }
    }

    /// Takes orders and reports, while nothing plays and no segment is made.
    pub fn attend(&mut self, orders: &mut impl Orders, report: &mut Report) {
        if orders.peek().is_some() {
            self.take_orders(orders);
        }
        self.tell(self.segment, report);
    }
}
