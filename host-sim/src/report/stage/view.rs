//! The section itself: drawings, constants, tables 1 to 4.

use super::{MountFacts, StageFacts, chain, geometry};
use crate::report::number::figure;
use crate::report::page::{Section, caption, folded};
use crate::report::sensitivity::greek;
use maud::{Markup, html};

pub(in crate::report) fn section(stage: &StageFacts) -> Section {
    let body = html! {
        @for turned in &stage.turned {
            p.warning { (turned) ". No constant matrix corrects it, and the controller refuses such an order." }
        }
        figure {
            (chain::draw(stage))
            figcaption {
                "The chain: " (stage.degrees_of_freedom) " degrees of freedom between base and fibre array; the chip stands \
                on the base. Blue: linear stages; violet: rotary stages."
            }
        }
        figure {
            (geometry::draw(stage))
            figcaption {
                "The three rotary axes and the fibre point F with all stages at home, in chip axes, to scale (mm; x is \
                foreshortened). Dashed: the lever, the shortest way from each axis to F. A longer lever turns the same angle \
                error into a larger displacement."
            }
        }
        div.tables {
            div { (statics(stage)) }
            div { (points(stage)) }
        }
        (axes(stage))
        div.tables {
            (folded("Table 1: low-order body array", low_order(stage)))
            (folded("Table 2: freedom of each pair of bodies", freedoms(stage)))
        }
        (folded("Table 3: the 36 errors of the stages", errors(stage)))
        (folded("Table 4: characteristic matrices", matrices(stage)))
    };
    Section { id: "stage", title: "The stage", body }
}

fn axes(stage: &StageFacts) -> Markup {
    html! {
        (caption("table", "The stages from the base to the fibre array. Step and backlash in nm or nrad; lever: distance of F \
            from the axis of a rotary stage."))
        div.wide { table {
            thead {
                tr {
                    th { "Stage" } th colspan="3" { "shift x, y, z, um" } th colspan="2" { "travel" } th.left { "" }
                    th { "step" } th { "backlash" } th { "lever, mm" }
                }
            }
            tbody {
                @for (n, axis) in stage.axes.iter().enumerate() {
                    @let at = |name: &str| format!("/stage/axes/{n}/{name}");
                    tr {
                        th { (axis.name) }
                        @for (i, v) in axis.offset_um.iter().enumerate() { td { (figure(at(&format!("offset_um/{i}")), *v)) } }
                        td { (figure(at("travel/0"), axis.travel[0])) }
                        td { (figure(at("travel/1"), axis.travel[1])) }
                        td.left { (axis.unit) }
                        td { (figure(at("step"), axis.step)) }
                        td { (figure(at("backlash"), axis.backlash)) }
                        td { @if let Some(lever) = axis.lever_mm { (figure(at("lever_mm"), lever)) } @else { "\u{2013}" } }
                    }
                }
            }
        } }
    }
}

fn statics(stage: &StageFacts) -> Markup {
    html! {
        (caption("table", "The nine static errors, urad."))
        table {
            thead { tr { th { "Error" } th.left { "about" } th.left { "meaning" } th { "urad" } } }
            tbody {
                @for row in &stage.static_errors {
                    @let index = stage.static_urad.iter().position(|(name, _)| *name == row.name).unwrap_or_default();
                    tr {
                        th { (row.name) }
                        td.left { (row.about) }
                        td.left { (row.meaning) }
                        td { (figure(format!("/stage/static_urad/{index}/1"), stage.static_error(row.name))) }
                    }
                }
            }
        }
    }
}

fn points(stage: &StageFacts) -> Markup {
    let three = |pointer: &str, values: [f64; 3]| {
        html! { @for (i, v) in values.into_iter().enumerate() { td { (figure(format!("{pointer}/{i}"), v)) } } }
    };
    let mounts: [(&str, &str, MountFacts); 2] =
        [("fibre array", "fibre_mount", stage.fibre_mount), ("chip", "chip_mount", stage.chip_mount)];
    html! {
        (caption("table", "Fibre point and mounts."))
        table {
            thead { tr { th { "" } th.left { "unit" } th { "x" } th { "y" } th { "z" } } }
            tbody {
                tr { th { "F in the array" } td.left { "um" } (three("/stage/fibre_point_um", stage.fibre_point_um)) }
                tr { th { "F at home, chip axes" } td.left { "mm" } (three("/stage/fibre_home_mm", stage.fibre_home_mm)) }
                @for (name, key, mount) in mounts {
                    tr { th { "mount of the " (name) } td.left { "um" } (three(&format!("/stage/{key}/offset_um"), mount.offset_um)) }
                    tr { th { "its rotation" } td.left { "urad" } (three(&format!("/stage/{key}/rotation_urad"), mount.rotation_urad)) }
                }
            }
        }
        p.note {
            "Of " (stage.structure.candidates) " constants that the joints of such a chain could have, measurements of all \
            poses can tell " (stage.structure.rank_of_candidates) " apart (numerical rank); the nine static errors are "
            (stage.structure.rank_of_static) " of them."
        }
    }
}

fn low_order(stage: &StageFacts) -> Markup {
    html! {
        (caption("table", "L\u{207f}(j): the n-th body from j towards the base (0)."))
        table.dense.plain {
            thead { tr { th { "j" } @for j in 1..=8 { th { (j) } } } }
            tbody {
                @for (n, row) in stage.low_order_array.iter().enumerate() {
                    tr { th { "L" sup { (n) } "(j)" } @for j in row { td { (j) } } }
                }
            }
        }
    }
}

fn freedoms(stage: &StageFacts) -> Markup {
    html! {
        (caption("table", "1: the pair is free in this coordinate."))
        table.dense.plain {
            thead {
                tr { th { "Pair" } @for name in ["x", "y", "z", "alpha", "beta", "gamma"] { th { (name) } } }
            }
            tbody {
                @for pair in &stage.freedoms {
                    tr { th { (pair.carrier) "\u{2013}" (pair.body) } @for free in pair.free { td { (free) } } }
                }
            }
        }
    }
}

fn errors(stage: &StageFacts) -> Markup {
    html! {
        (caption("table", "Functions of the position of the stage, first the name of ISO 230-1, then that of the paper. \
            Displacements in um, rotations in rad."))
        div.wide { table.dense {
            thead {
                tr {
                    th { "Stage" }
                    @for column in ["\u{3b4}x", "\u{3b4}y", "\u{3b4}z", "\u{3b5}x", "\u{3b5}y", "\u{3b5}z"] { th.left { (column) } }
                }
            }
            tbody {
                @for rows in stage.kinematic_errors.chunks(6) {
                    tr {
                        th { (rows[0].axis) }
                        @for row in rows { td.left { strong { (row.iso) } " " (greek(&row.paper)) br; (row.meaning) } }
                    }
                }
            }
        } }
    }
}

fn matrices(stage: &StageFacts) -> Markup {
    html! {
        (caption("table", "The transform of each pair is T\u{209a} \u{394}T\u{209a} T\u{209b} \u{394}T\u{209b}; I is the unit \
            matrix."))
        div.wide { table.dense {
            thead {
                tr {
                    th { "Pair" } th.left { "stage" } th.left { "mounting T\u{209a}" } th.left { "static error \u{394}T\u{209a}" }
                    th.left { "motion T\u{209b}" } th.left { "error of the motion \u{394}T\u{209b}" }
                }
            }
            tbody {
                @for row in &stage.characteristic_matrices {
                    tr {
                        th { (row.pair[0]) "\u{2013}" (row.pair[1]) }
                        td.left { (row.stage) }
                        td.left { (row.mounting) }
                        td.left { (row.static_error) }
                        td.left { (row.motion) }
                        td.left { (row.kinematic_error) }
                    }
                }
            }
        } }
    }
}
