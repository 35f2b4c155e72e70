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
const ROUNDS: [usize; 2] = [30, 60];

/// What position-dependent errors add.
pub(super) struct Widening {
    /// Covariance to be added to that of the unknowns.
    pub added: DMatrix<f64>,
    /// Index of the file and its sentence.
    pub warnings: Vec<(usize, String)>,
}

/// Products of all columns of a file: its unknowns (as touched), the functions, the residuals.
struct Products {
    touched: Vec<usize>,
    gram: DMatrix<f64>,
    /// Some of the rows themselves.
    sample: DMatrix<f64>,
}

impl Fit<'_> {
    /// None where no file's residuals depend on positions beyond chance.
    pub(super) fn widening(&self, covariance: &DMatrix<f64>) -> Option<Widening> {
        let width = self.layout.width;
        let errors = PositionErrors::new(self.fitted().map(|(_, file)| file), width);
        if errors.shapes.is_empty() {
            return None;
        }
        let extra = errors.shapes.len();
        let mut warnings = Vec::new();
        let (mut own, mut cross) = (DMatrix::zeros(extra, extra), DMatrix::zeros(width, extra));
        let mut right = DVector::zeros(extra);
        for (index, file) in self.fitted().filter(|(_, file)| file.kind != Kind::Squareness) {
            let products = self.products(index, &errors);
            let n = products.touched.len();
            if let Some(test) = products.test(&errors.shapes) {
                let axes: Vec<&str> = test.axes.iter().map(|axis| axis.name()).collect();
                warnings.push((
                    index,
                    format!(
                        "{}: the residuals depend on the positions of {} (F = {:.1} for {} and {} degrees of freedom): \
                         the stage has position-dependent errors (EXX ... ECC) that the constants do not describe; the \
                         uncertainties are widened by what such errors can do to the constants.",
                        file.file,
                        axes.join(", "),
                        test.ratio,
                        test.degrees.0,
                        test.degrees.1
                    ),
                ));
            }
            own += products.gram.view((n, n), (extra, extra));
            for (i, column) in products.touched.iter().enumerate() {
                let mut row = cross.row_mut(*column);
                row += products.gram.view((i, n), (1, extra));
            }
            right += products.gram.view((n, n + extra), (extra, 1)).column(0);
        }
        if warnings.is_empty() {
            return None;
        }
        let sensitivity = covariance * &cross;
        let projected = own - cross.tr_mul(&sensitivity);
        let variances = variances(&errors.shapes, &projected, &right);
        let scaled = DMatrix::from_fn(width, extra, |i, j| sensitivity[(i, j)] * variances[j].sqrt());
        Some(Widening { added: &scaled * scaled.transpose(), warnings })
    }

    fn products(&self, index: usize, errors: &PositionErrors) -> Products {
        let (width, extra) = (self.layout.width, errors.shapes.len());
        let file = &self.series[index];
        let touched = self.touched(index);
        let n = touched.len();
        let size = n + extra + 1;
        let mut gram = DMatrix::zeros(size, size);
        let mut rows: DMatrix<f64> = DMatrix::zeros(ROWS, size);
        let columns = file.kind.columns().len();
        let stride = (file.readings.len() * columns).div_ceil(TESTED_ROWS).max(1);
        let mut sample: DMatrix<f64> = DMatrix::zeros(file.readings.len().div_ceil(stride) * columns, size);
        let (mut filled, mut sampled) = (0, 0);
        let observer =
            Observer::new(&self.layout, &self.state, file, index, self.options.drift).with_position_errors(errors);
        let mut block = Block::new(width + extra);
        for (k, weight) in self.weights[index].iter().enumerate().filter(|(_, weight)| **weight > 0.0) {
            observer.fill(k, &mut block);
            let scale = weight.sqrt() / self.noise[index];
            for c in 0..columns {
                if filled == ROWS {
                    gram.gemm_tr(1.0, &rows, &rows, 1.0);
                    rows.fill(0.0);
                    filled = 0;
                }
                for (i, column) in touched.iter().enumerate() {
                    rows[(filled, i)] = block.rows[c][*column] * scale;
                }
                for j in 0..extra {
                    rows[(filled, n + j)] = block.rows[c][width + j] * scale;
                }
                rows[(filled, n + extra)] = block.residual[c] * scale;
                if k % stride == 0 {
                    sample.row_mut(sampled).copy_from(&rows.row(filled));
                    sampled += 1;
                }
                filled += 1;
            }
        }
        gram.gemm_tr(1.0, &rows, &rows, 1.0);
        Products { touched, gram, sample: sample.rows(0, sampled).into_owned() }
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

impl Products {
    /// F test of the functions beside the unknowns that the file can tell.
    fn test(&self, shapes: &[Shape]) -> Option<Dependence> {
        let (n, rows) = (self.touched.len(), self.sample.nrows());
        let tested: Vec<(usize, Shape)> =
            shapes.iter().copied().enumerate().filter(|(_, shape)| shape.degree <= TESTED).collect();
        let mut basis = Basis::new(rows, n + tested.len());
        for j in 0..n {
            basis.take(self.sample.column(j).into_owned(), NOTHING[0]);
        }
        let mut left: DVector<f64> = self.sample.column(n + shapes.len()).into_owned();
        for k in 0..basis.taken {
            let along = basis.columns.column(k).dot(&left);
            left.axpy(-along, &basis.columns.column(k), 1.0);
        }
        // as many functions as a third of what is left can tell, the low degrees first
        let (told, most) = (basis.taken, rows.saturating_sub(basis.taken) / 3);
        let mut gains = [0.0; 6];
        for (j, shape) in tested {
            if basis.taken - told < most && basis.take(self.sample.column(n + j).into_owned(), NOTHING[1]) {
                let along = basis.columns.column(basis.taken - 1).dot(&left);
                left.axpy(-along, &basis.columns.column(basis.taken - 1), 1.0);
                gains[shape.axis.index()] += along * along;
            }
        }
        let (taken, rest) = (basis.taken - told, rows.saturating_sub(basis.taken));
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
