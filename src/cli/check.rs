//! `bladescan check`: validates and prints the plan.

use super::files::{builtin_station, plan, read_recipe, read_station};
use super::{Exit, Failure, print};
use crate::geometry::{fixed_xyz_from_rotation, matrix_rows};
use crate::plan::{Plan, PlannedView};
use crate::seed::Seed;
use crate::settings::{Recipe, Station};
use serde_json::{Value, json};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// What to measure and how.
    recipe: PathBuf,
    /// Where [default: the built-in simulated station].
    #[arg(long)]
    station: Option<PathBuf>,
    /// Seeds the tilts.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let recipe = read_recipe(&args.recipe)?.meaning;
    let station = match &args.station {
        Some(path) => read_station(path)?,
        None => builtin_station(),
    }
    .meaning;
    let plan = plan(&recipe, &station, Seed(args.seed), None)?;
    if args.json {
        print(&as_json(&recipe, &station, &plan).to_string())?;
    } else {
        print(&as_table(&recipe, &station, &plan))?;
    }
    Ok(Exit::Done)
}

fn as_table(recipe: &Recipe, station: &Station, plan: &Plan) -> String {
    let mut lines = vec![
        format!("recipe {} on station {}: valid", recipe.name, station.name),
        format!(
            "{} views, turn step {:.3} deg, tilts up to {:.1} deg, optics {}, stand-off {:.1} mm",
            plan.views().len(),
            recipe.views.step_rad().to_degrees(),
            recipe.views.tilt_max_rad.to_degrees(),
            recipe.camera.optics.name(),
            recipe.camera_from_fixture.translation.z
        ),
        format!(
            "all poses lie in the workspace; about {:.0} s of motion without the way to the first view",
            plan.moves_duration_ns() as f64 * 1e-9
        ),
        String::new(),
        "view   turn  tilt x  tilt y |      X mm      Y mm      Z mm    Rx deg    Ry deg    Rz deg |  way mm  angle deg"
            .to_owned(),
    ];
    for view in plan.views() {
        if view.skipped {
            lines.push(format!("{:4} skipped", view.index));
            continue;
        }
        let position = view.base_from_tool.translation.vector;
        let [rx, ry, rz] = fixed_xyz_from_rotation(&view.base_from_tool.rotation).map(f64::to_degrees);
        let way = plan
            .moves()
            .iter()
            .find(|planned| planned.to_index == view.index)
            .map_or_else(String::new, |planned| {
                format!("{:7.1}  {:9.2}", planned.distance_mm, planned.angle_rad.to_degrees())
            });
        lines.push(format!(
            "{:4} {:6.1} {:7.2} {:7.2} | {:9.3} {:9.3} {:9.3} {rx:9.4} {ry:9.4} {rz:9.4} | {way}",
            view.index,
            view.turn_rad.to_degrees(),
            view.tilt_x_rad.to_degrees(),
            view.tilt_y_rad.to_degrees(),
            position.x,
            position.y,
            position.z,
        ));
    }
    lines.join("\n")
}

fn as_json(recipe: &Recipe, station: &Station, plan: &Plan) -> Value {
    let view = |view: &PlannedView| {
        json!({
            "index": view.index,
            "skipped": view.skipped,
            "turn_deg": view.turn_rad.to_degrees(),
            "tilt_x_deg": view.tilt_x_rad.to_degrees(),
            "tilt_y_deg": view.tilt_y_rad.to_degrees(),
            "camera_from_blade": matrix_rows(&view.camera_from_blade),
            "base_from_tool": matrix_rows(&view.base_from_tool),
        })
    };
    json!({
        "recipe": recipe.name,
        "station": station.name,
        "valid": true,
        "motion_s": plan.moves_duration_ns() as f64 * 1e-9,
        "views": plan.views().iter().map(view).collect::<Vec<_>>(),
    })
}
