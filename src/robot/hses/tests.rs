//! Requests and answers against the vectors of the page.

use super::*;
use crate::robot::{Command, Move, Path, Reply, ReplyError, Speed, WirePose};
use crate::vectors::hses;

const PAGE_POSE: WirePose = WirePose {
    position_um: [500_000, -250_000, 750_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};

#[test]
fn requests_equal_the_vectors_of_the_page() {
    let target = Command::Move(Move {
        base_from_tool: PAGE_POSE,
        path: Path::Straight,
        speed: Speed::ToolPoint(500),
        tool: 1,
    });
    for (command, id, name) in [
        (Command::Status, 0, "req_status"),
        (Command::Alarm(0), 0, "req_alarm_1"),
        (Command::Position, 1, "req_position"),
        (Command::HoldOn, 1, "req_hold_on"),
        (Command::HoldOff, 1, "req_hold_off"),
        (Command::ServoOn, 1, "req_servo_on"),
        (Command::ServoOff, 1, "req_servo_off"),
        (Command::AlarmReset, 1, "req_alarm_reset"),
        (Command::ErrorCancel, 1, "req_error_cancel"),
        (Command::SystemInformation, 1, "req_system_information"),
        (target, 1, "req_move_base_50mm_s"),
    ] {
        assert_eq!(request(&command, id).encode(), hses(name), "{name}");
    }
}

#[test]
fn answers_of_the_page_mean_what_they_say() {
    let read = |command: Command, name: &str| reply(&command, &Answer::decode(&hses(name)).unwrap()).unwrap();
    let Reply::Status(ready) = read(Command::Status, "ans_status_ready") else {
        panic!()
    };
    assert!(ready.remote() && ready.servo_on() && !ready.running() && !ready.alarm());
    let Reply::Status(held) = read(Command::Status, "ans_status_hold_alarm") else {
        panic!()
    };
    assert!(held.held_by_command() && held.alarm() && !held.servo_on() && !held.held_elsewhere());
    assert_eq!(read(Command::Alarm(0), "ans_alarm_none"), Reply::Alarm(None));
    let Reply::Alarm(Some(alarm)) = read(Command::Alarm(0), "ans_alarm_4315") else {
        panic!()
    };
    assert_eq!((alarm.code, alarm.name.as_str()), (4315, "COLLISION DETECT"));
    let Reply::Position(position) = read(Command::Position, "ans_position") else {
        panic!()
    };
    assert_eq!((position.base_from_tool, position.tool), (PAGE_POSE, 1));
    let Reply::SystemInformation(system) = read(Command::SystemInformation, "ans_system_information") else {
        panic!()
    };
    assert!(system.simulated());
}

#[test]
fn data_of_the_wrong_length_are_an_error_not_a_panic() {
    let mut answer = Answer::decode(&hses("ans_status_ready")).unwrap();
    for command in [
        Command::Status,
        Command::Alarm(0),
        Command::Position,
        Command::SystemInformation,
    ] {
        for length in 0..120 {
            answer.data = vec![0; length];
            let _ = reply(&command, &answer);
        }
    }
    answer.data = vec![0; 7];
    assert_eq!(
        reply(&Command::Status, &answer),
        Err(ReplyError::Length { expected: 8, found: 7 })
    );
}
