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
    let mut sentences = Vec::new();
    for (i, held) in held.iter().enumerate() {
        let Some(value) = held else { continue };
        let now = set(&mut start, &constants, i, *value)
            .map_err(|limit| Refusal::Gauge(format!("{} is held at {:?}: {limit}", names[i], value.unwrap_or(0.0))))?;
        sentences.push(format!("{} is held at {now} on request.", names[i]));
    }
    let mut held_constants: [bool; CONSTANTS] = std::array::from_fn(|i| held[i].is_some());
    let held_plays: [bool; AXES] = std::array::from_fn(|i| held[CONSTANTS + i].is_some());
    if ranks(&start).chosen < CONSTANTS {
        let free: Vec<Constant> = (0..CONSTANTS).filter(|i| !held_constants[*i]).map(|i| constants[i]).collect();
        for constant in dependent(&free, &start) {
            held_constants[constants.iter().position(|c| *c == constant).expect("one of the 24")] = true;
            let value = constant.of(&start) / per_unit(constant);
            sentences.push(format!(
                "{constant} is held at {value}: in the order {} it does what others of the 24 do together.",
                nominal.order.map(Axis::name).join(" ")
            ));
        }
    }
    let fitted: Vec<Constant> = (0..CONSTANTS).filter(|i| !held_constants[*i]).map(|i| constants[i]).collect();
    sentences.splice(0..0, conventions(nominal, &fitted));
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

/// Sentences that hold for every fit; of the constants they name those that are fitted.
fn conventions(machine: &Machine, fitted: &[Constant]) -> Vec<String> {
    let named = |which: fn(&Constant) -> bool| {
        let names: Vec<String> = fitted.iter().filter(|constant| which(constant)).map(Constant::to_string).collect();
        (!names.is_empty()).then(|| names.join(", "))
    };
    let chip = named(|c| matches!(c, Constant::ChipRotation(_)));
    let fibre = named(|c| matches!(c, Constant::FibreOffset(_) | Constant::FibreRotation(_)));
    let offsets = match named(|c| matches!(c, Constant::Offset(..))) {
        Some(names) => format!("Of the positions of the joint frames only {names} are fitted; all others stay"),
        None => "None of the positions of the joint frames is fitted; they stay".into(),
    };
    let [x, y, z] = machine.fibre_point_nm.map(|v| v * 1e-3);
    vec![
        format!(
            "{}{}.",
            slides(&machine.order),
            chip.map_or(String::new(), |names| format!("; how the chip lies to the base is in {names}"))
        ),
        "Home is where all motors count 0: how axes stand there is in the mounts.".into(),
        format!(
            "{offsets} as the nominal machine has them, and what is fitted of the mounts takes up what that leaves."
        ),
        format!(
            "The fibre point stays at ({x}, {y}, {z}) um of the array frame{}.",
            fibre.map_or(String::new(), |names| format!("; where that is on the last stage is in {names}"))
        ),
        "Approached upwards a stage stands at its motor's count; downwards it stands by the backlash above it.".into(),
    ]
}

/// Which frames the first two linear axes define: they have no static error of their own but the angle between them.
fn slides(order: &[Axis; AXES]) -> String {
    let linear: Vec<usize> = (0..AXES).filter(|k| !order[*k].is_rotary()).collect();
    let [first, second] = [order[linear[0]].name(), order[linear[1]].name()];
    let carrier = |k: usize| order[..k].iter().rev().find(|axis| axis.is_rotary()).map(|axis| axis.name());
    match (carrier(linear[0]), carrier(linear[1])) {
        (None, None) => format!(
            "The base frame is that of the slides: {first} moves exactly along its own axis of the base, {second} in the \
             plane of both"
        ),
        (below, above) => {
            let frame = |carrier: Option<&str>| match carrier {
                None => "the base".to_string(),
                Some(rotary) => format!("the frame of {rotary}"),
            };
            format!(
                "The frames are those of the slides: {first} moves exactly along its own axis of {}, {second} in the plane \
                 of {first} and {second} of {}",
                frame(below),
                frame(above)
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// All orders of the six axes.
    fn every_order() -> Vec<[Axis; AXES]> {
        let mut orders: Vec<Vec<Axis>> = vec![Vec::new()];
        for _ in 0..AXES {
            let longer = |order: &Vec<Axis>| {
                let rest = Axis::ALL.into_iter().filter(|axis| !order.contains(axis));
                rest.map(|axis| [order.clone(), vec![axis]].concat()).collect::<Vec<_>>()
            };
            orders = orders.iter().flat_map(longer).collect();
        }
        orders.into_iter().map(|order| order.try_into().unwrap()).collect()
    }

    /// Names of keys, or of their beginnings, in a sentence.
    fn keys(sentence: &str) -> Vec<&str> {
        let words = sentence.split(|c: char| c.is_whitespace() || ",;:()".contains(c));
        let groups = ["static_rad", "axis_offset_um", "mount.", "axes."];
        words.map(|word| word.trim_end_matches('.')).filter(|w| groups.iter().any(|g| w.starts_with(g))).collect()
    }

    /// What the sentences hold and what they fit; the same constant never both, by its own name or by a beginning.
    fn held_and_fitted(gauge: &Gauge) -> [Vec<&str>; 2] {
        let (held, others): (Vec<&String>, Vec<_>) = gauge.sentences.iter().partition(|s| s.contains(" is held at "));
        let held: Vec<&str> = held.into_iter().map(|sentence| keys(sentence)[0]).collect();
        let fitted: Vec<&str> = others.into_iter().flat_map(|sentence| keys(sentence)).collect();
        for (held, fitted) in held.iter().flat_map(|held| fitted.iter().map(move |fitted| (held, fitted))) {
            let rest = held.strip_prefix(fitted);
            assert!(!rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.')), "{:?}", gauge.sentences);
        }
        [held, fitted]
    }

    #[test]
    fn in_none_of_the_720_orders_a_constant_is_both_held_and_fitted() {
        let mut tally = BTreeMap::new();
        let mut sets: BTreeMap<Vec<String>, usize> = BTreeMap::new();
        let orders = every_order();
        assert_eq!(orders.len(), 720);
        for order in orders.into_iter().step_by(if cfg!(debug_assertions) { 37 } else { 1 }) {
            let machine = Machine { order, ..Machine::paper() };
            let gauge = gauge(&machine, &Options::default()).unwrap();
            let [held, fitted] = held_and_fitted(&gauge);
            let constants = Constant::all(&order);
            let flags: Vec<String> =
                (0..CONSTANTS).filter(|i| gauge.held_constants[*i]).map(|i| constants[i].to_string()).collect();
            assert_eq!(held, flags, "{order:?}");
            // the offsets, the chip's orientation and the mount of the array are fitted and named, or held and named
            let spoken = constants[9..18].iter().chain(&constants[21..]).map(Constant::to_string);
            for name in spoken {
                assert!(fitted.contains(&name.as_str()) != held.contains(&name.as_str()), "{order:?} {name}");
            }
            let linear_first = order[..3].iter().all(|axis| !axis.is_rotary());
            assert!(!linear_first || held.is_empty(), "{order:?} {held:?}");
            let linear = order.iter().enumerate().filter(|(_, axis)| !axis.is_rotary());
            let slides_on_the_base = linear.map(|(k, _)| k).take(2).eq(0..2);
            let said = gauge.sentences[0].starts_with("The base frame is that of the slides");
            assert_eq!(said, slides_on_the_base, "{order:?}");
            *tally.entry(CONSTANTS - held.len()).or_insert(0) += 1;
            *sets.entry(flags).or_insert(0) += 1;
        }
        println!("figure: constants fitted, and in how many orders: {tally:?}; held: {sets:?}");
    }

    #[test]
    fn what_is_held_on_request_is_named_as_held_alone_and_frees_its_double() {
        use Axis::{Alpha, Beta, Gamma, X, Y, Z};
        let machine = Machine { order: [Gamma, Beta, Alpha, Z, X, Y], ..Machine::paper() };
        let plain = gauge(&machine, &Options::default()).unwrap();
        let count = |gauge: &Gauge| gauge.held_constants.iter().filter(|held| **held).count();
        assert!(count(&plain) > 0);
        for name in ["mount.chip.rot_rad", "mount.fibre", "axis_offset_um"] {
            let options = Options { hold: vec![(name.into(), None)], ..Options::default() };
            let asked = gauge(&machine, &options).unwrap();
            let [held, _] = held_and_fitted(&asked);
            assert!(held.iter().any(|held| held.starts_with(name)));
        }
        // two ways to turn one thing: holding one by hand is as good as the other
        let hold = vec![("static_rad.ex_gamma".into(), None)];
        let asked = gauge(&machine, &Options { hold, ..Options::default() }).unwrap();
        println!("{:#?}", asked.sentences);
        assert_eq!(count(&asked), count(&plain));
    }
}
