//! Watching a board: every segment that it plays is checked.

pub mod checker;
pub mod rates;
pub mod script;
pub mod stage;
