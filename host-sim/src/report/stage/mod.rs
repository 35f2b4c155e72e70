//! The section on the stage itself: its chain, its constants, tables 1 to 4 of the paper.

mod chain;
mod geometry;
mod view;

pub(super) use view::section;

use crate::machine::{Machine, StaticErrors};
use crate::model::{
    Chain, CharacteristicRow, ErrorRow, PairFreedom, StaticErrorRow, Structure, Topology, characteristic_matrices,
    kinematic_errors, static_errors, structure,
};
use serde::Serialize;
use stage_controller::units::{AXES, Axis};

/// A position and an orientation error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MountFacts {
    /// um.
    pub offset_um: [f64; 3],
    /// urad.
    pub rotation_urad: [f64; 3],
}

/// One stage with its motor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AxisFacts {
    /// Its name.
    pub name: &'static str,
    /// Position of its frame in the one before it, um.
    pub offset_um: [f64; 3],
    /// um or deg.
    pub unit: &'static str,
    /// Lower and upper end of the travel.
    pub travel: [f64; 2],
    /// nm or nrad.
    pub step: f64,
    /// nm or nrad.
    pub backlash: f64,
    /// Distance of the fibre point from the axis of a rotary stage, mm.
    pub lever_mm: Option<f64>,
    /// A rotary stage: a point of its axis at home in chip axes, nearest to the fibre point, mm.
    pub point_mm: Option<[f64; 3]>,
    /// Direction of a linear stage or of a rotary stage's axis at home, in chip axes.
    pub direction: [f64; 3],
}

/// What the stage is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageFacts {
    /// From the base to the fibre array.
    pub order: [&'static str; AXES],
    /// Coordinates that move.
    pub degrees_of_freedom: usize,
    /// F in the frame of the fibre array, um.
    pub fibre_point_um: [f64; 3],
    /// F at home in chip axes, mm.
    pub fibre_home_mm: [f64; 3],
    /// Stages in the order of the chain.
    pub axes: Vec<AxisFacts>,
    /// The nine static errors with their values, urad.
    pub static_urad: Vec<(&'static str, f64)>,
    /// Which stage has each of them.
    pub static_errors: Vec<StaticErrorRow>,
    /// Mount of the fibre array.
    pub fibre_mount: MountFacts,
    /// Mount of the chip.
    pub chip_mount: MountFacts,
    /// Linear stages behind rotary ones: each makes the coupling depend on the pose.
    pub turned: Vec<String>,
    /// Linear stages among them.
    pub turned_axes: Vec<&'static str>,
    /// Table 1: row n holds L^n(j) for the bodies j from 1.
    pub low_order_array: Vec<Vec<usize>>,
    /// Table 2.
    pub freedoms: Vec<PairFreedom>,
    /// Table 3.
    pub kinematic_errors: Vec<ErrorRow>,
    /// Table 4.
    pub characteristic_matrices: Vec<CharacteristicRow>,
    /// How many constants are independent.
    pub structure: Structure,
}

impl StageFacts {
    pub(super) fn new(machine: &Machine) -> Self {
        let (chain, topology) = (Chain::new(machine), Topology::serial(&machine.order));
        let turned = topology.turned();
        let mut turned_axes: Vec<_> = turned.iter().map(|turned| turned.linear.name()).collect();
        turned_axes.dedup();
        let mount = |mount: crate::machine::Mount| MountFacts {
            offset_um: mount.offset_nm.map(|v| v * 1e-3),
            rotation_urad: mount.rotation_rad.map(|v| v * 1e6),
        };
        let offset_um = machine.axis_offset_nm.map(|offset| offset.map(|v| v * 1e-3));
        StageFacts {
            order: machine.order.map(Axis::name),
            degrees_of_freedom: topology.degrees_of_freedom(),
            fibre_point_um: machine.fibre_point_nm.map(|v| v * 1e-3),
            fibre_home_mm: (chain.fibre_home() * 1e-6).into(),
            axes: machine.order.map(|axis| axis_facts(machine, &chain, axis)).into(),
            static_urad: StaticErrors::NAMES.into_iter().zip(machine.statics.values().map(|rad| rad * 1e6)).collect(),
            static_errors: static_errors(&machine.order),
            fibre_mount: mount(machine.mounts.fibre),
            chip_mount: mount(machine.mounts.chip),
            turned: turned.iter().map(ToString::to_string).collect(),
            turned_axes,
            low_order_array: topology.low_order_array(),
            freedoms: topology.freedoms(),
            kinematic_errors: kinematic_errors(&machine.order),
            characteristic_matrices: characteristic_matrices(&machine.order, &offset_um),
            structure: structure(&machine.order),
        }
    }

    /// Value of a static error, urad.
    fn static_error(&self, name: &str) -> f64 {
        self.static_urad.iter().find(|(known, _)| *known == name).map_or(0.0, |(_, value)| *value)
    }
}

fn axis_facts(machine: &Machine, chain: &Chain, axis: Axis) -> AxisFacts {
    let (i, drive) = (axis.index(), &machine.drives[axis.index()]);
    let screw = axis.is_rotary().then(|| chain.screws()[i - 3]);
    let fibre = chain.fibre_home();
    let nearest = screw.map(|screw| screw.nearest(fibre));
    let direction = screw.map_or_else(|| chain.slides_matrix().column(i).into(), |screw| screw.direction);
    AxisFacts {
        name: axis.name(),
        offset_um: machine.axis_offset_nm[i].map(|v| v * 1e-3),
        unit: if axis.is_rotary() { "deg" } else { "um" },
        travel: drive.travel.map(|end| if axis.is_rotary() { (end * 1e-9).to_degrees() } else { end * 1e-3 }),
        step: drive.step,
        backlash: drive.backlash,
        lever_mm: nearest.map(|point| (fibre - point).norm() * 1e-6),
        point_mm: nearest.map(|point| (point * 1e-6).into()),
        direction: direction.into(),
    }
}
