//! `bladescan resume`: a run that was held, aborted, stopped by a fault or killed goes on.

use super::cell::{cell_options, in_cell};
use super::live_run::{Carried, exit, links_of, runtime};
use super::{Exit, Failure, print};
use crate::controller::{Controller, Input, ViewOutcome};
use crate::event::Ending;
use crate::journal::Recording;
use crate::run::{
    Beginning, Console, JournalFile, Links, Pool, Rebuilt, Recorded, RecordingFile, ReplayError, put_aside, rebuild,
    settle,
};
use crate::settings::Station;
use crate::stamp::Stamp;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The run's folder.
    dir: PathBuf,
    /// Allow real motion. Without it a real cell is not even connected.
    #[arg(long)]
    arm: bool,
    /// Say what is done and what is left, and touch nothing.
    #[arg(long)]
    show: bool,
    /// Fault to inject into the simulated cell; may be repeated, `bladescan sim faults` lists them.
    #[arg(long = "fault", value_name = "SPEC")]
    faults: Vec<String>,
    /// Print summary.json, or with --show what is left, to standard output.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let path = args.dir.join("run.mcap");
    let mut file = RecordingFile::open(&path)
        .map_err(|error| Failure::Usage(format!("{} is no folder of a run: {error}", args.dir.display())))?;
    let bytes = file.read().map_err(|error| Failure::Usage(error.to_string()))?;
    let recording = Recording::open(&bytes).map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))?;
    let Recorded { recipe, station, .. } = Recorded::read(&recording).map_err(|error| match error {
        ReplayError::Settings(error) => Failure::Settings(error),
        error => Failure::Usage(format!("{}: {error}", path.display())),
    })?;
    let place = Place::of(&recording, &station, args)?;
    let pool = Pool::new().map_err(|error| Failure::Broken(format!("cannot start threads: {error}")))?;
    let mut console = Console::new();
    console.say("Going through the recording of the run so far.");
    let rebuilt = rebuild(&recording, &pool, &mut |output| console.show_past(output)).map_err(|error| match error {
        ReplayError::Differs(_) => Failure::Differs(format!(
            "{error}\nThis program cannot go on with the run. `bladescan reconstruct --from` registers its views anew."
        )),
        error => Failure::Usage(format!("{}: {error}", path.display())),
    })?;
    let standing = Standing::of(&rebuilt.controller);
    match (args.show, args.json) {
        (true, true) => print(&standing.json().to_string())?,
        (true, false) => print(&standing.words())?,
        (false, _) => console.say(&standing.words()),
    }
    if args.show {
        return Ok(Exit::Done);
    }
    if standing.is_finished {
        // The lock on the recording goes with it.
        drop(file);
        return finish(&args.dir, &rebuilt, args.json);
    }
    let beginning = Beginning {
        input: Input::Restarted {
            version: env!("CARGO_PKG_VERSION").into(),
        },
        at: now(recording.start_unix_ns(), rebuilt.last),
        done: rebuilt.done,
    };
    let header = recording.header().clone();
    let start_unix_ns = recording.start_unix_ns();
    let go_on = async |links: Links| {
        let unwritten = &rebuilt.unwritten;
        let broken = |error: &dyn std::fmt::Display| Failure::Broken(error.to_string());
        let journal = JournalFile::resume(file, &recording, unwritten).map_err(|error| broken(&error))?;
        put_aside(&args.dir).map_err(|error| broken(&error))?;
        let carried = Carried {
            controller: rebuilt.controller,
            journal,
            start_unix_ns,
            beginning,
            pool: &pool,
            console: &mut console,
            json: args.json,
        };
        carried.carry_out(links, &args.dir).await
    };
    runtime()?.block_on(async {
        match place {
            Place::At(links) => go_on(links).await,
            Place::Simulated => {
                let simulation = header
                    .simulation
                    .as_ref()
                    .expect("a simulated place comes from its header");
                let options = cell_options(simulation, header.seed, &recipe, &station, &args.dir, &args.faults);
                in_cell(&options, station.robot.protocol, go_on).await
            }
        }
    })
}

/// Where the run goes on.
enum Place {
    /// In a simulated cell that is started for it.
    Simulated,
    At(Links),
}

impl Place {
    fn of(recording: &Recording<'_>, station: &Station, args: &Args) -> Result<Self, Failure> {
        let links = links_of(station)?;
        let Some(links) = links else {
            return match recording.header().simulation {
                Some(_) => Ok(Self::Simulated),
                None => Err(Failure::Usage(
                    "the recording does not say what its simulated cell was: it was made by an older version".into(),
                )),
            };
        };
        if !args.faults.is_empty() {
            return Err(Failure::Usage("--fault is for the simulated cell of a dry run".into()));
        }
        if !args.arm && !args.show {
            return Err(Failure::Usage(
                "a run that goes on moves the robot: clear the cell, then give --arm (nothing was connected)".into(),
            ));
        }
        Ok(Self::At(links))
    }
}

/// What is done of a run, and what is left.
struct Standing {
    ending: String,
    is_finished: bool,
    planned_count: usize,
    merged_count: usize,
    discarded_count: usize,
    left: Vec<usize>,
}

impl Standing {
    fn of(controller: &Controller) -> Self {
        let count = |is_counted: fn(&ViewOutcome) -> bool| {
            let views = controller.views().iter();
            views.filter(|view| is_counted(&view.outcome)).count()
        };
        let ending = match controller.ending() {
            Some(Ending::Finished) => "finished".to_owned(),
            Some(Ending::Aborted) => "ended by the operator".to_owned(),
            Some(Ending::Faulted { fault }) => format!("stopped by {fault}"),
            // Nobody else has the recording, so nobody will write its end.
            None => "cut off: the program was killed".to_owned(),
        };
        let left = controller.left();
        Self {
            ending,
            is_finished: left.is_empty() && controller.is_over(),
            planned_count: controller.views().len(),
            merged_count: count(|outcome| matches!(outcome, ViewOutcome::Merged { .. })),
            discarded_count: count(|outcome| matches!(outcome, ViewOutcome::Discarded { .. })),
            left,
        }
    }

    fn words(&self) -> String {
        let left = match self.left.len() {
            0 => "nothing is left to take".to_owned(),
            count => format!("{count} left to take: {}", ranges(&self.left)),
        };
        format!(
            "The run: {}. Of {} views {} are merged, {} discarded; {left}.",
            self.ending, self.planned_count, self.merged_count, self.discarded_count
        )
    }

    fn json(&self) -> serde_json::Value {
        json!({
            "ending": self.ending,
            "planned": self.planned_count,
            "merged": self.merged_count,
            "discarded": self.discarded_count,
            "left": self.left,
        })
    }
}

/// All views were taken: whatever of the run's files was not written is written now.
fn finish(dir: &Path, rebuilt: &Rebuilt, json: bool) -> Result<Exit, Failure> {
    let broken = |error: &dyn std::fmt::Display| Failure::Broken(error.to_string());
    let controller = &rebuilt.controller;
    settle(dir, &rebuilt.files).map_err(|error| broken(&error))?;
    crate::run::recover(&dir.join("run.mcap")).map_err(|error| broken(&error))?;
    if json && let Some(summary) = rebuilt.files.get("summary.json") {
        print(String::from_utf8_lossy(summary).trim_end())?;
    }
    let standing = Standing::of(controller);
    let ending = controller.ending().unwrap_or(&Ending::Finished);
    Ok(exit(ending, standing.merged_count, controller.merged_min_count()))
}

/// The run's time now: the clock goes on while nobody looks, and never back.
fn now(start_unix_ns: u64, last: Stamp) -> Stamp {
    let unix_ns = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos() as u64);
    Stamp {
        ns: unix_ns.saturating_sub(start_unix_ns).max(last.ns + 1),
    }
}

/// Numbers in ascending order, for example `3, 7 to 12`.
fn ranges(numbers: &[usize]) -> String {
    let mut parts: Vec<(usize, usize)> = Vec::new();
    for &number in numbers {
        match parts.last_mut() {
            Some((_, last)) if *last + 1 == number => *last = number,
            _ => parts.push((number, number)),
        }
    }
    let words = parts.iter().map(|(first, last)| match last - first {
        0 => first.to_string(),
        _ => format!("{first} to {last}"),
    });
    words.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_a_row_become_a_range() {
        assert_eq!(ranges(&[3, 7, 8, 9, 11]), "3, 7 to 9, 11");
        assert_eq!(ranges(&[]), "");
    }

    #[test]
    fn the_clock_of_a_run_never_goes_back() {
        let last = Stamp { ns: u64::MAX / 2 };
        assert_eq!(now(0, last).ns, last.ns + 1);
        assert!(now(0, Stamp::START).ns > 1_700_000_000_000_000_000);
    }
}
