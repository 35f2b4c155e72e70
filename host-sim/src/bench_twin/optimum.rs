//! The best alignment that a bench allows: what every search is compared with.
//!
//! The loss of channel i is that of the input, the same for all, plus what hangs on the output side alone. So the worst
//! channel is best when each side by itself is: two problems of six coordinates. In each the largest of some smooth
//! losses is sought the least, while four corners keep a distance. Where that leaves a choice, a thousandth of the mean
//! loss and a touch of the angles decide; both together change the largest by less than 0.0002 dB. The largest is smoothed, ln Σ exp(t L_i) / t, with t
//! rising; a corner that is too near costs in proportion, also smoothed. Each of these is minimised by Newton steps
//! whose derivatives are those of the smooth losses, taken by differences. At the end the array is moved until
//! the nearest corner keeps its distance exactly, and the true largest loss counts.

use super::port::{Place, Port};
use super::random::Chance;
use super::{Bench, Side};
use crate::optics::{uniformity_db, worst_db};
use nalgebra::{SMatrix, SVector, Vector3};
use serde::Serialize;

/// Starts of the search on each side.
pub const STARTS: usize = 50;
/// Starts that end within this of the best one found the same, dB.
const SAME_DB: f64 = 1e-4;
/// What a corner too near costs, dB per um: ten times what the light gains by it.
const PENALTY: f64 = 0.1;
/// Weight of the mean loss beside the largest: where one weak channel decides alone, the others still want their light.
const MEAN: f64 = 1e-3;
/// Weight of the squared angles, dB per unit²: a single round fibre has no roll of its own.
const UPRIGHT: f64 = 1e-5;
/// Sharpness of the largest, per dB, from smooth to sharp; that of the corners is the same per um.
const SHARPNESS: [f64; 6] = [1.0, 10.0, 100.0, 1e3, 1e4, 3e4];
/// Newton steps at each sharpness.
const STEPS: usize = 25;
/// A unit of a coordinate is 1 um or this many rad: alike in their effect at a lever of 1 mm.
const RAD_PER_UNIT: f64 = 1e-3;
/// Step of the differences, units.
const STEP: f64 = 0.02;
/// How far the starts are around the straight pose, units.
const REACH: f64 = 7.0;

type Vector = SVector<f64, 6>;
type Matrix = SMatrix<f64, 6, 6>;

/// The best alignment of a bench at tick 0.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Optimum {
    /// Insertion loss of the worst channel, dB: the least possible within 0.0002 dB.
    pub worst_db: f64,
    /// Largest less least insertion loss of the channels, dB.
    pub uniformity_db: f64,
    /// Insertion losses of all channels, dB.
    pub losses_db: Vec<f64>,
    /// True poses of both stages, nm and nrad from home. With the drift they move by [`Bench::drift_um`].
    pub poses: [[f64; 6]; 2],
    /// Of the starts on each side, how many found the best within 0.0001 dB.
    pub agreeing: [usize; 2],
}

/// Finds it: the best of [`STARTS`] starts on each side.
pub(super) fn optimum(bench: &Bench) -> Optimum {
    let mut agreeing = [0; 2];
    let poses = Side::BOTH.map(|side| {
        let problem = Problem::of(bench, side);
        let mut chance = Chance::new(bench.seed, 6 + side as u64);
        let ends: Vec<(f64, Vector)> = (0..STARTS)
            .map(|_| problem.descend(Vector::from_fn(|_, _| chance.within(REACH)) - Vector::z() * 20.0))
            .collect();
        let (best, at) = ends.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0)).expect("some starts");
        agreeing[side.index()] = ends.iter().filter(|(loss, _)| loss - best < SAME_DB).count();
        problem.pose(&at)
    });
    let losses_db = bench.losses(0, &poses);
    let (worst_db, uniformity_db) = (worst_db(&losses_db), uniformity_db(&losses_db));
    Optimum { worst_db, uniformity_db, losses_db, poses, agreeing }
}

/// One side: coordinates are the fibre point in the guides' frame and the angles from the straight pose.
struct Problem<'a> {
    port: &'a Port,
    /// What each channel loses elsewhere, dB.
    fixed: Vec<f64>,
    gap: f64,
    straight: [f64; 3],
}

/// Value, slopes and curvatures of one smooth function.
#[derive(Clone)]
struct Smooth {
    value: f64,
    gradient: Vector,
    hessian: Matrix,
}

impl<'a> Problem<'a> {
    fn of(bench: &'a Bench, side: Side) -> Self {
        let port = &bench.stations[side.index()].port;
        let fixed = if side == Side::Input { vec![0.0] } else { bench.splitter.loss_db.clone() };
        Problem { port, fixed, gap: bench.options.working_gap_um, straight: port.straight() }
    }

    fn pose(&self, at: &Vector) -> [f64; 6] {
        let angles = std::array::from_fn(|i| self.straight[i] + at[i + 3] * RAD_PER_UNIT);
        self.port.pose(Vector3::new(at[0], at[1], at[2]), angles)
    }

    fn place(&self, at: &Vector) -> Place {
        self.port.place(&self.pose(at), Vector3::zeros())
    }

    /// Losses of all channels, then how much too near each corner is.
    fn functions(&self, at: &Vector, out: &mut Vec<f64>) {
        let place = self.place(at);
        out.clear();
        out.extend(self.fixed.iter().enumerate().map(|(i, fixed)| fixed + self.port.loss_db(&place, i)));
        out.extend(self.port.corners(&place).map(|corner| self.gap - corner));
    }

    /// What decides beside the largest loss.
    fn beside(&self, losses: &[f64], at: &Vector) -> f64 {
        MEAN * losses.iter().sum::<f64>() / losses.len() as f64 + UPRIGHT * at.fixed_rows::<3>(3).norm_squared()
    }

    /// What is to be least when the array is moved along z until the nearest corner keeps its distance, and
    /// where.
    fn kept(&self, mut at: Vector) -> (f64, Vector) {
        for _ in 0..3 {
            at[2] -= self.gap - self.port.clearance(&self.place(&at));
        }
        let values = self.moved(&at, &[]);
        let losses = &values[..self.fixed.len()];
        (worst_db(losses) + self.beside(losses, &at), at)
    }

    fn objective(&self, values: &[f64], at: &Vector, sharpness: f64) -> f64 {
        let (losses, corners) = values.split_at(self.fixed.len());
        let largest = worst_db(losses);
        let sum: f64 = losses.iter().map(|loss| (sharpness * (loss - largest)).exp()).sum();
        let near: f64 =
            corners.iter().map(|by| by.max(0.0) + (-(sharpness * by).abs()).exp().ln_1p() / sharpness).sum();
        largest + sum.ln() / sharpness + PENALTY * near + self.beside(losses, at)
    }

    /// All functions some units away from a point.
    fn moved(&self, at: &Vector, by: &[(usize, f64)]) -> Vec<f64> {
        let mut moved = *at;
        by.iter().for_each(|(i, by)| moved[*i] += by);
        let mut values = Vec::with_capacity(self.fixed.len() + 4);
        self.functions(&moved, &mut values);
        values
    }

    /// All functions with their derivatives, by central differences.
    fn expand(&self, at: &Vector) -> Vec<Smooth> {
        let blank = Smooth { value: 0.0, gradient: Vector::zeros(), hessian: Matrix::zeros() };
        let mut functions = vec![blank; self.fixed.len() + 4];
        self.slopes(at, &mut functions);
        for i in 0..6 {
            for j in 0..i {
                let corner = |a: f64, b: f64| self.moved(at, &[(i, a * STEP), (j, b * STEP)]);
                let four = [corner(1.0, 1.0), corner(-1.0, -1.0), corner(1.0, -1.0), corner(-1.0, 1.0)];
                for (k, f) in functions.iter_mut().enumerate() {
                    let mixed = (four[0][k] + four[1][k] - four[2][k] - four[3][k]) / (4.0 * STEP * STEP);
                    f.hessian[(i, j)] = mixed;
                    f.hessian[(j, i)] = mixed;
                }
            }
        }
        functions
    }

    /// Values, slopes and the curvatures along the coordinates anew; the mixed ones hardly change over a few units.
    fn slopes(&self, at: &Vector, functions: &mut [Smooth]) {
        let middle = self.moved(at, &[]);
        for i in 0..6 {
            let [more, less] = [STEP, -STEP].map(|by| self.moved(at, &[(i, by)]));
            for (k, f) in functions.iter_mut().enumerate() {
                f.value = middle[k];
                f.gradient[i] = (more[k] - less[k]) / (2.0 * STEP);
                f.hessian[(i, i)] = (more[k] - 2.0 * middle[k] + less[k]) / (STEP * STEP);
            }
        }
    }

    /// Slopes and curvatures of the smoothed objective.
    fn derivatives(&self, functions: &[Smooth], at: &Vector, sharpness: f64) -> (Vector, Matrix) {
        let (losses, corners) = functions.split_at(self.fixed.len());
        let largest = losses.iter().map(|f| f.value).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = losses.iter().map(|f| (sharpness * (f.value - largest)).exp()).collect();
        let sum: f64 = weights.iter().sum();
        let (mut gradient, mut hessian) = (Vector::zeros(), Matrix::zeros());
        for (f, weight) in losses.iter().zip(&weights) {
            let share = weight / sum;
            gradient += f.gradient * share;
            hessian += (f.hessian + f.gradient * f.gradient.transpose() * sharpness) * share;
        }
        hessian -= gradient * gradient.transpose() * sharpness;
        for f in losses {
            let share = MEAN / losses.len() as f64;
            gradient += f.gradient * share;
            hessian += f.hessian * share;
        }
        for i in 3..6 {
            gradient[i] += 2.0 * UPRIGHT * at[i];
            hessian[(i, i)] += 2.0 * UPRIGHT;
        }
        for f in corners {
            let on = 1.0 / (1.0 + (-sharpness * f.value).exp());
            gradient += f.gradient * (PENALTY * on);
            let bend = f.gradient * f.gradient.transpose() * (sharpness * on * (1.0 - on));
            hessian += (f.hessian * on + bend) * PENALTY;
        }
        (gradient, hessian)
    }

    /// From a start to the least that is near.
    fn descend(&self, mut at: Vector) -> (f64, Vector) {
        let mut values = Vec::new();
        for sharpness in SHARPNESS {
            let mut damping = 1e-6;
            self.functions(&at, &mut values);
            let mut now = self.objective(&values, &at, sharpness);
            let mut functions = self.expand(&at);
            for _ in 0..STEPS {
                self.slopes(&at, &mut functions);
                let (gradient, hessian) = self.derivatives(&functions, &at, sharpness);
                let before = now;
                for _ in 0..12 {
                    let damped = hessian + Matrix::identity() * (damping * (1.0 + hessian.diagonal().amax()));
                    let step = damped.cholesky().map(|factors| factors.solve(&-gradient));
                    let next = step.filter(|step| step.amax() < 5.0).map(|step| at + step);
                    let better = next.and_then(|next| {
                        self.functions(&next, &mut values);
                        let value = self.objective(&values, &next, sharpness);
                        (value < now).then_some((value, next))
                    });
                    if let Some((value, next)) = better {
                        (now, at) = (value, next);
                        damping = (damping * 0.1).max(1e-12);
                        break;
                    }
                    damping *= 10.0;
                }
                if before - now < 1e-9 {
                    break;
                }
            }
        }
        self.kept(at)
    }
}
