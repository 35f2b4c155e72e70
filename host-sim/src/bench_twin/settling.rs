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
