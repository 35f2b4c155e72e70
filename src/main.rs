//! On the board: the firmware. On the host: prints the command tree as JSON, for whoever writes a driver.
#![cfg_attr(target_os = "none", no_std, no_main)]
#![deny(unsafe_code)]

#[cfg(target_os = "none")]
#[allow(unsafe_code)]
mod board;
#[cfg(target_os = "none")]
mod firmware;

#[cfg(not(target_os = "none"))]
mod tree_json;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    tree_json::main()
}
