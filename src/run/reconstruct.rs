//! Reconstruction of a recorded run under another recipe.

use super::pool::Pool;
use super::recorded::Recorded;
use super::recording_file::FileError;
use super::replay::ReplayError;
use super::run_dir::write_new;
use crate::controller::{Controller, Header, Input, Output, Outside, Reconstructed, Reconstruction, Source};
use crate::event::Event;
use crate::job::{FinishedJob, Job};
use crate::journal::{InputMemo, Record, Recording, Topic, read_input};
use crate::settings::Recipe;
use crate::stamp::Stamp;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;
use thiserror::Error;

/// Why a recording cannot be reconstructed.
#[derive(Debug, Error)]
pub enum ReconstructError {
    /// The recording.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The recipe is for another number of views.
    #[error("the recipe plans {planned} views, the recorded run {recorded}: a view has no place in the other plan")]
    Views {
        /// Views of the recipe.
        planned: usize,
        /// Views of the recipe in the recording.
        recorded: usize,
    },
    /// No frame has come in the recorded run.
    #[error("the recording has no frame")]
    NoFrame,
    /// This version does not find all frames of a recording of another version.
    #[error("the recording has {recorded} frames, of which this version finds {found}: use version {version}")]
    FramesLost {
        /// Frames that had come.
        recorded: usize,
        /// Frames that come now.
        found: usize,
        /// The version that recorded.
        version: String,
    },
}

/// Registers the frames of a recording anew. `header` names the result, as the recording's own does but for the recipe and
/// the version.
///
/// # Errors
/// The recording is not one, has no frame or another number of views than the recipe, or is of a version that heard more.
pub fn reconstruct(
    recording: &Recording<'_>,
    header: Header,
    source: Source,
    recipe: &Recipe,
    pool: &Pool,
    on_event: &mut dyn FnMut(&Event),
) -> Result<Reconstructed, ReconstructError> {
    let began = Instant::now();
    let recorded = Recorded::read(recording)?;
    if recipe.view_count() != recorded.recipe.view_count() {
        return Err(ReconstructError::Views {
            planned: recipe.view_count(),
            recorded: recorded.recipe.view_count(),
        });
    }
    let mut reconstruction = Reconstruction::new(header, source, recipe, &recorded.station, &recorded.plan);
    let mut now = || Stamp {
        ns: began.elapsed().as_nanos() as u64,
    };
    let mut outside = Outside {
        run: &mut |job: &Job| pool.run(job),
        now: &mut now,
        on_event,
    };
    let header = recording.header().clone();
    let controller = Controller::new(header, &recorded.recipe, &recorded.station, recorded.plan);
    let frames = feed(recording, controller, pool, &mut |output| {
        reconstruction.handle_output(output, &mut outside);
    })?;
    match (frames.found, frames.recorded) {
        (0, 0) => Err(ReconstructError::NoFrame),
        // The last frame of a killed run may have come without a word about it.
        (found, recorded) if found < recorded => Err(ReconstructError::FramesLost {
            recorded,
            found,
            version: recording.header().version.clone(),
        }),
        _ => Ok(reconstruction.finish(now())),
    }
}

/// How many frames had come when the run was recorded, and how many come now.
#[derive(Default)]
struct Frames {
    recorded: usize,
    found: usize,
}

/// Repeats the run without comparing anything, so that a recording of another version does as long as its frames come.
fn feed(
    recording: &Recording<'_>,
    mut controller: Controller,
    pool: &Pool,
    on_output: &mut dyn FnMut(&Output),
) -> Result<Frames, ReplayError> {
    let mut frames = Frames::default();
    let mut jobs: BTreeMap<u32, FinishedJob> = BTreeMap::new();
    for record in recording.whole_records()? {
        let record = record?;
        frames.recorded += usize::from(tells_of_a_frame(&record));
        let input = match read_input(&record) {
            Some(InputMemo::Whole(input)) => input,
            Some(InputMemo::JobDone { job_id, times }) => match jobs.remove(&job_id) {
                Some(done) => Input::JobDone {
                    job_id,
                    done: FinishedJob { times, ..done },
                },
                None => continue,
            },
            None => continue,
        };
        controller.handle_input(record.stamp, input);
        while let Some(output) = controller.poll_output() {
            on_output(&output);
            match output {
                Output::Job { job_id, job } => {
                    jobs.insert(job_id, pool.run(&job));
                }
                Output::Event(Event::FrameArrived { .. }) => frames.found += 1,
                _ => {}
            }
        }
    }
    Ok(frames)
}

fn tells_of_a_frame(record: &Record) -> bool {
    if record.topic != Topic::Event {
        return false;
    }
    let event: Option<serde_json::Value> = serde_json::from_slice(&record.payload).ok();
    event.is_some_and(|event| event["event"] == "frame-arrived")
}

/// Writes files into the folder; none of them may be there.
///
/// # Errors
/// The first that cannot be written.
pub fn write_files(dir: &Path, files: &[(&'static str, Vec<u8>)]) -> Result<(), FileError> {
    files
        .iter()
        .try_for_each(|(name, bytes)| write_new(&dir.join(name), bytes))
}
