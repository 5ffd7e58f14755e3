//! Commands as requests of HSES (`docs/protocols/hses.md`, sections 2 and 4).

use super::layout::{BASE, Layout, ROBOT, SIGNALS, TEXT_BYTES, TOOL, USER, layout};
use super::wire::{Request, Service};
use crate::robot::command::{AlarmClass, Command, Cycle, Move, MovePulses, Path, Speed};
use crate::robot::variable::{Frame, JobName, PositionVariable, Values, Variable, VariableKind};
use thiserror::Error;

/// Why a command cannot be said in one frame. Nothing is cut, filled up or split in silence: who asks for more than a
/// frame carries says it in several commands.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum RequestError {
    /// None, or more than one frame carries.
    #[error("{count} values where one frame carries 1 to {count_max}")]
    Count {
        /// How many were to go.
        count: usize,
        /// How many can.
        count_max: u16,
    },
    /// B variables and groups of signals go one alone or in even numbers: a filler would overwrite a neighbour.
    #[error("{0} values where several go in even numbers only")]
    Odd(usize),
    /// The values are of another kind than the variable.
    #[error("the values for {0} are of another kind")]
    Kind(Variable),
    /// A position that is not set has no bytes: zeros would be a position of the axes.
    #[error("a position that is not set cannot be written to {0}")]
    Unset(Variable),
    /// A text that its field cannot have.
    #[error("{text:?} is not a text of at most {bytes_max} printable ASCII characters")]
    Text {
        /// The text.
        text: String,
        /// Length of the field.
        bytes_max: usize,
    },
    /// HSES keeps jobs as files, at another port.
    #[error("HSES has no command for: {0}; jobs are files there")]
    File(&'static str),
    /// A line that a job cannot begin at.
    #[error("line {0} is beyond 9999")]
    Line(u32),
}

/// The request of `command` with the given id.
///
/// # Errors
///
/// One frame cannot carry the command, or a field cannot have its value.
pub fn request(command: &Command, id: u8) -> Result<Request, RequestError> {
    let (number, instance, attribute, service, data) = match command {
        Command::Alarm(index) => (0x70, 1 + u16::from(*index), 0, Service::GetAll, vec![]),
        Command::AlarmHistory { class, index } => {
            let instance = history_base(*class) + 1 + u16::from(*index);
            (0x71, instance, 0, Service::GetAll, vec![])
        }
        Command::Status => (0x72, 1, 0, Service::GetAll, vec![]),
        Command::ExecutingJob => (0x73, 1, 0, Service::GetAll, vec![]),
        Command::Position => (0x75, 101, 0, Service::GetAll, vec![]),
        Command::Pulses => (0x75, 1, 0, Service::GetAll, vec![]),
        Command::SystemInformation => (0x89, 11, 0, Service::GetAll, vec![]),
        Command::ReadSignals { first_group, count } => match fitting(SIGNALS, usize::from(*count))? {
            Fitting::One => (SIGNALS.one, *first_group, 1, Service::GetOne, vec![]),
            Fitting::Many(count) => (SIGNALS.many, *first_group, 0, Service::ReadMany, word(count)),
        },
        Command::WriteSignals { first_group, groups } => match fitting(SIGNALS, groups.len())? {
            Fitting::One => (SIGNALS.one, *first_group, 1, Service::SetOne, groups.clone()),
            Fitting::Many(count) => {
                let data = counted(count, groups.clone());
                (SIGNALS.many, *first_group, 0, Service::WriteMany, data)
            }
        },
        Command::Read { first, count } => read(*first, *count)?,
        Command::Write { first, values } => write(*first, values)?,
        Command::Order { variable, value } => {
            let first = Variable {
                kind: VariableKind::Double,
                index: *variable,
            };
            write(first, &Values::Double(vec![*value]))?
        }
        Command::AlarmReset => (0x82, 1, 1, Service::SetOne, word(1)),
        Command::ErrorCancel => (0x82, 2, 1, Service::SetOne, word(1)),
        Command::HoldOn => (0x83, 1, 1, Service::SetOne, word(1)),
        Command::HoldOff => (0x83, 1, 1, Service::SetOne, word(2)),
        Command::ServoOn => (0x83, 2, 1, Service::SetOne, word(1)),
        Command::ServoOff => (0x83, 2, 1, Service::SetOne, word(2)),
        Command::SetCycle(cycle) => (0x84, 2, 1, Service::SetOne, word(cycle_number(*cycle))),
        Command::ShowText(shown) => (0x85, 1, 1, Service::SetOne, padded(text(shown, 30)?, 32)),
        Command::JobNames | Command::DeleteJob { .. } => return Err(RequestError::File(command.name())),
        Command::StartJob => (0x86, 1, 1, Service::SetOne, word(1)),
        Command::SelectJob { job, line } => (0x87, 1, 0, Service::SetAll, selection(job, *line)?),
        Command::Move(target) => (0x8A, path(target.path), 1, Service::SetAll, cartesian(target)),
        Command::MovePulses(target) => (0x8B, path(target.path), 1, Service::SetAll, by_axes(target)),
    };
    Ok(Request {
        id,
        command: number,
        instance,
        attribute,
        service,
        data,
    })
}

/// What a datagram of ours asks for, in the words of the page, as far as its command number says it.
pub fn request_name(datagram: &[u8]) -> &'static str {
    let [Some(low), Some(high), Some(instance)] = [24, 25, 26].map(|at| datagram.get(at)) else {
        return "too short for a request";
    };
    match (u16::from_le_bytes([*low, *high]), instance) {
        (0x70, _) => "alarm",
        (0x71, _) => "alarm history",
        (0x72, _) => "status",
        (0x73, _) => "executing job",
        (0x75, _) => "position",
        (0x78 | 0x300, _) => "signals",
        (0x79 | 0x301, _) => "registers",
        (0x7A..=0x7F | 0x302..=0x307, _) => "variables",
        (0x82, _) => "reset",
        (0x83, 1) => "hold",
        (0x83, _) => "servo",
        (0x84, _) => "cycle",
        (0x85, _) => "text on the pendant",
        (0x86, _) => "start",
        (0x87, _) => "job select",
        (0x89, _) => "system information",
        (0x8A | 0x8B, _) => "move",
        _ => "another command",
    }
}

/// How many variables of a kind one request carries (section 5 of the page).
pub fn values_max(kind: VariableKind) -> usize {
    usize::from(layout(kind).count_max)
}

type Parts = (u16, u16, u8, Service, Vec<u8>);

/// The form in which a number of values goes.
enum Fitting {
    One,
    Many(u32),
}

fn fitting(layout: Layout, count: usize) -> Result<Fitting, RequestError> {
    match count {
        1 => Ok(Fitting::One),
        count if count == 0 || count > usize::from(layout.count_max) => Err(RequestError::Count {
            count,
            count_max: layout.count_max,
        }),
        count if layout.even && count % 2 == 1 => Err(RequestError::Odd(count)),
        count => Ok(Fitting::Many(count as u32)),
    }
}

fn read(first: Variable, count: u16) -> Result<Parts, RequestError> {
    let layout = layout(first.kind);
    Ok(match (fitting(layout, usize::from(count))?, first.kind) {
        (Fitting::One, VariableKind::Position) => (layout.one, first.index, 0, Service::GetAll, vec![]),
        (Fitting::One, _) => (layout.one, first.index, 1, Service::GetOne, vec![]),
        (Fitting::Many(count), _) => (layout.many, first.index, 0, Service::ReadMany, word(count)),
    })
}

fn write(first: Variable, values: &Values) -> Result<Parts, RequestError> {
    if values.kind() != first.kind {
        return Err(RequestError::Kind(first));
    }
    let layout = layout(first.kind);
    let fitting = fitting(layout, values.count())?;
    let data = elements(first, values)?;
    Ok(match (fitting, first.kind) {
        (Fitting::One, VariableKind::Position) => (layout.one, first.index, 0, Service::SetAll, data),
        (Fitting::One, _) => (layout.one, first.index, 1, Service::SetOne, data),
        (Fitting::Many(count), _) => (layout.many, first.index, 0, Service::WriteMany, counted(count, data)),
    })
}

fn elements(first: Variable, values: &Values) -> Result<Vec<u8>, RequestError> {
    Ok(match values {
        Values::Byte(values) => values.clone(),
        Values::Integer(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Register(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Double(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Real(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Text(values) => {
            let fields = values
                .iter()
                .map(|value| Ok(padded(text(value, TEXT_BYTES)?, TEXT_BYTES)));
            fields.collect::<Result<Vec<_>, _>>()?.concat()
        }
        Values::Position(values) => {
            let fields = values.iter().map(|value| position(first, value));
            fields.collect::<Result<Vec<_>, _>>()?.concat()
        }
    })
}

/// 13 × i32: type, form, tool, user frame, extended form, eight axes.
fn position(first: Variable, value: &PositionVariable) -> Result<Vec<u8>, RequestError> {
    let mut words = [0i32; 13];
    match value {
        PositionVariable::Unset => return Err(RequestError::Unset(first)),
        PositionVariable::Pulses { pulses, tool } => {
            words[2] = i32::from(*tool);
            words[5..13].copy_from_slice(pulses);
        }
        PositionVariable::Cartesian {
            frame,
            pose,
            form,
            tool,
        } => {
            (words[0], words[3]) = match frame {
                Frame::Base => (BASE, 0),
                Frame::Robot => (ROBOT, 0),
                Frame::User(number) => (USER, i32::from(*number)),
                Frame::Tool => (TOOL, 0),
            };
            words[1] = i32::from(form.0);
            words[2] = i32::from(*tool);
            words[5..8].copy_from_slice(&pose.position_um);
            words[8..11].copy_from_slice(&pose.rotation_e4_deg);
        }
    }
    Ok(bytes(&words))
}

/// 26 × i32, section 4 of the page.
fn cartesian(target: &Move) -> Vec<u8> {
    let mut words = [0i32; 26];
    words[0] = 1;
    (words[2], words[3]) = speed(target.speed);
    words[4] = BASE;
    words[5..8].copy_from_slice(&target.base_from_tool.position_um);
    words[8..11].copy_from_slice(&target.base_from_tool.rotation_e4_deg);
    words[15] = i32::from(target.tool);
    bytes(&words)
}

/// 22 × i32, section 4 of the page.
fn by_axes(target: &MovePulses) -> Vec<u8> {
    let mut words = [0i32; 22];
    words[0] = 1;
    (words[2], words[3]) = speed(target.speed);
    words[4..12].copy_from_slice(&target.pulses);
    words[12] = i32::from(target.tool);
    bytes(&words)
}

/// Class and value. A value beyond the field saturates; the controller refuses both.
fn speed(speed: Speed) -> (i32, i32) {
    let (class, value) = match speed {
        Speed::Link(value) => (0, value),
        Speed::ToolPoint(value) => (1, value),
        Speed::Turn(value) => (2, value),
    };
    (class, i32::try_from(value).unwrap_or(i32::MAX))
}

fn path(path: Path) -> u16 {
    match path {
        Path::Link => 1,
        Path::Straight => 2,
    }
}

fn cycle_number(cycle: Cycle) -> u32 {
    match cycle {
        Cycle::Step => 1,
        Cycle::Once => 2,
        Cycle::Continuous => 3,
    }
}

fn history_base(class: AlarmClass) -> u16 {
    match class {
        AlarmClass::Major => 0,
        AlarmClass::Minor => 1000,
        AlarmClass::UserSystem => 2000,
        AlarmClass::UserUser => 3000,
        AlarmClass::Offline => 4000,
    }
}

fn selection(job: &JobName, line: u32) -> Result<Vec<u8>, RequestError> {
    if line > LINE_MAX {
        return Err(RequestError::Line(line));
    }
    let mut data = padded(job.as_str().as_bytes(), 32);
    data.extend_from_slice(&line.to_le_bytes());
    Ok(data)
}

/// The bytes of `text`, if a field of that length can have them.
fn text(text: &str, bytes_max: usize) -> Result<&[u8], RequestError> {
    let printable = |byte: u8| (0x20..0x7F).contains(&byte);
    if text.len() <= bytes_max && text.bytes().all(printable) {
        Ok(text.as_bytes())
    } else {
        Err(RequestError::Text {
            text: text.to_owned(),
            bytes_max,
        })
    }
}

/// `text`, which is not longer, in a field of `size` bytes filled with NUL.
fn padded(text: &[u8], size: usize) -> Vec<u8> {
    let mut field = text.to_vec();
    field.resize(size, 0);
    field
}

fn counted(count: u32, mut data: Vec<u8>) -> Vec<u8> {
    data.splice(0..0, count.to_le_bytes());
    data
}

fn word(value: u32) -> Vec<u8> {
    value.to_le_bytes().to_vec()
}

fn bytes(words: &[i32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// The last line a job can begin at.
const LINE_MAX: u32 = 9999;
