//! A climb: steps along one axis after the other as long as they gain, then smaller ones.

use super::{Definition, LEAST, NUMBER, RANGE, SCAN_AXES};

/// Measurements after which a climb is given up.
const MOST: u16 = 2000;

/// Where a climb stands. Offsets in nm or nrad from where it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Climb {
    /// The best point so far.
    pub best: [i32; SCAN_AXES],
    /// Its level, millionths of a dBm.
    pub level: i32,
    /// Bit n: axis n came to the best point downwards.
    pub downwards: u8,
    /// The present step, to begin with the first one.
    pub step: i32,
    axis: u8,
    down: bool,
    /// Steps since the last gain.
    tries: u16,
    /// This direction has gained.
    rising: bool,
    /// A direction has gained since the step became what it is.
    gained: bool,
    measured: u16,
    /// The point that is measured now.
    pub here: [i32; SCAN_AXES],
}

impl Climb {
    /// None; all bytes are zero.
    pub const NONE: Climb = Climb {
        best: [0; SCAN_AXES],
        level: 0,
        downwards: 0,
        step: 0,
        axis: 0,
        down: false,
        tries: 0,
        rising: false,
        gained: false,
        measured: 0,
        here: [0; SCAN_AXES],
    };

    /// The level at [`Climb::here`]; the next point in `here`, or false: the climb has ended.
    #[inline(never)]
    pub fn measured(&mut self, definition: &Definition, level: i32) -> bool {
        let first = self.measured == 0;
        self.measured += 1;
        if first || level > self.level {
            (self.level, self.best) = (level, self.here);
            let bit = 1 << self.axis;
            self.downwards = if self.down { self.downwards | bit } else { self.downwards & !bit };
            self.tries = 0;
            (self.rising, self.gained) = (!first, self.gained || !first);
        }
        self.measured < MOST && self.next(definition)
    }

    /// It was given up before it had ended.
    pub fn is_cut_off(&self) -> bool {
        self.measured >= MOST
    }

    fn next(&mut self, definition: &Definition) -> bool {
        loop {
            self.tries += 1;
            let way = i64::from(self.step) * i64::from(self.tries) * if self.down { -1 } else { 1 };
            let axis = usize::from(self.axis);
            let to = self.best.get(axis).map_or(0, |best| i64::from(*best) + way);
            let within = 2 * to.abs() <= i64::from(definition.values[RANGE]);
            if i32::from(self.tries) <= definition.values[NUMBER] && within {
                self.here = self.best;
                if let Some(place) = self.here.get_mut(axis) {
                    *place = to as i32;
                }
                return true;
            }
            self.tries = 0;
            // the way back from a gain is known to lead down
            if !self.down && !self.rising {
                self.down = true;
                continue;
            }
            (self.down, self.rising) = (false, false);
            self.axis += 1;
            if self.axis < definition.count {
                continue;
            }
            self.axis = 0;
            if !core::mem::take(&mut self.gained) {
                if self.step <= definition.values[LEAST] {
                    return false;
                }
                self.step = (self.step / 2).max(definition.values[LEAST]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::STEP;
    use super::*;

    fn climb(patience: u16, power: impl Fn([i32; 3]) -> i32) -> (Climb, u32) {
        let mut definition = Definition { count: 2, ..Definition::default() };
        for (slot, value) in [(RANGE, 40_000), (STEP, 1_000), (LEAST, 50), (NUMBER, patience.into())] {
            definition.values[slot] = value;
        }
        let mut climb = Climb { step: definition.values[STEP], ..Climb::NONE };
        let mut count = 1;
        while climb.measured(&definition, power(climb.here)) {
            count += 1;
            assert!(climb.here.iter().all(|x| x.abs() <= 20_000));
        }
        (climb, count)
    }

    #[test]
    fn a_hill_is_climbed_to_the_least_step() {
        for (x, y) in [(7_130, -4_210), (0, 0), (-19_990, 19_990), (333, 1)] {
            let (climb, count) = climb(1, |at| -((at[0] - x).pow(2) / 1000) - ((at[1] - y).pow(2) / 1000));
            assert!((climb.best[0] - x).abs() <= 50 + 32 && (climb.best[1] - y).abs() <= 50 + 32, "{:?}", climb.best);
            assert!(count < 200, "{count}");
        }
    }

    #[test]
    fn nothing_to_climb_ends_soon_and_where_it_began() {
        let (climb, count) = climb(3, |_| -100);
        assert_eq!(climb.best, [0; 3]);
        assert!(count < 100, "{count}");
    }
}
