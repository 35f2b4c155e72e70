//! The page.

use super::Experiment;

/// The page as HTML.
pub fn render(_experiment: &Experiment) -> String {
    String::new()
}
