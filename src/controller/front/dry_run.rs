//! A move that is only looked at: `POSE:CHECk?`.

use super::Front;
use crate::compensation::backlash::Play;
use crate::compensation::law::Remembered;
use crate::error::Error;
use crate::units::{AXES, Axis, FinePose, Pose, SEGMENT_NS, wide};

/// Samples of a path on which a dry run counts the changes of flank.
const DRY_RUN_SAMPLES: i64 = 200;

/// What `POSE:CHECk?` answers.
#[derive(Clone, Copy, Debug, Default)]
pub struct Check {
    /// Zero, or the error that the move itself would raise.
    pub verdict: Option<Error>,
    /// Duration in us.
    pub duration_us: u64,
    /// Peak step rates, steps per second.
    pub step_rates: [u64; AXES],
    /// Changes of flank.
    pub flank_changes: [u32; AXES],
}

impl Front {
    /// A dry run of a move to a pose from where everything comes to rest.
    pub fn check(&self, target: [i64; AXES]) -> Check {
        let mut check = Check::default();
        if let Err(error) = self.try_check(target, &mut check) {
            check.verdict = Some(error);
        }
        check
    }

    fn try_check(&self, target: [i64; AXES], check: &mut Check) -> Result<(), Error> {
        self.armed()?;
        self.not_homing()?;
        self.not_scanning()?;
        let target = self.homed_pose(target)?;
        let from = self.commanded();
        let over = self.overshoot(from, target);
        let mut plays = [Play::default(); AXES];
        let start = self.capability.law.steps(from);
        for axis in Axis::ALL {
            let i = axis.index();
            plays[i] = Play::resting(start.0[i], Some(self.flank(axis).unwrap_or_default()), 0);
        }
        let mut at = from;
        for leg in [over, Some(target)].into_iter().flatten() {
            let run = self.planner.check(&self.capability, at, leg)?;
            self.check_switches(leg)?;
            check.duration_us += run.segments * SEGMENT_NS / 1000;
            for (rate, new) in check.step_rates.iter_mut().zip(run.step_rates) {
                *rate = (*rate).max(per_second_q44(new));
            }
            self.count_flanks(at, leg, &mut plays, &mut check.flank_changes);
            at = leg;
        }
        Ok(())
    }

    fn count_flanks(&self, from: Pose, to: Pose, plays: &mut [Play; AXES], changes: &mut [u32; AXES]) {
        let mut remembered = Remembered::default();
        for k in 1..=DRY_RUN_SAMPLES {
            let mut pose = FinePose::default();
            for (u, (a, b)) in pose.0.iter_mut().zip(from.0.iter().zip(&to.0)) {
                let (a, b) = (i64::from(*a), i64::from(*b));
                *u = (a << 32)
                    + wide::signed_div(i128::from((b - a) << 32) * i128::from(k), i128::from(DRY_RUN_SAMPLES)) as i64;
            }
            let steps = self.capability.law.targets(&pose, &mut remembered).floor();
            for (i, play) in plays.iter_mut().enumerate() {
                let dead_band = self.settings.axes[i].backlash.dead_band;
                changes[i] += u32::from(play.turn(steps.0[i], dead_band));
            }
        }
    }
}

/// Steps per segment in Q44 to steps per second.
fn per_second_q44(rate: u64) -> u64 {
    (wide::div(u128::from(rate) * 1_000_000_000, u128::from(SEGMENT_NS)) >> 44) as u64
}
