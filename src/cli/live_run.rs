//! `bladescan run`, and what it shares with `dry-run`.

use super::files::{Read, make_run_dir, plan, read_recipe, read_station};
use super::{Exit, Failure, operator, print};
use crate::controller::{Controller, Header, Simulation};
use crate::event::Ending;
use crate::job::sha256;
use crate::plan::Plan;
use crate::run::{Beginning, Console, JournalFile, Links, Live, Pool, RobotPlace, pack_file, run};
use crate::seed::Seed;
use crate::settings::{HostPort, Recipe, RobotAddress, Station, Target};
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// What the operator says of a run; it stands in every file of results.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Said {
    /// Serial number or name of the part.
    #[arg(long, value_name = "TEXT", value_parser = said)]
    part: Option<String>,
    /// Who runs it.
    #[arg(long, value_name = "NAME", value_parser = said)]
    operator: Option<String>,
}

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// What to measure and how.
    recipe: PathBuf,
    /// Where: addresses, limits, calibration.
    #[arg(long)]
    station: PathBuf,
    /// Allow real motion. Without it nothing is even connected.
    #[arg(long)]
    arm: bool,
    #[command(flatten)]
    said: Said,
    /// Folder of the run; must not exist [default: runs/<recipe>-<UTC time>].
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Seeds everything drawn (tilts, samples).
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only the first N views of the plan.
    #[arg(long, value_name = "N", value_parser = super::files::parse_views)]
    views: Option<NonZeroUsize>,
    /// Print summary.json to standard output.
    #[arg(long)]
    json: bool,
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    if !args.arm {
        return Err(Failure::Usage(
            "a real run moves the robot: clear the cell, then give --arm (nothing was connected)".into(),
        ));
    }
    let recipe = read_recipe(&args.recipe)?;
    let station = read_station(&args.station)?;
    let Some(links) = links_of(&station.meaning)? else {
        return Err(Failure::Usage(format!(
            "{} is the built-in simulated station: use dry-run",
            args.station.display()
        )));
    };
    let seed = Seed(args.seed);
    let plan = plan(&recipe.meaning, &station.meaning, seed, args.views)?;
    let job = RunJob {
        recipe,
        station,
        plan,
        seed,
        said: args.said.clone(),
        simulation: None,
        views: args.views,
        json: args.json,
    };
    let dir = make_run_dir(args.out.as_deref(), &job.recipe.meaning, SystemTime::now())?;
    runtime()?.block_on(async { job.carry_out(links, &dir).await })
}

/// A run that is ready to be carried out.
pub(super) struct RunJob {
    pub(super) recipe: Read<Recipe>,
    pub(super) station: Read<Station>,
    pub(super) plan: Plan,
    pub(super) seed: Seed,
    pub(super) said: Said,
    /// What the simulated cell was started with, if this program started it.
    pub(super) simulation: Option<Simulation>,
    pub(super) views: Option<NonZeroUsize>,
    pub(super) json: bool,
}

impl RunJob {
    /// Begins the recording and runs to the end.
    pub(super) async fn carry_out(self, links: Links, dir: &Path) -> Result<Exit, Failure> {
        let started = SystemTime::now();
        let start_unix_ns = started
            .duration_since(SystemTime::UNIX_EPOCH)
            .map_or(0, |since| since.as_nanos() as u64);
        let header = Header {
            target: target(),
            seed: self.seed,
            run_id: run_id(start_unix_ns),
            recipe: self.recipe.meaning.name.clone(),
            recipe_sha256: sha256(self.recipe.text.as_bytes()),
            station: self.station.meaning.name.clone(),
            station_sha256: sha256(self.station.text.as_bytes()),
            simulated: !matches!(self.station.meaning.target, Target::Cell { .. }),
            simulation: self.simulation,
            part: self.said.part,
            operator: self.said.operator,
            started_utc: humantime::format_rfc3339_seconds(started).to_string(),
            view_count: self.views.map(NonZeroUsize::get),
            ..Header::default()
        };
        let mut console = Console::new();
        if !header.simulated {
            console.say("Nothing here has met a real DX200 or A5000 yet. Keep a hand on the emergency stop.");
        }
        let journal = JournalFile::create(dir, &header, start_unix_ns, &self.recipe.text, &self.station.text)
            .map_err(|error| Failure::Broken(error.to_string()))?;
        let pool = Pool::new().map_err(|error| Failure::Broken(format!("cannot start threads: {error}")))?;
        let carried = Carried {
            controller: Controller::new(header, &self.recipe.meaning, &self.station.meaning, self.plan),
            journal,
            start_unix_ns,
            beginning: Beginning::default(),
            pool: &pool,
            console: &mut console,
            json: self.json,
        };
        carried.carry_out(links, dir).await
    }
}

/// A run, new or not, with its recording open.
pub(super) struct Carried<'a> {
    pub(super) controller: Controller,
    pub(super) journal: JournalFile,
    pub(super) start_unix_ns: u64,
    pub(super) beginning: Beginning,
    pub(super) pool: &'a Pool,
    pub(super) console: &'a mut Console,
    pub(super) json: bool,
}

impl Carried<'_> {
    /// Runs to the end, packs the recording, tells the person.
    pub(super) async fn carry_out(self, links: Links, dir: &Path) -> Result<Exit, Failure> {
        let console = self.console;
        let live = Live {
            controller: self.controller,
            journal: self.journal,
            start_unix_ns: self.start_unix_ns,
            beginning: self.beginning,
            links,
            pool: self.pool,
            commands: operator::listen(console.voice()),
            console: &mut *console,
            dir,
        };
        let outcome = run(live).await;
        console.close();
        let outcome = outcome.map_err(|error| Failure::Broken(error.to_string()))?;
        if let Err(error) = pack_file(&outcome.recording) {
            console.say(&format!("the recording stays unpacked: {error}"));
        }
        if self.json {
            print(String::from_utf8_lossy(&outcome.summary).trim_end())?;
        }
        console.say(&format!(
            "{} of {} views merged (at least {} wanted); files in {}",
            outcome.merged_count,
            outcome.planned_count,
            outcome.merged_min_count,
            dir.display()
        ));
        Ok(exit(&outcome.ending, outcome.merged_count, outcome.merged_min_count))
    }
}

/// What this program was built for.
pub(super) fn target() -> String {
    format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS)
}

/// A name for a new run that no other run has: from the moment and the process.
fn run_id(start_unix_ns: u64) -> u64 {
    let digest = sha256(format!("{start_unix_ns} {}", std::process::id()).as_bytes());
    let first = digest.get(..16).and_then(|digits| u64::from_str_radix(digits, 16).ok());
    first.unwrap_or(start_unix_ns).max(1)
}

pub(super) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| Failure::Broken(format!("cannot start the event loop: {error}")))
}

/// Reads what stands in the files of results: one line that readers of every format take.
fn said(text: &str) -> Result<String, String> {
    let text = text.trim();
    let count = text.chars().count();
    if count == 0 || count > SAID_CHARACTERS_MAX || text.chars().any(char::is_control) {
        return Err(format!("give 1 to {SAID_CHARACTERS_MAX} characters in one line"));
    }
    Ok(text.to_owned())
}

/// What the ending means for the caller.
pub(super) fn exit(ending: &Ending, merged_count: usize, merged_min_count: usize) -> Exit {
    match ending {
        Ending::Finished if merged_count >= merged_min_count => Exit::Done,
        Ending::Finished => Exit::Short,
        Ending::Aborted => Exit::Aborted,
        Ending::Faulted { .. } => Exit::Fault,
    }
}

/// Where the station's devices are; `None` for the simulated cell that a dry run starts.
pub(super) fn links_of(station: &Station) -> Result<Option<Links>, Failure> {
    match &station.target {
        Target::Simulated => Ok(None),
        Target::SimulatedAt { robot, camera } | Target::Cell { robot, camera } => Ok(Some(Links {
            robot: robot_place(robot)?,
            camera: resolve(camera)?,
        })),
    }
}

pub(super) fn robot_place(address: &RobotAddress) -> Result<RobotPlace, Failure> {
    Ok(match address {
        RobotAddress::Hses(address) => RobotPlace::Hses(resolve(address)?),
        RobotAddress::HostControl(address) => RobotPlace::HostControl(resolve(address)?),
        RobotAddress::Serial { device, baud } => RobotPlace::Serial {
            device: device.clone(),
            baud: *baud,
        },
    })
}

pub(super) fn resolve(address: &HostPort) -> Result<SocketAddr, Failure> {
    (address.host.as_str(), address.port)
        .to_socket_addrs()
        .ok()
        .and_then(|mut found| found.next())
        .ok_or_else(|| Failure::Usage(format!("{address} is not an address this machine can find")))
}

const SAID_CHARACTERS_MAX: usize = 200;
