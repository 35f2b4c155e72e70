//! Checks the pulse timing that the drivers demand, word by word; apart from the fast twin.

use super::after_word;
use stage_controller::stepgen::pins::{DIR_PINS, STEP_PINS};
use stage_controller::units::AXES;

/// Minimum times of one motor's driver in ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// STEP high, rising to falling edge.
    pub high: u64,
    /// STEP low, falling to rising edge.
    pub low: u64,
    /// DIR change to the next rising STEP edge.
    pub setup: u64,
    /// Rising STEP edge to the next DIR change.
    pub hold: u64,
}

/// Violations of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Count {
    /// How many.
    pub count: u64,
    /// Tick of the edge that came too early, of the first one.
    pub first: Option<u64>,
}

impl Count {
    fn note(&mut self, since: Option<u64>, tick: u64, least: u64) {
        if since.is_some_and(|start| tick - start < least) {
            self.count += 1;
            self.first.get_or_insert(tick);
        }
    }
}

/// Violations of one motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Violations {
    /// STEP high too short.
    pub high: Count,
    /// STEP low too short.
    pub low: Count,
    /// DIR changed too shortly before a step.
    pub setup: Count,
    /// DIR changed too shortly after a step.
    pub hold: Count,
}

impl Violations {
    /// All kinds together.
    pub fn total(&self) -> u64 {
        self.high.count + self.low.count + self.setup.count + self.hold.count
    }
}

/// Ticks of the last edges of one motor; none before the first.
#[derive(Clone, Copy, Debug, Default)]
struct Edges {
    rising: Option<u64>,
    falling: Option<u64>,
    dir: Option<u64>,
}

/// Timing of the six STEP and DIR lines. A word takes effect at the start of its tick; the first
/// word fed is tick 0.
#[derive(Clone, Debug)]
pub struct Timing {
    limits: [Limits; AXES],
    edges: [Edges; AXES],
    violations: [Violations; AXES],
    lines: u32,
    tick: u64,
}

impl Timing {
    /// All lines low, and low for long.
    pub fn new(limits: [Limits; AXES]) -> Self {
        Timing { limits, edges: Default::default(), violations: Default::default(), lines: 0, tick: 0 }
    }

    /// Checks words, one per tick.
    pub fn feed(&mut self, words: &[u32]) {
        for &word in words {
            let next = after_word(self.lines, word);
            if next != self.lines {
                for motor in 0..AXES {
                    self.motor(motor, next);
                }
                self.lines = next;
            }
            self.tick += 1;
        }
    }

    /// What was found so far, by motor.
    pub fn violations(&self) -> [Violations; AXES] {
        self.violations
    }

    fn motor(&mut self, motor: usize, next: u32) {
        let changed = next ^ self.lines;
        let (step, dir) = (1 << STEP_PINS[motor], 1 << DIR_PINS[motor]);
        let (limits, tick) = (self.limits[motor], self.tick);
        let (edges, found) = (&mut self.edges[motor], &mut self.violations[motor]);
        if changed & dir != 0 {
            found.hold.note(edges.rising, tick, limits.hold);
            edges.dir = Some(tick);
        }
        if changed & step != 0 {
            if next & step != 0 {
                found.low.note(edges.falling, tick, limits.low);
                found.setup.note(edges.dir, tick, limits.setup);
                edges.rising = Some(tick);
            } else {
                found.high.note(edges.rising, tick, limits.high);
                edges.falling = Some(tick);
            }
        }
    }
}
