//! Orders on their way to the generator, kept small: what is large is put in when the order is handed out.
//!
//! A track stays in its slot of the planner until it is answered; the law and the pulses are those in force, of which
//! an anchor or silence follows each change.

use super::Front;
use crate::compensation::backlash::{Flank, PlayConfig};
use crate::refill::border::{Action, Order};
use crate::units::{MotorSteps, Pose};

/// An action that waits, see [`Action`].
#[derive(Clone, Copy, Debug)]
pub(super) enum Waiting {
    Run { slot: u8 },
    Law,
    Anchor { pose: Pose, steps: MotorSteps },
    Play { motor: u8, config: PlayConfig },
    Flank { motor: u8, flank: Option<Flank> },
    Rest { motor: u8, flank: Option<Flank>, overlay: i32 },
    Pulses,
    Compare,
}

/// An order that waits, see [`Order`].
#[derive(Clone, Copy, Debug)]
pub(super) struct WaitingOrder {
    pub sequence: u16,
    pub segment: Option<u64>,
    pub aborts: u16,
    pub action: Waiting,
}

impl Front {
    /// The next order for the generator.
    pub fn next_order(&mut self) -> Option<Order> {
        loop {
            let WaitingOrder { sequence, segment, aborts, action } = self.orders.pop_front()?;
            let action = match action {
                Waiting::Run { slot } => match self.planner.on_its_way(slot, sequence) {
                    Some(track) => Action::Run { slot, track: *track },
                    // an immediate stop has forgotten it
                    None => continue,
                },
                Waiting::Law => Action::Law(self.capability.law),
                Waiting::Anchor { pose, steps } => Action::Anchor { pose, steps },
                Waiting::Play { motor, config } => Action::Play { motor, config },
                Waiting::Flank { motor, flank } => Action::Flank { motor, flank },
                Waiting::Rest { motor, flank, overlay } => Action::Rest { motor, flank, overlay },
                Waiting::Pulses => Action::Pulses(self.timing),
                Waiting::Compare => Action::Compare(self.comparing.wanted),
            };
            return Some(Order { sequence, segment, aborts, action });
        }
    }
}
