//! Reconstruction of a recorded run under another recipe.

use super::live::{LiveError, write_new};
use super::pool::Pool;
use super::replay::{ReplayError, refeed};
use crate::controller::{Header, Output, Outside, Reconstructed, Reconstruction, Source};
use crate::event::Event;
use crate::job::Job;
use crate::journal::Recording;
use crate::plan::Plan;
use crate::settings::{Recipe, Station};
use crate::stamp::Stamp;
use std::num::NonZeroUsize;
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
}

/// Registers the frames of a recording anew. `header` names the result, as the recording's own does but for the recipe and
/// the version.
///
/// # Errors
/// The recording is not one, has no frame, or has another number of views than the recipe.
pub fn reconstruct(
    recording: &Recording<'_>,
    header: Header,
    source: Source,
    recipe: &Recipe,
    pool: &Pool,
    on_event: &mut dyn FnMut(&Event),
) -> Result<Reconstructed, ReconstructError> {
    let began = Instant::now();
    let (recorded, station, plan) = recorded_plan(recording)?;
    if recipe.view_count() != recorded.view_count() {
        return Err(ReconstructError::Views {
            planned: recipe.view_count(),
            recorded: recorded.view_count(),
        });
    }
    let mut reconstruction = Reconstruction::new(header, source, recipe, &station, &plan);
    let mut now = || Stamp {
        ns: began.elapsed().as_nanos() as u64,
    };
    let mut outside = Outside {
        run: &mut |job: &Job| pool.run(job),
        now: &mut now,
        on_event,
    };
    let mut has_frame = false;
    let mut on_output = |output: &Output| {
        has_frame |= matches!(output, Output::Job { .. });
        reconstruction.handle_output(output, &mut outside);
    };
    refeed(recording, pool, &mut on_output)?;
    if !has_frame {
        return Err(ReconstructError::NoFrame);
    }
    Ok(reconstruction.finish(now()))
}

/// Writes files into the folder; none of them may be there.
///
/// # Errors
/// The first that cannot be written.
pub fn write_files(dir: &Path, files: &[(&'static str, Vec<u8>)]) -> Result<(), LiveError> {
    files
        .iter()
        .try_for_each(|(name, bytes)| write_new(&dir.join(name), bytes))
}

/// What the recorded run was to do.
fn recorded_plan(recording: &Recording<'_>) -> Result<(Recipe, Station, Plan), ReplayError> {
    let recipe = Recipe::parse("recipe.toml", recording.recipe_text()).map_err(Box::new)?;
    let station = Station::parse("station.toml", recording.station_text()).map_err(Box::new)?;
    let plan = Plan::new(&recipe, &station, recording.header().seed)?;
    let plan = match recording.header().view_count.and_then(NonZeroUsize::new) {
        Some(view_count) => plan.truncated(view_count),
        None => plan,
    };
    Ok((recipe, station, plan))
}
