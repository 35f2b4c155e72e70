//! A bench on which something goes wrong at a moment that a test names.
#![allow(dead_code)] // each test file uses its part

use host_sim::alignment::{Bus, BusError, Controller, Lab};
use host_sim::bench_twin::{self, Bench, Sees, Side};
use host_sim::machine::Machine;
use host_sim::optics::Burst;
use std::sync::Mutex;

/// Virtual time between two looks at whether it is time, s.
const LOOK_S: f64 = 0.004;

/// Stages that were measured, with what their controllers believe since.
static KNOWN: Mutex<Vec<([Machine; 2], [Machine; 2])>> = Mutex::new(Vec::new());

/// What the controllers of a bench believe; the same stages are measured once.
fn calibrated(bench: &Bench) -> [Machine; 2] {
    let truth = Side::BOTH.map(|side| bench.machine(side).clone());
    let known = KNOWN.lock().unwrap().iter().find(|(is, _)| *is == truth).map(|(_, believed)| believed.clone());
    known.unwrap_or_else(|| {
        let believed = Side::BOTH.map(|side| bench.calibrated(side).expect("a stage that can be measured").machine);
        KNOWN.lock().unwrap().push((truth, believed.clone()));
        believed
    })
}

/// One after the other on each core, with stacks of their own: boards are large.
pub fn on_each<T: Send>(seeds: Vec<u64>, work: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let (queue, results) = (Mutex::new(seeds.into_iter()), Mutex::new(Vec::new()));
    let worker = || {
        loop {
            // the queue is free again before the work begins
            let seed = queue.lock().unwrap().next();
            let Some(seed) = seed else { return };
            let result = work(seed);
            results.lock().unwrap().push(result);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            std::thread::Builder::new().stack_size(16 << 20).spawn_scoped(scope, worker).unwrap();
        }
    });
    results.into_inner().unwrap()
}

/// Something that happens: true when it has.
type Event = Box<dyn FnMut(&mut Lab) -> bool>;

/// A bench with what will happen to it.
pub struct Haunted {
    pub lab: Lab,
    events: Vec<Event>,
}

impl Haunted {
    pub fn new(seed: u64, options: &bench_twin::Options) -> Self {
        let bench = Bench::seeded(seed, options);
        let calibrated = calibrated(&bench);
        Haunted { lab: Lab::new(bench, &calibrated, seed).expect("a calibration that is taken"), events: Vec::new() }
    }

    pub fn when(mut self, event: impl FnMut(&mut Lab) -> bool + 'static) -> Self {
        self.events.push(Box::new(event));
        self
    }

    /// At a time, s.
    pub fn at(self, seconds: f64, mut happens: impl FnMut(&mut Lab) + 'static) -> Self {
        self.when(move |lab| {
            let now = lab.seconds() >= seconds;
            if now {
                happens(lab);
            }
            now
        })
    }

    fn look_around(&mut self) {
        self.events.retain_mut(|event| !event(&mut self.lab));
    }

    /// Nothing has touched, no motor turns, all steps of both sides are as counted, and both links answer.
    pub fn is_well(&mut self) {
        assert_eq!(self.lab.bench().collision(), None);
        let counts = |lab: &mut Lab| Side::BOTH.map(|side| lab.board(side).twin().motors());
        let before = counts(&mut self.lab);
        self.lab.pause(0.3).unwrap();
        assert_eq!(counts(&mut self.lab), before, "at rest");
        for side in Side::BOTH {
            let board = self.lab.board(side);
            assert_eq!(board.twin().motors(), board.front.motor_counts());
            assert!(!board.front.operation_pending() && !board.front.is_scanning());
            assert!(Controller::new(&mut self.lab, side).ask("*IDN?").unwrap().contains("Stage Controller"));
            let errors = Controller::new(&mut self.lab, side).ask("SYST:ERR:COUN?").unwrap();
            assert_eq!(errors, "0", "{side:?}");
        }
    }

    /// Least distance of the corners of both sides from the chip, um.
    pub fn clearances_um(&self) -> [f64; 2] {
        let (tick, poses) = (self.lab.tick(), self.lab.poses());
        Side::BOTH.map(|side| self.lab.bench().clearance_um(side, tick, &poses[side.index()]))
    }

    pub fn at_side(&mut self, side: Side) -> Controller<'_, Haunted> {
        Controller::new(self, side)
    }
}

/// Both channels of the meter are so noisy (dB) for some time.
pub fn noisy(lab: &mut Lab, seconds: f64, noise_db: f64) {
    let from = lab.tick();
    let burst = Burst { from, until: from + (seconds * 1e6) as u64, noise_db };
    [0, 1].into_iter().for_each(|channel| lab.bench_mut().disturb(channel, Some(burst)));
}

impl Bus for Haunted {
    fn send(&mut self, side: Side, message: &str) -> Result<(), BusError> {
        self.look_around();
        self.lab.send(side, message)
    }

    fn send_block(&mut self, side: Side, message: &str, block: &[u8]) -> Result<(), BusError> {
        self.lab.send_block(side, message, block)
    }

    fn line(&mut self, side: Side, message: &str, patience_s: f64) -> Result<String, BusError> {
        let until = self.seconds() + patience_s;
        loop {
            self.look_around();
            match self.lab.line(side, message, LOOK_S) {
                Err(BusError::Silent { .. }) if self.seconds() < until => {}
                Err(BusError::Silent { side, message, .. }) => {
                    return Err(BusError::Silent { side, message, seconds: patience_s });
                }
                other => return other,
            }
        }
    }

    fn look(&mut self, channel: usize, sees: Sees) {
        self.lab.look(channel, sees);
    }

    fn seconds(&self) -> f64 {
        self.lab.seconds()
    }

    fn pause(&mut self, seconds: f64) -> Result<(), BusError> {
        self.look_around();
        self.lab.pause(seconds)
    }
}
