use super::*;
use crate::robot::controller::{Panel, Settings};
use crate::robot::variables::Value;

const SECOND_NS: u64 = 1_000_000_000;

fn job(name: &str, body: &str) -> (String, String) {
    let lines = format!(
        "/JOB\n//NAME {name}\n//POS\n///NPOS 1,0,0,0,0,0\n///TOOL 1\n///POSTYPE BASE\n///RECTAN\n\
         C00000=900.000,0.000,900.000,0.0000,0.0000,0.0000\n//INST\nNOP\n{body}END\n"
    );
    (name.to_owned(), lines.replace('\n', "\r\n"))
}

/// A controller ready to start, in one-cycle mode, with the job T1.
fn ready(body: &str) -> Controller {
    with_jobs(vec![job("T1", body)])
}

fn with_jobs(jobs: Vec<(String, String)>) -> Controller {
    let mut robot = Controller::new(Settings {
        jobs,
        ..Settings::default()
    });
    assert_eq!(robot.poll_output(), None);
    robot.set_servo(0, true).unwrap();
    robot.set_cycle(0, Cycle::Once).unwrap();
    robot
}

fn d(robot: &mut Controller, now_ns: u64, index: u16) -> i32 {
    match robot.variable(now_ns, Kind::D, index).unwrap() {
        Value::D(value) => value,
        other => panic!("{other:?}"),
    }
}

fn is_running(robot: &mut Controller, now_ns: u64) -> bool {
    robot.status(now_ns)[0] & 8 != 0
}

#[test]
fn a_job_counts_to_ten_and_ends() {
    let mut robot =
        ready("SET D001 0\n*L\nINC D001\nJUMP *L IF D001<10\nSET D002 D001\nMUL D002 D001\nSUB D002 1\nDIV D002 2\n");
    robot.start(0, Some("T1")).unwrap();
    assert!(is_running(&mut robot, 0));
    assert!(!is_running(&mut robot, SECOND_NS));
    assert_eq!((d(&mut robot, SECOND_NS, 1), d(&mut robot, SECOND_NS, 2)), (10, 49));
    assert_eq!(robot.executing_job(SECOND_NS).line, 0);
}

#[test]
fn instructions_take_their_time_whenever_the_controller_is_looked_at() {
    let body = "*L\nINC D001\nJUMP *L\n";
    let (mut often, mut once) = (ready(body), ready(body));
    often.start(0, Some("T1")).unwrap();
    once.start(0, Some("T1")).unwrap();
    for at in 0..1000 {
        often.status(at * 100_003);
    }
    let now_ns = 999 * 100_003;
    assert_eq!(d(&mut often, now_ns, 1), d(&mut once, now_ns, 1));
    // A quarter of a millisecond each, three a turn; NOP comes first.
    assert_eq!(d(&mut once, 100_000_000, 1), 133);
}

#[test]
fn the_speed_of_the_simulation_runs_jobs_faster() {
    let (name, text) = job("T1", "*L\nINC D001\nJUMP *L\n");
    let mut robot = Controller::new(Settings {
        jobs: vec![(name, text)],
        speed: 20.0,
        ..Settings::default()
    });
    robot.set_servo(0, true).unwrap();
    robot.start(0, Some("T1")).unwrap();
    assert_eq!(d(&mut robot, 5_000_000, 1), 133);
}

#[test]
fn a_wait_ends_when_the_variable_comes_or_its_time_is_over() {
    let body = "WAIT B010=1\nSET D001 1\nWAIT B011=1 T=2.00\nSET D002 1\n";
    let mut robot = ready(body);
    robot.start(0, Some("T1")).unwrap();
    assert_eq!(d(&mut robot, 3600 * SECOND_NS, 1), 0);
    assert!(is_running(&mut robot, 3600 * SECOND_NS));
    let from_ns = 3600 * SECOND_NS;
    robot.set_variable(from_ns, 10, Value::B(1)).unwrap();
    assert_eq!(d(&mut robot, from_ns + SECOND_NS, 1), 1);
    assert_eq!(d(&mut robot, from_ns + SECOND_NS, 2), 0);
    assert_eq!(d(&mut robot, from_ns + 2 * SECOND_NS + 2_000_000, 2), 1);
}

#[test]
fn inputs_and_outputs_join_a_job_and_a_client() {
    let mut robot = ready("WAIT IN#(3)=ON\nDOUT OT#(10) ON\nDIN B001 IG#(1)\n");
    robot.start(0, Some("T1")).unwrap();
    assert_eq!(robot.signal_byte(SECOND_NS, 3702), Ok(0));
    robot.set_signal_byte(SECOND_NS, 2701, 4).unwrap();
    assert_eq!(robot.signal_byte(2 * SECOND_NS, 3702), Ok(2));
    assert_eq!(robot.variable(2 * SECOND_NS, Kind::B, 1), Ok(Value::B(4)));
}

#[test]
fn a_move_blocks_the_job_and_line_and_step_are_true() {
    let mut robot = ready("SET D001 1\nMOVL C00000 V=50.0\nSET D001 2\nTIMER T=1.00\n");
    robot.start(0, Some("T1")).unwrap();
    // 100 mm at 50 mm/s and a ramp.
    let in_move_ns = 2 * SECOND_NS;
    assert_eq!(d(&mut robot, in_move_ns, 1), 1);
    assert!(robot.is_moving(in_move_ns));
    let job = robot.executing_job(in_move_ns);
    assert_eq!((job.name.as_str(), job.line, job.step), ("T1", 2, 1));
    let after_ns = 2_210_000_000;
    assert_eq!(d(&mut robot, after_ns, 1), 2);
    assert_eq!(robot.pose(after_ns).position_um, [900_000, 0, 900_000]);
    assert!(is_running(&mut robot, after_ns));
    assert_eq!(robot.executing_job(after_ns).line, 4);
    assert_eq!(robot.move_cartesian(after_ns, &order()), Err(Refused::MOVING));
    assert!(!is_running(&mut robot, 4 * SECOND_NS));
}

fn order() -> crate::robot::moves::CartesianOrder {
    crate::robot::moves::CartesianOrder {
        path: Path::Straight,
        is_increment: false,
        speed: OrderedSpeed { class: 1, value: 500 },
        coordinate: 16,
        pose: Pose::from_mm_deg([850.0, 0.0, 900.0], [0.0; 3]),
        form: 0,
        form_ext: 0,
        tool: 1,
        user: 0,
    }
}

#[test]
fn a_hold_stops_a_job_in_its_move_and_a_start_goes_on_from_there() {
    let mut robot = ready("MOVL C00000 V=50.0\nSET D001 1\n");
    robot.start(0, Some("T1")).unwrap();
    robot.set_hold(SECOND_NS, true).unwrap();
    assert!(is_running(&mut robot, SECOND_NS));
    let stood_ns = SECOND_NS + 300_000_000;
    assert!(!is_running(&mut robot, stood_ns));
    let stood = robot.pose(stood_ns);
    assert_eq!(robot.start(stood_ns, None), Err(Refused::HELD_BY_COMMAND));
    robot.set_hold(stood_ns, false).unwrap();
    assert_eq!(robot.pose(10 * SECOND_NS), stood);
    assert_eq!(robot.executing_job(10 * SECOND_NS).line, 1);
    robot.start(10 * SECOND_NS, None).unwrap();
    assert!(is_running(&mut robot, 10 * SECOND_NS));
    assert_eq!(d(&mut robot, 20 * SECOND_NS, 1), 1);
    assert_eq!(robot.pose(20 * SECOND_NS).position_um, [900_000, 0, 900_000]);
}

#[test]
fn the_time_of_a_wait_stands_still_during_a_hold() {
    let mut robot = ready("TIMER T=10.00\nSET D001 1\n");
    robot.start(0, Some("T1")).unwrap();
    robot.set_hold(4 * SECOND_NS, true).unwrap();
    assert!(!is_running(&mut robot, 4 * SECOND_NS));
    robot.set_hold(100 * SECOND_NS, false).unwrap();
    robot.start(100 * SECOND_NS, None).unwrap();
    assert_eq!(d(&mut robot, 105 * SECOND_NS, 1), 0);
    assert_eq!(d(&mut robot, 107 * SECOND_NS, 1), 1);
}

#[test]
fn p_variables_are_reached_by_number_and_by_variable() {
    let mut robot = ready("MOVL P010 V=100.0\nMOVJ P[D021] VJ=50.00\nGETS P020 $PX001\n");
    for (number, x) in [(10, 850_000), (12, 820_000)] {
        let position = Position {
            kind: 17,
            form: 4,
            tool: 3,
            axes: [x, 0, 900_000, 0, 0, 0, 0, 0],
            ..Position::default()
        };
        robot.set_variable(0, number, Value::P(position)).unwrap();
    }
    robot.set_variable(0, 21, Value::D(12)).unwrap();
    robot.start(0, Some("T1")).unwrap();
    assert_eq!(robot.pose(60 * SECOND_NS).position_um[0], 820_000);
    let Ok(Value::P(stored)) = robot.variable(60 * SECOND_NS, Kind::P, 20) else {
        panic!()
    };
    assert_eq!((stored.kind, stored.tool, stored.axes[0]), (16, 3, 820_000));
    assert_eq!(robot.accepted_move_count(), 2);
}

#[test]
fn a_bad_instruction_is_an_alarm_with_its_line() {
    for (body, code) in [
        ("DIV D001 0\n", CODE_INSTRUCTION),
        ("SET B001 256\n", CODE_INSTRUCTION),
        ("SET B[D001] 1\nSET D001 -1\nSET B[D001] 1\n", CODE_INSTRUCTION),
        ("MOVL P010 V=10.0\n", CODE_POSITION),
        ("CALL JOB:NONE\n", CODE_INSTRUCTION),
        ("MOVL C00000 V=D001\n", CODE_INSTRUCTION),
        ("SET P001 P002\n", CODE_POSITION),
    ] {
        let mut robot = ready(body);
        robot.start(0, Some("T1")).unwrap();
        let alarm = robot.alarm(SECOND_NS, 1).unwrap().unwrap_or_else(|| panic!("{body}"));
        let line = body.matches('\n').count() as u32;
        assert_eq!((alarm.code, alarm.data), (code, line), "{body}");
        assert_eq!(robot.status(SECOND_NS), [0xC2, 0x10], "{body}");
    }
}

#[test]
fn a_move_of_a_job_out_of_the_workspace_is_an_alarm_and_none_begins() {
    let (name, text) = job("T1", "MOVL C00000 V=10.0\n");
    let text = text.replace("C00000=900.000", "C00000=9000.000");
    let mut robot = with_jobs(vec![(name, text)]);
    robot.start(0, Some("T1")).unwrap();
    assert_eq!(
        robot.alarm(SECOND_NS, 1).unwrap().map(|alarm| alarm.code),
        Some(CODE_LIMIT)
    );
    assert_eq!(robot.accepted_move_count(), 0);
}

#[test]
fn calls_come_back_behind_themselves_and_are_not_endless() {
    let mut robot = with_jobs(vec![
        job("T1", "CALL JOB:T2 IF D001=0\nCALL JOB:T2 IF D001=7\nINC D001\n"),
        job("T2", "ADD D001 5\nRET\nADD D001 100\n"),
        job("T3", "CALL JOB:T3\n"),
    ]);
    robot.start(0, Some("T1")).unwrap();
    assert_eq!(d(&mut robot, SECOND_NS, 1), 6);
    assert_eq!(robot.executing_job(SECOND_NS).name, "T1");
    robot.start(SECOND_NS, Some("T3")).unwrap();
    assert_eq!(
        robot.alarm(2 * SECOND_NS, 1).unwrap().map(|alarm| alarm.code),
        Some(CODE_INSTRUCTION)
    );
}

#[test]
fn the_cycle_says_how_much_of_a_job_a_start_runs() {
    let mut robot = ready("INC D001\nPAUSE\nINC D001\n");
    robot.select_job(0, "T1", 0).unwrap();
    robot.set_cycle(0, Cycle::Step).unwrap();
    robot.start(0, None).unwrap();
    assert_eq!(
        (d(&mut robot, SECOND_NS, 1), robot.executing_job(SECOND_NS).line),
        (0, 1)
    );
    robot.start(SECOND_NS, None).unwrap();
    assert_eq!(
        (d(&mut robot, 2 * SECOND_NS, 1), robot.executing_job(2 * SECOND_NS).line),
        (1, 2)
    );
    robot.set_cycle(2 * SECOND_NS, Cycle::Once).unwrap();
    robot.start(2 * SECOND_NS, None).unwrap();
    assert_eq!(
        (d(&mut robot, 3 * SECOND_NS, 1), robot.executing_job(3 * SECOND_NS).line),
        (1, 3)
    );
    robot.start(3 * SECOND_NS, None).unwrap();
    assert_eq!(d(&mut robot, 4 * SECOND_NS, 1), 2);
    robot.set_cycle(4 * SECOND_NS, Cycle::Auto).unwrap();
    for at in 4..8 {
        robot.start(at * SECOND_NS, None).unwrap();
        assert!(!is_running(&mut robot, at * SECOND_NS + SECOND_NS / 2));
    }
    assert_eq!(d(&mut robot, 8 * SECOND_NS, 1), 9);
}

#[test]
fn a_start_has_its_refusals() {
    let mut robot = ready("TIMER T=100.0\n");
    assert_eq!(robot.start(0, None), Err(Refused::NO_JOB_SELECTED));
    assert_eq!(robot.start(0, Some("T9")), Err(Refused::NO_SUCH_JOB));
    assert_eq!(robot.select_job(0, "T9", 0), Err(Refused::NO_SUCH_JOB));
    assert_eq!(robot.select_job(0, "T1", 3), Err(Refused::VALUE));
    robot.select_job(0, "T1", 1).unwrap();
    robot.set_servo(0, false).unwrap();
    assert_eq!(robot.start(0, None), Err(Refused::SERVO_OFF));
    robot.set_servo(0, true).unwrap();
    robot.start(0, None).unwrap();
    assert_eq!(robot.start(SECOND_NS, None), Err(Refused::MOVING));
    assert_eq!(robot.select_job(SECOND_NS, "T1", 0), Err(Refused::MOVING));
    robot.handle_panel(SECOND_NS, Panel::Remote(false));
    assert_eq!(robot.start(SECOND_NS, None), Err(Refused::NOT_REMOTE));
}

#[test]
fn an_alarm_stops_a_job_and_after_reset_and_servo_it_goes_on() {
    let mut robot = ready("MOVL C00000 V=50.0\nSET D001 1\n");
    robot.start(0, Some("T1")).unwrap();
    robot.handle_panel(SECOND_NS, Panel::Alarm(4315));
    assert_eq!(robot.status(SECOND_NS), [0xC2, 0x10]);
    robot.reset_alarms(2 * SECOND_NS).unwrap();
    robot.set_servo(2 * SECOND_NS, true).unwrap();
    robot.start(2 * SECOND_NS, None).unwrap();
    assert_eq!(d(&mut robot, 10 * SECOND_NS, 1), 1);
}

/// Takes the next order once D010 is another number than D011: a straight move to P[D020] at D014 x 0.1 mm/s.
const ORDERS: &str = "*WAIT\nTIMER T=0.02\nJUMP *WAIT IF D010=D011\nJUMP *OVER IF D010=0\nSET D013 2\n\
     MOVL P[D020] V=D014 PL=0\nSET D011 D010\nSET D013 1\nJUMP *WAIT\n*OVER\nSET D013 0\n";

#[test]
fn a_job_takes_its_orders_from_variables() {
    let mut robot = ready(ORDERS);
    robot.start(0, Some("T1")).unwrap();
    let mut now_ns = SECOND_NS;
    for (number, x_um) in [(1, 850_000), (2, 700_000), (3, 750_000)] {
        let position = Position {
            kind: 17,
            form: 4,
            tool: 1,
            axes: [x_um, 0, 900_000, 0, 0, 0, 0, 0],
            ..Position::default()
        };
        robot.set_variable(now_ns, 30, Value::P(position)).unwrap();
        for (index, value) in [(20, 30), (14, 1000), (10, number)] {
            robot.set_variable(now_ns, index, Value::D(value)).unwrap();
        }
        assert_ne!(d(&mut robot, now_ns, 11), number);
        assert_eq!(d(&mut robot, now_ns + 100_000_000, 13), 2);
        now_ns += 10 * SECOND_NS;
        assert_eq!((d(&mut robot, now_ns, 11), d(&mut robot, now_ns, 13)), (number, 1));
        assert_eq!(robot.pose(now_ns).position_um[0], x_um);
        assert!(is_running(&mut robot, now_ns));
    }
    robot.set_variable(now_ns, 10, Value::D(0)).unwrap();
    assert_eq!(d(&mut robot, now_ns + SECOND_NS, 13), 0);
    assert!(!is_running(&mut robot, now_ns + SECOND_NS));
}
