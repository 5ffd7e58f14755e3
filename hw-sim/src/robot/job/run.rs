//! Running jobs: selection, start, one instruction after another, pauses.

use std::sync::Arc;

use crate::checks::refuse_first;
use crate::robot::alarms::{CODE_INSTRUCTION, CODE_LIMIT, CODE_POSITION};
use crate::robot::controller::Controller;
use crate::robot::job::Job;
use crate::robot::job::instruction::{Condition, Instruction, Target, Time, WrittenSpeed};
use crate::robot::motion::Rate;
use crate::robot::moves::{OrderedSpeed, Path};
use crate::robot::pose::Pose;
use crate::robot::refused::{Answer, Refused};
use crate::robot::switches::Cycle;
use crate::robot::variables::{Kind, Position, Value};

/// What the executing job is doing, for a client.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExecutingJob {
    /// Name without extension; empty while none is selected.
    pub name: String,
    /// Line of the instruction that is next or under way, 0 the first.
    pub line: u32,
    /// Number of the last move at or before that line, 0 before the first.
    pub step: u32,
    /// Speed override in 0.01 %; always the whole.
    pub override_e2_percent: u32,
}

/// Where the jobs stand.
#[derive(Clone, Debug, Default)]
pub(in crate::robot) struct Playback {
    /// Names of the master jobs of task 0 to 15.
    masters: [Option<String>; TASK_COUNT],
    current: Option<Frame>,
    /// Callers of the current job, the first one first.
    callers: Vec<Frame>,
    is_running: bool,
    block: Block,
    next_ns: u64,
}

/// A job and its line.
#[derive(Clone, Debug)]
struct Frame {
    job: Arc<Job>,
    line: usize,
}

/// What the current line is in the middle of.
#[derive(Clone, Copy, Debug, Default)]
enum Block {
    #[default]
    Nothing,
    Move {
        path: Path,
        target: Pose,
        rate: Rate,
    },
    Wait {
        condition: Option<Condition>,
        time: Deadline,
    },
}

/// End of a wait. While the job is stopped its time stands still.
#[derive(Clone, Copy, Debug)]
enum Deadline {
    Never,
    At(u64),
    Left(u64),
}

/// What an instruction does to the line.
enum Flow {
    Next,
    To(usize),
    Call(String),
    Return,
    Pause,
    Block(Block),
}

/// Code and sub-code of the alarm that a bad instruction raises.
pub(super) struct Bad(pub(super) u32);

impl Controller {
    /// Selects a job and the line at which the next start begins. Not while anything runs.
    pub fn select_job(&mut self, now_ns: u64, name: &str, line: u32) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        refuse_first([(self.is_running(), Refused::MOVING)])?;
        let job = self.files.job(name).ok_or(Refused::NO_SUCH_JOB)?;
        let line = usize::try_from(line).unwrap_or(usize::MAX);
        refuse_first([(line >= job.instructions.len(), Refused::VALUE)])?;
        self.playback.select(Frame { job, line });
        Ok(())
    }

    /// Sets the master job of a task, 0 to 15; A001 beyond.
    pub fn set_master_job(&mut self, now_ns: u64, task: u16, name: &str) -> Answer<()> {
        self.advance(now_ns);
        self.check_remote()?;
        self.files.job(name).ok_or(Refused::NO_SUCH_JOB)?;
        let master = self
            .playback
            .masters
            .get_mut(usize::from(task))
            .ok_or(Refused::NO_INSTANCE)?;
        *master = Some(name.to_owned());
        Ok(())
    }

    /// Master job of a task, if one is set; A001 beyond 15.
    pub fn master_job(&mut self, now_ns: u64, task: u16) -> Answer<Option<String>> {
        self.advance(now_ns);
        self.playback
            .masters
            .get(usize::from(task))
            .cloned()
            .ok_or(Refused::NO_INSTANCE)
    }

    /// Starts the selected job where it stands, or a named one at its beginning.
    pub fn start(&mut self, now_ns: u64, name: Option<&str>) -> Answer<()> {
        self.check_can_move(now_ns)?;
        if let Some(name) = name {
            let job = self.files.job(name).ok_or(Refused::NO_SUCH_JOB)?;
            self.playback.select(Frame { job, line: 0 });
        }
        refuse_first([(self.playback.current.is_none(), Refused::NO_JOB_SELECTED)])?;
        self.playback.is_running = true;
        self.playback.next_ns = now_ns + self.instruction_ns();
        match self.playback.block {
            Block::Move { path, target, rate } => self.begin_move(now_ns, path, target, rate),
            Block::Wait {
                condition,
                time: Deadline::Left(left_ns),
            } => {
                let time = Deadline::At(now_ns + left_ns);
                self.playback.block = Block::Wait { condition, time };
            }
            Block::Wait { .. } | Block::Nothing => (),
        }
        Ok(())
    }

    /// Job that runs, or that a start would run.
    pub fn executing_job(&mut self, now_ns: u64) -> ExecutingJob {
        self.advance(now_ns);
        let (name, line, step) = match &self.playback.current {
            Some(frame) => (frame.job.name.clone(), frame.line as u32, frame.job.step(frame.line)),
            None => (String::new(), 0, 0),
        };
        ExecutingJob {
            name,
            line,
            step,
            override_e2_percent: 10_000,
        }
    }

    /// When the running job does something by itself.
    pub(in crate::robot) fn job_due_ns(&self) -> Option<u64> {
        if !self.playback.is_running {
            return None;
        }
        match self.playback.block {
            Block::Nothing => Some(self.playback.next_ns),
            Block::Wait {
                time: Deadline::At(at_ns),
                ..
            } => Some(at_ns),
            Block::Wait { .. } | Block::Move { .. } => None,
        }
    }

    /// Lets a waiting job go on whose condition has come true by what was done at `now_ns`.
    pub(in crate::robot) fn wake_job(&mut self, now_ns: u64) {
        let Block::Wait {
            condition: Some(condition),
            ..
        } = self.playback.block
        else {
            return;
        };
        if !self.playback.is_running {
            return;
        }
        match self.holds(&condition) {
            Ok(true) => self.go_on(now_ns),
            Ok(false) => (),
            Err(bad) => self.job_alarm(now_ns, bad),
        }
    }

    /// The running job's next instruction, or the end of its wait.
    pub(in crate::robot) fn step_job(&mut self, now_ns: u64) {
        if matches!(self.playback.block, Block::Wait { .. }) {
            self.go_on(now_ns);
            return;
        }
        let Some(frame) = self.playback.current.clone() else {
            return;
        };
        let instruction = frame.job.instructions.get(frame.line).unwrap_or(&Instruction::End);
        match self.carry_out(now_ns, &frame.job, instruction) {
            Ok(Flow::Next) => self.go_on(now_ns),
            Ok(Flow::To(line)) => {
                self.go_to(line);
                self.end_of_instruction(now_ns);
            }
            Ok(Flow::Call(name)) => self.call(now_ns, frame, &name),
            Ok(Flow::Return) => self.return_from_job(now_ns),
            Ok(Flow::Pause) => {
                self.go_on(now_ns);
                self.stop_job(now_ns);
            }
            Ok(Flow::Block(block)) => {
                self.playback.block = block;
                match block {
                    Block::Move { path, target, rate } => self.begin_move(now_ns, path, target, rate),
                    _ => self.wake_job(now_ns),
                }
            }
            Err(bad) => self.job_alarm(now_ns, bad),
        }
    }

    /// The arm stands at the end of a whole move.
    pub(in crate::robot) fn job_move_done(&mut self, now_ns: u64) {
        if self.playback.is_running && matches!(self.playback.block, Block::Move { .. }) {
            self.go_on(now_ns);
        }
    }

    /// Stops the job in the middle of its line.
    pub(in crate::robot) fn stop_job(&mut self, now_ns: u64) {
        if let Block::Wait {
            condition,
            time: Deadline::At(at_ns),
        } = self.playback.block
            && self.playback.is_running
        {
            let time = Deadline::Left(at_ns.saturating_sub(now_ns));
            self.playback.block = Block::Wait { condition, time };
        }
        self.playback.is_running = false;
    }

    /// Forgets where the job of this name stood: its text is another one now, or gone.
    pub(in crate::robot) fn job_changed(&mut self, name: &str) {
        let playback = &mut self.playback;
        let frames = playback.callers.first().or(playback.current.as_ref());
        let root = frames.map(|frame| frame.job.name.clone());
        let is_touched = playback
            .callers
            .iter()
            .chain(&playback.current)
            .any(|frame| frame.job.name == name);
        if is_touched {
            let job = root.and_then(|root| self.files.job(&root));
            self.playback.clear();
            self.playback.current = job.map(|job| Frame { job, line: 0 });
        }
    }

    /// Whether a job runs.
    pub fn is_job_running(&self) -> bool {
        self.playback.is_running
    }

    fn carry_out(&mut self, now_ns: u64, job: &Job, instruction: &Instruction) -> Result<Flow, Bad> {
        let holds = |controller: &Self, condition: &Option<Condition>| match condition {
            Some(condition) => controller.holds(condition),
            None => Ok(true),
        };
        Ok(match instruction {
            Instruction::Nothing => Flow::Next,
            Instruction::End | Instruction::Return => Flow::Return,
            Instruction::Jump { to, condition } if holds(self, condition)? => Flow::To(*to),
            Instruction::Call { job, condition } if holds(self, condition)? => Flow::Call(job.clone()),
            Instruction::Pause { condition } if holds(self, condition)? => Flow::Pause,
            Instruction::Jump { .. } | Instruction::Call { .. } | Instruction::Pause { .. } => Flow::Next,
            Instruction::Wait { condition, time } => {
                let time = match time {
                    Some(time) => Deadline::At(now_ns + self.span_ns(time)?),
                    None => Deadline::Never,
                };
                let condition = Some(*condition);
                Flow::Block(Block::Wait { condition, time })
            }
            Instruction::Timer { time } => Flow::Block(Block::Wait {
                condition: None,
                time: Deadline::At(now_ns + self.span_ns(time)?),
            }),
            Instruction::Move { path, target, speed } => {
                let position = self.target(job, *target)?;
                let rate = self.written_rate(*speed)?;
                let target = Pose::from_pulses(core::array::from_fn(|axis| position.axes[axis]));
                self.check_reach(&target).map_err(|_| Bad(CODE_LIMIT))?;
                self.tool = position.tool;
                let path = *path;
                Flow::Block(Block::Move { path, target, rate })
            }
            _ => {
                self.calculate(now_ns, instruction)?;
                Flow::Next
            }
        })
    }

    /// Position of a move: pulses, base or robot; there is no user coordinate.
    fn target(&self, job: &Job, target: Target) -> Result<Position, Bad> {
        let position = match target {
            Target::Own(number) => job.positions.get(&number).copied(),
            Target::Variable(index) => match self.variables.read(Kind::P, self.index(index)?) {
                Ok(Value::P(position)) => Some(position),
                _ => None,
            },
        };
        position
            .filter(|position| matches!(position.kind, 0 | 16 | 17))
            .ok_or(Bad(CODE_POSITION))
    }

    fn written_rate(&self, speed: WrittenSpeed) -> Result<Rate, Bad> {
        let value = self.whole(speed.value)?;
        let value = i32::try_from(value).map_err(|_| Bad(CODE_INSTRUCTION))?;
        let ordered = OrderedSpeed {
            class: speed.class,
            value,
        };
        ordered.rate().map_err(|_| Bad(CODE_INSTRUCTION))
    }

    /// Span on the cell's clock.
    fn span_ns(&self, time: &Time) -> Result<u64, Bad> {
        let seconds = match time {
            Time::Seconds(seconds) => *seconds,
            Time::Variable(place) => self.number(*place)? / 100.0,
        };
        if (0.0..=TIME_MAX_S).contains(&seconds) {
            Ok(self.clock_span_ns(seconds))
        } else {
            Err(Bad(CODE_INSTRUCTION))
        }
    }

    fn call(&mut self, now_ns: u64, caller: Frame, name: &str) {
        match self.files.job(name) {
            Some(job) if self.playback.callers.len() < CALL_DEPTH_MAX => {
                self.playback.callers.push(caller);
                self.playback.current = Some(Frame { job, line: 0 });
                self.end_of_instruction(now_ns);
            }
            _ => self.job_alarm(now_ns, Bad(CODE_INSTRUCTION)),
        }
    }

    /// Back to the caller, behind the call; at the end of the first job what the cycle says.
    fn return_from_job(&mut self, now_ns: u64) {
        if let Some(caller) = self.playback.callers.pop() {
            self.playback.current = Some(caller);
            self.go_on(now_ns);
            return;
        }
        self.go_to(0);
        self.end_of_instruction(now_ns);
        if self.switches.cycle != Cycle::Auto {
            self.stop_job(now_ns);
        }
    }

    /// Behind the current line.
    fn go_on(&mut self, now_ns: u64) {
        self.playback.block = Block::Nothing;
        if let Some(frame) = &mut self.playback.current {
            frame.line += 1;
        }
        self.end_of_instruction(now_ns);
    }

    fn go_to(&mut self, line: usize) {
        if let Some(frame) = &mut self.playback.current {
            frame.line = line;
        }
    }

    fn end_of_instruction(&mut self, now_ns: u64) {
        self.playback.next_ns = now_ns + self.instruction_ns();
        self.last_active_ns = now_ns;
        if self.switches.cycle == Cycle::Step {
            self.stop_job(now_ns);
        }
    }

    fn job_alarm(&mut self, now_ns: u64, bad: Bad) {
        let line = self.playback.current.as_ref().map_or(0, |frame| frame.line as u32);
        self.raise_alarm(now_ns, bad.0, line);
    }

    fn instruction_ns(&self) -> u64 {
        self.clock_span_ns(INSTRUCTION_S).max(1)
    }
}

impl Playback {
    fn select(&mut self, frame: Frame) {
        self.clear();
        self.current = Some(frame);
    }

    fn clear(&mut self) {
        self.current = None;
        self.callers.clear();
        self.is_running = false;
        self.block = Block::Nothing;
    }
}

/// Tasks that may have a master job: 0 to 15.
pub const TASK_COUNT: usize = 16;
/// An instruction that moves nothing takes this long on the controller, so that a job runs four in a millisecond. The
/// simulator's own.
pub const INSTRUCTION_S: f64 = 0.000_25;
/// Jobs that may wait for jobs that they called.
const CALL_DEPTH_MAX: usize = 10;
const TIME_MAX_S: f64 = 655.35;

#[cfg(test)]
#[path = "run_tests.rs"]
mod tests;
