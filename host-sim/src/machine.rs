//! Machine files: what a stage is, in the units of its data sheet, read from TOML and checked.
//!
//! A file names every quantity with its unit (`step_nm`, `travel_deg`); here they become nm and nrad
//! in axis order. Errors name the key and the value.

use serde::Deserialize;
use stage_controller::units::{AXES, Axis};
use std::f64::consts::PI;
use std::path::Path;

/// Highest step rate of one motor in steps per second (pulse timing of the step generator).
pub const STEP_RATE_CEILING: f64 = 499_000.0;

/// Smallest step in nm or nrad: the coupling row needs `30 + floor(log2 step)` bits, at least 31.
pub const SMALLEST_STEP: f64 = 2.0;

/// Steps of this size (nm or nrad) and more do not fit the calibration block.
pub const STEP_LIMIT: f64 = 32_768.0;

/// Largest static angular error that is taken for one, in radians: beyond it a unit was mistaken.
pub const LARGEST_STATIC: f64 = 0.02;

const DEFAULT: &str = include_str!("../machines/paper.toml");
const NRAD_PER_DEG: f64 = PI / 180.0 * 1e9;

/// Why a machine file is refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MachineError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// Not TOML, an unknown or missing key, or a value of the wrong kind; shows the line.
    #[error("{0}")]
    Syntax(#[from] toml::de::Error),
    /// A value that no machine can have.
    #[error("{key} = {value}: {reason}")]
    Value {
        /// Full name of the key, such as `axes.X.step_nm`.
        key: String,
        /// The value found.
        value: String,
        /// What it must be.
        reason: String,
    },
}

impl MachineError {
    fn value(key: impl Into<String>, value: impl ToString, reason: impl Into<String>) -> Self {
        MachineError::Value {
            key: key.into(),
            value: value.to_string(),
            reason: reason.into(),
        }
    }
}

/// The nine position-independent angular errors in radians (ERROR-MODEL 2), right-handed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case)]
pub struct StaticErrors {
    /// Squareness of Z and X, about y.
    pub S_ZX: f64,
    /// Squareness of Z and Y, about x.
    pub S_ZY: f64,
    /// Squareness of X and Y, about z.
    pub S_XY: f64,
    /// Tilt of the gamma axis about x.
    pub ex_gamma: f64,
    /// Tilt of the gamma axis about y.
    pub ey_gamma: f64,
    /// Tilt of the beta axis about x.
    pub ex_beta: f64,
    /// Tilt of the beta axis about z.
    pub ez_beta: f64,
    /// Tilt of the alpha axis about y.
    pub ey_alpha: f64,
    /// Tilt of the alpha axis about z.
    pub ez_alpha: f64,
}

impl StaticErrors {
    /// Names in machine files, in the order of [`StaticErrors::values`].
    pub const NAMES: [&'static str; 9] = [
        "S_ZX", "S_ZY", "S_XY", "ex_gamma", "ey_gamma", "ex_beta", "ez_beta", "ey_alpha",
        "ez_alpha",
    ];

    /// The nine values in radians.
    pub fn values(&self) -> [f64; 9] {
        [
            self.S_ZX,
            self.S_ZY,
            self.S_XY,
            self.ex_gamma,
            self.ey_gamma,
            self.ex_beta,
            self.ez_beta,
            self.ey_alpha,
            self.ez_alpha,
        ]
    }

    /// The errors from their values in the order of [`StaticErrors::NAMES`].
    pub fn from_values(v: [f64; 9]) -> Self {
        StaticErrors {
            S_ZX: v[0],
            S_ZY: v[1],
            S_XY: v[2],
            ex_gamma: v[3],
            ey_gamma: v[4],
            ex_beta: v[5],
            ez_beta: v[6],
            ey_alpha: v[7],
            ez_alpha: v[8],
        }
    }
}

/// One motor and the stage that it drives, in nm or, for a rotary stage, nrad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Size of one step.
    pub step: f64,
    /// Width of the play.
    pub backlash: f64,
    /// Lower and upper end of the travel.
    pub travel: [f64; 2],
    /// Largest velocity per second.
    pub velocity: f64,
    /// Largest acceleration per second squared.
    pub acceleration: f64,
    /// Largest jerk per second cubed.
    pub jerk: f64,
}

/// A checked machine description.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Name, at most 16 printable ASCII characters.
    pub name: String,
    /// The stages from the base to the fibre array: a permutation of the six axes.
    pub order: [Axis; AXES],
    /// The fibre point F in the fibre array frame, nm.
    pub fibre_point_nm: [f64; 3],
    /// Nominal position of each joint frame in the one before it, nm, in axis order.
    pub axis_offset_nm: [[f64; 3]; AXES],
    /// Static angular errors.
    pub statics: StaticErrors,
    /// Motors in axis order.
    pub drives: [Drive; AXES],
}

impl Machine {
    /// Reads and checks a machine file.
    ///
    /// # Errors
    /// When the file cannot be read, parsed or believed.
    pub fn load(path: &Path) -> Result<Self, MachineError> {
        let text = std::fs::read_to_string(path).map_err(|source| MachineError::Read {
            path: path.display().to_string(),
            source,
        })?;
        Self::parse(&text)
    }

    /// Parses and checks the text of a machine file.
    ///
    /// # Errors
    /// When the text is not a machine or a value cannot be believed.
    pub fn parse(text: &str) -> Result<Self, MachineError> {
        toml::from_str::<MachineFile>(text)?.try_into()
    }

    /// The built-in machine `paper`: the stage of the paper (ERROR-MODEL 4).
    pub fn paper() -> Self {
        Self::parse(DEFAULT).expect("the built-in machine is valid")
    }
}

/// A machine file as written: keys and units of the file, unchecked. Becomes a [`Machine`] by `try_into`.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MachineFile {
    name: String,
    order: Vec<String>,
    fibre_point_um: [f64; 3],
    #[serde(default)]
    axis_offset_um: Offsets,
    #[serde(default)]
    static_rad: StaticErrors,
    axes: Stages,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
#[allow(non_snake_case)]
struct Offsets {
    X: [f64; 3],
    Y: [f64; 3],
    Z: [f64; 3],
    alpha: [f64; 3],
    beta: [f64; 3],
    gamma: [f64; 3],
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
    travel_um: [f64; 2],
    max_velocity_um_s: f64,
    max_acceleration_um_s2: f64,
    max_jerk_um_s3: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RotaryStage {
    step_nrad: f64,
    backlash_nrad: f64,
    travel_deg: [f64; 2],
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
    rates: [f64; 3],
}

impl Written {
    fn linear(axis: Axis, s: &LinearStage) -> Self {
        let rates = [
            s.max_velocity_um_s,
            s.max_acceleration_um_s2,
            s.max_jerk_um_s3,
        ];
        Written {
            axis,
            step: s.step_nm,
            backlash: s.backlash_nm,
            travel: s.travel_um,
            rates,
        }
    }

    fn rotary(axis: Axis, s: &RotaryStage) -> Self {
        let rates = [
            s.max_velocity_deg_s,
            s.max_acceleration_deg_s2,
            s.max_jerk_deg_s3,
        ];
        Written {
            axis,
            step: s.step_nrad,
            backlash: s.backlash_nrad,
            travel: s.travel_deg,
            rates,
        }
    }

    fn key(&self, quantity: &str, per: &str) -> String {
        let (fine, coarse) = if self.axis.is_rotary() {
            ("nrad", "deg")
        } else {
            ("nm", "um")
        };
        let unit = if matches!(quantity, "step" | "backlash") {
            fine
        } else {
            coarse
        };
        format!("axes.{}.{quantity}_{unit}{per}", self.axis.name())
    }

    fn check(&self) -> Result<Drive, MachineError> {
        let scale = if self.axis.is_rotary() {
            NRAD_PER_DEG
        } else {
            1e3
        };
        if !(SMALLEST_STEP..STEP_LIMIT).contains(&self.step) {
            let reason = format!("a step must be at least {SMALLEST_STEP} and below {STEP_LIMIT}");
            return Err(MachineError::value(self.key("step", ""), self.step, reason));
        }
        if !(self.backlash.is_finite() && self.backlash >= 0.0) {
            let reason = "a backlash must be zero or positive";
            return Err(MachineError::value(
                self.key("backlash", ""),
                self.backlash,
                reason,
            ));
        }
        let [lower, upper] = self.travel;
        if !(lower.is_finite() && upper.is_finite() && lower < upper) {
            let reason = "the lower end of the travel must be below the upper";
            return Err(MachineError::value(
                self.key("travel", ""),
                format!("[{lower}, {upper}]"),
                reason,
            ));
        }
        let names = [
            ("max_velocity", "_s"),
            ("max_acceleration", "_s2"),
            ("max_jerk", "_s3"),
        ];
        for ((quantity, per), rate) in names.into_iter().zip(self.rates) {
            if !(rate.is_finite() && rate > 0.0) {
                return Err(MachineError::value(
                    self.key(quantity, per),
                    rate,
                    "a rate must be positive",
                ));
            }
        }
        let [velocity, acceleration, jerk] = self.rates.map(|rate| rate * scale);
        let step_rate = velocity / self.step;
        if step_rate > STEP_RATE_CEILING * (1.0 + 1e-12) {
            let reason = format!(
                "needs {step_rate:.0} steps/s of motor {}, at most {STEP_RATE_CEILING}",
                self.axis.name()
            );
            return Err(MachineError::value(
                self.key("max_velocity", "_s"),
                self.rates[0],
                reason,
            ));
        }
        let travel = [lower * scale, upper * scale];
        Ok(Drive {
            step: self.step,
            backlash: self.backlash,
            travel,
            velocity,
            acceleration,
            jerk,
        })
    }
}

impl TryFrom<MachineFile> for Machine {
    type Error = MachineError;

    fn try_from(file: MachineFile) -> Result<Self, MachineError> {
        let printable = file.name.bytes().all(|b| b.is_ascii_graphic() || b == b' ');
        if file.name.is_empty() || file.name.len() > 16 || !printable {
            let reason = "a name has 1 to 16 printable ASCII characters";
            return Err(MachineError::value(
                "name",
                format!("{:?}", file.name),
                reason,
            ));
        }
        let order = parse_order(&file.order)?;
        let position = |key: &str, um: [f64; 3]| {
            if um.iter().all(|v| v.is_finite()) {
                Ok(um.map(|v| v * 1e3))
            } else {
                Err(MachineError::value(
                    key,
                    format!("{um:?}"),
                    "a position must be finite",
                ))
            }
        };
        let offsets = &file.axis_offset_um;
        let written = [
            offsets.X,
            offsets.Y,
            offsets.Z,
            offsets.alpha,
            offsets.beta,
            offsets.gamma,
        ];
        let mut axis_offset_nm = [[0.0; 3]; AXES];
        for axis in Axis::ALL {
            let key = format!("axis_offset_um.{}", axis.name());
            axis_offset_nm[axis.index()] = position(&key, written[axis.index()])?;
        }
        for (name, value) in StaticErrors::NAMES
            .into_iter()
            .zip(file.static_rad.values())
        {
            if !(-LARGEST_STATIC..=LARGEST_STATIC).contains(&value) {
                let reason = format!("a static error is at most {LARGEST_STATIC} rad");
                return Err(MachineError::value(
                    format!("static_rad.{name}"),
                    value,
                    reason,
                ));
            }
        }
        let stages = &file.axes;
        let drives = [
            Written::linear(Axis::X, &stages.X).check()?,
            Written::linear(Axis::Y, &stages.Y).check()?,
            Written::linear(Axis::Z, &stages.Z).check()?,
            Written::rotary(Axis::Alpha, &stages.alpha).check()?,
            Written::rotary(Axis::Beta, &stages.beta).check()?,
            Written::rotary(Axis::Gamma, &stages.gamma).check()?,
        ];
        Ok(Machine {
            fibre_point_nm: position("fibre_point_um", file.fibre_point_um)?,
            name: file.name,
            order,
            axis_offset_nm,
            statics: file.static_rad,
            drives,
        })
    }
}

fn parse_order(written: &[String]) -> Result<[Axis; AXES], MachineError> {
    let refused = |reason: &str| MachineError::value("order", format!("{written:?}"), reason);
    let mut order = Vec::with_capacity(AXES);
    for name in written {
        let known = Axis::ALL.into_iter().find(|axis| axis.name() == name);
        let axis = known
            .ok_or_else(|| refused(&format!("{name:?} is none of X, Y, Z, alpha, beta, gamma")))?;
        if order.contains(&axis) {
            return Err(refused(&format!("{name} is named twice")));
        }
        order.push(axis);
    }
    order
        .try_into()
        .map_err(|_| refused("all six axes must be named"))
}
