//! Limits of velocity, acceleration and jerk, judged on the unrounded trajectory and on the step edges.

use host_sim::machine::Machine;
use stage_controller::units::{AXES, FineSteps, SEGMENT_NS};

/// Strides in segments over which divided differences are taken.
pub const STRIDES: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Positions kept: more than three of the longest strides.
const KEEP: usize = 128;
/// Length of a segment, s.
const SEGMENT: f64 = SEGMENT_NS as f64 * 1e-9;
const Q32: f64 = 4_294_967_296.0;

/// Divided differences of first to third order of the six motors' trajectories.
///
/// A trajectory whose n-th derivative stays below L has an n-th difference over stride k of at most L k^n,
/// wherever the n + 1 positions lie. On top comes 2^n times the noise of a single position.
pub struct Trajectory {
    ring: [[i64; KEEP]; AXES],
    at: usize,
    filled: usize,
    resting: usize,
    /// Largest allowed differences in Q32 steps: motor, order, stride.
    bounds: Bounds,
    /// Largest ones seen.
    largest: Bounds,
}

impl Trajectory {
    /// Limits of a machine, and the noise of a position of each motor in steps.
    pub fn new(machine: &Machine, noise: [f64; AXES]) -> Self {
        Trajectory {
            ring: [[0; KEEP]; AXES],
            at: 0,
            filled: 0,
            resting: 0,
            bounds: bounds(machine, noise),
            largest: [[[0; STRIDES.len()]; 3]; AXES],
        }
    }

    /// Another law has other noise.
    pub fn set_noise(&mut self, machine: &Machine, noise: [f64; AXES]) {
        self.bounds = bounds(machine, noise);
    }

    /// Forgets the past: after an abort, or when counts and law change.
    pub fn restart(&mut self) {
        (self.filled, self.resting) = (0, 0);
    }

    /// The positions at the end of one more segment; what they violate.
    pub fn push(&mut self, motors: &FineSteps) -> Option<String> {
        let before = self.at;
        if self.filled > 0 && self.ring.iter().zip(&motors.0).all(|(ring, m)| ring[before] == *m) {
            self.resting += 1;
            if self.resting > 3 * STRIDES[STRIDES.len() - 1] {
                return None;
            }
        } else {
            self.resting = 0;
        }
        self.at = (self.at + 1) % KEEP;
        self.filled = (self.filled + 1).min(KEEP);
        let mut found = None;
        for (motor, m) in motors.0.iter().enumerate() {
            self.ring[motor][self.at] = *m;
            let ring = &self.ring[motor];
            let back = |n: usize| ring[(self.at + KEEP - n) % KEEP];
            for (index, k) in STRIDES.into_iter().enumerate() {
                if self.filled <= k {
                    break;
                }
                let (a, b) = (*m, back(k));
                let mut differences = [a - b, 0, 0];
                if self.filled > 2 * k {
                    let c = back(2 * k);
                    differences[1] = a - 2 * b + c;
                    if self.filled > 3 * k {
                        differences[2] = a - 3 * b + 3 * c - back(3 * k);
                    }
                }
                for (n, difference) in differences.into_iter().enumerate() {
                    let size = difference.abs();
                    let largest = &mut self.largest[motor][n][index];
                    *largest = (*largest).max(size);
                    let bound = self.bounds[motor][n][index];
                    if size > bound {
                        {
                            found = Some(format!(
                                "motor {motor}: difference of order {} over {k} segments is {:.6} steps, allowed {:.6} ({:.2} %)",
                                n + 1,
                                size as f64 / Q32,
                                bound as f64 / Q32,
                                100.0 * size as f64 / bound as f64
                            ));
                        }
                    }
                }
            }
        }
        found
    }

    /// Largest used part of the limits over stride 32 (all motors): velocity, acceleration, jerk.
    pub fn used(&self) -> [f64; 3] {
        let last = STRIDES.len() - 1;
        std::array::from_fn(|n| {
            (0..AXES).map(|m| self.largest[m][n][last] as f64 / self.bounds[m][n][last] as f64).fold(0.0, f64::max)
        })
    }
}

type Bounds = [[[i64; STRIDES.len()]; 3]; AXES];

/// Largest allowed differences in Q32 steps.
fn bounds(machine: &Machine, noise: [f64; AXES]) -> Bounds {
    let mut bounds = [[[0; STRIDES.len()]; 3]; AXES];
    for ((motor, drive), noise) in bounds.iter_mut().zip(&machine.drives).zip(noise) {
        let rates = [drive.velocity, drive.acceleration, drive.jerk];
        for (n, (order, rate)) in motor.iter_mut().zip(rates).enumerate() {
            let power = n as i32 + 1;
            for (bound, k) in order.iter_mut().zip(STRIDES) {
                let limit = rate / drive.step * (SEGMENT * k as f64).powi(power);
                *bound = ((limit + noise * f64::from(1 << power)) * Q32) as i64;
            }
        }
    }
    bounds
}

/// Step edges: in any window of N ticks at most v N + 1 net steps, for every N at once.
///
/// The largest excess over all windows that end with the present step follows from the one before
/// (Kadane's recurrence), so all N are checked at the cost of one addition a step.
#[derive(Clone, Copy, Default)]
pub struct StepRate {
    /// Allowed steps per tick, Q32.
    rate: i64,
    /// The one step that every window may hold, and what rounding to the grid moves into it, Q32.
    most: i64,
    last: u64,
    /// Steps less the allowed ones in the worst window, Q32: upwards, downwards.
    level: [i64; 2],
}

impl StepRate {
    /// At a limit in steps per second, on a grid in ticks: a step may come up to a grid less a tick early.
    pub fn new(steps_per_second: f64, grid: u64) -> Self {
        let rate = (steps_per_second * Q32 / 1e6).ceil() as i64;
        StepRate { rate, most: (1 << 32) + rate * (grid as i64 - 1), ..StepRate::default() }
    }

    /// One more edge; how far it lies above v N + 1, in steps, if it does.
    pub fn step(&mut self, tick: u64, sign: i64) -> Option<f64> {
        let decay = (tick - self.last).min(1 << 20) as i64 * self.rate;
        self.last = tick;
        let mut worst = 0;
        for (level, sign) in self.level.iter_mut().zip([sign, -sign]) {
            let one = sign << 32;
            *level = (*level + one - decay).max(one - self.rate).max(-self.rate);
            worst = worst.max(*level);
        }
        (worst > self.most).then(|| (worst - self.most) as f64 / Q32)
    }
}
