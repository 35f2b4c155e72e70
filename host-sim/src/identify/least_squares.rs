//! Linear least squares of any length in bounded memory: a triangular factor to which rows are added.

use nalgebra::{DMatrix, DVector};

/// Singular values of the normalised Jacobian below this share of the largest one count as zero.
pub const RANK_TOLERANCE: f64 = 1e-9;

/// Collects rows `a · x = y` (already divided by their standard deviation).
#[derive(Clone, Debug)]
pub struct Rows {
    unknowns: usize,
    /// The factor so far on top, new rows below it; the last column is the right-hand side.
    stack: DMatrix<f64>,
    filled: usize,
    count: usize,
}

impl Rows {
    /// No rows yet.
    pub fn new(unknowns: usize) -> Self {
        let width = unknowns + 1;
        Rows { unknowns, stack: DMatrix::zeros(width + 256, width), filled: width, count: 0 }
    }

    /// Adds one row.
    pub fn push(&mut self, row: &[f64], right: f64) {
        if self.filled == self.stack.nrows() {
            self.fold();
        }
        for (j, value) in row.iter().enumerate() {
            self.stack[(self.filled, j)] = *value;
        }
        self.stack[(self.filled, self.unknowns)] = right;
        self.filled += 1;
        self.count += 1;
    }

    fn fold(&mut self) {
        let width = self.unknowns + 1;
        let r = self.stack.rows(0, self.filled).clone_owned().qr().r();
        self.stack.fill(0.0);
        self.stack.view_mut((0, 0), (width, width)).copy_from(&r);
        self.filled = width;
    }

    /// Calls back with rows that stand for all that came in: as many as unknowns, and no more.
    pub fn triangle(mut self, mut use_it: impl FnMut(&[f64], f64)) {
        self.fold();
        for i in 0..self.unknowns {
            let row: Vec<f64> = self.stack.row(i).iter().copied().collect();
            use_it(&row[..self.unknowns], row[self.unknowns]);
        }
    }

    /// The triangular system and its singular values.
    pub fn solve(mut self) -> Solution {
        self.fold();
        let n = self.unknowns;
        let mut factor = self.stack.view((0, 0), (n, n)).clone_owned();
        let right: DVector<f64> = self.stack.view((0, n), (n, 1)).column(0).into();
        let scale = DVector::from_fn(n, |j, _| {
            let norm = factor.column(j).norm();
            if norm > 0.0 { norm } else { 1.0 }
        });
        for (j, mut column) in factor.column_iter_mut().enumerate() {
            column /= scale[j];
        }
        let svd = factor.svd(true, true);
        let (u, vt) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
        Solution { scale, values: svd.singular_values, turned: u.tr_mul(&right), vt, rows: self.count }
    }
}

/// A solved system.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Length of each column.
    scale: DVector<f64>,
    /// Singular values of the columns at unit length.
    values: DVector<f64>,
    turned: DVector<f64>,
    vt: DMatrix<f64>,
    /// Rows that came in.
    pub rows: usize,
}

impl Solution {
    fn largest(&self) -> f64 {
        self.values.iter().copied().fold(0.0, f64::max)
    }

    fn counts(&self, i: usize) -> bool {
        self.values[i] > RANK_TOLERANCE * self.largest()
    }

    /// Numerical rank.
    pub fn rank(&self) -> usize {
        (0..self.values.len()).filter(|i| self.counts(*i)).count()
    }

    /// Largest over smallest singular value of those that count for the rank: finite whatever is undetermined.
    pub fn condition(&self) -> f64 {
        let counting = (0..self.values.len()).filter(|i| self.counts(*i)).map(|i| self.values[i]);
        self.largest() / counting.fold(f64::MAX, f64::min)
    }

    /// The step with Levenberg's damping in units of the columns' lengths; 0 gives the least squares solution, the
    /// shortest one when there are several.
    pub fn step(&self, damping: f64) -> DVector<f64> {
        let along = DVector::from_fn(self.values.len(), |i, _| {
            let s = self.values[i];
            if self.counts(i) { self.turned[i] * s / (s * s + damping) } else { 0.0 }
        });
        self.vt.tr_mul(&along).component_div(&self.scale)
    }

    /// Length of a step in standard deviations.
    pub fn sigmas(&self, step: &DVector<f64>) -> f64 {
        let scaled = &self.vt * step.component_mul(&self.scale);
        scaled.component_mul(&self.values).norm()
    }

    /// `(JᵀJ)⁻¹` on what is determined.
    pub fn covariance(&self) -> DMatrix<f64> {
        let root = self.root();
        &root * root.transpose()
    }

    /// A matrix G with covariance G Gᵀ: the leverage of a row a is |aᵀ G|².
    pub fn root(&self) -> DMatrix<f64> {
        let mut root = self.vt.transpose();
        for (i, mut column) in root.column_iter_mut().enumerate() {
            column *= if self.counts(i) { 1.0 / self.values[i] } else { 0.0 };
        }
        for (j, mut row) in root.row_iter_mut().enumerate() {
            row /= self.scale[j];
        }
        root
    }

    /// Directions that change nothing: one vector each, over columns of unit length.
    pub fn null_space(&self) -> Vec<DVector<f64>> {
        (0..self.values.len()).filter(|i| !self.counts(*i)).map(|i| self.vt.row(i).transpose()).collect()
    }
}
