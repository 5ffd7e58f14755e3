//! `bladescan camera conformance`.

use super::super::{Exit, Failure, print};
use super::{Place, run_id};
use crate::camera::conformance::{Permission, Told, Verdict, clauses, counts, run};
use crate::camera::lines::Lines;
use crate::run::camera_lines;
use serde_json::json;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: Place,
    /// Let the camera flash: without it the clauses about triggers and frames are skipped.
    #[arg(long)]
    allow_exposures: bool,
    /// Only clauses whose names begin so; may be repeated.
    #[arg(long, value_name = "START")]
    only: Vec<String>,
    /// List the clauses as a table in Markdown and end.
    #[arg(long)]
    list: bool,
}

pub(super) fn main(args: &Args, json: bool) -> Result<Exit, Failure> {
    if args.list {
        for clause in clauses() {
            print(&format!("| `{}` | {} | {} |", clause.id, clause.says, clause.does))?;
        }
        return Ok(Exit::Done);
    }
    if let Some(start) = args
        .only
        .iter()
        .find(|start| !clauses().iter().any(|clause| clause.id.starts_with(start.as_str())))
    {
        return Err(Failure::Usage(format!(
            "no clause begins with {start:?}; --list shows them"
        )));
    }
    let address = args.place.resolve()?;
    let mut lines = Lines::new(camera_lines(address));
    let permission = Permission {
        exposures: args.allow_exposures,
        first_run: run_id(),
    };
    let mut unprinted = None;
    let tell = |told: &Told| {
        if !json && let Err(failure) = print(&in_words(told)) {
            unprinted = Some(failure);
        }
    };
    let report = run(&mut lines, permission, &args.only, tell).map_err(|error| Failure::Broken(error.to_string()))?;
    if let Some(failure) = unprinted {
        return Err(failure);
    }
    let [passed, failed, skipped] = counts(&report);
    if json {
        let document = json!({ "passed": passed, "failed": failed, "skipped": skipped, "clauses": report });
        print(&document.to_string())?;
    } else {
        let hint = match args.allow_exposures {
            true => "",
            false => "; with --allow-exposures the camera may flash and more is tried",
        };
        print(&format!("{passed} passed, {failed} FAILED, {skipped} skipped{hint}"))?;
    }
    Ok(if failed == 0 { Exit::Done } else { Exit::Fault })
}

/// One line where all is well; else what the page says, what was done and what was seen.
fn in_words(told: &Told) -> String {
    let line = |word: &str| format!("{word:<7} {:<26} {:6.2} s  {}", told.id, told.seconds, told.says);
    match &told.verdict {
        Verdict::Passed => line("passed"),
        Verdict::Failed { reason } => format!(
            "{}\n        done: {}\n        seen: {reason}",
            line("FAILED"),
            told.does
        ),
        Verdict::Skipped { reason } => format!("{}\n        {reason}", line("skipped")),
    }
}
