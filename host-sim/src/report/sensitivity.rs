//! The section on sensitivity: which single error moves the fibre point how far (tables 5 and 6 of the paper).

use super::number::{figure, short};
use super::page::{Section, Swatch, caption, folded, legend};
use super::plot::{Scale, drawing, line, px, rectangle, text};
use crate::model::{Rank, Sensitivity};
use maud::{Markup, html};

/// Sources that the drawing shows for each direction.
const SHOWN: usize = 14;
const NAMES: [&str; 3] = ["X", "Y", "Z"];

pub(super) fn section(s: &Sensitivity) -> Section {
    let [fx, fy, fz] = s.fibre_point_um;
    let body = html! {
        p {
            "One error at a time: " (short(s.magnitudes.linear_um)) " um for a displacement, "
            (short(s.magnitudes.angular_rad * 1e6)) " urad for a rotation of a stage or a mount, "
            (short(s.magnitudes.squareness_rad * 1e6)) " urad for a squareness or axis tilt. Its own stage is displaced by "
            (short(s.unit.linear_um)) " um or " (short(s.unit.angle_rad * 1e3)) " mrad, for static and mounting errors all six \
            are. F = (" (short(fx)) ", " (short(fy)) ", " (short(fz)) ") um in the frame of the fibre array."
        }
        figure {
            (legend(Swatch::Bar, &[("c-coupling".into(), "one of the 36 errors of the stages"), ("c-pivot".into(), "static or mounting error")]))
            (bars(&s.ranking))
            figcaption {
                "The " (SHOWN) " errors that move the fibre point most along each direction, um, strongest first; the sign is \
                that of the displacement for a positive error. Names: ISO 230-1 for the 36 errors of the stages (E, \
                direction, stage), otherwise those of machine files."
            }
        }
        p {
            "The static errors of this machine alone displace the fibre point at home by ("
            @for (i, v) in s.background_at_home_um.iter().enumerate() {
                @if i > 0 { ", " } (figure(format!("/sensitivity/background_at_home_um/{i}"), *v))
            }
            ") um."
        }
        (folded("Tables 5 and 6: the 36 errors of the stages", kinematic(s)))
        (folded("Static and mounting errors", statics(s)))
    };
    Section { id: "sensitivity", title: "Which error moves the fibre how far", body }
}

fn bars(ranking: &[Vec<Rank>; 3]) -> Markup {
    const ROW: f64 = 17.0;
    let largest = ranking.iter().flatten().map(|rank| rank.effect_um.abs()).fold(0.0, f64::max);
    let cell = 320.0;
    let bottom = 26.0 + SHOWN as f64 * ROW + 4.0;
    let across = Scale::with_zero([0.0, largest], [104.0, cell - 56.0]);
    let content = html! {
        @for (direction, ranks) in ranking.iter().enumerate() {
            g transform=(format!("translate({} 0)", px(direction as f64 * cell))) {
                (text("label", [104.0, 14.0], &format!("along {}", NAMES[direction])))
                @for (value, name) in across.ticks() {
                    (line("grid", [across.at(value), 22.0], [across.at(value), bottom]))
                    (text("tick middle", [across.at(value), bottom + 14.0], &name))
                }
                (line("axis", [104.0, 22.0], [104.0, bottom]))
                (text("name middle", [180.0, bottom + 30.0], "displacement of F, um"))
                @for (n, rank) in ranks.iter().take(SHOWN).enumerate() {
                    @let y = 26.0 + (n as f64 + 0.5) * ROW;
                    (text("end", [98.0, y + 4.0], &name(rank)))
                    g class=(if rank.iso.is_empty() { "c-pivot" } else { "c-coupling" }) {
                        (rectangle("bar", [104.0, y - 5.5], [across.at(rank.effect_um.abs()), y + 5.5]))
                    }
                    (text("tick", [across.at(rank.effect_um.abs()) + 5.0, y + 4.0], &short(rank.effect_um)))
                }
            }
        }
    };
    drawing([960.0, bottom + 36.0], "The strongest errors along X, Y and Z", content)
}

/// A name of the paper with its Greek letters.
pub(super) fn greek(name: &str) -> String {
    name.replace("epsilon_", "\u{3b5}").replace("delta_", "\u{3b4}")
}

/// The name of ISO 230-1; of a static error that of machine files, of a mount with Greek letters.
fn name(rank: &Rank) -> String {
    match rank.iso.as_str() {
        "" => greek(&rank.source),
        iso => iso.into(),
    }
}

fn three(pointer: &str, values: [f64; 3]) -> Markup {
    html! { @for (i, value) in values.into_iter().enumerate() { td { (figure(format!("{pointer}/{i}"), value)) } } }
}

fn kinematic(s: &Sensitivity) -> Markup {
    html! {
        (caption("table", "Displacement of F, um: at home in first order; of the error alone (table 6); together with the \
            static errors of this machine (table 5)."))
        div.wide { table.dense {
            thead {
                tr {
                    th rowspan="2" { "Error" } th.left rowspan="2" { "paper" }
                    th colspan="3" { "first order, home" } th colspan="3" { "alone" } th colspan="3" { "with static errors" }
                }
                tr { @for _ in 0..3 { @for direction in NAMES { th { (direction) } } } }
            }
            tbody {
                @for (n, row) in s.kinematic.iter().enumerate() {
                    tr {
                        th { (row.iso) }
                        td.left { (greek(&row.source)) }
                        (three(&format!("/sensitivity/kinematic/{n}/E_first_order"), row.first_order_um))
                        (three(&format!("/sensitivity/kinematic/{n}/E_no_static"), row.no_static_um))
                        (three(&format!("/sensitivity/kinematic/{n}/E_with_static"), row.with_static_um))
                    }
                }
            }
        } }
    }
}

fn statics(s: &Sensitivity) -> Markup {
    html! {
        (caption("table", "Displacement of F, um: at home; with all six stages displaced by their unit; change when X, Y and \
            Z are displaced."))
        div.wide { table.dense {
            thead {
                tr {
                    th rowspan="2" { "Error" } th.left rowspan="2" { "of" } th.left rowspan="2" { "about" }
                    th colspan="3" { "at home" } th colspan="3" { "all displaced" } th colspan="3" { "change by X, Y, Z" }
                }
                tr { @for _ in 0..3 { @for direction in NAMES { th { (direction) } } } }
            }
            tbody {
                @for (n, row) in s.statics.iter().enumerate() {
                    tr {
                        th { (greek(&row.source)) }
                        td.left { (row.joint) }
                        td.left { (row.about) }
                        (three(&format!("/sensitivity/static/{n}/E_at_home"), row.at_home_um))
                        (three(&format!("/sensitivity/static/{n}/E_at_unit_pose"), row.at_unit_pose_um))
                        (three(&format!("/sensitivity/static/{n}/dE_linear_motion"), row.linear_motion_um))
                    }
                }
            }
        } }
    }
}
