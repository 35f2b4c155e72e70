//! Bodies, low-order body arrays, freedoms, and how many errors are independent.

use host_sim::model::{CHIP, Joint, Topology, TopologyError, characteristic_matrices, static_errors, structure};
use serde_json::Value;
use stage_controller::units::{AXES, Axis};

fn reference() -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/error-model/topologies.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn reference_order(topology: &Value) -> [Axis; AXES] {
    let axis = |letter: &Value| match letter.as_str().unwrap() {
        "a" => Axis::Alpha,
        "b" => Axis::Beta,
        "g" => Axis::Gamma,
        name => Axis::ALL.into_iter().find(|axis| axis.name() == name).unwrap(),
    };
    let order: Vec<Axis> = topology["order"].as_array().unwrap().iter().map(axis).collect();
    order.try_into().unwrap()
}

/// All orders of the six axes.
fn every_order() -> Vec<[Axis; AXES]> {
    fn extend(begun: &mut Vec<Axis>, found: &mut Vec<[Axis; AXES]>) {
        if let Ok(order) = begun.clone().try_into() {
            found.push(order);
        }
        for axis in Axis::ALL {
            if !begun.contains(&axis) {
                begun.push(axis);
                extend(begun, found);
                begun.pop();
            }
        }
    }
    let mut found = Vec::new();
    extend(&mut Vec::new(), &mut found);
    found
}

#[test]
fn tables_1_and_2_of_the_three_orders_are_those_of_the_reference() {
    let reference = reference();
    let reference = reference.as_object().unwrap();
    assert_eq!(reference.len(), 3);
    let orders: Vec<_> = reference.values().map(reference_order).collect();
    assert!(Topology::PAPER.iter().all(|order| orders.contains(order)));
    for (topology, order) in reference.values().zip(orders) {
        let ours = Topology::serial(&order);
        assert_eq!(serde_json::to_value(ours.low_order_array()).unwrap(), topology["L"]);
        let freedoms = ours.freedoms();
        assert_eq!(freedoms.len(), topology["dof_xyzabg"].as_object().unwrap().len());
        for pair in freedoms {
            let name = format!("{}-{}", pair.carrier, pair.body);
            assert_eq!(serde_json::to_value(pair.free).unwrap(), topology["dof_xyzabg"][&name], "{name}");
        }
        assert_eq!(ours.degrees_of_freedom(), 6);
    }
}

#[test]
fn the_static_errors_of_an_order_are_those_of_the_reference() {
    for topology in reference().as_object().unwrap().values() {
        let ours = static_errors(&reference_order(topology));
        let names: Vec<String> = ours
            .iter()
            .map(|row| {
                let greek = |n: &str| n.replace("alpha", "α").replace("beta", "β").replace("gamma", "γ");
                match row.name.strip_prefix('e') {
                    Some(rest) => format!("ε{} ", greek(rest)),
                    None => {
                        format!("{} (squareness {}, about {})", row.name, &row.meaning[11..], row.about.to_uppercase())
                    }
                }
            })
            .collect();
        let wanted: Vec<&str> = topology["static"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
        assert_eq!(names.len(), wanted.len());
        for ((name, row), wanted) in names.iter().zip(&ours).zip(wanted) {
            assert!(wanted.starts_with(name.as_str()), "{name} against {wanted}");
            let about = row.about.to_uppercase();
            assert!(wanted.ends_with(&format!("about {about})")) || wanted.ends_with(&format!("tilt about {about})")));
        }
    }
}

#[test]
fn three_static_errors_turn_about_each_axis_whatever_the_order() {
    for order in every_order() {
        let rows = static_errors(&order);
        for about in ["x", "y", "z"] {
            assert_eq!(rows.iter().filter(|row| row.about == about).count(), 3, "{order:?}");
        }
    }
}

#[test]
fn of_48_candidates_24_are_independent_and_all_nine_for_every_order() {
    let orders = every_order();
    assert_eq!(orders.len(), 720);
    for order in &orders {
        let ranks = structure(order);
        assert_eq!((ranks.candidates, ranks.rank_of_candidates, ranks.rank_of_static), (48, 24, 9), "{order:?}");
    }
}

#[test]
fn the_24_constants_are_complete_where_a_constant_coupling_holds() {
    let named = Topology::PAPER.into_iter();
    let constant = every_order().into_iter().filter(|order| Topology::serial(order).turned().is_empty());
    let orders: Vec<_> = named.chain(constant).collect();
    assert_eq!(orders.len(), 3 + 36);
    for order in orders {
        assert_eq!(structure(&order).rank_of_constants, 24, "{order:?}");
    }
}

#[test]
fn a_linear_axis_behind_a_rotary_one_is_named() {
    let named =
        |order: &[Axis; AXES]| Topology::serial(order).turned().iter().map(ToString::to_string).collect::<Vec<_>>();
    let [straight, turned, other] = Topology::PAPER;
    assert!(named(&straight).is_empty() && named(&other).is_empty());
    assert_eq!(named(&turned), ["Y lies behind gamma: the coupling depends on the pose"]);
    for order in every_order() {
        let first_rotary = order.iter().position(|axis| axis.is_rotary()).unwrap();
        assert_eq!(named(&order).is_empty(), first_rotary == 3, "{order:?}");
    }
}

/// Z and gamma under the chip, the other four under the fibre array.
fn two_branches() -> Vec<(usize, Joint)> {
    let stage = Joint::Stage;
    vec![
        (3, Joint::Fixed),
        (0, stage(Axis::Z)),
        (2, stage(Axis::Gamma)),
        (0, stage(Axis::X)),
        (4, stage(Axis::Y)),
        (5, stage(Axis::Beta)),
        (6, stage(Axis::Alpha)),
        (7, Joint::Fixed),
    ]
}

#[test]
fn a_tree_has_its_own_low_order_array() {
    let tree = Topology::tree(two_branches()).unwrap();
    assert_eq!(
        tree.low_order_array(),
        [
            [1, 2, 3, 4, 5, 6, 7, 8],
            [3, 0, 2, 0, 4, 5, 6, 7],
            [2, 0, 0, 0, 0, 4, 5, 6],
            [0, 0, 0, 0, 0, 0, 4, 5],
            [0, 0, 0, 0, 0, 0, 0, 4],
            [0; 8],
        ]
    );
    assert_eq!(tree.towards_base(CHIP, 2), 2);
    assert_eq!(tree.path(), [Axis::Gamma, Axis::Z, Axis::X, Axis::Y, Axis::Beta, Axis::Alpha]);
    // seen from the chip its own gamma turns all slides
    let turned: Vec<Axis> = tree.turned().iter().map(|t| t.linear).collect();
    assert_eq!(turned, [Axis::Z, Axis::X, Axis::Y]);
}

#[test]
fn what_carries_chip_and_array_alike_couples_nothing() {
    let tree =
        Topology::tree(vec![(2, Joint::Fixed), (0, Joint::Stage(Axis::Gamma)), (2, Joint::Stage(Axis::X))]).unwrap();
    assert_eq!(tree.path(), [Axis::X]);
    assert!(tree.turned().is_empty());
}

#[test]
fn what_is_no_tree_is_refused_with_the_body() {
    let mut looped = two_branches();
    looped[3].0 = 8;
    assert!(matches!(Topology::tree(looped), Err(TopologyError::Loop(4))));
    let mut beyond = two_branches();
    beyond[3].0 = 9;
    assert!(matches!(Topology::tree(beyond), Err(TopologyError::Unknown { body: 4, parent: 9, last: 8 })));
    let mut twice = two_branches();
    twice[4].1 = Joint::Stage(Axis::Z);
    assert!(matches!(Topology::tree(twice), Err(TopologyError::Twice { axis: Axis::Z, first: 2, second: 5 })));
    assert!(matches!(Topology::tree(vec![(0, Joint::Fixed)]), Err(TopologyError::TooFew(1))));
}

#[test]
fn a_squareness_belongs_to_the_later_of_its_two_axes_in_table_4() {
    let offsets = [[0.0; 3]; AXES];
    let errors = |order: [Axis; AXES]| {
        characteristic_matrices(&order, &offsets).into_iter().map(|row| row.static_error).collect::<Vec<_>>()
    };
    let [paper, ..] = Topology::PAPER;
    assert_eq!(
        errors(paper)[1..7],
        [
            "I",
            "exp([0, S_ZX, 0]x)",
            "exp([S_ZY, 0, S_XY]x)",
            "exp([ex_gamma, ey_gamma, 0]x)",
            "exp([ex_beta, 0, ez_beta]x)",
            "exp([0, ey_alpha, ez_alpha]x)"
        ]
    );
    let [a, b, g] = Axis::ROTARY;
    let other = errors([Axis::Y, Axis::X, Axis::Z, g, b, a]);
    assert_eq!(other[1..4], ["I", "exp([0, 0, S_XY]x)", "exp([S_ZY, S_ZX, 0]x)"]);
}
