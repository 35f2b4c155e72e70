//! The board's converter: 12 bits, eight conversions to a sample.

use super::noise::{bits, mixed, nearly_normal};

/// Conversions that are added to one sample.
pub const CONVERSIONS: u16 = 8;
/// Voltage at which the converter is full.
pub const FULL_SCALE_VOLTS: f64 = 3.3;
/// Largest sample: all conversions full.
pub const LARGEST_CODE: u16 = CONVERSIONS * 4095;
/// Steps of a conversion over the full scale.
const LEVELS: f64 = 4096.0;

/// An input of the converter.
///
/// A conversion is the nearest whole number to volts / 3.3 · 4096 plus noise, at most 4095 (RM0090, ADC: the first
/// transition is half a step above 0 V). Gain, offset and linearity have no error. The eight conversions of a sample
/// come within 12 us; the voltage stands meanwhile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Adc {
    /// Standard deviation of a conversion, steps of the converter.
    pub noise_lsb: f64,
    /// Where its noise comes from.
    pub source: u64,
}

impl Adc {
    /// The sample at a tick: the sum of eight conversions, 0 to [`LARGEST_CODE`].
    pub fn sample(&self, volts: f64, tick: u64) -> u16 {
        let ideal = volts * (LEVELS / FULL_SCALE_VOLTS);
        let mut random = bits(self.source, tick);
        let mut sum = 0;
        for _ in 0..CONVERSIONS {
            let level = (ideal + self.noise_lsb * nearly_normal(random) + 0.5).clamp(0.0, LEVELS - 1.0);
            sum += level as u16;
            random = mixed(random.wrapping_add(0x9e37_79b9_7f4a_7c15));
        }
        sum
    }

    /// The voltage that a sample stands for.
    pub fn volts(code: u16) -> f64 {
        f64::from(code) / f64::from(CONVERSIONS) * (FULL_SCALE_VOLTS / LEVELS)
    }
}
