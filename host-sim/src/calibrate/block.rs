//! Rounds the law into the fields of the calibration block.

use super::{Law, Q32, Refusal};
use crate::machine::{Drive, Machine};
use crate::model::Chain;
use nalgebra::Vector3;
use stage_controller::compensation::calibration::{Calibration, MotorData, ScrewAxis, row_bits};
use stage_controller::units::{AXES, Axis, COORDINATE_LIMIT};

const Q30: f64 = (1u64 << 30) as f64;
/// Positions in the block count sixteenths of a nm.
const PER_NM: f64 = 16.0;
/// Second-order coefficients: per radian times 2^60 / 10^9.
const SECOND_ORDER: f64 = (1u64 << 60) as f64 / 1e9;
/// Limit of the block for small coefficients.
const SMALL: f64 = (1u64 << 28) as f64;
const COUPLING_LIMIT: f64 = i32::MAX as f64;

/// Rounds a value that has to fit its field.
fn rounded(name: impl Fn() -> String, value: f64, limit: f64) -> Result<i64, Refusal> {
    let whole = value.round();
    if whole.abs() <= limit { Ok(whole as i64) } else { Err(Refusal::Range { name: name(), value, limit }) }
}

fn small(name: impl Fn() -> String, value: f64, limit: f64) -> Result<i32, Refusal> {
    Ok(rounded(name, value, limit)? as i32)
}

fn vector(name: &str, v: Vector3<f64>, scale: f64) -> Result<[i32; 3], Refusal> {
    let mut out = [0; 3];
    for i in 0..3 {
        out[i] = small(|| format!("{name}[{i}]"), v[i] * scale, Q30)?;
    }
    Ok(out)
}

/// A matrix of coefficients, each rounded after scaling by its row.
fn rows<const C: usize>(
    name: &str,
    value: impl Fn(usize, usize) -> f64,
    scale: impl Fn(usize) -> f64,
    limit: f64,
) -> Result<[[i32; C]; 3], Refusal> {
    let mut out = [[0; C]; 3];
    for (i, row) in out.iter_mut().enumerate() {
        for (j, entry) in row.iter_mut().enumerate() {
            *entry = small(|| format!("{name}[{i}][{j}]"), value(i, j) * scale(i), limit)?;
        }
    }
    Ok(out)
}

fn motor(axis: Axis, drive: &Drive) -> Result<MotorData, Refusal> {
    let field = |name: &'static str| move || format!("axes.{} {name}", axis.name());
    let step_q32 = rounded(field("step"), drive.step * 4_294_967_296.0, 281_474_976_710_655.0)? as u64;
    let end = |value| small(field("travel"), value, f64::from(COORDINATE_LIMIT));
    // A limit is not rounded up; a millionth forgives the binary form of a decimal number.
    let rate = |name, value: f64, bits: i32| {
        rounded(field(name), (value + 1e-6).floor().max(1.0), 2f64.powi(bits)).map(|whole| whole as u64)
    };
    // f64::round rounds halves away from zero, as the block demands.
    let backlash = rounded(field("backlash"), drive.backlash / drive.step, 2f64.powi(20))?;
    Ok(MotorData {
        step_q32,
        row_bits: row_bits(step_q32),
        backlash_steps: backlash as u32,
        travel_lower: end(drive.travel[0])?,
        travel_upper: end(drive.travel[1])?,
        velocity: rate("velocity", drive.velocity, 36)?,
        acceleration: rate("acceleration", drive.acceleration, 42)?,
        jerk: rate("jerk", drive.jerk, 50)?,
    })
}

/// The block of a machine whose law is `exact`.
pub(super) fn quantise(machine: &Machine, chain: &Chain, exact: &Law) -> Result<Calibration, Refusal> {
    let mut name = [0; 16];
    name[..machine.name.len()].copy_from_slice(machine.name.as_bytes());
    let mut motors = [motor(Axis::X, &machine.drives[0])?; AXES];
    for axis in Axis::ALL {
        motors[axis.index()] = motor(axis, &machine.drives[axis.index()])?;
    }
    let per_step = |i: usize| 2f64.powi(i32::from(motors[i].row_bits)) / machine.drives[i].step;
    let mut rotary_gain = [0; 3];
    for (i, gain) in rotary_gain.iter_mut().enumerate() {
        *gain = small(|| format!("rotary_gain[{i}]"), per_step(i + 3), COUPLING_LIMIT)?;
    }
    let mut screws = [ScrewAxis { axis: Axis::Alpha, direction: [0; 3], point: [0; 3] }; 3];
    for (out, screw) in screws.iter_mut().zip(&exact.screws) {
        let name = screw.axis.name();
        *out = ScrewAxis {
            axis: screw.axis,
            direction: vector(&format!("direction of {name}"), screw.direction, Q30)?,
            point: vector(&format!("point of {name}"), screw.point, PER_NM)?,
        };
    }
    let slides = &exact.inverse_slides;
    let tilt = exact.inverse_axes - nalgebra::Matrix3::identity();
    let rotation = chain.home_rotation();
    Ok(Calibration {
        name,
        order: machine.order,
        motors,
        inverse_slides: rows("inverse_slides", |i, j| slides[(i, j)], per_step, COUPLING_LIMIT)?,
        rotary_gain,
        tilt: rows("tilt", |i, j| tilt[(i, j)], |_| Q32, SMALL)?,
        second_order: rows("second_order", |i, j| exact.second_order[(i, j)], |_| SECOND_ORDER, SMALL)?,
        screws,
        home_rotation: rows("home_rotation", |i, j| rotation[(i, j)], |_| Q30, Q30)?,
        home_origin: vector("home_origin", chain.home_origin(), PER_NM)?,
        fibre_point: vector("fibre_point", Vector3::from(machine.fibre_point_nm), PER_NM)?,
    })
}
