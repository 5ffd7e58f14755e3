//! One run of the arm against the simulated controller on virtual time, over a wire that misbehaves.
//!
//! The operator and the session are a few lines here: go to each target in turn, hold when held elsewhere, resume a while after,
//! let go after a fault. Everything that is judged is read from the simulator, not from the arm.

use super::carry::Carrier;
use super::setup::{Ended, Happening, Link, Outcome, Phase, Setup, Tamper, When, arm_settings, targets};
use bladescan::fault::FaultCode;
use bladescan::robot::RobotOutput;
use bladescan::session::{Arm, ArmEvent};
use bladescan::stamp::Stamp;
use hw_sim::robot::controller::Settings;
use hw_sim::robot::hses::Port;
use hw_sim::robot::ports::{LinkOptions, PortInput, PortOutput, Ports};
use hw_sim::robot::pose::Pose;
use nalgebra::Isometry3;
use std::collections::BTreeMap;

/// The parts of a run as the session knows them.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    Identifying,
    Readying,
    Going,
    Standing,
    Holding,
    Held,
    Resuming,
    Ending,
    Over,
}

#[derive(Debug)]
enum Delivery {
    ToArm(Vec<u8>),
    ToPorts(PortInput),
    Connected(u64),
    Closed(u64),
    Incident(usize),
    Resume,
    Exposed(usize),
}

struct Run<'a> {
    setup: &'a Setup,
    arm: Arm,
    ports: Ports,
    carrier: Carrier,
    targets: Vec<Isometry3<f64>>,
    tolerances: (f64, f64),
    now_ns: u64,
    queue: BTreeMap<(u64, u64), Delivery>,
    queued_count: u64,
    stage: Stage,
    target_index: usize,
    fault: Option<FaultCode>,
    resume_count: u32,
    connection: Option<u64>,
    connection_count: u64,
    incident_index: usize,
    known_move_count: u32,
    known_pose: Option<Pose>,
    begun_in_order: u32,
    was_moving: bool,
    outcome: Outcome,
}

/// Runs `setup` to its end.
pub fn drive(setup: &Setup) -> Outcome {
    let settings = arm_settings(setup);
    let targets = targets(setup.target_count, setup.seed);
    let jobs = vec![("BLADESCAN".to_owned(), SCAN_JOB.to_owned())];
    let settings_of_robot = Settings {
        seed: setup.seed,
        faults: setup.faults.clone(),
        jobs,
        ..Settings::default()
    };
    let mut run = Run {
        tolerances: (settings.position_tolerance_mm, settings.rotation_tolerance_rad),
        arm: Arm::new(settings, targets.clone()),
        ports: Ports::new(settings_of_robot, LinkOptions::default()),
        carrier: Carrier::new(setup.weather, setup.seed),
        setup,
        targets,
        now_ns: 0,
        queue: BTreeMap::new(),
        queued_count: 0,
        stage: Stage::Identifying,
        target_index: 0,
        fault: None,
        resume_count: 0,
        connection: None,
        connection_count: 0,
        incident_index: 0,
        known_move_count: 0,
        known_pose: None,
        begun_in_order: 0,
        was_moving: false,
        outcome: Outcome {
            ended: Ended::Hung,
            end_ns: 0,
            repeated_count: 0,
            moved_while_held_count: 0,
            wrong_arrival_count: 0,
            violations: Vec::new(),
            digest: DIGEST_AT_START,
            events: Vec::new(),
            incident_ns: Vec::new(),
            sent: Vec::new(),
        },
    };
    run.run_out();
    run.outcome
}

impl Run<'_> {
    fn run_out(&mut self) {
        self.schedule_incident();
        self.see(Phase::Identifying);
        self.arm.identify(self.stamp());
        self.settle();
        while self.stage != Stage::Over && self.now_ns < RUN_NS_MAX {
            let next = [
                self.queue.keys().next().map(|(at_ns, _)| *at_ns),
                self.arm.wake_at().map(|stamp| stamp.ns),
                self.ports.wake_at(),
            ];
            let Some(next_ns) = next.into_iter().flatten().min() else {
                break;
            };
            self.now_ns = next_ns.max(self.now_ns);
            self.watch_motion();
            if let Some(first) = self.queue.first_entry().filter(|first| first.key().0 <= self.now_ns) {
                let delivery = first.remove();
                self.deliver(delivery);
            } else if self.ports.wake_at().is_some_and(|at_ns| at_ns <= self.now_ns) {
                self.tell_ports(PortInput::Wake);
            } else {
                self.arm.handle_wake(self.stamp());
            }
            self.settle();
        }
        self.outcome.end_ns = self.now_ns;
        self.outcome.ended = match (self.stage, self.fault) {
            (Stage::Over, Some(code)) => Ended::Fault(code.name()),
            (Stage::Over, None) => Ended::Finished,
            _ => Ended::Hung,
        };
    }

    fn stamp(&self) -> Stamp {
        Stamp { ns: self.now_ns }
    }

    fn deliver(&mut self, delivery: Delivery) {
        let now = self.stamp();
        match delivery {
            Delivery::ToArm(bytes) => {
                self.digest(b'<', &bytes);
                self.arm.handle_bytes(now, &bytes);
            }
            Delivery::ToPorts(input) => self.tell_ports(input),
            Delivery::Connected(connection) if self.connection == Some(connection) => {
                self.tell_ports(PortInput::Connected { connection });
                self.arm.handle_connected(now);
            }
            Delivery::Closed(connection) if self.connection == Some(connection) => {
                self.connection = None;
                self.arm.handle_closed(now, "the other side closed it");
            }
            Delivery::Connected(_) | Delivery::Closed(_) => {}
            Delivery::Incident(index) => {
                if index == self.incident_index {
                    self.befall();
                }
            }
            Delivery::Resume if self.stage == Stage::Held => {
                self.resume_count += 1;
                self.stage = Stage::Resuming;
                self.arm.make_ready(now);
                self.see(Phase::Resuming);
            }
            Delivery::Resume => {}
            Delivery::Exposed(index) if self.stage == Stage::Standing && self.target_index == index => {
                self.target_index += 1;
                self.go();
            }
            Delivery::Exposed(_) => {}
        }
    }

    /// Hands on what arm and controller want done, until neither wants anything.
    fn settle(&mut self) {
        loop {
            if let Some(output) = self.arm.poll_output() {
                self.send(output);
            } else if let Some(event) = self.arm.poll_event() {
                self.outcome.events.push((self.now_ns, event.clone()));
                self.handle_event(event);
            } else if let Some(output) = self.ports.poll_output() {
                self.answer(output);
            } else {
                return;
            }
        }
    }

    fn send(&mut self, output: RobotOutput) {
        match output {
            RobotOutput::Connect => {
                self.connection_count += 1;
                self.connection = Some(self.connection_count);
                self.enqueue(LATENCY_NS, Delivery::Connected(self.connection_count));
            }
            RobotOutput::Close => {
                if let Some(connection) = self.connection.take() {
                    self.enqueue(LATENCY_NS, Delivery::ToPorts(PortInput::Closed { connection }));
                }
            }
            RobotOutput::Bytes { bytes, .. } => {
                self.digest(b'>', &bytes);
                self.see_sent(&bytes);
                match self.setup.link {
                    Link::Hses => {
                        for (late_ns, bytes) in self.tampered(bytes) {
                            let from = ([127, 0, 0, 1], 5000).into();
                            let port = Port::Robot;
                            self.enqueue(late_ns, Delivery::ToPorts(PortInput::Datagram { port, from, bytes }));
                        }
                    }
                    Link::HostControl => {
                        if let Some(connection) = self.connection {
                            self.enqueue(LATENCY_NS, Delivery::ToPorts(PortInput::Bytes { connection, bytes }));
                        }
                    }
                    Link::Serial => {
                        let bytes = self.carrier.line_to_robot(bytes);
                        self.enqueue(LATENCY_NS, Delivery::ToPorts(PortInput::Serial(bytes)));
                    }
                }
            }
        }
    }

    /// What comes of a datagram to the robot.
    fn tampered(&mut self, bytes: Vec<u8>) -> Vec<(u64, Vec<u8>)> {
        let index = self.outcome.sent.len();
        let command = u16::from_le_bytes([bytes[24], bytes[25]]);
        self.outcome.sent.push((command, self.now_ns));
        let tampers = self.setup.tampers.clone();
        let mut arrivals = self.carrier.carried_to_robot(bytes.clone());
        for tamper in tampers {
            match tamper {
                Tamper::Lose { index: lost } if lost == index => arrivals.clear(),
                Tamper::Again {
                    index: doubled,
                    late_ns,
                } if doubled == index => {
                    arrivals.push((late_ns, bytes.clone()));
                }
                _ => {}
            }
        }
        arrivals
    }

    fn is_deaf(&self) -> bool {
        self.setup.tampers.iter().any(|tamper| match *tamper {
            Tamper::Deaf { from_ns, to_ns } => (from_ns..to_ns).contains(&self.now_ns),
            _ => false,
        })
    }

    fn answer(&mut self, output: PortOutput) {
        match output {
            PortOutput::Datagram { .. } if self.is_deaf() => {}
            PortOutput::Datagram { bytes, .. } => {
                for (late_ns, bytes) in self.carrier.carried_to_client(bytes) {
                    self.enqueue(late_ns, Delivery::ToArm(bytes));
                }
            }
            PortOutput::Bytes { connection, bytes } if self.connection == Some(connection) => {
                // In the order of the stream: the latency is always the same.
                self.enqueue(LATENCY_NS, Delivery::ToArm(bytes));
            }
            PortOutput::Bytes { .. } => {}
            PortOutput::Close { connection } => self.enqueue(LATENCY_NS, Delivery::Closed(connection)),
            PortOutput::Serial(bytes) => {
                let bytes = self.carrier.line_to_client(bytes);
                self.enqueue(LATENCY_NS, Delivery::ToArm(bytes));
            }
            PortOutput::Violation(text) => self.outcome.violations.push(text),
        }
    }

    fn tell_ports(&mut self, input: PortInput) {
        self.ports.handle_input(self.now_ns, input);
        self.watch_motion();
    }

    fn handle_event(&mut self, event: ArmEvent) {
        let now = self.stamp();
        match event {
            ArmEvent::Identity(_) if self.stage == Stage::Identifying => {
                self.stage = Stage::Readying;
                self.arm.make_ready(now);
                self.see(Phase::Readying);
            }
            ArmEvent::Ready if matches!(self.stage, Stage::Readying | Stage::Resuming) => self.go(),
            ArmEvent::Arrived { .. } if self.stage == Stage::Going => self.arrive(),
            ArmEvent::HeldElsewhere => self.hold(),
            ArmEvent::Held if self.stage == Stage::Holding && self.fault.is_some() => self.let_go(),
            ArmEvent::Held if self.stage == Stage::Holding => {
                self.stage = Stage::Held;
                self.watch_motion();
                self.outcome.moved_while_held_count += u32::from(self.was_moving);
                if self.resume_count < RESUMES_MAX {
                    self.enqueue(RESUME_NS, Delivery::Resume);
                } else {
                    // The operator gives up.
                    self.let_go();
                }
                self.see(Phase::Held);
            }
            ArmEvent::Parked => self.stage = Stage::Over,
            ArmEvent::Fault(fault) => {
                let is_letting_go = matches!(self.stage, Stage::Holding | Stage::Held | Stage::Ending);
                self.fault = self.fault.or(Some(fault.code));
                if is_letting_go {
                    self.let_go();
                } else {
                    self.stage = Stage::Holding;
                    self.arm.hold(now);
                }
            }
            _ => {}
        }
    }

    fn go(&mut self) {
        if self.target_index == self.targets.len() {
            return self.let_go();
        }
        self.stage = Stage::Going;
        self.begun_in_order = 0;
        self.arm.move_to(self.stamp(), self.target_index);
    }

    fn arrive(&mut self) {
        self.stage = Stage::Standing;
        let target = self.targets[self.target_index];
        let controller = self.ports.controller();
        let pose = controller.pose(self.now_ns).to_isometry();
        let away_mm = (pose.translation.vector - target.translation.vector).norm();
        let away_rad = pose.rotation.angle_to(&target.rotation);
        let is_right = away_mm <= self.tolerances.0 && away_rad <= self.tolerances.1;
        let is_wrong = !is_right || controller.is_moving(self.now_ns);
        self.outcome.wrong_arrival_count += u32::from(is_wrong);
        self.enqueue(self.setup.exposure_ns, Delivery::Exposed(self.target_index));
        self.see(Phase::Standing);
    }

    fn hold(&mut self) {
        if !matches!(self.stage, Stage::Holding | Stage::Held | Stage::Ending | Stage::Over) {
            self.stage = Stage::Holding;
            self.arm.hold(self.stamp());
        }
    }

    fn let_go(&mut self) {
        if self.stage != Stage::Ending {
            self.stage = Stage::Ending;
            self.arm.park(self.stamp());
            self.see(Phase::Parking);
        }
    }

    /// Counts motions. Whoever looks at the controller lets happen what is due there.
    fn watch_motion(&mut self) {
        let controller = self.ports.controller();
        let is_moving = controller.is_moving(self.now_ns);
        let pose = controller.pose(self.now_ns);
        let move_count = controller.accepted_move_count();
        let has_moved = is_moving || self.known_pose.replace(pose).is_some_and(|known| known != pose);
        // A move to where the arm stands is none.
        let begun = match move_count - std::mem::replace(&mut self.known_move_count, move_count) {
            begun if has_moved => begun,
            _ => 0,
        };
        if begun > 0 {
            let before = self.begun_in_order;
            self.begun_in_order += begun;
            self.outcome.repeated_count += self.begun_in_order.saturating_sub(before.max(1));
            if self.stage == Stage::Held {
                self.outcome.moved_while_held_count += begun;
            }
        }
        let was_moving = std::mem::replace(&mut self.was_moving, is_moving);
        if self.stage == Stage::Going {
            if is_moving {
                self.see(Phase::Moving);
            } else if was_moving {
                self.see(Phase::Settling);
            }
        }
    }

    fn see_sent(&mut self, bytes: &[u8]) {
        let (servo_on, start, load) = match self.setup.link {
            Link::Hses => (
                bytes.get(24..28) == Some(&[0x83, 0, 2, 0]) && bytes.get(32) == Some(&1),
                bytes.get(24..26) == Some(&[0x86, 0]),
                bytes.get(24..26) == Some(&[0x07, 3]),
            ),
            Link::HostControl | Link::Serial => {
                let text = String::from_utf8_lossy(bytes);
                (text.contains("SVON"), text.contains("START"), text.contains("LOADV"))
            }
        };
        for (is_sent, phase) in [
            (servo_on, Phase::ServoOn),
            (start, Phase::Starting),
            (load, Phase::Loading),
        ] {
            if is_sent && self.stage == Stage::Readying {
                self.see(phase);
            }
        }
    }

    /// This part of the run is seen now.
    fn see(&mut self, phase: Phase) {
        if let Some((When::In(wanted), _)) = self.setup.incidents.get(self.incident_index)
            && *wanted == phase
        {
            self.befall();
        }
    }

    /// Times of the incident that comes next, if it has one.
    fn schedule_incident(&mut self) {
        let delivery = Delivery::Incident(self.incident_index);
        match self.setup.incidents.get(self.incident_index) {
            Some((When::At(at_ns), _)) => self.enqueue(at_ns.saturating_sub(self.now_ns), delivery),
            Some((When::After(span_ns), _)) => self.enqueue(*span_ns, delivery),
            Some((When::In(_), _)) | None => {}
        }
    }

    fn befall(&mut self) {
        let (_, happening) = self.setup.incidents[self.incident_index];
        self.incident_index += 1;
        self.outcome.incident_ns.push(self.now_ns);
        self.schedule_incident();
        match happening {
            Happening::Panel(panel) => self.enqueue(0, Delivery::ToPorts(PortInput::Panel(panel))),
            Happening::OperatorHold => self.hold(),
            Happening::Cut => {
                if let Some(connection) = self.connection {
                    self.enqueue(0, Delivery::ToPorts(PortInput::Closed { connection }));
                    self.enqueue(0, Delivery::Closed(connection));
                }
            }
        }
    }

    fn enqueue(&mut self, late_ns: u64, delivery: Delivery) {
        self.queued_count += 1;
        self.queue.insert((self.now_ns + late_ns, self.queued_count), delivery);
    }

    /// FNV-1a.
    fn digest(&mut self, way: u8, bytes: &[u8]) {
        let with_time = self.now_ns.to_le_bytes();
        for byte in [way].iter().chain(&with_time).chain(bytes) {
            self.outcome.digest = (self.outcome.digest ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
}

/// The longest that a run may take, in time of the run.
const RUN_NS_MAX: u64 = 1_200_000_000_000;
const SCAN_JOB: &str = include_str!("../../docs/robot/BLADESCAN.JBI");
const LATENCY_NS: u64 = 200_000;
const RESUME_NS: u64 = 1_000_000_000;
const RESUMES_MAX: u32 = 8;
const DIGEST_AT_START: u64 = 0xcbf2_9ce4_8422_2325;
