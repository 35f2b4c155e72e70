//! Light between modes, and what a power meter and the board's converter make of it.

use host_sim::optics::noise::{nearly_normal, normal_pair};
use host_sim::optics::{
    Adc, Array, ArraySize, Burst, DARK_DBM, FrontEnd, LARGEST_CODE, Medium, Meter, MeterOptions, Misalignment, Mode,
    Pair, Splitter, SplitterSize, dbm, milliwatts,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

const GLUE: Medium = Medium { wavelength_um: 1.55, index: 1.5 };

/// A complex number.
type Complex = [f64; 2];

/// A Gaussian of waist radius `w` after a way `z` in one transverse direction, by its angular spectrum: nothing of the
/// closed form is used, no q and no radius of curvature.
struct Spectrum {
    /// Transverse wave number and amplitude after the way.
    waves: Vec<(f64, Complex)>,
}

impl Spectrum {
    fn new(w: f64, z: f64, medium: Medium) -> Self {
        let k = 2.0 * PI * medium.index / medium.wavelength_um;
        let (step, reach) = (0.02, 12.6 / w);
        let count = (reach / step).ceil() as i32;
        let waves = (-count..=count).map(|i| {
            let kx = step * f64::from(i);
            // Fourier transform of (2 / pi w^2)^(1/4) exp(-x^2 / w^2), over 2 pi
            let amplitude = (2.0 / (PI * w * w)).powf(0.25) * w / (2.0 * PI.sqrt()) * (-0.25 * kx * kx * w * w).exp();
            let (sin, cos) = (kx * kx * z / (2.0 * k)).sin_cos();
            (kx, [amplitude * cos * step, amplitude * sin * step])
        });
        Spectrum { waves: waves.collect() }
    }

    fn at(&self, x: f64) -> Complex {
        self.waves.iter().fold([0.0; 2], |[re, im], (kx, [a, b])| {
            let (sin, cos) = (-kx * x).sin_cos();
            [re + a * cos - b * sin, im + a * sin + b * cos]
        })
    }
}

/// Share of the power in one transverse direction, by quadrature over the fibre's face.
fn integrated(guide: f64, fibre: f64, d: f64, z: f64, tilt: f64) -> f64 {
    let k = 2.0 * PI * GLUE.index / GLUE.wavelength_um;
    let light = Spectrum::new(guide, z, GLUE);
    let (step, reach) = (0.25, 6.2 * fibre);
    let count = (reach / step).ceil() as i32;
    let mut sum = [0.0; 2];
    for i in -count..=count {
        let s = step * f64::from(i);
        let [re, im] = light.at(d + s);
        let mode = (2.0 / (PI * fibre * fibre)).powf(0.25) * (-s * s / (fibre * fibre)).exp();
        // complex conjugate of exp(-i k tilt s)
        let (sin, cos) = (k * tilt * s).sin_cos();
        sum[0] += mode * (re * cos - im * sin) * step;
        sum[1] += mode * (re * sin + im * cos) * step;
    }
    sum[0] * sum[0] + sum[1] * sum[1]
}

#[test]
fn the_overlap_is_the_integral_of_the_fields_to_1e_9() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut between = |a: f64, b: f64| random.random_range(a..b);
    let (mut worst, mut least) = (0.0_f64, 1.0_f64);
    for case in 0..60 {
        let [guide, fibre] = [0; 2].map(|_| Mode { radius_um: [0; 2].map(|_| between(4.0, 6.5)) });
        let at = Misalignment {
            offset_um: [0; 2].map(|_| between(-8.0, 8.0)),
            gap_um: between(0.0, 120.0),
            tilt_rad: [0; 2].map(|_| between(-0.06, 0.06)),
        };
        let [x, y] = [0, 1]
            .map(|i| integrated(guide.radius_um[i], fibre.radius_um[i], at.offset_um[i], at.gap_um, at.tilt_rad[i]));
        let closed = Pair::new(guide, fibre, GLUE).coupling(&at);
        worst = worst.max((closed / (x * y) - 1.0).abs());
        least = least.min(closed);
        assert!((closed / (x * y) - 1.0).abs() < 1e-9, "case {case}: {closed} and {}", x * y);
        let loss = Pair::new(guide, fibre, GLUE).loss_db(&at);
        assert!((loss + 10.0 * closed.log10()).abs() < 1e-10);
    }
    assert!(least < 0.05, "some of them couple badly: {least}");
    println!("figure: overlap against quadrature, 60 cases, largest relative difference {worst:.1e}");
}

#[test]
fn equal_modes_lose_what_the_textbook_says() {
    let w = 5.381;
    let pair = Pair::new(Mode::round(w), Mode::round(w), GLUE);
    let db = 10.0 / std::f64::consts::LN_10;
    let loss = |offset: f64, gap: f64, tilt: f64| {
        pair.loss_db(&Misalignment { offset_um: [offset, 0.0], gap_um: gap, tilt_rad: [0.0, tilt] })
    };
    assert!(loss(0.0, 0.0, 0.0).abs() < 1e-12);
    for i in 1..20 {
        let (d, theta, z) = (0.4 * f64::from(i), 0.004 * f64::from(i), 7.0 * f64::from(i));
        let apart = 10.0 * (1.0 + (z * GLUE.wavelength_um / (2.0 * PI * GLUE.index * w * w)).powi(2)).log10();
        assert!((loss(d, 0.0, 0.0) - db * (d / w).powi(2)).abs() < 1e-10);
        assert!((loss(0.0, 0.0, theta) - db * (PI * 1.5 * w * theta / 1.55).powi(2)).abs() < 1e-10);
        assert!((loss(0.0, z, 0.0) - apart).abs() < 1e-10);
    }
    // the paper: 0.15 dB are 1 um or 0.65 degrees
    assert!((loss(1.0, 0.0, 0.0) - 0.15).abs() < 1e-3);
    assert!((loss(0.0, 0.0, 0.65_f64.to_radians()) - 0.15).abs() < 1e-3);
}

#[test]
fn from_fibre_to_guide_couples_the_same_light_as_from_guide_to_fibre() {
    let (a, b) = (Mode { radius_um: [4.8, 5.5] }, Mode { radius_um: [5.2, 4.4] });
    let (there, back) = (Pair::new(a, b, GLUE), Pair::new(b, a, GLUE));
    let mut random = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..500 {
        let gap_um = random.random_range(0.0..200.0);
        let offset_um = [0; 2].map(|_| random.random_range(-10.0..10.0));
        let tilt_rad = [0; 2].map(|_| random.random_range(-0.08..0.08));
        let from_fibre = Misalignment {
            // the guide beside the axis of the fibre
            offset_um: [0, 1].map(|i| tilt_rad[i] * gap_um - offset_um[i]),
            gap_um,
            tilt_rad,
        };
        let [there, back] = [there.loss_db(&Misalignment { offset_um, gap_um, tilt_rad }), back.loss_db(&from_fibre)];
        assert!((there - back).abs() < 1e-9, "{there} {back}");
    }
}

#[test]
fn a_fibre_that_looks_at_the_guide_sees_more_than_one_that_looks_away() {
    let pair = Pair::new(Mode::round(4.8), Mode::round(5.2), GLUE);
    let loss = |tilt: f64| pair.loss_db(&Misalignment { offset_um: [30.0, 0.0], gap_um: 600.0, tilt_rad: [tilt, 0.0] });
    assert!(loss(0.05) < loss(0.0) && loss(0.0) < loss(-0.05));
}

#[test]
fn unequal_modes_lose_light_where_they_fit_best() {
    let pair = Pair::new(Mode::round(4.8), Mode::round(5.2), GLUE);
    let fit = 2.0 * 4.8 * 5.2 / (4.8 * 4.8 + 5.2 * 5.2);
    assert!((pair.coupling(&Misalignment::default()) - fit * fit).abs() < 1e-12);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..1000 {
        let at = Misalignment {
            offset_um: [0; 2].map(|_| random.random_range(-3.0..3.0)),
            gap_um: random.random_range(0.0..50.0),
            tilt_rad: [0; 2].map(|_| random.random_range(-0.03..0.03)),
        };
        assert!(pair.coupling(&at) <= fit * fit);
    }
}

#[test]
fn splitter_and_array_are_drawn_with_the_sizes_that_were_asked_for() {
    let mut k = 0;
    let mut normal = || {
        k += 1;
        normal_pair(7, k)[0]
    };
    let splitter = Splitter::draw(&SplitterSize { excess_sigma_db: 0.0, ..SplitterSize::default() }, &mut normal);
    assert_eq!(splitter.loss_db.len(), 8);
    assert!(splitter.loss_db.iter().all(|loss| (loss - (9.0309 + 0.6)).abs() < 1e-4));
    assert!((dbm(splitter.total()) + 0.6).abs() < 1e-9, "the outputs together lose the excess alone");
    let size = ArraySize { channels: 4000, pitch_um: 250.0, core_sigma_um: 0.25 };
    let array = Array::draw(&size, &mut normal);
    let rms = |c: usize| {
        let off = |(i, core): (usize, &[f64; 2])| (core[c] + if c == 0 { 250.0 * i as f64 } else { 0.0 }).powi(2);
        (array.cores_um.iter().enumerate().map(off).sum::<f64>() / 4000.0).sqrt()
    };
    assert!((rms(0) / 0.25 - 1.0).abs() < 0.05 && (rms(1) / 0.25 - 1.0).abs() < 0.05);
}

fn quiet() -> MeterOptions {
    MeterOptions { noise_db: 0.0, floor_dbm: -150.0, ceiling_dbm: 10.0, bandwidth_hz: 2000.0, delay_ticks: 100 }
}

#[test]
fn a_step_of_light_comes_after_the_delay_and_through_the_low_pass() {
    let tau = 1e6 / (2.0 * PI * 2000.0);
    for pace in [1, 7, 64] {
        let mut meter = Meter::new(quiet(), 1);
        meter.rest(0, 0.0);
        meter.see(1000, 0.0);
        meter.see(1001, 1.0);
        let mut tick = 1001;
        while tick < 3000 {
            tick += pace;
            meter.see(tick, 1.0);
            // the step runs up within one tick
            let time = tick as f64 - 1100.5;
            let expected = if time < 0.0 { 0.0 } else { 1.0 - (-time / tau).exp() };
            if time.abs() > 1.0 {
                assert!((meter.milliwatts() - expected).abs() < 1e-4, "{tick}: {} {expected}", meter.milliwatts());
            }
        }
    }
}

#[test]
fn of_light_that_rises_evenly_the_meter_is_late_by_delay_and_time_constant() {
    let late = 100.0 + 1e6 / (2.0 * PI * 2000.0);
    let mut meter = Meter::new(quiet(), 1);
    meter.rest(0, 1.0);
    for k in 1..100_u64 {
        let tick = 256 * k;
        meter.see(tick, 1.0 + 1e-5 * tick as f64);
    }
    let expected = 1.0 + 1e-5 * (256.0 * 99.0 - late);
    assert!((meter.milliwatts() - expected).abs() < 1e-9);
}

/// Mean and standard deviation.
fn spread(values: &[f64]) -> [f64; 2] {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    [mean, square.sqrt()]
}

#[test]
fn readings_scatter_by_the_stated_noise_and_more_in_a_burst() {
    let mut meter = Meter::new(MeterOptions::default(), 5);
    meter.burst = Some(Burst { from: 256 * 20_000, until: 256 * 40_000, noise_db: 0.3 });
    meter.rest(0, 0.1);
    let mut read = |from: u64| -> Vec<f64> {
        let ticks = (from + 1..=from + 19_999).map(|k| 256 * k);
        ticks
            .map(|tick| {
                meter.see(tick, 0.1);
                meter.dbm()
            })
            .collect()
    };
    let [mean, sigma] = spread(&read(0));
    assert!((mean + 10.0).abs() < 1e-4 && (sigma / 0.003 - 1.0).abs() < 0.03, "{mean} {sigma}");
    let [_, sigma] = spread(&read(20_000));
    assert!((sigma / 0.3 - 1.0).abs() < 0.03, "{sigma}");
    let [_, sigma] = spread(&read(40_000));
    assert!((sigma / 0.003 - 1.0).abs() < 0.03, "{sigma}");
}

#[test]
fn the_range_has_a_floor_of_noise_and_a_ceiling_that_is_told() {
    let mut meter = Meter::new(MeterOptions::default(), 5);
    let mut dark = Vec::new();
    for k in 1..10_000 {
        meter.see(256 * k, 0.0);
        dark.push(meter.dbm());
    }
    assert!(dark.iter().all(|dbm| (-60.0 - 1e-9..-53.0).contains(dbm)));
    assert!(dark.iter().any(|dbm| *dbm > -59.0) && !meter.is_saturated());
    meter.rest(256 * 10_001, 10.0);
    assert!(meter.is_saturated());
    assert!((meter.dbm() - 3.0).abs() < 1e-9);
}

#[test]
fn front_ends_give_volts_that_lead_back_to_the_power() {
    for power in [1e-5, 1e-3, 0.1, 0.21] {
        for front_end in [FrontEnd::LINEAR, FrontEnd::LOGARITHMIC] {
            assert!((front_end.power(front_end.volts(power)) / power - 1.0).abs() < 1e-12);
        }
    }
    assert!((FrontEnd::LINEAR.volts(0.1) - 1.5).abs() < 1e-12);
    assert!((FrontEnd::LOGARITHMIC.volts(milliwatts(-10.0)) - 2.5).abs() < 1e-12);
    assert_eq!(FrontEnd::LOGARITHMIC.volts(0.0), 0.0, "no front end gives less than 0 V");
    assert_eq!(dbm(0.0), DARK_DBM);
}

#[test]
fn a_sample_is_the_sum_of_eight_conversions_with_their_noise() {
    let still = Adc { noise_lsb: 0.0, source: 1 };
    assert_eq!(still.sample(0.0, 9), 0);
    assert_eq!(still.sample(5.0, 9), LARGEST_CODE);
    assert_eq!(LARGEST_CODE, 8 * 4095);
    for level in [1_u16, 100, 2048, 4095] {
        let volts = f64::from(level) * 3.3 / 4096.0;
        assert_eq!(still.sample(volts, 9), 8 * level);
        assert!((Adc::volts(8 * level) - volts).abs() < 1e-12);
    }
    let noisy = Adc { noise_lsb: 1.5, source: 1 };
    let samples: Vec<f64> = (0..20_000).map(|k| f64::from(noisy.sample(1.2345, 256 * k))).collect();
    let [mean, sigma] = spread(&samples);
    assert!((mean - 8.0 * 1.2345 * 4096.0 / 3.3).abs() < 0.15, "noise spreads what rounding would lose: {mean}");
    let expected = (8.0 * (1.5 * 1.5 + 1.0 / 12.0_f64)).sqrt();
    assert!((sigma / expected - 1.0).abs() < 0.03, "{sigma} {expected}");
    assert_eq!(noisy.sample(1.2345, 77), noisy.sample(1.2345, 77), "the same at the same tick");
}

#[test]
fn the_noise_of_neighbouring_ticks_and_sources_is_independent() {
    let of = |source: u64| -> Vec<f64> { (0..50_000).flat_map(|k| normal_pair(source, 256 * k)).collect() };
    let (a, b) = (of(1), of(2));
    let product = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>() / x.len() as f64;
    let [mean, sigma] = spread(&a);
    assert!(mean.abs() < 0.015 && (sigma - 1.0).abs() < 0.01, "{mean} {sigma}");
    assert!(product(&a, &b).abs() < 0.015);
    assert!(product(&a[1..], &a).abs() < 0.015 && product(&a[2..], &a).abs() < 0.015);
    let beyond = a.iter().filter(|v| v.abs() > 3.0).count() as f64 / a.len() as f64;
    assert!((beyond / 0.0027 - 1.0).abs() < 0.3, "{beyond}");
    let near: Vec<f64> = (0..50_000).map(|k| nearly_normal(host_sim::optics::noise::bits(3, k))).collect();
    let [mean, sigma] = spread(&near);
    assert!(mean.abs() < 0.02 && (sigma - 1.0).abs() < 0.01, "{mean} {sigma}");
}
