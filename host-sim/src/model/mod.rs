//! The stage's exact geometry in f64: the reference for every fixed-point result.

mod chain;
mod rotation;

pub(crate) use chain::static_vector;
pub use chain::{Chain, Screw};
pub use rotation::{Euler, exp, vee};
