//! Readings so far from the rest of their file that no stage could show them: a slipped decimal point, a lost sign.
//!
//! They are set aside before the first fit, which they would pull to where it finds no end, and come back if they fit
//! after all.

use super::fit::Fit;
use super::series::{Kind, Series};
use super::units::Quantity;
use super::weights::MOST_REJECTED;
use crate::machine::LARGEST_STATIC;

/// So many times the median distance from the median of the file's column. Poses all over the travels have residuals
/// against the nominal machine that are sums of products of two or three positions; the largest of those is about 12
/// times their median.
const FACTOR: f64 = 50.0;
/// And at least what the errors of a stage can do where all the other readings are at home: its largest static errors,
/// added up, times the way and the lever ...
const STATICS: f64 = 5.0 * LARGEST_STATIC;
/// ... and rotary axes some mm beside where the drawing has them, nm.
const OFFSETS: f64 = 1e6;

/// The value that is farthest from its file, for messages.
#[derive(Clone, Debug)]
pub(super) struct Farthest {
    pub index: usize,
    pub reading: usize,
    pub column: usize,
    /// From the median of its column, nm or nrad.
    pub by: f64,
    share: f64,
}

impl Fit<'_> {
    /// Looks at the residuals against the machine from which the fit starts.
    pub(super) fn set_wild_ones_aside(&mut self) {
        for (index, file) in self.fitted().filter(|(_, file)| file.kind != Kind::Squareness) {
            let floor = self.floor(file);
            let mut residuals: Vec<[f64; 3]> = Vec::with_capacity(file.readings.len());
            self.each_reading(&self.state, index, |_, block| residuals.push(block.residual));
            let mut wild = vec![false; residuals.len()];
            for column in 0..file.kind.columns().len() {
                for (k, by, share) in distances(file, &residuals, column, floor) {
                    wild[k] |= share > 1.0;
                    if self.farthest.as_ref().is_none_or(|farthest| share > farthest.share) {
                        self.farthest = Some(Farthest { index, reading: k, column, by, share });
                    }
                }
            }
            let count = wild.iter().filter(|wild| **wild).count();
            // so many are not typing errors
            if self.options.reject && count as f64 <= MOST_REJECTED * wild.len() as f64 {
                wild.iter().zip(&mut self.weights[index]).filter(|(wild, _)| **wild).for_each(|(_, w)| *w = 0.0);
                self.wild[index] = wild;
            }
        }
    }

    /// Distances below this are never wild, nm or nrad.
    fn floor(&self, file: &Series) -> f64 {
        match file.kind.quantity() {
            Quantity::Angle => STATICS * 1e9,
            Quantity::Length => {
                let motors = file.readings.iter().flat_map(|reading| &reading.motors[..3]);
                let way = motors.fold(0.0_f64, |most, motor| most.max(motor.abs()));
                let lever = self.state.machine.fibre_point_nm.iter().map(|v| v * v).sum::<f64>().sqrt();
                STATICS * (way + lever) + OFFSETS
            }
        }
    }

    /// What to say where a fit does not end.
    pub(super) fn farthest_reading(&self) -> Option<String> {
        let farthest = self.farthest.as_ref()?;
        let file = &self.series[farthest.index];
        Some(format!(
            "{}:{}: {} is farthest from the others of its file, by {:.3} {}",
            file.file,
            file.readings[farthest.reading].line,
            file.kind.columns()[farthest.column],
            farthest.by,
            file.kind.quantity().unit()
        ))
    }
}

/// Of each reading its distance from the median of its zero (the file, or its line of a diagonal), and that as a share
/// of what is believed.
fn distances(file: &Series, residuals: &[[f64; 3]], column: usize, floor: f64) -> Vec<(usize, f64, f64)> {
    let zero = |k: usize| if file.kind == Kind::Diagonal { file.readings[k].run } else { 0 };
    let mut zeros: Vec<u32> = (0..residuals.len()).map(zero).collect();
    zeros.sort_unstable();
    zeros.dedup();
    let mut off = vec![0.0; residuals.len()];
    for run in zeros {
        let of_run: Vec<usize> = (0..residuals.len()).filter(|k| zero(*k) == run).collect();
        let middle = median(of_run.iter().map(|k| residuals[*k][column]).collect());
        of_run.iter().for_each(|k| off[*k] = residuals[*k][column] - middle);
    }
    let believed = (FACTOR * median(off.iter().map(|off| off.abs()).collect())).max(floor);
    off.into_iter().enumerate().map(|(k, off)| (k, off, off.abs() / believed)).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
