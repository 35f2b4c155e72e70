//! From a machine description to the controller's calibration block: f64 here, fixed point there.

mod block;
mod law;
mod report;
mod second_order;

pub use law::Law;
pub use report::Report;
pub use second_order::{FIT_POINTS, Fit, fit, orientation_residual, products};

use crate::machine::Machine;
use crate::model::Chain;
use nalgebra::Matrix3;
use stage_controller::compensation::calibration::Calibration;
use stage_controller::units::Axis;

/// Steps of the controller's fine positions (32 fractional bits) in a nm, nrad or motor step.
pub const Q32: f64 = (1u64 << 32) as f64;
/// Largest travel of a rotary stage in degrees: the controller's rotation-centre law ends at 7.69°.
pub const ROTARY_TRAVEL_DEG: f64 = 7.5;
/// Largest distance of the fibre point from a rotary axis in nm.
pub const LEVER_LIMIT_NM: f64 = 60e6;
/// Largest orientation error of the second-order term in urad.
pub const ORIENTATION_LIMIT_URAD: f64 = 15.0;

/// Why no calibration can be made of a valid machine.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// A linear stage carried by a rotary one: its direction turns, no constant coupling holds.
    #[error(
        "order: {} is carried by {}; its direction turns with that stage, so no constant coupling matrix \
         corrects it (all linear axes must come before all rotary ones)",
        linear.name(), rotary.name()
    )]
    Topology {
        /// The carried linear stage.
        linear: Axis,
        /// A rotary stage nearer to the base.
        rotary: Axis,
    },
    /// A rotary travel beyond the controller's law.
    #[error("axes.{}.travel_deg: {degrees:.4} deg is beyond +-{ROTARY_TRAVEL_DEG} deg", axis.name())]
    Travel {
        /// The rotary stage.
        axis: Axis,
        /// The end of its travel.
        degrees: f64,
    },
    /// The fibre point is too far from a rotary axis.
    #[error("fibre_point_um: F is {mm:.4} mm from the {} axis, at most {} mm", axis.name(), LEVER_LIMIT_NM * 1e-6)]
    Lever {
        /// The rotary stage.
        axis: Axis,
        /// The distance.
        mm: f64,
    },
    /// The static errors are too large for the second-order term over this travel.
    #[error(
        "static_rad: the orientation residual over the angular travel is {urad:.2} urad, at most \
         {ORIENTATION_LIMIT_URAD} urad"
    )]
    Orientation {
        /// Largest rotation between commanded and achieved orientation.
        urad: f64,
    },
    /// A value that the block cannot hold.
    #[error("{name} = {value}: does not fit the calibration block (at most {limit})")]
    Range {
        /// What it is.
        name: String,
        /// The value in the block's units.
        value: f64,
        /// The largest magnitude.
        limit: f64,
    },
    /// The directions of three stages do not span the space.
    #[error("static_rad: the directions of the {0} axes are not independent")]
    Degenerate(&'static str),
}

/// Computes the calibration of a machine and how good it is.
///
/// # Errors
/// When the controller's law cannot serve this machine; nothing is clipped silently.
pub fn calibrate(machine: &Machine) -> Result<(Calibration, Report), Refusal> {
    check_order(machine)?;
    check_travel(machine)?;
    let chain = Chain::new(machine);
    let lever = largest_lever(&chain)?;
    let travel = angular_travel(machine);
    let tilt = chain.axes_matrix().try_inverse().ok_or(Refusal::Degenerate("rotary"))?;
    let slides = chain.slides_matrix().try_inverse().ok_or(Refusal::Degenerate("linear"))?;
    let fit = fit(&chain, &tilt, travel).ok_or(Refusal::Degenerate("rotary"))?;
    if fit.residual_urad > ORIENTATION_LIMIT_URAD {
        return Err(Refusal::Orientation { urad: fit.residual_urad });
    }
    let exact = Law::new(machine, &chain, slides, tilt, fit.coefficients);
    let calibration = block::quantise(machine, &chain, &exact)?;
    let report = Report::new(machine, &exact, &calibration, &fit, lever);
    Ok((calibration, report))
}

fn check_order(machine: &Machine) -> Result<(), Refusal> {
    let mut carrier = None;
    for axis in machine.order {
        match carrier {
            _ if axis.is_rotary() => carrier = carrier.or(Some(axis)),
            Some(rotary) => {
                return Err(Refusal::Topology { linear: axis, rotary });
            }
            None => {}
        }
    }
    Ok(())
}

fn check_travel(machine: &Machine) -> Result<(), Refusal> {
    for axis in Axis::ROTARY {
        for end in machine.drives[axis.index()].travel {
            let degrees = (end * 1e-9).to_degrees();
            if degrees.abs() > ROTARY_TRAVEL_DEG + 1e-9 {
                return Err(Refusal::Travel { axis, degrees });
            }
        }
    }
    Ok(())
}

fn largest_lever(chain: &Chain) -> Result<(Axis, f64), Refusal> {
    let fibre = chain.fibre_home();
    let mut largest = (Axis::Alpha, 0.0);
    for screw in chain.screws() {
        let lever = (fibre - screw.nearest(fibre)).norm();
        if lever > LEVER_LIMIT_NM {
            return Err(Refusal::Lever { axis: screw.axis, mm: lever * 1e-6 });
        }
        if lever >= largest.1 {
            largest = (screw.axis, lever);
        }
    }
    Ok(largest)
}

/// Travel of alpha, beta, gamma in rad.
pub fn angular_travel(machine: &Machine) -> [[f64; 2]; 3] {
    Axis::ROTARY.map(|axis| machine.drives[axis.index()].travel.map(|end| end * 1e-9))
}

/// W^-1 of a chain, exactly as `COMP:MATR?` reports it.
pub fn inverse_axes(chain: &Chain) -> Option<Matrix3<f64>> {
    chain.axes_matrix().try_inverse()
}
