//! Requests and answers against the vectors of the page.

use super::*;
use crate::robot::{
    AlarmClass, Command, Cycle, ExecutingJob, Form, Frame, JobName, Move, MovePulses, Path, PositionVariable, Reply,
    ReplyError, Speed, Values, Variable, VariableKind, WirePose,
};
use crate::vectors::hses;

const PAGE_POSE: WirePose = WirePose {
    position_um: [500_000, -250_000, 750_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};

const PAGE_POSITION: PositionVariable = PositionVariable::Cartesian {
    frame: Frame::Base,
    pose: PAGE_POSE,
    form: Form(0),
    tool: 1,
};

fn variable(kind: VariableKind, index: u16) -> Variable {
    Variable { kind, index }
}

fn read(kind: VariableKind, index: u16, count: u16) -> Command {
    let first = variable(kind, index);
    Command::Read { first, count }
}

fn write(index: u16, values: Values) -> Command {
    let first = variable(values.kind(), index);
    Command::Write { first, values }
}

fn move_by_axes() -> Command {
    Command::MovePulses(MovePulses {
        pulses: [1000, -2000, 3000, 0, 0, 0, 0, 0],
        path: Path::Link,
        speed: Speed::Link(500),
        tool: 1,
    })
}

fn move_in_base() -> Command {
    Command::Move(Move {
        base_from_tool: PAGE_POSE,
        path: Path::Straight,
        speed: Speed::ToolPoint(500),
        tool: 1,
    })
}

fn said(command: &Command, id: u8) -> Vec<u8> {
    request(command, id).unwrap().encode()
}

#[test]
fn requests_equal_the_vectors_of_the_page() {
    let minor = Command::AlarmHistory {
        class: AlarmClass::Minor,
        index: 0,
    };
    let select = Command::SelectJob {
        job: JobName::parse("SCAN1").unwrap(),
        line: 0,
    };
    for (command, id, name) in [
        (Command::Status, 0, "req_status"),
        (Command::Alarm(0), 0, "req_alarm_1"),
        (minor, 0, "req_alarm_history_minor_1"),
        (Command::Position, 1, "req_position"),
        (Command::Pulses, 0, "req_pulses"),
        (Command::ExecutingJob, 0, "req_executing_job"),
        (Command::SystemInformation, 1, "req_system_information"),
        (Command::HoldOn, 1, "req_hold_on"),
        (Command::HoldOff, 1, "req_hold_off"),
        (Command::ServoOn, 1, "req_servo_on"),
        (Command::ServoOff, 1, "req_servo_off"),
        (Command::AlarmReset, 1, "req_alarm_reset"),
        (Command::ErrorCancel, 1, "req_error_cancel"),
        (Command::SetCycle(Cycle::Once), 1, "req_cycle_once"),
        (Command::SetCycle(Cycle::Continuous), 1, "req_cycle_continuous"),
        (Command::ShowText("SCAN".into()), 0, "req_show_text"),
        (Command::StartJob, 1, "req_start_job"),
        (select, 1, "req_select_job"),
        (move_in_base(), 1, "req_move_base_50mm_s"),
        (move_by_axes(), 1, "req_move_pulses"),
    ] {
        assert_eq!(said(&command, id), hses(name), "{name}");
    }
}

#[test]
fn requests_for_values_equal_the_vectors_of_the_page() {
    use VariableKind::{Byte, Double, Position, Register};
    let read_signals = |count| Command::ReadSignals {
        first_group: 2701,
        count,
    };
    let write_signals = |groups| Command::WriteSignals {
        first_group: 2701,
        groups,
    };
    let in_robot = PositionVariable::Cartesian {
        frame: Frame::Robot,
        pose: WirePose {
            position_um: [100_000, -200_000, 300_000],
            rotation_e4_deg: [1_800_000, 0, -900_000],
        },
        form: Form(4),
        tool: 1,
    };
    let order = Command::Order { variable: 42, value: 7 };
    for (command, id, name) in [
        (read_signals(1), 0, "req_read_signals_2701"),
        (read_signals(2), 0, "req_read_signals_2701_2"),
        (write_signals(vec![0xA5]), 1, "req_write_signals_2701"),
        (write_signals(vec![0xA5, 1]), 1, "req_write_signals_2701_2"),
        (read(Register, 5, 1), 0, "req_read_m5"),
        (read(Register, 5, 2), 1, "req_read_m5_2"),
        (write(5, Values::Register(vec![0x1234])), 0, "req_write_m5"),
        (read(Byte, 10, 1), 1, "req_read_b10"),
        (read(Byte, 0, 4), 0, "req_read_b0_4"),
        (write(10, Values::Byte(vec![5])), 1, "req_write_b10"),
        (write(3, Values::Integer(vec![-2])), 0, "req_write_i3"),
        (read(Double, 42, 1), 1, "req_read_d42"),
        (read(Double, 100, 3), 1, "req_read_d100_3"),
        (write(42, Values::Double(vec![7])), 1, "req_write_d42"),
        (order, 1, "req_write_d42"),
        (write(10, Values::Double(vec![1, -2, 3])), 0, "req_write_d10_3"),
        (write(2, Values::Real(vec![1.5])), 0, "req_write_r2"),
        (write(1, Values::Text(vec!["PART-0001".into()])), 0, "req_write_s1"),
        (read(Position, 5, 1), 1, "req_read_p5"),
        (read(Position, 0, 2), 0, "req_read_p0_2"),
        (write(5, Values::Position(vec![PAGE_POSITION])), 1, "req_write_p5"),
        (write(10, Values::Position(vec![in_robot])), 0, "req_write_p10"),
    ] {
        assert_eq!(said(&command, id), hses(name), "{name}");
    }
}

fn answered(command: &Command, name: &str) -> Reply {
    reply(command, &Answer::decode(&hses(name)).unwrap()).unwrap()
}

#[test]
fn answers_of_the_page_mean_what_they_say() {
    let Reply::Status(ready) = answered(&Command::Status, "ans_status_ready") else {
        panic!()
    };
    assert!(ready.remote() && ready.servo_on() && !ready.running() && !ready.alarm());
    let Reply::Status(held) = answered(&Command::Status, "ans_status_hold_alarm") else {
        panic!()
    };
    assert!(held.held_by_command() && held.alarm() && !held.servo_on() && !held.held_elsewhere());
    assert_eq!(answered(&Command::Alarm(0), "ans_alarm_none"), Reply::Alarm(None));
    let Reply::Alarm(Some(alarm)) = answered(&Command::Alarm(0), "ans_alarm_4315") else {
        panic!()
    };
    assert_eq!((alarm.code, alarm.name.as_str()), (4315, "COLLISION DETECT"));
    let Reply::Position(position) = answered(&Command::Position, "ans_position") else {
        panic!()
    };
    assert_eq!((position.base_from_tool, position.tool), (PAGE_POSE, 1));
    let Reply::SystemInformation(system) = answered(&Command::SystemInformation, "ans_system_information") else {
        panic!()
    };
    assert!(system.simulated());
    let job = ExecutingJob {
        name: "SCAN1".into(),
        line: 12,
        step: 3,
        override_e2_percent: Some(10_000),
    };
    let executing = answered(&Command::ExecutingJob, "ans_executing_job");
    assert_eq!(executing, Reply::ExecutingJob(job));
    let pulses = answered(&Command::Pulses, "ans_pulses");
    assert_eq!(pulses, Reply::Pulses([1000, -2000, 3000, 0, 0, 0, 0, 0]));
}

#[test]
fn values_of_the_page_mean_what_they_say() {
    use VariableKind::{Byte, Double, Position};
    let group = Command::ReadSignals {
        first_group: 2701,
        count: 1,
    };
    let values = |values| Reply::Values(values);
    for (command, name, meant) in [
        (group, "ans_read_byte", Reply::Signals(vec![0xA5])),
        (read(Byte, 10, 1), "ans_read_byte", values(Values::Byte(vec![0xA5]))),
        (read(Double, 42, 1), "ans_read_d42", values(Values::Double(vec![7]))),
        (
            read(Double, 100, 3),
            "ans_read_d100_3",
            values(Values::Double(vec![1, -2, 3])),
        ),
        (
            read(Position, 5, 1),
            "ans_read_p5",
            values(Values::Position(vec![PAGE_POSITION])),
        ),
    ] {
        assert_eq!(answered(&command, name), meant, "{name}");
    }
}

#[test]
fn the_same_refusal_comes_in_two_forms() {
    for (name, status, added) in [
        ("ans_undefined_command", 0x08, 0),
        ("ans_undefined_command_long", 0x1F, 0xA000),
        ("ans_position_unset", 0x1F, 0xB001),
    ] {
        let answer = Answer::decode(&hses(name)).unwrap();
        assert_eq!((answer.status, answer.added_status), (status, added), "{name}");
    }
}

#[test]
fn data_of_the_wrong_length_are_an_error_not_a_panic() {
    let mut answer = Answer::decode(&hses("ans_status_ready")).unwrap();
    answer.data = vec![0; 7];
    assert_eq!(
        reply(&Command::Status, &answer),
        Err(ReplyError::Length { expected: 8, found: 7 })
    );
    answer.data = vec![3, 0, 0, 0, 1, 2, 3];
    assert_eq!(
        reply(&read(VariableKind::Byte, 0, 4), &answer),
        Err(ReplyError::Length { expected: 8, found: 7 })
    );
    answer.data.push(4);
    let short = reply(&read(VariableKind::Byte, 0, 4), &answer);
    assert!(matches!(short, Err(ReplyError::Field { field: "count", .. })));
}

#[test]
fn a_position_of_eleven_or_twelve_words_is_filled_with_zeros() {
    let mut answer = Answer::decode(&hses("ans_pulses")).unwrap();
    for (words, fits) in [(13, true), (12, true), (11, true), (10, false), (14, false)] {
        answer.data.resize(words * 4, 0);
        let pulses = reply(&Command::Pulses, &answer);
        assert_eq!(pulses.is_ok(), fits, "{words} words");
        let variable = reply(&read(VariableKind::Position, 0, 1), &answer);
        assert_eq!(variable.is_ok(), fits, "{words} words");
    }
}

#[test]
fn a_single_value_may_come_in_a_slot_of_four_bytes() {
    let mut answer = Answer::decode(&hses("ans_read_d42")).unwrap();
    let mut value = |kind, data: [u8; 4]| {
        answer.data = data.to_vec();
        reply(&read(kind, 0, 1), &answer).ok()
    };
    let values = |values| Some(Reply::Values(values));
    assert_eq!(
        value(VariableKind::Byte, [200, 0, 0, 0]),
        values(Values::Byte(vec![200]))
    );
    assert_eq!(
        value(VariableKind::Integer, [0xFE, 0xFF, 0xFF, 0xFF]),
        values(Values::Integer(vec![-2]))
    );
    assert_eq!(
        value(VariableKind::Register, [0x34, 0x12, 0, 0]),
        values(Values::Register(vec![0x1234]))
    );
    assert_eq!(value(VariableKind::Byte, [200, 1, 0, 0]), None);
    assert_eq!(value(VariableKind::Integer, [2, 0, 0xFF, 0xFF]), None);
}

#[test]
fn an_alarm_with_sub_texts_is_read_without_them() {
    let mut answer = Answer::decode(&hses("ans_alarm_4315")).unwrap();
    let short = reply(&Command::Alarm(0), &answer).unwrap();
    answer.data.resize(268, b'x');
    assert_eq!(reply(&Command::Alarm(0), &answer), Ok(short));
    answer.data.resize(269, b'x');
    assert!(reply(&Command::Alarm(0), &answer).is_err());
}

#[test]
fn a_frame_carries_so_many_values_and_no_more() {
    use VariableKind::{Byte, Double, Integer, Position, Real, Register, Text};
    for (kind, count_max) in [
        (Byte, 474),
        (Integer, 237),
        (Double, 118),
        (Real, 118),
        (Text, 29),
        (Position, 9),
        (Register, 237),
    ] {
        let sent = request(&read(kind, 0, count_max), 1).unwrap();
        assert_eq!(sent.data, u32::from(count_max).to_le_bytes());
        for count in [0, count_max + 2] {
            let count_error = RequestError::Count {
                count: usize::from(count),
                count_max,
            };
            assert_eq!(request(&read(kind, 0, count), 1), Err(count_error), "{kind:?}");
        }
    }
    let full = write(0, Values::Position(vec![PAGE_POSITION; 9]));
    assert_eq!(said(&full, 1).len(), 32 + 4 + 9 * 52);
    assert!(request(&write(0, Values::Position(vec![PAGE_POSITION; 10])), 1).is_err());
    assert_eq!(
        said(&write(0, Values::Byte(vec![1; 474])), 1).len(),
        32 + DATA_BYTES_MAX - 1
    );
}

#[test]
fn bytes_and_signals_go_alone_or_in_even_numbers() {
    let signals = |count| Command::ReadSignals { first_group: 1, count };
    for (command, refused) in [
        (signals(1), false),
        (signals(2), false),
        (signals(3), true),
        (read(VariableKind::Byte, 0, 3), true),
        (write(0, Values::Byte(vec![0; 3])), true),
        (read(VariableKind::Double, 0, 3), false),
    ] {
        let outcome = request(&command, 1);
        assert_eq!(outcome == Err(RequestError::Odd(3)), refused, "{command:?}");
    }
}

#[test]
fn what_has_no_bytes_is_an_error_and_nothing_is_cut() {
    let first = variable(VariableKind::Double, 0);
    let values = Values::Byte(vec![1]);
    assert_eq!(
        request(&Command::Write { first, values }, 1),
        Err(RequestError::Kind(first))
    );
    let unset = write(7, Values::Position(vec![PositionVariable::Unset]));
    assert_eq!(
        request(&unset, 1),
        Err(RequestError::Unset(variable(VariableKind::Position, 7)))
    );
    for (text, bytes_max) in [
        ("x".repeat(31), 30),
        ("Schaufel öffnen".into(), 30),
        ("a\0b".into(), 30),
    ] {
        let error = RequestError::Text {
            text: text.clone(),
            bytes_max,
        };
        assert_eq!(request(&Command::ShowText(text), 1), Err(error));
    }
    assert!(request(&write(0, Values::Text(vec!["x".repeat(17)])), 1).is_err());
    let job = JobName::parse("SCAN1").unwrap();
    let beyond = Command::SelectJob { job, line: 10_000 };
    assert_eq!(request(&beyond, 1), Err(RequestError::Line(10_000)));
}
