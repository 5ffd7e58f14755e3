//! Measurements of bladescan that are too slow or too specific for its tests.

mod bench;
mod bound;
mod cases;
mod golden;
mod model;
mod pairs;
mod speed;

use clap::{Parser, Subcommand};

/// Measurements of bladescan.
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Registers every case folder under a root and compares with the truth.
    Pairs(pairs::PairsArguments),
    /// Prints the Cramer-Rao bound of every case folder under a root.
    Bound(bound::BoundArguments),
    /// Registers the views of a folder one after the other to the growing model.
    Model(model::ModelArguments),
    /// Checks client and simulated controller against golden HSES frames.
    Golden(golden::GoldenArguments),
    /// Prints one table of the registration's speed: kernels, full-sample MPE, one view by stage.
    Bench(bench::BenchArguments),
    /// Times the parts that have a budget, on generated data.
    Speed,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    match Arguments::parse().command {
        Command::Pairs(arguments) => pairs::run(&arguments),
        Command::Bound(arguments) => bound::run(&arguments),
        Command::Model(arguments) => model::run(&arguments),
        Command::Golden(arguments) => golden::run(&arguments),
        Command::Bench(arguments) => bench::run(&arguments),
        Command::Speed => speed::run(),
    }
}
