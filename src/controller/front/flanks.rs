//! Flanks of the motors: homed, or taken up on command.

use super::Front;
use super::orders::Waiting;
use crate::compensation::backlash::Flank;
use crate::error::Error;
use crate::units::{AXES, Axis, Pose};

/// A take-up on command, on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Preload {
    /// Away from the wanted flank.
    Away { axis: Axis, flank: Flank, away: Pose, back: Pose },
    /// Back onto it.
    Back,
}

impl Front {
    /// Homed at zero on the reference flank, enabled: how host-sim begins.
    pub fn assume_homed(&mut self) {
        self.homed = [true; AXES];
        self.enabled = [true; AXES];
        self.uncertain = [false; AXES];
        for motor in 0..AXES as u8 {
            let _ = self.order(Waiting::Flank { motor, flank: Some(Flank::Positive) });
        }
        self.refresh();
    }

    /// Takes up the play of a motor towards a flank by moving away from it and back; afterwards it is known.
    ///
    /// # Errors
    /// 103 while the emergency stop is latched, 104 while moving, 108 disabled, 102 towards an active switch, -222 when
    /// the way leaves the travel.
    pub fn preload(&mut self, axis: Axis, flank: Flank) -> Result<(), Error> {
        self.armed()?;
        self.standstill()?;
        let i = axis.index();
        let back = self.commanded();
        let mut steps = self.capability.law.steps(back);
        steps.0[i] = steps.0[i].wrapping_sub(flank.sign().wrapping_mul(self.clearance(axis)));
        let away = self.capability.law.forward(steps);
        self.planner.check(&self.capability, back, away)?;
        self.check_switches(away)?;
        self.planner.go(away, None);
        self.preload = Some(Preload::Away { axis, flank, away, back });
        Ok(())
    }

    pub(super) fn continue_preload(&mut self) {
        let at_rest = !self.planner.is_moving() && self.report.settled && self.report.answered == self.sequence;
        match self.preload {
            Some(Preload::Away { away, .. }) if at_rest && self.planner.rest().rounded() != away => self.preload = None,
            Some(Preload::Away { axis, flank, back, .. }) if at_rest => {
                // having come this far, it rests on the other flank for certain
                let known = Waiting::Flank { motor: axis.index() as u8, flank: Some(flank.opposite()) };
                if self.order(known).is_ok() {
                    self.planner.go(back, None);
                    self.preload = Some(Preload::Back);
                }
            }
            Some(Preload::Back) if at_rest => self.preload = None,
            _ => {}
        }
    }
}
