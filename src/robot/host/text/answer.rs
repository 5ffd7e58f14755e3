//! Answers read as replies.

use super::number::read_fixed;
use super::phrase::{ACTIVE_ALARMS, USER_FRAME_MAX};
use crate::robot::command::Command;
use crate::robot::pose::WirePose;
use crate::robot::reply::{Alarm, ExecutingJob, Position, Reply, ReplyError, Status, SystemInformation};
use crate::robot::variable::{Form, Frame, PositionVariable, Values, VariableKind};
use std::str::FromStr;

/// Whether a positive answer to `command` carries data, rather than the result code alone.
pub fn expects_data(command: &Command) -> bool {
    matches!(
        command,
        Command::Status
            | Command::Alarm(_)
            | Command::AlarmHistory { .. }
            | Command::Position
            | Command::Pulses
            | Command::ExecutingJob
            | Command::SystemInformation
            | Command::Read { .. }
            | Command::ReadSignals { .. }
    )
}

/// A result code: four hexadecimal digits, 0 for "carried out".
pub fn result_code(text: &str) -> Option<u16> {
    let text = text.trim();
    let digits = text.len() == 4 && text.bytes().all(|byte| byte.is_ascii_hexdigit());
    digits.then(|| u16::from_str_radix(text, 16).ok())?
}

/// The code in the closing parentheses of an error line; 0 when there is none.
pub fn refusal_code(line: &str) -> u16 {
    let code = line
        .rsplit_once('(')
        .and_then(|(_, code)| code.split_once(')'))
        .and_then(|(code, _)| result_code(code));
    code.unwrap_or(0)
}

/// Reads the data of a positive answer to `command`, without the closing CR.
///
/// # Errors
///
/// The answer has another number of fields than the command's, or one that it cannot have.
pub fn reply(command: &Command, text: &str) -> Result<Reply, ReplyError> {
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    Ok(match command {
        Command::Status => {
            count(&fields, 2, 2)?;
            Reply::Status(Status {
                data_1: number("data 1", fields[0])?,
                data_2: number("data 2", fields[1])?,
            })
        }
        Command::Alarm(index) => Reply::Alarm(alarm(&fields, *index)?),
        Command::Position => {
            position_fields(&fields)?;
            Reply::Position(Position {
                base_from_tool: pose(&fields[..6])?,
                tool: number("tool", fields[7])?,
            })
        }
        Command::Pulses => {
            count(&fields, 6, 12)?;
            Reply::Pulses(pulses(&fields[..fields.len().min(8)])?)
        }
        Command::ExecutingJob => {
            count(&fields, 3, 3)?;
            Reply::ExecutingJob(ExecutingJob {
                name: fields[0].to_owned(),
                line: number("line", fields[1])?,
                step: number("step", fields[2])?,
                override_e2_percent: None,
            })
        }
        Command::SystemInformation => Reply::SystemInformation(from_job_names(&fields)),
        Command::Read { first, .. } => Reply::Values(values(first.kind, text, &fields)?),
        Command::ReadSignals { count: groups, .. } => {
            count(&fields, usize::from(*groups), usize::from(*groups))?;
            let bytes = fields.iter().map(|field| number("group", field));
            Reply::Signals(bytes.collect::<Result<_, _>>()?)
        }
        _ => Reply::Done,
    })
}

/// The arm's configuration in an answer to [`Command::Position`].
pub fn form(text: &str) -> Option<Form> {
    let bits: u8 = text.split(',').nth(6)?.trim().parse().ok()?;
    (bits <= FORM_BITS).then(|| Form::from_host_bits(bits))
}

/// What the controller is, by the line with which its TCP server greets: `OK: DX Information Server( 1.07).`
pub fn system_information(greeting: &str) -> SystemInformation {
    let text = greeting.strip_prefix("OK:").unwrap_or(greeting).trim();
    let (model, rest) = text.split_once("Information Server").unwrap_or((text, ""));
    let software = rest
        .split_once('(')
        .and_then(|(_, rest)| rest.rsplit_once(')'))
        .map_or("", |(software, _)| software);
    SystemInformation {
        software: software.trim().to_owned(),
        model: format!("{} (host control)", model.trim()),
    }
}

/// What the controller is, by the names of its jobs: a serial line has no greeting.
fn from_job_names(names: &[&str]) -> SystemInformation {
    let simulated = names.iter().any(|name| matches!(*name, "SIMULATED" | "SIMULATED.JBI"));
    SystemInformation {
        software: if simulated { "SIMULATED" } else { "" }.into(),
        model: "DX200 (serial)".into(),
    }
}

/// Error code and data, then code and data of four alarms, the newest first.
fn alarm(fields: &[&str], index: u8) -> Result<Option<Alarm>, ReplyError> {
    count(fields, 10, 10)?;
    let at = 2 + 2 * usize::from(index.min(ACTIVE_ALARMS - 1));
    let code = number("alarm code", fields[at])?;
    let data = number("alarm data", fields[at + 1])?;
    Ok((code != 0).then(|| Alarm {
        code,
        data,
        time: String::new(),
        name: String::new(),
    }))
}

fn values(kind: VariableKind, text: &str, fields: &[&str]) -> Result<Values, ReplyError> {
    let one = || count(fields, 1, 1).map(|()| fields[0]);
    Ok(match kind {
        VariableKind::Byte => Values::Byte(vec![number("byte", one()?)?]),
        VariableKind::Integer => Values::Integer(vec![number("integer", one()?)?]),
        VariableKind::Double => Values::Double(vec![number("double", one()?)?]),
        VariableKind::Real => match number::<f32>("real", one()?)? {
            real if real.is_finite() => Values::Real(vec![real]),
            _ => return Err(wrong("real", fields[0])),
        },
        VariableKind::Text => Values::Text(vec![text.trim().to_owned()]),
        VariableKind::Position => Values::Position(vec![position_variable(fields)?]),
        VariableKind::Register => Values::Register(vec![number("register", one()?)?]),
    })
}

fn position_variable(fields: &[&str]) -> Result<PositionVariable, ReplyError> {
    match fields[0] {
        "0" => {
            count(fields, 8, 10)?;
            let (tool, axes) = fields[1..].split_last().expect("eight fields or more");
            Ok(PositionVariable::Pulses {
                pulses: pulses(axes)?,
                tool: number("tool", tool)?,
            })
        }
        "1" => {
            count(fields, 10, 10)?;
            let frame = match number::<u8>("coordinate", fields[1])? {
                0 => Frame::Base,
                1 => Frame::Robot,
                number @ 2.. if number - 1 <= USER_FRAME_MAX => Frame::User(number - 1),
                _ => return Err(wrong("coordinate", fields[1])),
            };
            let bits: u8 = number("type", fields[8])?;
            if bits > FORM_BITS {
                return Err(wrong("type", fields[8]));
            }
            Ok(PositionVariable::Cartesian {
                frame,
                pose: pose(&fields[2..8])?,
                form: Form::from_host_bits(bits),
                tool: number("tool", fields[9])?,
            })
        }
        other => Err(wrong("position type", other)),
    }
}

/// X, Y, Z, Rx, Ry, Rz, type, tool, and up to six external axes.
fn position_fields(fields: &[&str]) -> Result<(), ReplyError> {
    count(fields, 8, 14)
}

/// Six fields: mm and degrees.
fn pose(fields: &[&str]) -> Result<WirePose, ReplyError> {
    let read = |at: usize, decimals: u32| read_fixed(fields[at], decimals).ok_or_else(|| wrong("pose", fields[at]));
    Ok(WirePose {
        position_um: [read(0, 3)?, read(1, 3)?, read(2, 3)?],
        rotation_e4_deg: [read(3, 4)?, read(4, 4)?, read(5, 4)?],
    })
}

/// At most eight axes; those that are not sent are 0.
fn pulses(fields: &[&str]) -> Result<[i32; 8], ReplyError> {
    let mut pulses = [0; 8];
    for (axis, field) in pulses.iter_mut().zip(fields) {
        *axis = number("axis", field)?;
    }
    Ok(pulses)
}

fn number<T: FromStr>(field: &'static str, text: &str) -> Result<T, ReplyError> {
    text.parse().map_err(|_| wrong(field, text))
}

fn wrong(field: &'static str, text: &str) -> ReplyError {
    ReplyError::Field {
        field,
        found: text.chars().take(SHOWN_CHARS_MAX).collect(),
    }
}

fn count(fields: &[&str], least: usize, most: usize) -> Result<(), ReplyError> {
    match fields.len() {
        found if (least..=most).contains(&found) => Ok(()),
        found => Err(ReplyError::Fields { expected: least, found }),
    }
}

/// Six bits: no flip, lower, back, R, T, S.
const FORM_BITS: u8 = 0b11_1111;
/// Of a wrong field, this much is told.
const SHOWN_CHARS_MAX: usize = 40;
