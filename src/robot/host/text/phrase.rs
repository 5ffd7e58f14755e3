//! Commands as a name and data.

use super::number::write_fixed;
use crate::robot::command::{Command, Cycle, Move, MovePulses, Path, Speed};
use crate::robot::host::Unsupported;
use crate::robot::pose::WirePose;
use crate::robot::variable::{Form, Frame, PositionVariable, Values, Variable, VariableKind};

/// A command as host control says it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Phrase {
    /// The command's name.
    pub name: &'static str,
    /// Its data, fields set apart by commas, without the closing CR; empty when it has none.
    pub data: String,
}

/// What to say for `command`; `form` is the arm's configuration as last reported, which moves are to keep.
///
/// # Errors
///
/// Host control has no words for it.
pub fn phrase(command: &Command, form: Option<Form>) -> Result<Phrase, Unsupported> {
    let (name, data) = match command {
        Command::Status => ("RSTATS", String::new()),
        Command::Alarm(index) if *index < ACTIVE_ALARMS => ("RALARM", String::new()),
        Command::Alarm(index) => return Err(value("alarm", index)),
        Command::AlarmHistory { .. } => return Err(Unsupported::Command(command.name())),
        Command::Position => ("RPOSC", "0,0".into()),
        Command::Pulses => ("RPOSJ", String::new()),
        Command::ExecutingJob => ("RJSEQ", String::new()),
        Command::SystemInformation | Command::JobNames => ("RJDIR", "*".into()),
        Command::DeleteJob { job } => ("DELETE", job.to_string()),
        Command::Read { first, count: 1 } => ("SAVEV", variable(*first)?),
        Command::Read { count, .. } => {
            return Err(Unsupported::Several {
                count: usize::from(*count),
            });
        }
        Command::ReadSignals { first_group, count } => ("IOREAD", signals(*first_group, usize::from(*count))?),
        Command::WriteSignals { first_group, groups } => {
            let mut data = signals(*first_group, groups.len())?;
            for group in groups {
                data.push_str(&format!(",{group}"));
            }
            ("IOWRITE", data)
        }
        Command::HoldOn => ("HOLD", "1".into()),
        Command::HoldOff => ("HOLD", "0".into()),
        Command::ServoOn => ("SVON", "1".into()),
        Command::ServoOff => ("SVON", "0".into()),
        Command::AlarmReset => ("RESET", String::new()),
        Command::ErrorCancel => ("CANCEL", String::new()),
        Command::SetCycle(cycle) => ("CYCLE", cycle_number(*cycle).to_string()),
        Command::ShowText(text) => ("MDSP", plain(text, SHOWN_BYTES_MAX, "")?),
        Command::SelectJob { job, line } if *line <= LINE_MAX => ("JSEQ", format!("{job},{line}")),
        Command::SelectJob { line, .. } => return Err(value("line", line)),
        Command::StartJob => ("START", String::new()),
        Command::Write { first, values } => ("LOADV", format!("{},{}", variable(*first)?, written(values)?)),
        Command::Order { variable, value } => ("LOADV", format!("2,{variable},{value}")),
        Command::Move(target) => cartesian(target, form)?,
        Command::MovePulses(target) => by_axes(target)?,
    };
    Ok(Phrase { name, data })
}

/// Kind and number.
fn variable(variable: Variable) -> Result<String, Unsupported> {
    let kind = match variable.kind {
        VariableKind::Byte => 0,
        VariableKind::Integer => 1,
        VariableKind::Double => 2,
        VariableKind::Real => 3,
        VariableKind::Position => 4,
        VariableKind::Text => 7,
        VariableKind::Register => return Err(Unsupported::Command("registers")),
    };
    Ok(format!("{kind},{}", variable.index))
}

fn written(values: &Values) -> Result<String, Unsupported> {
    if values.count() != 1 {
        return Err(Unsupported::Several { count: values.count() });
    }
    Ok(match values {
        Values::Byte(values) => values[0].to_string(),
        Values::Integer(values) => values[0].to_string(),
        Values::Double(values) => values[0].to_string(),
        Values::Real(values) if values[0].is_finite() => values[0].to_string(),
        Values::Real(values) => return Err(value("real", values[0])),
        Values::Text(values) => plain(&values[0], VARIABLE_BYTES_MAX, ",")?,
        Values::Position(values) => position_variable(&values[0])?,
        Values::Register(_) => return Err(Unsupported::Command("registers")),
    })
}

/// 0, the axes, tool; or 1, coordinate, X, Y, Z, Rx, Ry, Rz, type, tool.
fn position_variable(position: &PositionVariable) -> Result<String, Unsupported> {
    match position {
        PositionVariable::Unset => Err(value("position", "unset")),
        PositionVariable::Pulses { pulses, tool } => {
            let used = pulses.iter().rposition(|&axis| axis != 0).map_or(0, |last| last + 1);
            let axes: Vec<String> = pulses[..used.max(6)].iter().map(i32::to_string).collect();
            Ok(format!("0,{},{tool}", axes.join(",")))
        }
        PositionVariable::Cartesian {
            frame,
            pose,
            form,
            tool,
        } => {
            let coordinate = match frame {
                Frame::Base => 0,
                Frame::Robot => 1,
                Frame::User(number @ 1..=USER_FRAME_MAX) => 1 + *number,
                Frame::User(number) => return Err(value("user frame", number)),
                Frame::Tool => return Err(value("frame", "tool")),
            };
            Ok(format!("1,{coordinate},{},{},{tool}", axes(*pose), form.host_bits()))
        }
    }
}

/// First signal and number of signals.
fn signals(first_group: u16, count: usize) -> Result<String, Unsupported> {
    if !(1..=SIGNAL_GROUPS_MAX).contains(&count) {
        return Err(value("groups of signals", count));
    }
    Ok(format!("{},{}", u32::from(first_group) * 10, count * 8))
}

/// MOVL or MOVJ in the base frame, with no external axes.
fn cartesian(target: &Move, form: Option<Form>) -> Result<(&'static str, String), Unsupported> {
    let (name, speed, form) = match target.path {
        Path::Straight => ("MOVL", straight_speed(target.speed)?, form.unwrap_or_default()),
        Path::Link => ("MOVJ", link_speed(target.speed)?, form.ok_or(Unsupported::UnknownForm)?),
    };
    let (pose, form, tool) = (axes(target.base_from_tool), form.host_bits(), target.tool);
    Ok((name, format!("{speed},0,{pose},{form},{tool},0,0,0,0,0,0")))
}

/// PMOVL or PMOVJ: six axes, the 7th to 12th, tool.
fn by_axes(target: &MovePulses) -> Result<(&'static str, String), Unsupported> {
    let (name, speed) = match target.path {
        Path::Straight => ("PMOVL", straight_speed(target.speed)?),
        Path::Link => ("PMOVJ", link_speed(target.speed)?),
    };
    let axes: Vec<String> = target.pulses.iter().map(i32::to_string).collect();
    Ok((name, format!("{speed},{},0,0,0,0,{}", axes.join(","), target.tool)))
}

/// X, Y, Z in mm, Rx, Ry, Rz in degrees.
fn axes(pose: WirePose) -> String {
    let position = pose.position_um.map(|um| write_fixed(um, 3));
    let rotation = pose.rotation_e4_deg.map(|e4| write_fixed(e4, 4));
    format!("{},{}", position.join(","), rotation.join(","))
}

fn straight_speed(speed: Speed) -> Result<String, Unsupported> {
    let (class, tenths) = match speed {
        Speed::ToolPoint(tenths) => (0, tenths),
        Speed::Turn(tenths) => (1, tenths),
        Speed::Link(_) => return Err(Unsupported::Speed),
    };
    Ok(format!("{class},{}.{}", tenths / 10, tenths % 10))
}

fn link_speed(speed: Speed) -> Result<String, Unsupported> {
    match speed {
        Speed::Link(e2_percent) => Ok(format!("{}.{:02}", e2_percent / 100, e2_percent % 100)),
        Speed::ToolPoint(_) | Speed::Turn(_) => Err(Unsupported::Speed),
    }
}

fn cycle_number(cycle: Cycle) -> u8 {
    match cycle {
        Cycle::Step => 1,
        Cycle::Once => 2,
        Cycle::Continuous => 3,
    }
}

/// `text` if it is 1 to `most` printable ASCII characters, none of them in `other_than`.
fn plain(text: &str, most: usize, other_than: &str) -> Result<String, Unsupported> {
    let fits = |c: char| (c == ' ' || c.is_ascii_graphic()) && !other_than.contains(c);
    if (1..=most).contains(&text.len()) && text.chars().all(fits) {
        Ok(text.to_owned())
    } else {
        Err(Unsupported::Text(text.to_owned()))
    }
}

fn value(field: &'static str, value: impl ToString) -> Unsupported {
    Unsupported::Value {
        field,
        value: value.to_string(),
    }
}

/// RALARM tells this many alarms.
pub(super) const ACTIVE_ALARMS: u8 = 4;
/// Up to here the sources agree on the coordinate number of a user frame, one more than the frame's.
pub(super) const USER_FRAME_MAX: u8 = 16;
const LINE_MAX: u32 = 9999;
const SHOWN_BYTES_MAX: usize = 30;
const VARIABLE_BYTES_MAX: usize = 16;
const SIGNAL_GROUPS_MAX: usize = 256;
