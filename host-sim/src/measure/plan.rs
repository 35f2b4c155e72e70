//! The measurements of docs/CALIBRATION.md, made on a stage whose constants are known.

use super::Settings;
use super::instrument::Noise;
use crate::identify::units::HOUR;
use crate::identify::{Behind, Constant, Kind, Walk};
use crate::machine::{Kinematic, Machine, NRAD_PER_DEG};
use crate::model::{Chain, Truth, exp};
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::Serialize;
use stage_controller::units::{AXES, Axis};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

const TARGETS: usize = 11;
const RUNS: u32 = 5;
/// From one reading to the next, s.
const INTERVAL: f64 = 2.0;
/// How far an autocollimator follows, nrad.
const AUTOCOLLIMATOR_RANGE: f64 = 5e6;

/// One file of measurements.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredFile {
    /// Name.
    pub file: String,
    /// As in its line `# kind:`.
    pub kind: &'static str,
    /// Rows.
    pub readings: usize,
    /// Rows that were spoiled on purpose.
    pub spoiled: Vec<Spoiled>,
    /// Text.
    #[serde(skip)]
    pub text: String,
}

/// A reading that was spoiled on purpose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spoiled {
    /// Line of the file.
    pub line: u64,
    /// Column.
    pub column: &'static str,
    /// By how much, nm.
    pub by: f64,
}

/// The machine as its drawing says, without what is to be measured: no static and kinematic errors, mounts and
/// backlash, and the three fitted offsets at 0.
pub fn nominal(machine: &Machine) -> Machine {
    let mut nominal = machine.clone();
    for constant in Constant::all(&machine.order) {
        constant.set(&mut nominal, 0.0);
    }
    nominal.kinematic = Kinematic::default();
    nominal.drives.iter_mut().for_each(|drive| drive.backlash = 0.0);
    nominal
}

/// All measurements of a machine; the order of its axes decides nothing.
pub fn measure(machine: &Machine, settings: &Settings) -> Vec<MeasuredFile> {
    let mut stage = Stage {
        machine,
        chain: Chain::new(machine),
        truth: Truth::new(machine),
        noise: Noise::new(settings.seed),
        settings,
        files: Vec::new(),
    };
    Axis::ALL.into_iter().for_each(|axis| stage.positioning(axis));
    for axis in Axis::LINEAR {
        for direction in (0..3).filter(|direction| *direction != axis.index()) {
            stage.straightness(axis, direction);
        }
    }
    stage.squareness();
    stage.diagonal();
    stage.autocollimator();
    stage.fibre();
    stage.orientation();
    stage.files
}

struct Stage<'a> {
    machine: &'a Machine,
    chain: Chain,
    truth: Truth,
    noise: Noise,
    settings: &'a Settings,
    files: Vec<MeasuredFile>,
}

/// A file as it grows.
struct Sheet {
    text: String,
    line: u64,
    readings: usize,
    /// Per hour, of each column.
    drift: [f64; 3],
    noise: f64,
}

impl Sheet {
    fn push(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
        self.line += 1;
    }

    fn time(&self) -> f64 {
        self.readings as f64 * INTERVAL
    }

    fn drifted(&self, column: usize) -> f64 {
        self.drift[column] * self.time() / HOUR
    }
}

impl Stage<'_> {
    fn sheet(&mut self, kind: Kind, keys: &[String], columns: &str) -> Sheet {
        let settings = self.settings;
        let angle = kind.quantity() == crate::identify::units::Quantity::Angle;
        let (noise, drift, unit) = if angle {
            (settings.noise_nrad, settings.drift_nrad_per_hour, "urad")
        } else {
            (settings.noise_nm, settings.drift_nm_per_hour, "um")
        };
        let drift = [0; 3].map(|_| self.noise.between(-drift, drift));
        let mut sheet = Sheet { text: String::new(), line: 0, readings: 0, drift, noise };
        sheet.push(&format!("# kind: {}", kind.name()));
        sheet.push(&format!("# made by: host-sim measure, seed {}", settings.seed));
        sheet.push(&format!("# order: {}", self.machine.order.map(Axis::name).join(" ")));
        keys.iter().for_each(|key| sheet.push(&format!("# {key}")));
        if settings.state_noise && noise > 0.0 {
            sheet.push(&format!("# noise_{unit}: {}", noise * 1e-3));
        }
        sheet.push(columns);
        sheet
    }

    fn close(&mut self, name: String, kind: Kind, sheet: Sheet, spoiled: Vec<Spoiled>) {
        let Sheet { text, readings, .. } = sheet;
        self.files.push(MeasuredFile { file: format!("{name}.csv"), kind: kind.name(), readings, spoiled, text });
    }

    /// Whole steps nearest to a position.
    fn stepped(&self, axis: Axis, position: f64) -> f64 {
        let step = self.machine.drives[axis.index()].step;
        (position / step).round() * step
    }

    /// Evenly spaced whole-step targets over the travel.
    fn targets(&self, axis: Axis) -> Vec<f64> {
        let [lower, upper] = self.machine.drives[axis.index()].travel;
        let at = |k: usize| lower + (upper - lower) * (k as f64 + 0.5) / TARGETS as f64;
        (0..TARGETS).map(|k| self.stepped(axis, at(k))).collect()
    }

    /// Whole-step motor positions anywhere in the travel.
    fn anywhere(&mut self) -> [f64; AXES] {
        Axis::ALL.map(|axis| {
            let [lower, upper] = self.machine.drives[axis.index()].travel;
            let position = self.noise.between(lower, upper);
            self.stepped(axis, position)
        })
    }

    fn play(&self) -> [f64; AXES] {
        self.machine.drives.map(|drive| drive.backlash)
    }

    /// Actuators with one motor away from home.
    fn alone(&self, axis: Axis, target: f64, down: bool) -> [f64; AXES] {
        let mut actuators = [0.0; AXES];
        actuators[axis.index()] = if down { target + self.machine.drives[axis.index()].backlash } else { target };
        actuators
    }

    fn positioning(&mut self, axis: Axis) {
        let kind = Kind::Positioning(axis);
        let (unit, size) = if axis.is_rotary() { ("deg", NRAD_PER_DEG) } else { ("um", 1e3) };
        let read = if axis.is_rotary() { "urad" } else { "um" };
        let instrument = if axis.is_rotary() { "autocollimator and polygon" } else { "laser interferometer" };
        let keys = [format!("axis: {}", axis.name()), format!("instrument: {instrument}")];
        let mut sheet = self.sheet(kind, &keys, &format!("target_{unit},run,direction,measured_{read},time_s"));
        let zero = self.noise.between(-1e3, 1e3);
        let (home_rotation, home) = self.truth.place([0.0; AXES]);
        let targets = self.targets(axis);
        for run in 1..=RUNS {
            for down in [false, true] {
                let mut way = targets.clone();
                if down {
                    way.reverse();
                }
                for target in way {
                    let (rotation, point) = self.truth.place(self.alone(axis, target, down));
                    let moved = if axis.is_rotary() {
                        let screw = self.chain.screws()[axis.index() - 3];
                        scaled_axis(&(rotation * home_rotation.transpose())).dot(&screw.direction) * 1e9
                    } else {
                        self.chain.slides_matrix().column(axis.index()).dot(&(point - home))
                    };
                    let value = moved + zero + sheet.noise * self.noise.normal() + sheet.drifted(0);
                    let (at, direction) = (target / size, if down { "down" } else { "up" });
                    let digits = if axis.is_rotary() { 10 } else { 6 };
                    let time = sheet.time();
                    sheet.push(&format!("{at:.digits$},{run},{direction},{:.6},{time}", value * 1e-3));
                    sheet.readings += 1;
                }
            }
        }
        self.close(format!("positioning-{}", axis.name()), kind, sheet, Vec::new());
    }

    fn straightness(&mut self, axis: Axis, direction: usize) {
        let kind = Kind::Straightness { axis, direction, to_chip: false };
        let name = ["x", "y", "z"][direction];
        let keys = [format!("axis: {}", axis.name()), format!("direction: {name}"), "reference: free".into()];
        let mut sheet = self.sheet(kind, &keys, "target_um,run,direction,measured_um,time_s");
        let (offset, slope) = (self.noise.between(-5e3, 5e3), self.noise.between(-1e-4, 1e-4));
        let home = self.chain.fibre_home();
        for run in 1..=2 {
            for target in self.targets(axis) {
                let (_, point) = self.truth.place(self.alone(axis, target, false));
                let value = point[direction] - home[direction] + offset + slope * target + sheet.drifted(0);
                let value = value + sheet.noise * self.noise.normal();
                let time = sheet.time();
                sheet.push(&format!("{:.6},{run},up,{:.6},{time}", target * 1e-3, value * 1e-3));
                sheet.readings += 1;
            }
        }
        self.close(format!("straightness-{}-{name}", axis.name()), kind, sheet, Vec::new());
    }

    fn squareness(&mut self) {
        let kind = Kind::Squareness;
        let mut sheet = self.sheet(kind, &["instrument: granite square".into()], "pair,measured_urad");
        let slides = self.chain.slides_matrix();
        for (pair, a, b) in [("XY", 0, 1), ("ZX", 2, 0), ("ZY", 2, 1)] {
            for _ in 0..RUNS {
                let angle = slides.column(a).dot(&slides.column(b)).acos() - FRAC_PI_2;
                let value = angle * 1e9 + sheet.noise * self.noise.normal();
                sheet.push(&format!("{pair},{:.6}", value * 1e-3));
                sheet.readings += 1;
            }
        }
        self.close("squareness".into(), kind, sheet, Vec::new());
    }

    fn diagonal(&mut self) {
        let kind = Kind::Diagonal;
        let keys = ["approach: up".into(), "instrument: laser interferometer".into()];
        let mut sheet = self.sheet(kind, &keys, "line,at_X_um,at_Y_um,at_Z_um,distance_um,time_s");
        for (line, signs) in (1..).zip([[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]]) {
            let zero = self.noise.between(-1e3, 1e3);
            let mut start = None;
            for k in 0..TARGETS {
                let mut motors = [0.0; AXES];
                for axis in Axis::LINEAR {
                    let targets = self.targets(axis);
                    motors[axis.index()] = targets[if signs[axis.index()] > 0.0 { k } else { TARGETS - 1 - k }];
                }
                let (_, point) = self.truth.place(motors);
                let from = *start.get_or_insert(point);
                let value = (point - from).norm() + zero + sheet.noise * self.noise.normal() + sheet.drifted(0);
                let [x, y, z] = [motors[0], motors[1], motors[2]].map(|v| v * 1e-3);
                let time = sheet.time();
                sheet.push(&format!("{line},{x:.6},{y:.6},{z:.6},{:.6},{time}", value * 1e-3));
                sheet.readings += 1;
            }
        }
        self.close("diagonal".into(), kind, sheet, Vec::new());
    }

    fn autocollimator(&mut self) {
        let normal = 2;
        let kind = Kind::Autocollimator(normal);
        let keys = ["normal: z".into(), "approach: up".into(), "instrument: autocollimator".into()];
        let mut sheet =
            self.sheet(kind, &keys, "at_alpha_deg,at_beta_deg,at_gamma_deg,about_x_urad,about_y_urad,time_s");
        let zero = [0; 2].map(|_| self.noise.between(-1e5, 1e5));
        let tilt = Vector3::new(self.noise.between(-1e-3, 1e-3), self.noise.between(-1e-3, 1e-3), 0.0);
        for _ in 0..60 {
            let mut motors = self.anywhere();
            motors[..3].fill(0.0);
            for axis in [Axis::Alpha, Axis::Beta] {
                let reach = self.machine.drives[axis.index()].travel.map(f64::abs);
                let share = (AUTOCOLLIMATOR_RANGE / reach[0].max(reach[1])).min(1.0);
                motors[axis.index()] = self.stepped(axis, motors[axis.index()] * share);
            }
            let (rotation, _) = self.truth.place(motors);
            let n = rotation * exp(tilt) * Vector3::z();
            let angles = [(-n.y).atan2(n.z), n.x.atan2(n.z)];
            let mut value =
                |c: usize| (angles[c] * 1e9 + zero[c] + sheet.noise * self.noise.normal() + sheet.drifted(c)) * 1e-3;
            let (about_x, about_y) = (value(0), value(1));
            let [a, b, g] = [motors[3], motors[4], motors[5]].map(|v| v / NRAD_PER_DEG);
            let time = sheet.time();
            sheet.push(&format!("{a:.10},{b:.10},{g:.10},{about_x:.6},{about_y:.6},{time}"));
            sheet.readings += 1;
        }
        self.close("autocollimator-z".into(), kind, sheet, Vec::new());
    }

    fn pose_columns(motors: &[f64; AXES]) -> String {
        let mut text = String::new();
        for axis in Axis::ALL {
            let value = motors[axis.index()];
            let written = if axis.is_rotary() {
                write!(text, "{:.10},", value / NRAD_PER_DEG)
            } else {
                write!(text, "{:.6},", value * 1e-3)
            };
            written.expect("writing to a string");
        }
        text
    }

    fn fibre(&mut self) {
        let kind = Kind::Fibre(None);
        let keys = ["approach: sequence".into(), "instrument: 3D probe".into()];
        let columns = "at_X_um,at_Y_um,at_Z_um,at_alpha_deg,at_beta_deg,at_gamma_deg,x_um,y_um,z_um,time_s";
        let mut sheet = self.sheet(kind, &keys, columns);
        let count = self.settings.fibre_poses;
        let mut spoiled_rows: Vec<usize> = Vec::new();
        while spoiled_rows.len() < self.settings.outliers.min(count / 10) {
            let row = self.noise.below(count);
            if !spoiled_rows.contains(&row) {
                spoiled_rows.push(row);
            }
        }
        let mut spoiled = Vec::new();
        let mut walk = Walk::new(self.play());
        for row in 0..count {
            let motors = self.anywhere();
            let Behind { actuators, .. } = walk.to(&motors);
            let (_, point) = self.truth.place(actuators);
            let mut value: [f64; 3] =
                std::array::from_fn(|c| point[c] + sheet.noise * self.noise.normal() + sheet.drifted(c));
            if spoiled_rows.contains(&row) {
                let c = self.noise.below(3);
                // from clearly wrong to a missed count
                let sign = if self.noise.below(2) == 0 { 1.0 } else { -1.0 };
                let by = sign * self.noise.between(20.0, 2000.0) * sheet.noise.max(1.0);
                value[c] += by;
                spoiled.push(Spoiled { line: sheet.line + 1, column: kind.columns()[c], by });
            }
            let [x, y, z] = value.map(|v| v * 1e-3);
            let time = sheet.time();
            sheet.push(&format!("{}{x:.6},{y:.6},{z:.6},{time}", Self::pose_columns(&motors)));
            sheet.readings += 1;
        }
        self.close("fibre".into(), kind, sheet, spoiled);
    }

    fn orientation(&mut self) {
        let kind = Kind::Orientation;
        let keys = ["approach: sequence".into(), "instrument: autocollimators on two mirrors".into()];
        let columns = "at_X_um,at_Y_um,at_Z_um,at_alpha_deg,at_beta_deg,at_gamma_deg,rx_urad,ry_urad,rz_urad,time_s";
        let mut sheet = self.sheet(kind, &keys, columns);
        let mut walk = Walk::new(self.play());
        for _ in 0..self.settings.orientation_poses {
            let motors = self.anywhere();
            let (rotation, _) = self.truth.place(walk.to(&motors).actuators);
            let noise = Vector3::from_fn(|_, _| sheet.noise * self.noise.normal());
            let drift = Vector3::from_fn(|c, _| sheet.drifted(c));
            let vector = scaled_axis(&(exp((noise + drift) * 1e-9) * rotation)) * 1e6;
            let time = sheet.time();
            let row = format!("{}{:.6},{:.6},{:.6},{time}", Self::pose_columns(&motors), vector.x, vector.y, vector.z);
            sheet.push(&row);
            sheet.readings += 1;
        }
        self.close("orientation".into(), kind, sheet, Vec::new());
    }
}

/// Rotation vector of a rotation, rad.
fn scaled_axis(rotation: &Matrix3<f64>) -> Vector3<f64> {
    Rotation3::from_matrix_unchecked(*rotation).scaled_axis()
}
