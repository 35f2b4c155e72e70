//! Errors that depend on where a stage stands (EXX ... ECC, ISO 230-1) as functions of low order: what they would do
//! to a reading. They are not fitted; the uncertainties of the constants are widened by what they can do.

use super::jacobian::{Linearised, Twist};
use super::series::{Kind, Series};
use nalgebra::Vector3;
use stage_controller::units::{AXES, Axis};

/// Legendre polynomials of this many degrees describe each of the 36: smooth errors, up to two waves over the travel.
pub(super) const DEGREES: usize = 5;
/// Three displacements and three rotations of each stage.
const COMPONENTS: usize = 6;

/// One unknown of one of the 36 functions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    /// The stage whose position it depends on.
    pub axis: Axis,
    /// Displacements along x, y, z (nm), then rotations about them (nrad).
    pub component: usize,
    /// Degree of the polynomial, from 1.
    pub degree: usize,
}

impl Shape {
    pub(super) fn is_angular(self) -> bool {
        self.component >= 3
    }
}

/// The functions of all stages that move in the measurements.
#[derive(Clone, Debug)]
pub(super) struct PositionErrors {
    /// The low degrees first.
    pub shapes: Vec<Shape>,
    /// Farthest position of each motor from home, nm or nrad.
    reach: [f64; AXES],
}

impl PositionErrors {
    /// Of the files that the common fit evaluates.
    pub(super) fn new<'a>(files: impl Iterator<Item = &'a Series>) -> Self {
        let mut reach = [0.0_f64; AXES];
        for reading in files.filter(|file| file.kind != Kind::Squareness).flat_map(|file| &file.readings) {
            reach.iter_mut().zip(reading.motors).for_each(|(most, motor)| *most = most.max(motor.abs()));
        }
        let moving: Vec<Axis> = Axis::ALL.into_iter().filter(|axis| reach[axis.index()] > 0.0).collect();
        let mut shapes = Vec::new();
        for degree in 1..=DEGREES {
            for axis in &moving {
                shapes.extend((0..COMPONENTS).map(|component| Shape { axis: *axis, component, degree }));
            }
        }
        PositionErrors { shapes, reach }
    }

    /// Calls back with each column, from `first` on, and what one nm or one nrad of it does to the array. All are zero at home: how the
    /// stage stands there is in the constants.
    pub(super) fn each_twist(
        &self,
        at: &Linearised,
        order: &[Axis; AXES],
        actuators: &[f64; AXES],
        first: usize,
        mut use_it: impl FnMut(usize, Twist),
    ) {
        let interfaces = at.interfaces();
        let mut frames =
            [[Twist { turn: Vector3::zeros(), about: Vector3::zeros(), shift: Vector3::zeros() }; 6]; AXES];
        let mut values = [[0.0; DEGREES]; AXES];
        for (k, axis) in order.iter().enumerate() {
            let i = axis.index();
            // behind the motion: orientation of what comes next, at the place of the stage itself
            let rotation = interfaces[k + 2].rotation;
            let way = if axis.is_rotary() { 0.0 } else { actuators[i] };
            let about = interfaces[k + 1].origin + at.direction(*axis) * way;
            for c in 0..3 {
                let along: Vector3<f64> = rotation.column(c).into();
                frames[i][c] = Twist { turn: Vector3::zeros(), about, shift: along };
                frames[i][3 + c] = Twist { turn: along * 1e-9, about, shift: Vector3::zeros() };
            }
            if self.reach[i] > 0.0 {
                values[i] = from_home(actuators[i] / self.reach[i]);
            }
        }
        for (n, shape) in self.shapes.iter().enumerate() {
            let i = shape.axis.index();
            let (twist, value) = (frames[i][shape.component], values[i][shape.degree - 1]);
            use_it(first + n, Twist { turn: twist.turn * value, about: twist.about, shift: twist.shift * value });
        }
    }
}

/// Legendre polynomials of degree 1 and above, less their values at 0.
fn from_home(t: f64) -> [f64; DEGREES] {
    let all = |t: f64| {
        let mut p = [1.0; DEGREES + 1];
        p[1] = t;
        for n in 1..DEGREES {
            p[n + 1] = ((2 * n + 1) as f64 * t * p[n] - n as f64 * p[n - 1]) / (n + 1) as f64;
        }
        p
    };
    let (here, home) = (all(t), all(0.0));
    std::array::from_fn(|d| here[d + 1] - home[d + 1])
}
