//! What the twin knows and no program at the messages does: for telling afterwards what has kept a search from its peak.

use crate::alignment::{Bus, Lab};
use crate::bench_twin::Side;
use stage_controller::units::AXES;

/// Where everything truly is at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Tick of 1 us.
    pub tick: u64,
    /// True poses of both sides, nm and nrad.
    pub poses: [[f64; AXES]; 2],
    /// Counts of the motors.
    pub motors: [[i32; AXES]; 2],
    /// Driven sides of the plays, nm and nrad.
    pub driven: [[f64; AXES]; 2],
}

/// A bus whose bench can be looked at.
pub trait Witness: Bus {
    /// Where everything is now.
    fn snapshot(&mut self) -> Snapshot;

    /// What the camera at the side of the bench shows: distance of the nearest corner of a side from the chip, um.
    fn gap_um(&self, side: Side) -> f64;
}

impl Witness for Lab {
    fn snapshot(&mut self) -> Snapshot {
        let (tick, poses) = (self.tick(), self.poses());
        let motors = Side::BOTH.map(|side| self.board(side).twin().motors().0);
        let driven = Side::BOTH.map(|side| self.board(side).twin().actuators());
        Snapshot { tick, poses, motors, driven }
    }

    fn gap_um(&self, side: Side) -> f64 {
        self.bench().clearance_um(side, self.tick(), &self.poses()[side.index()])
    }
}
