//! `bladescan robot status`.

use super::super::{Exit, Failure, print};
use super::{other_answer, row};
use crate::robot::{Command, ExecutingJob, Reply, Status, SystemInformation};
use crate::run::Conversation;
use serde_json::{Value, json};

pub(super) async fn main(robot: &mut Conversation, json: bool) -> Result<Exit, Failure> {
    let system = match robot.say(Command::SystemInformation).await? {
        Reply::SystemInformation(system) => system,
        _ => return Err(other_answer("system information")),
    };
    let status = read(robot).await?;
    let job = match robot.say(Command::ExecutingJob).await {
        Ok(Reply::ExecutingJob(job)) => Some(job),
        // No job is selected, or the controller does not tell.
        _ => None,
    };
    if json {
        print(&as_json(&system, status, job.as_ref()).to_string())?;
    } else {
        print(&as_table(&system, status, job.as_ref()))?;
    }
    Ok(Exit::Done)
}

pub(super) async fn read(robot: &mut Conversation) -> Result<Status, Failure> {
    match robot.say(Command::Status).await? {
        Reply::Status(status) => Ok(status),
        _ => Err(other_answer("status")),
    }
}

fn as_table(system: &SystemInformation, status: Status, job: Option<&ExecutingJob>) -> String {
    let job = job.filter(|job| !job.name.is_empty()).map_or_else(
        || "none selected".to_owned(),
        |job| format!("{}, line {}, step {}", job.name, job.line, job.step),
    );
    [
        row("robot", format!("{}, software {}", system.model, system.software)),
        row("mode", mode(status)),
        row("servo", if status.servo_on() { "on" } else { "off" }),
        row("motion", motion(status)),
        row("hold", holds(status)),
        row("alarm", alarm(status)),
        row("job", job),
        row(
            "verdict",
            match obstacle(status) {
                None => "takes moves".to_owned(),
                Some(obstacle) => format!("takes no moves: {obstacle}"),
            },
        ),
    ]
    .join("\n")
}

fn as_json(system: &SystemInformation, status: Status, job: Option<&ExecutingJob>) -> Value {
    let mut document = state_json(status);
    document["model"] = json!(system.model);
    document["software"] = json!(system.software);
    document["simulated"] = json!(system.simulated());
    document["job"] = json!(job);
    document
}

/// The state as other programs read it.
pub(super) fn state_json(status: Status) -> Value {
    json!({
        "data_1": status.data_1,
        "data_2": status.data_2,
        "teach": status.teach(),
        "play": status.play(),
        "remote": status.remote(),
        "servo_on": status.servo_on(),
        "running": status.running(),
        "speed_restricted": status.speed_restricted(),
        "held_elsewhere": status.held_elsewhere(),
        "held_by_command": status.held_by_command(),
        "alarm": status.alarm(),
        "error": status.error(),
        "takes_moves": obstacle(status).is_none(),
    })
}

/// The state in one line.
pub(super) fn one_line(status: Status) -> String {
    let servo = if status.servo_on() { "servo on" } else { "servo off" };
    format!(
        "{}; {servo}; {}; hold {}; alarm {}",
        mode(status),
        motion(status),
        holds(status),
        alarm(status)
    )
}

/// Why a move would not be taken.
fn obstacle(status: Status) -> Option<&'static str> {
    [
        (status.alarm() || status.error(), "an alarm or error is active"),
        (!status.remote(), "play mode with command remote is not set"),
        (status.held_elsewhere(), "it is held at the robot"),
        (status.held_by_command(), "it is held by a command"),
        (status.running(), "it is running"),
        (!status.servo_on(), "servo power is off"),
    ]
    .into_iter()
    .find_map(|(applies, text)| applies.then_some(text))
}

fn mode(status: Status) -> &'static str {
    match (status.teach(), status.play(), status.remote()) {
        (_, _, true) => "play, command remote",
        (true, _, _) => "teach",
        (_, true, _) => "play, no command remote",
        _ => "neither teach nor play",
    }
}

fn motion(status: Status) -> &'static str {
    match (status.running(), status.speed_restricted()) {
        (true, false) => "running",
        (true, true) => "running, speed restricted",
        (false, false) => "standing",
        (false, true) => "standing, speed restricted",
    }
}

fn holds(status: Status) -> &'static str {
    match (status.held_elsewhere(), status.held_by_command()) {
        (true, true) => "at the robot and by command",
        (true, false) => "at the robot",
        (false, true) => "by command",
        (false, false) => "none",
    }
}

fn alarm(status: Status) -> &'static str {
    match (status.alarm(), status.error()) {
        (true, true) => "alarm and error",
        (true, false) => "alarm",
        (false, true) => "error",
        (false, false) => "none",
    }
}
