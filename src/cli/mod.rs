//! The command line: words to actions.

mod camera;
mod cell;
mod check;
mod dry_run;
mod files;
mod live_run;
mod operator;
mod reconstruct;
mod recover;
mod register;
mod replay;
mod resume;
mod robot;

use clap::{Parser, Subcommand};
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// Open controller for automatic blade scanning.
#[derive(Debug, Parser)]
#[command(name = "bladescan", version, arg_required_else_help = true, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Do the whole job on the built-in simulated cell.
    #[command(after_help = "Example:\n  bladescan dry-run config/recipes/hpt-blade-a.toml --seed 7")]
    DryRun(dry_run::Args),
    /// Do the whole job on a real cell.
    #[command(
        after_help = "Example:\n  bladescan run config/recipes/hpt-blade-a.toml --station config/stations/cell.toml --arm --part SN-0042"
    )]
    Run(live_run::Args),
    /// Go on with a run that was aborted, stopped by a fault or killed.
    #[command(after_help = "Example:\n  bladescan resume runs/hpt-blade-a-20261121T120000Z --show")]
    Resume(resume::Args),
    /// Make the recording of a killed run whole, packed and indexed.
    #[command(after_help = "Example:\n  bladescan recover runs/hpt-blade-a-20261121T120000Z/run.mcap")]
    Recover(recover::Args),
    /// Validate a recipe and print its plan; touches no device.
    #[command(
        after_help = "Example:\n  bladescan check config/recipes/hpt-blade-a.toml --station config/stations/cell.toml"
    )]
    Check(check::Args),
    /// Feed a recording to the same code and compare every output bit by bit.
    #[command(after_help = "Example:\n  bladescan replay runs/hpt-blade-a-20261121T120000Z/run.mcap")]
    Replay(replay::Args),
    /// Register the views of a recording anew, under another recipe and without devices.
    #[command(
        after_help = "Example:\n  bladescan reconstruct --from runs/hpt-blade-a-20261121T120000Z/run.mcap --recipe config/recipes/hpt-blade-a.toml"
    )]
    Reconstruct(reconstruct::Args),
    /// Register one cloud to another.
    #[command(after_help = "Example:\n  bladescan register view_00.ply view_01.ply --json")]
    Register(register::Args),
    /// Look at the robot, without a run: nothing moves.
    Robot(robot::Args),
    /// Look at the camera, test a bridge to one, or be one, without a run.
    Camera(camera::Args),
    /// The simulated cell on its own: `sim --help` lists its commands.
    #[cfg(feature = "sim")]
    #[command(
        disable_help_flag = true,
        after_help = "Example:\n  bladescan sim cell --blade builtin:hpt-a --json"
    )]
    Sim {
        /// Handed on to the simulator.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<std::ffi::OsString>,
    },
}

const EXIT_CODES: &str = "Exit codes:\n  0  done\n  1  a fault stopped the job\n  2  bad arguments, bad input, or an output folder \
                          that exists\n  3  done, but views missing or a registration not converged\n  4  aborted by the \
                          operator\n  5  replay differs";

/// Runs the program and says how it went.
pub fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::DryRun(args) => dry_run::main(args),
        Command::Run(args) => live_run::main(&args),
        Command::Resume(args) => resume::main(&args),
        Command::Recover(args) => recover::main(&args),
        Command::Check(args) => check::main(&args),
        Command::Replay(args) => replay::main(&args),
        Command::Reconstruct(args) => reconstruct::main(&args),
        Command::Register(args) => register::main(&args),
        Command::Robot(args) => robot::main(&args),
        Command::Camera(args) => camera::main(&args),
        #[cfg(feature = "sim")]
        Command::Sim { words } => return hw_sim::cli::main_from(words.into_iter(), "bladescan sim"),
    };
    match result {
        Ok(exit) => exit.into(),
        Err(failure) => {
            complain(&failure);
            failure.exit().into()
        }
    }
}

/// How a command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Exit {
    Done = 0,
    Fault = 1,
    Usage = 2,
    Short = 3,
    Aborted = 4,
    Differs = 5,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        ExitCode::from(exit as u8)
    }
}

/// Why a command could not be carried out.
#[derive(Debug, thiserror::Error)]
enum Failure {
    /// A mistake in a recipe or station.
    #[error(transparent)]
    Settings(Box<crate::settings::SettingsError>),
    /// A file that cannot be read.
    #[error("cannot read {path}: {source}")]
    Read { path: PathBuf, source: std::io::Error },
    /// Bad arguments or bad input, in words.
    #[error("{0}")]
    Usage(String),
    /// A recording that this program does not repeat.
    #[error("{0}")]
    Differs(String),
    /// Something went wrong on the way.
    #[error("{0}")]
    Broken(String),
}

impl Failure {
    fn exit(&self) -> Exit {
        match self {
            Self::Settings(_) | Self::Read { .. } | Self::Usage(_) => Exit::Usage,
            Self::Differs(_) => Exit::Differs,
            Self::Broken(_) => Exit::Fault,
        }
    }
}

fn complain(failure: &Failure) {
    let text = match failure {
        // miette draws file, line and caret.
        Failure::Settings(error) => {
            let mut text = String::new();
            let handler = miette::GraphicalReportHandler::new_themed(theme()).with_width(100);
            match handler.render_report(&mut text, error.as_ref()) {
                Ok(()) => text,
                Err(_) => format!("error: {error}"),
            }
        }
        other => format!("error: {other}"),
    };
    writeln!(std::io::stderr(), "{}", text.trim_end()).ok();
}

/// Colours on a terminal, plain characters elsewhere.
fn theme() -> miette::GraphicalTheme {
    use std::io::IsTerminal as _;
    if std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none() {
        miette::GraphicalTheme::unicode()
    } else {
        miette::GraphicalTheme::unicode_nocolor()
    }
}

/// Prints a line to standard output.
fn print(text: &str) -> Result<(), Failure> {
    writeln!(std::io::stdout(), "{text}").map_err(|error| Failure::Broken(format!("cannot print: {error}")))
}
