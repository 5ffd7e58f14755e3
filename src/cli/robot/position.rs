//! `bladescan robot position`.

use super::super::{Exit, Failure, print};
use super::{other_answer, row};
use crate::geometry::matrix_rows;
use crate::robot::{Command, Position, Reply};
use crate::run::Conversation;
use serde_json::{Value, json};

pub(super) async fn main(robot: &mut Conversation, json: bool) -> Result<Exit, Failure> {
    let position = read(robot).await?;
    let pulses = match robot.say(Command::Pulses).await? {
        Reply::Pulses(pulses) => pulses,
        _ => return Err(other_answer("axes")),
    };
    if json {
        let mut document = as_json(&position);
        document["pulses"] = json!(pulses);
        print(&document.to_string())?;
    } else {
        let axes: Vec<String> = AXES
            .iter()
            .zip(pulses)
            .map(|(axis, pulses)| format!("{axis} {pulses}"))
            .collect();
        print(
            &[
                row("pose", one_line(&position)),
                row("tool", position.tool),
                row("form", format!("{:#010b}", position.form.0)),
                row("pulses", axes.join("  ")),
            ]
            .join("\n"),
        )?;
    }
    Ok(Exit::Done)
}

pub(super) async fn read(robot: &mut Conversation) -> Result<Position, Failure> {
    match robot.say(Command::Position).await? {
        Reply::Position(position) => Ok(position),
        _ => Err(other_answer("position")),
    }
}

/// The pose in one line: base frame, mm and degrees about fixed axes.
pub(super) fn one_line(position: &Position) -> String {
    let [x, y, z] = position.base_from_tool.position_um.map(|um| f64::from(um) * 1e-3);
    let [rx, ry, rz] = position.base_from_tool.rotation_e4_deg.map(|e4| f64::from(e4) * 1e-4);
    format!("X {x:.3}  Y {y:.3}  Z {z:.3} mm  Rx {rx:.4}  Ry {ry:.4}  Rz {rz:.4} deg")
}

/// The pose as other programs read it.
pub(super) fn as_json(position: &Position) -> Value {
    json!({
        "position_mm": position.base_from_tool.position_um.map(|um| f64::from(um) / 1e3),
        "rotation_deg": position.base_from_tool.rotation_e4_deg.map(|e4| f64::from(e4) / 1e4),
        "base_from_tool": matrix_rows(&position.base_from_tool.to_isometry()),
        "tool": position.tool,
        "form": position.form.0,
    })
}

const AXES: [char; 8] = ['S', 'L', 'U', 'R', 'B', 'T', 'E', 'W'];
