use rand::RngExt;

use super::*;
use crate::draws::{Purpose, generator};
use crate::robot::controller::{Panel, Settings};

const SECOND_NS: u64 = 1_000_000_000;

fn controller(faults: &[&str]) -> Controller {
    Controller::new(Settings {
        home: Pose::from_mm_deg([353.769, 202.779, 120.658], [-1.34, 35.78, 27.84]),
        faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        ..Settings::default()
    })
}

fn say_at(controller: &mut Controller, now_ns: u64, name: &str, data: &str) -> host::Answer {
    let call = Call {
        name: name.to_owned(),
        data: data.to_owned(),
        since_ns: now_ns,
    };
    interpret(controller, now_ns, &call)
}

/// The answer to a command as its data, `done` or the four digits of its refusal.
fn say(controller: &mut Controller, name: &str, data: &str) -> String {
    match say_at(controller, 0, name, data) {
        host::Answer::Done => "done".to_owned(),
        host::Answer::Data(data) => data,
        host::Answer::Refused(code) => format!("{code:04X}"),
        host::Answer::Later(_) => "later".to_owned(),
    }
}

const MOVE: &str = "0,50.0,0,400.000,200.000,150.000,0.00,35.00,27.84,1,1,0,0,0,0,0,0";

#[test]
fn every_read_says_what_the_controller_knows() {
    let mut robot = controller(&[]);
    for (name, data, answer) in [
        ("RSTATS", "", "196,0"),
        ("RPOSC", "0,0", "353.769,202.779,120.658,-1.3400,35.7800,27.8400,1,1"),
        (
            "RPOSC",
            "1, 1",
            "353.769,202.779,120.658,-1.3400,35.7800,27.8400,1,1,0,0,0,0,0,0",
        ),
        ("RPOSC", "2,0", "3350"),
        ("RPOSJ", "", "353769,202779,120658,-13400,357800,278400,0,0,0,0,0,0"),
        ("RALARM", "", "0,0,0,0,0,0,0,0,0,0"),
        ("RGROUP", "", "1,0,0"),
        ("IOREAD", "10010,16", "0,0"),
        ("SAVEV", "2,42", "0"),
        ("SAVEV", "4,0", "4130"),
    ] {
        assert_eq!(say(&mut robot, name, data), answer, "{name} {data}");
    }
}

#[test]
fn names_may_be_small_and_ends_of_line_do_not_count() {
    let mut robot = controller(&[]);
    assert_eq!(say(&mut robot, "svon", "1\r\r"), "done");
    assert_eq!(say(&mut robot, "rstats", "\r"), "196,64");
}

#[test]
fn alarms_and_errors_stand_in_ralarm() {
    let mut robot = controller(&[]);
    robot.handle_panel(0, Panel::Alarm(4315));
    robot.handle_panel(0, Panel::Error);
    assert_eq!(say(&mut robot, "RALARM", ""), "1,0,4315,1,0,0,0,0,0,0");
    assert_eq!(say(&mut robot, "RESET", ""), "done");
    assert_eq!(say(&mut robot, "CANCEL", ""), "done");
    assert_eq!(say(&mut robot, "RALARM", ""), "0,0,0,0,0,0,0,0,0,0");
}

#[test]
fn switches_are_set_and_what_they_do_is_in_the_status() {
    let mut robot = controller(&[]);
    for (name, data, status) in [
        ("SVON", "1", "196,64"),
        ("HOLD", "1", "196,72"),
        ("HOLD", "0", "196,64"),
        ("HLOCK", "1", "196,64"),
        ("CYCLE", "1", "193,64"),
        ("CYCLE", "2", "194,64"),
        ("CYCLE", "3", "196,64"),
        ("MODE", "1", "164,64"),
        ("MODE", "2", "196,64"),
        ("SVON", "0", "196,0"),
        ("CGROUP", "1,0", "196,0"),
        ("CTASK", "0", "196,0"),
        ("MDSP", "SIMULATED, OF COURSE", "196,0"),
    ] {
        assert_eq!(say(&mut robot, name, data), "done", "{name} {data}");
        assert_eq!(say(&mut robot, "RSTATS", ""), status, "{name} {data}");
    }
    assert_eq!(robot.pendant_text(), b"SIMULATED, OF COURSE");
}

#[test]
fn what_cannot_be_carried_out_has_its_code() {
    let mut robot = controller(&[]);
    for (name, data, code) in [
        ("DANCE", "", "1010"),
        ("RUFRAME", "1", "1010"),
        ("RSTATS", "1", "1011"),
        ("HOLD", "", "1011"),
        ("HOLD", "2", "1012"),
        ("CYCLE", "0", "1012"),
        ("MODE", "x", "1012"),
        ("MDSP", "1234567890123456789012345678901", "1013"),
        ("CGROUP", "3,0", "3370"),
        ("CTASK", "1", "3370"),
        ("CTASK", "16", "1012"),
        ("JWAIT", "-2", "1012"),
        ("IOREAD", "10010,4", "1012"),
        ("IOREAD", "10011,8", "1012"),
        ("IOREAD", "10010,2056", "1012"),
        ("IOREAD", "99990,8", "1012"),
        ("IOWRITE", "10010,8,1", "2110"),
        ("IOWRITE", "27010,16,1", "1011"),
        ("IOWRITE", "27010,8,256", "1012"),
        ("SAVEV", "8,0", "1012"),
        ("SAVEV", "0,60000", "1012"),
        ("LOADV", "0,0,-1", "1012"),
        ("MOVL", "0,50", "1011"),
        ("MOVL", MOVE, "2070"),
    ] {
        assert_eq!(say(&mut robot, name, data), code, "{name} {data}");
    }
    let mut locked = controller(&["remote-off"]);
    for (name, data) in [
        ("SVON", "1"),
        ("RESET", ""),
        ("MOVL", MOVE),
        ("LOADV", "0,0,1"),
        ("IOWRITE", "27010,8,1"),
    ] {
        assert_eq!(say(&mut locked, name, data), "2100", "{name}");
    }
    assert_eq!(say(&mut locked, "HOLD", "1"), "done", "a stop needs no permission");
}

#[test]
fn variables_and_signals_are_read_back() {
    let mut robot = controller(&[]);
    for (kind, value) in [
        (0, "255"),
        (1, "-32768"),
        (2, "7"),
        (3, "0.25"),
        (4, "1,0,500.000,-250.000,750.000,180.0000,0.0000,-90.0000,1,1"),
        (4, "1,0,500.000,-250.000,750.000,180.0000,0.0000,-90.0000,1,1,7,8"),
        (4, "0,1,2,3,4,5,6,7,8,1"),
        (5, "0,1,2,3,4,5,6,7,8"),
        (6, "0,1,2,3,4,5,6,7,8"),
        (7, "SCAN 1"),
    ] {
        assert_eq!(say(&mut robot, "LOADV", &format!("{kind},3,{value}")), "done", "{kind}");
        assert_eq!(say(&mut robot, "SAVEV", &format!("{kind},3")), value, "{kind}");
    }
    assert_eq!(say(&mut robot, "IOWRITE", "27010, 16, 85, 170"), "done");
    assert_eq!(say(&mut robot, "IOREAD", "27010,16"), "85,170");
    // The last byte of the network inputs, and one too many: nothing is set.
    assert_eq!(say(&mut robot, "IOWRITE", "29550,24,1,1,1"), "1012");
    assert_eq!(say(&mut robot, "IOREAD", "29550,8"), "0");
}

#[test]
fn a_move_is_accepted_at_once_and_reaches_its_target() {
    let mut robot = controller(&[]);
    say(&mut robot, "SVON", "1");
    assert_eq!(say(&mut robot, "MOVL", MOVE), "done");
    assert_eq!(say(&mut robot, "MOVL", MOVE), "2010");
    assert_eq!(
        say_at(&mut robot, 60 * SECOND_NS, "RPOSC", "0,0"),
        host::Answer::Data("400.000,200.000,150.000,0.0000,35.0000,27.8400,1,1".to_owned())
    );
}

#[test]
fn every_kind_of_move_leads_where_it_says() {
    let by = "0, 100, 0, 10, 0, 0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0";
    let to = "25.5,0,300,0,500,0,0,0,1,1,0,0,0,0,0,0";
    let pulses = "300000,0,500000,0,0,90000,0,0,0,0,0,0";
    for (name, data, position) in [
        ("MOVJ", to.to_owned(), "300.000,0.000,500.000,0.0000,0.0000,0.0000,1,1"),
        (
            "IMOV",
            by.to_owned(),
            "363.769,202.779,120.658,-1.3400,35.7800,27.8400,1,1",
        ),
        (
            "PMOVJ",
            format!("50,{pulses},1"),
            "300.000,0.000,500.000,0.0000,0.0000,9.0000,1,1",
        ),
        (
            "PMOVL",
            format!("0,50,{pulses},1"),
            "300.000,0.000,500.000,0.0000,0.0000,9.0000,1,1",
        ),
        (
            "MOVL",
            format!("1,90,{}", &to[5..]),
            "300.000,0.000,500.000,0.0000,0.0000,0.0000,1,1",
        ),
    ] {
        let mut robot = controller(&[]);
        say(&mut robot, "SVON", "1");
        assert_eq!(say(&mut robot, name, &data), "done", "{name}");
        let arrived = say_at(&mut robot, 600 * SECOND_NS, "RPOSC", "0,0");
        assert_eq!(arrived, host::Answer::Data(position.to_owned()), "{name}");
    }
}

#[test]
fn the_type_of_a_move_is_of_the_order_of_texts() {
    let mut robot = controller(&[]);
    say(&mut robot, "SVON", "1");
    // The arm is never flipped, lowered or turned back: 1 here, 4 in HSES.
    for form in ["0", "4", "5", "64"] {
        let order = MOVE.replace(",1,1,0,0,0,0,0,0", &format!(",{form},1,0,0,0,0,0,0"));
        assert_eq!(say(&mut robot, "MOVL", &order), "1012", "{form}");
    }
    assert_eq!(say(&mut robot, "MOVL", MOVE), "done");
}

const CALLER: &str = "/JOB\r\n//NAME SCAN1\r\n//POS\r\n///NPOS 0,0,0,0,0,0\r\n//INST\r\n///DATE 2026/01/02 03:04\r\n\
     ///ATTR SC,RW\r\n///GROUP1 RB1\r\nNOP\r\nCALL JOB:SIMULATED\r\nTIMER T=1.00\r\nCALL JOB:SIMULATED\r\nEND\r\n";

#[test]
fn jobs_are_selected_started_told_and_deleted() {
    let mut robot = controller(&[]);
    robot.put_file(0, "SCAN1.JBI", CALLER.as_bytes()).unwrap();
    for (name, data, answer) in [
        ("RJDIR", "*", "SCAN1,SIMULATED"),
        ("RJDIR", "SCAN1", "SIMULATED"),
        ("RJDIR", "SCAN2", "4040"),
        ("RJDIR", "", "1011"),
        ("RJSEQ", "", "4060"),
        ("GETMJ", "", "4060"),
        ("START", "", "2070"),
        ("SVON", "1", "done"),
        ("START", "", "4060"),
        ("START", "SCAN2", "4040"),
        ("JSEQ", "SCAN1,2", "done"),
        ("JSEQ", "SCAN1,10000", "1012"),
        ("JSEQ", "SCAN1,9999", "1012"),
        ("RJSEQ", "", "SCAN1,2,0"),
        ("SETMJ", "SCAN1", "done"),
        ("GETMJ", "", "SCAN1"),
        ("CYCLE", "2", "done"),
        ("START", "SCAN1", "done"),
        ("START", "SCAN1", "2010"),
        ("RSTATS", "", "202,64"),
        ("DELETE", "SCAN1", "2010"),
    ] {
        assert_eq!(say(&mut robot, name, data), answer, "{name} {data}");
    }
    let later_ns = 60 * SECOND_NS;
    assert_eq!(
        say_at(&mut robot, later_ns, "JWAIT", "-1"),
        host::Answer::Data("0".to_owned())
    );
    assert_eq!(say_at(&mut robot, later_ns, "DELETE", "*"), host::Answer::Done);
    assert_eq!(
        say_at(&mut robot, later_ns, "RJDIR", "*"),
        host::Answer::Data("SIMULATED".to_owned()),
        "the job that says so stays"
    );
}

#[test]
fn jwait_ends_with_what_it_waits_for() {
    let ask = |robot: &mut Controller, limit_s: &str, now_ns| {
        let call = Call {
            name: "JWAIT".to_owned(),
            data: limit_s.to_owned(),
            since_ns: 0,
        };
        interpret(robot, now_ns, &call)
    };
    let data = |text: &str| host::Answer::Data(text.to_owned());
    let mut robot = controller(&[]);
    assert_eq!(ask(&mut robot, "1", 0), data("-1"), "servo power is off");
    say(&mut robot, "SVON", "1");
    assert_eq!(ask(&mut robot, "1", 0), data("0"));
    say(&mut robot, "MOVL", MOVE);
    assert_eq!(ask(&mut robot, "1", 0), host::Answer::Later(LOOK_NS));
    assert_eq!(ask(&mut robot, "1", SECOND_NS - 1), host::Answer::Later(SECOND_NS));
    assert_eq!(ask(&mut robot, "1", SECOND_NS), data("-1"));
    assert_eq!(
        ask(&mut robot, "-1", SECOND_NS),
        host::Answer::Later(SECOND_NS + LOOK_NS)
    );
    let mut held = robot.clone();
    say_at(&mut held, SECOND_NS, "HOLD", "1");
    assert_eq!(ask(&mut held, "-1", 60 * SECOND_NS), data("-1"));
    assert_eq!(ask(&mut robot, "-1", 60 * SECOND_NS), data("0"));
}

#[test]
fn codes_of_hses_alone_are_never_said() {
    for code in 0..=u16::MAX {
        assert!(interpreter_code(Refused(code)) <= INTERPRETER_CODE_MAX, "{code:04X}");
    }
}

#[test]
fn random_commands_never_panic() {
    let mut rng = generator(1, Purpose::Test, 2, 0);
    let names = [
        "RPOSC", "JWAIT", "HOLD", "MDSP", "CGROUP", "IOREAD", "IOWRITE", "SAVEV", "LOADV", "MOVJ", "MOVL", "IMOV",
        "PMOVJ", "PMOVL",
    ];
    let arguments = [
        "0",
        "1",
        "-1",
        "2147483647",
        "65535",
        "1e300",
        "0.5",
        "",
        "A",
        "27010",
        "16",
        "8",
        "4",
    ];
    let mut robot = controller(&[]);
    let mut done_count = 0;
    for step in 0..100_000_u64 {
        let name = names[rng.random_range(0..names.len())];
        let count = rng.random_range(0..19);
        let data: Vec<&str> = (0..count)
            .map(|_| arguments[rng.random_range(0..arguments.len())])
            .collect();
        let answer = say_at(&mut robot, step, name, &data.join(","));
        done_count += usize::from(!matches!(answer, host::Answer::Refused(_)));
    }
    assert!(done_count > 100, "{done_count}");
}
