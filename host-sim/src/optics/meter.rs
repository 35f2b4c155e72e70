//! One channel of an optical power meter: delay, bandwidth, noise, range.

use super::noise::normal_pair;
use super::{dbm, milliwatts};
use std::collections::VecDeque;
use std::f64::consts::{LN_10, TAU};

/// How good a power meter is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeterOptions {
    /// Standard deviation of a reading, dB; readings of different ticks are independent.
    pub noise_db: f64,
    /// Noise of the dark detector, standard deviation in dBm. A reading is never below it.
    pub floor_dbm: f64,
    /// Power at which the range ends: readings stay there, dBm.
    pub ceiling_dbm: f64,
    /// Bandwidth (-3 dB) of the first-order low pass, Hz.
    pub bandwidth_hz: f64,
    /// From light to reading beside that, ticks of 1 us.
    pub delay_ticks: u64,
}

impl Default for MeterOptions {
    /// 0.003 dB, -60 dBm, +3 dBm, 10 kHz, 20 us.
    fn default() -> Self {
        MeterOptions { noise_db: 0.003, floor_dbm: -60.0, ceiling_dbm: 3.0, bandwidth_hz: 10e3, delay_ticks: 20 }
    }
}

/// For some time a channel is noisier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Burst {
    /// First tick.
    pub from: u64,
    /// First tick after it.
    pub until: u64,
    /// Standard deviation of a reading meanwhile, dB.
    pub noise_db: f64,
}

/// A channel of the meter as time goes on.
///
/// Between two calls the light changes linearly; the low pass of that is exact.
#[derive(Clone, Debug)]
pub struct Meter {
    options: MeterOptions,
    floor_mw: f64,
    ceiling_mw: f64,
    /// Ticks.
    time_constant: f64,
    source: u64,
    /// The channel is noisier for some time.
    pub burst: Option<Burst>,
    /// Light that has not come through yet: when it does, and mW.
    coming: VecDeque<(u64, f64)>,
    /// Behind the delay: up to when, and mW there.
    light: (u64, f64),
    /// Behind the low pass, mW.
    passed: f64,
    reading: f64,
}

impl Meter {
    /// In the dark, at tick 0; `source` of its noise.
    pub fn new(options: MeterOptions, source: u64) -> Self {
        Meter {
            options,
            floor_mw: milliwatts(options.floor_dbm),
            ceiling_mw: milliwatts(options.ceiling_dbm),
            time_constant: 1e6 / (TAU * options.bandwidth_hz),
            source,
            burst: None,
            coming: VecDeque::with_capacity(4),
            light: (0, 0.0),
            passed: 0.0,
            reading: milliwatts(options.floor_dbm),
        }
    }

    /// As if this light had been there for ever.
    pub fn rest(&mut self, tick: u64, mw: f64) {
        self.coming.clear();
        self.light = (tick, mw);
        self.passed = mw;
        self.read(tick);
    }

    /// Light of `mw` milliwatts falls in at `tick`, which must not be before the one of the last call.
    pub fn see(&mut self, tick: u64, mw: f64) {
        self.coming.push_back((tick + self.options.delay_ticks, mw));
        while let Some(knot) = self.coming.front().copied().filter(|(at, _)| *at <= tick) {
            self.pass(knot.0, knot.1);
            self.coming.pop_front();
        }
        if let Some((at, next)) = self.coming.front().copied() {
            let (from, now) = self.light;
            if tick > from {
                let share = (tick - from) as f64 / (at - from) as f64;
                self.pass(tick, now + (next - now) * share);
            }
        }
        self.read(tick);
    }

    /// The light runs straight to a value at a later tick.
    fn pass(&mut self, tick: u64, mw: f64) {
        let (from, before) = self.light;
        if tick > from {
            let time = (tick - from) as f64;
            let lag = (mw - before) / time * self.time_constant;
            self.passed = mw - lag + (self.passed - before + lag) * (-time / self.time_constant).exp();
        }
        self.light = (tick, mw);
    }

    fn read(&mut self, tick: u64) {
        let [relative, dark] = normal_pair(self.source, tick);
        let burst = self.burst.filter(|burst| (burst.from..burst.until).contains(&tick));
        let noise = burst.map_or(self.options.noise_db, |burst| burst.noise_db);
        let gain = (relative * noise * (LN_10 / 10.0)).exp();
        self.reading = (self.passed * gain + self.floor_mw * dark).clamp(self.floor_mw, self.ceiling_mw);
    }

    /// The reading of the last call, mW.
    pub fn milliwatts(&self) -> f64 {
        self.reading
    }

    /// The same in dBm.
    pub fn dbm(&self) -> f64 {
        dbm(self.reading)
    }

    /// The range ends here: the true power may be more.
    pub fn is_saturated(&self) -> bool {
        self.reading >= self.ceiling_mw
    }
}
