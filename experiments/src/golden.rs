//! Golden HSES frames: the client's requests must equal them, the simulated controller must answer them.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use bladescan::job::hex;
use bladescan::robot::{Answer, Command, Move, Reply, Speed, WirePose};
use clap::Args;
use hw_sim::robot::controller::{Controller, RobotOutput, Settings};
use hw_sim::robot::hses::Port;
use hw_sim::robot::pose::Pose;
use serde_json::Value;

use crate::bsc;

#[derive(Args)]
pub(crate) struct GoldenArguments {
    /// JSON list of objects with `name` and `hex`, or a recorded exchange of them with `dir` and `hex`.
    file: PathBuf,
}

/// The pose of the golden move and position.
const POSE: WirePose = WirePose {
    position_um: [500_000, -250_000, 750_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};

pub(crate) fn run(arguments: &GoldenArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let vectors: Vec<Value> = serde_json::from_slice(&std::fs::read(&arguments.file)?)?;
    let (mut checked, mut wrong) = (0, 0);
    if vectors.iter().any(|vector| vector["dir"].is_string()) {
        return check_capture(&vectors, &mut out);
    }
    for vector in &vectors {
        let name = vector["name"].as_str().ok_or("a vector without a name")?;
        let bytes = bytes(vector["hex"].as_str().ok_or("a vector without hex")?)?;
        let verdicts = match (command(name), name.starts_with("ans_")) {
            (Some((command, id)), _) => vec![
                ("client sends it", command.request(id).encode() == bytes),
                ("simulator answers it", is_answered(&command, &bytes)),
            ],
            (None, true) => match understood(name, &bytes) {
                Some(verdict) => vec![("client understands it", verdict)],
                None => continue,
            },
            (None, false) => continue,
        };
        for (what, right) in verdicts {
            checked += 1;
            wrong += usize::from(!right);
            writeln!(out, "{:5} {name}: {what}", if right { "ok" } else { "WRONG" })?;
        }
    }
    writeln!(
        out,
        "{checked} checks, {wrong} wrong; vectors of commands that are not built are left out"
    )?;
    if wrong > 0 {
        return Err("a golden vector is not met".into());
    }
    Ok(())
}

/// A recorded exchange on the serial line.
fn check_capture(capture: &[Value], out: &mut impl Write) -> Result<(), Box<dyn Error>> {
    let verdicts = bsc::check(capture)?;
    for (what, is_right) in &verdicts {
        writeln!(out, "{:5} {what}", if *is_right { "ok" } else { "WRONG" })?;
    }
    let wrong = verdicts.iter().filter(|(_, is_right)| !is_right).count();
    writeln!(out, "{} checks, {wrong} wrong", verdicts.len())?;
    if wrong > 0 {
        return Err("the recorded exchange is not met".into());
    }
    Ok(())
}

/// The command behind a golden request, with the request id of the vector.
fn command(name: &str) -> Option<(Command, u8)> {
    let target = Move {
        base_from_tool: POSE,
        speed: Speed::ToolPoint(500),
        tool: 1,
    };
    Some(match name {
        "req_status_0x72_all" => (Command::Status, 0),
        "req_alarm_0x70_1_all" => (Command::Alarm, 0),
        "req_position_base_R1" => (Command::Position, 1),
        "req_hold_on" => (Command::HoldOn, 1),
        "req_hold_off" => (Command::HoldOff, 1),
        "req_servo_on" => (Command::ServoOn, 1),
        "req_servo_off" => (Command::ServoOff, 1),
        "req_alarm_reset" => (Command::AlarmReset, 1),
        "req_error_cancel" => (Command::ErrorCancel, 1),
        "req_move_cart_linear_base_50mm_s" => (Command::Move(target), 1),
        _ => return None,
    })
}

/// Whether a ready simulated controller carries the golden request out and answers so that the client understands.
fn is_answered(command: &Command, request: &[u8]) -> bool {
    let mut robot = Controller::new(Settings {
        home: Pose::from_mm_deg([800.0, 0.0, 900.0], [0.0; 3]),
        workspace_min_um: [-2_000_000; 3],
        workspace_max_um: [2_000_000; 3],
        speed: 1.0,
        seed: 1,
        faults: Vec::new(),
        ..Settings::default()
    });
    let from = ([127, 0, 0, 1], 5000).into();
    let mut ask = |datagram: &[u8]| {
        robot.handle_datagram(0, Port::Robot, from, datagram);
        match robot.poll_output() {
            Some(RobotOutput::Datagram { bytes, .. }) => Some(bytes),
            _ => None,
        }
    };
    if matches!(command, Command::Move(_)) {
        ask(&Command::ServoOn.request(9).encode());
    }
    let Some(answer) = ask(request).and_then(|bytes| Answer::decode(&bytes).ok()) else {
        return false;
    };
    answer.id == request[11] && answer.status == 0 && command.reply(&answer).is_ok()
}

/// Whether the client reads a golden answer as what it is; `None` for answers to commands that are not built.
fn understood(name: &str, bytes: &[u8]) -> Option<bool> {
    let answer = Answer::decode(bytes).ok();
    let reply = |command: Command| answer.as_ref().and_then(|answer| command.reply(answer).ok());
    let refused = |status, added| {
        answer
            .as_ref()
            .is_some_and(|answer| (answer.status, answer.added_status) == (status, added))
    };
    Some(match name {
        "ans_status_play_remote_servo_on" => {
            matches!(reply(Command::Status), Some(Reply::Status(status)) if status.remote() && status.servo_on() && !status.running())
        }
        "ans_status_running" => matches!(reply(Command::Status), Some(Reply::Status(status)) if status.running()),
        "ans_status_hold_alarm" => {
            matches!(reply(Command::Status), Some(Reply::Status(status)) if status.held_by_command() && status.alarm())
        }
        "ans_set_ok" => reply(Command::HoldOn) == Some(Reply::Done),
        "ans_err_2010_on_move" => refused(0x1F, 0x2010),
        "ans_err_2100_cmd_remote_not_set" => refused(0x1F, 0x2100),
        "ans_err_3450_servo_on_refused" => refused(0x1F, 0x3450),
        "ans_err_undefined_command_0x08" => refused(0x08, 0),
        "ans_position_base_R1" => {
            matches!(reply(Command::Position), Some(Reply::Position(position)) if position.base_from_tool == POSE && position.tool == 1)
        }
        "ans_alarm_none" => reply(Command::Alarm) == Some(Reply::Alarm(None)),
        "ans_alarm_4315" => matches!(reply(Command::Alarm), Some(Reply::Alarm(Some(alarm))) if alarm.code == 4315),
        _ => return None,
    })
}

pub(crate) fn bytes(digits: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    let bytes = (0..digits.len() / 2)
        .map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16))
        .collect::<Result<Vec<u8>, _>>()?;
    debug_assert_eq!(hex(&bytes), digits);
    Ok(bytes)
}
