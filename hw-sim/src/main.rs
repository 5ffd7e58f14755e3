//! The simulated cell as a program of its own.

use std::process::ExitCode;

fn main() -> ExitCode {
    hw_sim::cli::main_from(std::env::args_os().skip(1), "hw-sim")
}
