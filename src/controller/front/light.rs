//! The memory of samples, scans and recordings, apart from the front: a board lends it, a desktop has it in the front.

use super::scan::Scan;
use crate::refill::border::POWER_INPUTS;
use crate::scan::samples::{Point, Samples};
use crate::scan::{Definition, LINES, Outcome, SCANS};
use crate::sense::AVERAGE_MAX;
use crate::trace::{RECORDS, Record};

/// A scan that was defined, and what it gave last.
#[derive(Clone, Copy, Debug)]
pub struct Kept {
    /// The definition.
    pub definition: Definition,
    /// What it gave; its status is 0 before it has begun for the first time.
    pub outcome: Outcome,
}

/// Peak of a line of a raster.
#[derive(Clone, Copy, Debug, Default)]
pub struct LinePeak {
    /// Where on the line, nm or nrad from where the scan began.
    pub x: i32,
    /// Its standard uncertainty.
    pub sigma: u32,
}

/// The memory: 37 KB.
#[derive(Clone, Copy, Debug)]
pub struct LightMemory {
    /// The recording.
    pub records: [Record; RECORDS],
    /// The latest samples, round and round.
    pub latest: [[u16; POWER_INPUTS]; AVERAGE_MAX as usize],
    /// Scans.
    pub kept: [Kept; SCANS],
    /// The scan that runs or has been stopped.
    pub(super) scan: Scan,
    /// Samples of a line.
    pub samples: Samples,
    /// Peaks of the lines of a raster: place of the line and level.
    pub lines: [Point; LINES],
    /// The same, where on the lines.
    pub peaks: [LinePeak; LINES],
}

impl Default for LightMemory {
    fn default() -> Self {
        LightMemory::new()
    }
}

impl LightMemory {
    /// Empty.
    pub const fn new() -> Self {
        LightMemory {
            records: [Record::EMPTY; RECORDS],
            latest: [[0; POWER_INPUTS]; AVERAGE_MAX as usize],
            kept: [Kept { definition: Definition::NONE, outcome: Outcome::NONE }; SCANS],
            scan: Scan::NONE,
            samples: Samples::new(),
            lines: [(0, 0); LINES],
            peaks: [LinePeak { x: 0, sigma: 0 }; LINES],
        }
    }
}

/// The front's way to the memory. On a board none before it is lent: nothing is measured then.
#[cfg(target_os = "none")]
#[derive(Debug, Default)]
pub(super) struct Lent(Option<&'static mut LightMemory>);

/// The front's way to the memory.
#[cfg(not(target_os = "none"))]
#[derive(Debug, Default)]
pub(super) struct Lent(LightMemory);

#[cfg(target_os = "none")]
impl Lent {
    pub fn lend(&mut self, memory: &'static mut LightMemory) {
        self.0 = Some(memory);
    }

    pub fn get(&self) -> Option<&LightMemory> {
        self.0.as_deref()
    }

    pub fn get_mut(&mut self) -> Option<&mut LightMemory> {
        self.0.as_deref_mut()
    }
}

#[cfg(not(target_os = "none"))]
impl Lent {
    pub fn get(&self) -> Option<&LightMemory> {
        Some(&self.0)
    }

    pub fn get_mut(&mut self) -> Option<&mut LightMemory> {
        Some(&mut self.0)
    }
}

impl Lent {
    /// The scan that runs or has been stopped.
    pub fn scan(&self) -> Option<&Scan> {
        self.get().map(|memory| &memory.scan).filter(|scan| scan.is_there())
    }

    /// The same, to be changed.
    pub fn scan_mut(&mut self) -> Option<&mut Scan> {
        self.get_mut().map(|memory| &mut memory.scan).filter(|scan| scan.is_there())
    }
}
