//! The command-line tool `host-sim`.
#![forbid(unsafe_code)]

fn main() -> std::process::ExitCode {
    host_sim::cli::main()
}
