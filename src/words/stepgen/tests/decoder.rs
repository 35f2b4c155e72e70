//! An independent reader of words: plays them onto lines tick by tick and judges every edge.

use super::super::timing::MotorTiming;

/// One motor's lines as a driver sees them.
pub struct Decoder {
    step_bit: u32,
    dir_bit: u32,
    pub inverted: bool,
    asks: MotorTiming,
    step: bool,
    pub dir: bool,
    pub position: i64,
    now_ns: i64,
    rose_ns: i64,
    fell_ns: i64,
    turned_ns: i64,
}

const LONG_AGO: i64 = -1_000_000_000;

impl Decoder {
    pub fn new(step_pin: u8, dir_pin: u8, inverted: bool, asks: MotorTiming) -> Decoder {
        Decoder {
            step_bit: 1 << step_pin,
            dir_bit: 1 << dir_pin,
            inverted,
            asks,
            step: false,
            dir: false,
            position: 0,
            now_ns: 0,
            rose_ns: LONG_AGO,
            fell_ns: LONG_AGO,
            turned_ns: LONG_AGO,
        }
    }

    /// Lets time pass with no words.
    pub fn pause(&mut self, ticks: u32) {
        self.now_ns += i64::from(ticks) * 1_000;
    }

    /// One word, one tick.
    pub fn play(&mut self, word: u32) {
        let since = |then: i64| self.now_ns - then;
        let (set, reset) = (word & 0xFFFF, word >> 16);
        assert!(set & reset & self.dir_bit == 0, "DIR both set and reset");
        let step = set & self.step_bit != 0 || (self.step && reset & self.step_bit == 0);
        let dir = set & self.dir_bit != 0 || (self.dir && reset & self.dir_bit == 0);
        if set & self.step_bit != 0 {
            assert!(!self.step, "a step merged into the one before");
        }
        if self.step && !step {
            assert!(since(self.rose_ns) >= i64::from(self.asks.high_ns), "high time");
            self.fell_ns = self.now_ns;
        }
        if dir != self.dir {
            assert!(!step, "DIR changes while STEP is high");
            assert!(since(self.rose_ns) >= i64::from(self.asks.hold_ns), "DIR hold time");
            self.turned_ns = self.now_ns;
        }
        if step && !self.step {
            assert!(self.now_ns - self.fell_ns >= i64::from(self.asks.low_ns), "low time");
            assert!(self.now_ns - self.turned_ns >= i64::from(self.asks.setup_ns), "DIR set-up");
            self.rose_ns = self.now_ns;
            self.position += if dir != self.inverted { 1 } else { -1 };
        }
        self.step = step;
        self.dir = dir;
        self.now_ns += 1_000;
    }
}

/// Judges the net number of steps in *every* run of N ticks, N = 1, 2, …, against v N + 1 (on a
/// grid of g ticks v (N + g - 1) + 1) by keeping the extremes of count - v tick.
pub struct RateRule {
    rate: i64,
    slack: i64,
    tick: i64,
    lowest: i64,
    highest: i64,
}

impl RateRule {
    pub fn new(steps_per_second: u32, grid: u32) -> RateRule {
        let rate = i64::from(steps_per_second);
        let slack = 1_000_000 + rate * i64::from(grid - 1);
        RateRule { rate, slack, tick: 0, lowest: 0, highest: 0 }
    }

    /// After each tick, with the count so far (zero before the first).
    pub fn judge(&mut self, count: i64) {
        self.tick += 1;
        let ahead = count * 1_000_000 - self.rate * self.tick;
        let behind = count * 1_000_000 + self.rate * self.tick;
        assert!(ahead - self.lowest <= self.slack, "too many steps up by tick {}", self.tick);
        assert!(self.highest - behind <= self.slack, "too many steps down by tick {}", self.tick);
        self.lowest = self.lowest.min(ahead);
        self.highest = self.highest.max(behind);
    }
}

/// A small generator of test data (xorshift64*).
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// Uniform below `n`, which is not zero.
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.next()) * u128::from(n)) >> 64) as u64
    }
}
