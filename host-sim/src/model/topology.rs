//! Topology of a multi-body system: which body stands on which, and by what joint (tables 1 and 2 of the paper).
//!
//! Body 0 is the base, body 1 the chip, the last one the fibre array; between them the stages. L(j) is the body on
//! which j stands, L^n(j) the n-th one towards the base, L(0) = 0.

use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// The base.
pub const BASE: usize = 0;
/// The chip.
pub const CHIP: usize = 1;

/// What lets a body move on the one that carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Joint {
    /// Nothing: it is fixed.
    Fixed,
    /// One stage: free along or about its axis.
    Stage(Axis),
}

/// Why something is no topology.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TopologyError {
    /// A body that stands on one that does not exist.
    #[error("body {body} stands on body {parent}, but the bodies are 0 to {last}")]
    Unknown {
        /// The body.
        body: usize,
        /// What it is said to stand on.
        parent: usize,
        /// The last body.
        last: usize,
    },
    /// A body that stands on itself, perhaps by others.
    #[error("body {0} does not stand on the base, it carries itself")]
    Loop(usize),
    /// A stage that moves two bodies.
    #[error("axis {} moves two bodies, {first} and {second}", axis.name())]
    Twice {
        /// The stage.
        axis: Axis,
        /// The first body.
        first: usize,
        /// The second one.
        second: usize,
    },
    /// Fewer bodies than base, chip and fibre array.
    #[error("a stage has a base, a chip and a fibre array, so at least two bodies beside the base, not {0}")]
    TooFew(usize),
}

/// A tree of bodies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topology {
    /// Body on which body j + 1 stands, and its joint.
    bodies: Vec<(usize, Joint)>,
}

/// A row of table 2: one pair of neighbouring bodies and its freedom.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PairFreedom {
    /// The carrying body.
    pub carrier: usize,
    /// The carried body.
    pub body: usize,
    /// The free coordinate; none when the joint is fixed.
    pub coordinate: Option<&'static str>,
    /// 1 where the pair is free, in the order x, y, z, alpha, beta, gamma.
    pub free: [u8; AXES],
}

/// A linear stage behind a rotary one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Turned {
    /// The linear stage, whose direction turns.
    pub linear: Axis,
    /// The rotary stage that turns it.
    pub rotary: Axis,
}

impl std::fmt::Display for Turned {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} lies behind {}: the coupling depends on the pose", self.linear.name(), self.rotary.name())
    }
}

impl Topology {
    /// The three orders that the paper names.
    pub const PAPER: [[Axis; AXES]; 3] = [
        [Axis::Z, Axis::X, Axis::Y, Axis::Gamma, Axis::Beta, Axis::Alpha],
        [Axis::Z, Axis::X, Axis::Gamma, Axis::Y, Axis::Beta, Axis::Alpha],
        [Axis::Z, Axis::X, Axis::Y, Axis::Gamma, Axis::Alpha, Axis::Beta],
    ];

    /// The chip on the base, and the stages one on the other up to the fibre array.
    pub fn serial(order: &[Axis; AXES]) -> Self {
        let mut bodies = vec![(BASE, Joint::Fixed)];
        for (k, &axis) in order.iter().enumerate() {
            bodies.push((if k == 0 { BASE } else { k + 1 }, Joint::Stage(axis)));
        }
        bodies.push((AXES + 1, Joint::Fixed));
        Topology { bodies }
    }

    /// Any tree: for each body from 1 (the chip) to the last (the fibre array) what it stands on, and its joint.
    ///
    /// # Errors
    /// When it is not a tree on the base, or a stage moves two bodies.
    pub fn tree(bodies: Vec<(usize, Joint)>) -> Result<Self, TopologyError> {
        let last = bodies.len();
        if last < 2 {
            return Err(TopologyError::TooFew(last));
        }
        for (i, &(parent, joint)) in bodies.iter().enumerate() {
            if parent > last {
                return Err(TopologyError::Unknown { body: i + 1, parent, last });
            }
            if let (Joint::Stage(axis), Some(first)) = (joint, bodies[..i].iter().position(|b| b.1 == joint))
                && joint != Joint::Fixed
            {
                return Err(TopologyError::Twice { axis, first: first + 1, second: i + 1 });
            }
        }
        let topology = Topology { bodies };
        match (1..=last).find(|&j| topology.towards_base(j, last) != BASE) {
            Some(body) => Err(TopologyError::Loop(body)),
            None => Ok(topology),
        }
    }

    /// The last body: the fibre array.
    pub fn array(&self) -> usize {
        self.bodies.len()
    }

    /// L^n(j): the n-th body from j towards the base.
    pub fn towards_base(&self, j: usize, n: usize) -> usize {
        (0..n).fold(j, |body, _| if body == BASE { BASE } else { self.bodies[body - 1].0 })
    }

    /// Table 1: the low-order body array; row n holds L^n(j) for j from 1. Ends with the row that is all zero.
    pub fn low_order_array(&self) -> Vec<Vec<usize>> {
        let mut rows = vec![(1..=self.array()).collect::<Vec<usize>>()];
        while rows.last().is_some_and(|row| row.iter().any(|&j| j != BASE)) {
            let next = rows[rows.len() - 1].iter().map(|&j| self.towards_base(j, 1)).collect();
            rows.push(next);
        }
        rows
    }

    /// Table 2: the freedom of each pair of neighbouring bodies.
    pub fn freedoms(&self) -> Vec<PairFreedom> {
        let row = |(i, &(carrier, joint)): (usize, &(usize, Joint))| {
            let mut free = [0; AXES];
            let coordinate = match joint {
                Joint::Fixed => None,
                Joint::Stage(axis) => {
                    free[axis.index()] = 1;
                    Some(coordinate(axis))
                }
            };
            PairFreedom { carrier, body: i + 1, coordinate, free }
        };
        self.bodies.iter().enumerate().map(row).collect()
    }

    /// Degrees of freedom of the whole: stages that move.
    pub fn degrees_of_freedom(&self) -> usize {
        self.freedoms().iter().filter(|pair| pair.coordinate.is_some()).count()
    }

    /// The stages between the chip and the fibre array, in the order in which one comes to them from the chip. Stages
    /// that carry both, or neither, are not among them.
    pub fn path(&self) -> Vec<Axis> {
        let up = |mut body: usize| {
            let mut line = vec![body];
            while body != BASE {
                body = self.towards_base(body, 1);
                line.push(body);
            }
            line
        };
        let (mut chip, mut array) = (up(CHIP), up(self.array()));
        while chip.len() > 1 && array.len() > 1 && chip[chip.len() - 2] == array[array.len() - 2] {
            chip.pop();
            array.pop();
        }
        // the joint of a body is the one below it; the common body has none on the path
        chip.pop();
        array.pop();
        let stage = |body: usize| match self.bodies[body - 1].1 {
            Joint::Stage(axis) => Some(axis),
            Joint::Fixed => None,
        };
        chip.into_iter().chain(array.into_iter().rev()).filter_map(stage).collect()
    }

    /// Linear stages that a rotary one turns against the chip: with one of them no constant matrix holds.
    pub fn turned(&self) -> Vec<Turned> {
        let path = self.path();
        let mut found = Vec::new();
        for (i, &linear) in path.iter().enumerate().filter(|(_, axis)| !axis.is_rotary()) {
            found.extend(path[..i].iter().filter(|axis| axis.is_rotary()).map(|&rotary| Turned { linear, rotary }));
        }
        found
    }
}

/// The name of the coordinate that a stage moves.
pub fn coordinate(axis: Axis) -> &'static str {
    ["x", "y", "z", "alpha", "beta", "gamma"][axis.index()]
}
