//! `bladescan camera`: looking at the camera, and at a bridge to one, without a run.

mod bridge;
mod conformance;
mod frame;
mod hello;
mod settings;
mod watch;

use super::files::{read_recipe, read_station};
use super::live_run::resolve;
use super::{Exit, Failure};
use crate::camera::{CameraSettings, Caps, ComponentKind, Hello, Visit, VisitError};
use crate::run::camera_lines;
use crate::session::camera_settings;
use crate::settings::{HostPort, Recipe, Target};
use clap::Subcommand;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
    /// Print JSON: one document, or for `watch` one a line.
    #[arg(long, global = true)]
    json: bool,
}

/// Where the camera is: by its address, or as a station says.
#[derive(Debug, clap::Args)]
struct Place {
    /// The bridge to the camera.
    #[arg(value_name = "HOST:PORT", value_parser = parse_address, conflicts_with = "station")]
    address: Option<HostPort>,
    /// The station whose camera is meant.
    #[arg(long, value_name = "STATION")]
    station: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Who the camera is, what it can do, how warm it is; also while a run goes on.
    #[command(after_help = "Example:\n  bladescan camera hello 192.168.2.20:50555")]
    Hello(hello::Args),
    /// Set what a recipe asks for and compare; or suggest exposures for the part before the camera.
    #[command(
        after_help = "Example:\n  bladescan camera settings --recipe config/recipes/hpt-blade-a.toml 192.168.2.20:50555\n  bladescan camera settings --suggest 192.168.2.20:50555"
    )]
    Settings(settings::Args),
    /// Take one frame: a cloud (PLY), or depth and intensity as pictures (PNG).
    #[command(after_help = "Example:\n  bladescan camera frame --out blade.png 192.168.2.20:50555")]
    Frame(frame::Args),
    /// A line each second: state, temperatures, counters; also while a run goes on. Ctrl-C ends it.
    #[command(after_help = "Example:\n  bladescan camera watch --station config/stations/cell.toml")]
    Watch(watch::Args),
    /// Test a server of A3DP/1 clause by clause.
    #[command(
        after_help = "Example:\n  bladescan camera conformance 127.0.0.1:50555 --allow-exposures\n\nNo observer and no controller may be connected meanwhile. Exit code 0 only when no clause failed."
    )]
    Conformance(conformance::Args),
    /// Serve A3DP/1 on the vision PC, with the vendor's software behind it. Ctrl-C ends it.
    #[command(after_help = "Example:\n  bladescan camera bridge config/bridges/a5000.toml")]
    Bridge(bridge::Args),
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    match &args.what {
        What::Hello(hello) => hello::main(hello, args.json),
        What::Settings(settings) => settings::main(settings, args.json),
        What::Frame(frame) => frame::main(frame, args.json),
        What::Watch(watch) => watch::main(watch, args.json),
        What::Conformance(conformance) => conformance::main(conformance, args.json),
        What::Bridge(bridge) => bridge::main(bridge, args.json),
    }
}

impl Place {
    fn resolve(&self) -> Result<SocketAddr, Failure> {
        let missing = || Failure::Usage("say where the camera is: HOST:PORT or --station".into());
        match (&self.address, &self.station) {
            (Some(address), _) => resolve(address),
            (None, Some(path)) => match read_station(path)?.meaning.target {
                Target::Cell { camera, .. } | Target::SimulatedAt { camera, .. } => resolve(&camera),
                Target::Simulated => Err(missing()),
            },
            (None, None) => Err(missing()),
        }
    }

    /// A visit that only looks: a run may go on meanwhile.
    fn observe(&self) -> Result<Visit<'static>, Failure> {
        Ok(Visit::open(camera_lines(self.resolve()?), Hello::observer(NAME))?)
    }

    /// A visit that sets and triggers: no run may go on meanwhile.
    fn control(&self) -> Result<Visit<'static>, Failure> {
        let hello = Hello::controller(run_id(), NAME);
        Ok(Visit::open(camera_lines(self.resolve()?), hello)?)
    }
}

/// Which settings are meant.
#[derive(Debug, clap::Args)]
struct Source {
    /// Take the settings of this recipe [default: the camera's usual ones, the whole sensor].
    #[arg(long, value_name = "RECIPE")]
    recipe: Option<PathBuf>,
    /// The view whose exposures are meant, from 0.
    #[arg(long, value_name = "N", default_value_t = 0, requires = "recipe")]
    view: usize,
}

impl Source {
    /// The recipe, where there is one and it has this view.
    fn read(&self) -> Result<Option<Recipe>, Failure> {
        let Some(path) = &self.recipe else { return Ok(None) };
        let recipe = read_recipe(path)?.meaning;
        let view_count = recipe.view_count();
        if self.view < view_count {
            return Ok(Some(recipe));
        }
        Err(Failure::Usage(format!(
            "--view {}: {} has {view_count} views, from 0 to {}",
            self.view,
            path.display(),
            view_count - 1
        )))
    }

    /// Settings of the recipe's view, or the camera's usual ones for the whole sensor.
    fn settings(&self, recipe: Option<&Recipe>, caps: &Caps) -> CameraSettings {
        match recipe {
            Some(recipe) => camera_settings(recipe, self.view),
            None => usual(caps),
        }
    }
}

fn usual(caps: &Caps) -> CameraSettings {
    let lowest = |mask: u32| mask.trailing_zeros().min(31) as u8;
    let points = ComponentKind::Xyz.bit() | ComponentKind::Intensity.bit() | ComponentKind::Mask.bit();
    CameraSettings {
        binning: false,
        roi_px: [caps.sensor_px[0], caps.sensor_px[1], 0, 0, 0, 0],
        exposure_us: caps.exposure_default_us,
        image_count: caps.image_count_default,
        hdr_us: [0; 2],
        compression: lowest(caps.compressions),
        led_percent: caps.led_recommended_percent,
        frame_time_ratio: 1.0,
        score_threshold: 0.85,
        outlier_filter: lowest(caps.outlier_filters),
        reconstruction_quality: 5,
        pre_filtering: 3,
        working_volume: lowest(caps.working_volumes),
        volume_of_interest: None,
        components: points,
    }
}

/// New for each start of the program.
fn run_id() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (since.as_nanos() as u64).max(1)
}

fn parse_address(text: &str) -> Result<HostPort, String> {
    HostPort::parse(text).ok_or_else(|| "give HOST:PORT, for example 192.168.2.20:50555".into())
}

/// Temperatures in words: projector, camera 1, camera 2, board.
fn temperatures(temperature_c: &[Option<f32>; 4]) -> String {
    let names = ["projector", "camera 1", "camera 2", "board"];
    let known = names.iter().zip(temperature_c);
    let words: Vec<String> = known
        .filter_map(|(name, value)| value.map(|value| format!("{name} {value:.1}")))
        .collect();
    match words.is_empty() {
        true => "unknown".into(),
        false => format!("{} °C", words.join(", ")),
    }
}

/// The last error with its name.
fn error_name(code: u16) -> String {
    match (code, crate::camera::code::name(code)) {
        (0, _) => "none".into(),
        (_, Some(name)) => format!("{code} {name}"),
        (_, None) => code.to_string(),
    }
}

/// For a table: a label, then what there is to say.
fn row(label: &str, text: impl std::fmt::Display) -> String {
    format!("{label:<12} {text}")
}

impl From<VisitError> for Failure {
    fn from(error: VisitError) -> Self {
        Self::Broken(error.to_string())
    }
}

const NAME: &str = "bladescan camera";
