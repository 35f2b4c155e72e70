//! The section that sets the numbers of the paper beside ours.

use super::number::long_figure;
use super::page::Section;
use crate::model::{Claim, Verdict};
use maud::html;

pub(super) fn section(claims: &[Claim]) -> Section {
    let count = |verdict| claims.iter().filter(|claim| claim.verdict == verdict).count();
    let class = |verdict| match verdict {
        Verdict::Reproduced => "yes",
        Verdict::Approximately => "partly",
        Verdict::NotReproduced => "no",
        Verdict::Input => "given",
    };
    let body = html! {
        p.lead {
            "Of " (claims.len()) " statements of the paper " strong { (count(Verdict::Reproduced)) " are reproduced" } ", "
            (count(Verdict::Approximately)) " approximately, " (count(Verdict::NotReproduced)) " are not; taken as input: "
            (count(Verdict::Input)) "."
        }
        p.note {
            "Computed from the inputs that the paper prints, on its own stage (built in as \u{201c}paper\u{201d}), whatever \
            machine this page is about. Reproduced: the number rounds to the printed digits."
        }
        div.wide { table {
            thead { tr { th { "The paper says" } th { "printed" } th { "computed" } th.left { "unit" } th.left { "verdict" } th.left { "how, or why not" } } }
            tbody {
                @for (n, claim) in claims.iter().enumerate() {
                    tr {
                        td.left { (claim.quoted) }
                        td { @if let Some(v) = claim.printed { span data-figure=(format!("/paper/{n}/printed")) { (v) } } @else { "\u{2013}" } }
                        td { @if let Some(v) = claim.ours { (long_figure(format!("/paper/{n}/ours"), v)) } @else { "\u{2013}" } }
                        td.left { (claim.unit) }
                        td.left { span class=(class(claim.verdict)) { (claim.verdict.words()) } }
                        td.left { (claim.why) }
                    }
                }
            }
        } }
    };
    Section { id: "paper", title: "The numbers of the paper", body }
}
