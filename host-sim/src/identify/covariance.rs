//! Covariances as far as they are asked for: of the common unknowns, and of each file's own with these.

use super::bordered::Joint;
use nalgebra::DMatrix;

/// Covariance of the common unknowns, and of each file's with the common ones first.
#[derive(Clone)]
pub(super) struct Covariance {
    pub common: DMatrix<f64>,
    pub files: Vec<DMatrix<f64>>,
}

impl Covariance {
    /// By the noise of a fit over so many files.
    pub(super) fn new(joint: &Joint, files: usize) -> Self {
        let of = |index: usize| {
            let root = joint.root(index);
            &root * root.transpose()
        };
        Covariance { common: joint.common_covariance(), files: (0..files).map(of).collect() }
    }

    /// Variance of the own unknown `k` of a file.
    pub(super) fn own(&self, file: usize, k: usize) -> f64 {
        let at = self.common.nrows() + k;
        self.files[file][(at, at)]
    }
}

/// Sums of the products of all columns of rows that come one by one.
pub(super) struct Products {
    sum: DMatrix<f64>,
    /// One row in each column.
    rows: DMatrix<f64>,
    filled: usize,
}

/// Rows that are added at once.
const AT_ONCE: usize = 384;

impl Products {
    pub(super) fn new(size: usize) -> Self {
        Products { sum: DMatrix::zeros(size, size), rows: DMatrix::zeros(size, AT_ONCE), filled: 0 }
    }

    pub(super) fn push(&mut self, row: impl Iterator<Item = f64>) {
        if self.filled == AT_ONCE {
            self.add();
        }
        self.rows.column_mut(self.filled).iter_mut().zip(row).for_each(|(to, value)| *to = value);
        self.filled += 1;
    }

    fn add(&mut self) {
        let rows = self.rows.columns(0, self.filled);
        self.sum.gemm(1.0, &rows, &rows.transpose(), 1.0);
        self.filled = 0;
    }

    pub(super) fn sum(mut self) -> DMatrix<f64> {
        self.add();
        self.sum
    }
}
