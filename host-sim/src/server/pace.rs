//! How virtual time keeps up with wall time.

use stage_controller::units::SEGMENT_NS;
use std::time::{Duration, Instant};

/// Most segments in one turn at full speed.
const FLAT_OUT_SEGMENTS: u64 = 2000;
/// Virtual time that a late turn makes up for; beyond, it is given up.
const CATCH_UP: Duration = Duration::from_millis(250);
/// Segments between two looks at the clock.
const SEGMENTS_PER_LOOK: u64 = 8;

/// How virtual time runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// As fast as the machine can, and only while somebody waits for it.
    Max,
    /// This many times wall time.
    Factor(f64),
}

/// Virtual time against wall time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    speed: Speed,
    /// Wall time up to which virtual time has run.
    reached: Duration,
    /// The last turn did not catch up with wall time.
    late: bool,
}

/// One turn of the server's loop.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    wall: Duration,
    begun: Instant,
    budget: Duration,
    segments: u64,
}

impl Turn {
    /// At this wall time since the start, of which virtual time may take `budget`.
    pub fn new(wall: Duration, budget: Duration) -> Self {
        Turn { wall, begun: Instant::now(), budget, segments: 0 }
    }

    fn is_over(&self) -> bool {
        let looks = self.segments > 0 && self.segments.is_multiple_of(SEGMENTS_PER_LOOK);
        looks && self.begun.elapsed() >= self.budget
    }
}

impl Pace {
    /// From the start of the server.
    pub fn new(speed: Speed) -> Self {
        Pace { speed, reached: Duration::ZERO, late: false }
    }

    /// Another segment is due in this turn; at full speed only if it is `wanted`.
    pub fn takes(&mut self, turn: &mut Turn, wanted: bool) -> bool {
        let goes = match self.speed {
            Speed::Max => wanted && turn.segments < FLAT_OUT_SEGMENTS && !turn.is_over(),
            Speed::Factor(factor) => {
                self.reached = self.reached.max(turn.wall.saturating_sub(CATCH_UP));
                let segment = Duration::from_nanos((SEGMENT_NS as f64 / factor) as u64).max(Duration::from_nanos(1));
                let next = self.reached + segment;
                self.late = next <= turn.wall;
                let goes = self.late && !turn.is_over();
                if goes {
                    self.reached = next;
                }
                goes
            }
        };
        turn.segments += u64::from(goes);
        goes
    }

    /// Virtual time runs as fast as it can, or lags behind.
    pub fn is_flat_out(&self) -> bool {
        self.speed == Speed::Max || self.late
    }
}
