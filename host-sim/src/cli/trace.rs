//! `host-sim trace`: the pins of a session as a VCD file, for a logic analyser's viewer, or word by word.

use super::Failure;
use super::common::{board, load, say, say_bytes};
use crate::board::Played;
use crate::console::Console;
use crate::light::Light;
use crate::twin::after_word;
use stage_controller::stepgen::pins::{DIR_PINS, STEP_PINS};
use stage_controller::units::{Axis, SEGMENT_TICKS};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::PathBuf;
use vcd::{IdCode, SimulationCommand, TimescaleUnit, Value, Writer};

/// What is traced without a script: a coordinated move, a reversal with its take-up, a new target on the way, a stop.
const DEMO: &str = "\
POSE 20,-10,5,0.1,-0.1,0.05
*WAI
AXIS1:MOVE 15
*WAI
AXIS2:MOVE 400
@30
AXIS2:MOVE 200
@30
STOP
*WAI
POSE 0,0,0,0,0,0
*WAI
";

/// Write what the step output plays in a session: its STEP and DIR lines as a VCD file, one unit of time a tick of 1
/// us, or the bare words.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    #[arg(long, value_name = "FILE", default_value = "paper")]
    machine: PathBuf,
    /// Commands, one a line; `@12.5` lets 12.5 ms pass, `@stop open`, `@fault 2 on` happen at the stage, `#` begins a
    /// comment; a built-in demonstration by default.
    #[arg(long, value_name = "FILE")]
    script: Option<PathBuf>,
    /// What the power inputs see (TOML), for each of both a table `[[input]]`: `top`, the sum of eight conversions where
    /// the light is greatest (full scale is 32760), `at`, the six motor counts there, and `fall`, six whole numbers: by
    /// how much the sum is less one count of a motor away, in 2^-20; it grows with the square. In integers, so that
    /// every board computes the same. Dark by default.
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
    /// Like a board after power-up: not homed, disabled.
    #[arg(long)]
    cold: bool,
    /// Where the trace is written.
    #[arg(short, long, value_name = "FILE", required_unless_present = "words")]
    output: Option<PathBuf>,
    /// Where the words are written, one a tick, 32 bits each, little endian, as the board puts them into BSRR.
    #[arg(long, value_name = "FILE")]
    words: Option<PathBuf>,
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
        let light = self.light.as_ref().map(|path| {
            let text = std::fs::read_to_string(path).map_err(io(path))?;
            Light::parse(&text).map_err(|why| Failure::Refused(format!("{}: {why}", path.display())))
        });
        let mut console = Console::new(board(&machine, self.cold)?);
        if let Some(light) = light.transpose()? {
            console.set_light(light);
        }
        let played = console.board.played();
        let mut trace = match &self.output {
            Some(path) => Some(create(path).and_then(|file| Trace::new(file, played)).map_err(io(path))?),
            None => None,
        };
        let mut words = match &self.words {
            Some(path) => Some(Raw { file: create(path).map_err(io(path))?, failed: None }),
            None => None,
        };
        let mut observe = |played: Played<'_>| {
            if let Some(trace) = &mut trace {
                trace.segment(&played);
            }
            if let Some(words) = &mut words {
                words.segment(&played);
            }
        };
        let answers = console.script(&script, &mut observe).map_err(Failure::Refused)?;
        console.settle(&mut observe);
        answers.into_iter().try_for_each(|mut answer| {
            answer.push(b'\n');
            say_bytes(&answer)
        })?;
        let errors = console.line("SYST:ERR:ALL?", observe);
        let board = &console.board;
        if let (Some(trace), Some(path)) = (trace, &self.output) {
            let edges = trace.end(board.played()).map_err(io(path))?;
            say(format!("{edges} edges in {} us written to {}", board.now() * SEGMENT_TICKS as u64, path.display()))?;
        }
        if let (Some(words), Some(path)) = (words, &self.words) {
            words.end().map_err(io(path))?;
        }
        if !errors.starts_with("0,") {
            return Err(Failure::Refused(format!("the script raised {errors}")));
        }
        Ok(())
    }
}

fn create(path: &PathBuf) -> io::Result<BufWriter<File>> {
    File::create(path).map(BufWriter::new)
}

/// A file of words in the making. The first write that fails ends it; [`Raw::end`] answers why.
struct Raw<W: Write> {
    file: W,
    failed: Option<io::Error>,
}

impl<W: Write> Raw<W> {
    /// The words of a segment as they play.
    fn segment(&mut self, played: &Played<'_>) {
        if self.failed.is_none() {
            let bytes: Vec<u8> = played.words.iter().flat_map(|word| word.to_le_bytes()).collect();
            self.failed = self.file.write_all(&bytes).err();
        }
    }

    fn end(mut self) -> io::Result<()> {
        self.failed.map_or_else(|| self.file.flush(), Err)
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
