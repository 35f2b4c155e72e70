//! The controller in two halves: the front (thread) and the generator (refill interrupt).

pub mod commands;
pub mod front;
pub mod links;
