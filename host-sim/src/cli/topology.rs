//! `host-sim topology`: which body stands on which, what errors the joints have, how many are independent.

use super::Failure;
use super::common::load;
use super::sheet::{Sheet, Style};
use crate::model::{
    CharacteristicRow, ErrorRow, Joint, PairFreedom, StaticErrorRow, Structure, Topology, characteristic_matrices,
    kinematic_errors, static_errors, structure,
};
use serde::Serialize;
use stage_controller::units::{AXES, Axis};
use std::path::PathBuf;

/// Print the low-order body array and the freedoms of a stage (tables 1 and 2 of the paper), its 36 kinematic and nine
/// static errors and its characteristic matrices (tables 3 and 4), and how many of the errors are independent.
///
/// Without arguments: for the three orders that the paper names. A linear axis behind a rotary one is named.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Machine files (TOML), or `paper`: their orders and axis offsets (um).
    machines: Vec<PathBuf>,
    /// An order from the base to the fibre array, such as Z,X,Y,gamma,beta,alpha; may be given again.
    #[arg(long, value_name = "AXES", value_parser = order)]
    order: Vec<Order>,
    /// Any tree: for each body from 1, the chip, to the last, the fibre array, its joint (an axis, or `-` for none) and
    /// the body on which it stands (0 is the base), such as "-:0 Z:0 X:2 Y:3 gamma:4 beta:5 alpha:6 -:7".
    #[arg(long, value_name = "BODIES", value_parser = tree, allow_hyphen_values = true)]
    tree: Vec<Tree>,
    #[command(flatten)]
    style: Style,
}

/// A permutation of the axes.
#[derive(Clone, Copy, Debug)]
struct Order([Axis; AXES]);

#[derive(Clone, Debug)]
struct Tree(Topology);

fn axis(name: &str) -> Result<Axis, String> {
    let known = Axis::ALL.into_iter().find(|axis| axis.name() == name.trim());
    known.ok_or_else(|| format!("{name:?} is none of X, Y, Z, alpha, beta, gamma"))
}

fn order(text: &str) -> Result<Order, String> {
    let axes: Vec<Axis> = text.split(',').map(axis).collect::<Result<_, _>>()?;
    if let Some((i, twice)) = axes.iter().enumerate().find(|(i, axis)| axes[..*i].contains(axis)) {
        return Err(format!("{} is named twice, again in place {}", twice.name(), i + 1));
    }
    axes.try_into().map(Order).map_err(|_| "all six axes must be named".into())
}

fn tree(text: &str) -> Result<Tree, String> {
    let body = |word: &str| {
        let (joint, parent) = word.split_once(':').ok_or_else(|| format!("{word:?} is not JOINT:BODY"))?;
        let parent: usize =
            parent.parse().map_err(|_| format!("{parent:?} in {word:?} is not the number of a body"))?;
        let joint = if joint == "-" { Joint::Fixed } else { Joint::Stage(axis(joint)?) };
        Ok((parent, joint))
    };
    let bodies = text.split_whitespace().map(body).collect::<Result<Vec<_>, String>>()?;
    Topology::tree(bodies).map(Tree).map_err(|error| error.to_string())
}

/// One topology, analysed. What needs a serial order is absent for a tree.
#[derive(Debug, Serialize)]
struct Analysis {
    name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    order: Option<[&'static str; AXES]>,
    low_order_array: Vec<Vec<usize>>,
    freedoms: Vec<PairFreedom>,
    degrees_of_freedom: usize,
    /// Sentences about linear axes behind rotary ones.
    pose_dependent: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    static_errors: Option<Vec<StaticErrorRow>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    characteristic_matrices: Option<Vec<CharacteristicRow>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    independent: Option<Structure>,
}

impl Analysis {
    fn of_tree(name: String, topology: &Topology) -> Self {
        Analysis {
            name,
            order: None,
            low_order_array: topology.low_order_array(),
            freedoms: topology.freedoms(),
            degrees_of_freedom: topology.degrees_of_freedom(),
            pose_dependent: topology.turned().iter().map(ToString::to_string).collect(),
            static_errors: None,
            characteristic_matrices: None,
            independent: None,
        }
    }

    fn of_order(name: Option<String>, order: &[Axis; AXES], offset_um: &[[f64; 3]; AXES]) -> Self {
        let names = order.map(Axis::name);
        let line = names.join(" ");
        Analysis {
            order: Some(names),
            static_errors: Some(static_errors(order)),
            characteristic_matrices: Some(characteristic_matrices(order, offset_um)),
            independent: Some(structure(order)),
            ..Self::of_tree(name.map_or(line.clone(), |name| format!("{name}: {line}")), &Topology::serial(order))
        }
    }

    fn sheets(&self, to: &mut Vec<Sheet>) {
        let name = &self.name;
        let mut low = Sheet::new(
            format!("Table 1, low-order body array, {name}"),
            std::iter::once("L^n(j)".to_string()).chain(self.low_order_array[0].iter().map(|j| format!("j={j}"))),
        );
        for (n, row) in self.low_order_array.iter().enumerate() {
            low.row(std::iter::once(format!("L^{n}")).chain(row.iter().map(usize::to_string)));
        }
        to.push(low);
        let mut pairs = Sheet::new(
            format!("Table 2, freedom of neighbouring bodies, {name}, {} in all", self.degrees_of_freedom),
            ["pair", "free", "x", "y", "z", "alpha", "beta", "gamma"],
        );
        for pair in &self.freedoms {
            let head = [format!("{}-{}", pair.carrier, pair.body), pair.coordinate.unwrap_or("-").into()];
            pairs.row(head.into_iter().chain(pair.free.map(|f| f.to_string())));
        }
        to.push(pairs);
        let mut turned = Sheet::new(format!("Coupling of the linear axes, {name}"), ["coupling"]);
        for sentence in &self.pose_dependent {
            turned.row([sentence]);
        }
        if self.pose_dependent.is_empty() {
            turned.row(["constant: no linear axis lies behind a rotary one"]);
        }
        to.push(turned);
        if let Some(rows) = &self.static_errors {
            let mut sheet = Sheet::new(format!("Static errors, {name}"), ["name", "stage", "about", "meaning"]);
            rows.iter().for_each(|row| sheet.row([row.name, row.joint, row.about, row.meaning]));
            to.push(sheet);
        }
        if let Some(rows) = &self.characteristic_matrices {
            let mut sheet = Sheet::new(
                format!("Table 4, characteristic matrices (um), {name}"),
                ["pair", "stage", "Tp", "dTp", "Ts", "dTs"],
            );
            for r in rows {
                let pair = format!("{}-{}", r.pair[0], r.pair[1]);
                sheet.row([pair.as_str(), r.stage, &r.mounting, &r.static_error, &r.motion, &r.kinematic_error]);
            }
            to.push(sheet);
        }
        if let Some(s) = &self.independent {
            let mut sheet = Sheet::new(format!("Independent errors, {name}"), ["set", "parameters", "independent"]);
            sheet.row([
                "six at each of the eight interfaces",
                &s.candidates.to_string(),
                &s.rank_of_candidates.to_string(),
            ]);
            sheet.row(["the nine static errors", "9", &s.rank_of_static.to_string()]);
            sheet.row([
                "nine static errors, three distances of rotary axes, two mounts",
                "24",
                &s.rank_of_constants.to_string(),
            ]);
            to.push(sheet);
        }
    }
}

#[derive(Debug, Serialize)]
struct Report {
    topologies: Vec<Analysis>,
    kinematic_errors: Vec<ErrorRow>,
}

impl Args {
    pub(super) fn run(self) -> Result<(), Failure> {
        let none = [[0.0; 3]; AXES];
        let mut topologies = Vec::new();
        for path in &self.machines {
            let machine = load(path)?;
            let offsets = machine.axis_offset_nm.map(|offset| offset.map(|v| v * 1e-3));
            topologies.push(Analysis::of_order(Some(machine.name), &machine.order, &offsets));
        }
        topologies.extend(self.order.iter().map(|order| Analysis::of_order(None, &order.0, &none)));
        topologies
            .extend(self.tree.iter().enumerate().map(|(i, t)| Analysis::of_tree(format!("tree {}", i + 1), &t.0)));
        if topologies.is_empty() {
            topologies.extend(Topology::PAPER.iter().map(|order| Analysis::of_order(None, order, &none)));
        }
        let report = Report { topologies, kinematic_errors: kinematic_errors(&Axis::ALL) };
        self.style.print(&report, || {
            let mut sheets = Vec::new();
            report.topologies.iter().for_each(|topology| topology.sheets(&mut sheets));
            let mut errors =
                Sheet::new("Table 3, kinematic errors", ["ISO 230-1", "paper", "stage", "meaning", "unit"]);
            report.kinematic_errors.iter().for_each(|r| errors.row([&r.iso, &r.paper, r.axis, r.meaning, r.unit]));
            sheets.push(errors);
            sheets
        })
    }
}
