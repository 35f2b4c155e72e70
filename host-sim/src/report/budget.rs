//! The section on fixed point: what coefficients in 32 bits, whole steps and the second-order term cost at the fibre.

use super::number::{Spread, figure};
use super::page::{Section, caption};
use super::plot::{Scale, dot, drawing, line, rectangle, text};
use crate::calibrate::Q32;
use crate::calibrate::{Fit, Law, Report, angular_travel, fit, inverse_axes};
use crate::machine::Machine;
use crate::model::{Chain, vee};
use maud::{Markup, html};
use serde::Serialize;
use stage_controller::compensation::calibration::Calibration;
use stage_controller::compensation::law::{Law as FixedLaw, Remembered, Switches};
use stage_controller::units::{AXES, Axis, FinePose};

/// Points along each of the six travels at which the law is compared: 4096 poses.
const POINTS: usize = 4;

/// One motor's part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotorBudget {
    /// The motor.
    pub motor: &'static str,
    /// nm or nrad, the unit of the other values.
    pub unit: &'static str,
    /// Size of a step.
    pub step: f64,
    /// Half a step: the rounding that no law avoids.
    pub half_step: f64,
    /// Largest change of the position over the travel by rounding the coefficients.
    pub coefficients: f64,
    /// Play less the whole steps that correct it.
    pub backlash_remainder: f64,
    /// Distance of the fibre point from the axis of a rotary stage, mm.
    pub lever_mm: Option<f64>,
    /// Half a step at the fibre point, nm.
    pub half_step_at_fibre_nm: f64,
}

/// What one more approximation adds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stage {
    /// Which approximation.
    pub name: &'static str,
    /// How far it displaces the fibre point, nm.
    pub position_nm: Spread,
    /// How far it turns the array, urad.
    pub orientation_urad: Spread,
}

/// The whole budget.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Budget {
    /// Motor by motor.
    pub motors: Vec<MotorBudget>,
    /// Poses at which the stages were compared.
    pub poses: usize,
    /// From the exact law to whole steps, each against the one before; the last one is the sum, against the pose.
    pub stages: Vec<Stage>,
    /// Largest rotation that the second-order term leaves over the angular travel, urad.
    pub orientation_residual_urad: f64,
    /// The same without the second-order term.
    pub linear_orientation_residual_urad: f64,
    /// Rotary axis farthest from the fibre point.
    pub lever_axis: &'static str,
}

impl Budget {
    /// The budget of a calibrated machine. None when its law cannot be inverted, which `calibrate` has refused before.
    pub fn new(machine: &Machine, calibration: &Calibration, report: &Report) -> Option<Self> {
        let chain = Chain::new(machine);
        let tilt = inverse_axes(&chain)?;
        let Fit { coefficients, .. } = fit(&chain, &tilt, angular_travel(machine))?;
        let exact = Law::new(machine, &chain, chain.slides_matrix().try_inverse()?, tilt, coefficients);
        Some(Budget {
            motors: Axis::ALL.map(|axis| motor(machine, &chain, report, axis)).into(),
            poses: POINTS.pow(AXES as u32),
            stages: stages(machine, &chain, &exact, calibration),
            orientation_residual_urad: report.orientation_residual_urad,
            linear_orientation_residual_urad: report.linear_orientation_residual_urad,
            lever_axis: report.lever_axis,
        })
    }
}

fn motor(machine: &Machine, chain: &Chain, report: &Report, axis: Axis) -> MotorBudget {
    let (i, drive) = (axis.index(), &machine.drives[axis.index()]);
    let fibre = chain.fibre_home();
    let lever = axis.is_rotary().then(|| (fibre - chain.screws()[i - 3].nearest(fibre)).norm());
    MotorBudget {
        motor: axis.name(),
        unit: if axis.is_rotary() { "nrad" } else { "nm" },
        step: drive.step,
        half_step: 0.5 * drive.step,
        coefficients: report.quantisation[i],
        backlash_remainder: report.backlash_remainder[i],
        lever_mm: lever.map(|nm| nm * 1e-6),
        half_step_at_fibre_nm: 0.5 * drive.step * lever.map_or(1.0, |nm| nm * 1e-9),
    }
}

/// Poses on a grid over all travels; a compensated motor may leave its own there, the law holds all the same.
fn grid(machine: &Machine) -> impl Iterator<Item = [f64; AXES]> {
    (0..POINTS.pow(AXES as u32)).map(|corner| {
        let mut rest = corner;
        machine.drives.map(|drive| {
            let share = (rest % POINTS) as f64 / (POINTS - 1) as f64;
            rest /= POINTS;
            (drive.travel[0] + (drive.travel[1] - drive.travel[0]) * share).round()
        })
    })
}

fn stages(machine: &Machine, chain: &Chain, exact: &Law, calibration: &Calibration) -> Vec<Stage> {
    let steps = machine.drives.map(|drive| drive.step);
    let held = Law::of_block(calibration, steps);
    let fixed = FixedLaw::new(calibration, Switches::default(), calibration.fibre_point);
    let names =
        ["second-order term", "coefficients of 32 bits", "fixed-point arithmetic", "whole steps", "all together"];
    let mut position: [Vec<f64>; 5] = Default::default();
    let mut turned: [Vec<f64>; 5] = Default::default();
    for pose in grid(machine) {
        let targets = fixed.targets(&FinePose(pose.map(|u| (u * Q32) as i64)), &mut Remembered::default());
        let unrounded = std::array::from_fn(|i| (targets.0[i] as f64 / Q32 - 0.5) * steps[i]);
        let whole = targets.floor().0;
        let rounded = std::array::from_fn(|i| f64::from(whole[i]) * steps[i]);
        let chain_of = |actuators| chain.true_pose(actuators);
        let truths = [
            pose,
            chain_of(exact.actuators(pose)),
            chain_of(held.actuators(pose)),
            chain_of(unrounded),
            chain_of(rounded),
        ];
        let mut note = |n: usize, from: [f64; AXES], to: [f64; AXES]| {
            position[n].push((0..3).map(|i| (to[i] - from[i]).powi(2)).sum::<f64>().sqrt());
            let rotation = |u: [f64; AXES]| chain.euler().of_pose(&u);
            turned[n].push(vee(&(rotation(to) * rotation(from).transpose())).norm() * 1e6);
        };
        (0..4).for_each(|n| note(n, truths[n], truths[n + 1]));
        note(4, pose, truths[4]);
    }
    let stage = |((name, p), o): ((&'static str, &Vec<f64>), &Vec<f64>)| Stage {
        name,
        position_nm: Spread::of(p),
        orientation_urad: Spread::of(o),
    };
    names.into_iter().zip(&position).zip(&turned).map(stage).collect()
}

/// The section; `refusal` when there is no calibration.
pub fn section(budget: Result<&Budget, &str>) -> Section {
    let body = match budget {
        Ok(budget) => body(budget),
        Err(refusal) => html! { p.warning { "There are no coefficients to round: " (refusal) "." } },
    };
    Section { id: "budget", title: "Fixed point: what rounding costs", body }
}

fn body(budget: &Budget) -> Markup {
    html! {
        p.lead {
            "All rounding together displaces the fibre point by "
            strong { (figure("/budget/stages/4/position_nm/rms", budget.stages[4].position_nm.rms)) " nm" }
            " (root mean square, at most " (figure("/budget/stages/4/position_nm/max", budget.stages[4].position_nm.max))
            " nm); the coefficients alone by at most "
            strong { (figure("/budget/stages/1/position_nm/max", budget.stages[1].position_nm.max)) " nm" } "."
        }
        figure {
            (ladder(budget))
            figcaption { "How far each approximation moves the fibre point against the one before, nm, on a logarithmic \
                scale, over " (budget.poses) " poses on a grid over all travels. Bar: root mean square; dot: largest. What \
                lies below 0.001 nm is drawn at the left edge." }
        }
        (caption("table", "The same in numbers, and how far each approximation turns the array."))
        (numbers(budget))
        (caption("table", "Motor by motor. Coefficients: largest change of the motor\u{2019}s position over the travel by \
            rounding its coefficients. Left of backlash: true play less the whole steps that correct it. Half a step at \
            the fibre: times the distance of the fibre point from the axis."))
        (motors(budget))
        p {
            "Orientation left by the second-order term over the angular travel: "
            (figure("/budget/orientation_residual_urad", budget.orientation_residual_urad)) " urad, without it "
            (figure("/budget/linear_orientation_residual_urad", budget.linear_orientation_residual_urad))
            " urad. Longest lever: from the " (budget.lever_axis) " axis."
        }
    }
}

fn numbers(budget: &Budget) -> Markup {
    html! {
        table {
            thead {
                tr { th rowspan="2" { "Approximation" } th colspan="3" { "fibre point, nm" } th colspan="2" { "orientation, urad" } }
                tr { @for name in ["rms", "p95", "max", "rms", "max"] { th { (name) } } }
            }
            tbody {
                @for (n, stage) in budget.stages.iter().enumerate() {
                    @let at = |name: &str| format!("/budget/stages/{n}/{name}");
                    tr {
                        th { (stage.name) }
                        td { (figure(at("position_nm/rms"), stage.position_nm.rms)) }
                        td { (figure(at("position_nm/p95"), stage.position_nm.p95)) }
                        td { (figure(at("position_nm/max"), stage.position_nm.max)) }
                        td { (figure(at("orientation_urad/rms"), stage.orientation_urad.rms)) }
                        td { (figure(at("orientation_urad/max"), stage.orientation_urad.max)) }
                    }
                }
            }
        }
    }
}

fn motors(budget: &Budget) -> Markup {
    html! {
        table {
            thead {
                tr {
                    th { "Motor" } th.left { "unit" } th { "step" } th { "half a step" } th { "coefficients" }
                    th { "left of backlash" } th { "lever, mm" } th { "half a step at the fibre, nm" }
                }
            }
            tbody {
                @for (n, m) in budget.motors.iter().enumerate() {
                    @let at = |name: &str| format!("/budget/motors/{n}/{name}");
                    tr {
                        th { (m.motor) }
                        td.left { (m.unit) }
                        td { (figure(at("step"), m.step)) }
                        td { (figure(at("half_step"), m.half_step)) }
                        td { (figure(at("coefficients"), m.coefficients)) }
                        td { (figure(at("backlash_remainder"), m.backlash_remainder)) }
                        td { @if let Some(lever) = m.lever_mm { (figure(at("lever_mm"), lever)) } @else { "\u{2013}" } }
                        td { (figure(at("half_step_at_fibre_nm"), m.half_step_at_fibre_nm)) }
                    }
                }
            }
        }
    }
}

fn ladder(budget: &Budget) -> Markup {
    const ROW: f64 = 30.0;
    let bottom = budget.stages.len() as f64 * ROW + 4.0;
    let largest = budget.stages.iter().map(|s| s.position_nm.max).fold(1.0, f64::max);
    let across = Scale::decades([1e-3, largest], [190.0, 880.0]);
    let content = html! {
        @for (value, name) in across.ticks() {
            (line("grid", [across.at(value), 0.0], [across.at(value), bottom]))
            (text("tick middle", [across.at(value), bottom + 15.0], &name))
        }
        (line("axis", [across.at(0.0), bottom], [880.0, bottom]))
        (text("name middle", [535.0, bottom + 32.0], "displacement of the fibre point, nm"))
        @for (n, stage) in budget.stages.iter().enumerate() {
            @let y = (n as f64 + 0.5) * ROW;
            @let s = stage.position_nm;
            g class=(if n + 1 == budget.stages.len() { "c-all" } else { "c-coupling" }) {
                (rectangle("bar", [across.at(0.0), y - 6.0], [across.at(s.rms), y + 6.0]))
                (line("thin", [across.at(s.rms), y], [across.at(s.max), y]))
                (dot("bar", [across.at(s.max), y], 4.0))
            }
            (text("label end", [178.0, y + 4.0], stage.name))
            (text("tick", [across.at(s.max) + 9.0, y + 3.5], &super::number::short(s.max)))
        }
    };
    drawing([960.0, bottom + 40.0], "What each approximation costs at the fibre point", content)
}
