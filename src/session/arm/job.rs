//! The scan job on the controller: loading poses, starting it, and numbered orders (`docs/robot/README.md`).

use super::travel::tenths;
use super::{Arm, State};
use crate::fault::FaultCode;
use crate::robot::{
    Command, ExecutingJob, Form, Frame, JobName, PositionVariable, Speed, Status, Values, Variable, VariableKind,
    WirePose, values_max,
};
use crate::stamp::Stamp;
use std::collections::VecDeque;

/// Which job, and which variables it and bladescan share.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobSettings {
    /// Its name on the controller.
    pub name: JobName,
    /// The first of the position variables that hold the poses of the plan.
    pub position_first: u16,
    /// The first of the D variables of the job.
    pub variable_first: u16,
    /// So many turns of its waiting loop without a beat stop the job.
    pub patience: i32,
}

/// The orders to the job: which number comes next, which pose lies where.
#[derive(Debug)]
pub(super) struct Orders {
    settings: JobSettings,
    /// The last number given out, or the one from which this start of the job goes on.
    number: i32,
    beat: i32,
    /// The poses are on the controller, read back and found right.
    poses_loaded: bool,
    /// The job may be running because of us.
    started: bool,
    /// The order that is to be carried out.
    open: Option<(Command, Stamp)>,
}

/// What the job and bladescan tell each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Counters {
    /// Number of the last order carried out.
    pub(super) done: i32,
    state: Option<i32>,
}

/// Putting the poses on the controller and starting the job, step by step.
#[derive(Debug)]
pub(super) struct Loading {
    since: Stamp,
    steps: VecDeque<Step>,
    open: Option<Step>,
    start_count: u32,
    form: Form,
}

#[derive(Debug, Clone)]
enum Step {
    /// Read how far an earlier run has counted.
    Count,
    /// Write, then go on.
    Write(Variable, Values),
    /// Read back what was written, and compare.
    Compare(Variable, Values),
    Select,
    /// See that the right job is selected.
    Selected,
    Start,
    /// Wait until the job says that it waits for orders.
    Waits,
}

impl Orders {
    pub(super) fn new(settings: JobSettings) -> Self {
        Self {
            settings,
            number: 1,
            beat: 0,
            poses_loaded: false,
            started: false,
            open: None,
        }
    }

    /// Whether `name` is the job's.
    pub(super) fn is_of(&self, name: &str) -> bool {
        name == self.settings.name.as_str()
    }

    /// The next order: to the pose of this index.
    pub(super) fn next(&mut self, now: Stamp, target_index: usize, speed: Speed) -> (i32, Command) {
        self.number = self.number % NUMBER_MAX + 1;
        let class = i32::from(matches!(speed, Speed::Turn(_)));
        let position = i32::from(self.settings.position_first) + target_index as i32;
        let command = Command::Order {
            variable: self.settings.variable_first,
            value: self.number * NUMBER_UNIT + class * CLASS_UNIT + position,
        };
        self.open = Some((command.clone(), now));
        (self.number, command)
    }

    /// The open order, if it is time to say it again: another that came late may have been written over it, and the job
    /// takes each number once.
    pub(super) fn said_again(&mut self, now: Stamp) -> Option<Command> {
        let (command, said_at) = self.open.as_mut()?;
        (now.ms_since(*said_at) >= ORDER_REPEAT_MS).then(|| {
            *said_at = now;
            command.clone()
        })
    }

    /// Somebody is here.
    pub(super) fn beat(&mut self) -> Command {
        self.beat = self.beat % BEAT_MAX + 1;
        write(self.variable(BEAT), Values::Double(vec![self.beat]))
    }

    /// Reads what is done, and the state as well if the job has `stopped`.
    pub(super) fn look(&self, stopped: bool) -> Command {
        self.read(DONE, if stopped { 3 } else { 1 })
    }

    fn read(&self, offset: u16, count: u16) -> Command {
        Command::Read {
            first: self.variable(offset),
            count,
        }
    }

    /// The order that ends the job.
    pub(super) fn order_to_end(&self) -> Command {
        write(self.variable(ORDER), Values::Double(vec![0]))
    }

    /// Puts the job back to its first line, if it may be anywhere else because of us: no start goes on with a move that was
    /// interrupted.
    pub(super) fn rewinding(&self) -> Option<Command> {
        self.started.then(|| self.select())
    }

    fn select(&self) -> Command {
        Command::SelectJob {
            job: self.settings.name.clone(),
            line: 0,
        }
    }

    /// The order that ends the job, if it may be running because of us.
    pub(super) fn end_of_job(&self) -> Option<Command> {
        self.started.then(|| self.order_to_end())
    }

    fn variable(&self, offset: u16) -> Variable {
        Variable {
            kind: VariableKind::Double,
            index: self.settings.variable_first + offset,
        }
    }

    fn position(&self, target_index: usize) -> Variable {
        Variable {
            kind: VariableKind::Position,
            index: self.settings.position_first + target_index as u16,
        }
    }
}

impl Counters {
    fn read(values: &Values) -> Option<Self> {
        match values {
            Values::Double(values) => match values.as_slice() {
                [done, rest @ ..] => Some(Self {
                    done: *done,
                    state: rest.get(1).copied(),
                }),
                [] => None,
            },
            _ => None,
        }
    }

    /// Whether the state was read as well.
    pub(super) fn is_whole(self) -> bool {
        self.state.is_some()
    }

    pub(super) fn words(self) -> String {
        match self.state {
            Some(0) => "it has ended".into(),
            Some(1) => "it says that it waits for orders".into(),
            Some(2) => "it says that it moves".into(),
            Some(3) => "it no longer saw anybody here".into(),
            Some(4) => "it could not read the order".into(),
            Some(other) => format!("its state is {other}"),
            None => "its state is not known".into(),
        }
    }
}

impl Arm {
    /// The arm is ready but for the job: puts the poses there and starts it.
    pub(super) fn load(&mut self, now: Stamp, form: Form) {
        self.state = State::Loading(Loading {
            since: now,
            steps: VecDeque::from([Step::Count]),
            open: None,
            start_count: 0,
            form,
        });
        self.load_on(now);
    }

    /// The next step of loading.
    pub(super) fn load_on(&mut self, now: Stamp) {
        let (State::Loading(loading), Some(orders)) = (&mut self.state, &mut self.orders) else {
            return;
        };
        let Some(step) = loading.steps.pop_front() else { return };
        loading.open = Some(step.clone());
        let command = match step {
            Step::Count => orders.read(DONE, 1),
            Step::Write(first, values) => write(first, values),
            Step::Compare(first, values) => Command::Read {
                first,
                count: values.count() as u16,
            },
            Step::Select => orders.select(),
            Step::Selected => Command::ExecutingJob,
            Step::Start => {
                orders.started = true;
                loading.start_count += 1;
                Command::StartJob
            }
            Step::Waits => return self.look_whether_the_job_waits(now),
        };
        self.exchange.say(now, command);
    }

    /// Variables have been read.
    pub(super) fn handle_values(&mut self, now: Stamp, values: &Values) {
        match &self.state {
            State::Travelling(_) => {
                if let Some(counters) = Counters::read(values) {
                    self.follow_job(now, counters);
                }
            }
            State::Loading(loading) => match loading.open.clone() {
                Some(Step::Count) => self.lay_out_steps(now, values),
                Some(Step::Compare(first, wanted)) if same(&wanted, values) => {
                    if first.kind == VariableKind::Double
                        && let Some(orders) = &mut self.orders
                    {
                        orders.poses_loaded = true;
                    }
                    self.load_on(now);
                }
                Some(Step::Compare(first, _)) => {
                    let seen = format!("{first} and those after it do not read back as they were written");
                    self.fault(FaultCode::RobotJob, seen);
                }
                Some(Step::Waits) => self.decide_waiting(now, values),
                _ => {}
            },
            _ => {}
        }
    }

    pub(super) fn handle_executing_job(&mut self, now: Stamp, selected: &ExecutingJob) {
        match &self.state {
            State::Readying(_) => self.decide_about_running(now, selected),
            State::Loading(loading) if matches!(loading.open, Some(Step::Selected)) => {
                if self.orders.as_ref().is_some_and(|orders| orders.is_of(&selected.name)) {
                    self.load_on(now);
                } else {
                    let seen = format!("the job selected on the controller is {:?}", selected.name);
                    self.fault(FaultCode::RobotJob, seen);
                }
            }
            _ => {}
        }
    }

    /// How far an earlier run has counted is known: everything else can be written down.
    fn lay_out_steps(&mut self, now: Stamp, shared: &Values) {
        let (State::Loading(loading), Some(orders)) = (&mut self.state, &mut self.orders) else {
            return;
        };
        let done = Counters::read(shared).map_or(0, |counters| counters.done);
        // What an earlier start has left on the way is too old from here on.
        orders.number = (done.clamp(0, NUMBER_MAX) + NUMBERS_SKIPPED) % NUMBER_MAX + 1;
        let mut steps = Vec::new();
        if !orders.poses_loaded {
            let many = values_max(VariableKind::Position);
            for (chunk_index, chunk) in self.targets.chunks(many).enumerate() {
                let first = orders.position(chunk_index * many);
                let values = chunk.iter().map(|target| PositionVariable::Cartesian {
                    frame: Frame::Base,
                    pose: WirePose::from_isometry(target),
                    form: loading.form,
                    tool: self.settings.tool,
                });
                steps.push((first, Values::Position(values.collect())));
            }
        }
        let settings = [
            tenths(self.settings.speed_mm_s) as i32,
            tenths(self.settings.rotation_speed_rad_s.to_degrees()) as i32,
            orders.settings.patience,
        ];
        // Nothing that the job writes: what is written here may come again late. The job begins to count at the order
        // that it finds when it starts, so that one is looked at last.
        steps.push((orders.variable(SPEED), Values::Double(settings.to_vec())));
        let begin = vec![orders.number * NUMBER_UNIT];
        let begin = (orders.variable(ORDER), Values::Double(begin));
        loading.steps = steps
            .into_iter()
            .chain([begin.clone()])
            .flat_map(|(first, values)| [Step::Write(first, values.clone()), Step::Compare(first, values)])
            .chain([
                Step::Select,
                Step::Selected,
                Step::Compare(begin.0, begin.1),
                Step::Start,
                Step::Waits,
            ])
            .collect();
        self.load_on(now);
    }

    pub(super) fn look_whether_the_job_waits(&mut self, now: Stamp) {
        if let Some(orders) = &self.orders {
            let look = orders.read(DONE, JOB_VERSION - DONE + 1);
            self.exchange.say(now, look);
        }
    }

    fn decide_waiting(&mut self, now: Stamp, values: &Values) {
        let State::Loading(loading) = &self.state else { return };
        let (Values::Double(shared), Some(orders)) = (values, &self.orders) else {
            return;
        };
        let of = |offset: u16| shared.get(usize::from(offset - DONE)).copied();
        // The number is new: only this start of the job can have counted it.
        let is_counted = of(DONE) == Some(orders.number) && of(STATE) == Some(WAITING);
        match of(JOB_VERSION) {
            Some(VERSION) if is_counted => self.stand_ready(now),
            Some(version) if is_counted => {
                let seen = format!("the scan job is version {version}, not {VERSION}: put the right one there");
                self.fault(FaultCode::RobotJob, seen);
            }
            _ if now.ms_since(loading.since) >= self.settings.servo_timeout_ms.max(LOADING_MS_MIN) => {
                let seen = format!("the scan job does not start, or is not version {VERSION}");
                self.fault(FaultCode::RobotJob, seen);
            }
            _ => self.ask_status(now),
        }
    }

    /// The job does not wait for orders yet: is it running at all?
    pub(super) fn handle_status_of_job(&mut self, now: Stamp, status: Status) {
        if !self.watch(now, status) {
            return;
        }
        let State::Loading(loading) = &mut self.state else {
            return;
        };
        if !status.running() && loading.start_count < START_ATTEMPTS_MAX {
            // Nothing is ordered, so a start that comes twice moves nothing.
            loading.steps = VecDeque::from([Step::Start, Step::Waits]);
            self.load_on(now);
        } else {
            self.poll_later(now);
        }
    }
}

/// Positions are compared but for the configuration, which the controller may write in its own way.
fn same(wanted: &Values, found: &Values) -> bool {
    let (Values::Position(wanted), Values::Position(found)) = (wanted, found) else {
        return wanted == found;
    };
    wanted.len() == found.len()
        && wanted.iter().zip(found).all(|pair| match pair {
            (
                PositionVariable::Cartesian { frame, pose, tool, .. },
                PositionVariable::Cartesian {
                    frame: found_frame,
                    pose: found_pose,
                    tool: found_tool,
                    ..
                },
            ) => (frame, pose, tool) == (found_frame, found_pose, found_tool),
            (wanted, found) => wanted == found,
        })
}

fn write(first: Variable, values: Values) -> Command {
    Command::Write { first, values }
}

/// Offsets of the shared variables.
const ORDER: u16 = 0;
const DONE: u16 = 1;
const BEAT: u16 = 2;
const STATE: u16 = 3;
const SPEED: u16 = 4;
const JOB_VERSION: u16 = 7;
/// The state of a job that waits for orders.
const WAITING: i32 = 1;
/// The version of `docs/robot/BLADESCAN.JBI` that this speaks to.
const VERSION: i32 = 2;
const NUMBER_UNIT: i32 = 10_000;
const CLASS_UNIT: i32 = 1000;
const NUMBER_MAX: i32 = 200_000;
const NUMBERS_SKIPPED: i32 = 1000;
const BEAT_MAX: i32 = 1_000_000_000;
/// After so long an order that is not carried out yet is said again.
const ORDER_REPEAT_MS: u64 = 1000;
const START_ATTEMPTS_MAX: u32 = 3;
const LOADING_MS_MIN: u64 = 30_000;
