//! The chain of stages from the base (chip) to the fibre point F, with its nine static angular errors.

use super::rotation::{Euler, exp, vee};
use crate::machine::{Machine, StaticErrors};
use nalgebra::{Matrix3, Vector3};
use stage_controller::units::{AXES, Axis};

const MAX_ITERATIONS: usize = 40;
/// Last Newton step in rad: 2e-6 nrad, 0.1 pm at 60 mm; rounding alone makes about a tenth of it.
const CONVERGED: f64 = 2e-15;

/// One joint: nominal translation, static error, motion along or about its own axis.
#[derive(Clone, Copy, Debug)]
struct Joint {
    axis: Axis,
    offset: Vector3<f64>,
    tilt: Matrix3<f64>,
}

/// The line about which a rotary stage turns, with the stage at home, in chip axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Screw {
    /// Which rotary stage.
    pub axis: Axis,
    /// Unit direction.
    pub direction: Vector3<f64>,
    /// A point of the line, nm.
    pub point: Vector3<f64>,
}

impl Screw {
    /// The point of the line nearest to `p`.
    pub fn nearest(&self, p: Vector3<f64>) -> Vector3<f64> {
        self.point + self.direction * self.direction.dot(&(p - self.point))
    }
}

/// State of the fibre array for given actuators, in chip axes.
struct Placement {
    rotation: Matrix3<f64>,
    origin: Vector3<f64>,
    /// Where each stage stands: unit vector and a point of its axis, in axis order.
    stages: [(Vector3<f64>, Vector3<f64>); AXES],
}

/// The exact forward model of a machine: lengths in nm, angles in rad inside and nrad at the border.
///
/// Joint k = Trans(axis_offset) · `exp([ε]×)` · motion, base to tip, then F (docs/LAW.md 1); before them the inverse of
/// the chip's mount, after them the mount of the fibre array.
#[derive(Clone, Debug)]
pub struct Chain {
    joints: [Joint; AXES],
    /// Orientation and origin of the base in chip axes.
    base: (Matrix3<f64>, Vector3<f64>),
    /// The same of the fibre array frame on the last stage.
    mount: (Matrix3<f64>, Vector3<f64>),
    fibre: Vector3<f64>,
    euler: Euler,
    home_rotation: Matrix3<f64>,
    home_origin: Vector3<f64>,
    slides: [Vector3<f64>; 3],
    screws: [Screw; 3],
}

impl Chain {
    /// The chain of a machine; every order of the six stages is accepted.
    pub fn new(machine: &Machine) -> Self {
        let joints = std::array::from_fn(|k| Joint {
            axis: machine.order[k],
            offset: Vector3::from(machine.axis_offset_nm[machine.order[k].index()]),
            tilt: exp(static_vector(&machine.statics, &machine.order[..=k])),
        });
        let (chip, fibre) = (exp(machine.mounts.chip.rotation_rad.into()), machine.mounts.fibre);
        let mut chain = Chain {
            joints,
            base: (chip.transpose(), -(chip.transpose() * Vector3::from(machine.mounts.chip.offset_nm))),
            mount: (exp(fibre.rotation_rad.into()), fibre.offset_nm.into()),
            fibre: Vector3::from(machine.fibre_point_nm),
            euler: Euler::new(&machine.order),
            home_rotation: Matrix3::identity(),
            home_origin: Vector3::zeros(),
            slides: [Vector3::zeros(); 3],
            screws: [Screw { axis: Axis::Alpha, direction: Vector3::zeros(), point: Vector3::zeros() }; 3],
        };
        let home = chain.place([0.0; 3], [0.0; 3]);
        chain.home_rotation = home.rotation;
        chain.home_origin = home.origin;
        chain.slides = std::array::from_fn(|i| home.stages[i].0);
        chain.screws = std::array::from_fn(|i| {
            let (direction, point) = home.stages[i + 3];
            Screw { axis: Axis::ROTARY[i], direction, point }
        });
        chain
    }

    /// Walks the chain; `lengths` in nm, `angles` in rad.
    fn place(&self, lengths: [f64; 3], angles: [f64; 3]) -> Placement {
        let (mut rotation, mut origin) = self.base;
        let mut stages = [(Vector3::zeros(), Vector3::zeros()); AXES];
        for joint in &self.joints {
            origin += rotation * joint.offset;
            rotation *= joint.tilt;
            let index = joint.axis.index();
            let along: Vector3<f64> = rotation.column(index % 3).into();
            stages[index] = (along, origin);
            if joint.axis.is_rotary() {
                rotation *= exp(Vector3::ith(index - 3, angles[index - 3]));
            } else {
                origin += along * lengths[index];
            }
        }
        origin += rotation * self.mount.1;
        rotation *= self.mount.0;
        Placement { rotation, origin, stages }
    }

    /// Pose of the fibre point for given actuators (nm and nrad, axis order): displacement of F in chip
    /// axes from home in nm, and the logical angles of R(q)·R(0)ᵀ in nrad.
    pub fn true_pose(&self, actuators: [f64; AXES]) -> [f64; AXES] {
        let (rotation, origin) = self.array(actuators);
        let moved = origin + rotation * self.fibre - self.fibre_home();
        let angles = self.euler.decompose(&(rotation * self.home_rotation.transpose()));
        [moved.x, moved.y, moved.z, angles[0] * 1e9, angles[1] * 1e9, angles[2] * 1e9]
    }

    /// The fibre array frame for given actuators (nm and nrad, axis order): orientation and origin (nm) in chip axes.
    pub fn array(&self, actuators: [f64; AXES]) -> (Matrix3<f64>, Vector3<f64>) {
        let [x, y, z, a, b, g] = actuators;
        let at = self.place([x, y, z], [a * 1e-9, b * 1e-9, g * 1e-9]);
        (at.rotation, at.origin)
    }

    /// Actuators (nm and nrad) that bring F to a pose (nm and nrad): docs/LAW.md 2 solved to the
    /// last bit. None when the iteration does not converge (angles far beyond any stage's travel).
    pub fn exact_inverse(&self, pose: [f64; AXES]) -> Option<[f64; AXES]> {
        let [x, y, z, a, b, g] = pose;
        let angles = self.actuator_angles([a * 1e-9, b * 1e-9, g * 1e-9])?;
        let at = self.place([0.0; 3], angles);
        let wanted = self.fibre_home() + Vector3::new(x, y, z);
        let slides = Matrix3::from_columns(&[at.stages[0].0, at.stages[1].0, at.stages[2].0]);
        let q = slides.lu().solve(&(wanted - at.origin - at.rotation * self.fibre))?;
        Some([q.x, q.y, q.z, angles[0] * 1e9, angles[1] * 1e9, angles[2] * 1e9])
    }

    /// Actuator angles (rad) whose orientation is that of the logical angles (rad): chord Newton.
    pub fn actuator_angles(&self, logical: [f64; 3]) -> Option<[f64; 3]> {
        let wanted = self.euler.compose(logical);
        let inverse = self.axes_matrix().try_inverse()?;
        let mut q = inverse * Vector3::from(logical);
        for _ in 0..MAX_ITERATIONS {
            let step = inverse * vee(&(wanted * self.orientation(q.into()).transpose()));
            q += step;
            if step.norm() < CONVERGED {
                return Some(q.into());
            }
        }
        None
    }

    /// Orientation relative to home of actuator angles (rad), in chip axes.
    pub fn orientation(&self, angles: [f64; 3]) -> Matrix3<f64> {
        self.place([0.0; 3], angles).rotation * self.home_rotation.transpose()
    }

    /// D: unit directions of X, Y, Z as columns, at home.
    pub fn slides_matrix(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&self.slides)
    }

    /// W: unit directions of the alpha, beta, gamma axes as columns, at home.
    pub fn axes_matrix(&self) -> Matrix3<f64> {
        Matrix3::from_columns(&self.screws.map(|screw| screw.direction))
    }

    /// The rotary axes alpha, beta, gamma at home.
    pub fn screws(&self) -> [Screw; 3] {
        self.screws
    }

    /// Orientation of the fibre array frame at home.
    pub fn home_rotation(&self) -> Matrix3<f64> {
        self.home_rotation
    }

    /// Origin of the fibre array frame at home, nm.
    pub fn home_origin(&self) -> Vector3<f64> {
        self.home_origin
    }

    /// The fibre point at home, nm.
    pub fn fibre_home(&self) -> Vector3<f64> {
        self.home_origin + self.home_rotation * self.fibre
    }

    /// The meaning of the logical angles.
    pub fn euler(&self) -> Euler {
        self.euler
    }
}

/// Vector of static errors of the last joint of `upstream`. A squareness S_AB sits on whichever of A
/// and B comes later in the chain, about the third axis.
pub(crate) fn static_vector(errors: &StaticErrors, upstream: &[Axis]) -> Vector3<f64> {
    let Some((&axis, before)) = upstream.split_last() else {
        return Vector3::zeros();
    };
    let square = |partner: Axis, error: f64| {
        if before.contains(&partner) { error } else { 0.0 }
    };
    let e = errors;
    match axis {
        Axis::X => Vector3::new(0.0, square(Axis::Z, e.S_ZX), square(Axis::Y, e.S_XY)),
        Axis::Y => Vector3::new(square(Axis::Z, e.S_ZY), 0.0, square(Axis::X, e.S_XY)),
        Axis::Z => Vector3::new(square(Axis::Y, e.S_ZY), square(Axis::X, e.S_ZX), 0.0),
        Axis::Alpha => Vector3::new(0.0, e.ey_alpha, e.ez_alpha),
        Axis::Beta => Vector3::new(e.ex_beta, 0.0, e.ez_beta),
        Axis::Gamma => Vector3::new(e.ex_gamma, e.ey_gamma, 0.0),
    }
}
