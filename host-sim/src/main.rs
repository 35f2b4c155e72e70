//! The stage controller on the desktop.
fn main() {}
