//! Light: from the sum of conversions of a power input to dBm and W.
//!
//! # Design
//! A meter puts out a voltage that is proportional to the power (linear) or to its logarithm. The board measures it with
//! 12 bits, of which a step is 3.3 V / 4096 (RM0090, 13.2), and a sample is the sum of [`CONVERSIONS`] conversions. Levels are whole
//! millionths of a dB, because a fitted peak is finer than any single sample; answers have thousandths. The mean of
//! several samples is taken of the voltage.
//!
//! # Limitations
//! What lies below one step of a conversion is [`Reading::Low`]; a sample with all conversions at full scale, or a mean
//! above [`SenseSettings::range`], is [`Reading::High`].

use crate::refill::border::{CONVERSION_MAX, CONVERSIONS, POWER_INPUTS};
use crate::units::wide;
use serde::{Deserialize, Serialize};

/// The largest sample: from one and a half steps of a conversion below 3.3 V on.
pub const FULL_SCALE: u16 = CONVERSION_MAX * CONVERSIONS;
/// A sample that would mean the reference voltage.
const REFERENCE: u16 = (CONVERSION_MAX + 1) * CONVERSIONS;
/// That voltage, mV.
const REFERENCE_MV: i64 = 3300;
/// Millionths of a dB in a dB.
pub const DB: i32 = 1_000_000;
/// The level that stands for no light, millionths of a dBm; also the least one that can be named.
pub const DARK: i32 = -200 * DB;
/// The largest level that can be named, millionths of a dBm.
pub const BRIGHT: i32 = 200 * DB;
/// Most samples of a mean.
pub const AVERAGE_MAX: u16 = 256;
/// Samples of a mean unless told otherwise.
pub const AVERAGE_DEFAULT: u16 = 16;
/// Longest delay of a meter, ns.
pub const DELAY_MAX_NS: u32 = 100_000_000;
/// Most that a linear meter may mean by a volt, pW: 1 kW.
pub const GAIN_MAX: u64 = 1_000_000_000_000_000;
/// Most that a logarithmic meter may mean by a volt, thousandths of a dB.
pub const SLOPE_MAX: i32 = 100_000;

/// What the voltage of an input means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Input {
    /// Proportional to the power: pW per V.
    Linear(u64),
    /// Proportional to the level: thousandths of a dB per V, and thousandths of a dBm at 0 V.
    Logarithmic(i32, i32),
}

/// Settings of a power input.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SenseSettings {
    /// What its voltage means: a fact of the meter, which `*RST` leaves alone.
    pub input: Input,
    /// Level above which the meter is saturated, thousandths of a dBm; none: full scale. `*RST` leaves it alone.
    pub range: Option<i32>,
    /// By how much the meter is late, ns. `*RST` leaves it alone.
    pub delay_ns: u32,
    /// Samples of a mean.
    pub average: u16,
    /// Answers are in W, not in dBm.
    pub watts: bool,
}

impl Default for SenseSettings {
    /// A meter of 1 mW per V.
    fn default() -> Self {
        SenseSettings {
            input: Input::Linear(1_000_000_000),
            range: None,
            delay_ns: 0,
            average: AVERAGE_DEFAULT,
            watts: false,
        }
    }
}

/// Settings of all inputs.
pub type SenseInputs = [SenseSettings; POWER_INPUTS];

/// What an input says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Millionths of a dBm.
    Level(i32),
    /// Below one step of a conversion.
    Low,
    /// Saturated.
    High,
}

impl Reading {
    /// As a level: what is out of range counts as the end of it.
    #[inline(never)]
    pub fn level(self) -> i32 {
        match self {
            Reading::Level(level) => level,
            Reading::Low => DARK,
            Reading::High => BRIGHT,
        }
    }
}

/// log2 in Q32, to 2^-30; of zero: 0.
#[inline(never)]
pub fn log2_q32(x: u64) -> i64 {
    let up = x.leading_zeros();
    if up == 64 {
        return 0;
    }
    let mut mantissa = ((x << up) >> 32) as u32;
    let mut log = i64::from(63 - up);
    // each squaring of a number in 1..2 gives the next digit
    for _ in 0..32 {
        let square = u64::from(mantissa) * u64::from(mantissa);
        let carry = square >> 63;
        mantissa = (square >> (31 + carry)) as u32;
        log = log << 1 | carry as i64;
    }
    log
}

/// 2^x of a number in Q32, as a whole number: the least one whose logarithm is not below.
fn exp2(x_q32: i64) -> u64 {
    let mut power = 0;
    for bit in (0..63).rev() {
        let more = power | 1u64 << bit;
        if log2_q32(more) <= x_q32 {
            power = more;
        }
    }
    power
}

/// 10 log10 of 2, millionths of a dB in Q12.
const DB_PER_OCTAVE: i64 = 12_330_188_626;
/// 10 log10(3.3e-9 / 32768), millionths of a dB: a step of a sample at 1 pW per V, in mW.
const STEP_OF_A_PICOWATT: i64 = -129_969_360;

/// Millionths of a dB of a ratio whose log2 is given in Q32.
fn decibels(log2_q32: i64) -> i64 {
    // Q32 by Q12; the factors have 38 and 34 bits
    ((i128::from(log2_q32) * i128::from(DB_PER_OCTAVE) + (1 << 43)) >> 44) as i64
}

impl SenseSettings {
    /// The level of a mean of `count` samples whose sum is `sum`, millionths of a dBm, as if nothing were out of range.
    #[inline(never)]
    pub fn level(&self, sum: u32, count: u16) -> i32 {
        let (sum, count) = (sum.max(1), u32::from(count.max(1)));
        let level = match self.input {
            Input::Linear(gain) => {
                let ratio = log2_q32(sum.into()) - log2_q32(count.into()) + log2_q32(gain.max(1));
                decibels(ratio) + STEP_OF_A_PICOWATT
            }
            Input::Logarithmic(slope, zero) => {
                // thousandths of a dB times mV are millionths of a dB: at most 10^5 * 3300 * 2^23
                let (whole, parts) =
                    (i64::from(slope) * REFERENCE_MV * i64::from(sum), i64::from(count) * i64::from(REFERENCE));
                i64::from(zero) * 1000 + (whole + parts / 2).div_euclid(parts.max(1))
            }
        };
        level.clamp(DARK.into(), BRIGHT.into()) as i32
    }

    /// What a mean of `count` samples says. `saturated`: one of them was at full scale.
    #[inline(never)]
    pub fn reading(&self, sum: u32, count: u16, saturated: bool) -> Reading {
        let level = self.level(sum, count);
        if saturated || self.range.is_some_and(|range| level > range.wrapping_mul(1000)) {
            Reading::High
        } else if sum < u32::from(count) * u32::from(CONVERSIONS) {
            Reading::Low
        } else {
            Reading::Level(level)
        }
    }

    /// Least and largest power that the range may be: the level of one step of a conversion, and that of full scale,
    /// thousandths of a dBm.
    #[inline(never)]
    pub fn ranges(&self) -> (i32, i32) {
        let [least, most] = [CONVERSIONS, FULL_SCALE].map(|code| (self.level(code.into(), 1) + 500).div_euclid(1000));
        (least, most.max(least))
    }

    /// What `*RST` sets.
    pub fn reset(&mut self) {
        let fresh = SenseSettings::default();
        (self.average, self.watts) = (fresh.average, fresh.watts);
    }

    /// Every value must be one that its command would take.
    pub fn is_good(&self) -> bool {
        let input = match self.input {
            Input::Linear(gain) => (1..=GAIN_MAX).contains(&gain),
            Input::Logarithmic(slope, zero) => {
                (1..=SLOPE_MAX).contains(&slope) && (DARK / 1000..=BRIGHT / 1000).contains(&zero)
            }
        };
        let (least, most) = self.ranges();
        input
            && (1..=AVERAGE_MAX).contains(&self.average)
            && self.delay_ns <= DELAY_MAX_NS
            && self.range.is_none_or(|range| (least..=most).contains(&range))
    }
}

/// fW of a level in millionths of a dBm, to 10^-6 of it.
pub fn femtowatts(level: i32) -> u64 {
    // 0 dBm are 10^12 fW
    let log = (i128::from(level) + 120_000_000) << 44;
    exp2(wide::signed_div(log, DB_PER_OCTAVE.into()) as i64)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;

    fn exact(input: Input, sum: f64, count: f64) -> f64 {
        let volts = sum / count / 32768.0 * 3.3;
        match input {
            Input::Linear(gain) => 10.0 * (volts * gain as f64 * 1e-12 / 1e-3).log10(),
            Input::Logarithmic(slope, zero) => f64::from(slope) / 1e3 * volts + f64::from(zero) / 1e3,
        }
    }

    #[test]
    fn every_code_is_right_to_a_thousandth_of_a_db() {
        let inputs = [1u64, 1_000, 123_456_789, 1_000_000_000, GAIN_MAX].map(Input::Linear).into_iter();
        let inputs = inputs.chain([Input::Logarithmic(20_000, -60_000), Input::Logarithmic(SLOPE_MAX, -179_999)]);
        for input in inputs {
            let settings = SenseSettings { input, ..SenseSettings::default() };
            for code in 1..=u32::from(FULL_SCALE) {
                let (level, exact) = (settings.level(code, 1), exact(input, code.into(), 1.0));
                assert!((f64::from(level) / 1e6 - exact).abs() < 2e-6, "{input:?} {code}: {level} {exact}");
            }
        }
    }

    #[test]
    fn a_mean_is_one_of_the_voltage() {
        let settings = SenseSettings::default();
        for count in 1..=AVERAGE_MAX {
            let sum = u32::from(count) * 20_000 + u32::from(count) / 3;
            let exact = exact(settings.input, sum.into(), count.into());
            assert!((f64::from(settings.level(sum, count)) / 1e6 - exact).abs() < 2e-6, "{count}");
        }
    }

    #[test]
    fn watts_are_what_the_level_says() {
        for level in (-100 * DB..60 * DB).step_by(123_457) {
            let (have, want) = (femtowatts(level) as f64, 10f64.powf(f64::from(level) / 1e7) * 1e12);
            assert!((have / want - 1.0).abs() < 1e-6 || (have - want).abs() <= 1.0, "{level}: {have} {want}");
        }
    }

    #[test]
    fn what_is_out_of_range_says_so() {
        let mut settings = SenseSettings::default();
        assert_eq!(settings.reading(FULL_SCALE.into(), 1, true), Reading::High);
        assert_eq!(settings.reading(7, 1, false), Reading::Low);
        assert!(matches!(settings.reading(8, 1, false), Reading::Level(_)));
        settings.range = Some(-3_000);
        assert_eq!(settings.reading(16_000, 1, false), Reading::High, "1.6 mW are above half a mW");
        assert!(matches!(settings.reading(4_000, 1, false), Reading::Level(_)), "0.4 mW are not");
    }
}
