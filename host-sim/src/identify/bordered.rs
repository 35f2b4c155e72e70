//! Least squares over many files: unknowns that all files have in common, and a few that each file has alone.
//!
//! What a file has alone is eliminated from its own triangle by singular values, and only what is left over tells the
//! common unknowns. The work grows with the readings and not with the number of files times their unknowns.

use super::least_squares::{RANK_TOLERANCE, Rows, Solution};
use nalgebra::{DMatrix, DVector};

/// The eliminated unknowns of a file: `values[i] * y[i] + across[i] . x = right[i]` with `y = turn * (lengths * own)`.
#[derive(Clone, Debug)]
struct Eliminated {
    lengths: DVector<f64>,
    turn: DMatrix<f64>,
    /// 0 where nothing is told.
    values: DVector<f64>,
    across: DMatrix<f64>,
    right: DVector<f64>,
}

impl Eliminated {
    /// Own unknowns that belong to values of y.
    fn own(&self, y: &DVector<f64>) -> DVector<f64> {
        self.turn.tr_mul(y).component_div(&self.lengths)
    }

    fn rank(&self) -> usize {
        self.values.iter().filter(|value| **value > 0.0).count()
    }
}

/// The system of all files.
#[derive(Clone, Debug)]
pub struct Bordered {
    /// First column of each file's own behind the common ones.
    first: Vec<usize>,
    width: usize,
    /// What is left for the common unknowns.
    rows: Rows,
    /// Squares of the lengths of the common columns before anything was eliminated.
    squares: DVector<f64>,
    files: Vec<Option<Eliminated>>,
    count: usize,
}

impl Bordered {
    /// `first`: the first own column of each file, the common ones come before all.
    pub fn new(first: &[usize], common: usize, width: usize) -> Self {
        Bordered {
            first: first.to_vec(),
            width,
            rows: Rows::new(common),
            squares: DVector::zeros(common),
            files: vec![None; first.len()],
            count: 0,
        }
    }

    /// One row of the common unknowns.
    pub fn push(&mut self, row: &[f64], right: f64) {
        self.squares.iter_mut().zip(row).for_each(|(square, value)| *square += value * value);
        self.rows.push(row, right);
        self.count += 1;
    }

    /// All rows of a file; of its columns the own ones come first. Returns what they tell the common unknowns.
    pub fn add(&mut self, index: usize, file: Rows) -> Vec<(Vec<f64>, f64)> {
        let common = self.squares.len();
        self.count += file.count();
        let triangle = file.into_triangle();
        let (most, own) = (triangle.nrows(), triangle.ncols() - 1 - common);
        for j in 0..common {
            self.squares[j] += triangle.column(own + j).norm_squared();
        }
        let mut left: Vec<(Vec<f64>, f64)> = Vec::new();
        if own > 0 {
            let top = DMatrix::from_fn(own, own + common + 1, |i, j| if i < most { triangle[(i, j)] } else { 0.0 });
            let lengths = DVector::from_fn(own, |j, _| {
                let length = top.column(j).norm();
                if length > 0.0 { length } else { 1.0 }
            });
            let unit = DMatrix::from_fn(own, own, |i, j| top[(i, j)] / lengths[j]);
            let svd = unit.svd(true, true);
            let (u, turn) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
            let mut across = u.tr_mul(&top.columns(own, common));
            let mut right: DVector<f64> = u.tr_mul(&top.column(own + common));
            let largest = svd.singular_values.max();
            let mut values = svd.singular_values;
            for i in 0..own {
                // such a row has none of the file's own any more
                if values[i] <= RANK_TOLERANCE * largest {
                    values[i] = 0.0;
                    left.push((across.row(i).iter().copied().collect(), right[i]));
                    across.row_mut(i).fill(0.0);
                    right[i] = 0.0;
                }
            }
            self.files[index] = Some(Eliminated { lengths, turn, values, across, right });
        }
        for i in own..most {
            let row = triangle.row(i);
            left.push((row.columns(own, common).iter().copied().collect(), row[own + common]));
        }
        left.iter().for_each(|(row, right)| self.rows.push(row, *right));
        left
    }

    /// The solution of all.
    pub fn solve(self) -> Joint {
        let lengths = self.squares.map(|square| if square > 0.0 { square.sqrt() } else { 1.0 });
        Joint { common: self.rows.clone().solve_with(lengths), system: self }
    }
}

/// A solved system.
#[derive(Clone, Debug)]
pub struct Joint {
    common: Solution,
    system: Bordered,
}

impl Joint {
    /// Rows that came in.
    pub fn rows(&self) -> usize {
        self.system.count
    }

    /// Numerical rank of all.
    pub fn rank(&self) -> usize {
        self.common.rank() + self.system.files.iter().flatten().map(Eliminated::rank).sum::<usize>()
    }

    /// Of the common unknowns beside those of the files.
    pub fn condition(&self) -> f64 {
        self.common.condition()
    }

    /// The step of all unknowns with Levenberg's damping in units of the columns' lengths.
    pub fn step(&self, damping: f64) -> DVector<f64> {
        let system = &self.system;
        let x = if damping == 0.0 {
            self.common.step(0.0)
        } else {
            let mut rows = system.rows.clone();
            for file in system.files.iter().flatten() {
                for (i, value) in file.values.iter().enumerate().filter(|(_, value)| **value > 0.0) {
                    let share = (damping / (value * value + damping)).sqrt();
                    let row: Vec<f64> = file.across.row(i).iter().map(|entry| entry * share).collect();
                    rows.push(&row, file.right[i] * share);
                }
            }
            rows.solve_with(self.common.lengths().clone()).step(damping)
        };
        let mut step = DVector::zeros(system.width);
        step.rows_mut(0, x.len()).copy_from(&x);
        for (first, file) in system.first.iter().zip(&system.files) {
            let Some(file) = file else { continue };
            let across = &file.across * &x;
            let y = DVector::from_fn(file.values.len(), |i, _| {
                let value = file.values[i];
                if value > 0.0 { value * (file.right[i] - across[i]) / (value * value + damping) } else { 0.0 }
            });
            step.rows_mut(*first, y.len()).copy_from(&file.own(&y));
        }
        step
    }

    /// Length of a step in standard deviations.
    pub fn sigmas(&self, step: &DVector<f64>) -> f64 {
        let x = step.rows(0, self.system.squares.len()).into_owned();
        let mut square = self.common.sigmas(&x).powi(2);
        for (first, file) in self.system.first.iter().zip(&self.system.files) {
            let Some(file) = file else { continue };
            let own = step.rows(*first, file.lengths.len()).component_mul(&file.lengths);
            square += ((&file.turn * own).component_mul(&file.values) + &file.across * &x).norm_squared();
        }
        square.sqrt()
    }

    /// Directions that change nothing, of unit length over columns of unit length: their common part.
    pub fn null_space(&self) -> Vec<DVector<f64>> {
        let lengths = self.common.lengths();
        let mut whole: Vec<(DVector<f64>, DVector<f64>)> = Vec::new();
        for x in self.common.null_space() {
            let moved = x.component_div(lengths);
            let mut own = Vec::new();
            for file in self.system.files.iter().flatten() {
                let across = &file.across * &moved;
                own.extend((0..across.len()).filter(|i| file.values[*i] > 0.0).map(|i| -across[i] / file.values[i]));
            }
            let (mut x, mut own) = (x, DVector::from(own));
            for (other, others) in &whole {
                let along = other.dot(&x) + others.dot(&own);
                x -= other * along;
                own -= others * along;
            }
            let length = x.norm_squared() + own.norm_squared();
            whole.push((x / length.sqrt(), own / length.sqrt()));
        }
        whole.into_iter().map(|(x, _)| x).collect()
    }

    /// How many unknowns are common.
    pub fn common(&self) -> usize {
        self.system.squares.len()
    }

    /// Covariance of the common unknowns.
    pub fn common_covariance(&self) -> DMatrix<f64> {
        self.common.covariance()
    }

    /// How a file's unknowns, the common ones first, follow the common ones: ones above its own.
    pub fn follow(&self, index: usize) -> DMatrix<f64> {
        let common = self.system.squares.len();
        let own = self.system.files[index].as_ref().map(|file| {
            let inverse = DMatrix::from_fn(file.values.len(), common, |i, j| {
                if file.values[i] > 0.0 { -file.across[(i, j)] / file.values[i] } else { 0.0 }
            });
            let mut own = file.turn.tr_mul(&inverse);
            own.row_iter_mut().zip(file.lengths.iter()).for_each(|(mut row, length)| row /= *length);
            own
        });
        let m = own.as_ref().map_or(0, |own| own.nrows());
        let mut follow = DMatrix::identity(common + m, common);
        if let Some(own) = own {
            follow.rows_mut(common, m).copy_from(&own);
        }
        follow
    }

    /// A matrix G with covariance G Gᵀ of a file's unknowns, the common ones first.
    pub fn root(&self, index: usize) -> DMatrix<f64> {
        let common = self.system.squares.len();
        let shared = self.follow(index) * self.common.root();
        let Some(file) = &self.system.files[index] else { return shared };
        let m = file.lengths.len();
        let mut root = DMatrix::zeros(common + m, common + m);
        root.columns_mut(0, common).copy_from(&shared);
        for i in 0..m {
            for j in (0..m).filter(|j| file.values[*j] > 0.0) {
                root[(common + i, common + j)] = file.turn[(j, i)] / (file.values[j] * file.lengths[i]);
            }
        }
        root
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three files with 0, 2 and 3 unknowns of their own beside 4; of the last the third does what the second does.
    #[test]
    fn elimination_file_by_file_gives_what_the_whole_system_gives() {
        let wave = |n: usize| (((n as f64 + 0.7) * 12.9898).sin() * 43_758.545_3).fract();
        for deficient in [false, true] {
            let (first, own, width) = ([4, 4, 6], [0, 2, 3], 9);
            let mut system = Bordered::new(&first, 4, width);
            let mut whole = Rows::new(width);
            for index in 0..3 {
                let mut file = Rows::new(own[index] + 4);
                for k in 0..15 {
                    let mut row: Vec<f64> = (0..own[index] + 4).map(|j| wave(1000 * index + 20 * k + j)).collect();
                    if deficient && index == 2 {
                        row[2] = 3.0 * row[1];
                    }
                    let right = 5.0 * wave(7000 + 100 * index + k);
                    file.push(&row, right);
                    let mut long = vec![0.0; width];
                    long[..4].copy_from_slice(&row[own[index]..]);
                    long[first[index]..first[index] + own[index]].copy_from_slice(&row[..own[index]]);
                    whole.push(&long, right);
                }
                system.add(index, file);
            }
            let (joint, whole) = (system.solve(), whole.solve());
            let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{a} {b}");
            assert_eq!((joint.rank(), joint.rows()), (width - usize::from(deficient), 45));
            for damping in [0.0, 1e-3, 1.0] {
                let (step, expected) = (joint.step(damping), whole.step(damping));
                (0..width).for_each(|j| near(step[j], expected[j]));
                near(joint.sigmas(&step), whole.sigmas(&expected));
            }
            let covariance = whole.covariance();
            for index in 0..3 {
                let root = joint.root(index);
                let found = &root * root.transpose();
                let touched: Vec<usize> = (0..4).chain(first[index]..first[index] + own[index]).collect();
                for (i, a) in touched.iter().enumerate() {
                    touched.iter().enumerate().for_each(|(j, b)| near(found[(i, j)], covariance[(*a, *b)]));
                }
            }
        }
    }
}
