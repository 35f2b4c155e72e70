//! `host-sim field`: accuracy of the fibre point over the travel.

use super::Failure;
use super::common::{load, replace, say, spares, with_progress, writable};
use super::sheet::{Sheet, Sizes, Style, numbers, positive, three};
use crate::machine::Machine;
use crate::model::{
    Accuracy, AccuracyOptions, Ensemble, EnsembleStatistics, ErrorModel, FirstOrderGap, Motion, MotionAccuracy,
    Statistics, accuracy, accuracy_figure, beyond_travel,
};
use serde::Serialize;
use stage_controller::units::{Axis, COORDINATE_LIMIT};
use std::path::PathBuf;

/// Print how far the fibre point is from where it should be over linear and over angular motion: maximum, rms,
/// percentiles and worst pose, before and after compensation, and of ensembles of stages with errors of given size.
///
/// Errors are counted in chip axes, in um; `from home` is without the error at home, which alignment there removes.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    machine: PathBuf,
    /// Poses along each of the three stages that move, 2 to 101.
    #[arg(long, value_name = "N", default_value_t = 21, value_parser = clap::value_parser!(u16).range(2..=101))]
    points: u16,
    /// X, Y, Z from minus to plus this, um [default: the machine's travel].
    #[arg(long, value_name = "UM", value_parser = half_um)]
    linear_um: Option<f64>,
    /// alpha, beta, gamma from minus to plus this, degrees [default: the machine's travel].
    #[arg(long, value_name = "DEG", value_parser = half_deg)]
    angular_deg: Option<f64>,
    #[command(flatten)]
    sizes: Sizes,
    /// Stages of each ensemble, 1 to 100000.
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    stages: u32,
    /// Seed of chance; the same seed gives the same stages.
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Where Fig. 5 is drawn (SVG).
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// The point F in the fibre array frame, um, such as 875,100,500 [default: the machine's].
    #[arg(long, value_name = "X,Y,Z", value_parser = three, allow_hyphen_values = true)]
    fibre_point_um: Option<[f64; 3]>,
    /// Only the error of the machine, not compensated, at this pose (um and degrees); may be given again.
    #[arg(long, value_name = "X,Y,Z,ALPHA,BETA,GAMMA", value_parser = coordinates, allow_hyphen_values = true,
          conflicts_with_all = ["output", "dump"])]
    pose: Vec<[f64; 6]>,
    /// Print the fields of the machine, pose by pose, as CSV instead of their statistics.
    #[arg(long, conflicts_with_all = ["json", "csv"])]
    dump: bool,
    #[command(flatten)]
    style: Style,
}

/// Largest coordinate that a controller knows: um, degrees.
fn farthest() -> [f64; 2] {
    let limit = f64::from(COORDINATE_LIMIT);
    [limit * 1e-3, (limit * 1e-9).to_degrees()]
}

fn within(value: f64, farthest: f64, unit: &str) -> Result<f64, String> {
    if value.abs() <= farthest {
        return Ok(value);
    }
    Err(format!("{value} {unit} is beyond any machine's coordinates: at most {farthest:.3} {unit} from home"))
}

fn half_um(text: &str) -> Result<f64, String> {
    positive(text).and_then(|value| within(value, farthest()[0], "um"))
}

fn half_deg(text: &str) -> Result<f64, String> {
    positive(text).and_then(|value| within(value, farthest()[1], "deg"))
}

fn coordinates(text: &str) -> Result<[f64; 6], String> {
    let pose: [f64; 6] = numbers(text)?;
    let [um, deg] = farthest();
    for (axis, value) in Axis::ALL.into_iter().zip(pose) {
        let (farthest, unit) = if axis.is_rotary() { (deg, "deg") } else { (um, "um") };
        within(value, farthest, unit).map_err(|reason| format!("{}: {reason}", axis.name()))?;
    }
    Ok(pose)
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let mut machine = load(&self.machine)?;
        if let Some(point) = self.fibre_point_um {
            machine.fibre_point_nm = point.map(|v| v * 1e3);
        }
        if !self.pose.is_empty() {
            let report = at_poses(&machine, &self.pose);
            return self.style.print(&report, || vec![pose_sheet(&report)]);
        }
        if let Some(path) = &self.output {
            writable(path)?;
            spares(path, &[&self.machine])?;
        }
        let options = AccuracyOptions {
            points: usize::from(self.points),
            linear_half_um: self.linear_um,
            angular_half_rad: self.angular_deg.map(f64::to_radians),
            magnitudes: self.sizes.into(),
            stages: self.stages as usize,
            seed: self.seed,
        };
        let result =
            with_progress(options.fields() as u64, "fields", |progress| accuracy(&machine, &options, progress));
        if let Some(path) = &self.output {
            replace(&[(path, accuracy_figure(&result).as_bytes())])?;
        }
        if self.dump {
            return say(poses(&result)?);
        }
        self.style.print(&result, || sheets(&result))
    }
}

/// The error at one pose.
#[derive(Serialize)]
struct AtPose {
    pose_um_deg: [f64; 6],
    /// Actual minus ideal, chip axes, um.
    #[serde(rename = "E_um")]
    error_um: [f64; 3],
    /// Rotation vector from the ideal to the actual orientation, chip axes, rad.
    rotation_rad: [f64; 3],
    /// Sum of the effects of the single errors, um.
    #[serde(rename = "E_first_order_um")]
    first_order_um: [f64; 3],
    first_order_gap: FirstOrderGap,
    /// Axes that would be beyond the machine's travel.
    beyond_travel: Vec<&'static str>,
}

#[derive(Serialize)]
struct Poses {
    machine: String,
    #[serde(rename = "F")]
    fibre_point_um: [f64; 3],
    poses: Vec<AtPose>,
}

fn at_poses(machine: &Machine, poses: &[[f64; 6]]) -> Poses {
    let model = ErrorModel::of(machine);
    let at_pose = |&pose_um_deg: &[f64; 6]| {
        let [x, y, z, a, b, g] = pose_um_deg;
        let at = [x, y, z, a.to_radians(), b.to_radians(), g.to_radians()];
        let error = model.error_at(at);
        AtPose {
            pose_um_deg,
            error_um: error.position_um,
            rotation_rad: error.rotation_rad,
            first_order_um: model.first_order(at, model.fibre_point_um).position_um,
            first_order_gap: model.first_order_gap(at, model.fibre_point_um),
            beyond_travel: Axis::ALL
                .into_iter()
                .filter(|axis| beyond_travel(machine, *axis, at[axis.index()]))
                .map(Axis::name)
                .collect(),
        }
    };
    Poses {
        machine: machine.name.clone(),
        fibre_point_um: model.fibre_point_um,
        poses: poses.iter().map(at_pose).collect(),
    }
}

fn pose_sheet(report: &Poses) -> Sheet {
    let [fx, fy, fz] = report.fibre_point_um;
    let mut title = format!("{}, F = ({fx}, {fy}, {fz}) um: errors in um", report.machine);
    if report.poses.iter().any(|at| !at.beyond_travel.is_empty()) {
        title.push_str("; *: beyond the machine's travel");
    }
    let header = ["pose (um, deg)", "Ex", "Ey", "Ez", "rx urad", "ry urad", "rz urad", "first order misses"];
    let mut sheet = Sheet::new(title, header);
    for at in &report.poses {
        let far = |axis: Axis| if at.beyond_travel.contains(&axis.name()) { "*" } else { "" };
        let pose = Axis::ALL.map(|axis| format!("{}{}", at.pose_um_deg[axis.index()], far(axis))).join(" ");
        let e = at.error_um.map(|v| format!("{v:.6}"));
        let r = at.rotation_rad.map(|v| format!("{:.4}", v * 1e6));
        let gap = format!("{:.6}", at.first_order_gap.sum_um);
        sheet.row([pose].into_iter().chain(e).chain(r).chain([gap]));
    }
    sheet
}

fn motion_name(motion: Motion) -> &'static str {
    match motion {
        Motion::Linear => "linear",
        Motion::Angular => "angular",
    }
}

fn title(part: &MotionAccuracy) -> String {
    let unit = if part.motion == Motion::Angular { "deg" } else { "um" };
    let ends: Vec<String> = part.ends_um_deg.iter().map(|[a, b]| format!("{a:.6} to {b:.6}")).collect();
    let ends = ends.join(", ").replace(".000000", "");
    let beyond = match part.beyond_travel.as_slice() {
        [] => String::new(),
        axes => format!("; beyond the machine's travel of {}", axes.join(", ")),
    };
    format!("{} motion ({ends} {unit}, {} poses each{beyond})", motion_name(part.motion), part.points)
}

fn sheets(result: &Accuracy) -> Vec<Sheet> {
    let mut all = Vec::new();
    for part in &result.motions {
        let header = ["field", "of", "max", "rms", "p50", "p95", "p99", "worst pose (um, deg)"];
        let mut sheet =
            Sheet::new(format!("{}, {}: errors in um, rotation in urad", result.machine, title(part)), header);
        let refused = part.refusal.as_ref().map(|reason| format!("no compensation by the controller: {reason}"));
        let rows = [
            ("machine, not compensated", Some(part.machine)),
            ("the same from home", Some(part.before)),
            ("compensated by the controller, from home", part.after),
            ("compensated exactly, from home", part.after_exact),
            ("all errors of the same sign", Some(part.same_sign)),
        ];
        for (name, statistics) in rows.into_iter().filter_map(|(name, s)| s.map(|s| (name, s))) {
            add(&mut sheet, name, &statistics);
        }
        all.push(sheet);
        if let Some(reason) = refused {
            let mut sheet = Sheet::new(format!("{} motion, compensation", motion_name(part.motion)), ["reason"]);
            sheet.row([reason]);
            all.push(sheet);
        }
        let mut gap = Sheet::new(
            format!("{} motion, what the first-order forms miss at the worst pose, um", motion_name(part.motion)),
            ["matrices I + [epsilon]x", "sum of single effects"],
        );
        gap.row([part.first_order_gap.matrices_um, part.first_order_gap.sum_um].map(|v| format!("{v:.6}")));
        all.push(gap);
        let mut sheet = Sheet::new(
            format!("{} motion, ensembles of {} stages, um", motion_name(part.motion), part.ensembles[0].stages),
            ["ensemble", "of", "median", "p95", "max"],
        );
        part.ensembles.iter().for_each(|ensemble| add_ensemble(&mut sheet, ensemble));
        all.push(sheet);
    }
    all
}

fn add(sheet: &mut Sheet, field: &str, s: &Statistics) {
    let parts = [
        ("abs Ex", s.x_um),
        ("abs Ey", s.y_um),
        ("abs Ez", s.z_um),
        ("abs E", s.norm_um),
        ("rotation", s.rotation_urad),
    ];
    for (of, size) in parts {
        let pose: Vec<String> = size.worst_pose_um_deg.iter().map(|q| format!("{q:.3}")).collect();
        let figures = [size.max, size.rms, size.p50, size.p95, size.p99].map(|v| format!("{v:.4}"));
        let head = [field.to_string(), of.to_string()];
        sheet.row(head.into_iter().chain(figures).chain([pose.join(" ").replace("-0.000", "0.000")]));
    }
}

fn add_ensemble(sheet: &mut Sheet, ensemble: &EnsembleStatistics) {
    let name = match ensemble.ensemble {
        Ensemble::SameSign => "same sign",
        Ensemble::RandomSigns => "random signs",
        Ensemble::MonteCarlo => "Monte Carlo",
    };
    let [x, y, z] = ensemble.max_um;
    let parts = [
        ("largest abs Ex", x),
        ("largest abs Ey", y),
        ("largest abs Ez", z),
        ("largest abs E", ensemble.norm_max_um),
        ("rms of E", ensemble.norm_rms_um),
    ];
    for (of, spread) in parts {
        let figures = [spread.median, spread.p95, spread.max].map(|v| format!("{v:.4}"));
        sheet.row([name.to_string(), of.to_string()].into_iter().chain(figures));
    }
}

/// The fields of the machine, pose by pose.
fn poses(result: &Accuracy) -> Result<String, Failure> {
    let axes = ["X_um", "Y_um", "Z_um", "alpha_deg", "beta_deg", "gamma_deg"];
    let errors = ["Ex_um", "Ey_um", "Ez_um", "rx_rad", "ry_rad", "rz_rad", "after_Ex_um", "after_Ey_um", "after_Ez_um"];
    let mut sheet = Sheet::new("field", ["motion"].into_iter().chain(axes).chain(errors));
    for part in &result.motions {
        let field = &part.fields.machine;
        for (number, deviation) in field.deviations.iter().enumerate() {
            let pose = field.grid.pose(number);
            let pose = (0..6).map(|i| if i < 3 { pose[i] } else { pose[i].to_degrees() }.to_string());
            let after = part.fields.after.as_ref().map(|after| after.deviations[number].position_um);
            let after = after.map_or([const { String::new() }; 3], |e| e.map(|v| v.to_string()));
            let e = [deviation.position_um, deviation.rotation_rad];
            let e = e.as_flattened().iter().map(|v| v.to_string());
            sheet.row(std::iter::once(motion_name(part.motion).to_string()).chain(pose).chain(e).chain(after));
        }
    }
    sheet.csv()
}
