//! From commands to tracks: which path, how fast, within whose share of the motors' limits.
//!
//! ```text
//! desire, goal -> planner -> limits: soft limits and travel
//!                         -> bounds: how steep the law is along the path
//!                         -> budget: share of the motors' limits
//!                         -> plan: jerk-limited profile of the path parameter -> track
//! ```
//! Time is counted in whole segments, so nothing is ever rounded in time.

pub mod bounds;
pub mod budget;
pub mod limits;
mod path;
pub mod plan;
pub mod planner;
pub mod profile;
pub mod ramp;
mod search;
mod sloped;
pub mod track;

#[cfg(test)]
mod reference;
#[cfg(test)]
mod tests;
