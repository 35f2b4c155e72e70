//! The light at rest, read so that a bad reading is not taken for a good one.
//!
//! Every level is read twice. Both agree within what the meter's noise explains, or they are read again until a burst has
//! passed, which several pairs in succession tell and not one by chance, or until the patience is over.

use super::bus::Bus;
use super::program::Program;
use super::trouble::Trouble;
use crate::bench_twin::Side;

/// Time of a mean with the meter in front of it, s.
pub(super) const CALM_S: f64 = 0.01;
/// Samples of a mean at rest, of 256 us.
pub(super) const CALM_AVERAGE: usize = 32;
/// What two readings may differ by in full light, dB: ten times what they do on a bench that is well.
const STEADY_DB: f64 = 0.02;
/// Standard deviations of the dark noise that two means may differ by.
const DEVIATIONS: f64 = 6.0;
/// Pairs in succession that agree when a burst has passed.
const CALM_AGAIN: usize = 5;
/// How long an unsteady light is waited for, s.
const PATIENCE_S: f64 = 1.0;
/// What a controller answers for a saturated input (SCPI-99, 7.2.1.4: infinity), and above any level.
const SATURATED: f64 = 9.9e37;

/// What two means in the same light differ by at most, dB.
fn steady_db(level_dbm: f64, dark_dbm: f64) -> f64 {
    let dark = 10.0 / std::f64::consts::LN_10 * 10f64.powf(0.1 * (dark_dbm - level_dbm));
    STEADY_DB + DEVIATIONS * (2.0 / CALM_AVERAGE as f64).sqrt() * dark
}

impl<B: Bus> Program<'_, B> {
    /// Both power inputs where the stages stand now, dBm; a saturated one is infinite, a dark one at most the noise of the
    /// meter.
    pub(super) fn calm_powers(&mut self) -> Result<[f64; 2], Trouble> {
        let dark_dbm = self.options.dark_dbm;
        let level = |level: f64| if level >= SATURATED { f64::INFINITY } else { level.max(dark_dbm) };
        let until = self.bus.seconds() + PATIENCE_S;
        let mut wanted = 1;
        loop {
            let mut controller = self.at(Side::Output);
            controller.pause(CALM_S)?;
            let readings = [controller.powers()?, controller.powers()?];
            let pairs: [[f64; 2]; 2] = std::array::from_fn(|input| readings.map(|reading| level(reading[input])));
            let steady = |[first, second]: [f64; 2]| {
                first.max(second) == f64::INFINITY
                    || (first - second).abs() <= steady_db(0.5 * (first + second), dark_dbm)
            };
            let Some(input) = (0..2).find(|input| !steady(pairs[*input])) else {
                wanted -= 1;
                if wanted == 0 {
                    return Ok(pairs.map(|[first, second]| 0.5 * (first + second)));
                }
                continue;
            };
            wanted = CALM_AGAIN;
            if self.bus.seconds() >= until {
                let (from, pair_dbm) = (self.sees[input], pairs[input]);
                return Err(Trouble::Unsteady { from, input, pair_dbm, seconds: PATIENCE_S });
            }
        }
    }

    /// A level of an input, if it is one of light.
    pub(super) fn lit(&self, input: usize, level_dbm: f64) -> Result<f64, Trouble> {
        let (from, least_dbm) = (self.sees[input], self.options.light_dbm);
        match level_dbm {
            f64::INFINITY => Err(Trouble::Saturated { from, input }),
            _ if level_dbm < least_dbm => Err(Trouble::Dark { from, input, level_dbm, least_dbm }),
            _ => Ok(level_dbm),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_the_dark_readings_may_differ_more() {
        assert!((steady_db(-10.0, -60.0) - STEADY_DB).abs() < 1e-3);
        assert!(steady_db(-40.0, -60.0) > 0.05 && steady_db(-60.0, -60.0) > 6.0);
    }
}
