//! Scans: what they are, what they give, and how a peak is found.

pub mod climb;
pub mod peak;
pub mod real;
pub mod samples;

use crate::sense::DARK;
use crate::units::{AXES, Axis};

/// Definitions that can be kept.
pub const SCANS: usize = 8;
/// Most axes of a scan.
pub const SCAN_AXES: usize = 3;
/// Most lines of a raster.
pub const LINES: usize = 64;
/// Most turns of a spiral.
pub const TURNS: i32 = 64;
/// Least points of a parabola: three are on one whatever they are, and with fewer than five noise looks curved too often.
pub const LEAST_POINTS: i32 = 5;
/// Most points of a parabola.
pub const POINTS: i32 = 101;
/// Most steps without gain in a climb.
pub const PATIENCE: i32 = 100;

/// Kinds of scans.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kind {
    /// A line, sampled in motion.
    #[default]
    Line,
    /// Parallel lines.
    Raster,
    /// A square spiral outwards, sampled in motion.
    Spiral,
    /// Steps upwards.
    Hill,
    /// Points on a line, measured at rest.
    Parabola,
}

/// What a scan does in the end; values of [`END`].
pub mod end {
    /// Goes to the peak.
    pub const PEAK: i32 = 0;
    /// Stays.
    pub const STAY: i32 = 1;
    /// Goes back to where it began.
    pub const START: i32 = 2;
    /// Stops where the power first reaches the threshold.
    pub const FIRST: i32 = 3;
}

/// The power input, from 1.
pub const CHANNEL: usize = 0;
/// Whole way of the first axis, about where the scan begins, nm or nrad.
pub const RANGE: usize = 1;
/// The same of the second axis.
pub const SECOND_RANGE: usize = 2;
/// Way between two samples of a line, nm or nrad.
pub const PITCH: usize = 3;
/// Way between lines or turns; the first step of a climb; nm or nrad.
pub const STEP: usize = 4;
/// The last step of a climb, nm or nrad.
pub const LEAST: usize = 5;
/// Points of a parabola; steps without gain that a climb goes on.
pub const NUMBER: usize = 6;
/// Level that counts as light, thousandths of a dBm.
pub const THRESHOLD: usize = 7;
/// What it does in the end, see [`end`].
pub const END: usize = 8;
/// 1: it samples on the negative flank.
pub const FLANK: usize = 9;
/// Values of a definition.
pub const VALUES: usize = 10;

/// A scan as it was defined.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Definition {
    /// There is one.
    pub defined: bool,
    /// What it is.
    pub kind: Kind,
    /// Axes, as indices; the first [`Definition::count`] of them.
    pub axes: [u8; SCAN_AXES],
    /// How many axes.
    pub count: u8,
    /// Its values, by [`CHANNEL`] and the others.
    pub values: [i32; VALUES],
}

impl Definition {
    /// None; all bytes are zero.
    pub const NONE: Definition =
        Definition { defined: false, kind: Kind::Line, axes: [0; SCAN_AXES], count: 0, values: [0; VALUES] };

    /// The axes, as indices.
    pub fn axes(&self) -> &[u8] {
        self.axes.get(..usize::from(self.count)).unwrap_or(&[])
    }

    /// One of its axes.
    pub fn axis(&self, n: usize) -> Axis {
        self.axes.get(n).and_then(|i| Axis::from_index((*i).into())).unwrap_or(Axis::X)
    }

    /// The power input, from 0.
    pub fn channel(&self) -> usize {
        (self.values[CHANNEL] - 1) as usize & 1
    }

    /// It samples on the negative flank.
    pub fn is_negative(&self) -> bool {
        self.values[FLANK] != 0
    }

    /// It samples on one flank, which is chosen.
    pub fn samples_one_way(&self) -> bool {
        matches!(self.kind, Kind::Line | Kind::Raster | Kind::Parabola)
    }

    /// +1 or -1: the direction in which it samples.
    pub fn sign(&self) -> i32 {
        if self.is_negative() { -1 } else { 1 }
    }

    /// Legs that are sampled in motion: lines of a raster, sides of a spiral.
    pub fn legs(&self) -> i32 {
        match self.kind {
            Kind::Line => 1,
            Kind::Raster => self.values[SECOND_RANGE].wrapping_div(self.values[STEP].max(1)) + 1,
            Kind::Spiral => self.turns() * 4 + 1,
            Kind::Hill | Kind::Parabola => 0,
        }
    }

    /// How far a spiral reaches to each side, nm or nrad: in as few turns as cover the range.
    #[inline(never)]
    pub fn reach(&self) -> i32 {
        self.turns() * self.values[STEP]
    }

    fn turns(&self) -> i32 {
        // rounded up
        (self.values[RANGE] - 1).wrapping_div((2 * self.values[STEP]).max(1)) + 1
    }

    /// Where a side of a spiral begins, in steps of both axes: sides of 1, 1, 2, 2, 3, 3 ... steps. The last side
    /// ends where its turn closes, at [`Definition::reach`].
    pub fn corner(n: i32) -> [i32; 2] {
        let turn = n / 4;
        match n % 4 {
            0 => [-turn, -turn],
            1 => [turn + 1, -turn],
            2 => [turn + 1, turn + 1],
            _ => [-turn - 1, turn + 1],
        }
    }
}

/// Bits of a result's status word.
pub mod status {
    /// It has ended by itself.
    pub const DONE: u16 = 1 << 0;
    /// The peak was found.
    pub const PEAK: u16 = 1 << 1;
    /// Light: the threshold was reached.
    pub const LIGHT: u16 = 1 << 2;
    /// The maximum lies at the edge of the range.
    pub const EDGE: u16 = 1 << 3;
    /// Samples were saturated.
    pub const SATURATED: u16 = 1 << 4;
    /// Samples were left out of the fit: they did not belong to it.
    pub const OUTLIERS: u16 = 1 << 5;
    /// Samples were lost on their way.
    pub const LOST: u16 = 1 << 6;
    /// Stopped by a command.
    pub const STOPPED: u16 = 1 << 7;
    /// Ended by an error; the queue names it.
    pub const FAILED: u16 = 1 << 8;
    /// It runs, or waits for its trigger.
    pub const RUNNING: u16 = 1 << 9;
}

/// What a scan has given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Bits of [`status`].
    pub status: u16,
    /// Samples used, means of AVERage conversions each.
    pub samples: u32,
    /// Level of the peak, millionths of a dBm.
    pub level: i32,
    /// Position of the peak, nm or nrad, of the axes that were scanned.
    pub position: [i32; AXES],
    /// Its standard uncertainty, nm or nrad; 0: not known.
    pub sigma: [u32; SCAN_AXES],
    /// Where it ended.
    pub ended: [i32; AXES],
}

impl Outcome {
    /// None; all bytes are zero.
    pub const NONE: Outcome =
        Outcome { status: 0, samples: 0, level: 0, position: [0; AXES], sigma: [0; SCAN_AXES], ended: [0; AXES] };

    /// As a scan begins.
    pub const FRESH: Outcome = Outcome { status: status::RUNNING, level: DARK, ..Outcome::NONE };

    /// True when it says where the peak is, or where light was found: not while that is still looked for.
    pub fn has_position(&self) -> bool {
        self.level != DARK && self.status & (status::PEAK | status::LIGHT | status::EDGE) != 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spiral_covers_its_range_and_goes_no_further_than_a_step_beyond() {
        for (range, step) in [(10, 10), (10, 1), (10, 5), (20, 4), (21, 4), (26, 4), (128, 1), (7, 3), (1, 1)] {
            let mut spiral = Definition { kind: Kind::Spiral, count: 2, ..Definition::default() };
            (spiral.values[RANGE], spiral.values[STEP]) = (range, step);
            let reach = spiral.reach();
            assert!(2 * reach >= range && 2 * (reach - step) < range, "{range} {step}: {reach}");
            // each side but the last ends within
            for n in 0..spiral.legs() {
                let corner = Definition::corner(n).map(|steps| steps * step);
                assert!(corner.iter().all(|place| place.abs() <= reach), "{range} {step}: {n} {corner:?}");
            }
            // there its outermost turn is open on one side
            assert_eq!(Definition::corner(spiral.legs() - 1).map(|steps| steps * step), [-reach; 2]);
        }
    }
}
