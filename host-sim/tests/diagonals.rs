//! Identification from diagonals of any number: ISO 230-6 lines, each with its own zero.

mod stage;

use host_sim::identify::{Identification, Options, Refusal, identify, parse};
use host_sim::machine::Machine;
use host_sim::measure::{Settings, measure, nominal};
use host_sim::model::Chain;
use nalgebra::Vector3;
use stage::{Dice, golden};
use std::fmt::Write;

/// Standard deviation of a distance, um.
const NOISE_UM: f64 = 0.05;
const POINTS: usize = 11;

/// Lines in any direction through the travel as a file, each with a zero of its own; the readings with these numbers
/// are 5 um too long.
fn diagonals(truth: &Machine, numbers: impl Iterator<Item = u32>, spoiled: &[usize]) -> String {
    let mut dice = Dice::new(6);
    let chain = Chain::new(truth);
    let mut text = format!("# kind: diagonal\n# noise_um: {NOISE_UM}\nline,at_X_um,at_Y_um,at_Z_um,distance_um\n");
    let mut count = 0;
    for number in numbers {
        let from = dice.direction() * 2e6;
        let way = dice.direction() * dice.between(3e6, 5e6);
        let zero = dice.between(-1.0, 1.0);
        let mut start = None;
        for k in 0..POINTS {
            let at = from + way * (k as f64 / (POINTS - 1) as f64);
            let there = chain.true_pose([at.x, at.y, at.z, 0.0, 0.0, 0.0]);
            let point = Vector3::new(there[0], there[1], there[2]);
            let start = *start.get_or_insert(point);
            // twelve even ones have the variance of a normal one
            let noise: f64 = (0..12).map(|_| dice.between(-0.5, 0.5)).sum::<f64>() * NOISE_UM;
            let off = if spoiled.contains(&count) { 5.0 } else { 0.0 };
            let distance = (point - start).norm() * 1e-3 + zero + noise + off;
            let [x, y, z] = [at.x, at.y, at.z].map(|v| v * 1e-3);
            writeln!(text, "{number},{x:.6},{y:.6},{z:.6},{distance:.6}").unwrap();
            count += 1;
        }
    }
    text
}

/// All files of a stage, with other diagonals.
fn fit(truth: &Machine, text: &str) -> Result<Identification, Refusal> {
    let known = nominal(truth);
    let files = measure(truth, &Settings::default());
    let own = |file: &str, other: String| if file == "diagonal.csv" { text.to_string() } else { other };
    let series: Vec<_> =
        files.into_iter().map(|f| parse(&f.file, &own(&f.file, f.text), &known.order).unwrap()).collect();
    identify(&series, &known, &Options::default(), &mut |_| {})
}

#[test]
fn eleven_thousand_readings_of_a_thousand_lines_take_no_time_of_note() {
    let truth = golden("long-lever").0;
    let lines = if cfg!(debug_assertions) { 100 } else { 1000 };
    let spoiled: Vec<usize> = (0..20).map(|n| 7 + 53 * n).collect();
    let text = diagonals(&truth, 1..=lines, &spoiled);
    let since = std::time::Instant::now();
    let result = fit(&truth, &text).unwrap();
    let seconds = since.elapsed().as_secs_f64();
    println!("figure: {} readings in {lines} lines, with all other files in {seconds:.2} s", POINTS * lines as usize);
    assert!(seconds <= 3.0);
    let file = result.files.iter().find(|file| file.kind == "diagonal").unwrap();
    assert_eq!((file.readings, file.nuisances.len()), (POINTS * lines as usize, lines as usize));
    // three header lines stand before the first reading
    let named: Vec<usize> =
        result.outliers.iter().filter(|o| o.file == file.file).map(|o| o.line as usize - 4).collect();
    assert_eq!(named, spoiled);
    assert!((file.rms / (NOISE_UM * 1e3) - 1.0).abs() < 0.1, "{}", file.rms);
    assert!(result.probability.is_some_and(|p| p > 1e-3), "{:?}", result.probability);
    assert_eq!(result.rank, result.unknowns);
    for (name, value) in [("S_ZX", truth.statics.S_ZX), ("S_ZY", truth.statics.S_ZY), ("S_XY", truth.statics.S_XY)] {
        let found = result.estimate(&format!("static_rad.{name}")).unwrap();
        assert!((found.value - value).abs() < 4.0 * found.sigma, "{name}");
    }
}

#[test]
fn the_zero_of_every_line_is_reported_with_its_uncertainty() {
    let truth = golden("long-lever").0;
    let result = fit(&truth, &diagonals(&truth, 1..=40, &[])).unwrap();
    let file = result.files.iter().find(|file| file.kind == "diagonal").unwrap();
    let mut dice = Dice::new(6);
    let mut squares = 0.0;
    for (number, (name, value, sigma)) in (1..).zip(&file.nuisances) {
        assert_eq!(*name, format!("zero of line {number}"));
        let _ = (dice.direction(), dice.direction(), dice.between(3e6, 5e6));
        let zero = dice.between(-1.0, 1.0) * 1e3;
        (0..12 * POINTS).for_each(|_| _ = dice.between(-0.5, 0.5));
        squares += ((value - zero) / sigma).powi(2);
        // no better than eleven readings
        assert!(*sigma > NOISE_UM * 1e3 / (POINTS as f64).sqrt() * 0.999, "{sigma}");
    }
    assert!((15.0..75.0).contains(&squares), "{squares} of 40 zeros");
}

#[test]
fn a_line_may_have_any_number_and_must_not_go_back() {
    let truth = golden("long-lever").0;
    let text = diagonals(&truth, [u32::MAX, 4].into_iter(), &[]);
    assert!(fit(&truth, &text).is_ok());
    let mut lines: Vec<&str> = text.lines().collect();
    lines.swap(6, 7);
    let message = fit(&truth, &lines.join("\n")).unwrap_err().to_string();
    assert!(message.contains("diagonal.csv:8: line 4294967295 is not monotonic"), "{message}");
}
