//! The controller in two halves: the front (thread) and the generator (refill interrupt).

pub mod border;
pub mod commands;
pub mod front;
pub mod generator;
pub mod links;
pub mod safety;
pub mod stream;
