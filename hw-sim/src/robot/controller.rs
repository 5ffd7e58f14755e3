//! The DX200 as a value: datagrams, a person's acts and time go in, datagrams come out.
//!
//! What a client can do is a method with plain arguments; HSES and host control call the same ones. All of them first let
//! everything happen that is due, so that it makes no difference when they are called.

use core::net::SocketAddr;
use std::collections::VecDeque;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fault::Fault;
use crate::robot::alarms::{Alarm, AlarmBook};
use crate::robot::files::{Files, SIMULATED, SIMULATED_TEXT};
use crate::robot::hses::{FileLink, Port, Request, is_read};
use crate::robot::io::Signals;
use crate::robot::job::run::Playback;
use crate::robot::motion::Motion;
pub use crate::robot::panel::Panel;
use crate::robot::pose::Pose;
use crate::robot::refused::Refused;
pub use crate::robot::settings::{Options, Settings};
use crate::robot::switches::Cycle;
use crate::robot::variables::Variables;

/// The simulated robot controller. It starts in play mode with command remote, servo off, standing at home.
#[derive(Clone, Debug)]
pub struct Controller {
    pub(super) settings: Settings,
    pub(super) switches: Switches,
    pub(super) holds: Holds,
    pub(super) alarms: AlarmBook,
    pub(super) has_error: bool,
    pub(super) is_silent: bool,
    pub(super) pose: Pose,
    pub(super) tool: i32,
    pub(super) motion: Option<Motion>,
    pub(super) incidents: Vec<(u64, Incident)>,
    pub(super) accepted_move_count: u32,
    pub(super) departure_count: u32,
    pub(super) last_active_ns: u64,
    pub(super) variables: Variables,
    pub(super) signals: Signals,
    pub(super) files: Files,
    pub(super) playback: Playback,
    pub(super) file_link: FileLink,
    pub(super) times: Times,
    pub(super) pendant_text: Vec<u8>,
    pub(super) busy_until_ns: u64,
    clock_ns: u64,
    answer_count: u64,
    outputs: VecDeque<RobotOutput>,
}

/// What the controller wants done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RobotOutput {
    /// An answer, for the sender of the request alone.
    Datagram {
        /// Port that it leaves from.
        port: Port,
        /// Receiver.
        to: SocketAddr,
        /// Whole datagram.
        bytes: Vec<u8>,
    },
    /// A datagram that no client should have sent.
    Violation(String),
}

/// What is switched on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Switches {
    pub(super) is_playing: bool,
    pub(super) is_remote_key: bool,
    pub(super) is_remote_selected: bool,
    pub(super) is_servo_on: bool,
    pub(super) is_estop_pressed: bool,
    pub(super) is_door_open: bool,
    pub(super) is_speed_restricted: bool,
    pub(super) is_pendant_locked: bool,
    pub(super) is_powered: bool,
    pub(super) cycle: Cycle,
}

impl Switches {
    pub(super) fn is_command_remote(&self) -> bool {
        self.is_remote_key && self.is_remote_selected
    }
}

/// Who holds the arm.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Holds {
    pub(super) pendant: bool,
    pub(super) panel: bool,
    pub(super) external: bool,
    pub(super) command: bool,
}

/// What happens in the middle of a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Incident {
    Alarm(u32),
    EmergencyStop,
    Door,
    PendantHold,
    ServoDrop,
    /// Off for this long.
    PowerLoss(u64),
    PowerReturn,
    /// Refuses what is not a read for this long.
    Busy(u64),
}

/// How long things have been on, in ns of the cell's clock.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Times {
    pub(super) servo_ns: u64,
    pub(super) playback_ns: u64,
    pub(super) moving_ns: u64,
}

/// What is due next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    Incident(usize),
    MotionEnd,
    Job,
    ServoSleep,
    FileStall,
}

impl Controller {
    /// Controller at home, with the jobs of its settings and one called SIMULATED. A job that is none is told as a
    /// violation.
    pub fn new(settings: Settings) -> Self {
        let options = &settings.options;
        let mut controller = Self {
            switches: Switches {
                is_playing: true,
                is_remote_key: !settings.faults.contains(&Fault::RemoteOff),
                is_remote_selected: true,
                is_servo_on: false,
                is_estop_pressed: settings.faults.contains(&Fault::ServoRefused),
                is_door_open: false,
                is_speed_restricted: false,
                is_pendant_locked: false,
                is_powered: true,
                cycle: Cycle::Auto,
            },
            holds: Holds::default(),
            alarms: AlarmBook::default(),
            has_error: false,
            is_silent: false,
            pose: settings.home,
            tool: TOOL_AT_START,
            motion: None,
            incidents: Vec::new(),
            accepted_move_count: 0,
            departure_count: 0,
            last_active_ns: 0,
            variables: Variables::new(options.scalar_variable_count, options.position_variable_count),
            signals: Signals::default(),
            files: Files::default(),
            playback: Playback::default(),
            file_link: FileLink::default(),
            times: Times::default(),
            busy_until_ns: 0,
            pendant_text: Vec::new(),
            clock_ns: 0,
            answer_count: 0,
            outputs: VecDeque::new(),
            settings,
        };
        let jobs = controller.settings.jobs.clone();
        let simulated = (SIMULATED.to_owned(), SIMULATED_TEXT.to_owned());
        for (name, text) in jobs.iter().chain([&simulated]) {
            if let Err(error) = controller.install_job(name, text.as_bytes()) {
                controller.violation(format!("job {name} of the settings: {error}"));
            }
        }
        controller
    }

    /// Takes one datagram of a port of HSES. A malformed one is told, and answered where the sheet has a code for it.
    pub fn handle_datagram(&mut self, now_ns: u64, port: Port, from: SocketAddr, datagram: &[u8]) {
        self.advance(now_ns);
        if !self.switches.is_powered {
            return;
        }
        let answer = match Request::parse(port, datagram) {
            Ok(request) => match port {
                Port::Robot => Some(self.answer(now_ns, &request)),
                Port::File => self.reply_file(now_ns, from, &request),
            },
            Err(malformed) => {
                self.violation(format!("hses from {from}: {malformed}"));
                Request::answer_malformed(port, datagram, malformed)
            }
        };
        let Some(bytes) = answer else { return };
        self.answer_count += 1;
        if !self.is_silent() && !self.is_answer_lost() {
            self.outputs.push_back(RobotOutput::Datagram { port, to: from, bytes });
        }
    }

    fn answer(&mut self, now_ns: u64, request: &Request) -> Vec<u8> {
        if now_ns < self.busy_until_ns && !is_read(request) {
            return self.refuse(request, Refused::BUSY.into());
        }
        match self.reply(now_ns, request) {
            Ok(data) => request.done(&data),
            Err(refusal) => self.refuse(request, refusal),
        }
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<RobotOutput> {
        self.outputs.pop_front()
    }

    /// Where the arm is, `base_from_tool`; exactly what it reports.
    pub fn pose(&mut self, now_ns: u64) -> Pose {
        self.advance(now_ns);
        self.standing(now_ns)
    }

    /// Whether the arm is moving.
    pub fn is_moving(&mut self, now_ns: u64) -> bool {
        self.advance(now_ns);
        self.motion.is_some()
    }

    /// Moves begun so far, of clients and of jobs.
    pub fn accepted_move_count(&self) -> u32 {
        self.accepted_move_count
    }

    /// Of these, the moves to another place than where the arm stood. To move to where it stands is to stand.
    pub fn departure_count(&self) -> u32 {
        self.departure_count
    }

    /// Whether nothing comes out of the controller: no power, or a fault. Whoever serves a link sends nothing then.
    pub fn is_silent(&self) -> bool {
        self.is_silent || !self.switches.is_powered
    }

    /// Lets everything happen that is due, in the order of time; at one time in the order of [`Due`].
    pub(super) fn advance(&mut self, now_ns: u64) {
        self.wake_job(self.clock_ns);
        while let Some((at_ns, due)) = self.next_due().filter(|(at_ns, _)| *at_ns <= now_ns) {
            let at_ns = at_ns.max(self.clock_ns);
            self.pass_time(at_ns);
            match due {
                Due::Incident(index) => {
                    let (_, incident) = self.incidents.remove(index);
                    self.befall(at_ns, incident);
                }
                Due::MotionEnd => {
                    self.end_motion(at_ns);
                    self.job_move_done(at_ns);
                }
                Due::Job => self.step_job(at_ns),
                Due::ServoSleep => self.servo_off(at_ns),
                Due::FileStall => {
                    if let Some((to, bytes)) = self.drop_transfer() {
                        let port = Port::File;
                        self.outputs.push_back(RobotOutput::Datagram { port, to, bytes });
                    }
                }
            }
        }
        self.pass_time(now_ns);
    }

    /// When the controller has something to say by itself.
    pub fn wake_at(&self) -> Option<u64> {
        self.file_deadline_ns()
    }

    /// Lets everything happen that is due and says what there is to say.
    pub fn handle_wake(&mut self, now_ns: u64) {
        self.advance(now_ns);
    }

    /// Nothing changes up to this time.
    fn pass_time(&mut self, now_ns: u64) {
        let passed_ns = now_ns.saturating_sub(self.clock_ns);
        let count = |is_on: bool| if is_on { passed_ns } else { 0 };
        self.times.servo_ns += count(self.switches.is_servo_on);
        self.times.playback_ns += count(self.is_running());
        self.times.moving_ns += count(self.motion.is_some());
        self.clock_ns += passed_ns;
    }

    fn next_due(&self) -> Option<(u64, Due)> {
        let incident = self.incidents.iter().enumerate().min_by_key(|(_, (at_ns, _))| *at_ns);
        let incident = incident.map(|(index, (at_ns, _))| (*at_ns, Due::Incident(index)));
        let motion_end = self.motion.as_ref().map(|motion| (motion.end_ns(), Due::MotionEnd));
        let job = self.job_due_ns().map(|at_ns| (at_ns, Due::Job));
        let sleeps = self.switches.is_servo_on && !self.is_running();
        let servo_sleep = self.settings.options.servo_sleep_s.filter(|_| sleeps);
        let servo_sleep = servo_sleep.map(|idle_s| (self.last_active_ns + self.clock_span_ns(idle_s), Due::ServoSleep));
        let stall = self.file_deadline_ns().map(|at_ns| (at_ns, Due::FileStall));
        [incident, motion_end, job, servo_sleep, stall]
            .into_iter()
            .flatten()
            .min_by_key(|(at_ns, _)| *at_ns)
    }

    fn befall(&mut self, now_ns: u64, incident: Incident) {
        match incident {
            Incident::Alarm(code) => self.raise_alarm(now_ns, code, 1),
            Incident::EmergencyStop => self.press_estop(now_ns),
            Incident::Door => {
                self.switches.is_door_open = true;
                self.servo_off(now_ns);
            }
            Incident::PendantHold => {
                self.holds.pendant = true;
                self.pause(now_ns);
            }
            Incident::ServoDrop => self.servo_off(now_ns),
            Incident::PowerLoss(span_ns) => {
                self.switch_power(now_ns, false);
                self.incidents.push((now_ns + span_ns, Incident::PowerReturn));
            }
            Incident::PowerReturn => self.switch_power(now_ns, true),
            Incident::Busy(span_ns) => self.busy_until_ns = now_ns + span_ns,
        }
    }

    fn end_motion(&mut self, now_ns: u64) {
        if let Some(motion) = self.motion.take() {
            self.pose = motion.pose(now_ns);
            self.last_active_ns = now_ns;
        }
    }

    /// Whether the arm moves or a job runs.
    pub(super) fn is_running(&self) -> bool {
        self.motion.is_some() || self.is_job_running()
    }

    /// Slows down whatever moves and stops what runs; a start goes on from there.
    pub(super) fn pause(&mut self, now_ns: u64) {
        if let Some(motion) = &mut self.motion {
            motion.stop(now_ns);
        }
        self.stop_job(now_ns);
    }

    pub(super) fn violation(&mut self, text: String) {
        self.outputs.push_back(RobotOutput::Violation(text));
    }

    pub(super) fn raise_alarm(&mut self, now_ns: u64, code: u32, data: u32) {
        self.alarms.raise(Alarm {
            code,
            data,
            raised_ns: now_ns,
        });
        self.servo_off(now_ns);
    }

    /// The brakes fall at once: no ramp.
    pub(super) fn servo_off(&mut self, now_ns: u64) {
        self.pause(now_ns);
        self.switches.is_servo_on = false;
        self.end_motion(now_ns);
    }

    /// Span of the controller's time in one of the clock's.
    pub(super) fn controller_ns(&self, span_ns: u64) -> u64 {
        (span_ns as f64 * self.settings.speed) as u64
    }

    /// Time on the cell's clock of a span of the controller's, ns.
    pub(super) fn clock_span_ns(&self, controller_s: f64) -> u64 {
        (controller_s / self.settings.speed * 1e9).round() as u64
    }

    /// Drawn from the seed and the count of the answer.
    fn is_answer_lost(&self) -> bool {
        self.settings.faults.iter().any(|fault| match fault {
            Fault::AnswerLost { fraction } => {
                let mut rng = ChaCha8Rng::seed_from_u64(self.settings.seed);
                rng.set_stream(self.answer_count);
                (rng.next_u32() as f64) < fraction * (f64::from(u32::MAX) + 1.0)
            }
            _ => false,
        })
    }
}

const TOOL_AT_START: i32 = 1;

#[cfg(test)]
#[path = "controller_tests.rs"]
mod tests;
