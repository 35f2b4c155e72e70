//! `host-sim bench`: how fast the simulation is, how much the segment generator costs.

use super::Failure;
use super::common::{board, load, say, say_json};
use crate::board::{Board, Queue};
use crate::machine::Machine;
use crate::session::power_up;
use serde::Serialize;
use stage_controller::controller::front::Front;
use stage_controller::refill::border::Report;
use stage_controller::refill::generator::Generator;
use stage_controller::stepgen::segment::Words;
use stage_controller::units::{AXES, Axis, MotorSteps, SEGMENT_NS, SEGMENT_TICKS};
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// What the simulation is to reach, times real time.
const TARGET: f64 = 300.0;
/// Wanted step rates of every motor, steps per second.
const RATES: [f64; 2] = [100e3, 490e3];
/// Share of a move's travel that is used, so that the curved way of a motor stays inside.
const OF_THE_TRAVEL: f64 = 0.9;
/// Segments between two looks at the motors.
const SAMPLE: u64 = 500;
/// Segments of which instructions are counted.
const COUNTED: u64 = 20_000;
const BENCH: &str = include_str!("../../machines/bench.toml");

/// Measure the speed of the simulation on one thread: six motors moving, all compensation on, twin included.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper`; the built-in machine `bench` by default.
    #[arg(long, value_name = "FILE")]
    machine: Option<PathBuf>,
    /// Print the figures as JSON.
    #[arg(long)]
    json: bool,
    /// Seconds of each measurement.
    #[arg(long, default_value_t = 2.0)]
    seconds: f64,
    /// Run the generator for counting instructions, and nothing else.
    #[arg(long, hide = true, value_name = "STEPS_PER_S")]
    counted: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Figures {
    machine: String,
    target_times_real_time: f64,
    simulation: Vec<Run>,
    generator_alone: Vec<Run>,
    /// Of the refills, at the same rates; empty when not counted.
    instructions: Vec<Instructions>,
    /// Why instructions were not counted.
    instructions_note: Option<String>,
}

/// One measurement.
#[derive(Debug, Default, Serialize)]
struct Run {
    wanted_steps_per_s: f64,
    /// Slowest and fastest motor at the fastest sample of each.
    reached_steps_per_s: [f64; 2],
    /// All motors, ramps included.
    mean_steps_per_s: f64,
    segments: u64,
    steps: u64,
    wall_s: f64,
    /// Time that the thread had a core, where the system tells.
    cpu_s: Option<f64>,
    segments_per_s: f64,
    /// By the wall clock: on a busy machine less than the thread could do.
    times_real_time: f64,
    times_real_time_by_cpu: Option<f64>,
}

/// Wall clock and time on a core, which differ when other programs want the cores too.
#[derive(Clone, Copy, Default)]
pub(super) struct Clocks {
    pub wall_s: f64,
    pub cpu_s: Option<f64>,
}

impl Clocks {
    /// Since some beginning.
    pub fn now(begin: Instant) -> Self {
        let on_core = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
        let ns = on_core.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
        Clocks { wall_s: begin.elapsed().as_secs_f64(), cpu_s: ns.map(|ns| ns * 1e-9) }
    }

    pub fn since(self, before: Clocks) -> Self {
        Clocks {
            wall_s: self.wall_s - before.wall_s,
            cpu_s: self.cpu_s.zip(before.cpu_s).map(|(now, before)| now - before),
        }
    }
}

#[derive(Debug, Serialize)]
struct Instructions {
    wanted_steps_per_s: f64,
    segments: u64,
    steps: u64,
    per_segment: f64,
    per_step: f64,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = match &self.machine {
            Some(path) => load(path)?,
            None => Machine::parse(BENCH).expect("the built-in machine is valid"),
        };
        if let Some(rate) = self.counted {
            let run = generator_alone(&machine, rate, None)?;
            return say(format!("{} {}", run.segments, run.steps));
        }
        let each = |measure: &dyn Fn(f64) -> Result<Run, Failure>| {
            RATES.into_iter().map(measure).collect::<Result<Vec<_>, _>>()
        };
        let counted: Result<Vec<_>, _> =
            RATES.into_iter().map(|rate| count_instructions(self.machine.as_deref(), rate)).collect();
        let (instructions, instructions_note) = match counted {
            Ok(counted) => (counted, None),
            Err(note) => (Vec::new(), Some(note)),
        };
        let figures = Figures {
            machine: machine.name.clone(),
            target_times_real_time: TARGET,
            simulation: each(&|rate| simulation(&machine, rate, self.seconds))?,
            generator_alone: each(&|rate| generator_alone(&machine, rate, Some(self.seconds)))?,
            instructions,
            instructions_note,
        };
        if self.json { say_json(&figures) } else { say(figures) }
    }
}

/// The two ends of a coordinated move through home on which every motor turns at about `rate`.
struct Course {
    ends: [[i64; AXES]; 2],
}

impl Course {
    /// Sets the axes' velocities so that the move runs at the wanted rate, as far as the motors allow.
    fn set_up(front: &mut Front, machine: &Machine, rate: f64) -> Result<Course, Failure> {
        let mut settings = *front.settings();
        for (own, motor) in settings.axes.iter_mut().zip(front.motors()) {
            // the smallest reserve for take-up leaves the most for the move
            own.backlash.velocity = (motor.velocity / 100).max(1);
        }
        let ways = machine.drives.map(|d| d.travel[1].min(-d.travel[0]) / d.step);
        let half = ways.into_iter().fold(f64::MAX, f64::min) * OF_THE_TRAVEL;
        let counts = |sign: f64| {
            let turn = |i: usize| if i.is_multiple_of(2) { sign } else { -sign };
            MotorSteps(std::array::from_fn(|i| (turn(i) * half) as i32))
        };
        let ends = [-1.0, 1.0].map(|sign| front.law().forward(counts(sign)).0.map(i64::from));
        let duration = 2.0 * half / rate;
        for (i, own) in settings.axes.iter_mut().enumerate() {
            let way = (ends[1][i] - ends[0][i]).unsigned_abs() as f64;
            own.velocity = ((way / duration).ceil() as u64).max(1);
        }
        front.set_axes(&settings).map_err(refused)?;
        Ok(Course { ends })
    }
}

fn refused(error: stage_controller::error::Error) -> Failure {
    Failure::Refused(error.to_string())
}

/// Collects what the motors did, from looks at their counts.
struct Tally {
    last: [i32; AXES],
    peak: [f64; AXES],
    steps: u64,
    segments: u64,
}

impl Tally {
    fn new(counts: MotorSteps) -> Self {
        Tally { last: counts.0, peak: [0.0; AXES], steps: 0, segments: 0 }
    }

    fn look(&mut self, counts: MotorSteps, segments: u64) {
        for i in 0..AXES {
            let way = u64::from(counts.0[i].abs_diff(self.last[i]));
            self.steps += way;
            let rate = way as f64 * 1e9 / (segments.max(1) * SEGMENT_NS) as f64;
            if segments == SAMPLE {
                self.peak[i] = self.peak[i].max(rate);
            }
        }
        self.last = counts.0;
        self.segments += segments;
    }

    fn run(self, wanted: f64, spent: Clocks) -> Run {
        let Clocks { wall_s, cpu_s } = spent;
        let virtual_s = (self.segments * SEGMENT_NS) as f64 * 1e-9;
        let of = |pick: fn(f64, f64) -> f64, start| self.peak.into_iter().fold(start, pick);
        Run {
            wanted_steps_per_s: wanted,
            reached_steps_per_s: [of(f64::min, f64::MAX), of(f64::max, 0.0)],
            mean_steps_per_s: self.steps as f64 / AXES as f64 / virtual_s,
            segments: self.segments,
            steps: self.steps,
            wall_s,
            cpu_s,
            segments_per_s: self.segments as f64 / wall_s,
            times_real_time: virtual_s / wall_s,
            times_real_time_by_cpu: cpu_s.map(|cpu_s| virtual_s / cpu_s),
        }
    }
}

/// The whole board: front, generator, ring, hash of the words, twin.
fn simulation(machine: &Machine, rate: f64, seconds: f64) -> Result<Run, Failure> {
    let mut board: Board = board(machine, false)?;
    let course = Course::set_up(&mut board.front, machine, rate)?;
    board.front.pose_absolute(course.ends[0]).map_err(refused)?;
    board.settle();
    let mut tally = Tally::new(board.twin().motors());
    let begin = Instant::now();
    let start = Clocks::now(begin);
    for leg in 1.. {
        board.front.pose_absolute(course.ends[leg % 2]).map_err(refused)?;
        loop {
            let before = board.now();
            let rested = board.run(SAMPLE, |_| ());
            tally.look(board.twin().motors(), board.now() - before);
            if rested {
                break;
            }
        }
        if begin.elapsed().as_secs_f64() >= seconds {
            break;
        }
    }
    Ok(tally.run(rate, Clocks::now(begin).since(start)))
}

/// One refill, a symbol of its own so that its instructions can be counted.
#[inline(never)]
fn counted_refill(generator: &mut Generator, orders: &mut Queue, played: u64, words: &mut Words) -> Report {
    generator.refill(orders, played, words)
}

/// Refills alone: no ring, no hash, no twin, and the front only at the ends of a move. Without `seconds`, as many
/// segments are made as instructions are counted of.
fn generator_alone(machine: &Machine, rate: f64, seconds: Option<f64>) -> Result<Run, Failure> {
    let mut front = power_up(machine, false).map_err(Failure::Refused)?;
    let course = Course::set_up(&mut front, machine, rate)?;
    let (law, timing) = front.generator_setup();
    let mut generator = Generator::new(law, timing);
    let mut orders = Queue::default();
    let mut words: Words = [0; SEGMENT_TICKS];
    let mut tally = None;
    let (begin, mut leg) = (Instant::now(), 0);
    let mut start = Clocks::default();
    let emitted = |generator: &Generator| MotorSteps(std::array::from_fn(|i| generator.emitted(i).0));
    loop {
        if !front.operation_pending() {
            front.pose_absolute(course.ends[leg % 2]).map_err(refused)?;
            leg += 1;
        }
        front.plan();
        while let Some(order) = front.next_order() {
            orders.0.push_back(order);
        }
        let report = generator.refill(&mut orders, front.report().next, &mut words);
        front.receive_report(report);
        let Some(tally) = &mut tally else {
            // the first leg goes from home to an end
            if leg == 2 {
                tally = Some(Tally::new(emitted(&generator)));
                start = Clocks::now(begin);
            }
            continue;
        };
        let mut left = if report.settled || report.moving == 0 { 0 } else { SAMPLE };
        if seconds.is_none() {
            left = left.min(COUNTED - tally.segments);
        }
        if left == SAMPLE {
            let played = report.next;
            let mut last = report;
            for segment in 0..left {
                last = counted_refill(&mut generator, &mut orders, played + segment, &mut words);
            }
            front.receive_report(last);
            tally.look(emitted(&generator), left);
        }
        let done = match seconds {
            Some(seconds) => begin.elapsed().as_secs_f64() - start.wall_s >= seconds,
            None => tally.segments >= COUNTED,
        };
        if done {
            break;
        }
    }
    Ok(tally.expect("a leg was made").run(rate, Clocks::now(begin).since(start)))
}

/// Counts the instructions of the refills with callgrind, in a child of this program.
fn count_instructions(machine: Option<&Path>, rate: f64) -> Result<Instructions, String> {
    let tool = std::env::current_exe().map_err(|error| format!("not counted: {error}"))?;
    let mut child = Command::new("valgrind");
    child.args(["--tool=callgrind", "--callgrind-out-file=/dev/null", "--toggle-collect=*counted_refill*"]);
    child.arg(tool).args(["bench", "--counted", &rate.to_string()]);
    if let Some(machine) = machine {
        child.arg("--machine").arg(machine);
    }
    let output = child.output().map_err(|_| "not counted: needs valgrind (apt install valgrind)".to_string())?;
    let said = String::from_utf8_lossy(&output.stderr);
    let collected = said.lines().find_map(|line| line.split_once("Collected : ")?.1.trim().parse::<u64>().ok());
    let printed = String::from_utf8_lossy(&output.stdout);
    let mut counts = printed.split_whitespace().map_while(|word| word.parse::<u64>().ok());
    match (collected, counts.next(), counts.next()) {
        (Some(collected), Some(segments), Some(steps)) if collected > 0 && steps > 0 => Ok(Instructions {
            wanted_steps_per_s: rate,
            segments,
            steps,
            per_segment: collected as f64 / segments as f64,
            per_step: collected as f64 / steps as f64,
        }),
        _ => Err("not counted: valgrind did not run this program".to_string()),
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = |f: &mut fmt::Formatter<'_>, what: &str, run: &Run| {
            let k = |rate: f64| rate * 1e-3;
            let [slowest, fastest] = run.reached_steps_per_s;
            let by_cpu = run.times_real_time_by_cpu.map_or(String::new(), |times| format!(" ({times:.0} by CPU time)"));
            writeln!(
                f,
                "{what:<16} {:>3.0} k wanted, {:>5.1} to {:>5.1} k reached, {:>5.1} k mean  {:>9.0} segments/s  {:>6.0} x real time{by_cpu}  \
                 ({} steps, {} segments, {:.2} s)",
                k(run.wanted_steps_per_s),
                k(slowest),
                k(fastest),
                k(run.mean_steps_per_s),
                run.segments_per_s,
                run.times_real_time,
                run.steps,
                run.segments,
                run.wall_s
            )
        };
        writeln!(
            f,
            "machine {}: {} motors at once, one thread, all compensation on; rates in steps/s of a motor",
            self.machine,
            Axis::ALL.len()
        )?;
        for run in &self.simulation {
            line(f, "simulation", run)?;
        }
        for run in &self.generator_alone {
            line(f, "generator alone", run)?;
        }
        for i in &self.instructions {
            writeln!(
                f,
                "instructions     {:>3.0} k wanted: {:.1} a step, {:.0} a segment (of this machine, {} steps in {} segments)",
                i.wanted_steps_per_s * 1e-3,
                i.per_step,
                i.per_segment,
                i.steps,
                i.segments
            )?;
        }
        if let [low, high] = self.instructions.as_slice() {
            let steps = high.steps as f64 / high.segments as f64 - low.steps as f64 / low.segments as f64;
            if steps > 1.0 {
                let more = high.per_segment - low.per_segment;
                writeln!(f, "                 {:.1} a further step", more / steps)?;
            }
        }
        if let Some(note) = &self.instructions_note {
            writeln!(f, "instructions     {note}")?;
        }
        writeln!(f, "target           {:.0} x real time with the twin", self.target_times_real_time)
    }
}
