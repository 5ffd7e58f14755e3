//! A run on real sockets: the one loop around [`Controller`].

use super::clock::Clock;
use super::console::Console;
use super::datagrams::DATAGRAM_BYTES;
use super::journal_file::{JournalError, JournalFile};
use super::pool::Pool;
use super::robot_wire::RobotWire;
use super::wires::{self, Place};
use crate::camera::CameraOutput;
use crate::controller::{Command, Controller, Input, Output};
use crate::event::Ending;
use crate::journal::{Record, input_record, output_records};
use crate::robot::RobotOutput;
use crate::stamp::Stamp;
use std::fs::OpenOptions;
use std::io::{self, Write as _};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use thiserror::Error;
use tokio::sync::mpsc;

/// Where the devices are.
#[derive(Debug, Clone)]
pub struct Links {
    /// The robot.
    pub robot: RobotPlace,
    /// The camera bridge.
    pub camera: SocketAddr,
}

/// Where the robot is, and what is spoken there.
#[derive(Debug, Clone)]
pub enum RobotPlace {
    /// HSES over UDP.
    Hses(SocketAddr),
    /// Host control over TCP.
    HostControl(SocketAddr),
    /// Host control over a serial line.
    Serial {
        /// Its path.
        device: PathBuf,
        /// Bits per second.
        baud: u32,
    },
}

/// Everything a run needs from outside.
pub struct Live<'a> {
    /// The decisions.
    pub controller: Controller,
    /// The recording.
    pub journal: JournalFile,
    /// When the run began, nanoseconds since 1970 UTC.
    pub start_unix_ns: u64,
    /// The devices.
    pub links: Links,
    /// Threads for the jobs.
    pub pool: &'a Pool,
    /// The operator's words.
    pub commands: mpsc::Receiver<Command>,
    /// Where progress is shown.
    pub console: &'a mut Console,
    /// The run's folder.
    pub dir: &'a Path,
}

/// How it went.
#[derive(Debug)]
pub struct Outcome {
    /// How the run ended.
    pub ending: Ending,
    /// How many views were planned.
    pub planned_count: usize,
    /// How many of them are in the model.
    pub merged_count: usize,
    /// How many had to be.
    pub merged_min_count: usize,
    /// The recording.
    pub recording: PathBuf,
    /// The content of `summary.json`.
    pub summary: Vec<u8>,
}

/// What the run could not be carried out for. Faults of devices are not errors but endings.
#[derive(Debug, Error)]
pub enum LiveError {
    /// A socket of ours.
    #[error("cannot open a socket: {0}")]
    Socket(io::Error),
    /// A file of the run.
    #[error("cannot write {path}: {source}")]
    File {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// The recording, at its end.
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// The camera's connection. Each one has a queue of its own, so that nothing of an older one is taken for the newest's.
#[derive(Default)]
struct CameraWire {
    outgoing: Option<mpsc::Sender<Vec<u8>>>,
    news: Option<mpsc::Receiver<Input>>,
}

impl CameraWire {
    fn connect(&mut self, address: SocketAddr) {
        let (sender, receiver) = mpsc::channel(NEWS_MAX);
        self.news = Some(receiver);
        self.outgoing = Some(wires::open(Place::Tcp(address), wires::CAMERA, sender));
    }

    /// The next input from the newest connection; `None` when it has none any more.
    async fn recv(&mut self) -> Option<Input> {
        match &mut self.news {
            Some(news) => news.recv().await,
            None => None,
        }
    }
}

/// Carries a run out to its end.
pub async fn run(live: Live<'_>) -> Result<Outcome, LiveError> {
    let (news, stream_news) = mpsc::channel(NEWS_MAX);
    let (robot, _guard) = RobotWire::open(&live.links.robot, &news)?;
    let (finished, finished_jobs) = mpsc::unbounded_channel();
    let shell = Shell {
        clock: Clock::start(),
        robot,
        camera: CameraWire::default(),
        news,
        finished,
        journal_failed: false,
        summary: Vec::new(),
        file_error: None,
        live,
    };
    shell.run(stream_news, finished_jobs).await
}

struct Shell<'a> {
    live: Live<'a>,
    clock: Clock,
    robot: RobotWire,
    camera: CameraWire,
    news: mpsc::Sender<Input>,
    /// At most a handful of jobs are ever open, so this queue is bounded by the controller.
    finished: mpsc::UnboundedSender<Input>,
    journal_failed: bool,
    summary: Vec<u8>,
    file_error: Option<LiveError>,
}

impl Shell<'_> {
    async fn run(
        mut self,
        mut stream_news: mpsc::Receiver<Input>,
        mut finished_jobs: mpsc::UnboundedReceiver<Input>,
    ) -> Result<Outcome, LiveError> {
        self.handle(Input::Begin).await;
        let mut datagram = vec![0u8; DATAGRAM_BYTES];
        while !self.live.controller.is_over() {
            let wake = self.live.controller.wake_at();
            let input = tokio::select! {
                biased;
                Some(command) = self.live.commands.recv() => Input::Operator(command),
                input = self.robot.recv(&mut datagram) => input,
                () = self.clock.sleep_until(wake) => Input::Wake,
                Some(input) = finished_jobs.recv() => input,
                Some(input) = stream_news.recv() => input,
                Some(input) = self.camera.recv() => input,
            };
            self.handle(input).await;
        }
        self.conclude()
    }

    /// One input: recorded, handled, and everything that follows from it done.
    async fn handle(&mut self, input: Input) {
        let now = self.clock.now();
        self.record(now, input_record(now, &input));
        self.live.controller.handle_input(now, input);
        while let Some(output) = self.live.controller.poll_output() {
            for record in output_records(now, &output, self.live.start_unix_ns) {
                self.record(now, record);
            }
            self.carry_out(now, output).await;
        }
    }

    /// After the first failure nothing more is recorded: a recording has an end, never a gap.
    fn record(&mut self, now: Stamp, record: Record) {
        if !self.journal_failed
            && let Err(error) = self.live.journal.record(record)
        {
            self.fail_journal(now, &error);
        }
    }

    async fn carry_out(&mut self, now: Stamp, output: Output) {
        match output {
            Output::Robot(RobotOutput::Bytes { bytes, kind }) => {
                if kind.waits_for_journal() && !self.flushed(now) {
                    return;
                }
                self.robot.send(bytes).await;
            }
            Output::Robot(RobotOutput::Connect) => self.robot.connect(&self.news),
            Output::Robot(RobotOutput::Close) => self.robot.close(),
            Output::Camera(CameraOutput::Connect) => self.camera.connect(self.live.links.camera),
            Output::Camera(CameraOutput::Close) => self.camera.outgoing = None,
            Output::Camera(CameraOutput::Bytes { bytes, act }) => {
                if act && !self.flushed(now) {
                    return;
                }
                if let Some(camera) = &self.camera.outgoing {
                    // The writer ends when the connection does; its reader reports that.
                    camera.send(bytes).await.ok();
                }
            }
            Output::Job { job_id, job } => {
                let finished = self.finished.clone();
                self.live.pool.start(job, move |done| {
                    // After the end of the run nobody waits for it.
                    finished.send(Input::JobDone { job_id, done }).ok();
                });
            }
            Output::Event(event) => self.live.console.show(&event),
            Output::File { name, bytes } => {
                if name == "summary.json" {
                    self.summary.clone_from(&bytes);
                }
                if let Err(error) = write_new(&self.live.dir.join(name), &bytes) {
                    self.file_error.get_or_insert(error);
                }
            }
            Output::ViewCloud { .. } | Output::ViewPose { .. } | Output::Model(_) => {}
        }
    }

    /// No journal, no motion: an act leaves only when the record of what caused it has left the process.
    fn flushed(&mut self, now: Stamp) -> bool {
        if self.journal_failed {
            return false;
        }
        match self.live.journal.flush() {
            Ok(()) => true,
            Err(error) => {
                self.fail_journal(now, &error);
                false
            }
        }
    }

    fn fail_journal(&mut self, now: Stamp, error: &JournalError) {
        if !self.journal_failed {
            self.journal_failed = true;
            let reason = error.to_string();
            self.live.controller.handle_input(now, Input::JournalFailed { reason });
        }
    }

    fn conclude(self) -> Result<Outcome, LiveError> {
        let controller = &self.live.controller;
        let merged_count = controller
            .views()
            .iter()
            .filter(|view| view.model_from_view().is_some())
            .count();
        let planned_count = controller.views().len();
        let merged_min_count = controller.merged_min_count();
        let ending = controller.ending().cloned().expect("a run that is over has an ending");
        let path = self.live.journal.path().to_owned();
        let recording = match self.live.journal.finish() {
            Ok(path) => path,
            // The fault has been reported; what was written stays.
            Err(_) if self.journal_failed => path,
            Err(error) => return Err(error.into()),
        };
        match self.file_error {
            Some(error) => Err(error),
            None => Ok(Outcome {
                ending,
                planned_count,
                merged_count,
                merged_min_count,
                recording,
                summary: self.summary,
            }),
        }
    }
}

pub(super) fn write_new(path: &Path, bytes: &[u8]) -> Result<(), LiveError> {
    let write = || {
        let mut file = OpenOptions::new().write(true).create_new(true).open(path)?;
        file.write_all(bytes)?;
        file.sync_all()
    };
    write().map_err(|source| LiveError::File {
        path: path.to_owned(),
        source,
    })
}

const NEWS_MAX: usize = 32;
