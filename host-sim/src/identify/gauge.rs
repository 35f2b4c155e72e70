//! What is fixed by convention: which of the unknowns are fitted, and the sentences that say so.

use super::constants::{CONSTANTS, Constant, backlash_name};
use super::rank::{dependent, ranks};
use super::{Options, Refusal};
use crate::machine::{FARTHEST_UM, LARGEST_STATIC, Machine};
use stage_controller::units::{AXES, Axis};

/// Which unknowns are held, and the machine with their values.
pub(super) struct Gauge {
    pub held_constants: [bool; CONSTANTS],
    pub held_plays: [bool; AXES],
    pub start: Machine,
    pub sentences: Vec<String>,
}

impl Gauge {
    /// The play of a motor where it is held, nm or nrad.
    pub fn held_play(&self, axis: Axis) -> Option<f64> {
        self.held_plays[axis.index()].then(|| self.start.drives[axis.index()].backlash)
    }
}

/// nm in an unit of the machine file, or 1 for angles in rad.
pub(super) fn per_unit(constant: Constant) -> f64 {
    if constant.is_angle() { 1.0 } else { 1e3 }
}

pub(super) fn gauge(nominal: &Machine, options: &Options) -> Result<Gauge, Refusal> {
    let constants = Constant::all(&nominal.order);
    let mut names: Vec<String> = constants.iter().map(Constant::to_string).collect();
    names.extend(Axis::ALL.map(backlash_name));
    let mut held: Vec<Option<Option<f64>>> = vec![None; names.len()];
    for (wanted, value) in &options.hold {
        let matches = |name: &str| {
            let rest = name.strip_prefix(wanted.as_str());
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
                || (wanted == "backlash" && name.starts_with("axes."))
        };
        let found: Vec<usize> = (0..names.len()).filter(|i| matches(&names[*i])).collect();
        if found.is_empty() {
            return Err(Refusal::Gauge(format!("{wanted:?} is none of what is fitted: {}", names.join(", "))));
        }
        for i in found {
            match (held[i], value) {
                (Some(Some(before)), Some(now)) if before != *now => {
                    let name = &names[i];
                    let reason = format!("contradictory: {name} is held at {before} and at {now}; give one value");
                    return Err(Refusal::Gauge(reason));
                }
                (Some(Some(_)), None) => {}
                _ => held[i] = Some(*value),
            }
        }
    }
    let mut start = nominal.clone();
    let mut sentences = conventions(nominal, &constants);
    for (i, held) in held.iter().enumerate() {
        let Some(value) = held else { continue };
        let now = set(&mut start, &constants, i, *value)
            .map_err(|limit| Refusal::Gauge(format!("{} is held at {:?}: {limit}", names[i], value.unwrap_or(0.0))))?;
        sentences.push(format!("{} is held at {now} on request.", names[i]));
    }
    let mut held_constants: [bool; CONSTANTS] = std::array::from_fn(|i| held[i].is_some());
    let held_plays: [bool; AXES] = std::array::from_fn(|i| held[CONSTANTS + i].is_some());
    if ranks(&start).chosen < CONSTANTS {
        for constant in dependent(&nominal.order, &start) {
            let i = constants.iter().position(|c| *c == constant).expect("one of the 24");
            if !held_constants[i] {
                held_constants[i] = true;
                let value = constant.of(&start) / per_unit(constant);
                sentences.push(format!(
                    "{constant} is held at {value}: in the order {} it does what others of the 24 do together.",
                    nominal.order.map(Axis::name).join(" ")
                ));
            }
        }
    }
    Ok(Gauge { held_constants, held_plays, start, sentences })
}

fn set(machine: &mut Machine, constants: &[Constant], i: usize, value: Option<f64>) -> Result<f64, String> {
    if let Some(constant) = constants.get(i) {
        if let Some(value) = value {
            if constant.is_angle() && value.abs() > LARGEST_STATIC {
                return Err(format!("an angle of a stage is at most {LARGEST_STATIC} rad"));
            }
            if !constant.is_angle() && value.abs() > FARTHEST_UM {
                return Err(format!("a position is at most {FARTHEST_UM} um"));
            }
            constant.set(machine, value * per_unit(*constant));
        }
        return Ok(constant.of(machine) / per_unit(*constant));
    }
    let play = &mut machine.drives[i - constants.len()].backlash;
    if let Some(value) = value {
        if !(0.0..1e9).contains(&value) {
            return Err("a backlash is 0 or positive, below 1e9".into());
        }
        *play = value;
    }
    Ok(*play)
}

fn conventions(machine: &Machine, constants: &[Constant; CONSTANTS]) -> Vec<String> {
    let linear: Vec<&str> = machine.order.iter().filter(|axis| !axis.is_rotary()).map(|axis| axis.name()).collect();
    let offsets: Vec<String> = constants[9..12].iter().map(Constant::to_string).collect();
    let [x, y, z] = machine.fibre_point_nm.map(|v| v * 1e-3);
    vec![
        format!(
            "The base frame is that of the slides: {first} moves exactly along its own axis of the base, {second} in the \
             plane of both; how the chip lies to them is in mount.chip.rot_rad.",
            first = linear[0],
            second = linear[1]
        ),
        "Home is where all motors count 0: how axes stand there is in the mounts.".into(),
        format!(
            "Of the positions of the joint frames only {} are fitted; all others stay as the nominal machine has them, \
             and the mounts take up what that leaves.",
            offsets.join(", ")
        ),
        format!(
            "The fibre point stays at ({x}, {y}, {z}) um of the array frame; where that is on the last stage is in \
             mount.fibre."
        ),
        "Approached upwards a stage stands at its motor's count; downwards it stands by the backlash above it.".into(),
    ]
}
