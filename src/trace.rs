//! Recorded samples: what the inputs said, when, and where the motors stood.

use crate::refill::border::{POWER_INPUTS, Sample};
use crate::units::{AXES, SEGMENT_TICKS};

/// Records that can be kept.
pub const RECORDS: usize = 1024;
/// Bytes of a record in a block: tick (u64), six motor counts (i32), power of both inputs (u16), little endian.
pub const PACKED: usize = 8 + 4 * AXES + 2 * POWER_INPUTS;
/// Most records in a block of 4096 bytes.
pub const PACKED_MOST: usize = 4096 / PACKED;

/// A sample as it is kept: 32 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Record {
    /// Segments played since the recording began.
    segments: u32,
    counts: [i32; AXES],
    power: [u16; POWER_INPUTS],
}

const _: () = assert!(size_of::<Record>() == 32);

impl Record {
    /// None yet.
    pub const EMPTY: Record = Record { segments: 0, counts: [0; AXES], power: [0; POWER_INPUTS] };
}

/// A record as it is told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Told {
    /// Tick of the sample, us.
    pub tick: u64,
    /// Motor counts, overlay included.
    pub counts: [i32; AXES],
    /// Sums of conversions.
    pub power: [u16; POWER_INPUTS],
}

/// Which samples are recorded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Source {
    /// Those of every border.
    #[default]
    Border,
    /// Those that a scan uses.
    Scan,
}

/// Where a recording stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Nothing is recorded.
    #[default]
    Idle,
    /// `*TRG` begins it.
    Armed,
    /// Samples are recorded.
    Running,
}

/// What is recorded, and how far.
#[derive(Clone, Copy, Debug, Default)]
pub struct Trace {
    /// Which samples.
    pub source: Source,
    /// Every n-th of them, counted from zero: 0 is every one.
    pub skip: u16,
    /// Where it stands.
    pub state: State,
    left: u16,
    /// Records kept.
    points: u16,
    /// Segment from which they are counted.
    base: u64,
}

impl Trace {
    /// Records kept.
    pub fn points(&self) -> u16 {
        self.points
    }

    /// Forgets what is kept, and begins or waits.
    pub fn arm(&mut self, state: State) {
        (self.state, self.points, self.left) = (state, 0, 0);
    }

    /// Keeps a sample, if its turn has come; ends when the memory is full.
    pub fn push(&mut self, records: &mut [Record], sample: &Sample) {
        if self.left > 0 {
            self.left -= 1;
            return;
        }
        if self.points == 0 {
            self.base = sample.played;
        }
        let segments = sample.played.wrapping_sub(self.base);
        match (records.get_mut(usize::from(self.points)), u32::try_from(segments)) {
            (Some(place), Ok(segments)) => {
                *place = Record { segments, counts: sample.counts.0, power: sample.power };
                self.points += 1;
                self.left = self.skip;
            }
            _ => self.state = State::Idle,
        }
        if usize::from(self.points) >= records.len() {
            self.state = State::Idle;
        }
    }

    /// A record.
    pub fn told(&self, records: &[Record], n: u16) -> Option<Told> {
        let record = records.get(usize::from(n)).filter(|_| n < self.points)?;
        let tick = (self.base + u64::from(record.segments)) * SEGMENT_TICKS as u64;
        Some(Told { tick, counts: record.counts, power: record.power })
    }
}
