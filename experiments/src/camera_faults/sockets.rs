//! Runs over sockets in real time: the simulator's own shell serves, and a few lines stand for bladescan's.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, UdpSocket};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use bladescan::camera::CameraOutput;
use bladescan::controller::{Controller, Input, Output};
use bladescan::robot::RobotOutput;
use bladescan::stamp::Stamp;
use hw_sim::camera::render::Frame;
use hw_sim::cell::Cell;
use hw_sim::shell::{Sockets, Wanted, serve_with};
use tokio::sync::oneshot;

use super::run::{Darkroom, Met, Outcome, Watch, controller, finish_job, scene};
use super::setup::{self, Setup, Spans};

/// Runs all seeds from this one on, some at a time, and gives what `judge` makes of each, in the order of the seeds.
pub(super) fn drive_all<T: Send>(
    seed: u64,
    run_count: u64,
    darkroom: Darkroom,
    judge: impl Fn(&Setup, &Outcome) -> T + Sync,
) -> Result<Vec<T>, String> {
    let darkroom = Arc::new(darkroom);
    let seeds: Vec<u64> = (seed..seed + run_count).collect();
    let mut judged = Vec::new();
    for some in seeds.chunks(AT_ONCE) {
        let outcomes: Vec<Result<T, String>> = thread::scope(|scope| {
            let handles: Vec<_> = some
                .iter()
                .map(|seed| {
                    let (darkroom, judge) = (Arc::clone(&darkroom), &judge);
                    scope.spawn(move || {
                        let setup = setup::draw(*seed, IN_REAL_TIME);
                        drive(&setup, darkroom).map(|outcome| judge(&setup, &outcome))
                    })
                })
                .collect();
            let joined = handles.into_iter().map(|handle| handle.join());
            joined
                .map(|run| run.unwrap_or_else(|_| Err("a run panicked".to_owned())))
                .collect()
        });
        for outcome in outcomes {
            judged.push(outcome?);
        }
    }
    Ok(judged)
}

/// The cell in a thread of its own.
struct Served {
    robot: SocketAddr,
    camera: SocketAddr,
    stop: oneshot::Sender<()>,
    thread: thread::JoinHandle<Result<(), String>>,
    rendered: Arc<Mutex<Vec<(u64, Frame)>>>,
}

fn start_cell(setup: &Setup, darkroom: Arc<Darkroom>) -> Result<Served, String> {
    let scene = scene(setup, SPEED);
    let rendered = Arc::new(Mutex::new(Vec::new()));
    let keep = Arc::clone(&rendered);
    let (stop, stopped) = oneshot::channel::<()>();
    let (tell_addresses, addresses) = channel();
    let thread = thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| error.to_string())?;
        runtime.block_on(async move {
            let wanted = Wanted {
                hses: Some(0),
                camera: Some(0),
                ..Wanted::default()
            };
            let sockets = Sockets::open(&wanted).await.map_err(|error| error.to_string())?;
            let found = sockets.robot_address().zip(sockets.camera_address());
            tell_addresses.send(found).map_err(|error| error.to_string())?;
            let render = move |job: &hw_sim::cell::RenderJob| {
                let frame = darkroom.frame(job);
                if let Ok(mut keep) = keep.lock() {
                    keep.push((job.draws.trigger_id, frame.clone()));
                }
                frame
            };
            let stop = async {
                stopped.await.ok();
            };
            serve_with(Cell::new(scene), render, sockets, None, stop)
                .await
                .map_err(|error| error.to_string())
        })
    });
    let found = addresses
        .recv_timeout(Duration::from_secs(10))
        .map_err(|error| error.to_string())?;
    let (robot, camera) = found.ok_or("the cell has no addresses")?;
    Ok(Served {
        robot,
        camera,
        stop,
        thread,
        rendered,
    })
}

struct Run {
    controller: Controller,
    robot: UdpSocket,
    camera_address: SocketAddr,
    camera: Option<TcpStream>,
    connection_count: u64,
    news: Sender<(u64, Input)>,
    since: Instant,
    watch: Watch,
    rendered: Arc<Mutex<Vec<(u64, Frame)>>>,
}

/// Runs `setup` to its end, or to the time that none may take.
fn drive(setup: &Setup, darkroom: Arc<Darkroom>) -> Result<Outcome, String> {
    let served = start_cell(setup, darkroom)?;
    let robot = UdpSocket::bind("127.0.0.1:0").map_err(|error| error.to_string())?;
    robot.connect(served.robot).map_err(|error| error.to_string())?;
    let (news, inputs) = channel();
    listen_to_robot(&robot, news.clone())?;
    let mut run = Run {
        controller: controller(setup)?,
        robot,
        camera_address: served.camera,
        camera: None,
        connection_count: 0,
        news,
        since: Instant::now(),
        watch: Watch::default(),
        rendered: Arc::clone(&served.rendered),
    };
    run.tell(Input::Begin);
    run.run_out(&inputs);
    let end_ns = run.now_ns();
    run.camera = None;
    served.stop.send(()).ok();
    served.thread.join().map_err(|_| "the cell panicked".to_owned())??;
    let met = setup.faults.iter().filter_map(|fault| match fault {
        hw_sim::fault::Fault::Camera(fault) => Some(*fault),
        _ => None,
    });
    Ok(run
        .watch
        .outcome(run.controller.ending(), end_ns, Met::Drawn(met.collect()), Vec::new()))
}

fn listen_to_robot(robot: &UdpSocket, news: Sender<(u64, Input)>) -> Result<(), String> {
    let robot = robot.try_clone().map_err(|error| error.to_string())?;
    robot
        .set_read_timeout(Some(RUN_MAX))
        .map_err(|error| error.to_string())?;
    thread::spawn(move || {
        let mut datagram = [0; 2048];
        while let Ok(byte_count) = robot.recv(&mut datagram) {
            if news
                .send((FROM_ROBOT, Input::RobotBytes(datagram[..byte_count].to_vec())))
                .is_err()
            {
                return;
            }
        }
    });
    Ok(())
}

impl Run {
    fn run_out(&mut self, inputs: &Receiver<(u64, Input)>) {
        while !self.controller.is_over() && self.since.elapsed() < RUN_MAX {
            let now_ns = self.now_ns();
            let wake_ns = self
                .controller
                .wake_at()
                .map_or(now_ns + 1_000_000_000, |stamp| stamp.ns);
            let wait = Duration::from_nanos(wake_ns.saturating_sub(now_ns));
            match inputs.recv_timeout(wait) {
                Ok((FROM_ROBOT, input)) => self.tell(input),
                Ok((connection, input)) if connection == self.connection_count && self.camera.is_some() => {
                    if matches!(input, Input::CameraClosed { .. }) {
                        self.camera = None;
                    }
                    self.tell(input);
                }
                Ok(_) => (),
                Err(RecvTimeoutError::Timeout) => self.tell(Input::Wake),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn tell(&mut self, input: Input) {
        let mut inputs = vec![input];
        while let Some(input) = inputs.pop() {
            let now_ns = self.now_ns();
            self.controller.handle_input(Stamp { ns: now_ns }, input);
            while let Some(output) = self.controller.poll_output() {
                self.take_rendered();
                self.watch.see(now_ns, &output);
                match output {
                    Output::Robot(RobotOutput::Bytes { bytes, .. }) => {
                        self.robot.send(&bytes).ok();
                    }
                    Output::Camera(output) => inputs.extend(self.do_with_camera(output)),
                    Output::Job { job_id, job } => {
                        self.news.send((FROM_ROBOT, finish_job(job_id, &job))).ok();
                    }
                    Output::Sync { view_index, attempt } => inputs.push(Input::Synced { view_index, attempt }),
                    _ => (),
                }
            }
        }
    }

    fn do_with_camera(&mut self, output: CameraOutput) -> Option<Input> {
        match (output, &mut self.camera) {
            (CameraOutput::Connect, _) => {
                self.connection_count += 1;
                match TcpStream::connect(self.camera_address) {
                    Ok(stream) => {
                        stream.set_nodelay(true).ok();
                        let reader = stream.try_clone().ok()?;
                        self.camera = Some(stream);
                        let (connection, news) = (self.connection_count, self.news.clone());
                        thread::spawn(move || listen_to_camera(connection, reader, &news));
                        return Some(Input::CameraConnected);
                    }
                    Err(error) => {
                        let reason = error.to_string();
                        return Some(Input::CameraClosed { reason });
                    }
                }
            }
            (CameraOutput::Bytes { bytes, .. }, Some(stream)) => {
                // An end of the connection is reported by its reader.
                stream.write_all(&bytes).ok();
            }
            (CameraOutput::Close, Some(stream)) => {
                stream.shutdown(Shutdown::Both).ok();
                self.camera = None;
            }
            (CameraOutput::Bytes { .. } | CameraOutput::Close, None) => (),
        }
        None
    }

    /// What was rendered is known before anything made of it arrives.
    fn take_rendered(&mut self) {
        let rendered = self.rendered.lock().map(|mut rendered| core::mem::take(&mut *rendered));
        for (trigger_id, frame) in rendered.unwrap_or_default() {
            self.watch.judge.handle_rendered(trigger_id, &frame);
        }
    }

    fn now_ns(&self) -> u64 {
        self.since.elapsed().as_nanos() as u64
    }
}

fn listen_to_camera(connection: u64, mut reader: TcpStream, news: &Sender<(u64, Input)>) {
    let mut piece = vec![0; 65_536];
    loop {
        let input = match reader.read(&mut piece) {
            Ok(0) => Input::CameraClosed {
                reason: "the camera closed the connection".to_owned(),
            },
            Ok(byte_count) => Input::CameraBytes(piece[..byte_count].to_vec()),
            Err(error) => Input::CameraClosed {
                reason: error.to_string(),
            },
        };
        let is_last = matches!(input, Input::CameraClosed { .. });
        if news.send((connection, input)).is_err() || is_last {
            return;
        }
    }
}

/// Inputs that are of no connection to the camera.
const FROM_ROBOT: u64 = 0;
/// Runs at the same time; they mostly wait.
const AT_ONCE: usize = 10;
const SPEED: f64 = 20.0;
const RUN_MAX: Duration = Duration::from_secs(240);
/// Spans that real time allows.
const IN_REAL_TIME: Spans = Spans {
    reset_s: 2.0,
    other_max_s: 1.5,
};
