//! One run on virtual time: controller and simulated cell exchange bytes without a socket or a sleep.

use std::collections::BTreeMap;

use bladescan::camera::CameraOutput;
use bladescan::controller::{Controller, Input, Output};
use bladescan::job::Job;
use bladescan::journal::Record;
use bladescan::robot::RobotOutput;
use bladescan::run::{Journal, JournalError, Journalled, Progress};
use bladescan::stamp::Stamp;
use hw_sim::cell::{self, Cell};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::run::{Darkroom, Met, Outcome, Watch, controller, finish_job, scene};
use super::setup::Setup;
use crate::camera_line::{CameraLine, Passing, pieces};

/// What may be on its way.
enum Delivery {
    ToRobot(Vec<u8>),
    Camera(Passing),
    ToController(Input),
}

/// A journal on virtual time.
pub(crate) trait TimedJournal: Journal {
    /// It is this time.
    fn handle_time(&self, now_ns: u64);

    /// When it comes further by itself.
    fn wake_at(&self) -> Option<u64>;
}

/// A journal that keeps nothing.
#[derive(Debug, Default)]
struct Nowhere {
    record_count: u64,
}

impl Journal for Nowhere {
    fn record(&mut self, _record: Record) -> Result<(), JournalError> {
        self.record_count += 1;
        Ok(())
    }

    fn flush(&mut self) -> Result<(), JournalError> {
        Ok(())
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        Ok(())
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        Ok(Progress {
            flushed_count: self.record_count,
            synced_count: self.record_count,
        })
    }
}

impl TimedJournal for Nowhere {
    fn handle_time(&self, _now_ns: u64) {}

    fn wake_at(&self) -> Option<u64> {
        None
    }
}

/// What takes part in a run besides the controller.
pub(crate) struct Around<'a> {
    pub(crate) setup: &'a Setup,
    pub(crate) darkroom: &'a Darkroom,
    /// Does a job.
    pub(crate) finish: &'a dyn Fn(u32, &Job) -> Input,
    /// Sees what leaves, when, and whether the recording had failed by then.
    pub(crate) see: &'a mut dyn FnMut(u64, &Output, bool),
}

struct Run<'a, J> {
    around: Around<'a>,
    run: Journalled<J>,
    cell: Cell,
    now_ns: u64,
    wire: BTreeMap<(u64, u64), Delivery>,
    delivery_count: u64,
    camera: CameraLine,
    chance: ChaCha8Rng,
    watch: Watch,
    violations: Vec<String>,
}

/// Runs `setup` to its end, or to the time that none may take.
pub(super) fn drive(setup: &Setup, darkroom: &Darkroom) -> Result<Outcome, String> {
    let around = Around {
        setup,
        darkroom,
        finish: &finish_job,
        see: &mut |_, _, _| (),
    };
    drive_on(around, controller(setup)?, Nowhere::default()).map(|(outcome, _)| outcome)
}

/// The same with a journal, which is handed back.
pub(crate) fn drive_on<J: TimedJournal>(
    around: Around<'_>,
    controller: Controller,
    journal: J,
) -> Result<(Outcome, J), String> {
    let mut run = Run {
        run: Journalled::new(controller, journal, START_UNIX_NS),
        cell: Cell::new(scene(around.setup, 1.0)),
        chance: ChaCha8Rng::seed_from_u64(around.setup.seed),
        around,
        now_ns: 0,
        wire: BTreeMap::new(),
        delivery_count: 0,
        camera: CameraLine::default(),
        watch: Watch::default(),
        violations: Vec::new(),
    };
    run.tell(Input::Begin);
    while !run.run.controller().is_over() && run.now_ns < RUN_NS_MAX && run.step() {}
    let met = Met::Happened(run.cell.met_camera_faults());
    let (controller, journal) = run.run.into_parts();
    let outcome = run.watch.outcome(controller.ending(), run.now_ns, met, run.violations);
    Ok((outcome, journal))
}

impl<J: TimedJournal> Run<'_, J> {
    /// The next thing that happens; false where nothing ever will.
    fn step(&mut self) -> bool {
        let next = [
            self.wire.keys().next().map(|(at_ns, _)| *at_ns),
            self.run.wake_at().map(|stamp| stamp.ns),
            self.run.journal().wake_at(),
            self.cell.wake_at(),
        ];
        let Some(next_ns) = next.into_iter().flatten().min() else {
            return false;
        };
        self.now_ns = next_ns.max(self.now_ns);
        self.run.journal().handle_time(self.now_ns);
        if let Some(first) = self.wire.first_entry().filter(|first| first.key().0 <= self.now_ns) {
            match first.remove() {
                Delivery::ToController(input) => self.tell(input),
                Delivery::Camera(Passing::ToCamera(input)) => self.ask_cell(input),
                Delivery::Camera(Passing::FromCamera(connection, input)) if self.camera.hears(connection, &input) => {
                    self.tell(input)
                }
                Delivery::Camera(Passing::FromCamera(..)) => (),
                Delivery::ToRobot(bytes) => self.ask_cell(cell::Input::RobotDatagram {
                    from: ([127, 0, 0, 1], 5000).into(),
                    bytes,
                }),
            }
        } else if self.cell.wake_at().is_some_and(|at_ns| at_ns <= self.now_ns) {
            self.ask_cell(cell::Input::Wake);
        } else {
            // Whatever it is time for, the journal included.
            self.run.handle_wake(Stamp { ns: self.now_ns });
            self.carry_out();
        }
        true
    }

    fn tell(&mut self, input: Input) {
        self.run.handle_input(Stamp { ns: self.now_ns }, input);
        self.carry_out();
    }

    fn carry_out(&mut self) {
        while let Some(output) = self.run.poll_output() {
            self.watch.see(self.now_ns, &output);
            (self.around.see)(self.now_ns, &output, self.run.has_failed());
            match output {
                Output::Robot(RobotOutput::Bytes { bytes, .. }) => self.send(LATENCY_NS, Delivery::ToRobot(bytes)),
                Output::Camera(output) => self.do_with_camera(output),
                Output::Job { job_id, job } => {
                    let done = (self.around.finish)(job_id, &job);
                    self.send(JOB_NS, Delivery::ToController(done));
                }
                _ => (),
            }
        }
    }

    fn do_with_camera(&mut self, output: CameraOutput) {
        for (latency_count, passing) in self.camera.handle_output(output) {
            self.send(latency_count * LATENCY_NS, Delivery::Camera(passing));
        }
    }

    fn ask_cell(&mut self, input: cell::Input) {
        self.cell.handle_input(self.now_ns, input);
        while let Some(output) = self.cell.poll_output() {
            match output {
                cell::Output::RobotDatagram { bytes, .. } => {
                    self.send(LATENCY_NS, Delivery::ToController(Input::RobotBytes(bytes)));
                }
                cell::Output::CameraBytes { connection, bytes } => self.carry(connection, &bytes),
                cell::Output::CameraClose { connection } => {
                    let reason = "the camera closed the connection".to_owned();
                    self.send(
                        LATENCY_NS,
                        Delivery::Camera(Passing::FromCamera(connection, Input::CameraClosed { reason })),
                    );
                }
                cell::Output::Render(job) => {
                    let frame = self.around.darkroom.frame(&job);
                    self.watch.judge.handle_rendered(job.draws.trigger_id, &frame);
                    self.ask_cell(cell::Input::Rendered { job: job.job, frame });
                }
                cell::Output::Violation(text) => self.violations.push(text),
                cell::Output::RobotPort(output) => self.violations.push(format!("nobody is at this port: {output:?}")),
                cell::Output::TruthGrew => (),
            }
        }
    }

    fn carry(&mut self, connection: u64, bytes: &[u8]) {
        for piece in pieces(bytes, self.around.setup.piece_bytes_max, &mut self.chance) {
            let input = Input::CameraBytes(piece.to_vec());
            self.send(LATENCY_NS, Delivery::Camera(Passing::FromCamera(connection, input)));
        }
    }

    fn send(&mut self, latency_ns: u64, delivery: Delivery) {
        self.delivery_count += 1;
        self.wire
            .insert((self.now_ns + latency_ns, self.delivery_count), delivery);
    }
}

/// Dates the viewer's messages.
pub(crate) const START_UNIX_NS: u64 = 1_767_225_600_000_000_000;
const LATENCY_NS: u64 = 200_000;
const JOB_NS: u64 = 50_000_000;
/// No run may take longer: four faults of the longest kind, each waited for as long as the station allows.
pub(super) const RUN_NS_MAX: u64 = 900_000_000_000;
