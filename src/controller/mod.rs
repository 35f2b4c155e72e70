//! The controller in two halves: the front (thread) and the generator (refill interrupt).

pub mod border;
pub mod front;
pub mod generator;
