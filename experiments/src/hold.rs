//! How long a hold takes from the operator's word to the robot, over real sockets, while registrations keep all cores busy.

use std::error::Error;
use std::io::Write;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use bladescan::controller::{Command, Controller, Header};
use bladescan::event::Ending;
use bladescan::job::{Job, RegisterJob};
use bladescan::plan::Plan;
use bladescan::reconstruction::{Model, ViewSettings};
use bladescan::run::{Beginning, Console, JournalFile, Links, Live, Pool, RobotPlace};
use bladescan::seed::Seed;
use bladescan::settings::{Recipe, RobotProtocol, Station};
use clap::Args;
use hw_sim::blade::Builtin;
use hw_sim::camera::render::{Renderer, Surface};
use hw_sim::cell::Cell;
use hw_sim::robot::ports::LinkOptions;
use hw_sim::scene::Scene;
use hw_sim::shell::{Seen, Sockets, Wanted, serve_watched};
use nalgebra::Isometry3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::sync::{mpsc, oneshot};

use crate::speed::{cloud, sheet};

mod ear;

use ear::{Arrival, Ear, Place, Step};

#[derive(Args)]
pub(crate) struct HoldArguments {
    /// Holds over each link.
    #[arg(long, default_value_t = 200)]
    holds: usize,
    /// Only this link: hses, host-control or serial.
    #[arg(long)]
    link: Option<String>,
    /// Without the registrations.
    #[arg(long)]
    idle: bool,
    /// Speed of the serial line, Bd.
    #[arg(long, default_value_t = 9600)]
    baud: u32,
    /// Shows what passed on the serial line before the slowest hold.
    #[arg(long)]
    slowest: bool,
    /// Seeds the run and the moments of the holds.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// One link's figures, ms, sorted.
struct Figures {
    total_ms: Vec<f64>,
    /// From the end of the running exchange, or from the word if nothing was running.
    after_ms: Vec<f64>,
    /// Of that, how late the simulator was to hand over what had come over the serial line.
    late_ms: Vec<f64>,
    /// Of that, the rest but the line's own time: our host, and the system's pseudo-terminal.
    host_ms: Vec<f64>,
    slowest: Slowest,
}

/// The hold that took longest from the end of the running exchange.
#[derive(Default)]
struct Slowest {
    after_ms: f64,
    asked: Option<Instant>,
    steps: Vec<Step>,
}

pub(crate) fn run(arguments: &HoldArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "seed {}, {} holds over each link, {}",
        arguments.seed,
        arguments.holds,
        if arguments.idle {
            "cores idle"
        } else {
            "registrations on all cores"
        }
    )?;
    writeln!(
        out,
        "| link | from the operator's word: median | p99 | max | from the end of the running exchange: median | p99 | max | bar, p99 |"
    )?;
    writeln!(out, "|---|---|---|---|---|---|---|---|")?;
    let mut too_late = Vec::new();
    for (link, bar_ms) in LINKS {
        if arguments.link.as_ref().is_some_and(|only| only != link) {
            continue;
        }
        let figures = measure(arguments, link)?;
        let judged = percentile(&figures.after_ms, 0.99);
        writeln!(
            out,
            "| {link} | {} | {} | {bar_ms} ms |",
            words(&figures.total_ms),
            words(&figures.after_ms)
        )?;
        if link == "serial" {
            writeln!(
                out,
                "of the last, on the line {:.2} ms; the simulator late by {}; host and pseudo-terminal {}",
                line_ms(arguments.baud),
                words(&figures.late_ms),
                words(&figures.host_ms)
            )?;
            if arguments.slowest {
                show(&mut out, &figures.slowest)?;
            }
        }
        if judged > bar_ms {
            too_late.push(link);
        }
    }
    if too_late.is_empty() {
        Ok(())
    } else {
        Err(format!("too late: {}", too_late.join(", ")).into())
    }
}

fn measure(arguments: &HoldArguments, link: &str) -> Result<Figures, String> {
    let busy = (!arguments.idle).then(Busy::start);
    let robot = format!("[robot]\nlink = \"{link}\"\nserial_baud = {}\n", arguments.baud);
    let text = Station::BUILTIN_SIMULATED_TEXT.replacen("[robot]\n", &robot, 1);
    let station = Station::parse("sim.toml", &text).map_err(|error| error.to_string())?;
    let served = start_cell(arguments, &station, link)?;
    let links = Links {
        robot: match (&station.robot.protocol, &served.serial) {
            (RobotProtocol::Hses, _) => RobotPlace::Hses(served.hses),
            (RobotProtocol::HostControl, _) => RobotPlace::HostControl(served.host_control),
            (RobotProtocol::Serial { baud }, Some(device)) => RobotPlace::Serial {
                device: device.clone(),
                baud: *baud,
            },
            (RobotProtocol::Serial { .. }, None) => return Err("the cell has no serial line".into()),
        },
        camera: served.camera,
    };
    let (commands, words) = mpsc::channel(COMMANDS_MAX);
    let seed = arguments.seed;
    let live = thread::spawn(move || live(seed, &station, &text, links, words));
    let figures = hold_again_and_again(arguments, &commands, &served.arrivals);
    commands.blocking_send(Command::Abort).ok();
    let ended = live.join().map_err(|_| "the run panicked".to_owned())?;
    served.stop.send(()).ok();
    served.thread.join().map_err(|_| "the cell panicked".to_owned())??;
    drop(busy);
    match (figures, ended) {
        (Ok(figures), Ok(Ending::Aborted)) => Ok(figures),
        (figures, ended) => Err(format!(
            "{link}: the run ended {ended:?}, {}",
            figures.err().unwrap_or_default()
        )),
    }
}

/// Holds at drawn moments, resumes after each.
fn hold_again_and_again(
    arguments: &HoldArguments,
    commands: &mpsc::Sender<Command>,
    arrivals: &Receiver<Arrival>,
) -> Result<Figures, String> {
    let mut chance = ChaCha8Rng::seed_from_u64(arguments.seed);
    let (mut total_ms, mut after_ms) = (Vec::new(), Vec::new());
    let (mut late_ms, mut host_ms) = (Vec::new(), Vec::new());
    let mut slowest = Slowest::default();
    let mut pause = OPENING;
    for _ in 0..arguments.holds {
        // Nothing that is waited for comes now; what does is of the hold before.
        let until = Instant::now() + pause;
        while arrivals
            .recv_timeout(until.saturating_duration_since(Instant::now()))
            .is_ok()
        {}
        pause = Duration::from_micros(chance.random_range(PAUSE_US));
        let asked = Instant::now();
        say(commands, Command::Hold)?;
        let (at, free_at, steps) = loop {
            match arrivals.recv_timeout(PATIENCE).map_err(|_| "no hold came")? {
                Arrival::Hold { at, free_at, steps } if at >= asked => break (at, free_at, steps),
                Arrival::Hold { .. } | Arrival::Release => {}
            }
        };
        total_ms.push((at - asked).as_secs_f64() * 1e3);
        let free_at = free_at.map_or(asked, |free_at| free_at.max(asked));
        let after = at.saturating_duration_since(free_at).as_secs_f64() * 1e3;
        after_ms.push(after);
        let late = handed_over_late_ms(&steps, free_at);
        late_ms.push(late);
        host_ms.push(after - late - line_ms(arguments.baud));
        if after > slowest.after_ms {
            slowest = Slowest {
                after_ms: after,
                asked: Some(asked),
                steps,
            };
        }
        let patient_until = Instant::now() + PATIENCE;
        loop {
            say(commands, Command::Resume)?;
            match arrivals.recv_timeout(RESUME_AGAIN) {
                Ok(Arrival::Release) => break,
                _ if Instant::now() > patient_until => return Err("no release came".into()),
                _ => {}
            }
        }
    }
    total_ms.sort_by(f64::total_cmp);
    after_ms.sort_by(f64::total_cmp);
    late_ms.sort_by(f64::total_cmp);
    host_ms.sort_by(f64::total_cmp);
    Ok(Figures {
        total_ms,
        after_ms,
        late_ms,
        host_ms,
        slowest,
    })
}

fn say(commands: &mpsc::Sender<Command>, command: Command) -> Result<(), String> {
    commands
        .blocking_send(command)
        .map_err(|_| "the run has ended".to_owned())
}

/// A whole run on this thread, as the program makes it.
fn live(
    seed: u64,
    station: &Station,
    station_text: &str,
    links: Links,
    commands: mpsc::Receiver<Command>,
) -> Result<Ending, String> {
    // Four times the views: the run must outlast the holds.
    let text = RECIPE.replacen("step_deg = 10.0", "step_deg = 2.5", 1);
    let recipe = Recipe::parse("hpt-blade-a.toml", &text).map_err(|error| error.to_string())?;
    let plan = Plan::new(&recipe, station, Seed(seed)).map_err(|error| error.to_string())?;
    let header = Header {
        seed: Seed(seed),
        run_id: seed.max(1),
        recipe: recipe.name.clone(),
        station: station.name.clone(),
        ..Header::default()
    };
    let dir = std::env::temp_dir().join(format!("bladescan-hold-{}", std::process::id()));
    std::fs::create_dir(&dir).map_err(|error| error.to_string())?;
    let journal = JournalFile::create(&dir, &header, 0, &text, station_text).map_err(|error| error.to_string())?;
    let pool = Pool::new().map_err(|error| error.to_string())?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| error.to_string())?;
    let mut console = Console::quiet();
    let outcome = runtime.block_on(bladescan::run::run(Live {
        beginning: Beginning::default(),
        controller: Controller::new(header, &recipe, station, plan),
        journal,
        start_unix_ns: 0,
        links,
        pool: &pool,
        commands,
        console: &mut console,
        dir: &dir,
    }));
    std::fs::remove_dir_all(&dir).ok();
    outcome.map(|outcome| outcome.ending).map_err(|error| error.to_string())
}

/// Registrations of a view of 100,000 points to a model of 400,000, one after the other, on all cores.
struct Busy {
    stop: Arc<AtomicBool>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Busy {
    fn start() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let wanted = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let Ok(pool) = Pool::new() else { return };
            let whole = cloud(&sheet(640, 625, 0.0), 640);
            let model = Model::default().merged_with(&whole, &Isometry3::identity(), 0.1);
            let job = Job::Register(Box::new(RegisterJob {
                view_index: 1,
                cloud: Arc::new(cloud(&sheet(400, 250, 0.03), 400)),
                model: Arc::new(model),
                start: Isometry3::identity(),
                settings: ViewSettings::default(),
                coincident_distance_mm: 0.1,
                seed: Seed(1),
            }));
            while !wanted.load(Ordering::Relaxed) {
                pool.run(&job);
            }
        });
        let thread = Some(thread);
        Self { stop, thread }
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// The cell in a thread of its own.
struct Served {
    hses: SocketAddr,
    host_control: SocketAddr,
    serial: Option<PathBuf>,
    camera: SocketAddr,
    arrivals: Receiver<Arrival>,
    stop: oneshot::Sender<()>,
    thread: thread::JoinHandle<Result<(), String>>,
}

type Found = (SocketAddr, SocketAddr, Option<PathBuf>, SocketAddr);

fn start_cell(arguments: &HoldArguments, station: &Station, link: &str) -> Result<Served, String> {
    let scene = Scene {
        seed: arguments.seed,
        base_from_camera: station.base_from_camera,
        tool_from_blade: station.tool_from_blade,
        links: LinkOptions {
            host_pause_ns: 0,
            serial_baud: Some(arguments.baud),
            ..LinkOptions::default()
        },
        ..Scene::default()
    };
    let has_serial = link == "serial";
    let (stop, stopped) = oneshot::channel::<()>();
    let (tell_found, found) = channel::<Option<Found>>();
    let (tell_arrival, arrivals) = channel();
    let thread = thread::spawn(move || {
        let renderer = Renderer::new(&Builtin::HptA.mesh(), Surface::matte()).map_err(|error| error.to_string())?;
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| error.to_string())?;
        runtime.block_on(async move {
            let wanted = Wanted {
                hses: Some(0),
                host_control: Some(0),
                has_serial,
                camera: Some(0),
                ..Wanted::default()
            };
            let sockets = Sockets::open(&wanted).await.map_err(|error| error.to_string())?;
            let addresses = sockets.robot_address().zip(sockets.host_control_address());
            let serial = sockets.serial_path().map(PathBuf::from);
            let all = addresses.zip(sockets.camera_address());
            let all = all.map(|((hses, host_control), camera)| (hses, host_control, serial, camera));
            tell_found.send(all).map_err(|error| error.to_string())?;
            let mut ear = Ear::default();
            let see = move |at: Instant, seen: Seen<'_>| {
                if let Some(arrival) = ear.hear(at, seen) {
                    tell_arrival.send(arrival).ok();
                }
            };
            let stop = async {
                stopped.await.ok();
            };
            let render = move |job: &hw_sim::cell::RenderJob| job.run(&renderer);
            let mut cell = Cell::new(scene);
            cell.watch_serial();
            serve_watched(cell, render, see, sockets, None, stop)
                .await
                .map_err(|error| error.to_string())
        })
    });
    let found = found.recv_timeout(PATIENCE).map_err(|error| error.to_string())?;
    let (hses, host_control, serial, camera) = found.ok_or("the cell has no addresses")?;
    Ok(Served {
        hses,
        host_control,
        serial,
        camera,
        arrivals,
        stop,
        thread,
    })
}

/// The time of a hold's own characters: ENQ, ACK0, a block of 18, ACK1, EOT, of eleven bits each.
fn line_ms(baud: u32) -> f64 {
    f64::from(1 + 2 + 18 + 2 + 1) * 11.0 * 1e3 / f64::from(baud)
}

/// How late the simulator was from `since` on with what it had for the host. What it does itself has the line's times.
fn handed_over_late_ms(steps: &[Step], since: Instant) -> f64 {
    let for_host = steps
        .iter()
        .filter(|step| step.place == Place::AtHost && step.at >= since);
    for_host.map(|step| step.late.as_secs_f64() * 1e3).sum()
}

/// Times in ms from the operator's word on.
fn show(out: &mut impl Write, slowest: &Slowest) -> std::io::Result<()> {
    let Some(asked) = slowest.asked else { return Ok(()) };
    writeln!(out, "slowest: {:.2} ms", slowest.after_ms)?;
    for step in &slowest.steps {
        let place = match step.place {
            Place::FromHost => "read from the host",
            Place::AtRobot => "at the robot",
            Place::AtHost => "at the host",
        };
        let since = |from: Instant, to: Instant| to.saturating_duration_since(from).as_secs_f64() * 1e3;
        writeln!(
            out,
            "{:9.2} ms, handled {:.2} ms later, {place}: {}",
            since(asked, step.at) - since(step.at, asked),
            step.late.as_secs_f64() * 1e3,
            step.bytes.escape_ascii()
        )?;
    }
    Ok(())
}

fn words(sorted_ms: &[f64]) -> String {
    format!(
        "{:.2} ms | {:.2} ms | {:.2} ms",
        percentile(sorted_ms, 0.5),
        percentile(sorted_ms, 0.99),
        percentile(sorted_ms, 1.0)
    )
}

/// The smallest that this share of them does not exceed.
fn percentile(sorted: &[f64], share: f64) -> f64 {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied().unwrap_or(f64::NAN)
}

/// Names of the links, and how late the 99th percentile may be, ms.
const LINKS: [(&str, f64); 3] = [("hses", 20.0), ("host-control", 20.0), ("serial", 60.0)];
const RECIPE: &str = include_str!("../../config/recipes/hpt-blade-a.toml");
const COMMANDS_MAX: usize = 16;
const OPENING: Duration = Duration::from_secs(3);
const PAUSE_US: std::ops::Range<u64> = 30_000..300_000;
const RESUME_AGAIN: Duration = Duration::from_millis(30);
const PATIENCE: Duration = Duration::from_secs(20);
