//! Motion: jerk-limited profiles of one path parameter, in integers.
//!
//! [`plan`] turns a state and a goal into a [`Profile`]; [`profile`] evaluates it once per
//! segment. Time is counted in whole segments, so nothing is ever rounded in time.

mod path;
pub mod plan;
pub mod profile;
pub mod ramp;
pub mod roots;
mod search;
mod sloped;

#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;

pub use plan::{to_position, to_velocity};
pub use profile::{Profile, State};
pub use ramp::{Limits, Unplannable};
