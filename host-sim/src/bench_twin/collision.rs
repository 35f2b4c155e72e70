//! The contact of two faces.

use super::Side;
use serde::Serialize;

/// The faces of array and chip have touched: the bench is broken from here on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, thiserror::Error)]
#[error("collision on the {} side at tick {tick}: a corner of the array is {:.3} um inside the chip; this is \
         for good: begin anew with another bench, and keep a wider gap on the way", if *side == Side::Input { "input" } else { "output" },
        -clearance_um)]
pub struct Collision {
    /// Where.
    pub side: Side,
    /// When, ticks of 1 us.
    pub tick: u64,
    /// True pose of the stage, nm and nrad.
    pub pose: [f64; 6],
    /// Least distance of a corner, um: 0 or below.
    pub clearance_um: f64,
}
