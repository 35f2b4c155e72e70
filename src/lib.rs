//! Stage controller: the way of the data from commands to step words.
#![no_std]
#![forbid(unsafe_code)]

pub mod compensation;
pub mod controller;
pub mod error;
pub mod motion;
pub mod scpi;
pub mod settings;
pub mod stepgen;
pub mod units;
