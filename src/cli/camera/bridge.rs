//! `bladescan camera bridge`: A3DP/1 on one side, the vendor's software on the other.

use crate::camera::bridge::BridgeConfig;
use crate::cli::live_run::runtime;
use crate::cli::{Exit, Failure};
use crate::run::{BridgeReport, serve_bridge};
use std::io::Write as _;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The bridge's file: see config/bridges and docs/protocols/bridge.md.
    config: PathBuf,
}

pub(super) fn main(args: &Args, json: bool) -> Result<Exit, Failure> {
    let text = std::fs::read_to_string(&args.config).map_err(|source| Failure::Read {
        path: args.config.clone(),
        source,
    })?;
    let mut config =
        BridgeConfig::parse(&text).map_err(|error| Failure::Usage(format!("{}: {error}", args.config.display())))?;
    // The vendor's side may name whole paths.
    config.vendor.frames = std::path::absolute(&config.vendor.frames)
        .map_err(|error| Failure::Usage(format!("[vendor] frames: {error}")))?;
    let report = |report: BridgeReport| match report {
        BridgeReport::VendorListening(address) if json => {
            writeln!(std::io::stdout(), "{}", serde_json::json!({ "vendor": address })).ok();
        }
        BridgeReport::VendorListening(address) => {
            writeln!(std::io::stdout(), "waiting for the vendor's side on {address}").ok();
        }
        BridgeReport::Listening(address) if json => {
            writeln!(std::io::stdout(), "{}", serde_json::json!({ "a3dp": address })).ok();
        }
        BridgeReport::Listening(address) => {
            writeln!(std::io::stdout(), "serving A3DP/1 on {address}; Ctrl-C ends it").ok();
        }
        BridgeReport::Note(text) => {
            writeln!(std::io::stderr(), "{text}").ok();
        }
    };
    let stop = async {
        // Without a handler Ctrl-C ends the process, and with it the vendor's side.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    runtime()?
        .block_on(serve_bridge(config, boot_id(), report, stop))
        .map_err(|error| Failure::Broken(error.to_string()))?;
    Ok(Exit::Done)
}

/// New at each start.
fn boot_id() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
