//! Whole runs on virtual time: the controller and the simulated cell exchange bytes without a socket, a thread or a sleep.

mod camera;
mod codes;
mod disk;
mod restart;
mod retakes;
mod words;

use bladescan::camera::CameraOutput;
use bladescan::controller::{Command, Controller, Header, Input, Output, ViewOutcome, ViewRecord};
use bladescan::event::{Ending, Event, HoldBy};
use bladescan::job::{FinishedJob, JobOutput, sha256};
use bladescan::journal::{Recording, Writer};
use bladescan::plan::Plan;
use bladescan::robot::{self, RobotOutput};
use bladescan::run::{Journalled, Pool, replay};
use bladescan::seed::Seed;
use bladescan::settings::{Recipe, Station};
use bladescan::stamp::Stamp;
use hw_sim::blade::Builtin;
use hw_sim::camera::render::Renderer;
use hw_sim::cell::{self, Cell};
use hw_sim::robot::controller::Panel;
use hw_sim::scene::Scene;
use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::io::{Cursor, Seek, Write};
use std::num::NonZeroUsize;

const RECIPE: &str = r#"
name = "small"
[blade]
cad = "builtin:hpt-a"
[views]
step_deg = 10.0
[presentation]
position_mm = [0.0, 0.0, 280.0]
rotation_deg = [0.0, 90.0, 0.0]
[camera]
optics = "fine"
roi_px = [320, 240, 560, 420]
points_min = 1000
[merge]
overlap_min_fraction = 0.3
"#;

/// What may be on its way.
enum Delivery {
    ToRobot(Vec<u8>),
    /// On the connection of this number.
    ToCamera(u64, Vec<u8>),
    CameraConnect(u64),
    CameraClose(u64),
    /// From the connection of this number: of an older one nothing is handed over.
    FromCamera(u64, Input),
    ToController(Input),
    /// A person does something at the robot.
    ToPanel(Panel),
}

/// Controller and cell with a wire between them, recorded on `W`.
struct Pair<W: Write + Seek = Cursor<Vec<u8>>> {
    run: Journalled<Writer<W>>,
    cell: Cell,
    renderer: Renderer,
    pool: Pool,
    now_ns: u64,
    wire: BTreeMap<(u64, u64), Delivery>,
    next_number: u64,
    /// The camera's newest connection.
    connection: u64,
    /// When the camera was told its settings.
    configured_at_ns: Vec<u64>,
    /// Share of datagrams lost in each direction.
    loss: f64,
    /// What never reaches the robot.
    lost_command: Option<robot::Command>,
    chance: ChaCha8Rng,
    events: Vec<(u64, Event)>,
    /// Moves that the simulated robot accepted.
    accepted_move_count: usize,
    /// Times the controller switched servo power off.
    servo_off_count: usize,
    /// The job of this name and view panics.
    panicking_job: Option<(&'static str, usize)>,
    /// How long a job takes.
    job_ns: u64,
    files: BTreeMap<&'static str, Vec<u8>>,
}

impl Pair {
    fn new(view_count: usize, faults: &[&str], loss: f64, seed: u64) -> Self {
        Self::with_recipe(RECIPE, view_count, faults, loss, seed)
    }

    fn with_recipe(recipe_text: &str, view_count: usize, faults: &[&str], loss: f64, seed: u64) -> Self {
        let station_text = Station::BUILTIN_SIMULATED_TEXT;
        Self::at_station(recipe_text, station_text, view_count, faults, loss, seed)
    }

    fn at_station(
        recipe_text: &str,
        station_text: &str,
        view_count: usize,
        faults: &[&str],
        loss: f64,
        seed: u64,
    ) -> Self {
        let out = Cursor::new(Vec::new());
        Self::recorded_on(out, (recipe_text, station_text), view_count, faults, loss, seed)
    }

    fn fault_name(ending: &Ending) -> &'static str {
        match ending {
            Ending::Faulted { fault } => fault.code.name(),
            _ => "none",
        }
    }

    /// Ends the recording and replays it.
    fn replay(self) {
        let (_, journal) = self.run.into_parts();
        let bytes = journal.finish().unwrap().into_inner();
        let recording = Recording::open(&bytes).unwrap();
        let report = replay(&recording, &self.pool).unwrap();
        assert!(report.identical && report.complete, "{:#?}", report.difference);
    }
}

impl<W: Write + Seek> Pair<W> {
    fn recorded_on(out: W, texts: (&str, &str), view_count: usize, faults: &[&str], loss: f64, seed: u64) -> Self {
        let (recipe_text, station_text) = texts;
        let recipe = Recipe::parse("small.toml", recipe_text).unwrap();
        let station = Station::parse("station.toml", station_text).unwrap();
        let views = NonZeroUsize::new(view_count).unwrap();
        let plan = Plan::new(&recipe, &station, Seed(seed)).unwrap().truncated(views);
        let header = Header {
            seed: Seed(seed),
            run_id: seed + 1,
            recipe: recipe.name.clone(),
            station: station.name.clone(),
            view_count: Some(view_count),
            ..Header::default()
        };
        let scene = Scene {
            seed,
            base_from_camera: station.base_from_camera,
            tool_from_blade: station.tool_from_blade,
            faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
            ..Scene::default()
        };
        let journal = Writer::begin(out, &header, START_UNIX_NS, recipe_text, station_text).unwrap();
        Self {
            renderer: Renderer::new(&Builtin::HptA.mesh(), scene.surface).unwrap(),
            cell: Cell::new(scene),
            run: Journalled::new(Controller::new(header, &recipe, &station, plan), journal, START_UNIX_NS),
            pool: Pool::new().unwrap(),
            now_ns: 0,
            wire: BTreeMap::new(),
            next_number: 0,
            connection: 0,
            configured_at_ns: Vec::new(),
            loss,
            lost_command: None,
            chance: ChaCha8Rng::seed_from_u64(seed),
            events: Vec::new(),
            accepted_move_count: 0,
            servo_off_count: 0,
            panicking_job: None,
            job_ns: JOB_NS,
            files: BTreeMap::new(),
        }
    }

    /// Runs to the end; `on_event` may answer an event with the operator's word.
    fn drive(&mut self, on_event: impl FnMut(&Event) -> Option<Command>) -> Ending {
        self.drive_from(Input::Begin, on_event)
    }

    /// Runs from `first` to the end.
    fn drive_from(&mut self, first: Input, mut on_event: impl FnMut(&Event) -> Option<Command>) -> Ending {
        self.run_from(first, &mut on_event, |_| false);
        self.run.controller().ending().unwrap().clone()
    }

    /// Runs until something has happened, as if the process had been killed then; false if the run ends before.
    fn drive_until(&mut self, is_last: impl FnMut(&Event) -> bool) -> bool {
        self.drive_from_until(Input::Begin, is_last)
    }

    fn drive_from_until(&mut self, first: Input, mut is_last: impl FnMut(&Event) -> bool) -> bool {
        let killed = std::cell::Cell::new(false);
        let mut on_event = |event: &Event| {
            killed.set(killed.get() || is_last(event));
            None
        };
        self.run_from(first, &mut on_event, |_| killed.get());
        killed.get()
    }

    fn run_from(
        &mut self,
        first: Input,
        on_event: &mut impl FnMut(&Event) -> Option<Command>,
        is_killed: impl Fn(&Self) -> bool,
    ) {
        self.tell(first, on_event);
        while !self.run.controller().is_over() && !is_killed(self) {
            let next = [
                self.wire.keys().next().map(|(ns, _)| *ns),
                self.run.wake_at().map(|stamp| stamp.ns),
                self.cell.wake_at(),
            ];
            self.now_ns = next
                .into_iter()
                .flatten()
                .min()
                .expect("a run always waits for something")
                .max(self.now_ns);
            assert!(
                self.now_ns < RUN_NS_MAX,
                "the run does not end: {:#?}",
                self.events.last()
            );
            if let Some(entry) = self.wire.first_entry().filter(|entry| entry.key().0 <= self.now_ns) {
                let delivery = entry.remove();
                self.deliver(delivery, on_event);
            } else if self.cell.wake_at().is_some_and(|ns| ns <= self.now_ns) {
                self.ask_cell(cell::Input::Wake);
            } else {
                self.run.handle_wake(Stamp { ns: self.now_ns });
                self.carry_out(on_event);
            }
        }
    }

    fn deliver(&mut self, delivery: Delivery, on_event: &mut impl FnMut(&Event) -> Option<Command>) {
        match delivery {
            Delivery::ToController(input) => self.tell(input, on_event),
            Delivery::ToPanel(panel) => self.ask_cell(cell::Input::Panel(panel)),
            Delivery::ToRobot(bytes) => self.ask_cell(cell::Input::RobotDatagram {
                from: ([127, 0, 0, 1], 5000).into(),
                bytes,
            }),
            Delivery::FromCamera(connection, input) if connection == self.connection => self.tell(input, on_event),
            Delivery::FromCamera(..) => {}
            Delivery::ToCamera(connection, bytes) => self.ask_cell(cell::Input::CameraBytes { connection, bytes }),
            Delivery::CameraConnect(connection) => {
                self.ask_cell(cell::Input::CameraConnected { connection });
                self.send(LATENCY_NS, Delivery::FromCamera(connection, Input::CameraConnected));
            }
            Delivery::CameraClose(connection) => {
                self.ask_cell(cell::Input::CameraClosed { connection });
                let reason = "closed".to_owned();
                let closed = Input::CameraClosed { reason };
                self.send(LATENCY_NS, Delivery::FromCamera(connection, closed));
            }
        }
    }

    fn tell(&mut self, input: Input, on_event: &mut impl FnMut(&Event) -> Option<Command>) {
        self.run.handle_input(Stamp { ns: self.now_ns }, input);
        self.carry_out(on_event);
    }

    fn carry_out(&mut self, on_event: &mut impl FnMut(&Event) -> Option<Command>) {
        let mut commands = Vec::new();
        while let Some(output) = self.run.poll_output() {
            match output {
                Output::Robot(RobotOutput::Bytes { bytes, .. }) => {
                    let says = |command| bytes == robot::hses::request(command, bytes[11]).unwrap().encode();
                    self.servo_off_count += usize::from(says(&SERVO_OFF));
                    let is_lost = self.lost_command.as_ref().is_some_and(says) || self.is_lost();
                    if !is_lost {
                        self.send(LATENCY_NS, Delivery::ToRobot(bytes));
                    }
                }
                Output::Camera(CameraOutput::Connect) => {
                    self.connection += 1;
                    self.send(LATENCY_NS, Delivery::CameraConnect(self.connection));
                }
                Output::Camera(CameraOutput::Bytes { bytes, .. }) => {
                    if bytes[6] == CONFIGURE {
                        self.configured_at_ns.push(self.now_ns);
                    }
                    self.send(LATENCY_NS, Delivery::ToCamera(self.connection, bytes));
                }
                Output::Camera(CameraOutput::Close) => {
                    self.send(LATENCY_NS, Delivery::CameraClose(self.connection));
                }
                Output::Job { job_id, job } => {
                    let mut done = FinishedJob {
                        times: Vec::new(),
                        ..self.pool.run(&job)
                    };
                    if self.panicking_job == Some((job.name(), job.view_index())) {
                        done.output = JobOutput::Panicked { text: "a bug".into() };
                    }
                    self.send(self.job_ns, Delivery::ToController(Input::JobDone { job_id, done }));
                }
                Output::Event(event) => {
                    commands.extend(on_event(&event));
                    self.events.push((self.now_ns, event));
                }
                Output::File { name, bytes } => {
                    self.files.insert(name, bytes);
                }
                Output::Robot(RobotOutput::Connect | RobotOutput::Close)
                | Output::Sync { .. }
                | Output::ViewCloud { .. }
                | Output::ViewPose { .. }
                | Output::Model(_) => {}
            }
        }
        for command in commands {
            self.send(0, Delivery::ToController(Input::Operator(command)));
        }
    }

    fn ask_cell(&mut self, input: cell::Input) {
        self.cell.handle_input(self.now_ns, input);
        while let Some(output) = self.cell.poll_output() {
            match output {
                cell::Output::RobotDatagram { bytes, .. } => {
                    let accepted_move = bytes[24] == 0x82 && bytes[25] == 0;
                    self.accepted_move_count += usize::from(accepted_move);
                    if !self.is_lost() {
                        self.send(LATENCY_NS, Delivery::ToController(Input::RobotBytes(bytes)));
                    }
                }
                cell::Output::CameraBytes { connection, bytes } => {
                    self.send(LATENCY_NS, Delivery::FromCamera(connection, Input::CameraBytes(bytes)));
                }
                cell::Output::CameraClose { connection } => {
                    let reason = "the camera closed the connection".to_owned();
                    let closed = Input::CameraClosed { reason };
                    self.send(LATENCY_NS, Delivery::FromCamera(connection, closed));
                }
                cell::Output::Render(job) => {
                    let frame = job.run(&self.renderer);
                    self.ask_cell(cell::Input::Rendered { job: job.job, frame });
                }
                cell::Output::Violation(text) => panic!("the client broke a protocol: {text}"),
                cell::Output::RobotPort(output) => panic!("nobody is at this port: {output:?}"),
                cell::Output::TruthGrew => {}
            }
        }
    }

    fn send(&mut self, latency_ns: u64, delivery: Delivery) {
        self.next_number += 1;
        self.wire.insert((self.now_ns + latency_ns, self.next_number), delivery);
    }

    fn is_lost(&mut self) -> bool {
        self.loss > 0.0 && self.chance.random::<f64>() < self.loss
    }

    fn merged_count(&self) -> usize {
        let merged = |view: &&ViewRecord| view.model_from_view().is_some();
        self.run.controller().views().iter().filter(merged).count()
    }
}

/// Type of the message that sets the camera.
const CONFIGURE: u8 = 0x10;
const SERVO_OFF: robot::Command = robot::Command::ServoOff;
const START_UNIX_NS: u64 = 1_767_225_600_000_000_000;
const LATENCY_NS: u64 = 200_000;
const JOB_NS: u64 = 300_000_000;
const RUN_NS_MAX: u64 = 3_600_000_000_000;

#[test]
fn a_run_merges_every_view_and_replays_bit_for_bit() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    assert_eq!(pair.drive(|_| None), Ending::Finished);
    assert_eq!((pair.merged_count(), pair.accepted_move_count), (3, 3));
    assert_eq!(
        pair.files.keys().copied().collect::<Vec<_>>(),
        ["model.ply", "poses.json", "summary.json"]
    );
    pair.replay();
}

#[test]
fn the_same_seed_gives_the_same_events_at_the_same_times() {
    let run = |seed| {
        let mut pair = Pair::new(2, &[], 0.0, seed);
        pair.drive(|_| None);
        let outcome = (sha256(&pair.files["model.ply"]), format!("{:?}", pair.events));
        pair.replay();
        outcome
    };
    let first = run(5);
    assert_eq!(first, run(5));
    assert_ne!(first.0, run(6).0);
}

#[test]
fn the_robot_moves_on_when_the_exposure_is_over_not_when_the_view_is_registered() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    pair.drive(|_| None);
    let when = |wanted: &dyn Fn(&Event) -> bool| pair.events.iter().find(|(_, event)| wanted(event)).unwrap().0;
    let exposed = when(&|event| matches!(event, Event::ExposureDone { view_index: 0, .. }));
    let moving = when(&|event| matches!(event, Event::MoveStarted { view_index: 1, .. }));
    let merged = when(&|event| matches!(event, Event::ViewMerged { view_index: 0, .. }));
    assert!(exposed <= moving && moving < merged);
    pair.replay();
}

#[test]
fn lost_datagrams_never_move_the_arm_twice_for_one_view() {
    for seed in 1..=12 {
        let mut pair = Pair::new(2, &[], 0.2, seed);
        let ending = pair.drive(|_| None);
        let named = ["none", "robot-silent", "robot-not-held"].contains(&Pair::fault_name(&ending));
        assert!(named, "seed {seed}: {ending:?}");
        // An absolute pose said anew only after the arm was seen standing elsewhere: never more than one motion a view.
        assert!(
            pair.accepted_move_count <= 2,
            "seed {seed}: {} moves",
            pair.accepted_move_count
        );
        if ending == Ending::Finished {
            assert_eq!((pair.merged_count(), pair.accepted_move_count), (2, 2), "seed {seed}");
            assert!(pair.servo_off_count > 0, "seed {seed}: servo power stays on");
        }
        pair.replay();
    }
}

#[test]
fn a_hold_in_mid_motion_stops_the_arm_and_the_run_goes_on_after_resume() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    let mut held_once = false;
    let ending = pair.drive(|event| match event {
        Event::MoveStarted { view_index: 1, .. } if !held_once => {
            held_once = true;
            Some(Command::Hold)
        }
        Event::Held => Some(Command::Resume),
        _ => None,
    });
    assert_eq!(ending, Ending::Finished);
    assert_eq!(pair.merged_count(), 3);
    let order: Vec<&str> = pair
        .events
        .iter()
        .filter_map(|(_, event)| match event {
            Event::HoldAsked { .. } => Some("asked"),
            Event::Held => Some("held"),
            Event::Resumed => Some("resumed"),
            _ => None,
        })
        .collect();
    assert_eq!(order, ["asked", "held", "resumed"]);
    pair.replay();
}

#[test]
fn an_abort_while_held_ends_the_run_and_keeps_what_was_merged() {
    let mut pair = Pair::new(4, &[], 0.0, 1);
    let ending = pair.drive(|event| match event {
        Event::ViewMerged { view_index: 1, .. } => Some(Command::Hold),
        Event::Held => Some(Command::Abort),
        _ => None,
    });
    assert_eq!(ending, Ending::Aborted);
    assert!(pair.merged_count() >= 2);
    let poses: serde_json::Value = serde_json::from_slice(&pair.files["poses.json"]).unwrap();
    assert_eq!(poses["views"].as_array().unwrap().len(), 4);
    pair.replay();
}

#[test]
fn the_stop_key_holds_again_after_a_resume_and_ends_the_run_only_while_held() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    let mut held_count = 0;
    let ending = pair.drive(|event| match event {
        Event::MoveStarted { .. } if held_count < 2 => Some(Command::Stop),
        Event::Held => {
            held_count += 1;
            Some(if held_count == 1 {
                Command::Resume
            } else {
                Command::Stop
            })
        }
        _ => None,
    });
    assert_eq!((ending, held_count), (Ending::Aborted, 2));
    pair.replay();
}

#[test]
fn servo_power_lost_during_a_hold_is_switched_on_again_by_resume() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    // The emergency stop is pressed and released while the arm is held: servo power is off afterwards.
    for (at_s, panel) in [(2.0, Panel::EmergencyStop(true)), (2.5, Panel::EmergencyStop(false))] {
        pair.send((at_s * 1e9) as u64, Delivery::ToPanel(panel));
    }
    let resume_ns = 4_000_000_000;
    let resume = Delivery::ToController(Input::Operator(Command::Resume));
    pair.send(resume_ns, resume);
    let ending = pair.drive(|event| matches!(event, Event::RobotReady).then_some(Command::Hold));
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3));
    pair.replay();
}

#[test]
fn a_hold_at_the_pendant_stops_the_run_until_it_is_released_there_and_resumed_here() {
    let mut pair = Pair::new(3, &[], 0.0, 1);
    pair.send(300_000_000, Delivery::ToPanel(Panel::Hold(true)));
    // Resumed too early: the pendant still holds.
    pair.send(2_000_000_000, Delivery::ToController(Input::Operator(Command::Resume)));
    pair.send(4_000_000_000, Delivery::ToPanel(Panel::Hold(false)));
    pair.send(5_000_000_000, Delivery::ToController(Input::Operator(Command::Resume)));
    let ending = pair.drive(|_| None);
    assert_eq!((ending, pair.merged_count()), (Ending::Finished, 3));
    let asked = |event: &Event| matches!(event, Event::HoldAsked { by: HoldBy::Robot });
    assert_eq!(pair.events.iter().filter(|(_, event)| asked(event)).count(), 2);
    pair.replay();
}

#[test]
fn every_fault_of_the_cell_ends_in_its_name_or_is_overcome() {
    for (fault, expected) in [
        ("camera-gone@1", "none"),
        ("camera-error=405@1", "none"),
        ("corrupt-chunk@1", "none"),
        ("empty-frame@1", "none"),
        ("config-echo", "camera-settings"),
        ("controller-busy", "camera-refused"),
        ("robot-alarm=4315@1", "robot-alarm"),
        ("estop@1", "robot-servo"),
        ("remote-off", "robot-not-remote"),
        ("servo-refused", "robot-servo"),
        ("elsewhere=3@1", "robot-elsewhere"),
        ("late-frame=20@1", "none"),
    ] {
        let mut pair = Pair::new(2, &[fault], 0.0, 1);
        let ending = pair.drive(|_| None);
        assert_eq!(Pair::fault_name(&ending), expected, "{fault}: {ending:?}");
        if expected == "none" {
            assert_eq!(pair.merged_count(), 2, "{fault}");
        }
        assert!(pair.files.contains_key("summary.json"), "{fault}");
        pair.replay();
    }
}

#[test]
fn a_fault_in_the_last_registration_is_how_the_run_ends_though_all_was_taken() {
    let mut pair = Pair::new(2, &[], 0.0, 1);
    pair.panicking_job = Some(("register", 1));
    let ending = pair.drive(|_| None);
    // Not replayed: there the job does not panic.
    assert_eq!(Pair::fault_name(&ending), "job-panicked");
    assert_eq!(pair.merged_count(), 1);
}

#[test]
fn a_panic_in_a_job_costs_the_view_of_that_job_and_no_other_frame() {
    for job in ["prepare", "register"] {
        let mut pair = Pair::new(4, &[], 0.0, 1);
        pair.panicking_job = Some((job, 1));
        // Longer than taking all views: every frame has come when the job panics.
        pair.job_ns = 10 * JOB_NS;
        assert_eq!(Pair::fault_name(&pair.drive(|_| None)), "job-panicked", "{job}");
        assert_eq!(pair.merged_count(), 3, "{job}");
        let ViewOutcome::Discarded { reason } = &pair.run.controller().views()[1].outcome else {
            panic!("{job}: {:?}", pair.run.controller().views()[1]);
        };
        assert_eq!(reason, "a job panicked: a bug", "{job}");
    }
}

#[test]
fn a_frame_taken_again_has_an_attempt_of_its_own() {
    let mut pair = Pair::new(3, &["corrupt-chunk@1"], 0.0, 1);
    pair.drive(|_| None);
    let attempts: Vec<u16> = pair.run.controller().views().iter().map(|view| view.attempt).collect();
    assert_eq!(attempts, [0, 1, 0]);
    pair.replay();
}
