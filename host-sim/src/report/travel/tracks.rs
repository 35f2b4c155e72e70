//! The moves along which compensation is judged: through the whole travel, and the small ones of an alignment.

use super::drive::Mode;
use crate::calibrate::Q32;
use crate::machine::Machine;
use serde::Serialize;
use stage_controller::compensation::calibration::Calibration;
use stage_controller::compensation::law::{Law, Remembered};
use stage_controller::units::{AXES, Axis, FinePose};

/// Stops on the way there; as many on the way back.
const STOPS: usize = 41;
/// Poses spread over the travel.
const POSES: usize = 250;
/// Half the way of a small scan, nm.
const SCAN: f64 = 2_000.0;
/// Where home is at the end of a travel, an axis that does not move stands so much of the travel inside: a coupled
/// motor needs room.
const INSIDE: f64 = 0.05;

/// What a track looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// From one end to the other and back.
    Line,
    /// Poses in no order.
    Poses,
}

/// Moves from stop to stop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Track {
    /// What moves.
    pub name: String,
    /// There and back, or scattered.
    pub kind: Kind,
    /// Share of the travel that is used: less than 1 where a compensated motor would leave its own travel.
    pub share_of_travel: f64,
    /// What `along` counts: um, deg or % of the travel.
    pub unit: &'static str,
    /// Where each stop is along the track.
    pub along: Vec<f64>,
}

/// All tracks with their poses in nm and nrad.
pub(super) fn all(machine: &Machine, calibration: &Calibration) -> Vec<(Track, Vec<[f64; AXES]>)> {
    let room = Room::new(machine, calibration);
    let mut all: Vec<_> = Axis::ALL.iter().map(|axis| room.line(axis.name(), &[*axis])).collect();
    all.push(room.line("X, Y, Z together", &Axis::LINEAR));
    all.push(room.line("all six together", &Axis::ALL));
    all.push(room.scan());
    all.push(room.poses());
    all
}

struct Room<'a> {
    machine: &'a Machine,
    laws: [Law; 5],
}

impl<'a> Room<'a> {
    fn new(machine: &'a Machine, calibration: &Calibration) -> Self {
        Room { machine, laws: Mode::ALL.map(|mode| Law::new(calibration, mode.switches(), calibration.fibre_point)) }
    }

    /// True when every motor stays within its own travel, whatever is switched on.
    fn holds(&self, pose: &[f64; AXES]) -> bool {
        let fine = FinePose(pose.map(|u| (u * Q32) as i64));
        self.laws.iter().all(|law| {
            let counts = law.targets(&fine, &mut Remembered::default()).floor().0;
            self.machine.drives.iter().zip(counts).all(|(drive, count)| {
                let at = f64::from(count) * drive.step;
                // half a step for the rounding of the very end of the travel
                at >= drive.travel[0] - 0.5 * drive.step && at <= drive.travel[1] + 0.5 * drive.step
            })
        })
    }

    /// The largest share of the travel, in whole percents, that all poses may use.
    fn shrink(&self, poses: impl Fn(f64) -> Vec<[f64; AXES]>) -> (f64, Vec<[f64; AXES]>) {
        let shares = (1..=100).rev().map(|percent| f64::from(percent) / 100.0);
        let fits = |share: &f64| poses(*share).iter().all(|pose| self.holds(pose));
        let share = shares.clone().find(fits).unwrap_or(0.01);
        (share, poses(share))
    }

    /// From the lower ends to the upper ones and back.
    fn line(&self, name: &str, axes: &[Axis]) -> (Track, Vec<[f64; AXES]>) {
        let there = |i: usize| i as f64 / (STOPS - 1) as f64;
        let ways: Vec<f64> = (0..STOPS).map(there).chain((0..STOPS - 1).rev().map(there)).collect();
        let poses =
            |share: f64| ways.iter().map(|way| self.at(share, |axis| axes.contains(&axis).then_some(*way))).collect();
        let (share_of_travel, poses) = self.shrink(poses);
        let (unit, along) = match axes {
            [axis] if axis.is_rotary() => {
                ("deg", poses.iter().map(|p| (p[axis.index()] * 1e-9).to_degrees()).collect())
            }
            [axis] => ("um", poses.iter().map(|p| p[axis.index()] * 1e-3).collect()),
            _ => ("%", ways.iter().map(|way| way * 100.0).collect()),
        };
        (Track { name: name.into(), kind: Kind::Line, share_of_travel, unit, along }, poses)
    }

    /// A few micrometres about home, as an alignment does it, along the space diagonal.
    fn scan(&self) -> (Track, Vec<[f64; AXES]>) {
        let there = |i: usize| (2.0 * i as f64 / (STOPS - 1) as f64 - 1.0) * SCAN;
        let ways: Vec<f64> = (0..STOPS).map(there).chain((0..STOPS - 1).rev().map(there)).collect();
        let rest = self.at(1.0, |_| None);
        let moved = |way: &f64| std::array::from_fn(|i| if i < 3 { rest[i] + way.round() } else { rest[i] });
        let poses = ways.iter().map(moved).collect();
        let along = ways.iter().map(|way| way * 1e-3).collect();
        let name = "small scan in X, Y and Z".into();
        (Track { name, kind: Kind::Line, share_of_travel: 1.0, unit: "um", along }, poses)
    }

    /// Poses spread evenly over all six travels: a Halton sequence.
    fn poses(&self) -> (Track, Vec<[f64; AXES]>) {
        let bases = [2, 3, 5, 7, 11, 13];
        let poses = |share: f64| {
            (1..=POSES).map(|n| self.at(share, |axis| Some(radical_inverse(n, bases[axis.index()])))).collect()
        };
        let (share_of_travel, poses) = self.shrink(poses);
        let along = (1..=POSES).map(|n| n as f64).collect();
        let name = if share_of_travel < 1.0 {
            format!("{POSES} poses, {:.0} % of the travel", share_of_travel * 100.0)
        } else {
            format!("{POSES} poses over the travel")
        };
        (Track { name, kind: Kind::Poses, share_of_travel, unit: "number", along }, poses)
    }

    /// A pose at a share of the travel about its middle; None leaves an axis at home, or near it. Whole nm and nrad.
    fn at(&self, share: f64, way: impl Fn(Axis) -> Option<f64>) -> [f64; AXES] {
        Axis::ALL.map(|axis| {
            let [lower, upper] = self.machine.drives[axis.index()].travel;
            let (middle, half) = (0.5 * (lower + upper), 0.5 * (upper - lower));
            let rest = 0f64.clamp(middle - (1.0 - 2.0 * INSIDE) * half, middle + (1.0 - 2.0 * INSIDE) * half);
            way(axis)
                .map_or(rest, |way| middle + half * share * (2.0 * way - 1.0))
                .round()
                .clamp(lower.ceil(), upper.floor())
        })
    }
}

/// The digits of `n` in a base, mirrored at the point.
fn radical_inverse(mut n: usize, base: usize) -> f64 {
    let (mut value, mut digit) = (0.0, 1.0);
    while n > 0 {
        digit /= base as f64;
        value += digit * (n % base) as f64;
        n /= base;
    }
    value
}
