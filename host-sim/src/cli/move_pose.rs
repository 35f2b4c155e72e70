//! `host-sim move`: one pose with the compensation on and off, and where the stage really stands.

use super::Failure;
use super::common::{board, load, say, say_json};
use crate::board::Board;
use crate::machine::Machine;
use serde::Serialize;
use stage_controller::compensation::law::Switches;
use stage_controller::error::{Detail, Error};
use stage_controller::units::decimal::{Formatted, Unit, parse};
use stage_controller::units::{AXES, Axis, Pose};
use std::fmt;
use std::path::PathBuf;

/// Move from home to a pose with compensation on, and again with it off; compare with the stage's true pose.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine file (TOML), or `paper` for the built-in machine.
    #[arg(long, value_name = "FILE", default_value = "paper")]
    machine: PathBuf,
    /// Six numbers with commas between: x, y, z in um, alpha, beta, gamma in degrees; other units by their suffix.
    #[arg(long, value_name = "x,y,z,a,b,g", allow_hyphen_values = true)]
    pose: String,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// One move; six numbers in the order X, Y, Z, alpha, beta, gamma.
#[derive(Debug, Serialize)]
struct Run {
    commanded_nm_nrad: [i64; AXES],
    /// Counts really played, overlay of backlash included.
    motor_steps: [i32; AXES],
    steps_without_overlay: [i32; AXES],
    /// Angles of the rotary stages as the controller computes them, before the rounding to steps.
    q_a_nrad: [f64; 3],
    /// True pose of the fibre point of the twin.
    true_pose_nm_nrad: [f64; AXES],
    /// True less commanded.
    error_nm_nrad: [f64; AXES],
}

#[derive(Debug, Serialize)]
struct Runs {
    on: Run,
    off: Run,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let machine = load(&self.machine)?;
        let pose = read_pose(&self.pose)?;
        let runs = Runs { on: travel(&machine, pose, true)?, off: travel(&machine, pose, false)? };
        if self.json {
            say_json(&runs)
        } else {
            say(format!("machine {}, from home on the reference flank\n{runs}", machine.name))
        }
    }
}

fn unit(axis: Axis) -> Unit {
    if axis.is_rotary() { Unit::ANGLE } else { Unit::LENGTH }
}

/// Six numbers in um and degrees, exactly, to nm and nrad.
fn read_pose(text: &str) -> Result<[i64; AXES], Failure> {
    let numbers: Vec<_> = text.split(',').map(str::trim).collect();
    let numbers: [&str; AXES] = numbers
        .try_into()
        .map_err(|n: Vec<_>| Failure::Refused(format!("--pose: needs six numbers, has {}", n.len())))?;
    let mut pose = [0; AXES];
    for ((value, number), axis) in pose.iter_mut().zip(numbers).zip(Axis::ALL) {
        *value = parse(number.as_bytes(), unit(axis)).map_err(|error| {
            Failure::Refused(format!("--pose: {} = {number:?}: {}", axis.name(), error.description()))
        })?;
    }
    Ok(pose)
}

/// The controller's own text, with the axis by its name in front.
fn refused(error: Error) -> Failure {
    match error.detail {
        Detail::Limit { axis, .. } | Detail::Axis(axis) | Detail::AxisText(axis, _) => {
            Failure::Refused(format!("{}: {error}", axis.name()))
        }
        _ => Failure::Refused(error.to_string()),
    }
}

/// From home to a pose on a board of its own.
fn travel(machine: &Machine, pose: [i64; AXES], compensation: bool) -> Result<Run, Failure> {
    let mut board: Board = board(machine, false)?;
    if !compensation {
        board.front.set_switches(Switches { compensation: false, ..Switches::default() }).map_err(refused)?;
        board.settle();
    }
    board.front.pose_absolute(pose).map_err(refused)?;
    if !board.settle() {
        return Err(Failure::Refused("the move does not come to rest".into()));
    }
    if let Some(error) = board.front.take_late_error() {
        return Err(refused(error));
    }
    let truth = board.twin().true_pose();
    let law = board.front.law();
    let q_a = law.actuator_angles(Pose(pose.map(|u| u as i32)));
    Ok(Run {
        commanded_nm_nrad: pose,
        motor_steps: board.twin().motors().0,
        steps_without_overlay: board.front.report().final_steps.0,
        q_a_nrad: q_a.map(|q| q as f64 / 4_294_967_296.0),
        true_pose_nm_nrad: truth,
        error_nm_nrad: std::array::from_fn(|i| truth[i] - pose[i] as f64),
    })
}

/// One row of the table.
fn row(f: &mut fmt::Formatter<'_>, name: &str, cells: [String; AXES]) -> fmt::Result {
    write!(f, "{name:<24}")?;
    cells.iter().try_for_each(|cell| write!(f, "{cell:>15}"))?;
    writeln!(f)
}

impl Run {
    fn rows(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let degrees = |nrad: f64| (nrad * 1e-9).to_degrees();
        row(f, "  motor steps", self.motor_steps.map(|steps| steps.to_string()))?;
        row(f, "  without overlay", self.steps_without_overlay.map(|steps| steps.to_string()))?;
        let q_a = |i: usize| i.checked_sub(3).map_or(String::new(), |k| format!("{:.9}", degrees(self.q_a_nrad[k])));
        row(f, "  q_a, deg", std::array::from_fn(q_a))?;
        let truth = |i: usize| {
            let value = self.true_pose_nm_nrad[i];
            if i < 3 { format!("{:.4}", value * 1e-3) } else { format!("{:.8}", degrees(value)) }
        };
        row(f, "  true pose, um and deg", std::array::from_fn(truth))?;
        let error = |i: usize| {
            let value = self.error_nm_nrad[i];
            if i < 3 { format!("{value:.2}") } else { format!("{:.3}", value * 1e-3) }
        };
        row(f, "  error, nm and urad", std::array::from_fn(error))
    }
}

impl fmt::Display for Runs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        row(f, "", Axis::ALL.map(|axis| axis.name().to_string()))?;
        let commanded =
            |axis: Axis| Formatted { value: self.on.commanded_nm_nrad[axis.index()], unit: unit(axis) }.to_string();
        row(f, "commanded, um and deg", Axis::ALL.map(commanded))?;
        writeln!(f, "compensation on")?;
        self.on.rows(f)?;
        writeln!(f, "compensation off")?;
        self.off.rows(f)
    }
}
