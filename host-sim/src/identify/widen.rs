//! Uncertainties where the residuals depend on positions: such errors do not average out like noise.
//!
//! The 24 constants are fitted as before. What position-dependent errors do to them is treated as in consider analysis
//! (S. F. Schmidt 1966; Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. VIII): parameters
//! that act on the readings but are not estimated add `S L S'` to the covariance, where S is the sensitivity of the
//! estimates to them and L their own variance. L is told by the residuals: variance components of the functions'
//! coefficients by maximum likelihood with the fitted constants projected out (Patterson and Thompson, Biometrika 58,
//! 1971), found by expectation maximisation.

use super::fit::Fit;
use super::observe::{Block, Observer};
use super::position_errors::{PositionErrors, Shape};
use super::series::Kind;
use nalgebra::{Cholesky, DMatrix, DVector};
use stage_controller::units::Axis;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Residuals that depend on positions by chance are reported in fewer than one of so many files.
const FALSE_ALARM: f64 = 1e-5;
/// A column of which less than this part of its length is left beside others tells nothing of its own: an unknown, and
/// a function, which must be well above what rounding leaves of unknowns.
const NOTHING: [f64; 2] = [1e-8, 1e-3];
/// Highest degree that is looked for in the residuals of one file.
const TESTED: usize = 3;
/// Values of a file with which it is looked for; of a longer one every so manyth reading.
const TESTED_ROWS: usize = 2000;
/// Rows that are added to a product at once.
const ROWS: usize = 384;
/// Rounds of expectation maximisation for all stages together, and for each.
const ROUNDS: [usize; 2] = [15, 40];

/// What position-dependent errors add.
pub(super) struct Widening {
    /// Covariance to be added to that of the unknowns.
    pub added: DMatrix<f64>,
    /// One sentence for each file that shows it.
    pub warnings: Vec<String>,
}

/// Weighted rows of some readings of a file: columns of its unknowns (as touched), of the functions, the residuals.
struct Sample {
    unknowns: usize,
    /// Degrees of freedom that zeros of lines have taken from the rows.
    eliminated: f64,
    rows: DMatrix<f64>,
}

impl Fit<'_> {
    /// None where no file's residuals depend on positions beyond chance.
    pub(super) fn widening(&self, covariance: &DMatrix<f64>) -> Option<Widening> {
        let width = self.layout.width;
        let errors = PositionErrors::new(self.fitted().map(|(_, file)| file), width);
        let files: Vec<_> = self.fitted().filter(|(_, file)| file.kind != Kind::Squareness).collect();
        let mut warnings = Vec::new();
        for (index, file) in &files {
            let Some(found) = self.sample(*index, &errors).test(&errors.shapes) else { continue };
            let axes: Vec<&str> = found.axes.iter().map(|axis| axis.name()).collect();
            warnings.push(format!(
                "{}: the residuals depend on the positions of {} (F = {:.1} for {} and {} degrees of freedom): the stage \
                 has position-dependent errors (EXX ... ECC) that the constants do not describe; the uncertainties are \
                 widened by what such errors can do to the constants.",
                file.file,
                axes.join(", "),
                found.ratio,
                found.degrees.0,
                found.degrees.1
            ));
        }
        if warnings.is_empty() {
            return None;
        }
        let extra = errors.shapes.len();
        let (mut own, mut cross) = (DMatrix::zeros(extra, extra), DMatrix::zeros(width, extra));
        let mut right = DVector::zeros(extra);
        for (index, _) in files {
            let touched = self.touched(index);
            let n = touched.len();
            let gram = self.products(index, &errors);
            own += gram.view((n, n), (extra, extra));
            for (i, column) in touched.iter().enumerate() {
                let mut row = cross.row_mut(*column);
                row += gram.view((i, n), (1, extra));
            }
            right += gram.view((n, n + extra), (extra, 1)).column(0);
        }
        let sensitivity = covariance * &cross;
        let projected = own - cross.tr_mul(&sensitivity);
        let variances = variances(&errors.shapes, &projected, &right);
        let scaled = DMatrix::from_fn(width, extra, |i, j| sensitivity[(i, j)] * variances[j].sqrt());
        Some(Widening { added: &scaled * scaled.transpose(), warnings })
    }

    /// Some rows of a file, as many as the test needs.
    fn sample(&self, index: usize, errors: &PositionErrors) -> Sample {
        let file = &self.series[index];
        let stride = (file.readings.len() * file.kind.columns().len()).div_ceil(TESTED_ROWS).max(1);
        let unknowns = self.touched(index).len();
        let (mut rows, mut eliminated) = (Vec::new(), 0.0);
        self.each_row(index, errors, stride, |row, taken| {
            rows.extend_from_slice(row);
            eliminated += taken;
        });
        let size = unknowns + errors.shapes.len() + 1;
        Sample { unknowns, eliminated, rows: DMatrix::from_row_slice(rows.len() / size, size, &rows) }
    }

    /// Products of all columns of a file with one another.
    fn products(&self, index: usize, errors: &PositionErrors) -> DMatrix<f64> {
        let size = self.touched(index).len() + errors.shapes.len() + 1;
        let mut gram = DMatrix::zeros(size, size);
        let mut rows: DMatrix<f64> = DMatrix::zeros(ROWS, size);
        let mut filled = 0;
        self.each_row(index, errors, 1, |row, _| {
            if filled == ROWS {
                gram.gemm_tr(1.0, &rows, &rows, 1.0);
                rows.fill(0.0);
                filled = 0;
            }
            rows.row_mut(filled).copy_from_slice(row);
            filled += 1;
        });
        gram.gemm_tr(1.0, &rows, &rows, 1.0);
        gram
    }

    /// Calls back with the weighted rows of every so manyth reading that counts, and with the share of a degree of
    /// freedom that was eliminated from each.
    fn each_row(&self, index: usize, errors: &PositionErrors, stride: usize, mut use_it: impl FnMut(&[f64], f64)) {
        let width = self.layout.width;
        let file = &self.series[index];
        let touched = self.touched(index);
        let (drift, weights) = (self.options.drift, &self.weights[index]);
        let observer =
            Observer::new(&self.layout, &self.state, file, index, drift, weights).with_position_errors(errors);
        let mut block = Block::new(width + errors.shapes.len());
        let mut row = vec![0.0; touched.len() + errors.shapes.len() + 1];
        let counting = self.weights[index].iter().enumerate().filter(|(_, weight)| **weight > 0.0);
        for (k, weight) in counting.step_by(stride) {
            observer.fill(k, &mut block);
            let scale = weight.sqrt() / self.noise[index];
            for c in 0..file.kind.columns().len() {
                let unknowns = touched.iter().map(|column| block.rows[c][*column]);
                let values = unknowns.chain(block.rows[c][width..].iter().copied()).chain([block.residual[c]]);
                row.iter_mut().zip(values).for_each(|(to, value)| *to = value * scale);
                use_it(&row, weight * block.eliminated);
            }
        }
    }
}

/// Residuals that depend on positions.
struct Dependence {
    /// Mean square that the functions take over the mean square that is left.
    ratio: f64,
    /// Of both.
    degrees: (usize, usize),
    /// Motors whose functions take most.
    axes: Vec<Axis>,
}

impl Sample {
    /// F test of the functions beside the unknowns that the file can tell.
    fn test(&self, shapes: &[Shape]) -> Option<Dependence> {
        let (n, rows) = (self.unknowns, self.rows.nrows());
        let free = rows.saturating_sub(self.eliminated.round() as usize);
        let tested: Vec<(usize, Shape)> =
            shapes.iter().copied().enumerate().filter(|(_, shape)| shape.degree <= TESTED).collect();
        let mut basis = Basis::new(rows, n + tested.len());
        for j in 0..n {
            basis.take(self.rows.column(j).into_owned(), NOTHING[0]);
        }
        let mut left: DVector<f64> = self.rows.column(n + shapes.len()).into_owned();
        for k in 0..basis.taken {
            let along = basis.columns.column(k).dot(&left);
            left.axpy(-along, &basis.columns.column(k), 1.0);
        }
        // as many functions as a third of what is left can tell, the low degrees first
        let (told, most) = (basis.taken, free.saturating_sub(basis.taken) / 3);
        let mut gains = [0.0; 6];
        for (j, shape) in tested {
            if basis.taken - told < most && basis.take(self.rows.column(n + j).into_owned(), NOTHING[1]) {
                let along = basis.columns.column(basis.taken - 1).dot(&left);
                left.axpy(-along, &basis.columns.column(basis.taken - 1), 1.0);
                gains[shape.axis.index()] += along * along;
            }
        }
        let (taken, rest) = (basis.taken - told, free.saturating_sub(basis.taken));
        if taken == 0 || rest == 0 {
            return None;
        }
        let (gain, most) = (gains.iter().sum::<f64>(), gains.iter().copied().fold(0.0, f64::max));
        let ratio = gain / taken as f64 / (left.norm_squared() / rest as f64).max(f64::MIN_POSITIVE);
        // the chance of a ratio that is beyond all chance is beyond some distributions too
        let chance = FisherSnedecor::new(taken as f64, rest as f64).ok()?.sf(ratio.min(1e6));
        let axes = Axis::ALL.into_iter().filter(|axis| gains[axis.index()] > 0.2 * most).collect();
        (chance < FALSE_ALARM).then_some(Dependence { ratio, degrees: (taken, rest), axes })
    }
}

/// Orthonormal columns, by Gram and Schmidt, twice each.
struct Basis {
    columns: DMatrix<f64>,
    taken: usize,
}

impl Basis {
    fn new(rows: usize, most: usize) -> Self {
        Basis { columns: DMatrix::zeros(rows, most), taken: 0 }
    }

    /// Takes the part of a column that is none of the others', if it is more than a share of its length.
    fn take(&mut self, mut column: DVector<f64>, share: f64) -> bool {
        let length = column.norm();
        let others = self.columns.columns(0, self.taken);
        for _ in 0..2 {
            let along = others.tr_mul(&column);
            column.gemv(-1.0, &others, &along, 1.0);
        }
        let left = column.norm();
        let counts = left > share * length && self.taken < self.columns.nrows();
        if counts {
            self.columns.set_column(self.taken, &(column / left));
            self.taken += 1;
        }
        counts
    }
}

/// Variance of each coefficient (nm^2 or nrad^2): one for all displacements and one for all rotations of a stage, so
/// that what the measurements do not show has the size of what they do.
fn variances(shapes: &[Shape], product: &DMatrix<f64>, right: &DVector<f64>) -> Vec<f64> {
    let together: Vec<usize> = shapes.iter().map(|shape| usize::from(shape.is_angular())).collect();
    let each: Vec<usize> = shapes.iter().map(|s| 2 * s.axis.index() + usize::from(s.is_angular())).collect();
    let mut variances: Vec<f64> =
        shapes.iter().map(|shape| if shape.is_angular() { 5e3_f64.powi(2) } else { 1e2_f64.powi(2) }).collect();
    for (groups, rounds) in [together, each].iter().zip(ROUNDS) {
        for _ in 0..rounds {
            let Some(next) = maximise(groups, &variances, product, right) else { return variances };
            variances = next;
        }
    }
    variances
}

/// One round of expectation maximisation: variances from the coefficients' posterior.
fn maximise(groups: &[usize], before: &[f64], product: &DMatrix<f64>, right: &DVector<f64>) -> Option<Vec<f64>> {
    let n = before.len();
    let sigma: Vec<f64> = before.iter().map(|variance| variance.sqrt()).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| {
        let one = if i == j { 1.0 } else { 0.0 };
        one + 0.5 * (product[(i, j)] + product[(j, i)]) * sigma[i] * sigma[j]
    });
    let inverse = Cholesky::new(scaled)?.inverse();
    let mean = &inverse * DVector::from_fn(n, |i, _| right[i] * sigma[i]);
    let mut sums = [(0.0, 0.0); 12];
    for (i, group) in groups.iter().enumerate() {
        sums[*group].0 += before[i] * (mean[i] * mean[i] + inverse[(i, i)]);
        sums[*group].1 += 1.0;
    }
    Some(groups.iter().map(|group| sums[*group].0 / sums[*group].1).collect())
}
