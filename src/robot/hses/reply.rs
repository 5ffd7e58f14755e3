//! Answers of HSES read as replies (`docs/protocols/hses.md`, section 2).

use super::layout::{BASE, Layout, ROBOT, SIGNALS, TOOL, USER, layout};
use super::wire::Answer;
use crate::robot::command::Command;
use crate::robot::pose::WirePose;
use crate::robot::reply::{Alarm, ExecutingJob, Position, Reply, ReplyError, Status, SystemInformation};
use crate::robot::variable::{Form, Frame, PositionVariable, Values, VariableKind};

/// Reads the data of a positive answer to `command`.
///
/// # Errors
///
/// The data have another length than the command's answer, or a field that it cannot have.
pub fn reply(command: &Command, answer: &Answer) -> Result<Reply, ReplyError> {
    let data = answer.data.as_slice();
    Ok(match command {
        Command::Status => {
            length(data, 8)?;
            Reply::Status(Status {
                data_1: u32_at(data, 0),
                data_2: u32_at(data, 4),
            })
        }
        Command::Alarm(_) | Command::AlarmHistory { .. } => {
            if data.len() != ALARM_WITH_SUB_TEXT_BYTES {
                length(data, 60)?;
            }
            Reply::Alarm((u32_at(data, 0) != 0).then(|| Alarm {
                code: u32_at(data, 0),
                data: u32_at(data, 4),
                time: text(&data[12..28]),
                name: text(&data[28..60]),
            }))
        }
        Command::Position => Reply::Position(position(data)?),
        Command::Pulses => Reply::Pulses(pulses(data)?),
        Command::ExecutingJob => {
            length(data, 44)?;
            Reply::ExecutingJob(ExecutingJob {
                name: text(&data[0..32]),
                line: u32_at(data, 32),
                step: u32_at(data, 36),
                override_e2_percent: Some(u32_at(data, 40)),
            })
        }
        Command::SystemInformation => {
            length(data, 48)?;
            Reply::SystemInformation(SystemInformation {
                software: text(&data[0..24]),
                model: text(&data[24..40]),
            })
        }
        Command::ReadSignals { count, .. } => Reply::Signals(elements(data, SIGNALS, *count)?.to_vec()),
        Command::Read { first, count: 1 } if first.kind == VariableKind::Position => {
            position_length(data)?;
            let mut whole = [0; 52];
            whole[..data.len()].copy_from_slice(data);
            Reply::Values(Values::Position(vec![position_variable(&whole)?]))
        }
        Command::Read { first, count } => {
            let layout = layout(first.kind);
            Reply::Values(values(first.kind, layout, elements(data, layout, *count)?)?)
        }
        _ => Reply::Done,
    })
}

/// The bytes of `count` values: alone, or after their count.
fn elements(data: &[u8], layout: Layout, count: u16) -> Result<&[u8], ReplyError> {
    if count == 1 {
        return one(data, layout);
    }
    length(data, 4 + usize::from(count) * layout.bytes)?;
    let stated = u32_at(data, 0);
    if stated != u32::from(count) {
        return Err(ReplyError::Field {
            field: "count",
            found: stated.to_string(),
        });
    }
    Ok(&data[4..])
}

/// The bytes of a single value. Some controllers give a short one a slot of four bytes; what fills it must be the
/// value's sign.
fn one(data: &[u8], layout: Layout) -> Result<&[u8], ReplyError> {
    if data.len() == SLOT_BYTES && layout.bytes < SLOT_BYTES {
        let (value, filler) = data.split_at(layout.bytes);
        let negative = value[layout.bytes - 1] & 0x80 != 0;
        if filler.iter().all(|&byte| byte == 0) || negative && filler.iter().all(|&byte| byte == 0xFF) {
            return Ok(value);
        }
    }
    length(data, layout.bytes)?;
    Ok(data)
}

/// Reads whole values of one kind.
fn values(kind: VariableKind, layout: Layout, data: &[u8]) -> Result<Values, ReplyError> {
    let chunks = data.chunks_exact(layout.bytes);
    Ok(match kind {
        VariableKind::Byte => Values::Byte(data.to_vec()),
        VariableKind::Integer => Values::Integer(chunks.map(|two| i16::from_le_bytes([two[0], two[1]])).collect()),
        VariableKind::Register => Values::Register(chunks.map(|two| u16::from_le_bytes([two[0], two[1]])).collect()),
        VariableKind::Double => Values::Double(chunks.map(|four| u32_at(four, 0) as i32).collect()),
        VariableKind::Real => Values::Real(chunks.map(|four| f32::from_bits(u32_at(four, 0))).collect()),
        VariableKind::Text => Values::Text(chunks.map(text).collect()),
        VariableKind::Position => Values::Position(chunks.map(position_variable).collect::<Result<_, _>>()?),
    })
}

/// `data` has 52 bytes.
fn position_variable(data: &[u8]) -> Result<PositionVariable, ReplyError> {
    let word = |index: usize| u32_at(data, index * 4) as i32;
    let tool = byte_field("tool", word(2))?;
    let frame = match word(0) {
        0 => {
            let pulses = std::array::from_fn(|axis| word(5 + axis));
            return Ok(PositionVariable::Pulses { pulses, tool });
        }
        BASE => Frame::Base,
        ROBOT => Frame::Robot,
        USER => Frame::User(byte_field("user frame", word(3))?),
        TOOL => Frame::Tool,
        other => return Err(ReplyError::PositionType(other)),
    };
    Ok(PositionVariable::Cartesian {
        frame,
        pose: pose(data),
        form: Form(byte_field("form", word(1))?),
        tool,
    })
}

fn position(data: &[u8]) -> Result<Position, ReplyError> {
    position_length(data)?;
    let word = |index: usize| u32_at(data, index * 4) as i32;
    if word(0) != BASE {
        return Err(ReplyError::PositionType(word(0)));
    }
    Ok(Position {
        base_from_tool: pose(data),
        tool: word(2),
    })
}

/// The axes that are not sent are 0.
fn pulses(data: &[u8]) -> Result<[i32; 8], ReplyError> {
    position_length(data)?;
    let kind = u32_at(data, 0) as i32;
    if kind != 0 {
        return Err(ReplyError::PositionType(kind));
    }
    Ok(std::array::from_fn(|axis| {
        match data.get(20 + axis * 4..24 + axis * 4) {
            Some(four) => u32_at(four, 0) as i32,
            None => 0,
        }
    }))
}

fn position_length(data: &[u8]) -> Result<(), ReplyError> {
    match data.len() {
        44 | 48 | 52 => Ok(()),
        found => Err(ReplyError::Length { expected: 52, found }),
    }
}

/// Words 5 to 10; `data` has at least 44 bytes.
fn pose(data: &[u8]) -> WirePose {
    let word = |index: usize| u32_at(data, index * 4) as i32;
    WirePose {
        position_um: [word(5), word(6), word(7)],
        rotation_e4_deg: [word(8), word(9), word(10)],
    }
}

fn byte_field(field: &'static str, word: i32) -> Result<u8, ReplyError> {
    u8::try_from(word).map_err(|_| ReplyError::Field {
        field,
        found: word.to_string(),
    })
}

fn length(data: &[u8], expected: usize) -> Result<(), ReplyError> {
    match data.len() {
        found if found == expected => Ok(()),
        found => Err(ReplyError::Length { expected, found }),
    }
}

fn u32_at(data: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]])
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

/// An alarm record followed by its sub-texts (16, 96 and 96 bytes), which some controllers always send.
const ALARM_WITH_SUB_TEXT_BYTES: usize = 268;
/// The slot that some controllers give every single number.
const SLOT_BYTES: usize = 4;
