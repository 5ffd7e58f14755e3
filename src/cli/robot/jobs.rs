//! `bladescan robot jobs`: job files on the controller.

use super::super::live_run::resolve;
use super::super::{Exit, Failure, print};
use super::{Link, other_answer, parse_address};
use crate::robot::hses::FileSettings;
use crate::robot::{Command, FileCommand, FileContent, FileEnding, FileName, JobName, Reply};
use crate::run::{Conversation, RobotPlace, TransferError, Transferred, transfer};
use crate::session::exchange_settings;
use crate::settings::HostPort;
use clap::Subcommand;
use serde_json::json;
use std::fs::OpenOptions;
use std::io::Write as _;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(subcommand)]
    what: What,
    /// Where HSES has its port for files [default: one above the robot's].
    #[arg(long, global = true, value_name = "HOST:PORT", value_parser = parse_address)]
    hses_file: Option<HostPort>,
    /// Allow what changes the controller (put, delete). Without it nothing is even connected.
    #[arg(long, global = true)]
    arm: bool,
}

#[derive(Debug, Subcommand)]
enum What {
    /// The jobs on the controller.
    List,
    /// Fetch a job and write it to a file.
    Get {
        /// Its name.
        job: String,
        /// Where to [default: JOB.JBI here]; must not exist.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
    /// Bring a job file to the controller; its name there is the file's.
    Put {
        /// For example docs/robot/BLADESCAN.JBI.
        file: PathBuf,
    },
    /// Delete a job on the controller.
    Delete {
        /// Its name.
        job: String,
    },
}

pub(super) async fn main(args: &Args, link: &Link, json: bool) -> Result<Exit, Failure> {
    if matches!(args.what, What::Put { .. } | What::Delete { .. }) && !args.arm {
        return Err(Failure::Usage(
            "this changes the controller: give --arm (nothing was connected)".into(),
        ));
    }
    match &args.what {
        What::List => list(args, link, json).await,
        What::Get { job, out } => {
            let name = file_name(job)?;
            let Transferred::Content(content) = files(args, link, FileCommand::Save(name.clone())).await? else {
                return Err(other_answer("get"));
            };
            let path = out.clone().unwrap_or_else(|| PathBuf::from(name.as_str()));
            write_new(&path, &content)?;
            told(
                json,
                "got",
                job,
                &format!("{} bytes in {}", content.len(), path.display()),
            )
        }
        What::Put { file } => {
            let source = |source| Failure::Read {
                path: file.clone(),
                source,
            };
            let content = std::fs::read(file).map_err(source)?;
            let named = file.file_name().and_then(|name| name.to_str()).unwrap_or_default();
            let name = FileName::parse(named).map_err(|error| Failure::Usage(error.to_string()))?;
            let content =
                FileContent::new(content).map_err(|error| Failure::Usage(format!("{}: {error}", file.display())))?;
            let load = FileCommand::Load { name, content };
            files(args, link, load).await?;
            told(json, "put", named, "on the controller")
        }
        What::Delete { job } => {
            match &link.place {
                RobotPlace::Hses(_) | RobotPlace::Serial { .. } => {
                    files(args, link, FileCommand::Delete(file_name(job)?)).await?;
                }
                RobotPlace::HostControl(_) => {
                    let job = job_name(job)?;
                    let mut robot = Conversation::open(&link.place, exchange_settings(&link.station))?;
                    robot.say(Command::DeleteJob { job }).await?;
                }
            }
            told(json, "deleted", job, "no longer on the controller")
        }
    }
}

async fn list(args: &Args, link: &Link, json: bool) -> Result<Exit, Failure> {
    let mut names = match &link.place {
        RobotPlace::Hses(_) | RobotPlace::Serial { .. } => {
            match files(args, link, FileCommand::List(FileEnding::Jbi)).await? {
                Transferred::Names(names) => names,
                _ => return Err(other_answer("list")),
            }
        }
        RobotPlace::HostControl(_) => {
            let mut robot = Conversation::open(&link.place, exchange_settings(&link.station))?;
            match robot.say(Command::JobNames).await? {
                Reply::JobNames(names) => names,
                _ => return Err(other_answer("list")),
            }
        }
    };
    for name in &mut names {
        if let Some(stem) = name.strip_suffix(".JBI") {
            *name = stem.to_owned();
        }
    }
    if json {
        print(&json!({ "jobs": names }).to_string())?;
    } else if names.is_empty() {
        print("no jobs")?;
    } else {
        print(&names.join("\n"))?;
    }
    Ok(Exit::Done)
}

async fn files(args: &Args, link: &Link, command: FileCommand) -> Result<Transferred, Failure> {
    let port = args.hses_file.as_ref().map(resolve).transpose()?;
    let exchange = exchange_settings(&link.station);
    let settings = FileSettings {
        answer_timeout_ms: exchange.answer_timeout_ms,
        attempts: exchange.ask_attempts,
    };
    Ok(transfer(&link.place, port, settings, command).await?)
}

fn file_name(job: &str) -> Result<FileName, Failure> {
    let job = job_name(job)?;
    FileName::parse(&format!("{job}.JBI")).map_err(|error| Failure::Usage(error.to_string()))
}

fn job_name(job: &str) -> Result<JobName, Failure> {
    JobName::parse(job).map_err(|error| Failure::Usage(error.to_string()))
}

fn write_new(path: &Path, content: &[u8]) -> Result<(), Failure> {
    let write = || {
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        file.write_all(content)
    };
    write().map_err(|error| Failure::Usage(format!("cannot write {}: {error}", path.display())))
}

fn told(json: bool, what: &str, job: &str, text: &str) -> Result<Exit, Failure> {
    if json {
        print(&json!({ "done": what, "job": job }).to_string())?;
    } else {
        print(&format!("{job}: {text}"))?;
    }
    Ok(Exit::Done)
}

impl From<TransferError> for Failure {
    fn from(error: TransferError) -> Self {
        Self::Broken(error.to_string())
    }
}
