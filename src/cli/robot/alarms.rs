//! `bladescan robot alarms`.

use super::super::{Exit, Failure, print};
use super::other_answer;
use crate::robot::{Alarm, AlarmClass, Command, Reply};
use crate::run::Conversation;
use serde_json::json;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// So many of the newest entries of each history, at most 100; HSES only.
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=100))]
    history: u8,
}

pub(super) async fn main(robot: &mut Conversation, args: &Args, json: bool) -> Result<Exit, Failure> {
    let mut active = Vec::new();
    for index in 0..ACTIVE_COUNT {
        active.extend(read(robot, Command::Alarm(index)).await?);
    }
    let mut history = Vec::new();
    for (class, name) in CLASSES {
        for index in 0..args.history {
            match read(robot, Command::AlarmHistory { class, index }).await? {
                Some(alarm) => history.push((name, alarm)),
                None => break,
            }
        }
    }
    if json {
        let history: Vec<_> = history
            .iter()
            .map(|(class, alarm)| json!({ "class": class, "alarm": alarm }))
            .collect();
        print(&json!({ "active": active, "history": history }).to_string())?;
    } else {
        let mut lines: Vec<String> = active.iter().map(|alarm| line("active", alarm)).collect();
        if lines.is_empty() {
            lines.push("no active alarm".into());
        }
        lines.extend(history.iter().map(|(class, alarm)| line(class, alarm)));
        print(&lines.join("\n"))?;
    }
    Ok(Exit::Done)
}

async fn read(robot: &mut Conversation, command: Command) -> Result<Option<Alarm>, Failure> {
    match robot.say(command).await? {
        Reply::Alarm(alarm) => Ok(alarm),
        _ => Err(other_answer("alarm")),
    }
}

fn line(class: &str, alarm: &Alarm) -> String {
    let Alarm { code, data, time, name } = alarm;
    format!("{class:<8} {code:>5}  sub-code {data:<4} {time:16}  {name}")
        .trim_end()
        .to_owned()
}

const ACTIVE_COUNT: u8 = 4;
const CLASSES: [(AlarmClass, &str); 5] = [
    (AlarmClass::Major, "major"),
    (AlarmClass::Minor, "minor"),
    (AlarmClass::UserSystem, "system"),
    (AlarmClass::UserUser, "user"),
    (AlarmClass::Offline, "offline"),
];
