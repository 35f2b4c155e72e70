//! Uncertainties where the residuals depend on positions: such errors do not average out like noise.
//!
//! The 24 constants are fitted as before. What position-dependent errors do to them is treated as in consider analysis
//! (S. F. Schmidt 1966; Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. VIII): parameters
//! that act on the readings but are not estimated add `S L S'` to the covariance, where S is the sensitivity of the
//! estimates to them and L their own variance. L is told by the residuals: variance components of the functions'
//! coefficients by maximum likelihood with the fitted constants projected out (Patterson and Thompson, Biometrika 58,
//! 1971), found by expectation maximisation.

use super::bordered::Joint;
use super::covariance::{Covariance, Products};
use super::fit::Fit;
use super::freedom::student_factor;
use super::observe::{Block, Observer};
use super::position_errors::{PositionErrors, Shape};
use super::series::Kind;
use nalgebra::{Cholesky, DMatrix, DVector};
use stage_controller::units::Axis;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use std::collections::BTreeMap;

/// Residuals that depend on positions by chance are reported in fewer than one of so many files.
const FALSE_ALARM: f64 = 1e-5;
/// A column of which less than this part of its length is left beside others tells nothing of its own: an unknown, and
/// a function, which must be well above what rounding leaves of unknowns.
const NOTHING: [f64; 2] = [1e-8, 1e-3];
/// Highest degree that is looked for in the residuals of one file.
const TESTED: usize = 3;
/// Values of a file with which it is looked for; of a longer one every so manyth reading.
const TESTED_ROWS: usize = 2000;
/// Variance of the coefficient of a degree over that of the degree below. Smooth errors have most in the low ones: q^3
/// is 3/5 P1 + 2/5 P3, that is 0.44 of two degrees; q^2 and half a wave have it in P2 and P1.
const FALLING: f64 = 0.4;
/// Coefficients for which the size of what all stages together show counts beside those of one stage.
const BELIEVED: f64 = 1.0;
/// Most rounds in which variances are sought; a change by this share ends them.
const ROUNDS: usize = 60;
const SETTLED: f64 = 0.02;

/// What position-dependent errors add.
pub(super) struct Widening {
    /// Covariance to be added to that of the unknowns.
    pub added: Covariance,
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

/// What the rows of a file say of the functions.
struct Share {
    index: usize,
    /// Of its unknowns, the common ones first, with the functions.
    cross: DMatrix<f64>,
    /// Of its unknowns with the residuals.
    right: DVector<f64>,
    /// (noise stated / noise of the fit)^2.
    trust: f64,
}

impl Fit<'_> {
    /// None where no file's residuals depend on positions beyond chance.
    pub(super) fn widening(&self, joint: &Joint) -> Option<Widening> {
        let errors = PositionErrors::new(self.fitted().map(|(_, file)| file));
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
        // the residuals are judged by the noise that is stated: the fit's may hold the very errors that are looked for
        let stated: Vec<f64> =
            self.series.iter().zip(&self.noise).map(|(file, noise)| file.noise.unwrap_or(*noise)).collect();
        let judging = self.assemble_with_parts(&self.state, &stated).0.solve();
        let extra = errors.shapes.len();
        let (mut own, mut right) = (DMatrix::zeros(extra, extra), DVector::zeros(extra));
        let mut shares = Vec::new();
        for (index, _) in files {
            let n = self.touched(index).len();
            let products = self.products(index, &errors, stated[index]);
            own += products.view((n, n), (extra, extra));
            right += products.view((n, n + extra), (extra, 1)).column(0);
            shares.push(Share {
                index,
                cross: products.view((0, n), (n, extra)).into_owned(),
                right: products.view((0, n + extra), (n, 1)).column(0).into_owned(),
                trust: (stated[index] / self.noise[index]).powi(2),
            });
        }
        let seen = Sensitivity::new(&judging, &shares, |_| 1.0);
        for share in &shares {
            let of = seen.of(share.index);
            own -= share.cross.tr_mul(&of);
            right -= of.tr_mul(&share.right);
        }
        for prior in self.priors.iter().filter(|prior| prior.column < self.layout.common()) {
            let pull = (prior.value - self.value(&self.state, prior.column)) / prior.sigma.powi(2);
            right -= seen.common.row(prior.column).transpose() * pull;
        }
        let variances = variances(&errors.shapes, &own, &right);
        let felt = Sensitivity::new(joint, &shares, |share| share.trust);
        let scaled = |sensitivity: &DMatrix<f64>| {
            let mut scaled = sensitivity.clone();
            scaled.column_iter_mut().zip(&variances).for_each(|(mut column, variance)| column *= variance.sqrt());
            &scaled * scaled.transpose()
        };
        let files = (0..self.series.len()).map(|index| scaled(&felt.of(index))).collect();
        Some(Widening { added: Covariance { common: scaled(&felt.common), files }, warnings })
    }

    /// Some rows of a file, as many as the test needs.
    fn sample(&self, index: usize, errors: &PositionErrors) -> Sample {
        let file = &self.series[index];
        let stride = (file.readings.len() * file.kind.columns().len()).div_ceil(TESTED_ROWS).max(1);
        let unknowns = self.touched(index).len();
        let (mut rows, mut eliminated) = (Vec::new(), 0.0);
        self.each_row(index, errors, stride, self.noise[index], |row, taken| {
            rows.extend_from_slice(row);
            eliminated += taken;
        });
        let size = unknowns + errors.shapes.len() + 1;
        Sample { unknowns, eliminated, rows: DMatrix::from_row_slice(rows.len() / size, size, &rows) }
    }

    /// Products of all columns of a file with one another.
    fn products(&self, index: usize, errors: &PositionErrors, noise: f64) -> DMatrix<f64> {
        let mut products = Products::new(self.touched(index).len() + errors.shapes.len() + 1);
        self.each_row(index, errors, 1, noise, |row, _| products.push(row.iter().copied()));
        products.sum()
    }

    /// Calls back with the weighted rows of every so manyth reading that counts, and with the share of a degree of
    /// freedom that was eliminated from each.
    fn each_row(
        &self,
        index: usize,
        errors: &PositionErrors,
        stride: usize,
        noise: f64,
        mut use_it: impl FnMut(&[f64], f64),
    ) {
        let file = &self.series[index];
        let size = self.touched(index).len() + errors.shapes.len();
        let (drift, weights) = (self.options.drift, &self.weights[index]);
        let observer =
            Observer::new(&self.layout, &self.state, file, index, drift, weights).with_position_errors(errors);
        let mut block = Block::new(size);
        let mut row = vec![0.0; size + 1];
        let counting = self.weights[index].iter().enumerate().filter(|(_, weight)| **weight > 0.0);
        for (k, weight) in counting.step_by(stride) {
            observer.fill(k, &mut block);
            let scale = weight.sqrt() / noise;
            for c in 0..file.kind.columns().len() {
                let values = block.rows[c].iter().copied().chain([block.residual[c]]);
                row.iter_mut().zip(values).for_each(|(to, value)| *to = value * scale);
                use_it(&row, weight * block.eliminated);
            }
        }
    }
}

/// How the unknowns of a fit follow the functions.
struct Sensitivity<'a> {
    joint: &'a Joint,
    /// Of the common unknowns: one column for each function.
    common: DMatrix<f64>,
    /// The part of each file, by its index.
    parts: BTreeMap<usize, DMatrix<f64>>,
}

impl<'a> Sensitivity<'a> {
    fn new(joint: &'a Joint, shares: &[Share], trust: impl Fn(&Share) -> f64) -> Self {
        let width = joint.common();
        let extra = shares.first().map_or(0, |share| share.cross.ncols());
        let mut common = DMatrix::zeros(width, extra);
        let mut parts = BTreeMap::new();
        for share in shares {
            let root = joint.root(share.index);
            let part = &root * root.tr_mul(&share.cross) * trust(share);
            common += part.rows(0, width);
            parts.insert(share.index, part);
        }
        Sensitivity { joint, common, parts }
    }

    /// Of a file's unknowns, the common ones first.
    fn of(&self, index: usize) -> DMatrix<f64> {
        let follow = self.joint.follow(index);
        let Some(part) = self.parts.get(&index) else { return follow * &self.common };
        // its own unknowns follow what the other files say through the common ones alone
        follow * (&self.common - part.rows(0, self.common.nrows())) + part
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

/// Variance of each coefficient (nm^2 or nrad^2): one for all displacements and one for all rotations of a stage, which
/// falls with the degree. What the measurements do not show has the size of what they do.
fn variances(shapes: &[Shape], product: &DMatrix<f64>, right: &DVector<f64>) -> Vec<f64> {
    let together: Vec<usize> = shapes.iter().map(|shape| usize::from(shape.is_angular())).collect();
    let each: Vec<usize> = shapes.iter().map(|s| 2 * s.axis.index() + usize::from(s.is_angular())).collect();
    let falling: Vec<f64> = shapes.iter().map(|shape| FALLING.powi(shape.degree as i32 - 1)).collect();
    let first = |shape: &Shape| if shape.is_angular() { 5e3_f64.powi(2) } else { 1e2_f64.powi(2) };
    let mut levels: Vec<f64> = shapes.iter().map(first).collect();
    let mut told = vec![0.0; shapes.len()];
    for (groups, believed) in [(together, 0.0), (each, BELIEVED)] {
        let before = levels.clone();
        for _ in 0..ROUNDS {
            let Some(next) = level(&groups, &falling, (&before, believed), &levels, product, right) else { break };
            let changed = next.0.iter().zip(&levels).any(|(next, level)| (next / level - 1.0).abs() > SETTLED);
            (levels, told) = next;
            if !changed {
                break;
            }
        }
    }
    let widened = |(level, told): (&f64, &f64)| level * student_factor(told + BELIEVED, 3.0).powi(2);
    levels.iter().zip(&told).map(widened).zip(falling).map(|(level, falling)| level * falling).collect()
}

/// One round: the level of each coefficient's group by the squares of what is told of its coefficients over their number,
/// each counted as far as it is told (MacKay, Neural Computation 4, 1992: the fixed point is that of expectation
/// maximisation, and comes sooner). And this number.
fn level(
    groups: &[usize],
    falling: &[f64],
    (before, believed): (&[f64], f64),
    levels: &[f64],
    product: &DMatrix<f64>,
    right: &DVector<f64>,
) -> Option<(Vec<f64>, Vec<f64>)> {
    let n = levels.len();
    let sigma: Vec<f64> = levels.iter().zip(falling).map(|(level, falling)| (level * falling).sqrt()).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| {
        let one = if i == j { 1.0 } else { 0.0 };
        one + 0.5 * (product[(i, j)] + product[(j, i)]) * sigma[i] * sigma[j]
    });
    let inverse = Cholesky::new(scaled)?.inverse();
    let mean = &inverse * DVector::from_fn(n, |i, _| right[i] * sigma[i]);
    let mut sums = [(0.0, 0.0); 12];
    for (i, group) in groups.iter().enumerate() {
        sums[*group].0 += levels[i] * mean[i] * mean[i];
        sums[*group].1 += (1.0 - inverse[(i, i)]).max(0.0);
    }
    let next = |(i, group): (usize, &usize)| {
        let (squares, told) = sums[*group];
        let level = (squares + believed * before[i]) / (told + believed).max(1e-3);
        level.max(1e-6 * before[i])
    };
    let told = groups.iter().map(|group| sums[*group].1).collect();
    Some((groups.iter().enumerate().map(next).collect(), told))
}
