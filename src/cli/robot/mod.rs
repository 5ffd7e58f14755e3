//! `bladescan robot`: looking at the robot, without a run.

mod alarms;
mod jobs;
mod position;
mod status;
mod watch;

use super::files::{builtin_station, read_station};
use super::live_run::{resolve, robot_place, runtime};
use super::{Exit, Failure};
use crate::run::{Conversation, ConversationError, RobotPlace};
use crate::session::exchange_settings;
use crate::settings::{HostPort, RobotProtocol, Station, Target};
use clap::Subcommand;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
    #[command(flatten)]
    place: Place,
    /// Print JSON: one document, or for `watch` one a line.
    #[arg(long, global = true)]
    json: bool,
}

/// Where the robot is: as a station says, or by its address.
#[derive(Debug, clap::Args)]
struct Place {
    /// The station whose robot is meant.
    #[arg(long, global = true, value_name = "STATION", conflicts_with_all = ["hses", "host_control", "serial"])]
    station: Option<PathBuf>,
    /// Its High-Speed Ethernet Server.
    #[arg(long, global = true, value_name = "HOST:PORT", value_parser = parse_address, conflicts_with_all = ["host_control", "serial"])]
    hses: Option<HostPort>,
    /// Its host control over TCP.
    #[arg(long, global = true, value_name = "HOST:PORT", value_parser = parse_address, conflicts_with = "serial")]
    host_control: Option<HostPort>,
    /// The serial port at whose other end it is.
    #[arg(long, global = true, value_name = "DEVICE")]
    serial: Option<PathBuf>,
    /// Speed of the serial port, Bd.
    #[arg(long, global = true, default_value_t = 9600, value_name = "BD")]
    baud: u32,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Mode, servo power, holds, alarms, the selected job.
    #[command(after_help = "Example:\n  bladescan robot status --hses 192.168.1.31:10040")]
    Status,
    /// Where the arm stands: pose in the base frame, and axes in pulses.
    #[command(after_help = "Example:\n  bladescan robot position --station config/stations/cell.toml --json")]
    Position,
    /// Active alarms, and the newest of the history.
    #[command(after_help = "Example:\n  bladescan robot alarms --history 10 --hses 192.168.1.31:10040")]
    Alarms(alarms::Args),
    /// Job files on the controller.
    #[command(
        after_help = "Example:\n  bladescan robot jobs put docs/robot/BLADESCAN.JBI --station config/stations/cell.toml --arm"
    )]
    Jobs(jobs::Args),
    /// State and pose again and again, a line when something has changed; Ctrl-C ends it.
    #[command(after_help = "Example:\n  bladescan robot watch --every-ms 200 --hses 192.168.1.31:10040")]
    Watch(watch::Args),
}

pub(super) fn main(args: &Args) -> Result<Exit, Failure> {
    let link = args.place.link()?;
    let json = args.json;
    runtime()?.block_on(async {
        if let What::Jobs(jobs) = &args.what {
            return jobs::main(jobs, &link, json).await;
        }
        let mut robot = Conversation::open(&link.place, exchange_settings(&link.station))?;
        match &args.what {
            What::Status => status::main(&mut robot, json).await,
            What::Position => position::main(&mut robot, json).await,
            What::Alarms(alarms) => alarms::main(&mut robot, alarms, json).await,
            What::Watch(watch) => watch::main(&mut robot, watch, json).await,
            What::Jobs(_) => unreachable!("jobs were dealt with before"),
        }
    })
}

/// The robot's place, with the times of a station.
struct Link {
    station: Station,
    place: RobotPlace,
}

impl Place {
    fn link(&self) -> Result<Link, Failure> {
        let mut station = match &self.station {
            Some(path) => read_station(path)?,
            None => builtin_station(),
        }
        .meaning;
        let place = match (self, &station.target) {
            (
                Self {
                    hses: Some(address), ..
                },
                _,
            ) => RobotPlace::Hses(resolve(address)?),
            (
                Self {
                    host_control: Some(address),
                    ..
                },
                _,
            ) => RobotPlace::HostControl(resolve(address)?),
            (
                Self {
                    serial: Some(device), ..
                },
                _,
            ) => RobotPlace::Serial {
                device: device.clone(),
                baud: self.baud,
            },
            (_, Target::Cell { robot, .. } | Target::SimulatedAt { robot, .. }) => robot_place(robot)?,
            (_, Target::Simulated) => {
                return Err(Failure::Usage(
                    "say where the robot is: --station, --hses, --host-control or --serial".into(),
                ));
            }
        };
        station.robot.protocol = match &place {
            RobotPlace::Hses(_) => RobotProtocol::Hses,
            RobotPlace::HostControl(_) => RobotProtocol::HostControl,
            RobotPlace::Serial { baud, .. } => RobotProtocol::Serial { baud: *baud },
        };
        Ok(Link { station, place })
    }
}

fn parse_address(text: &str) -> Result<HostPort, String> {
    HostPort::parse(text).ok_or_else(|| "give HOST:PORT, for example 192.168.1.31:10040".into())
}

impl From<ConversationError> for Failure {
    fn from(error: ConversationError) -> Self {
        Self::Broken(error.to_string())
    }
}

/// An answer of another kind than the question's: a bug of ours.
fn other_answer(question: &str) -> Failure {
    Failure::Broken(format!("{question}: the answer is to another question"))
}

/// For a table: a label, then what there is to say.
fn row(label: &str, text: impl std::fmt::Display) -> String {
    format!("{label:<10} {text}")
}
