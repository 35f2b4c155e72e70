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
        Rows { unknowns, stack: DMatrix::zeros(width + 256, width), filled: 0, count: 0 }
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
        let r = triangular(self.stack.rows(0, self.filled).clone_owned());
        self.stack.view_mut((0, 0), r.shape()).copy_from(&r);
        self.filled = r.nrows();
    }

    /// Rows that came in.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Rows that stand for all that came in, at most as many as unknowns; the right-hand side is the last column.
    pub fn into_triangle(mut self) -> DMatrix<f64> {
        self.fold();
        self.stack.rows(0, self.filled.min(self.unknowns)).clone_owned()
    }

    /// Calls back with rows that stand for all that came in: as many as unknowns, and no more.
    pub fn triangle(self, mut use_it: impl FnMut(&[f64], f64)) {
        let unknowns = self.unknowns;
        let triangle = self.into_triangle();
        for i in 0..unknowns {
            let row: Vec<f64> =
                if i < triangle.nrows() { triangle.row(i).iter().copied().collect() } else { vec![0.0; unknowns + 1] };
            use_it(&row[..unknowns], row[unknowns]);
        }
    }

    /// The triangular system and its singular values.
    pub fn solve(mut self) -> Solution {
        self.fold();
        let rows = self.filled.min(self.unknowns);
        let scale = DVector::from_fn(self.unknowns, |j, _| {
            let norm = self.stack.view((0, j), (rows, 1)).norm();
            if norm > 0.0 { norm } else { 1.0 }
        });
        self.solve_with(scale)
    }

    /// The same with lengths of the columns that are given.
    pub fn solve_with(mut self, scale: DVector<f64>) -> Solution {
        self.fold();
        let n = self.unknowns;
        let (mut factor, mut right) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for i in 0..self.filled.min(n) {
            factor.row_mut(i).copy_from(&self.stack.view((i, 0), (1, n)));
            right[i] = self.stack[(i, n)];
        }
        for (j, mut column) in factor.column_iter_mut().enumerate() {
            column /= scale[j];
        }
        let svd = factor.svd(true, true);
        let (u, vt) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
        Solution { scale, values: svd.singular_values, turned: u.tr_mul(&right), vt }
    }
}

/// The triangular factor of a matrix by Householder's reflections, column by column.
fn triangular(mut a: DMatrix<f64>) -> DMatrix<f64> {
    let (rows, columns) = a.shape();
    let most = rows.min(columns);
    let values = a.as_mut_slice();
    for j in 0..most {
        let (done, rest) = values.split_at_mut((j + 1) * rows);
        let pivot = &mut done[j * rows + j..];
        let length = pivot.iter().map(|v| v * v).sum::<f64>().sqrt();
        if length == 0.0 {
            continue;
        }
        let head = if pivot[0] > 0.0 { -length } else { length };
        pivot[0] -= head;
        // v'v = 2 length (length + |first|)
        let factor = -1.0 / (head * pivot[0]);
        for column in rest.chunks_exact_mut(rows) {
            let column = &mut column[j..];
            let along = dot(pivot, column) * factor;
            column.iter_mut().zip(pivot.iter()).for_each(|(c, v)| *c -= along * v);
        }
        pivot.fill(0.0);
        pivot[0] = head;
    }
    a.rows(0, most).clone_owned()
}

/// In eight sums, which a processor adds at once.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 8];
    let (a8, b8) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a8.remainder().iter().zip(b8.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a8.zip(b8) {
        (0..8).for_each(|i| sums[i] += a[i] * b[i]);
    }
    sums.iter().sum::<f64>() + rest
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
}

impl Solution {
    /// Length of each column.
    pub fn lengths(&self) -> &DVector<f64> {
        &self.scale
    }

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
