//! Zeros of the lines of diagonals. Each line has an unknown of its own; all are eliminated in closed form, so that a
//! file of any number of lines takes one pass over its readings.
//!
//! Least squares with an unknown that adds to all readings of a line is least squares of these readings less their
//! weighted mean (Frisch, Waugh and Lovell). The mean of what is left over is the zero.

use super::fit::Fit;
use super::observe::{Block, Observer};
use super::series::{Kind, Series};
use nalgebra::{DMatrix, DVector};
use std::collections::BTreeMap;

/// Which readings of a file belong to which line. Empty for files of other kinds.
#[derive(Clone, Debug, Default)]
pub struct Lines {
    /// Numbers of the lines, rising.
    numbers: Vec<u32>,
    /// The first reading of each line.
    first: Vec<usize>,
    /// The line of each reading.
    of: Vec<usize>,
}

impl Lines {
    /// Of a file.
    pub fn new(series: &Series) -> Self {
        if series.kind != Kind::Diagonal {
            return Lines::default();
        }
        let mut first = BTreeMap::new();
        for (k, reading) in series.readings.iter().enumerate() {
            first.entry(reading.run).or_insert(k);
        }
        let place: BTreeMap<u32, usize> = first.keys().copied().zip(0..).collect();
        let of = series.readings.iter().map(|reading| place[&reading.run]).collect();
        Lines { numbers: first.keys().copied().collect(), first: first.into_values().collect(), of }
    }

    /// How many zeros the readings tell: those of lines of which something counts.
    fn told(&self, weights: &[f64]) -> usize {
        let mut counts = vec![false; self.numbers.len()];
        self.of.iter().zip(weights).for_each(|(line, weight)| counts[*line] |= *weight > 0.0);
        counts.into_iter().filter(|counts| *counts).count()
    }

    /// The reading from which the distance of reading `k` counts.
    pub fn start(&self, k: usize) -> usize {
        self.first[self.of[k]]
    }
}

/// Measured less computed of one reading without the zero of its line, and the derivatives of what is computed.
#[derive(Clone, Debug, PartialEq)]
pub struct Equation {
    /// nm.
    pub residual: f64,
    /// One for each column.
    pub row: Vec<f64>,
}

/// What the readings of one line have in common.
#[derive(Clone, Debug)]
struct Common {
    /// Sum of the weights.
    weight: f64,
    /// The weighted mean; of a line of which nothing counts the plain one.
    mean: Equation,
}

/// All readings of a file less the weighted mean of their line.
#[derive(Clone, Debug)]
pub struct Centred {
    lines: Lines,
    readings: Vec<Equation>,
    common: Vec<Common>,
}

impl Centred {
    /// Takes the mean from the readings, one equation and one weight (0 to 1) each.
    pub fn new(lines: Lines, mut readings: Vec<Equation>, weights: &[f64]) -> Self {
        let mut sums = vec![0.0; lines.numbers.len()];
        let mut counts = vec![0.0; lines.numbers.len()];
        for (line, weight) in lines.of.iter().zip(weights) {
            sums[*line] += weight;
            counts[*line] += 1.0;
        }
        let width = readings.first().map_or(0, |equation| equation.row.len());
        let none = |weight: &f64| Common { weight: *weight, mean: Equation { residual: 0.0, row: vec![0.0; width] } };
        let mut common: Vec<Common> = sums.iter().map(none).collect();
        for ((equation, line), weight) in readings.iter().zip(&lines.of).zip(weights) {
            let Common { weight: sum, mean } = &mut common[*line];
            let share = if *sum > 0.0 { weight / *sum } else { 1.0 / counts[*line] };
            mean.residual += share * equation.residual;
            mean.row.iter_mut().zip(&equation.row).for_each(|(mean, value)| *mean += share * value);
        }
        for (equation, line) in readings.iter_mut().zip(&lines.of) {
            let mean = &common[*line].mean;
            equation.residual -= mean.residual;
            equation.row.iter_mut().zip(&mean.row).for_each(|(value, mean)| *value -= mean);
        }
        Centred { lines, readings, common }
    }

    /// Reading `k` as the fit sees it.
    pub fn fill(&self, k: usize, block: &mut Block) {
        block.residual[0] = self.readings[k].residual;
        block.rows[0].copy_from_slice(&self.readings[k].row);
        let weight = self.common[self.lines.of[k]].weight;
        block.eliminated = if weight > 0.0 { weight.recip() } else { 0.0 };
    }

    /// Number, zero and its standard deviation of each line; `noise` of one reading, `covariance` of the columns.
    fn zeros(&self, noise: f64, covariance: &DMatrix<f64>) -> Vec<(u32, f64, f64)> {
        let zero = |(number, common): (&u32, &Common)| {
            let row = DVector::from_column_slice(&common.mean.row);
            let own = if common.weight > 0.0 { noise * noise / common.weight } else { 0.0 };
            (*number, common.mean.residual, (own + row.dot(&(covariance * &row))).sqrt())
        };
        self.lines.numbers.iter().zip(&self.common).map(zero).collect()
    }
}

impl Fit<'_> {
    /// The zeros of a file's lines for the report: name, value and standard deviation, nm. `covariance`: of the columns
    /// that the file touches.
    pub(super) fn zeros(&self, index: usize, covariance: &DMatrix<f64>) -> Vec<(String, f64, f64)> {
        let named = |(number, value, sigma)| (format!("zero of line {number}"), value, sigma);
        let centred = self.centred(index);
        centred.iter().flat_map(|c| c.zeros(self.noise[index], covariance)).map(named).collect()
    }

    /// Zeros of lines that are fitted beside the columns of the system.
    pub(super) fn zeros_told(&self) -> usize {
        let told = |(index, file): (usize, &Series)| Lines::new(file).told(&self.weights[index]);
        self.fitted().map(told).sum()
    }

    fn centred(&self, index: usize) -> Option<Centred> {
        let file = &self.series[index];
        if file.kind != Kind::Diagonal {
            return None;
        }
        let observer = Observer::new(&self.layout, &self.state, file, index, self.options.drift, &self.weights[index]);
        observer.into_centred(self.touched(index).len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::least_squares::Rows;

    const WIDTH: usize = 4;
    const NOISE: f64 = 2.5;

    /// Three lines in disorder with columns that have no pattern, and weights as rounds of outliers leave them.
    fn example() -> (Lines, Vec<Equation>, Vec<f64>) {
        let wave = |n: usize| (((n as f64 + 0.3) * 12.9898).sin() * 43_758.545_3).fract();
        let of: Vec<usize> = (0..40).map(|k| (k / 3) % 3).collect();
        let readings = (0..40)
            .map(|k| Equation {
                residual: 30.0 * wave(k),
                row: (0..WIDTH).map(|j| wave(100 + k * WIDTH + j)).collect(),
            })
            .collect();
        let weights = (0..40).map(|k| [1.0, 0.3, 0.0, 1.0, 1e-6][k % 5]).collect();
        (Lines { numbers: vec![3, 7, 8], first: vec![0, 3, 6], of }, readings, weights)
    }

    #[test]
    fn elimination_gives_what_unknowns_of_their_own_give() {
        let (lines, readings, weights) = example();
        let whole_row = |k: usize| {
            let mut row = readings[k].row.clone();
            row.extend((0..3).map(|line| if lines.of[k] == line { 1.0 } else { 0.0 }));
            row
        };
        let solved = |rows: Rows| {
            let solution = rows.solve();
            (solution.step(0.0), solution.covariance())
        };
        let centred = Centred::new(lines.clone(), readings.clone(), &weights);
        let (mut all, mut less) = (Rows::new(WIDTH + 3), Rows::new(WIDTH));
        for (k, weight) in weights.iter().enumerate() {
            let scale = weight.sqrt() / NOISE;
            let scaled = |row: &[f64]| row.iter().map(|value| value * scale).collect::<Vec<f64>>();
            all.push(&scaled(&whole_row(k)), readings[k].residual * scale);
            less.push(&scaled(&centred.readings[k].row), centred.readings[k].residual * scale);
        }
        let ((step, covariance), (short, own)) = (solved(all), solved(less));
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
        (0..WIDTH).for_each(|j| near(short[j], step[j]));
        (0..WIDTH).for_each(|j| (0..WIDTH).for_each(|i| near(own[(i, j)], covariance[(i, j)])));
        let mut block = Block::new(WIDTH);
        for (k, reading) in readings.iter().enumerate() {
            let row = DVector::from(whole_row(k));
            centred.fill(k, &mut block);
            let part = DVector::from_column_slice(&block.rows[0]);
            near(block.residual[0] - part.dot(&short), reading.residual - row.dot(&step));
            let leverage = part.dot(&(&own * &part)) / NOISE.powi(2) + block.eliminated;
            near(leverage, row.dot(&(&covariance * &row)) / NOISE.powi(2));
        }
        // at the solution what is left has the zero as its mean
        let at_solution = |k: usize| {
            let fitted: f64 = readings[k].row.iter().zip(short.iter()).map(|(a, x)| a * x).sum();
            Equation { residual: readings[k].residual - fitted, row: readings[k].row.clone() }
        };
        let there = Centred::new(lines, (0..readings.len()).map(at_solution).collect(), &weights);
        for (i, (number, zero, sigma)) in there.zeros(NOISE, &own).into_iter().enumerate() {
            assert_eq!(number, [3, 7, 8][i]);
            near(zero, step[WIDTH + i]);
            near(sigma, covariance[(WIDTH + i, WIDTH + i)].sqrt());
        }
    }

    #[test]
    fn a_line_of_which_nothing_counts_tells_nothing_and_takes_nothing() {
        let (lines, readings, mut weights) = example();
        (0..weights.len()).filter(|k| lines.of[*k] == 1).for_each(|k| weights[k] = 0.0);
        let centred = Centred::new(lines, readings, &weights);
        assert_eq!(centred.lines.told(&weights), 2);
        assert!(centred.readings.iter().all(|equation| equation.residual.is_finite()));
    }
}
