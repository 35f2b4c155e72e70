//! What must hold in every segment, whatever was commanded.

use super::rates::{StepRate, Trajectory};
use host_sim::board::{Board, Played};
use host_sim::machine::Machine;
use host_sim::twin::{Limits, Timing, after_word};
use stage_controller::stepgen::pins::{DIR_PINS, STEP_PINS};
use stage_controller::units::{AXES, MotorSteps};

/// Counts remembered by segments played, for late reports.
const REMEMBERED: usize = 64;

/// Observes the words and the unrounded trajectory of a board.
pub struct Checker {
    timing: Timing,
    pub trajectory: Trajectory,
    rates: [StepRate; AXES],
    /// Own decoder of the words.
    lines: u32,
    tick: u64,
    counts: [i32; AXES],
    offset: [i32; AXES],
    seen: [(u64, [i32; AXES]); REMEMBERED],
    step_nm: [f64; AXES],
    travel: [[f64; 2]; AXES],
    /// Segments and steps checked.
    pub segments: u64,
    pub steps: u64,
    /// The trajectory is not continuous now: an abort, or a change of counts or law.
    pub jumps: bool,
    /// First thing found wrong.
    pub wrong: Option<String>,
}

impl Checker {
    /// For a machine, with minimum times in ticks: high, low, set-up, hold.
    pub fn new(machine: &Machine, noise: [f64; AXES], times: [u64; 4]) -> Self {
        let [high, low, setup, hold] = times;
        Checker {
            timing: Timing::new([Limits { high, low, setup, hold }; AXES]),
            trajectory: Trajectory::new(machine, noise),
            rates: machine.drives.map(|d| StepRate::new(d.velocity / d.step, high.max(low).next_power_of_two())),
            lines: 0,
            tick: 0,
            counts: [0; AXES],
            offset: [0; AXES],
            seen: [(u64::MAX, [0; AXES]); REMEMBERED],
            step_nm: machine.drives.map(|d| d.step),
            travel: machine.drives.map(|d| d.travel),
            segments: 0,
            steps: 0,
            jumps: true,
            wrong: None,
        }
    }

    fn fail(&mut self, what: impl FnOnce() -> String) {
        if self.wrong.is_none() {
            self.wrong = Some(what());
        }
    }

    /// What a board has played.
    pub fn played(&mut self, played: &Played<'_>) {
        self.segments += 1;
        self.timing.feed(played.words);
        self.decode(played.words);
        self.seen[(played.segment + 1) as usize % REMEMBERED] = (played.segment + 1, self.counts);
        match played.motor {
            Some(motor) if !self.jumps => {
                if let Some(what) = self.trajectory.push(&motor) {
                    self.fail(|| what);
                }
                for m in 0..AXES {
                    let apart = ((motor.0[m] >> 32) as i32).wrapping_sub(self.counts[m] + self.offset[m]);
                    if apart.abs() > 1 {
                        self.fail(|| format!("motor {m}: {apart} steps wait"));
                    }
                }
            }
            _ => self.trajectory.restart(),
        }
    }

    fn decode(&mut self, words: &[u32]) {
        for chunk in words.chunks(16) {
            let any = chunk.iter().fold(0, |any, word| any | word);
            if any & 0xffff == 0 {
                self.lines &= !(any >> 16);
                self.tick += chunk.len() as u64;
                continue;
            }
            for &word in chunk {
                let next = after_word(self.lines, word);
                let rising = next & !self.lines;
                self.lines = next;
                if rising != 0 {
                    for m in 0..AXES {
                        if rising >> STEP_PINS[m] & 1 != 0 {
                            let sign = if next >> DIR_PINS[m] & 1 == 1 { 1 } else { -1 };
                            self.counts[m] += sign;
                            self.steps += 1;
                            if let Some(over) = self.rates[m].step(self.tick, i64::from(sign)) {
                                self.fail(|| format!("motor {m}: {over:.6} steps above v N + 1 in some window"));
                            }
                        }
                    }
                }
                self.tick += 1;
            }
        }
    }

    /// The state of the two halves after a step of the board.
    pub fn after(&mut self, board: &Board) {
        let generator = board.generator();
        let motors = generator.motor_positions();
        for m in 0..AXES {
            let (emitted, waiting) = generator.emitted(m);
            if emitted + waiting != (motors.0[m] >> 32) as i32 {
                self.fail(|| format!("motor {m}: emitted {emitted} + {waiting} is not the floor"));
            }
        }
        if board.twin().motors().0 != self.counts {
            self.fail(|| "the twin counts otherwise".into());
        }
        let report = board.front.report();
        let (played, counts) = self.seen[report.played as usize % REMEMBERED];
        if played == report.played && !self.jumps {
            let own: [i32; AXES] = std::array::from_fn(|m| counts[m] + self.offset[m]);
            if report.counts.0 != own {
                self.fail(|| format!("reported counts {:?}, edges {own:?}", report.counts.0));
            }
        }
        if let Some((m, v)) = self
            .timing
            .violations()
            .iter()
            .enumerate()
            .find(|(_, v)| v.total() != 0)
            .filter(|_| self.segments.is_multiple_of(64))
        {
            let v = *v;
            self.fail(|| format!("motor {m}: {v:?}"));
        }
        if !self.jumps {
            self.travel(report.steps);
        }
    }

    fn travel(&mut self, steps: MotorSteps) {
        for m in 0..AXES {
            let at = f64::from(steps.0[m]) * self.step_nm[m];
            let [low, high] = self.travel[m];
            if at < low - 1.01 * self.step_nm[m] || at > high + 1.01 * self.step_nm[m] {
                self.fail(|| format!("motor {m} at {at} beyond its travel {low}..{high}"));
            }
        }
    }

    /// At rest, counts or law have been changed: the edges are counted from here on.
    pub fn anchor(&mut self, counts: MotorSteps) {
        self.offset = std::array::from_fn(|m| counts.0[m] - self.counts[m]);
        self.jumps = false;
        self.trajectory.restart();
    }

    /// At rest: what was counted is what the controller says.
    pub fn at_rest(&mut self, counts: MotorSteps) {
        let own: [i32; AXES] = std::array::from_fn(|m| self.counts[m] + self.offset[m]);
        if counts.0 != own {
            self.fail(|| format!("at rest the counts are {:?}, edges {own:?}", counts.0));
        }
        let violations = self.timing.violations();
        if violations.iter().any(|v| v.total() != 0) {
            self.fail(|| format!("timing: {violations:?}"));
        }
    }
}
