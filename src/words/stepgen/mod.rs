//! From motor positions to the words that a timer writes to the port, one per tick.
//!
//! `pins` names the lines, `timing` what the drivers ask for, `crossing` says when a motor passes
//! a whole step, `segment` puts the edges into words, `played` reads them back after an abort.

mod crossing;
pub mod pins;
pub mod played;
mod rest;
pub mod segment;
pub mod timing;

#[cfg(test)]
mod tests;
