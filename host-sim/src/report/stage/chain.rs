//! Drawing of the chain: base, chip, six stages, fibre array, with what each carries of offsets and static errors.

use super::{AxisFacts, StageFacts};
use crate::report::number::short;
use crate::report::plot::{curve, drawing, line, px, rectangle, text};
use maud::{Markup, html};

const BOX: [f64; 2] = [92.0, 66.0];
const PITCH: f64 = 123.4;
/// Upper edge of the row of stages.
const TOP: f64 = 96.0;

/// The chain from left to right.
pub(super) fn draw(stage: &StageFacts) -> Markup {
    let left = |n: usize| 2.0 + n as f64 * PITCH;
    let rotary: Vec<bool> = stage.axes.iter().map(|axis| axis.unit == "deg").collect();
    let content = html! {
        // the chip stands on the base
        (line("link", [left(0) + BOX[0] / 2.0, TOP], [left(0) + BOX[0] / 2.0, 58.0]))
        (rectangle("box", [left(0), 8.0], [left(0) + BOX[0], 58.0]))
        (text("label middle", [left(0) + BOX[0] / 2.0, 30.0], "chip"))
        (text("small middle", [left(0) + BOX[0] / 2.0, 47.0], "body 1"))
        @for n in 0..7 {
            (line("link", [left(n) + BOX[0], TOP + BOX[1] / 2.0], [left(n + 1), TOP + BOX[1] / 2.0]))
        }
        (body(left(0), "box", "base", "body 0", html! {}))
        @for (n, axis) in stage.axes.iter().enumerate() {
            @let turned = stage.turned_axes.contains(&axis.name);
            @let class = match (rotary[n], turned) { (true, _) => "box rotary", (_, true) => "box linear turned", _ => "box linear" };
            (body(left(n + 1), class, axis.name, &format!("body {}", n + 2), symbol(axis, left(n + 1) + BOX[0] - 22.0)))
            (below(stage, axis, turned, left(n + 1) + BOX[0] / 2.0))
        }
        (body(left(7), "box", "fibre array", "body 8", html! {}))
        (mount("end", "F at", stage.fibre_point_um, left(7) + BOX[0]))
        (text("small", [left(1), 30.0], "Each stage stands on the one to its left. Arrow: direction of a linear stage; \
            circle with arrow: axis of a rotary one."))
        (text("small", [left(1), 47.0], "Below: shift of its frame against the one before (um) and static errors (urad)."))
    };
    drawing([960.0, TOP + BOX[1] + 96.0], "The chain of stages from the base to the fibre array", content)
}

fn body(left: f64, class: &str, name: &str, number: &str, symbol: Markup) -> Markup {
    html! {
        (rectangle(class, [left, TOP], [left + BOX[0], TOP + BOX[1]]))
        (text("label", [left + 9.0, TOP + 20.0], name))
        (text("small", [left + 9.0, TOP + 55.0], number))
        (symbol)
    }
}

/// Arrow along x (right), y (up) or z (towards the reader), or a circle with an arrow and the letter of the axis.
fn symbol(axis: &AxisFacts, x: f64) -> Markup {
    let y = TOP + BOX[1] / 2.0 + 10.0;
    let (dx, dy) = match axis.name {
        "X" => (12.0, 0.0),
        "Y" => (0.0, -12.0),
        _ => (-9.0, 9.0),
    };
    let head = |sign: f64| {
        let (tx, ty) = (x + sign * dx, y + sign * dy);
        let length = f64::hypot(dx, dy);
        let (ux, uy) = (sign * dx / length, sign * dy / length);
        let corner = |side: f64| [tx - 6.0 * ux + side * 3.5 * uy, ty - 6.0 * uy - side * 3.5 * ux];
        curve("link", [corner(1.0), [tx, ty], corner(-1.0)])
    };
    let letter = match axis.name {
        "alpha" => "x",
        "beta" => "y",
        _ => "z",
    };
    html! {
        @if axis.unit == "deg" {
            path class="link" d=(format!("M{} {}A12 12 0 1 1 {} {}", px(x + 11.0), px(y + 5.0), px(x + 11.5), px(y - 3.5))) {}
            (curve("link", [[x + 4.5, y - 4.0], [x + 11.5, y - 3.5], [x + 12.5, y - 10.5]]))
            (text("middle", [x, y + 4.0], letter))
        } @else {
            (line("link", [x - dx, y - dy], [x + dx, y + dy]))
            (head(1.0)) (head(-1.0))
        }
    }
}

/// Offset and static errors of a stage.
fn below(stage: &StageFacts, axis: &AxisFacts, turned: bool, middle: f64) -> Markup {
    let shifted = axis.offset_um != [0.0; 3];
    let errors: Vec<_> = stage.static_errors.iter().filter(|row| row.joint == axis.name).collect();
    html! {
        @if shifted { (mount("middle", "shifted", axis.offset_um, middle)) }
        @for (n, row) in errors.iter().enumerate() {
            @let y = TOP + BOX[1] + 18.0 + 15.0 * (n + 2 * usize::from(shifted)) as f64;
            (text("small middle", [middle, y], &format!("{} {}", row.name, short(stage.static_error(row.name)))))
        }
        @if turned {
            (text("small alarm middle", [middle, TOP - 8.0], "turned by a rotary stage"))
        }
    }
}

/// A vector below the chain, with the word that says what it is; to 0.1 um, as neighbours leave room.
fn mount(anchor: &str, word: &str, um: [f64; 3], at: f64) -> Markup {
    let [x, y, z] = um.map(|v| short((v * 10.0).round() / 10.0));
    html! {
        (text(&format!("small {anchor}"), [at, TOP + BOX[1] + 18.0], word))
        (text(&format!("small {anchor}"), [at, TOP + BOX[1] + 33.0], &format!("({x}, {y}, {z})")))
    }
}
