//! Commands as requests of HSES (`docs/protocols/hses.md`, sections 2 and 4).

use super::wire::{Request, Service};
use crate::robot::command::{AlarmClass, Command, Cycle, Move, MovePulses, Path, Speed};
use crate::robot::variable::{Frame, JobName, PositionVariable, Values, Variable, VariableKind};

/// The request of `command` with the given id.
pub fn request(command: &Command, id: u8) -> Request {
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
        Command::ReadSignals { first_group, count: 1 } => (0x78, *first_group, 1, Service::GetOne, vec![]),
        Command::ReadSignals { first_group, count } => {
            (0x300, *first_group, 0, Service::ReadMany, word(u32::from(*count)))
        }
        Command::WriteSignals { first_group, groups } => match groups.as_slice() {
            [group] => (0x78, *first_group, 1, Service::SetOne, vec![*group]),
            groups => (
                0x300,
                *first_group,
                0,
                Service::WriteMany,
                counted(groups.len(), groups.iter().copied()),
            ),
        },
        Command::Read { first, count: 1 } => read_one(*first),
        Command::Read { first, count } => (
            many(first.kind),
            first.index,
            0,
            Service::ReadMany,
            word(u32::from(*count)),
        ),
        Command::Write { first, values } => write(*first, values),
        Command::Order { variable, value } => {
            let first = Variable {
                kind: VariableKind::Double,
                index: *variable,
            };
            write(first, &Values::Double(vec![*value]))
        }
        Command::AlarmReset => (0x82, 1, 1, Service::SetOne, word(1)),
        Command::ErrorCancel => (0x82, 2, 1, Service::SetOne, word(1)),
        Command::HoldOn => (0x83, 1, 1, Service::SetOne, word(1)),
        Command::HoldOff => (0x83, 1, 1, Service::SetOne, word(2)),
        Command::ServoOn => (0x83, 2, 1, Service::SetOne, word(1)),
        Command::ServoOff => (0x83, 2, 1, Service::SetOne, word(2)),
        Command::SetCycle(cycle) => (0x84, 2, 1, Service::SetOne, word(cycle_number(*cycle))),
        Command::ShowText(text) => (0x85, 1, 1, Service::SetOne, padded(text.as_bytes(), 32)),
        Command::StartJob => (0x86, 1, 1, Service::SetOne, word(1)),
        Command::SelectJob { job, line } => (0x87, 1, 0, Service::SetAll, selection(job, *line)),
        Command::Move(target) => (0x8A, path(target.path), 1, Service::SetAll, cartesian(target)),
        Command::MovePulses(target) => (0x8B, path(target.path), 1, Service::SetAll, by_axes(target)),
    };
    Request {
        id,
        command: number,
        instance,
        attribute,
        service,
        data,
    }
}

/// How many variables of a kind one request carries (section 2).
pub fn values_max(kind: VariableKind) -> usize {
    match kind {
        VariableKind::Byte => 474,
        VariableKind::Integer => 237,
        VariableKind::Double | VariableKind::Real => 118,
        VariableKind::Text => 29,
        VariableKind::Position => 9,
    }
}

type Parts = (u16, u16, u8, Service, Vec<u8>);

fn read_one(variable: Variable) -> Parts {
    let (attribute, service) = match variable.kind {
        VariableKind::Position => (0, Service::GetAll),
        _ => (1, Service::GetOne),
    };
    (one(variable.kind), variable.index, attribute, service, vec![])
}

fn write(first: Variable, values: &Values) -> Parts {
    let data = elements(values);
    match (values.count(), first.kind) {
        (1, VariableKind::Position) => (one(first.kind), first.index, 0, Service::SetAll, data),
        (1, _) => (one(first.kind), first.index, 1, Service::SetOne, data),
        (count, _) => (
            many(first.kind),
            first.index,
            0,
            Service::WriteMany,
            counted(count, data),
        ),
    }
}

fn elements(values: &Values) -> Vec<u8> {
    match values {
        Values::Byte(values) => values.clone(),
        Values::Integer(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Double(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Real(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        Values::Text(values) => values.iter().flat_map(|value| padded(value.as_bytes(), 16)).collect(),
        Values::Position(values) => values.iter().flat_map(position).collect(),
    }
}

/// 13 × i32: type, form, tool, user frame, extended form, eight axes.
fn position(value: &PositionVariable) -> Vec<u8> {
    let mut words = [0i32; 13];
    match value {
        PositionVariable::Unset => {}
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
    bytes(&words)
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

fn speed(speed: Speed) -> (i32, i32) {
    match speed {
        Speed::Link(value) => (0, value as i32),
        Speed::ToolPoint(value) => (1, value as i32),
        Speed::Turn(value) => (2, value as i32),
    }
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

fn one(kind: VariableKind) -> u16 {
    match kind {
        VariableKind::Byte => 0x7A,
        VariableKind::Integer => 0x7B,
        VariableKind::Double => 0x7C,
        VariableKind::Real => 0x7D,
        VariableKind::Text => 0x7E,
        VariableKind::Position => 0x7F,
    }
}

fn many(kind: VariableKind) -> u16 {
    match kind {
        VariableKind::Byte => 0x302,
        VariableKind::Integer => 0x303,
        VariableKind::Double => 0x304,
        VariableKind::Real => 0x305,
        VariableKind::Text => 0x306,
        VariableKind::Position => 0x307,
    }
}

fn selection(job: &JobName, line: u32) -> Vec<u8> {
    let mut data = padded(job.as_str().as_bytes(), 32);
    data.extend_from_slice(&line.to_le_bytes());
    data
}

fn counted(count: usize, data: impl IntoIterator<Item = u8>) -> Vec<u8> {
    let mut counted = word(count as u32);
    counted.extend(data);
    counted
}

/// `text` in a field of `size` bytes, cut or filled with NUL.
fn padded(text: &[u8], size: usize) -> Vec<u8> {
    let mut field = text[..text.len().min(size)].to_vec();
    field.resize(size, 0);
    field
}

fn word(value: u32) -> Vec<u8> {
    value.to_le_bytes().to_vec()
}

fn bytes(words: &[i32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

pub(super) const BASE: i32 = 16;
pub(super) const ROBOT: i32 = 17;
pub(super) const USER: i32 = 18;
pub(super) const TOOL: i32 = 19;
