//! Machines, golden poses and boards that several tests share; each test uses its part.
#![allow(dead_code)]

use host_sim::board::{Board, Interleaving, Seeded};
use host_sim::calibrate::{Law as ExactLaw, calibrate};
use host_sim::machine::{Drive, Machine, MachineFile, Mounts, StaticErrors};
use host_sim::model::Chain;
use host_sim::session::power_up;
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use stage_controller::compensation::calibration::Calibration;
use stage_controller::controller::front::Front;
use stage_controller::units::{AXES, Axis};
use std::path::{Path, PathBuf};

/// The golden machines: other orders, up to 8 mrad, levers to 52 mm.
pub const GOLDEN: [&str; 8] =
    ["paper", "long-lever", "three-mrad", "eight-mrad", "lever-52mm", "xzy-bga", "yxz-abg", "zxy-gab"];

pub fn golden_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden").join(name)
}

/// A machine and the poses that its golden file holds, nm and nrad.
pub fn golden(name: &str) -> (Machine, Vec<[i32; AXES]>) {
    #[derive(Deserialize)]
    struct Entry {
        pose_nm_nrad: [i32; AXES],
    }
    #[derive(Deserialize)]
    struct Golden {
        machine: MachineFile,
        poses: Vec<Entry>,
    }
    let text = std::fs::read_to_string(golden_path(&format!("{name}.json"))).expect(name);
    let golden: Golden = serde_json::from_str(&text).expect(name);
    let machine = golden.machine.try_into().expect(name);
    (machine, golden.poses.into_iter().map(|entry| entry.pose_nm_nrad).collect())
}

/// A machine with all that a test of its law needs.
pub struct Stage {
    pub machine: Machine,
    pub chain: Chain,
    pub calibration: Calibration,
    /// The law in f64 with the coefficients as computed, not as the block rounds them.
    pub exact: ExactLaw,
    /// Distance of F from alpha, beta and gamma, nm.
    pub levers: [f64; 3],
}

impl Stage {
    pub fn new(machine: Machine) -> Option<Stage> {
        let (calibration, _) = calibrate(&machine).ok()?;
        let chain = Chain::new(&machine);
        let slides = chain.slides_matrix().try_inverse()?;
        let axes = chain.axes_matrix().try_inverse()?;
        let exact = ExactLaw::new(&machine, &chain, slides, axes, Default::default());
        let fibre = chain.fibre_home();
        let levers = chain.screws().map(|screw| (fibre - screw.nearest(fibre)).norm());
        Some(Stage { machine, chain, calibration, exact, levers })
    }

    pub fn golden(name: &str) -> Stage {
        Stage::new(golden(name).0).expect(name)
    }

    /// A largest static error of the machine, rad.
    pub fn largest_static(&self) -> f64 {
        self.machine.statics.values().into_iter().fold(0.0, |most, value| value.abs().max(most))
    }
}

/// Angle between the orientation of logical angles and that of others, rad.
pub fn turned_by(chain: &Chain, commanded: [f64; 3], achieved: [f64; 3]) -> f64 {
    let rotation = |angles: [f64; 3]| -> Matrix3<f64> { chain.euler().compose(angles.map(|a| a * 1e-9)) };
    host_sim::model::vee(&(rotation(commanded) * rotation(achieved).transpose())).norm()
}

/// Uniform numbers on top of the seeded generator.
pub struct Dice(pub Seeded);

impl Dice {
    pub fn new(seed: u64) -> Self {
        let mut seeded = Seeded::new(seed);
        // neighbouring seeds begin alike
        for _ in 0..4 {
            seeded.next_u64();
        }
        Dice(seeded)
    }

    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn between(&mut self, lower: f64, upper: f64) -> f64 {
        lower + (upper - lower) * self.unit()
    }

    pub fn logarithmic(&mut self, lower: f64, upper: f64) -> f64 {
        lower * (upper / lower).powf(self.unit())
    }

    pub fn integer(&mut self, range: std::ops::RangeInclusive<i64>) -> i64 {
        range.start() + self.0.below((range.end() - range.start() + 1) as u64) as i64
    }

    pub fn direction(&mut self) -> Vector3<f64> {
        loop {
            let v = Vector3::from_fn(|_, _| self.between(-1.0, 1.0));
            if (0.1..1.0).contains(&v.norm()) {
                return v.normalize();
            }
        }
    }

    fn shuffled(&mut self, mut axes: [Axis; 3]) -> [Axis; 3] {
        axes.swap(2, self.0.below(3) as usize);
        axes.swap(1, self.0.below(2) as usize);
        axes
    }

    /// A machine of any order with all linear stages first, statics to 8 mrad, a lever of 52 to 60 mm, axes that do
    /// not meet, steps of 2 nm to 1 um (2 to 30 000 nrad) and travels to 25 mm and 5 degrees.
    pub fn stage(&mut self) -> Stage {
        loop {
            let (linear, rotary) = (self.shuffled(Axis::LINEAR), self.shuffled(Axis::ROTARY));
            let mut offsets = [[0.0; 3]; AXES];
            for offset in &mut offsets[3..] {
                *offset = std::array::from_fn(|_| self.between(-3e5, 3e5));
            }
            let statics = std::array::from_fn(|_| self.between(-8e-3, 8e-3));
            let machine = Machine {
                name: "random".into(),
                order: [linear[0], linear[1], linear[2], rotary[0], rotary[1], rotary[2]],
                fibre_point_nm: (self.direction() * self.between(52e6, 60e6)).into(),
                axis_offset_nm: offsets,
                statics: StaticErrors::from_values(statics),
                mounts: Mounts::default(),
                kinematic: Default::default(),
                drives: Axis::ALL.map(|axis| self.drive(axis)),
            };
            let stage = Stage::new(machine);
            if let Some(stage) = stage.filter(|s| s.levers.iter().any(|l| (52e6..60e6).contains(l))) {
                return stage;
            }
        }
    }

    fn drive(&mut self, axis: Axis) -> Drive {
        let (steps, travel) =
            if axis.is_rotary() { ((2.0, 30_000.0), (2e7, 87_266_462.0)) } else { ((2.0, 1000.0), (1e6, 25e6)) };
        let step = self.logarithmic(steps.0, steps.1);
        let velocity = (step * 400e3).min(2e6);
        let (acceleration, jerk) = (velocity * 10.0, velocity * 200.0);
        let end = self.between(travel.0, travel.1).round();
        Drive {
            step,
            backlash: step * 7.0,
            travel: [-end, end],
            switches: [-1.1 * end, 1.1 * end],
            velocity,
            acceleration,
            jerk,
        }
    }

    /// A pose of whole nm and nrad within the travel.
    pub fn pose(&mut self, machine: &Machine) -> [i32; AXES] {
        machine.drives.map(|drive| self.between(drive.travel[0], drive.travel[1]) as i32)
    }

    /// Motor counts within the travel.
    pub fn counts(&mut self, machine: &Machine) -> [i32; AXES] {
        machine.drives.map(|drive| (self.between(drive.travel[0], drive.travel[1]) / drive.step) as i32)
    }
}

/// A front with the machine's calibration, homed and enabled.
pub fn homed(machine: &Machine) -> Front {
    power_up(machine, false).expect("a machine that the law serves")
}

/// A front with the machine's calibration as after power-up.
pub fn loaded(machine: &Machine) -> Front {
    power_up(machine, true).expect("a machine that the law serves")
}

/// A board at home in front of the machine.
pub fn board(machine: &Machine) -> Board {
    let mut board = Board::new(machine, homed(machine), Interleaving::Prompt, 1);
    assert!(board.settle());
    board
}
