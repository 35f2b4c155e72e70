//! The page: head, style, table of contents, sections.

use super::{Report, budget, field, paper, provenance, sensitivity, stage, travel};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Style of all pages.
const STYLE: &str = include_str!("style.css");

/// A section of the page.
#[derive(Clone, Debug)]
pub struct Section {
    /// Anchor.
    pub id: &'static str,
    /// Heading.
    pub title: &'static str,
    /// Content.
    pub body: Markup,
}

/// The page as HTML.
pub fn render(report: &Report) -> String {
    let refusal = report.refusal.as_deref().unwrap_or("no calibration");
    let sections = [
        stage::section(&report.stage),
        sensitivity::section(&report.sensitivity),
        field::section(&report.field, report.refusal.as_deref()),
        travel::section(report.travel.as_ref().ok_or(refusal)),
        budget::section(report.budget.as_ref().ok_or(refusal)),
        paper::section(&report.paper),
        provenance::section(&report.provenance),
    ];
    let title = format!("Stage {}: errors and their compensation", report.provenance.machine);
    let sub = html! {
        (report.stage.order.join(" \u{2192} ")) " \u{2192} fibre array \u{b7} " (report.provenance.file)
        " \u{b7} block CRC " (report.provenance.crc())
        @if let Some(date) = &report.provenance.date { " \u{b7} " (date) }
    };
    framed(&title, &sub, &sections, "")
}

/// A page of sections with its list of contents, self-contained; `more_style` is added to the style of all pages.
pub fn framed(title: &str, sub: &Markup, sections: &[Section], more_style: &str) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(more_style)) }
            }
            body {
                header {
                    h1 { (title) }
                    p.sub { (sub) }
                    nav { ol { @for section in sections { li { a href=(format!("#{}", section.id)) { (section.title) } } } } }
                }
                main {
                    @for (n, section) in sections.iter().enumerate() {
                        section id=(section.id) {
                            h2 { (n + 1) ". " (section.title) }
                            (section.body)
                        }
                    }
                }
            }
        }
    };
    page.into_string()
}

/// A caption that stands before what it describes.
pub fn caption(class: &str, words: impl maud::Render) -> Markup {
    html! { p class=(format!("caption {class}")) { (words) } }
}

/// How a legend shows its colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Swatch {
    /// A piece of the curve.
    Curve,
    /// A piece of the bar.
    Bar,
}

/// What the colours of a drawing mean: class and name.
pub fn legend(swatch: Swatch, names: &[(String, &str)]) -> Markup {
    html! {
        p.legend {
            @for (class, name) in names {
                span class=(class) {
                    svg viewBox="0 0 26 10" aria-hidden="true" { @match swatch {
                            Swatch::Curve => path class="curve" d="M0 5L26 5" {},
                            Swatch::Bar => path class="bar" d="M0 1h26v8h-26z" {},
                        } }
                    (name)
                }
                " "
            }
        }
    }
}

/// A table that a reader may fold away; open at first, and so on paper.
pub fn folded(summary: &str, content: Markup) -> Markup {
    html! { details open { summary { (summary) } (content) } }
}
