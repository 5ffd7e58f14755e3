//! `bladescan dry-run`: the whole job on the built-in simulated cell.

use super::cell::{cell_options, in_cell};
use super::files::{beside, builtin_station_with, make_run_dir, plan, read_recipe};
use super::live_run::{RunJob, Said, runtime};
use super::{Exit, Failure};
use crate::controller::Simulation;
use crate::seed::Seed;
use crate::settings::Cad;
use clap::ValueEnum;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// What to measure and how.
    recipe: PathBuf,
    #[command(flatten)]
    said: Said,
    /// Folder of the run; must not exist [default: runs/<recipe>-<UTC time>].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seeds everything drawn: the simulated cell, tilts, samples.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only the first N views of the plan.
    #[arg(long, value_name = "N", value_parser = super::files::parse_views)]
    views: Option<NonZeroUsize>,
    /// Simulated motion and exposure are this much faster than real; time-outs stay.
    #[arg(long, default_value_t = 20.0, value_name = "X", value_parser = parse_speed)]
    speed: f64,
    /// What is spoken with the simulated robot.
    #[arg(long, value_enum, default_value_t = Link::Hses)]
    link: Link,
    /// How the simulated robot is moved: by moves of bladescan, or by orders to the scan job on the controller.
    #[arg(long, value_enum, default_value_t = Motion::Direct)]
    motion: Motion,
    /// How the simulated blade throws light back.
    #[arg(long, value_enum, default_value_t = Surface::Matte)]
    surface: Surface,
    /// Part of the simulated camera's artefacts to leave out; may be repeated (docs/simulator.md).
    #[arg(long, value_name = "TERM")]
    without: Vec<String>,
    /// Fault to inject, KIND[=VALUE][@VIEW]; may be repeated, `bladescan sim faults` lists them.
    #[arg(long = "fault", value_name = "SPEC")]
    faults: Vec<String>,
    /// Print summary.json to standard output.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Link {
    Hses,
    HostControl,
    Serial,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Motion {
    Direct,
    Job,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Surface {
    Matte,
    Machined,
    Polished,
}

pub(super) fn main(args: Args) -> Result<Exit, Failure> {
    let recipe = read_recipe(&args.recipe)?;
    let station = builtin_station_with(&word(args.link), &word(args.motion));
    let seed = Seed(args.seed);
    let plan = plan(&recipe.meaning, &station.meaning, seed, args.views)?;
    let blade = match &recipe.meaning.cad {
        Cad::Builtin(name) => format!("builtin:{name}"),
        Cad::File(path) => absolute(&beside(&args.recipe, path))?,
    };
    let simulation = Simulation {
        blade,
        surface: word(args.surface),
        without: args.without,
        speed: args.speed,
    };
    let dir = make_run_dir(args.out.as_deref(), &recipe.meaning, SystemTime::now())?;
    let (recipe_meaning, station_meaning) = (&recipe.meaning, &station.meaning);
    let options = cell_options(&simulation, seed, recipe_meaning, station_meaning, &dir, &args.faults);
    let protocol = station.meaning.robot.protocol;
    let job = RunJob {
        recipe,
        station,
        plan,
        seed,
        said: args.said,
        simulation: Some(simulation),
        views: args.views,
        json: args.json,
    };
    let done = runtime()?.block_on(in_cell(&options, protocol, async |links| {
        job.carry_out(links, &dir).await
    }));
    if done.is_err() {
        // Where nothing was recorded the folder just made is empty.
        std::fs::remove_dir(&dir).ok();
    }
    done
}

/// A path that still leads there when another process, elsewhere, starts the cell again.
fn absolute(path: &Path) -> Result<String, Failure> {
    let absolute = std::path::absolute(path)
        .map_err(|error| Failure::Usage(format!("cannot name {} in full: {error}", path.display())))?;
    Ok(absolute.display().to_string())
}

/// The word that chooses `value`, in the command line and in a station alike.
fn word(value: impl ValueEnum) -> String {
    let word = value.to_possible_value().expect("every choice has a word");
    word.get_name().to_owned()
}

fn parse_speed(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(speed) if (0.1..=1000.0).contains(&speed) => Ok(speed),
        _ => Err("give a number from 0.1 to 1000".into()),
    }
}
