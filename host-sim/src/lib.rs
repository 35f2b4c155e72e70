//! The stage controller on the desktop: the stage's exact model, its calibration and its physical twin.
#![forbid(unsafe_code)]

pub mod alignment;
pub mod bench_twin;
pub mod board;
pub mod calibrate;
pub mod cli;
pub mod console;
pub mod control;
pub mod experiment;
pub mod flash;
pub mod gpib;
pub mod hislip;
pub mod identify;
pub mod light;
pub mod machine;
pub mod manual;
pub mod measure;
pub mod model;
pub mod optics;
pub mod power_meter;
pub mod report;
pub mod rig;
pub mod server;
pub mod session;
pub mod twin;
