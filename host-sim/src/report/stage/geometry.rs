//! Drawing to scale of where the rotary axes pass and where the fibre point lies, at home.

use super::{AxisFacts, StageFacts};
use crate::report::number::short;
use crate::report::plot::{curve, dot, drawing, line, text};
use maud::{Markup, html};

const SIZE: [f64; 2] = [960.0, 330.0];
/// Room for the drawing itself: left, right, top, bottom.
const ROOM: [f64; 4] = [40.0, 600.0, 26.0, 300.0];
const CLASSES: [(&str, &str); 3] = [("alpha", "c-coupling"), ("beta", "c-backlash"), ("gamma", "c-pivot")];

/// Parallel projection: z to the right, y up, x towards the reader.
fn project([x, y, z]: [f64; 3]) -> [f64; 2] {
    [z - 0.5 * x, -y + 0.35 * x]
}

fn plus(a: [f64; 3], b: [f64; 3], times: f64) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i] * times)
}

/// The rotary axes, the levers, F.
pub(super) fn draw(stage: &StageFacts) -> Markup {
    let rotary: Vec<(&AxisFacts, [f64; 3])> =
        stage.axes.iter().filter_map(|axis| axis.point_mm.map(|point| (axis, point))).collect();
    let fibre = stage.fibre_home_mm;
    let reach = rotary.iter().map(|(_, point)| *point).chain([fibre]).flatten().map(f64::abs).fold(1e-2, f64::max);
    let half = 0.42 * reach;
    let ends: Vec<[[f64; 3]; 2]> =
        rotary.iter().map(|(axis, point)| [-half, half].map(|t| plus(*point, axis.direction, t))).collect();
    let all: Vec<[f64; 2]> = ends.iter().flatten().copied().chain([fibre, [0.0; 3]]).map(project).collect();
    let bound = |i: usize| {
        let values = all.iter().map(|p| p[i]);
        [values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max)]
    };
    let ([x0, x1], [y0, y1]) = (bound(0), bound(1));
    let [left, right, top, bottom] = ROOM;
    let scale = ((right - left) / (x1 - x0)).min((bottom - top) / (y1 - y0));
    let at = |p: [f64; 3]| {
        let [x, y] = project(p);
        [(left + right) / 2.0 + (x - (x0 + x1) / 2.0) * scale, (top + bottom) / 2.0 + (y - (y0 + y1) / 2.0) * scale]
    };
    let class = |name: &str| CLASSES.iter().find(|(known, _)| *known == name).map_or("", |(_, class)| class);
    let decade = 10f64.powf((0.5 * reach).log10().floor());
    let bar = [5.0, 2.0, 1.0].map(|m| m * decade).into_iter().find(|bar| *bar <= 0.5 * reach).unwrap_or(decade);
    let [fx, fy] = at(fibre);
    let content = html! {
        @for ((axis, point), [from, to]) in rotary.iter().zip(&ends) {
            g class=(class(axis.name)) {
                (curve("solid", [at(*from), at(*to)]))
                (curve("dash", [at(*point), at(fibre)]))
                (dot("bar", at(*point), 3.5))
            }
            (text("small middle", beyond(at(*from), at(*to)), axis.name))
        }
        g class="ink" { (dot("bar", [fx, fy], 5.0)) }
        (text("label", [fx + 9.0, fy + 16.0], "F"))
        // the directions and the scale
        (arrows([690.0, 290.0]))
        (line("link", [760.0, 300.0], [760.0 + bar * scale, 300.0]))
        (text("small", [760.0, 318.0], &format!("{bar} mm along y or z")))
        (key(&rotary, class))
    };
    drawing(SIZE, "Where the rotary axes pass and where the fibre point lies", content)
}

/// Where the name of a line stands: a little behind its end.
fn beyond([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> [f64; 2] {
    let length = f64::hypot(x1 - x0, y1 - y0).max(1.0);
    [x1 + 24.0 * (x1 - x0) / length, y1 + 14.0 * (y1 - y0) / length + 4.0]
}

/// mm to the micrometre.
fn um(mm: f64) -> String {
    let text = format!("{mm:.3}");
    if text == "-0.000" { "0.000".into() } else { text.replace('-', "\u{2212}") }
}

fn arrows(at: [f64; 2]) -> Markup {
    html! {
        @for (name, direction) in [("x", [30.0, 0.0, 0.0]), ("y", [0.0, 24.0, 0.0]), ("z", [0.0, 0.0, 24.0])] {
            @let [dx, dy] = project(direction);
            (line("link", at, [at[0] + dx, at[1] + dy]))
            (text("small middle", [at[0] + 1.35 * dx, at[1] + 1.35 * dy + 4.0], name))
        }
    }
}

/// Which colour is which axis, and its lever.
fn key(rotary: &[(&AxisFacts, [f64; 3])], class: impl Fn(&str) -> &'static str) -> Markup {
    html! {
        @for (n, (axis, [x, y, z])) in rotary.iter().enumerate() {
            @let y0 = 60.0 + n as f64 * 66.0;
            g class=(class(axis.name)) {
                (curve("solid", [[640.0, y0], [672.0, y0]]))
                (curve("dash", [[640.0, y0 + 18.0], [672.0, y0 + 18.0]]))
            }
            (text("label", [682.0, y0 + 4.0], &format!("axis of {}", axis.name)))
            (text("", [682.0, y0 + 22.0], &format!("lever to F: {} mm", short(axis.lever_mm.unwrap_or_default()))))
            (text("small", [682.0, y0 + 38.0], &format!("foot at ({}, {}, {}) mm", um(*x), um(*y), um(*z))))
        }
    }
}
