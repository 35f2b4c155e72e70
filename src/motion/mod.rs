//! From commands to tracks: which path, how fast, within whose share of the motors' limits.

pub mod bounds;
pub mod budget;
pub mod limits;
pub mod plan;
pub mod planner;
pub mod profile;
pub mod ramp;
pub mod roots;
mod search;
pub mod track;
