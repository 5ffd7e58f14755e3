//! A run on real sockets: the one loop around [`Controller`].

use super::clock::Clock;
use super::console::Console;
use super::datagrams::DATAGRAM_BYTES;
use super::journal_file::{JournalError, JournalFile};
use super::journalled::Journalled;
use super::pool::Pool;
use super::recording_file::FileError;
use super::robot_wire::RobotWire;
use super::run_dir::write_new;
use super::wires::{self, Place};
use crate::camera::CameraOutput;
use crate::controller::{Command, Controller, Input, Output};
use crate::event::Ending;
use crate::job::FinishedJob;
use crate::robot::RobotOutput;
use crate::stamp::Stamp;
use std::collections::BTreeMap;
use std::io;
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
    /// What happens first, and when.
    pub beginning: Beginning,
    /// Where progress is shown.
    pub console: &'a mut Console,
    /// The run's folder.
    pub dir: &'a Path,
}

/// How a run begins, or goes on.
#[derive(Debug)]
pub struct Beginning {
    /// The first input.
    pub input: Input,
    /// When that is.
    pub at: Stamp,
    /// Jobs that have ended and were not handed back yet.
    pub done: BTreeMap<u32, FinishedJob>,
}

impl Default for Beginning {
    /// A new run.
    fn default() -> Self {
        Self {
            input: Input::Begin,
            at: Stamp::START,
            done: BTreeMap::new(),
        }
    }
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
    #[error("cannot write {0}")]
    File(FileError),
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
    let Live {
        controller,
        journal,
        start_unix_ns,
        links,
        pool,
        commands,
        beginning,
        console,
        dir,
    } = live;
    let shell = Shell {
        clock: Clock::start_at(beginning.at),
        journalled: Journalled::new(controller, journal, start_unix_ns),
        robot,
        camera: CameraWire::default(),
        camera_address: links.camera,
        news,
        finished,
        pool,
        console,
        dir,
        summary: Vec::new(),
        file_error: None,
    };
    for (job_id, done) in beginning.done {
        shell.finished.send(Input::JobDone { job_id, done }).ok();
    }
    shell.run(beginning.input, commands, stream_news, finished_jobs).await
}

struct Shell<'a> {
    clock: Clock,
    journalled: Journalled<JournalFile>,
    robot: RobotWire,
    camera: CameraWire,
    camera_address: SocketAddr,
    news: mpsc::Sender<Input>,
    /// At most a handful of jobs are ever open, so this queue is bounded by the controller.
    finished: mpsc::UnboundedSender<Input>,
    pool: &'a Pool,
    console: &'a mut Console,
    dir: &'a Path,
    summary: Vec<u8>,
    file_error: Option<LiveError>,
}

/// What the loop waits for.
enum News {
    Input(Input),
    /// It is time.
    Wake,
    /// The journal has come further.
    Journal,
}

impl Shell<'_> {
    async fn run(
        mut self,
        first: Input,
        mut commands: mpsc::Receiver<Command>,
        mut stream_news: mpsc::Receiver<Input>,
        mut finished_jobs: mpsc::UnboundedReceiver<Input>,
    ) -> Result<Outcome, LiveError> {
        let mut journal_news = self.journalled.journal().news();
        self.handle(News::Input(first)).await;
        let mut datagram = vec![0u8; DATAGRAM_BYTES];
        while !self.journalled.controller().is_over() {
            let wake = self.journalled.wake_at();
            let news = tokio::select! {
                biased;
                Some(command) = commands.recv() => News::Input(Input::Operator(command)),
                () = journal_news.recv(), if self.journalled.is_waiting() => News::Journal,
                input = self.robot.recv(&mut datagram) => News::Input(input),
                () = self.clock.sleep_until(wake) => News::Wake,
                Some(input) = finished_jobs.recv() => News::Input(input),
                Some(input) = stream_news.recv() => News::Input(input),
                Some(input) = self.camera.recv() => News::Input(input),
            };
            self.handle(news).await;
        }
        self.conclude()
    }

    /// One piece of news, and everything that follows from it done.
    async fn handle(&mut self, news: News) {
        let now = self.clock.now();
        match news {
            News::Input(input) => self.journalled.handle_input(now, input),
            News::Wake => self.journalled.handle_wake(now),
            News::Journal => self.journalled.handle_progress(now),
        }
        while let Some(output) = self.journalled.poll_output() {
            self.carry_out(output).await;
        }
    }

    async fn carry_out(&mut self, output: Output) {
        match output {
            Output::Robot(RobotOutput::Bytes { bytes, .. }) => self.robot.send(bytes).await,
            Output::Robot(RobotOutput::Connect) => self.robot.connect(&self.news),
            Output::Robot(RobotOutput::Close) => self.robot.close(),
            Output::Camera(CameraOutput::Connect) => self.camera.connect(self.camera_address),
            Output::Camera(CameraOutput::Close) => self.camera.outgoing = None,
            Output::Camera(CameraOutput::Bytes { bytes, .. }) => {
                if let Some(camera) = &self.camera.outgoing {
                    // The writer ends when the connection does; its reader reports that.
                    camera.send(bytes).await.ok();
                }
            }
            Output::Job { job_id, job } => {
                let finished = self.finished.clone();
                self.pool.start(job, move |done| {
                    // After the end of the run nobody waits for it.
                    finished.send(Input::JobDone { job_id, done }).ok();
                });
            }
            Output::Event(event) => self.console.show(&event),
            Output::File { name, bytes } => {
                if name == "summary.json" {
                    self.summary.clone_from(&bytes);
                }
                if let Err(error) = write_new(&self.dir.join(name), &bytes) {
                    self.file_error.get_or_insert(LiveError::File(error));
                }
            }
            Output::Sync { .. } | Output::ViewCloud { .. } | Output::ViewPose { .. } | Output::Model(_) => {}
        }
    }

    fn conclude(self) -> Result<Outcome, LiveError> {
        let has_failed = self.journalled.has_failed();
        let (controller, journal) = self.journalled.into_parts();
        let merged_count = controller
            .views()
            .iter()
            .filter(|view| view.model_from_view().is_some())
            .count();
        let path = journal.path().to_owned();
        let recording = match journal.finish() {
            Ok(path) => path,
            // The fault has been reported; what was written stays. After the run's last input nobody hears of a fault.
            Err(_) if has_failed && matches!(controller.ending(), Some(Ending::Faulted { .. })) => path,
            Err(error) => return Err(error.into()),
        };
        match self.file_error {
            Some(error) => Err(error),
            None => Ok(Outcome {
                ending: controller.ending().cloned().expect("a run that is over has an ending"),
                planned_count: controller.views().len(),
                merged_count,
                merged_min_count: controller.merged_min_count(),
                recording,
                summary: self.summary,
            }),
        }
    }
}

const NEWS_MAX: usize = 32;
