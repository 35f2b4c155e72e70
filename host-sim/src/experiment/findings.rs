//! What follows from the figures, in sentences that are computed from them.

use super::Experiment;
use serde::Serialize;

/// A sentence.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What it says.
    pub text: String,
}

/// All of them.
pub(super) fn findings(_experiment: &Experiment) -> Vec<Finding> {
    Vec::new()
}
