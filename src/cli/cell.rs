//! The simulated cell of a run: started by the same program, with what the arguments or the recording say of it.

use super::{Exit, Failure};
use crate::controller::Simulation;
use crate::run::{Links, SimulatedCell, SimulatedError, SimulatedOptions};
use crate::seed::Seed;
use crate::settings::{Recipe, RobotProtocol, Station};
use std::path::Path;

/// What the cell of a run in the folder `dir` is started with. A truth that lies there already goes on.
pub(super) fn cell_options(
    simulation: &Simulation,
    seed: Seed,
    recipe: &Recipe,
    station: &Station,
    dir: &Path,
    faults: &[String],
) -> SimulatedOptions {
    SimulatedOptions {
        seed: seed.0,
        blade: simulation.blade.clone(),
        optics: recipe.camera.optics.name(),
        surface: simulation.surface.clone(),
        without: simulation.without.clone(),
        serial: matches!(station.robot.protocol, RobotProtocol::Serial { .. }),
        base_from_camera: station.base_from_camera,
        tool_from_blade: station.tool_from_blade,
        speed: simulation.speed,
        truth: dir.join("truth.json"),
        faults: faults.to_vec(),
    }
}

/// Starts the cell, does `job` with it, and lets it end.
pub(super) async fn in_cell(
    options: &SimulatedOptions,
    protocol: RobotProtocol,
    job: impl AsyncFnOnce(Links) -> Result<Exit, Failure>,
) -> Result<Exit, Failure> {
    let cell = SimulatedCell::start(options).await.map_err(|error| match error {
        SimulatedError::Options(_) => Failure::Usage(error.to_string()),
        _ => Failure::Broken(error.to_string()),
    })?;
    let exit = match cell.links(protocol) {
        Some(links) => job(links).await,
        None => Err(Failure::Broken("the simulated cell has no such link".into())),
    };
    cell.stop().await;
    exit
}
