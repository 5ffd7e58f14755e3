//! The simulator's command line.

use std::ffi::OsString;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use nalgebra::{Isometry3, Translation3};
use serde::Serialize;
use thiserror::Error;
use tokio::io::AsyncReadExt;

use crate::blade::{Builtin, Mesh, stl};
use crate::camera::optics::Optics;
use crate::camera::render::{Renderer, Surface, Term, Terms};
use crate::cell::Cell;
use crate::fault::{Fault, catalogue};
use crate::robot::ports::LinkOptions;
use crate::robot::pose::{Pose, isometry_from_mm_deg};
use crate::scene::Scene;
use crate::score::score_folder;
use crate::shell::{self, Sockets, Wanted};
use crate::truth::{PoseErrorSize, Truth};
use crate::vendor;

/// Runs the command line `args` (without the name of the program) and says how it went: 0 done, 1 failed, 2 bad arguments
/// or bad input. `program` stands in the help.
pub fn main_from(args: impl Iterator<Item = OsString>, program: &str) -> ExitCode {
    let command = Cli::command().bin_name(program.to_owned()).no_binary_name(true);
    let parsed = command
        .try_get_matches_from(args)
        .and_then(|matches| Cli::from_arg_matches(&matches));
    let cli = match parsed {
        Ok(cli) => cli,
        Err(error) => {
            // Help goes to standard output, complaints to standard error; a closed one loses them.
            error.print().ok();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    match run(cli.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            writeln!(io::stderr(), "error: {error}").ok();
            error.exit_code()
        }
    }
}

/// The simulated blade-scanning cell: nothing it says was measured.
///
/// Example: sim cell --seed 1 --blade builtin:hpt-a --speed 20 --json
#[derive(Debug, Parser)]
#[command(version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve robot and camera.
    Cell(ServeArgs),
    /// Serve the robot alone.
    Robot(ServeArgs),
    /// Serve the camera alone, the blade held at its nominal distance.
    Camera(ServeArgs),
    /// The vendor's side of a bridge: a slanting plane, for `bladescan camera bridge` to be tried on.
    #[command(hide = true)]
    Vendor(vendor::Args),
    /// List the faults that can be injected.
    Faults,
    /// Write a built-in blade as STL.
    Blade {
        /// lpt, hpt-a, hpt-b or hpt-c.
        name: String,
        /// File to write; an existing one is replaced.
        #[arg(long, value_name = "FILE.stl")]
        out: PathBuf,
    },
    /// Compare the poses of a run with the truth, as JSON.
    Score {
        /// Folder with poses.json and truth.json.
        dir: PathBuf,
        /// JSON is the only form there is.
        #[arg(long)]
        json: bool,
    },
}

#[derive(Debug, Args)]
struct ServeArgs {
    /// Seed of everything drawn.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Blade in the gripper: builtin:NAME or an STL file in mm.
    #[arg(long, default_value = "builtin:hpt-a")]
    blade: String,
    /// Lens set: fine, medium or wide.
    #[arg(long, default_value = "fine", value_parser = parse_optics)]
    optics: Optics,
    /// How the blade throws light back: matte, machined or polished (docs/simulator.md).
    #[arg(long, default_value = "matte", value_parser = parse_surface)]
    surface: Surface,
    /// Part of the camera's artefacts to switch off; may be repeated.
    #[arg(long = "without", value_name = "TERM", value_parser = parse_term)]
    without: Vec<Term>,
    /// Part of the camera's artefacts to switch on; may be repeated.
    #[arg(long = "with", value_name = "TERM", value_parser = parse_term)]
    with: Vec<Term>,
    /// Switch the camera's systematic errors on: bowl, scale and warm-up.
    #[arg(long)]
    systematic: bool,
    /// Camera in the robot's base: x,y,z,rx,ry,rz in mm and degrees, fixed axes.
    #[arg(long, value_name = "POSE", default_value = "1000,-700,1000,-90,0,0", value_parser = parse_pose)]
    #[arg(allow_hyphen_values = true)]
    base_from_camera: Isometry3<f64>,
    /// Blade in the robot's tool: x,y,z,rx,ry,rz in mm and degrees, fixed axes.
    #[arg(long, value_name = "POSE", default_value = "0,0,400,0,0,0", value_parser = parse_pose)]
    #[arg(allow_hyphen_values = true)]
    tool_from_blade: Isometry3<f64>,
    /// Motion and exposure are this much faster than real; time-outs stay.
    #[arg(long, default_value_t = 1.0, value_parser = parse_speed)]
    speed: f64,
    /// File for the truth, written after each acquisition; that of the same run goes on.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Fault to inject, KIND[=VALUE][@VIEW[.ATTEMPT][:PHASE]]; may be repeated, `faults` lists them.
    #[arg(long = "fault", value_name = "SPEC")]
    faults: Vec<Fault>,
    /// Standard deviation of the robot's position, per axis and view.
    #[arg(long, default_value_t = 0.05, value_parser = parse_size)]
    pose_error_mm: f64,
    /// Standard deviation of the robot's orientation, per axis and view.
    #[arg(long, default_value_t = 0.03, value_parser = parse_size)]
    pose_error_deg: f64,
    /// Standard deviation of the calibrated positions, per axis and run.
    #[arg(long, default_value_t = 0.1, value_parser = parse_size)]
    calibration_error_mm: f64,
    /// Standard deviation of the calibrated orientations, per axis and run.
    #[arg(long, default_value_t = 0.05, value_parser = parse_size)]
    calibration_error_deg: f64,
    /// UDP port of the robot; 0 = any free one.
    #[arg(long, default_value_t = 0)]
    hses_port: u16,
    /// UDP port of the robot's files; 0 = any free one.
    #[arg(long, default_value_t = 0)]
    hses_file_port: u16,
    /// TCP port of the robot's host control; 0 = any free one.
    #[arg(long, default_value_t = 0)]
    host_control_port: u16,
    /// Give the robot a serial line, a pseudo-terminal whose path is said.
    #[arg(long)]
    serial: bool,
    /// Speed of the serial line; 0 = no time at all. A faster simulation makes it faster.
    #[arg(long, value_name = "BAUD", default_value_t = 9600)]
    serial_baud: u32,
    /// Time between the confirmation of a host-control command and its answer, in real milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 50)]
    host_control_pause: u32,
    /// TCP port of the camera; 0 = any free one.
    #[arg(long, default_value_t = 0)]
    a3dp_port: u16,
    /// Say where the devices listen in one line of JSON.
    #[arg(long)]
    json: bool,
    /// End when standard input does.
    #[arg(long)]
    until_stdin_closes: bool,
}

/// Why a command fails.
#[derive(Debug, Error)]
enum CliError {
    #[error("no built-in blade is called {0:?}; there are: lpt, hpt-a, hpt-b, hpt-c")]
    NoBlade(String),
    #[error(transparent)]
    Stl(#[from] stl::StlError),
    #[error(transparent)]
    Renderer(#[from] crate::camera::render::RendererError),
    #[error(transparent)]
    Score(#[from] crate::score::ScoreError),
    #[error(transparent)]
    Shell(#[from] shell::ShellError),
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: io::Error },
    #[error("cannot write {path}: {source}")]
    Write { path: PathBuf, source: io::Error },
    #[error("{path} is the truth of another run: another blade, seed, optics or surface, or no truth at all")]
    OtherRun { path: PathBuf },
    #[error("cannot say where the cell listens: {0}")]
    Stdout(#[from] io::Error),
}

impl CliError {
    fn exit_code(&self) -> ExitCode {
        match self {
            Self::NoBlade(_) | Self::Stl(_) | Self::Renderer(_) | Self::Score(_) | Self::OtherRun { .. } => {
                ExitCode::from(2)
            }
            Self::Shell(_) | Self::Read { .. } | Self::Write { .. } | Self::Stdout(_) => ExitCode::from(1),
        }
    }
}

/// Which devices serve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Devices {
    Both,
    Robot,
    Camera,
}

fn run(command: Command) -> Result<(), CliError> {
    match command {
        Command::Cell(args) => serve(args, Devices::Both),
        Command::Robot(args) => serve(args, Devices::Robot),
        Command::Camera(args) => serve(args, Devices::Camera),
        Command::Faults => {
            let mut stdout = io::stdout().lock();
            for (spelling, meaning) in catalogue() {
                writeln!(stdout, "{spelling:37} {meaning}")?;
            }
            writeln!(stdout, "\n{PLACES}")?;
            Ok(())
        }
        Command::Blade { name, out } => {
            let blade = Builtin::from_name(name.strip_prefix(BUILTIN).unwrap_or(&name));
            let mesh = blade.ok_or(CliError::NoBlade(name))?.mesh();
            stl::write(&out, &mesh).map_err(|source| CliError::Write { path: out, source })
        }
        Command::Vendor(args) => Ok(vendor::serve(&args, io::stdin().lock(), io::stdout().lock())?),
        Command::Score { dir, json: _ } => {
            let score = score_folder(&dir)?;
            let mut stdout = io::stdout().lock();
            serde_json::to_writer_pretty(&mut stdout, &score).map_err(io::Error::from)?;
            Ok(writeln!(stdout)?)
        }
    }
}

fn serve(args: ServeArgs, devices: Devices) -> Result<(), CliError> {
    let mesh = load_blade(&args.blade)?;
    let scene = scene(&args, devices, &mesh);
    let renderer = Arc::new(Renderer::new(&mesh, scene.surface)?);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let served = runtime.block_on(async {
        let has_robot = devices != Devices::Camera;
        let sockets = Sockets::open(&Wanted {
            hses: has_robot.then_some(args.hses_port),
            hses_file: has_robot.then_some(args.hses_file_port),
            host_control: has_robot.then_some(args.host_control_port),
            has_serial: has_robot && args.serial,
            camera: (devices != Devices::Robot).then_some(args.a3dp_port),
        })
        .await?;
        let cell = cell(scene, args.truth.as_deref())?;
        announce(&sockets, args.json)?;
        shell::serve(cell, renderer, sockets, args.truth, stop(args.until_stdin_closes)).await?;
        Ok(())
    });
    // A thread that waits for standard input must not keep the program.
    runtime.shutdown_background();
    served
}

/// The cell, and its truth on disk. A truth that is there already belongs to the same run, which goes on.
fn cell(scene: Scene, truth_path: Option<&Path>) -> Result<Cell, CliError> {
    let Some(path) = truth_path else {
        return Ok(Cell::new(scene));
    };
    let cell = match std::fs::read(path) {
        Ok(text) => {
            let other_run = || CliError::OtherRun { path: path.to_owned() };
            let earlier: Truth = serde_json::from_slice(&text).map_err(|_| other_run())?;
            let here = (&scene.blade, scene.seed, scene.optics.name, &scene.surface);
            if (&earlier.blade, earlier.seed, earlier.optics.as_str(), &earlier.surface) != here {
                return Err(other_run());
            }
            Cell::resumed(scene, earlier)
        }
        Err(source) if source.kind() == std::io::ErrorKind::NotFound => Cell::new(scene),
        Err(source) => {
            return Err(CliError::Read {
                path: path.to_owned(),
                source,
            });
        }
    };
    cell.truth().write(path).map_err(|source| CliError::Write {
        path: path.to_owned(),
        source,
    })?;
    Ok(cell)
}

/// Ends at Ctrl-C and, when asked, at the end of standard input.
async fn stop(until_stdin_closes: bool) {
    let stdin_closes = async {
        if !until_stdin_closes {
            return std::future::pending().await;
        }
        let (mut stdin, mut bytes) = (tokio::io::stdin(), [0; 1024]);
        while stdin.read(&mut bytes).await.unwrap_or(0) > 0 {}
    };
    tokio::select! {
        () = stdin_closes => (),
        _ = tokio::signal::ctrl_c() => (),
    }
}

/// Addresses of what serves.
#[derive(Serialize)]
struct Ready {
    hses: Option<String>,
    hses_file: Option<String>,
    host_control: Option<String>,
    serial: Option<String>,
    a3dp: Option<String>,
}

fn announce(sockets: &Sockets, json: bool) -> io::Result<()> {
    let written = |address: Option<SocketAddr>| address.map(|address| address.to_string());
    let ready = Ready {
        hses: written(sockets.robot_address()),
        hses_file: written(sockets.robot_file_address()),
        host_control: written(sockets.host_control_address()),
        serial: sockets.serial_path().map(str::to_owned),
        a3dp: written(sockets.camera_address()),
    };
    let mut stdout = io::stdout().lock();
    if json {
        serde_json::to_writer(&mut stdout, &ready)?;
        writeln!(stdout)?;
    } else {
        for (what, place) in [
            ("robot (DX200, HSES over UDP)", ready.hses),
            ("robot (DX200, HSES files over UDP)", ready.hses_file),
            ("robot (DX200, host control over TCP)", ready.host_control),
            ("robot (DX200, host control over a serial line)", ready.serial),
            ("camera (A3DP/1 over TCP)", ready.a3dp),
        ] {
            if let Some(place) = place {
                writeln!(stdout, "SIMULATED {what} on {place}")?;
            }
        }
    }
    stdout.flush()
}

fn load_blade(name: &str) -> Result<Mesh, CliError> {
    match name.strip_prefix(BUILTIN) {
        Some(builtin) => Ok(Builtin::from_name(builtin)
            .ok_or_else(|| CliError::NoBlade(builtin.to_owned()))?
            .mesh()),
        None => Ok(stl::read(Path::new(name))?),
    }
}

fn scene(args: &ServeArgs, devices: Devices, mesh: &Mesh) -> Scene {
    let defaults = Scene::default();
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let mut scene = Scene {
        blade: args.blade.strip_prefix(BUILTIN).unwrap_or(&args.blade).to_owned(),
        optics: args.optics,
        surface: surface(args),
        base_from_camera: args.base_from_camera,
        tool_from_blade: args.tool_from_blade,
        seed: args.seed,
        speed: args.speed,
        pose_error: PoseErrorSize {
            robot_mm: args.pose_error_mm,
            robot_deg: args.pose_error_deg,
            calibration_mm: args.calibration_error_mm,
            calibration_deg: args.calibration_error_deg,
        },
        links: LinkOptions {
            host_pause_ns: u64::from(args.host_control_pause) * 1_000_000,
            serial_baud: (args.serial_baud > 0).then_some(args.serial_baud),
            ..LinkOptions::default()
        },
        faults: args.faults.clone(),
        boot_id: since_1970.as_nanos() as u64,
        ..defaults
    };
    if devices == Devices::Camera {
        scene.home = pose_in_view(&scene, mesh);
    }
    scene
}

/// Where the tool must be so that the blade lies along the wide side of the view, its middle at the nominal distance.
fn pose_in_view(scene: &Scene, mesh: &Mesh) -> Pose {
    let middle_mm = mesh
        .extents_mm()
        .map_or_else(Default::default, |(low, high)| nalgebra::center(&low, &high));
    let blade_from_middle = Translation3::from(middle_mm.coords);
    let camera_from_middle = isometry_from_mm_deg([0.0, 0.0, scene.optics.nominal_mm], [180.0, -90.0, 0.0]);
    let base_from_blade = scene.base_from_camera * camera_from_middle * blade_from_middle.inverse();
    Pose::from_isometry(&(base_from_blade * scene.tool_from_blade.inverse()))
}

/// The preset with what is switched; what is named as off is off.
fn surface(args: &ServeArgs) -> Surface {
    let systematic = Term::SYSTEMATIC.into_iter().filter(|_| args.systematic);
    let on = args.with.iter().copied().chain(systematic);
    let terms = on.fold(args.surface.terms, Terms::with);
    Surface {
        terms: args.without.iter().copied().fold(terms, Terms::without),
        ..args.surface
    }
}

fn parse_surface(name: &str) -> Result<Surface, String> {
    Surface::from_name(name).ok_or_else(|| format!("there are: {}", Surface::NAMES.join(", ")))
}

fn parse_term(name: &str) -> Result<Term, String> {
    let names = || Term::ALL.map(Term::name).join(", ");
    Term::from_name(name).ok_or_else(|| format!("there are: {}", names()))
}

fn parse_optics(name: &str) -> Result<Optics, String> {
    Optics::from_name(name).ok_or_else(|| format!("there are: {}", Optics::NAMES.join(", ")))
}

fn parse_pose(text: &str) -> Result<Isometry3<f64>, String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|number| number.trim().parse().ok().filter(|number: &f64| number.is_finite()))
        .collect::<Option<_>>()
        .ok_or("six numbers with commas between them: x,y,z in mm, rx,ry,rz in degrees")?;
    match numbers[..] {
        [x, y, z, rx, ry, rz] => Ok(isometry_from_mm_deg([x, y, z], [rx, ry, rz])),
        _ => Err(format!("six numbers, not {}", numbers.len())),
    }
}

fn parse_speed(text: &str) -> Result<f64, String> {
    parse_range(text, SPEED_RANGE)
}

fn parse_size(text: &str) -> Result<f64, String> {
    parse_range(text, SIZE_RANGE)
}

fn parse_range(text: &str, [low, high]: [f64; 2]) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| (low..=high).contains(number));
    number.ok_or_else(|| format!("a number from {low} to {high}"))
}

const BUILTIN: &str = "builtin:";
/// How the places of faults are written.
const PLACES: &str = "\
@VIEW is view and attempt of a trigger of the camera, written VIEW or VIEW.ATTEMPT (3.1: the second attempt at view 3).
[:PHASE] is where in it, one of those in brackets; the first is meant where none is written (camera-gone@3:exposure).
Every fault with a place happens once.";
const SPEED_RANGE: [f64; 2] = [0.01, 1000.0];
/// Of an error, in mm or degrees.
const SIZE_RANGE: [f64; 2] = [0.0, 10.0];

#[cfg(test)]
mod tests {
    use super::*;

    fn run_with(args: &[&str]) -> String {
        format!("{:?}", main_from(args.iter().map(OsString::from), "hw-sim"))
    }

    fn code(number: u8) -> String {
        format!("{:?}", ExitCode::from(number))
    }

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn bad_arguments_and_bad_input_exit_with_2_and_a_taken_port_with_1() {
        let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = taken.local_addr().unwrap().port().to_string();
        for args in [
            &["cell", "--fault", "camera-on-fire@1"][..],
            &["cell", "--speed", "0"],
            &["cell", "--optics", "narrow"],
            &["cell", "--surface", "chrome"],
            &["cell", "--without", "gravity"],
            &["cell", "--base-from-camera", "1,2,3"],
            &["cell", "--pose-error-mm", "-1"],
            &["cell", "--blade", "builtin:fan"],
            &["cell", "--blade", "/nowhere.stl"],
            &["blade", "fan", "--out", "/nowhere/fan.stl"],
            &["score", "/nowhere"],
        ] {
            assert_eq!(run_with(args), code(2), "{args:?}");
        }
        assert_eq!(run_with(&["camera", "--a3dp-port", &port]), code(1));
        assert_eq!(run_with(&["--help"]), code(0));
    }

    #[test]
    fn the_truth_of_a_resumed_run_goes_on_and_that_of_another_run_stays() {
        let path = std::env::temp_dir().join(format!("hw-sim-cli-{}.json", std::process::id()));
        let mut first = cell(Scene::default(), Some(&path)).unwrap().truth().clone();
        first.record(7 << 16, &Isometry3::identity(), Vec::new(), false);
        first.write(&path).unwrap();
        let faults = vec![Fault::ConfigEcho];
        let resumed = cell(
            Scene {
                faults,
                ..Scene::default()
            },
            Some(&path),
        )
        .unwrap();
        assert_eq!(resumed.truth().views, first.views);
        assert_eq!(resumed.truth().faults, ["config-echo"]);
        let other = cell(
            Scene {
                seed: 2,
                ..Scene::default()
            },
            Some(&path),
        );
        std::fs::remove_file(&path).unwrap();
        assert!(matches!(other, Err(CliError::OtherRun { .. })));
    }

    #[test]
    fn a_truth_that_is_there_but_cannot_be_read_is_not_begun_anew() {
        // A folder is there, and no file to read.
        let path = std::env::temp_dir().join(format!("hw-sim-cli-folder-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        let refused = cell(Scene::default(), Some(&path));
        std::fs::remove_dir(&path).unwrap();
        assert!(matches!(refused, Err(CliError::Read { .. })));
    }

    #[test]
    fn poses_may_be_negative() {
        let args = [
            "cell",
            "--base-from-camera",
            "-1,-2,-3,-90,0,0",
            "--fault",
            "estop@3",
            "--fault",
            "remote-off",
        ];
        let cli = Cli::try_parse_from(["hw-sim"].into_iter().chain(args)).unwrap();
        let Command::Cell(args) = cli.command else { panic!() };
        assert_eq!(
            args.base_from_camera,
            isometry_from_mm_deg([-1.0, -2.0, -3.0], [-90.0, 0.0, 0.0])
        );
        assert_eq!(args.faults, [Fault::Estop { view: 3 }, Fault::RemoteOff]);
    }

    #[test]
    fn terms_are_switched_on_and_off_and_off_wins() {
        let args = [
            "hw-sim",
            "cell",
            "--surface=machined",
            "--without=ghosts",
            "--systematic",
            "--without=bowl",
        ];
        let cli = Cli::try_parse_from(args).unwrap();
        let Command::Cell(args) = cli.command else { panic!() };
        let (terms, machined) = (surface(&args).terms, Surface::machined().terms);
        assert_eq!(
            terms,
            machined.without(Term::Ghosts).with(Term::Scale).with(Term::WarmUp)
        );
    }

    #[test]
    fn the_camera_alone_sees_the_blade() {
        let cli = Cli::try_parse_from(["hw-sim", "camera"]).unwrap();
        let Command::Camera(args) = cli.command else { panic!() };
        let mesh = Builtin::HptA.mesh();
        let scene = scene(&args, Devices::Camera, &mesh);
        let base_from_blade = scene.home.to_isometry() * scene.tool_from_blade;
        let camera_from_blade = scene.base_from_camera.inverse() * base_from_blade;
        let (low, high) = mesh.extents_mm().unwrap();
        assert!(scene.optics.covers(&camera_from_blade, &[low, high]));
    }
}
