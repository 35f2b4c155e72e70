//! From a logical pose to motor targets: the law, its parts, and its inverse.
pub mod calibration;
