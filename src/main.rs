//! The `bladescan` program.

fn main() -> std::process::ExitCode {
    bladescan::cli::main()
}
