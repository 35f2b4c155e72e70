//! Small drawings in SVG: axes, curves, text. Colours come from the page's style by class, so that the same drawing
//! serves light, dark and paper.

mod scale;

pub use scale::Scale;

use maud::{Markup, html};

/// A coordinate in a drawing, to a hundredth of a unit: the same bytes on every machine.
pub fn px(v: f64) -> String {
    let text = format!("{v:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// A drawing of a given size; `title` is what a screen reader says.
pub fn drawing(size: [f64; 2], title: &str, content: Markup) -> Markup {
    html! {
        svg viewBox=(format!("0 0 {} {}", px(size[0]), px(size[1]))) role="img" aria-label=(title) {
            title { (title) }
            (content)
        }
    }
}

/// A straight line.
pub fn line(class: &str, from: [f64; 2], to: [f64; 2]) -> Markup {
    html! { line class=(class) x1=(px(from[0])) y1=(px(from[1])) x2=(px(to[0])) y2=(px(to[1])) {} }
}

/// Text; `class` says where it is anchored and how it looks.
pub fn text(class: &str, at: [f64; 2], content: &str) -> Markup {
    html! { text class=(class) x=(px(at[0])) y=(px(at[1])) { (content) } }
}

/// A curve through points of the drawing.
pub fn curve(class: &str, points: impl IntoIterator<Item = [f64; 2]>) -> Markup {
    let mut path = String::new();
    for [x, y] in points {
        path.push_str(if path.is_empty() { "M" } else { "L" });
        path.push_str(&format!("{} {}", px(x), px(y)));
    }
    html! { path class=(class) d=(path) {} }
}

/// A filled rectangle between two corners.
pub fn rectangle(class: &str, from: [f64; 2], to: [f64; 2]) -> Markup {
    let (x, y) = (from[0].min(to[0]), from[1].min(to[1]));
    let (width, height) = ((to[0] - from[0]).abs(), (to[1] - from[1]).abs());
    html! { rect class=(class) x=(px(x)) y=(px(y)) width=(px(width)) height=(px(height)) {} }
}

/// A filled circle.
pub fn dot(class: &str, at: [f64; 2], radius: f64) -> Markup {
    html! { circle class=(class) cx=(px(at[0])) cy=(px(at[1])) r=(px(radius)) {} }
}

/// A plot's frame: grid lines, ticks and the names of both axes.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Left and right end.
    pub x: [f64; 2],
    /// Lower and upper end; the lower one is the larger number.
    pub y: [f64; 2],
}

impl Frame {
    /// Grid and ticks of both scales, with the names of the axes below and above.
    pub fn draw(&self, across: &Scale, up: &Scale, x_name: &str, y_name: &str) -> Markup {
        let [left, right] = self.x;
        let [bottom, top] = self.y;
        html! {
            @for (value, name) in up.ticks() {
                (line("grid", [left, up.at(value)], [right, up.at(value)]))
                (text("tick end", [left - 5.0, up.at(value) + 3.5], &name))
            }
            @for (value, name) in across.ticks() {
                (line("mark", [across.at(value), bottom], [across.at(value), bottom + 4.0]))
                (text("tick middle", [across.at(value), bottom + 15.0], &name))
            }
            (line("axis", [left, bottom], [right, bottom]))
            (text("name middle", [(left + right) / 2.0, bottom + 30.0], x_name))
            @if !y_name.is_empty() { (text("name end", [left - 5.0, top - 8.0], y_name)) }
        }
    }
}
