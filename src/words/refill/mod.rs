//! The half of the controller that lives in the refill interrupt: orders in, words and reports out.

pub mod border;
pub mod generator;
pub mod safety;
pub mod stream;
