//! `bladescan camera`: the camera's side, without a run.

mod bridge;

use super::{Exit, Failure};
use clap::Subcommand;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Serve A3DP/1 on the vision PC, beside the vendor's software.
    #[command(after_help = "Example:\n  bladescan camera bridge config/bridges/a5000.toml")]
    Bridge(bridge::Args),
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    match &args.what {
        What::Bridge(args) => bridge::main(args),
    }
}
