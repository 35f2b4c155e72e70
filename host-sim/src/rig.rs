//! What passes between a bench and the two boards before it, in every segment of 256 us.

use crate::bench_twin::{Bench, Side};
use crate::board::Board;
use stage_controller::units::SEGMENT_NS;

/// A bench and its time. The boards are with whoever talks to them.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The bench.
    pub bench: Bench,
    segments: u64,
}

impl Rig {
    /// A bench at tick 0; its boards are at home.
    pub fn new(bench: Bench) -> Self {
        Rig { bench, segments: 0 }
    }

    /// Both boards (in the order of [`Side::BOTH`]) have played a segment: the bench sees where the stages stand, and
    /// the converters of both boards read what the meter says.
    pub fn border(&mut self, boards: [&mut Board; 2]) {
        self.segments += 1;
        let poses = boards.each_ref().map(|board| board.twin().true_pose());
        self.bench.light(self.tick(), poses);
        for side in Side::BOTH {
            let codes = self.bench.codes(side);
            boards[side.index()].set_power(codes);
        }
    }

    /// Segments since the beginning.
    pub fn segments(&self) -> u64 {
        self.segments
    }

    /// Ticks of 1 us since the beginning.
    pub fn tick(&self) -> u64 {
        self.segments * SEGMENT_NS / 1000
    }
}
