//! The keys and units of a machine file, and the checks of its values.

use super::kinematic::KinematicFile;
use super::{
    Drive, LARGEST_STATIC, Machine, MachineError, Mount, Mounts, SMALLEST_STEP, STEP_LIMIT, STEP_RATE_CEILING,
    StaticErrors,
};
use serde::Deserialize;
use stage_controller::controller::front::{REFERENCE_NM, REFERENCE_NRAD};
use stage_controller::units::{AXES, Axis, COORDINATE_LIMIT};
use std::f64::consts::PI;

/// nrad in a degree.
pub const NRAD_PER_DEG: f64 = PI / 180.0 * 1e9;
/// Widest play in steps that the calibration block takes.
const LARGEST_BACKLASH_STEPS: f64 = 1_048_576.0;
/// Largest velocity, acceleration or jerk, nm or nrad per s, s^2, s^3; each has its own smaller limit in the block.
const LARGEST_RATE: f64 = 1e15;
/// Farthest that a position in the file may lie, um: a sixteenth of a nanometre of it fits 31 bits.
pub const FARTHEST_UM: f64 = 67_000.0;

/// So many numbers, no fewer and no more.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(try_from = "Vec<f64>")]
pub(super) struct Row<const N: usize>(pub(super) [f64; N]);

impl<const N: usize> Default for Row<N> {
    fn default() -> Self {
        Row([0.0; N])
    }
}

impl<const N: usize> TryFrom<Vec<f64>> for Row<N> {
    type Error = String;

    fn try_from(numbers: Vec<f64>) -> Result<Self, String> {
        let written = format!("{numbers:?}");
        numbers.try_into().map(Row).map_err(|_| format!("{written} must be {N} numbers"))
    }
}

/// A machine file as written: keys and units of the file, unchecked. Becomes a [`Machine`] by `try_into`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineFile {
    name: String,
    order: Vec<String>,
    fibre_point_um: Row<3>,
    #[serde(default)]
    axis_offset_um: Offsets,
    #[serde(default)]
    static_rad: StaticErrors,
    #[serde(default)]
    mount: MountsFile,
    #[serde(default)]
    kinematic: KinematicFile,
    axes: Stages,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct MountsFile {
    fibre: MountFile,
    chip: MountFile,
}

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct MountFile {
    offset_um: Row<3>,
    rot_rad: Row<3>,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case)]
struct Offsets {
    X: Row<3>,
    Y: Row<3>,
    Z: Row<3>,
    alpha: Row<3>,
    beta: Row<3>,
    gamma: Row<3>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(non_snake_case)]
struct Stages {
    X: LinearStage,
    Y: LinearStage,
    Z: LinearStage,
    alpha: RotaryStage,
    beta: RotaryStage,
    gamma: RotaryStage,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinearStage {
    step_nm: f64,
    backlash_nm: f64,
    travel_um: Row<2>,
    #[serde(default)]
    switches_um: Option<Row<2>>,
    max_velocity_um_s: f64,
    max_acceleration_um_s2: f64,
    max_jerk_um_s3: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RotaryStage {
    step_nrad: f64,
    backlash_nrad: f64,
    travel_deg: Row<2>,
    #[serde(default)]
    switches_deg: Option<Row<2>>,
    max_velocity_deg_s: f64,
    max_acceleration_deg_s2: f64,
    max_jerk_deg_s3: f64,
}

/// One stage in the units of the file, with what its keys are called.
struct Written {
    axis: Axis,
    step: f64,
    backlash: f64,
    travel: [f64; 2],
    switches: Option<[f64; 2]>,
    rates: [f64; 3],
}

impl Written {
    fn linear(axis: Axis, s: &LinearStage) -> Self {
        let rates = [s.max_velocity_um_s, s.max_acceleration_um_s2, s.max_jerk_um_s3];
        let switches = s.switches_um.map(|row| row.0);
        Written { axis, step: s.step_nm, backlash: s.backlash_nm, travel: s.travel_um.0, switches, rates }
    }

    fn rotary(axis: Axis, s: &RotaryStage) -> Self {
        let rates = [s.max_velocity_deg_s, s.max_acceleration_deg_s2, s.max_jerk_deg_s3];
        let switches = s.switches_deg.map(|row| row.0);
        Written { axis, step: s.step_nrad, backlash: s.backlash_nrad, travel: s.travel_deg.0, switches, rates }
    }

    fn key(&self, quantity: &str, per: &str) -> String {
        let (fine, coarse) = if self.axis.is_rotary() { ("nrad", "deg") } else { ("nm", "um") };
        let unit = if matches!(quantity, "step" | "backlash") { fine } else { coarse };
        format!("axes.{}.{quantity}_{unit}{per}", self.axis.name())
    }

    fn check(&self) -> Result<Drive, MachineError> {
        let scale = if self.axis.is_rotary() { NRAD_PER_DEG } else { 1e3 };
        if !(SMALLEST_STEP..STEP_LIMIT).contains(&self.step) {
            let reason = format!("a step must be at least {SMALLEST_STEP} and below {STEP_LIMIT}");
            return Err(MachineError::value(self.key("step", ""), self.step, reason));
        }
        if !(0.0..=LARGEST_BACKLASH_STEPS * self.step).contains(&self.backlash) {
            let reason = format!("a backlash must be zero or positive, at most {LARGEST_BACKLASH_STEPS} steps");
            return Err(MachineError::value(self.key("backlash", ""), self.backlash, reason));
        }
        let [lower, upper] = self.travel;
        let reach = f64::from(COORDINATE_LIMIT) / scale;
        if !(lower < upper && lower >= -reach && upper <= reach) {
            let reason = format!("the lower end of the travel must be below the upper, both within {reach:.0}");
            return Err(MachineError::value(self.key("travel", ""), format!("[{lower}, {upper}]"), reason));
        }
        let names = [("max_velocity", "_s"), ("max_acceleration", "_s2"), ("max_jerk", "_s3")];
        for ((quantity, per), rate) in names.into_iter().zip(self.rates) {
            // the block counts whole nm or nrad per s, s^2, s^3
            if !(rate * scale >= 1.0 && rate * scale <= LARGEST_RATE) {
                let reason =
                    format!("a rate must be at least {:e} and at most {:e}", 1.0 / scale, LARGEST_RATE / scale);
                return Err(MachineError::value(self.key(quantity, per), rate, reason));
            }
        }
        let [velocity, acceleration, jerk] = self.rates.map(|rate| rate * scale);
        let step_rate = velocity / self.step;
        if step_rate > STEP_RATE_CEILING * (1.0 + 1e-12) {
            let reason =
                format!("needs {step_rate:.0} steps/s of motor {}, at most {STEP_RATE_CEILING}", self.axis.name());
            return Err(MachineError::value(self.key("max_velocity", "_s"), self.rates[0], reason));
        }
        let travel = [lower * scale, upper * scale];
        let beyond = if self.axis.is_rotary() { REFERENCE_NRAD } else { REFERENCE_NM } as f64;
        let switches = match self.switches {
            None => [travel[0] - beyond, travel[1] + beyond],
            Some([first, last]) if first < last && first >= -reach && last <= reach => [first * scale, last * scale],
            Some([first, last]) => {
                let reason = format!("the lower switch must be below the upper, both within {reach:.0}");
                return Err(MachineError::value(self.key("switches", ""), format!("[{first}, {last}]"), reason));
            }
        };
        Ok(Drive { step: self.step, backlash: self.backlash, travel, switches, velocity, acceleration, jerk })
    }
}

impl TryFrom<MachineFile> for Machine {
    type Error = MachineError;

    fn try_from(file: MachineFile) -> Result<Self, MachineError> {
        let printable = file.name.bytes().all(|b| b.is_ascii_graphic() || b == b' ');
        if file.name.is_empty() || file.name.len() > 16 || !printable {
            let reason = "a name has 1 to 16 printable ASCII characters";
            return Err(MachineError::value("name", format!("{:?}", file.name), reason));
        }
        let order = parse_order(&file.order)?;
        let position = |key: &str, um: [f64; 3]| {
            if um.iter().all(|v| v.abs() <= FARTHEST_UM) {
                Ok(um.map(|v| v * 1e3))
            } else {
                let reason = format!("a position must be a number within +-{FARTHEST_UM} um");
                Err(MachineError::value(key, format!("{um:?}"), reason))
            }
        };
        let offsets = &file.axis_offset_um;
        let written = [offsets.X, offsets.Y, offsets.Z, offsets.alpha, offsets.beta, offsets.gamma];
        let mut axis_offset_nm = [[0.0; 3]; AXES];
        for axis in Axis::ALL {
            let key = format!("axis_offset_um.{}", axis.name());
            axis_offset_nm[axis.index()] = position(&key, written[axis.index()].0)?;
        }
        for (name, value) in StaticErrors::NAMES.into_iter().zip(file.static_rad.values()) {
            if !(-LARGEST_STATIC..=LARGEST_STATIC).contains(&value) {
                let reason = format!("a static error is at most {LARGEST_STATIC} rad");
                return Err(MachineError::value(format!("static_rad.{name}"), value, reason));
            }
        }
        let mount = |name: &str, written: MountFile| {
            let rotation_rad = written.rot_rad.0;
            if !rotation_rad.iter().all(|v| v.abs() <= LARGEST_STATIC) {
                let reason = format!("a mounting error is at most {LARGEST_STATIC} rad about each axis");
                return Err(MachineError::value(format!("mount.{name}.rot_rad"), format!("{rotation_rad:?}"), reason));
            }
            let offset_nm = position(&format!("mount.{name}.offset_um"), written.offset_um.0)?;
            Ok(Mount { offset_nm, rotation_rad })
        };
        let mounts = Mounts { fibre: mount("fibre", file.mount.fibre)?, chip: mount("chip", file.mount.chip)? };
        let stages = &file.axes;
        let drives = [
            Written::linear(Axis::X, &stages.X).check()?,
            Written::linear(Axis::Y, &stages.Y).check()?,
            Written::linear(Axis::Z, &stages.Z).check()?,
            Written::rotary(Axis::Alpha, &stages.alpha).check()?,
            Written::rotary(Axis::Beta, &stages.beta).check()?,
            Written::rotary(Axis::Gamma, &stages.gamma).check()?,
        ];
        let travels = std::array::from_fn(|i| {
            let scale = if Axis::ALL[i].is_rotary() { NRAD_PER_DEG } else { 1e3 };
            drives[i].travel.map(|end| end / scale)
        });
        Ok(Machine {
            kinematic: file.kinematic.check(travels)?,
            fibre_point_nm: position("fibre_point_um", file.fibre_point_um.0)?,
            name: file.name,
            order,
            axis_offset_nm,
            statics: file.static_rad,
            mounts,
            drives,
        })
    }
}

fn parse_order(written: &[String]) -> Result<[Axis; AXES], MachineError> {
    let refused = |reason: &str| MachineError::value("order", format!("{written:?}"), reason);
    let mut order = Vec::with_capacity(AXES);
    for name in written {
        let known = Axis::ALL.into_iter().find(|axis| axis.name() == name);
        let axis = known.ok_or_else(|| refused(&format!("{name:?} is none of X, Y, Z, alpha, beta, gamma")))?;
        if order.contains(&axis) {
            return Err(refused(&format!("{name} is named twice")));
        }
        order.push(axis);
    }
    order.try_into().map_err(|_| refused("all six axes must be named"))
}
