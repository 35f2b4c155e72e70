//! Identification: what can be told from measurements, and how well.

mod stage;

use host_sim::identify::{Constant, Linearised, dependent, ranks};
use host_sim::machine::{Machine, StaticErrors};
use host_sim::model::{Chain, vee};
use nalgebra::Vector3;
use stage::Dice;
use stage_controller::units::{AXES, Axis};

/// All orders of the six axes.
fn every_order() -> Vec<[Axis; AXES]> {
    let mut orders = vec![Vec::new()];
    for _ in 0..AXES {
        orders = orders
            .into_iter()
            .flat_map(|order: Vec<Axis>| {
                let rest: Vec<Axis> = Axis::ALL.into_iter().filter(|axis| !order.contains(axis)).collect();
                rest.into_iter().map(move |axis| [order.clone(), vec![axis]].concat())
            })
            .collect();
    }
    orders.into_iter().map(|order| order.try_into().unwrap()).collect()
}

fn linear_first(order: &[Axis; AXES]) -> bool {
    order[..3].iter().all(|axis| !axis.is_rotary())
}

/// The paper's machine with statics, offsets and mounts drawn at random.
fn drawn(dice: &mut Dice, order: [Axis; AXES]) -> Machine {
    let mut machine = Machine { order, ..Machine::paper() };
    machine.statics = StaticErrors::from_values([0.0; 9].map(|_| dice.between(-1e-3, 1e-3)));
    for constant in Constant::all(&order).into_iter().skip(9) {
        let reach = if constant.is_angle() { 1e-3 } else { 3e5 };
        constant.set(&mut machine, dice.between(-reach, reach));
    }
    machine
}

#[test]
fn of_the_48_candidates_24_can_be_told_apart_and_all_nine_static_angles() {
    let orders = every_order();
    assert_eq!(orders.len(), 720);
    let (mut gap, mut full, mut less) = ((f64::MAX, 0.0_f64), 0, std::collections::BTreeMap::new());
    let mut dice = Dice::new(48);
    for order in orders {
        for machine in
            [Machine { order, statics: StaticErrors::default(), ..Machine::paper() }, drawn(&mut dice, order)]
        {
            let ranks = ranks(&machine);
            assert_eq!((ranks.candidates, ranks.statics), (24, 9), "{order:?} {ranks:?}");
            gap = (gap.0.min(ranks.gap.0), gap.1.max(ranks.gap.1));
            if linear_first(&order) {
                assert_eq!(ranks.chosen, 24, "{order:?}");
            }
            if ranks.chosen == 24 { full += 1 } else { *less.entry(ranks.chosen).or_insert(0) += 1 }
        }
    }
    println!("figure: 720 orders, with and without errors: rank 24 of 48 and 9 of 9; singular values {gap:?}");
    println!("figure: the 24 chosen constants have rank 24 in {full} of 1440 cases, less in {less:?}");
}

#[test]
fn the_derivatives_are_those_of_the_exact_chain() {
    let mut dice = Dice::new(5);
    let mut worst = 0.0_f64;
    for order in every_order().into_iter().step_by(29) {
        let machine = drawn(&mut dice, order);
        let pose = [2e6, -1e6, 3e6, 4e7, -6e7, 5e7];
        let at = Linearised::new(&machine, &pose);
        let (rotation, origin) = at.array(&machine);
        let point = origin + rotation * Vector3::from(machine.fibre_point_nm);
        let place = |machine: &Machine, pose: [f64; AXES]| {
            let chain = Chain::new(machine);
            let there = chain.true_pose(pose);
            let turned = chain.euler().compose([there[3], there[4], there[5]].map(|a| a * 1e-9));
            (chain.fibre_home() + Vector3::new(there[0], there[1], there[2]), turned * chain.home_rotation())
        };
        assert!((place(&machine, pose).0 - point).norm() < 1e-6);
        for constant in Constant::all(&order) {
            let h = if constant.is_angle() { 1e-5 } else { 1e4 };
            let [more, less] = [h, -h].map(|h| {
                let mut changed = machine.clone();
                constant.set(&mut changed, constant.of(&machine) + h);
                place(&changed, pose)
            });
            let twist = at.constant(constant, &order);
            let moved = (more.0 - less.0) / (2.0 * h) - twist.moves(point);
            let turned = vee(&(more.1 * less.1.transpose())) / (2.0 * h) - twist.turn;
            let off =
                if constant.is_angle() { moved.norm() / 5e7 + turned.norm() } else { moved.norm() + turned.norm() };
            worst = worst.max(off);
            assert!(off < 1e-7, "{order:?} {constant}: {moved} {turned}");
        }
    }
    println!("figure: derivatives differ from differences of the exact chain by at most {worst:.1e}");
}

#[test]
fn orders_in_which_the_usual_24_depend_on_each_other_are_known_by_name() {
    let order = [Axis::Gamma, Axis::Beta, Axis::Alpha, Axis::Z, Axis::X, Axis::Y];
    let lost = dependent(&order, &drawn(&mut Dice::new(1), order));
    println!(
        "figure: gamma beta alpha Z X Y: dependent {:?}",
        lost.iter().map(Constant::to_string).collect::<Vec<_>>()
    );
    assert!(!lost.is_empty());
}
