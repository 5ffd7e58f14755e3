//! `bladescan recover`.

use super::{Exit, Failure, print};
use crate::run::{Recovered, recover};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The recording of a killed run.
    recording: PathBuf,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let Recovered {
        was_whole,
        record_count,
        bytes_before,
        bytes_after,
    } = recover(&args.recording).map_err(|error| Failure::Usage(format!("{}: {error}", args.recording.display())))?;
    if args.json {
        let text = serde_json::json!({
            "was_whole": was_whole,
            "records": record_count,
            "bytes_before": bytes_before,
            "bytes_after": bytes_after,
        });
        print(&text.to_string())?;
    } else if was_whole {
        print("the recording is whole: nothing to recover")?;
    } else {
        print(&format!(
            "recovered {record_count} records; {bytes_before} bytes became {bytes_after}, packed and indexed. \
             `bladescan resume` goes on with the run."
        ))?;
    }
    Ok(Exit::Done)
}
