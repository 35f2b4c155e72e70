//! `host-sim trace`: the pins of a session as a VCD file, for a logic analyser's viewer.

use super::Failure;
use super::common::{board, load};
use crate::board::{Board, Played};
use crate::twin::{DIR_PINS, STEP_PINS, after_word};
use stage_controller::units::decimal::{Unit, parse};
use stage_controller::units::{AXES, Axis, SEGMENT_TICKS};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use vcd::{IdCode, SimulationCommand, TimescaleUnit, Value, Writer};

/// What is traced without a script: a coordinated move, a reversal with its take-up, a stop on the way.
const DEMO: &str = "\
POSE 20,-10,5,0.1,-0.1,0.05
*WAI
AXIS1:MOVE 15
*WAI
AXIS2:MOVE 400
*WAI
POSE 0,0,0,0,0,0
*WAI
";

/// Write the STEP and DIR lines of a session as a VCD file, one unit of time a tick of 1 us.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    #[arg(long, value_name = "FILE", default_value = "paper")]
    machine: PathBuf,
    /// Commands, one a line; a built-in demonstration by default.
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// Where the trace is written.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let io = |path: &PathBuf| {
            let path = path.display().to_string();
            move |source| Failure::Io { path, source }
        };
        let machine = load(&self.machine)?;
        let script = match &self.script {
            Some(path) => std::fs::read_to_string(path).map_err(io(path))?,
            None => DEMO.into(),
        };
        let commands = read_script(&script)?;
        let mut board = board(&machine)?;
        let file = BufWriter::new(File::create(&self.output).map_err(io(&self.output))?);
        let mut trace = Trace::new(file, board.played()).map_err(io(&self.output))?;
        for command in commands {
            command.carry_out(&mut board, &mut trace)?;
        }
        board.run(u64::MAX, |played| trace.segment(&played));
        let edges = trace.end(board.played()).map_err(io(&self.output))?;
        println!("{edges} edges in {} us written to {}", board.now() * SEGMENT_TICKS as u64, self.output.display());
        Ok(())
    }
}

/// What a line of a script asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Command {
    Pose([i64; AXES]),
    Move(Axis, i64),
    StopAll,
    Wait,
}

/// The commands of a script. A stand-in that knows four of the language's headers; the controller's own parser
/// takes its place, and then [`Command`] goes.
fn read_script(script: &str) -> Result<Vec<Command>, Failure> {
    let lines =
        script.lines().map(str::trim).enumerate().filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    lines
        .map(|(number, line)| {
            read_line(line).ok_or_else(|| Failure::Refused(format!("line {}: {line:?} is not understood", number + 1)))
        })
        .collect()
}

fn read_line(line: &str) -> Option<Command> {
    let (header, rest) = line.split_once(' ').unwrap_or((line, ""));
    let number =
        |text: &str, axis: Axis| parse(text.as_bytes(), if axis.is_rotary() { Unit::ANGLE } else { Unit::LENGTH }).ok();
    match (header.to_ascii_uppercase().as_str(), rest.trim()) {
        ("*WAI", "") => Some(Command::Wait),
        ("STOP", "") => Some(Command::StopAll),
        ("POSE", rest) => {
            let numbers = rest.split(',').zip(Axis::ALL).map(|(text, axis)| number(text, axis));
            let pose: Vec<_> = numbers.collect::<Option<_>>()?;
            (rest.split(',').count() == AXES).then_some(())?;
            Some(Command::Pose(pose.try_into().ok()?))
        }
        (header, rest) => {
            let axis: usize = header.strip_prefix("AXIS")?.strip_suffix(":MOVE")?.parse().ok()?;
            let axis = Axis::from_index(axis.checked_sub(1)?)?;
            Some(Command::Move(axis, number(rest, axis)?))
        }
    }
}

impl Command {
    /// Motion is overlapped: only `*WAI` lets time pass, and every command the segment in which it is seen.
    fn carry_out<W: Write>(self, board: &mut Board, trace: &mut Trace<W>) -> Result<(), Failure> {
        let refused = |error: stage_controller::error::Error| Failure::Refused(error.to_string());
        match self {
            Command::Pose(pose) => board.front.pose_absolute(pose).map_err(refused)?,
            Command::Move(axis, to) => board.front.move_absolute(axis, to).map_err(refused)?,
            Command::StopAll => board.front.stop_all(),
            Command::Wait => {
                board.run(u64::MAX, |played| trace.segment(&played));
                return Ok(());
            }
        }
        board.step(|played| trace.segment(&played));
        Ok(())
    }
}

/// A VCD file in the making. The first write that fails ends it; [`Trace::end`] answers why.
struct Trace<W: Write> {
    writer: Writer<W>,
    wires: Vec<(u32, IdCode)>,
    lines: u32,
    /// The segment at which time begins.
    origin: u64,
    edges: u64,
    failed: Option<io::Error>,
}

impl<W: Write> Trace<W> {
    fn new(file: W, origin: u64) -> io::Result<Self> {
        let mut writer = Writer::new(file);
        writer.timescale(1, TimescaleUnit::US)?;
        writer.add_module("stage")?;
        let mut wires = Vec::new();
        for axis in Axis::ALL {
            for (signal, pins) in [("STEP", STEP_PINS), ("DIR", DIR_PINS)] {
                let wire = writer.add_wire(1, &format!("{signal}_{}", axis.name()))?;
                wires.push((1 << pins[axis.index()], wire));
            }
        }
        writer.upscope()?;
        writer.enddefinitions()?;
        writer.timestamp(0)?;
        writer.begin(SimulationCommand::Dumpvars)?;
        for (_, wire) in &wires {
            writer.change_scalar(*wire, Value::V0)?;
        }
        writer.end()?;
        Ok(Trace { writer, wires, lines: 0, origin, edges: 0, failed: None })
    }

    /// The words of a segment as they play.
    fn segment(&mut self, played: &Played<'_>) {
        if self.failed.is_none() {
            self.failed = self.write(played).err();
        }
    }

    fn write(&mut self, played: &Played<'_>) -> io::Result<()> {
        let base = (played.segment - self.origin) * SEGMENT_TICKS as u64;
        for (tick, word) in (base..).zip(played.words) {
            let next = after_word(self.lines, *word);
            let changed = next ^ self.lines;
            self.lines = next;
            let mut stamped = false;
            for (line, wire) in self.wires.iter().filter(|(line, _)| changed & line != 0) {
                if !stamped {
                    self.writer.timestamp(tick)?;
                    stamped = true;
                }
                self.writer.change_scalar(*wire, next & line != 0)?;
                self.edges += 1;
            }
        }
        Ok(())
    }

    /// Closes the file after the words of the segments before `end`; answers the edges written.
    fn end(mut self, end: u64) -> io::Result<u64> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        self.writer.timestamp((end - self.origin) * SEGMENT_TICKS as u64)?;
        self.writer.flush()?;
        Ok(self.edges)
    }
}
