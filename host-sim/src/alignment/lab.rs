//! A bench on the desktop: two boards before one chip, in one virtual time, with wires of a given speed.
//!
//! # Design
//! In every segment of 256 us both boards play theirs, the bench sees where the stages stand, and the converters of
//! both boards read what the meter says. Bytes take the time that the serial line takes; nothing else passes between
//! the alignment program and the controllers.

use super::bus::{Bus, BusError};
use crate::bench_twin::{Bench, Sees, Side};
use crate::board::{Board, Interleaving};
use crate::console::Console;
use crate::machine::Machine;
use crate::power_meter::SWITCH_TICKS;
use crate::rig::Rig;
use crate::session::power_up;
use stage_controller::units::SEGMENT_NS;
use std::collections::VecDeque;

/// Bits on the wire for a byte: start, eight, stop.
const BITS_PER_BYTE: u64 = 10;
/// Speed of the serial lines, baud.
const BAUD: u64 = 115_200;
/// Time of a byte, ns.
const BYTE_NS: u64 = BITS_PER_BYTE * 1_000_000_000 / BAUD;

/// Bytes on their way, one after the other.
#[derive(Debug, Default)]
struct Wire {
    bytes: VecDeque<u8>,
    /// Time for which the line has been free for the next byte, ns.
    credit_ns: u64,
}

impl Wire {
    /// Bytes that arrive in one segment.
    fn arrive(&mut self) -> Vec<u8> {
        self.credit_ns += SEGMENT_NS;
        let count = (self.credit_ns / BYTE_NS).min(self.bytes.len() as u64);
        self.credit_ns = if count as usize == self.bytes.len() { 0 } else { self.credit_ns - count * BYTE_NS };
        self.bytes.drain(..count as usize).collect()
    }
}

/// A controller with its stage and its wires.
struct Stage {
    console: Console,
    down: Wire,
    up: Wire,
    line: Vec<u8>,
    lines: VecDeque<String>,
    /// The link has been lost.
    cut: bool,
}

impl Stage {
    fn step(&mut self) {
        let bytes = self.down.arrive();
        // what is on the wire while it is cut is lost in both directions
        if !bytes.is_empty() && !self.cut {
            let answer = self.console.exchange(&bytes);
            self.up.bytes.extend(answer);
        }
        let answer = self.console.step(|_| ());
        self.up.bytes.extend(answer);
        for byte in self.up.arrive() {
            match byte {
                _ if self.cut => self.line.clear(),
                b'\n' => self.lines.push_back(String::from_utf8_lossy(&std::mem::take(&mut self.line)).into_owned()),
                _ => self.line.push(byte),
            }
        }
    }
}

/// What can be seen of a bench at an instant.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Since the beginning, s.
    pub seconds: f64,
    /// What the meter shows, dBm.
    pub levels_dbm: [f64; 2],
    /// Logical poses that the controllers tell, nm and nrad.
    pub poses: [[i32; 6]; 2],
}

/// Somebody who looks on.
type Onlooker = Box<dyn FnMut(&Moment)>;

/// Segments between two looks: 10 ms.
const LOOK_SEGMENTS: u64 = 10_000_000 / SEGMENT_NS;

/// Two boards before one chip.
pub struct Lab {
    rig: Rig,
    stages: [Stage; 2],
    /// When the optical switch has settled, tick.
    switched: u64,
    /// Least distance of the corners from the chip so far, um.
    least_um: [f64; 2],
    onlooker: Option<Onlooker>,
}

impl Lab {
    /// A bench whose controllers believe what `calibrated` says of their stages; homed at 0, enabled.
    ///
    /// # Errors
    /// The calibration's refusal.
    pub fn new(bench: Bench, calibrated: &[Machine; 2], seed: u64) -> Result<Self, String> {
        let stage = |side: Side| {
            let front = power_up(&calibrated[side.index()], false)?;
            let board = Board::new(bench.machine(side), front, Interleaving::Prompt, seed ^ side.index() as u64);
            Ok::<_, String>(Stage {
                console: Console::new(board),
                down: Wire::default(),
                up: Wire::default(),
                line: Vec::new(),
                lines: VecDeque::new(),
                cut: false,
            })
        };
        let stages = [stage(Side::Input)?, stage(Side::Output)?];
        let least_um = bench.clearances_um();
        Ok(Lab { rig: Rig::new(bench), stages, switched: 0, least_um, onlooker: None })
    }

    /// One segment of virtual time.
    pub fn step(&mut self) {
        self.stages.iter_mut().for_each(Stage::step);
        self.rig.border(self.stages.each_mut().map(|stage| &mut stage.console.board));
        let now_um = self.rig.bench.clearances_um();
        self.least_um = std::array::from_fn(|i| self.least_um[i].min(now_um[i]));
        if self.rig.segments().is_multiple_of(LOOK_SEGMENTS) {
            self.look_on();
        }
    }

    /// Lets somebody see the bench every 10 ms of virtual time.
    pub fn show(&mut self, onlooker: impl FnMut(&Moment) + 'static) {
        self.onlooker = Some(Box::new(onlooker));
    }

    fn look_on(&mut self) {
        let Some(onlooker) = &mut self.onlooker else { return };
        onlooker(&Moment {
            seconds: self.rig.tick() as f64 * 1e-6,
            levels_dbm: self.rig.bench.readings(),
            poses: self.stages.each_ref().map(|stage| stage.console.board.front.position().0),
        });
    }

    /// Ticks of 1 us since the beginning.
    pub fn tick(&self) -> u64 {
        self.rig.tick()
    }

    /// True poses of both stages, nm and nrad.
    pub fn poses(&self) -> [[f64; 6]; 2] {
        self.stages.each_ref().map(|stage| stage.console.board.twin().true_pose())
    }

    /// Insertion loss of every channel where the stages stand now, dB.
    pub fn losses(&self) -> Vec<f64> {
        self.rig.bench.losses(self.tick(), &self.poses())
    }

    /// Least distance of the corners of both sides from the chip so far, um.
    pub fn least_clearances_um(&self) -> [f64; 2] {
        self.least_um
    }

    /// Waits until the optical switch has settled.
    fn settle(&mut self) -> Result<(), BusError> {
        while self.tick() < self.switched {
            self.step();
            self.rig.bench.check()?;
        }
        Ok(())
    }

    /// The bench.
    pub fn bench(&self) -> &Bench {
        &self.rig.bench
    }

    /// The bench, to break something.
    pub fn bench_mut(&mut self) -> &mut Bench {
        &mut self.rig.bench
    }

    /// The board of a side.
    pub fn board(&mut self, side: Side) -> &mut Board {
        &mut self.stages[side.index()].console.board
    }

    /// The link of a side is lost: nothing arrives any more, in neither direction.
    pub fn cut(&mut self, side: Side) {
        self.stages[side.index()].cut = true;
    }

    /// The link of a side is back; what was sent meanwhile is lost.
    pub fn mend(&mut self, side: Side) {
        let stage = &mut self.stages[side.index()];
        (stage.down, stage.up, stage.cut) = (Wire::default(), Wire::default(), false);
        stage.line.clear();
        stage.lines.clear();
    }
}

impl Bus for Lab {
    fn send(&mut self, side: Side, message: &str) -> Result<(), BusError> {
        self.settle()?;
        let down = &mut self.stages[side.index()].down.bytes;
        down.extend(message.bytes());
        down.push_back(b'\n');
        Ok(())
    }

    fn send_block(&mut self, side: Side, message: &str, block: &[u8]) -> Result<(), BusError> {
        let length = block.len().to_string();
        let down = &mut self.stages[side.index()].down.bytes;
        down.extend(message.bytes());
        down.extend(format!("#{}{length}", length.len()).bytes());
        down.extend(block);
        down.push_back(b'\n');
        Ok(())
    }

    fn line(&mut self, side: Side, message: &str, patience_s: f64) -> Result<String, BusError> {
        let until = self.seconds() + patience_s;
        loop {
            if let Some(line) = self.stages[side.index()].lines.pop_front() {
                return Ok(line);
            }
            if self.seconds() >= until {
                return Err(BusError::Silent { side, message: message.into(), seconds: patience_s });
            }
            self.step();
            self.rig.bench.check()?;
        }
    }

    fn look(&mut self, channel: usize, sees: Sees) {
        self.rig.bench.connect(channel, sees);
        // both channels switch at once; what is sent after that waits
        self.switched = self.tick() + SWITCH_TICKS;
    }

    fn pause(&mut self, seconds: f64) -> Result<(), BusError> {
        let until = self.seconds() + seconds;
        while self.seconds() < until {
            self.step();
            self.rig.bench.check()?;
        }
        Ok(())
    }

    fn seconds(&self) -> f64 {
        self.tick() as f64 * 1e-6
    }
}
