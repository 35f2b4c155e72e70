//! A board whose power inputs see a Gaussian spot at its true fibre point.
#![allow(dead_code)] // each test file uses its part

use host_sim::board::{Board, Interleaving, Played, Seeded};
use host_sim::console::Console;
use host_sim::machine::Machine;
use host_sim::session::power_up;
use std::collections::VecDeque;

/// What the inputs see.
#[derive(Clone, Debug)]
pub struct Spot {
    /// Where the light is, nm in x, y, z.
    pub at: [f64; 3],
    /// 1/e^2 half width in x, y, and a long one in z, nm: 4.343 (d/w)^2 dB.
    pub width: [f64; 3],
    /// Level at the middle, dBm.
    pub top: f64,
    /// Standard deviation of a sample, dB.
    pub noise: f64,
    /// Every so many samples one is a burst of this many dB, 0: none.
    pub bursts: (u64, f64),
    /// Samples by which the meter is late.
    pub late: usize,
    /// An angle that the light depends on: index of the axis, where it is greatest and 1/e^2 half width, nrad.
    pub tilt: Option<(usize, f64, f64)>,
}

impl Spot {
    pub fn new(at: [f64; 3]) -> Self {
        Spot { at, width: [5000.0, 5000.0, 500_000.0], top: 0.0, noise: 0.003, bursts: (0, 0.0), late: 0, tilt: None }
    }
}

/// A board with one link, in front of a spot.
pub struct Bench {
    pub console: Console,
    pub spot: Spot,
    random: Seeded,
    waiting: VecDeque<f64>,
    /// Called with what is played.
    pub samples: u64,
}

impl Bench {
    pub fn new(spot: Spot, seed: u64) -> Self {
        Bench::of(&Machine::paper(), spot, seed, Interleaving::Jittered(3))
    }

    pub fn of(machine: &Machine, spot: Spot, seed: u64, interleaving: Interleaving) -> Self {
        let mut board = Board::new(machine, power_up(machine, false).unwrap(), interleaving, seed);
        assert!(board.settle());
        let random = Seeded::new(seed ^ 0x11);
        let mut bench = Bench { console: Console::new(board), spot, random, waiting: VecDeque::new(), samples: 0 };
        bench.run(20);
        bench
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64).sum::<f64>() - 6.0
    }

    /// Level of the light where the stage truly is, dBm, without noise.
    pub fn level(&self) -> f64 {
        let pose = self.console.board.twin().true_pose();
        let part = |i: usize| ((pose[i] - self.spot.at[i]) / self.spot.width[i]).powi(2);
        let tilt = self.spot.tilt.map_or(0.0, |(axis, at, width)| ((pose[axis] - at) / width).powi(2));
        self.spot.top - 4.342_944_819 * (part(0) + part(1) + part(2) + tilt)
    }

    /// One segment; what is answered meanwhile.
    pub fn step(&mut self, observe: impl FnMut(Played<'_>)) -> Vec<u8> {
        let answer = self.console.step(observe);
        self.waiting.push_back(self.level());
        while self.waiting.len() > self.spot.late + 1 {
            self.waiting.pop_front();
        }
        let mut level = self.waiting[0];
        self.samples += 1;
        level += self.spot.noise * self.normal();
        if self.spot.bursts.0 > 0 && self.samples.is_multiple_of(self.spot.bursts.0) {
            level += self.spot.bursts.1;
        }
        // 1 mW a volt, 3.3 V are 32768
        let code = (10f64.powf(level / 10.0) / 3.3 * 32768.0).round().clamp(0.0, 32760.0) as u16;
        self.console.board.set_power([code, code / 2]);
        answer
    }

    pub fn run(&mut self, segments: u64) {
        (0..segments).for_each(|_| drop(self.step(|_| ())));
    }

    /// Sends a line and waits for what it answers.
    pub fn line(&mut self, line: &str) -> String {
        let mut answer = self.console.exchange(format!("{line}\n").as_bytes());
        if line.contains('?') {
            for n in 0.. {
                if answer.ends_with(b"\n") {
                    break;
                }
                assert!(n < 1_000_000, "{line} is not answered");
                answer.extend(self.step(|_| ()));
            }
        }
        String::from_utf8_lossy(&answer).trim_end().to_owned()
    }

    /// Sends a line that must raise no error.
    pub fn good(&mut self, line: &str) -> String {
        let answer = self.line(line);
        let error = self.line("SYST:ERR?");
        assert!(error.starts_with("0,"), "{line}: {error}");
        answer
    }

    /// Numbers of a result.
    pub fn result(&mut self, id: u8) -> Outcome {
        let text = self.line(&format!("SCAN:RES? {id}"));
        let values: Vec<f64> = text.split(',').map(|x| x.parse().unwrap_or_else(|_| panic!("{text}"))).collect();
        let axes = values[3..].chunks(3).map(|axis| [axis[0], axis[1], axis[2]]).collect();
        Outcome { status: values[0] as u16, samples: values[1] as u32, level: values[2], axes }
    }

    /// Runs a scan to its end.
    pub fn scan(&mut self, id: u8) -> Outcome {
        self.good(&format!("SCAN:STAR {id}"));
        assert_eq!(self.line("*OPC?"), "1");
        self.result(id)
    }

    /// True x, y, z of the fibre point, nm.
    pub fn truth(&self) -> [f64; 3] {
        let pose = self.console.board.twin().true_pose();
        [pose[0], pose[1], pose[2]]
    }

    /// The oldest error.
    pub fn error(&mut self) -> String {
        self.line("SYST:ERR?")
    }

    /// Uniform between two numbers.
    pub fn between(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// A result as the controller tells it: um.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub status: u16,
    pub samples: u32,
    pub level: f64,
    /// Of each axis: peak, its uncertainty, where it ended.
    pub axes: Vec<[f64; 3]>,
}

pub const DONE_WITH_PEAK: u16 = 1 | 2 | 4;
