//! What a recorded run was to do, from the recipe and the station inside its recording.

use super::replay::ReplayError;
use crate::journal::Recording;
use crate::plan::Plan;
use crate::settings::{Recipe, Station};
use std::num::NonZeroUsize;

/// Recipe, station and plan of a recorded run.
#[derive(Debug)]
pub struct Recorded {
    /// What was measured and how.
    pub recipe: Recipe,
    /// Where.
    pub station: Station,
    /// The views that were to be taken.
    pub plan: Plan,
}

impl Recorded {
    /// Reads them.
    ///
    /// # Errors
    /// When this version does not take the recipe or the station, or plans no run from them.
    pub fn read(recording: &Recording<'_>) -> Result<Self, ReplayError> {
        let recipe = Recipe::parse("recipe.toml", recording.recipe_text()).map_err(Box::new)?;
        let station = Station::parse("station.toml", recording.station_text()).map_err(Box::new)?;
        let header = recording.header();
        let mut plan = Plan::new(&recipe, &station, header.seed)?;
        if let Some(view_count) = header.view_count.and_then(NonZeroUsize::new) {
            plan = plan.truncated(view_count);
        }
        Ok(Self { recipe, station, plan })
    }
}
