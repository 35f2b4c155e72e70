//! The second-order term of the actuator angles: six products per motor, fitted to the exact law.
//!
//! q = W⁻¹a + S·(α², β², γ², αβ, αγ, βγ). What remains is of third order in the angles and odd, so no
//! even term can remove it: about (tilt)·θ³. Re-weighting towards the smallest maximum was tried and
//! gains 2 to 3 %: plain least squares stays.

use crate::model::{Chain, vee};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Points of the fit and of the residual along each angle.
pub const FIT_POINTS: usize = 9;

/// Second-order coefficients per rad, rows alpha, beta, gamma.
pub type SecondOrder = SMatrix<f64, 3, 6>;

/// A fitted second-order term and what it leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The coefficients.
    pub coefficients: SecondOrder,
    /// Largest rotation between commanded and achieved orientation over the travel, urad.
    pub residual_urad: f64,
    /// The same of W⁻¹ alone.
    pub linear_residual_urad: f64,
}

/// The products α², β², γ², αβ, αγ, βγ.
pub fn products([a, b, g]: [f64; 3]) -> SMatrix<f64, 6, 1> {
    SMatrix::from([[a * a, b * b, g * g, a * b, a * g, b * g]])
}

/// Fits the second-order term over a box of logical angles (rad) by least squares. None when the
/// exact law has no solution there.
pub fn fit(chain: &Chain, inverse_axes: &Matrix3<f64>, travel: [[f64; 2]; 3]) -> Option<Fit> {
    let points: Vec<Point> =
        grid(travel, FIT_POINTS).into_iter().map(|a| Point::new(chain, inverse_axes, a)).collect::<Option<_>>()?;
    let coefficients = solve(&points)?;
    let largest = |term: &SecondOrder| points.iter().map(|p| p.error(chain, term)).fold(0.0, f64::max) * 1e6;
    Some(Fit {
        coefficients,
        residual_urad: largest(&coefficients),
        linear_residual_urad: largest(&SecondOrder::zeros()),
    })
}

/// Largest rotation (urad) between the commanded orientation and that of `actuator_angles` over a
/// grid of logical angles.
pub fn orientation_residual(
    chain: &Chain,
    travel: [[f64; 2]; 3],
    points: usize,
    actuator_angles: impl Fn([f64; 3]) -> [f64; 3],
) -> f64 {
    let error = |a| rotation_between(chain, a, actuator_angles(a));
    grid(travel, points).into_iter().map(error).fold(0.0, f64::max) * 1e6
}

/// One grid point: the products and what W⁻¹a leaves of the exact actuator angles.
struct Point {
    logical: [f64; 3],
    linear: Vector3<f64>,
    products: SMatrix<f64, 6, 1>,
    rest: Vector3<f64>,
}

impl Point {
    fn new(chain: &Chain, inverse_axes: &Matrix3<f64>, logical: [f64; 3]) -> Option<Self> {
        let linear = inverse_axes * Vector3::from(logical);
        let rest = Vector3::from(chain.actuator_angles(logical)?) - linear;
        Some(Point { logical, linear, products: products(logical), rest })
    }

    fn error(&self, chain: &Chain, coefficients: &SecondOrder) -> f64 {
        rotation_between(chain, self.logical, (self.linear + coefficients * self.products).into())
    }
}

fn rotation_between(chain: &Chain, logical: [f64; 3], actuator: [f64; 3]) -> f64 {
    vee(&(chain.euler().compose(logical) * chain.orientation(actuator).transpose())).norm()
}

fn solve(points: &[Point]) -> Option<SecondOrder> {
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = SMatrix::<f64, 6, 3>::zeros();
    for point in points {
        normal += point.products * point.products.transpose();
        right += point.products * point.rest.transpose();
    }
    // Products of small angles: scaled to a unit diagonal before they are solved.
    let scale = normal.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
    let scale = SMatrix::<f64, 6, 6>::from_diagonal(&scale);
    let svd = (scale * normal * scale).svd(true, true);
    Some((scale * svd.solve(&(scale * right), 1e-12).ok()?).transpose())
}

fn grid(travel: [[f64; 2]; 3], points: usize) -> Vec<[f64; 3]> {
    let along = |[lower, upper]: [f64; 2], i: usize| lower + (upper - lower) * i as f64 / (points - 1) as f64;
    let mut all = Vec::with_capacity(points.pow(3));
    for i in 0..points {
        for j in 0..points {
            for k in 0..points {
                all.push([along(travel[0], i), along(travel[1], j), along(travel[2], k)]);
            }
        }
    }
    all
}
