//! Commands and answers against the vectors of the page.

use super::number::{read_fixed, write_fixed};
use super::*;
use crate::robot::host::Unsupported;
use crate::robot::{
    Alarm, AlarmClass, Command, Cycle, ExecutingJob, Form, Frame, JobName, Move, MovePulses, Path, Position,
    PositionVariable, Reply, ReplyError, Speed, Status, Values, Variable, VariableKind, WirePose,
};
use crate::vectors::host;
use proptest::prelude::*;

const PAGE_POSE: WirePose = WirePose {
    position_um: [500_000, -250_000, 750_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};
const NO_FLIP: Form = Form(0b100);
const PULSES: [i32; 8] = [1000, -2000, 3000, 0, 0, 42, 0, 0];

fn page(name: &str) -> String {
    String::from_utf8(host(name)).unwrap().trim_end().to_owned()
}

fn said(command: &Command) -> (&'static str, String) {
    let phrase = phrase(command, Some(NO_FLIP)).unwrap();
    (phrase.name, phrase.data)
}

fn read(command: &Command, name: &str) -> Reply {
    reply(command, &page(name)).unwrap()
}

fn variable(kind: VariableKind, index: u16) -> Variable {
    Variable { kind, index }
}

fn page_move(path: Path, speed: Speed) -> Command {
    Command::Move(Move {
        base_from_tool: PAGE_POSE,
        path,
        speed,
        tool: 1,
    })
}

fn page_pulses(path: Path, speed: Speed) -> Command {
    Command::MovePulses(MovePulses {
        pulses: PULSES,
        path,
        speed,
        tool: 1,
    })
}

fn page_position() -> PositionVariable {
    PositionVariable::Cartesian {
        frame: Frame::Base,
        pose: PAGE_POSE,
        form: NO_FLIP,
        tool: 1,
    }
}

fn write(first: Variable, values: Values) -> Command {
    Command::Write { first, values }
}

#[test]
fn commands_with_data_are_those_of_the_page() {
    let d42 = variable(VariableKind::Double, 42);
    let by_pulses = PositionVariable::Pulses {
        pulses: PULSES,
        tool: 1,
    };
    let order = Command::Order {
        variable: 42,
        value: -7,
    };
    let job = JobName::parse("SCAN1").unwrap();
    for (command, name, vector) in [
        (Command::Position, "RPOSC", "data_position"),
        (Command::HoldOn, "HOLD", "data_hold_on"),
        (Command::HoldOff, "HOLD", "data_hold_off"),
        (Command::SelectJob { job, line: 0 }, "JSEQ", "data_job_select"),
        (Command::Read { first: d42, count: 1 }, "SAVEV", "data_read_d42"),
        (write(d42, Values::Double(vec![-7])), "LOADV", "data_write_d42"),
        (order, "LOADV", "data_write_d42"),
        (
            write(
                variable(VariableKind::Position, 1),
                Values::Position(vec![page_position()]),
            ),
            "LOADV",
            "data_write_p1",
        ),
        (
            write(variable(VariableKind::Position, 2), Values::Position(vec![by_pulses])),
            "LOADV",
            "data_write_p2",
        ),
        (
            Command::ReadSignals {
                first_group: 1001,
                count: 2,
            },
            "IOREAD",
            "data_read_signals",
        ),
        (
            Command::WriteSignals {
                first_group: 2701,
                groups: vec![1, 128],
            },
            "IOWRITE",
            "data_write_signals",
        ),
        (
            page_move(Path::Straight, Speed::ToolPoint(500)),
            "MOVL",
            "data_move_straight",
        ),
        (page_move(Path::Straight, Speed::Turn(95)), "MOVL", "data_move_turn"),
        (page_move(Path::Link, Speed::Link(1250)), "MOVJ", "data_move_link"),
        (page_pulses(Path::Link, Speed::Link(1250)), "PMOVJ", "data_pulses_link"),
        (
            page_pulses(Path::Straight, Speed::ToolPoint(500)),
            "PMOVL",
            "data_pulses_straight",
        ),
    ] {
        assert_eq!(said(&command), (name, page(vector)), "{vector}");
    }
}

#[test]
fn commands_with_little_or_no_data_are_said_by_their_names() {
    for (command, name, data) in [
        (Command::Status, "RSTATS", ""),
        (Command::Alarm(3), "RALARM", ""),
        (Command::Pulses, "RPOSJ", ""),
        (Command::ExecutingJob, "RJSEQ", ""),
        (Command::SystemInformation, "RJDIR", "*"),
        (Command::ServoOn, "SVON", "1"),
        (Command::ServoOff, "SVON", "0"),
        (Command::AlarmReset, "RESET", ""),
        (Command::ErrorCancel, "CANCEL", ""),
        (Command::SetCycle(Cycle::Step), "CYCLE", "1"),
        (Command::SetCycle(Cycle::Once), "CYCLE", "2"),
        (Command::SetCycle(Cycle::Continuous), "CYCLE", "3"),
        (Command::ShowText("VIEW 3 OF 24".into()), "MDSP", "VIEW 3 OF 24"),
        (Command::StartJob, "START", ""),
    ] {
        assert_eq!(said(&command), (name, data.to_owned()));
    }
}

#[test]
fn answers_of_the_page_mean_what_they_say() {
    let ready = Status {
        data_1: 0xC4,
        data_2: 0x40,
    };
    let held = Status {
        data_1: 0xC4,
        data_2: 0x18,
    };
    let position = Reply::Position(Position {
        base_from_tool: PAGE_POSE,
        tool: 1,
        form: NO_FLIP,
    });
    let alarm = Alarm {
        code: 4315,
        data: 1,
        time: String::new(),
        name: String::new(),
    };
    let job = ExecutingJob {
        name: "SCAN1".into(),
        line: 12,
        step: 3,
        override_e2_percent: None,
    };
    let d42 = Command::Read {
        first: variable(VariableKind::Double, 42),
        count: 1,
    };
    let outputs = Command::ReadSignals {
        first_group: 1001,
        count: 2,
    };
    for (command, vector, reply) in [
        (Command::Status, "ans_status_ready", Reply::Status(ready)),
        (Command::Status, "ans_status_hold_alarm", Reply::Status(held)),
        (Command::Alarm(0), "ans_alarm_none", Reply::Alarm(None)),
        (Command::Alarm(0), "ans_alarm_4315", Reply::Alarm(Some(alarm))),
        (Command::Alarm(1), "ans_alarm_4315", Reply::Alarm(None)),
        (Command::Position, "ans_position", position),
        (Command::Pulses, "ans_pulses", Reply::Pulses(PULSES)),
        (Command::ExecutingJob, "ans_job", Reply::ExecutingJob(job)),
        (d42, "ans_d42", Reply::Values(Values::Double(vec![-7]))),
        (outputs, "ans_signals", Reply::Signals(vec![85, 3])),
    ] {
        assert_eq!(read(&command, vector), reply, "{vector}");
        assert!(expects_data(&command));
    }
}

#[test]
fn positions_are_read_with_two_or_four_decimals() {
    let four = read(&Command::Position, "ans_position");
    assert_eq!(read(&Command::Position, "ans_position_two_decimals"), four);
    let spaced = page("ans_position").replace(',', " , ");
    assert_eq!(reply(&Command::Position, &spaced).unwrap(), four);
    assert_eq!(form(&page("ans_position")), Some(NO_FLIP));
    assert_eq!(form("1,2,3,4,5,6,64,1"), None);
}

#[test]
fn position_variables_survive_the_text() {
    let cartesian = |frame| PositionVariable::Cartesian {
        frame,
        pose: PAGE_POSE,
        form: Form(0b10_1011),
        tool: 63,
    };
    let p5 = variable(VariableKind::Position, 5);
    for value in [
        PositionVariable::Pulses {
            pulses: PULSES,
            tool: 3,
        },
        PositionVariable::Pulses {
            pulses: [1, 2, 3, 4, 5, 6, 7, 8],
            tool: 0,
        },
        cartesian(Frame::Base),
        cartesian(Frame::Robot),
        cartesian(Frame::User(1)),
        cartesian(Frame::User(16)),
    ] {
        let values = Values::Position(vec![value]);
        let (_, data) = said(&write(p5, values.clone()));
        let answer = data.strip_prefix("4,5,").unwrap();
        let ask = Command::Read { first: p5, count: 1 };
        assert_eq!(reply(&ask, answer).unwrap(), Reply::Values(values), "{answer}");
    }
}

#[test]
fn values_of_every_kind_are_read_within_their_ranges() {
    for (kind, answer, values) in [
        (VariableKind::Byte, "255", Some(Values::Byte(vec![255]))),
        (VariableKind::Byte, "256", None),
        (VariableKind::Integer, "-32768", Some(Values::Integer(vec![i16::MIN]))),
        (VariableKind::Integer, "40000", None),
        (VariableKind::Double, "2147483648", None),
        (VariableKind::Real, "-1.5", Some(Values::Real(vec![-1.5]))),
        (VariableKind::Real, "1.5E+03", Some(Values::Real(vec![1500.0]))),
        (VariableKind::Real, "inf", None),
        (VariableKind::Real, "NaN", None),
        (
            VariableKind::Text,
            " BLADE 7 ",
            Some(Values::Text(vec!["BLADE 7".into()])),
        ),
        (VariableKind::Byte, "1,2", None),
        (VariableKind::Position, "1,18,0,0,0,0,0,0,0,0", None),
        (VariableKind::Position, "1,0,0,0,0,0,0,0,64,0", None),
        (VariableKind::Position, "2,0,0,0,0,0,0,0", None),
    ] {
        let ask = Command::Read {
            first: variable(kind, 0),
            count: 1,
        };
        assert_eq!(reply(&ask, answer).ok(), values.map(Reply::Values), "{kind:?} {answer}");
    }
}

#[test]
fn what_host_control_cannot_say_is_refused_before_it_is_said() {
    let history = Command::AlarmHistory {
        class: AlarmClass::Major,
        index: 0,
    };
    let refused = |command: &Command| phrase(command, Some(NO_FLIP)).unwrap_err();
    assert_eq!(refused(&history), Unsupported::Command("alarm history"));
    let m0 = variable(VariableKind::Register, 0);
    let registers = Unsupported::Command("registers");
    assert_eq!(refused(&Command::Read { first: m0, count: 1 }), registers);
    assert_eq!(refused(&write(m0, Values::Register(vec![1]))), registers);
    let b0 = variable(VariableKind::Byte, 0);
    let several = Unsupported::Several { count: 2 };
    assert_eq!(refused(&Command::Read { first: b0, count: 2 }), several);
    assert_eq!(refused(&write(b0, Values::Byte(vec![1, 2]))), several);
    for (path, speed) in [
        (Path::Straight, Speed::Link(100)),
        (Path::Link, Speed::ToolPoint(100)),
        (Path::Link, Speed::Turn(100)),
    ] {
        assert_eq!(refused(&page_move(path, speed)), Unsupported::Speed);
        assert_eq!(refused(&page_pulses(path, speed)), Unsupported::Speed);
    }
    for text in ["", "A\rB", "ÄRGER", &"X".repeat(31)] {
        assert_eq!(refused(&Command::ShowText(text.into())), Unsupported::Text(text.into()));
    }
    let s0 = variable(VariableKind::Text, 0);
    for text in ["A,B", "", &"X".repeat(17)] {
        let command = write(s0, Values::Text(vec![text.into()]));
        assert_eq!(refused(&command), Unsupported::Text(text.into()));
    }
    for command in [
        Command::Alarm(4),
        Command::SelectJob {
            job: JobName::parse("A").unwrap(),
            line: 10_000,
        },
        Command::ReadSignals {
            first_group: 1,
            count: 257,
        },
        Command::WriteSignals {
            first_group: 2701,
            groups: vec![],
        },
        write(variable(VariableKind::Real, 0), Values::Real(vec![f32::NAN])),
        write(
            variable(VariableKind::Position, 0),
            Values::Position(vec![PositionVariable::Unset]),
        ),
    ] {
        assert!(matches!(refused(&command), Unsupported::Value { .. }), "{command:?}");
    }
}

#[test]
fn user_frames_beyond_16_are_not_said() {
    for frame in [Frame::User(0), Frame::User(17), Frame::Tool] {
        let value = PositionVariable::Cartesian {
            frame,
            pose: PAGE_POSE,
            form: NO_FLIP,
            tool: 0,
        };
        let command = write(variable(VariableKind::Position, 0), Values::Position(vec![value]));
        assert!(matches!(phrase(&command, None), Err(Unsupported::Value { .. })));
    }
}

#[test]
fn a_link_move_waits_until_the_configuration_is_known() {
    let link = page_move(Path::Link, Speed::Link(1250));
    assert_eq!(phrase(&link, None), Err(Unsupported::UnknownForm));
    let straight = page_move(Path::Straight, Speed::ToolPoint(500));
    let data = phrase(&straight, None).unwrap().data;
    assert_eq!(data, page("data_move_straight").replace(",1,1,0", ",0,1,0"));
}

#[test]
fn codes_are_read_from_results_and_from_error_lines() {
    assert_eq!(result_code("0000"), Some(0));
    assert_eq!(result_code("2010"), Some(0x2010));
    assert_eq!(result_code("20100"), None);
    assert_eq!(result_code("+010"), None);
    assert_eq!(refusal_code(&page("ans_hold_refused_2100")), 0x2100);
    assert_eq!(refusal_code("ERROR: HOLD is not successful"), 0);
}

#[test]
fn a_simulated_controller_is_known_by_its_greeting_or_by_a_job() {
    let greeted = system_information(&page("greeting_always"));
    assert_eq!(
        (greeted.software.as_str(), greeted.model.as_str()),
        ("1.07", "DX (host control)")
    );
    assert!(!greeted.simulated());
    assert!(system_information(&page("greeting_simulated")).simulated());
    for (names, simulated) in [("SCAN1, SIMULATED", true), ("SCAN1,SIMULATED-2", false), ("", false)] {
        let Ok(Reply::SystemInformation(system)) = reply(&Command::SystemInformation, names) else {
            panic!()
        };
        assert_eq!(
            (system.simulated(), system.model.as_str()),
            (simulated, "DX200 (serial)")
        );
    }
}

#[test]
fn a_wrong_number_of_fields_is_an_error() {
    assert_eq!(
        reply(&Command::Status, "194"),
        Err(ReplyError::Fields { expected: 2, found: 1 })
    );
    let wrong = reply(&Command::Status, "194,x");
    assert!(matches!(wrong, Err(ReplyError::Field { field: "data 2", .. })));
}

#[test]
fn numbers_are_rounded_to_their_last_digit_and_bounded() {
    for (text, value) in [
        ("1", Some(1000)),
        ("-1.5", Some(-1500)),
        ("+.25", Some(250)),
        ("0.0005", Some(1)),
        ("0.00049", Some(0)),
        ("-0.0005", Some(-1)),
        ("2147483.647", Some(i32::MAX)),
        ("2147483.648", None),
        ("", None),
        ("-", None),
        (".", None),
        ("1.2.3", None),
        ("1e3", None),
        ("0.0000000000000000000001", None),
    ] {
        assert_eq!(read_fixed(text, 3), value, "{text}");
    }
}

proptest! {
    #[test]
    fn written_numbers_are_read_back(value: i32, decimals in 1u32..5) {
        let text = write_fixed(value, decimals);
        prop_assert_eq!(read_fixed(&text, decimals), Some(value));
        // An independent reading of the same text.
        let float: f64 = text.parse().unwrap();
        prop_assert!((float * 10f64.powi(decimals as i32) - f64::from(value)).abs() < 0.01);
    }

    #[test]
    fn no_answer_makes_the_reader_panic(text in "[0-9,. +\\-A-Z\\r]{0,200}|.{0,60}") {
        let position = Variable { kind: VariableKind::Position, index: 0 };
        let real = Variable { kind: VariableKind::Real, index: 0 };
        for command in [
            Command::Status,
            Command::Alarm(200),
            Command::Position,
            Command::Pulses,
            Command::ExecutingJob,
            Command::SystemInformation,
            Command::Read { first: position, count: 1 },
            Command::Read { first: real, count: 1 },
            Command::ReadSignals { first_group: 0, count: 3 },
        ] {
            let _ = reply(&command, &text);
        }
        let _ = (form(&text), refusal_code(&text), result_code(&text), system_information(&text));
    }
}
