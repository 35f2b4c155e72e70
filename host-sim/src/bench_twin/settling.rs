//! The stage creeps behind its motors a little: a share of every motion follows exponentially.

/// How a stage settles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettlingOptions {
    /// Share of a motion that comes late; 0 is a stiff stage.
    pub share: f64,
    /// Time constant with which it comes, us.
    pub time_us: f64,
}

impl Default for SettlingOptions {
    /// One hundredth, 3 ms: 10 nm behind just after a step of 1 um, 30 us behind in motion.
    fn default() -> Self {
        SettlingOptions { share: 0.01, time_us: 3000.0 }
    }
}

/// What of the motion of one stage has not come yet.
#[derive(Clone, Debug, Default)]
pub(super) struct Settling {
    /// Pose of the last call, nm and nrad.
    last: [f64; 6],
    missing: [f64; 6],
}

impl Settling {
    /// The stage has stood at a pose for long.
    pub fn rest(&mut self, pose: [f64; 6]) {
        *self = Settling { last: pose, missing: [0.0; 6] };
    }

    /// The pose that a stage truly has, which `ticks` after the last call would be at `pose` if it were stiff. It moved
    /// evenly meanwhile.
    pub fn follow(&mut self, options: &SettlingOptions, ticks: u64, pose: &[f64; 6]) -> [f64; 6] {
        let time = ticks as f64 / options.time_us;
        let decay = (-time).exp();
        let fresh = if ticks == 0 { options.share } else { options.share * (1.0 - decay) / time };
        std::array::from_fn(|i| {
            self.missing[i] = self.missing[i] * decay + (pose[i] - self.last[i]) * fresh;
            self.last[i] = pose[i];
            pose[i] - self.missing[i]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAGE: SettlingOptions = SettlingOptions { share: 0.02, time_us: 2000.0 };

    fn along(x: f64) -> [f64; 6] {
        [x, 0.0, 0.0, 0.0, 0.0, 0.0]
    }

    #[test]
    fn after_a_step_the_late_share_dies_out_exponentially_however_the_time_is_cut() {
        for cut in [1, 10, 250, 1000, 4000] {
            let mut settling = Settling::default();
            settling.rest(along(500.0));
            assert_eq!(settling.follow(&STAGE, 0, &along(1500.0))[0], 1500.0 - 0.02 * 1000.0);
            let mut now = 0.0;
            for _ in 0..4000 / cut {
                now = settling.follow(&STAGE, cut, &along(1500.0))[0];
            }
            assert!((now - (1500.0 - 20.0 * (-2.0_f64).exp())).abs() < 1e-9, "{cut}: {now}");
        }
    }

    #[test]
    fn in_steady_motion_the_stage_is_late_by_share_times_time() {
        let mut settling = Settling::default();
        let speed = 0.2;
        let mut behind = 0.0;
        for k in 1..200 {
            let at = speed * f64::from(k) * 256.0;
            behind = at - settling.follow(&STAGE, 256, &along(at))[0];
        }
        assert!((behind / speed - 0.02 * 2000.0).abs() < 1e-6, "{behind}");
    }
}
