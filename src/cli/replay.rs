//! `bladescan replay`.

use super::{Exit, Failure, print};
use crate::journal::Recording;
use crate::run::{Pool, replay};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The recording of a run.
    recording: PathBuf,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let bytes = std::fs::read(&args.recording).map_err(|source| Failure::Read {
        path: args.recording.clone(),
        source,
    })?;
    let unreadable = |error: String| Failure::Usage(format!("{}: {error}", args.recording.display()));
    let recording = Recording::open(&bytes).map_err(|error| unreadable(error.to_string()))?;
    let pool = Pool::new().map_err(|error| Failure::Broken(format!("cannot start threads: {error}")))?;
    let report = replay(&recording, &pool).map_err(|error| unreadable(error.to_string()))?;
    if args.json {
        let text = serde_json::to_string(&report).expect("a report always has a JSON text");
        print(&text)?;
    } else {
        if report.recorded_by != report.replayed_by {
            print(&format!(
                "recorded by version {}, replayed by {}",
                report.recorded_by, report.replayed_by
            ))?;
        }
        print(&format!(
            "{} inputs fed, {} jobs run again on {} threads, {} outputs compared",
            report.input_count,
            report.job_count,
            pool.thread_count(),
            report.output_count
        ))?;
        match &report.difference {
            None if report.complete => print("bit-identical")?,
            None => print("bit-identical as far as the recording goes; it lacks the end of its run")?,
            Some(difference) => print(&format!(
                "DIFFERS at {:.6} s on {} after {} inputs\n  recorded: {}\n  replayed: {}",
                difference.at_s,
                difference.topic,
                difference.after_input_count,
                difference.recorded,
                difference.replayed
            ))
            .and_then(|()| {
                print("the inputs before it, the latest last:")?;
                difference
                    .inputs_before
                    .iter()
                    .try_for_each(|input| print(&format!("  {input}")))
            })?,
        }
    }
    Ok(if report.identical { Exit::Done } else { Exit::Differs })
}
