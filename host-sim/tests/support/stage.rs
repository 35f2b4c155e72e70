//! A board with its checker, and the words to drive it.

use super::checker::Checker;
use host_sim::board::{Board, Interleaving, RING, Seeded};
use host_sim::machine::Machine;
use host_sim::session::power_up;
use stage_controller::compensation::law::{Law, Remembered};
use stage_controller::error::{Error, ErrorNumber};
use stage_controller::settings::Settings;
use stage_controller::units::{AXES, Axis, Pose};
use std::collections::VecDeque;

/// Segments after which a move that has not ended counts as hanging: half an hour.
const HANGS: u64 = 7_000_000;
/// Segments after which a slow move is made faster: two and a half minutes.
const PATIENCE: u64 = 600_000;

/// How far rounding may put an unrounded target from the smooth law, in steps of each motor, from the widths of the
/// numbers: per screw the sine in Q33 (one and a half units), angles in 1/16 nrad, versines in Q34, each times the
/// lever, and levers in 1/16 nm and cross products in 1/8 nm times the sine of 7.69 degrees; three screws, rows of at most 1.1;
/// coordinates in 2^-16 nm. At short strides this is far more than the limits; from 16 segments on, a few percent.
pub fn noise(machine: &Machine, law: &Law) -> [f64; AXES] {
    let lever = law.lever_nm() as f64;
    let screw = lever * (1.5 / 2f64.powi(33) + 0.5 / 16e9 + 0.5 / 2f64.powi(34)) + 0.02;
    let pivot = if lever > 0.0 { 3.3 * screw } else { 0.0 };
    std::array::from_fn(|i| {
        let units = if i < 3 { pivot + 1.0 / 16_384.0 } else { 2e-3 };
        units / machine.drives[i].step + 1.0 / 65_536.0
    })
}

/// A board under watch.
pub struct Stage {
    pub board: Board,
    pub checker: Checker,
    pub random: Seeded,
    pub machine: Machine,
    pub expected: [Option<i32>; AXES],
    /// Where it stood after the last change of law or counts.
    stood: Pose,
    /// Jogs that ended with an error.
    pub late: u64,
    log: VecDeque<String>,
    name: String,
}

impl Stage {
    /// A homed stage with default settings.
    pub fn new(machine: &Machine, interleaving: Interleaving, seed: u64) -> Self {
        Self::with(machine, interleaving, seed, [1, 1, 3, 3], |_| ())
    }

    /// A homed stage with settings; `times`: what its drivers ask for, in ticks.
    pub fn with(
        machine: &Machine,
        interleaving: Interleaving,
        seed: u64,
        times: [u64; 4],
        change: impl FnOnce(&mut Settings),
    ) -> Self {
        let front = power_up(machine, false).expect("the machine can be calibrated");
        let noise = noise(machine, front.law());
        let mut stage = Stage {
            board: Board::new(machine, front, interleaving, seed),
            checker: Checker::new(machine, noise, times),
            random: Seeded::new(seed ^ 0x5eed),
            machine: machine.clone(),
            expected: [Some(0); AXES],
            stood: Pose::default(),
            late: 0,
            log: VecDeque::new(),
            name: format!("{} {interleaving:?} seed {seed}", machine.name),
        };
        stage.wait_for_anchor();
        let mut settings = *stage.board.front.settings();
        for axis in &mut settings.axes {
            let ns = times.map(|t| t as u32 * 1000);
            axis.timing = stage_controller::stepgen::timing::MotorTiming {
                high_ns: ns[0],
                low_ns: ns[1],
                setup_ns: ns[2],
                hold_ns: ns[3],
            };
        }
        stage.board.front.set_pulses(&settings).expect("pulses");
        change(&mut settings);
        stage.board.front.set_axes(&settings).expect("settings");
        stage.wait_for_anchor();
        stage
    }

    /// Notes what was commanded, for a failure's message.
    pub fn note(&mut self, what: impl FnOnce() -> String) {
        if self.log.len() == 14 {
            self.log.pop_front();
        }
        self.log.push_back(format!("@{} {}", self.board.now(), what()));
    }

    #[cold]
    pub fn fail(&self, what: &str) -> ! {
        let log: Vec<_> = self.log.iter().map(String::as_str).collect();
        let front = &self.board.front;
        panic!(
            "{}: @{} {what}\n  at {:?} of {:?}, motors {:?}, moving {:#b}\n  {}",
            self.name,
            self.board.now(),
            front.position().0,
            front.commanded().0,
            front.report().steps.0,
            front.report().moving,
            log.join("\n  ")
        );
    }

    pub fn expect(&self, holds: bool, what: &str) {
        if !holds {
            self.fail(what);
        }
    }

    /// One segment.
    pub fn step(&mut self) {
        let Stage { board, checker, .. } = self;
        board.step(|played| checker.played(&played));
        checker.after(board);
        if let Some(wrong) = self.checker.wrong.take() {
            self.fail(&wrong);
        }
        if let Some(error) = self.board.front.take_late_error() {
            // a jog is accepted without knowing all of its way, and after one or a stop a path may begin elsewhere
            let jogs = self.log.iter().any(|l| l.contains(" jog ") || l.contains(" stop"));
            if !jogs || error.number != ErrorNumber::DataOutOfRange {
                self.fail(&format!("late error {error:?}"));
            }
            self.late += 1;
            self.expected = [None; AXES];
        }
        if self.board.now().is_multiple_of(32) && !self.checker.jumps {
            self.check_soft_limits();
        }
    }

    /// Some segments.
    pub fn run(&mut self, segments: u64) {
        (0..segments).for_each(|_| self.step());
    }

    fn check_soft_limits(&mut self) {
        let position = self.board.front.position();
        let steps: i64 = self.machine.drives[3..].iter().map(|d| d.step as i64).max().unwrap_or(0);
        for axis in Axis::ALL {
            let i = axis.index();
            let own = &self.board.front.settings().axes[i];
            // half a step of this motor, and what half a step of the rotary ones does to it
            let lever = if i < 3 { steps * self.board.front.law().lever_nm() as i64 / 500_000_000 } else { steps / 50 };
            let room = self.machine.drives[i].step as i64 + 1 + lever;
            let at = i64::from(position.0[i]);
            // a change of law may have left it beyond, without a move
            let lower = i64::from(own.soft_lower).min(self.stood.0[i].into());
            let upper = i64::from(own.soft_upper).max(self.stood.0[i].into());
            if own.soft_on && (at < lower - room || at > upper + room) {
                self.fail(&format!("{axis:?} at {at} beyond {}..{}", own.soft_lower, own.soft_upper));
            }
        }
    }

    /// Until everything has been played and taken up, then checks the rest; segments it took.
    pub fn settle(&mut self) -> u64 {
        let start = self.board.now();
        // a command of this very instant becomes an order with the next step
        loop {
            self.step();
            if !self.board.front.operation_pending() {
                break;
            }
            if self.board.now() - start == PATIENCE {
                // a tenth of the rates at a few percent: right, and too slow to wait for
                self.board.front.set_override(100);
                self.log.push_back(format!("@{} override 100, to see the end", self.board.now()));
            }
            if self.board.now() - start > HANGS {
                self.fail("hangs");
            }
        }
        self.check_rest();
        self.board.now() - start
    }

    /// After an abort, a load or a change of counts: until the front knows where it stands.
    pub fn wait_for_anchor(&mut self) {
        self.checker.jumps = true;
        for n in 0.. {
            self.step();
            if !self.board.front.operation_pending() {
                break;
            }
            self.expect(n < 1000, "the anchor hangs");
        }
        // what was generated before it is still played
        self.run(RING as u64 + 2);
        self.checker.anchor(self.board.front.motor_counts());
        let position = self.board.front.position();
        self.stood = position;
        let noise = noise(&self.machine, self.board.front.law());
        self.checker.trajectory.set_noise(&self.machine, noise);
        self.expect(
            self.board.front.law().steps(position) == self.board.front.report().steps,
            "the forward map does not lead back",
        );
    }

    fn check_rest(&mut self) {
        let front = &self.board.front;
        let report = *front.report();
        self.checker.at_rest(report.counts);
        if let Some(wrong) = self.checker.wrong.take() {
            self.fail(&wrong);
        }
        let generator = self.board.generator();
        for m in 0..AXES {
            let (emitted, waiting) = generator.emitted(m);
            self.expect(waiting == 0 && emitted == report.counts.0[m], "something is still to be played at rest");
            self.expect(report.steps.0[m] + report.overlay[m] == report.counts.0[m], "overlay at rest");
        }
        self.expect(report.moving == 0 && report.taking_up == 0, "moves at rest");
        let commanded = front.commanded();
        for axis in Axis::ALL {
            let i = axis.index();
            if let Some(expected) = self.expected[i]
                && commanded.0[i] != expected
            {
                self.fail(&format!("{axis:?} commanded {} instead of {expected}", commanded.0[i]));
            }
        }
        if self.expected.iter().all(Option::is_some) {
            // bit for bit: nothing is left of the way that it came
            let law = self.board.front.law().motors(&commanded.fine(), &mut Remembered::default());
            let targets = self.board.generator().targets();
            if law != targets || law.floor() != report.final_steps {
                self.fail(&format!("at rest {:?} {targets:?}, the law says {law:?}", report.final_steps));
            }
        }
    }

    /// An accepted or refused command: a refused one changes nothing.
    pub fn refused(&mut self, result: &Result<(), Error>, before: Pose) -> bool {
        if result.is_err() {
            self.expect(self.board.front.commanded() == before, "a refused command changed the target");
        }
        result.is_err()
    }

    /// A number in -most..=most, of any magnitude.
    pub fn any(&mut self, most: i64) -> i64 {
        let bits = 64 - most.leading_zeros() as u64;
        let size = (self.random.next_u64() >> (63 - self.random.below(bits))) as i64 % (most + 1);
        if self.random.below(2) == 0 { size } else { -size }
    }

    /// One of the axes.
    pub fn axis(&mut self) -> Axis {
        Axis::ALL[self.random.below(6) as usize]
    }
}
