//! One side of the chip with the array before it: from the pose of the stage to where each fibre and each corner is.
//!
//! Frame of a stage: x along the array, y up, z along the optical axis towards the chip. Both sides have one of their
//! own. The array is rigid; its face is the plane through the fibre point across its z.

use crate::model::Euler;
use crate::optics::{Array, Misalignment, Pair};
use nalgebra::{Matrix3, Vector3};

/// The front face of an array or of a fibre's block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Middle of the rectangle from the fibre point, um.
    pub middle_um: [f64; 2],
    /// Width in x and height in y, um.
    pub size_um: [f64; 2],
}

/// Where the array is in the frame of the chip's guides: z along the optical axis into the chip, origin at guide 0.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Orientation of the array.
    turn: Matrix3<f64>,
    /// The fibre point, um.
    origin: Vector3<f64>,
}

/// A side of the chip and what stands before it.
#[derive(Clone, Debug)]
pub(super) struct Port {
    euler: Euler,
    /// Orientation of the array with the stage at home.
    home: Matrix3<f64>,
    /// Guide 0 from the fibre point at home, um.
    pub seat: Vector3<f64>,
    /// Orientation of the frame of the guides.
    guides: Matrix3<f64>,
    face: Face,
    pair: Pair,
    array: Array,
    /// Distance of neighbouring guides, um.
    pitch: f64,
}

/// What a port is made of.
pub(super) struct Parts {
    pub euler: Euler,
    pub home: Matrix3<f64>,
    /// Guide 0 beside the fibre point at home, um.
    pub offset_um: [f64; 2],
    /// Logical angles at which the array stands straight before the guides, rad.
    pub angles_rad: [f64; 3],
    /// Least distance of the face's corners from the chip at home, um.
    pub clearance_um: f64,
    pub face: Face,
    pub pair: Pair,
    pub array: Array,
    pub pitch_um: f64,
}

impl Port {
    pub fn new(parts: Parts) -> Self {
        let [x, y] = parts.offset_um;
        let mut port = Port {
            guides: parts.euler.compose(parts.angles_rad) * parts.home,
            euler: parts.euler,
            home: parts.home,
            seat: Vector3::new(x, y, 0.0),
            face: parts.face,
            pair: parts.pair,
            array: parts.array,
            pitch: parts.pitch_um,
        };
        let lacking = parts.clearance_um - port.clearance(&port.place(&[0.0; 6], Vector3::zeros()));
        // the chip recedes along z until no corner is nearer
        port.seat.z = lacking / port.guides[(2, 2)];
        port
    }

    /// The place of the array at a pose (nm, nrad) when the chip has drifted by so many um.
    pub fn place(&self, pose: &[f64; 6], drift: Vector3<f64>) -> Place {
        let turn = self.euler.compose([pose[3] * 1e-9, pose[4] * 1e-9, pose[5] * 1e-9]);
        let point = Vector3::new(pose[0], pose[1], pose[2]) * 1e-3;
        let inverse = self.guides.transpose();
        Place { turn: inverse * turn * self.home, origin: inverse * (point - self.seat - drift) }
    }

    /// The pose (nm, nrad) at which the fibre point lies at a point of the guides' frame (um) and the array has these
    /// logical angles (rad).
    pub fn pose(&self, point: Vector3<f64>, angles: [f64; 3]) -> [f64; 6] {
        let p = (self.guides * point + self.seat) * 1e3;
        [p.x, p.y, p.z, angles[0] * 1e9, angles[1] * 1e9, angles[2] * 1e9]
    }

    /// Logical angles (rad) at which the array stands straight.
    pub fn straight(&self) -> [f64; 3] {
        self.euler.decompose(&(self.guides * self.home.transpose()))
    }

    /// How fibre `channel` stands before its guide.
    #[inline]
    pub fn misalignment(&self, place: &Place, channel: usize) -> Misalignment {
        let [x, y] = self.array.cores_um[channel];
        let a = &place.turn;
        let at = place.origin + a.column(0) * x + a.column(1) * y;
        let forward = 1.0 / a[(2, 2)];
        Misalignment {
            offset_um: [at.x + self.pitch * channel as f64, at.y],
            gap_um: -at.z,
            // the fibre takes what comes against its z
            tilt_rad: [-a[(0, 2)] * forward, -a[(1, 2)] * forward],
        }
    }

    /// Loss between fibre `channel` and its guide, dB.
    #[inline]
    pub fn loss_db(&self, place: &Place, channel: usize) -> f64 {
        self.pair.loss_db(&self.misalignment(place, channel))
    }

    /// Distances of the four corners of the array's face from the plane of the chip's, um; below 0 inside the chip.
    pub fn corners(&self, place: &Place) -> [f64; 4] {
        let Face { middle_um: [mx, my], size_um: [w, h] } = self.face;
        let a = &place.turn;
        [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)]
            .map(|(u, v)| -(place.origin.z + a[(2, 0)] * (mx + u * w) + a[(2, 1)] * (my + v * h)))
    }

    /// The least of them, um.
    pub fn clearance(&self, place: &Place) -> f64 {
        self.corners(place).into_iter().fold(f64::INFINITY, f64::min)
    }
}
