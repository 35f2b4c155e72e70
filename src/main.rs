//! Firmware entry; on the host it prints the command tree as JSON.
fn main() {}
