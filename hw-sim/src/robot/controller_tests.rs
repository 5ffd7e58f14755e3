use super::*;
use crate::vectors::{HSES_PAGE, vector};

const SECOND_NS: u64 = 1_000_000_000;

fn settings(faults: &[&str]) -> Settings {
    Settings {
        home: Pose::from_mm_deg([1000.0, -200.0, 1100.0], [0.0, 90.0, 0.0]),
        workspace_min_um: [0, -1_500_000, 0],
        workspace_max_um: [2_000_000, 1_500_000, 2_000_000],
        speed: 1.0,
        seed: 1,
        faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        ..Settings::default()
    }
}

fn controller(faults: &[&str]) -> Controller {
    Controller::new(settings(faults))
}

fn ready(faults: &[&str]) -> Controller {
    let mut robot = controller(faults);
    assert_eq!(
        send(&mut robot, 0, "req_servo_on"),
        Some(vector(HSES_PAGE, "ans_set_ok"))
    );
    robot
}

fn client() -> SocketAddr {
    "127.0.0.1:4711".parse().unwrap()
}

fn ask(robot: &mut Controller, now_ns: u64, datagram: &[u8]) -> Option<Vec<u8>> {
    robot.handle_datagram(now_ns, Port::Robot, client(), datagram);
    match robot.poll_output()? {
        RobotOutput::Datagram { to, bytes, .. } => {
            assert_eq!(to, client());
            Some(bytes)
        }
        RobotOutput::Violation(_) => None,
    }
}

fn send(robot: &mut Controller, now_ns: u64, name: &str) -> Option<Vec<u8>> {
    ask(robot, now_ns, &vector(HSES_PAGE, name))
}

/// Data words 1 and 2 of a status.
fn status(robot: &mut Controller, now_ns: u64) -> (u32, u32) {
    let answer = send(robot, now_ns, "req_status").unwrap();
    let word = |at: usize| u32::from_le_bytes(answer[at..at + 4].try_into().unwrap());
    (word(32), word(36))
}

/// The page's move with some of its words replaced.
fn move_with(changes: &[(usize, i32)]) -> Vec<u8> {
    let mut datagram = vector(HSES_PAGE, "req_move_base_50mm_s");
    for (index, value) in changes {
        datagram[32 + 4 * index..][..4].copy_from_slice(&value.to_le_bytes());
    }
    datagram
}

/// Added status of a refusal, none of an acceptance.
fn added(answer: &[u8]) -> Option<u16> {
    match answer[25] {
        0 => None,
        0x1F => Some(u16::from_le_bytes([answer[28], answer[29]])),
        other => panic!("status {other:#x}"),
    }
}

#[test]
fn every_request_of_the_page_is_answered_as_the_page_says() {
    let mut robot = ready(&[]);
    let mut status = vector(HSES_PAGE, "ans_status_ready");
    status[11] = 0;
    assert_eq!(send(&mut robot, 1, "req_status"), Some(status));
    let mut none = vector(HSES_PAGE, "ans_alarm_none");
    none[11] = 0;
    assert_eq!(send(&mut robot, 1, "req_alarm_1"), Some(none));
    for name in ["req_hold_on", "req_hold_off", "req_alarm_reset", "req_error_cancel"] {
        assert_eq!(
            send(&mut robot, 1, name),
            Some(vector(HSES_PAGE, "ans_set_ok")),
            "{name}"
        );
    }
    let system = send(&mut robot, 1, "req_system_information").unwrap();
    assert_eq!(system[..32], vector(HSES_PAGE, "ans_system_information")[..32]);
    assert!(system[32..].starts_with(b"SIMULATED "));
    assert!(system[56..].starts_with(b"SIMULATED DX200\0"));
    assert_eq!(
        send(&mut robot, 1, "req_move_base_50mm_s"),
        Some(vector(HSES_PAGE, "ans_move_accepted"))
    );
    assert_eq!(
        send(&mut robot, 2, "req_move_base_50mm_s"),
        Some(vector(HSES_PAGE, "ans_move_refused_2010"))
    );
    let mut running = vector(HSES_PAGE, "ans_status_running");
    running[11] = 0;
    assert_eq!(send(&mut robot, 2, "req_status"), Some(running));
    assert_eq!(
        send(&mut robot, 100 * SECOND_NS, "req_position"),
        Some(vector(HSES_PAGE, "ans_position"))
    );
    assert_eq!(
        send(&mut robot, 100 * SECOND_NS, "req_servo_off"),
        Some(vector(HSES_PAGE, "ans_set_ok"))
    );
}

#[test]
fn what_the_controller_does_not_know_is_refused_by_its_own_status() {
    let mut robot = controller(&[]);
    for (at, value, status) in [(24, 0x6F, 0x08), (26, 9, 0x28), (28, 7, 0x09), (29, 0x55, 0x08)] {
        let mut datagram = vector(HSES_PAGE, "req_status");
        datagram[at] = value;
        let answer = ask(&mut robot, 0, &datagram).unwrap();
        assert_eq!((answer[25], answer[26]), (status, 0), "byte {at}");
    }
    let mut undefined = vector(HSES_PAGE, "req_status");
    (undefined[11], undefined[24]) = (1, 0x6F);
    assert_eq!(
        ask(&mut robot, 0, &undefined),
        Some(vector(HSES_PAGE, "ans_undefined_command"))
    );
}

#[test]
fn pulses_have_instance_1_and_no_other_instance_but_the_base_exists() {
    let mut robot = controller(&[]);
    let mut datagram = vector(HSES_PAGE, "req_position");
    datagram[26] = 1;
    let answer = ask(&mut robot, 0, &datagram).unwrap();
    assert_eq!((answer[25], answer.len(), answer[32]), (0, 84, 0));
    datagram[26] = 2;
    assert_eq!(ask(&mut robot, 0, &datagram).unwrap()[25], 0x28);
}

#[test]
fn a_malformed_datagram_is_told_and_not_answered() {
    let mut robot = controller(&[]);
    let from = ([127, 0, 0, 1], 5000).into();
    robot.handle_datagram(0, Port::Robot, from, b"YERC");
    assert!(matches!(robot.poll_output(), Some(RobotOutput::Violation(_))));
    assert_eq!(robot.poll_output(), None);
}

#[test]
fn preconditions_are_checked_in_the_order_of_the_page() {
    let mut robot = controller(&["robot-alarm=4315@0"]);
    // A move with a wrong field, so that what is refused last is the field.
    let order = move_with(&[(15, 64)]);
    let refusal = |robot: &mut Controller, now_ns| added(&ask(robot, now_ns, &order).unwrap());
    send(&mut robot, 0, "req_servo_on");
    ask(&mut robot, 0, &move_with(&[])).unwrap();
    let after_ns = 60 * SECOND_NS;
    send(&mut robot, after_ns, "req_hold_on");
    robot.handle_panel(after_ns, Panel::Hold(true));
    robot.handle_panel(after_ns, Panel::Play(false));
    robot.handle_panel(after_ns, Panel::Remote(false));
    assert_eq!(refusal(&mut robot, after_ns), Some(0x2100));
    robot.handle_panel(after_ns, Panel::Remote(true));
    assert_eq!(refusal(&mut robot, after_ns), Some(0x2080));
    robot.handle_panel(after_ns, Panel::Play(true));
    assert_eq!(refusal(&mut robot, after_ns), Some(0x2060));
    send(&mut robot, after_ns, "req_alarm_reset");
    assert_eq!(refusal(&mut robot, after_ns), Some(0x2020));
    robot.handle_panel(after_ns, Panel::Hold(false));
    assert_eq!(refusal(&mut robot, after_ns), Some(0x2050));
    send(&mut robot, after_ns, "req_hold_off");
    assert_eq!(refusal(&mut robot, after_ns), Some(0x2070));
    send(&mut robot, after_ns, "req_servo_on");
    assert_eq!(refusal(&mut robot, after_ns), Some(0xB00D));
    ask(&mut robot, after_ns, &move_with(&[])).unwrap();
    assert_eq!(refusal(&mut robot, after_ns + 1), Some(0x2010));
}

#[test]
fn every_field_of_a_move_has_its_refusal() {
    let mut robot = ready(&[]);
    for (changes, code) in [
        (&[(1, 1)][..], 0xB008),
        (&[(2, 3)], 0xB009),
        (&[(3, -1)], 0xB009),
        (&[(3, 15_001)], 0xB009),
        (&[(2, 2), (3, 1_801)], 0xB009),
        (&[(3, 0)], 0xB00A),
        (&[(4, 18)], 0xB00B),
        (&[(13, 128)], 0xB00C),
        (&[(15, 64)], 0xB00D),
        (&[(15, -1)], 0xB00D),
        (&[(16, 1)], 0xB00E),
        (&[(5, 2_000_001)], 0xB004),
        (&[(7, -1)], 0xB004),
        (&[(8, 1_800_001)], 0xB004),
        (&[(20, 1)], 0xB004),
    ] {
        assert_eq!(
            added(&ask(&mut robot, 0, &move_with(changes)).unwrap()),
            Some(code),
            "{changes:?}"
        );
    }
    let mut short = move_with(&[]);
    short.truncate(32 + 100);
    short[6] = 100;
    assert_eq!(added(&ask(&mut robot, 0, &short).unwrap()), Some(0xB003));
    assert_eq!(robot.accepted_move_count(), 0);
}

#[test]
fn without_command_remote_only_reads_and_hold_on_work() {
    let mut robot = controller(&["remote-off"]);
    for name in [
        "req_hold_off",
        "req_servo_on",
        "req_servo_off",
        "req_alarm_reset",
        "req_error_cancel",
    ] {
        assert_eq!(
            send(&mut robot, 0, name),
            Some(vector(HSES_PAGE, "ans_set_refused_2100")),
            "{name}"
        );
    }
    assert_eq!(
        send(&mut robot, 0, "req_hold_on"),
        Some(vector(HSES_PAGE, "ans_set_ok"))
    );
    assert_eq!(status(&mut robot, 0), (0x44, 0x08));
    robot.handle_panel(0, Panel::Play(false));
    assert_eq!(status(&mut robot, 0), (0x24, 0x08));
}

#[test]
fn a_pressed_emergency_stop_refuses_the_servo_and_shows_in_no_bit() {
    let mut robot = controller(&["servo-refused"]);
    assert_eq!(
        send(&mut robot, 0, "req_servo_on"),
        Some(vector(HSES_PAGE, "ans_servo_refused_3450"))
    );
    assert_eq!(status(&mut robot, 0), (0xC4, 0));
}

#[test]
fn a_move_takes_its_time_and_ends_exactly_at_the_quantised_target() {
    let mut robot = ready(&[]);
    // From 1000, -200, 1100 mm, turned, to 200 mm away at 50 mm/s: 4 s and a ramp of 0.2 s.
    let order = move_with(&[(5, 1_000_000), (6, 0), (7, 1_100_000), (8, 0), (9, 900_000), (10, 0)]);
    assert_eq!(added(&ask(&mut robot, 0, &order).unwrap()), None);
    assert_eq!(status(&mut robot, 4_199_999_999), (0xCC, 0x40));
    assert_eq!(robot.pose(2_100_000_000).position_um, [1_000_000, -100_000, 1_100_000]);
    assert_eq!(status(&mut robot, 4_200_000_000), (0xC4, 0x40));
    let target = Pose {
        position_um: [1_000_000, 0, 1_100_000],
        turn_e4_deg: [0, 900_000, 0],
    };
    assert_eq!(robot.pose(4_200_000_000), target);
}

#[test]
fn a_hold_stops_the_arm_and_its_release_does_not_move_it() {
    let mut robot = ready(&[]);
    send(&mut robot, 0, "req_move_base_50mm_s");
    send(&mut robot, SECOND_NS, "req_hold_on");
    assert_eq!(status(&mut robot, SECOND_NS), (0xCC, 0x48));
    let stood_ns = SECOND_NS + 200_000_001;
    assert_eq!(status(&mut robot, stood_ns), (0xC4, 0x48));
    let stood = robot.pose(stood_ns);
    send(&mut robot, 2 * SECOND_NS, "req_hold_off");
    assert_eq!(status(&mut robot, 3 * SECOND_NS), (0xC4, 0x40));
    assert_eq!(robot.pose(3 * SECOND_NS), stood);
    assert_eq!(
        send(&mut robot, 3 * SECOND_NS, "req_move_base_50mm_s"),
        Some(vector(HSES_PAGE, "ans_move_accepted"))
    );
    let there = send(&mut robot, 100 * SECOND_NS, "req_position");
    assert_eq!(there, Some(vector(HSES_PAGE, "ans_position")));
}

#[test]
fn servo_off_stops_a_move_at_once() {
    let mut robot = ready(&[]);
    send(&mut robot, 0, "req_move_base_50mm_s");
    let before = robot.pose(SECOND_NS);
    send(&mut robot, SECOND_NS, "req_servo_off");
    assert_eq!(status(&mut robot, SECOND_NS), (0xC4, 0));
    assert_eq!(robot.pose(2 * SECOND_NS), before);
}

#[test]
fn an_alarm_in_mid_move_stops_the_arm_until_reset_and_servo_on() {
    let mut robot = ready(&["robot-alarm=4315@0"]);
    send(&mut robot, 0, "req_move_base_50mm_s");
    let after_ns = 30 * SECOND_NS;
    assert_eq!(status(&mut robot, after_ns), (0xC4, 0x10));
    let mut alarm = vector(HSES_PAGE, "ans_alarm_4315");
    alarm[11] = 0;
    assert_eq!(send(&mut robot, after_ns, "req_alarm_1"), Some(alarm));
    assert_ne!(robot.pose(after_ns).position_um, [500_000, -250_000, 750_000]);
    assert_eq!(
        added(&send(&mut robot, after_ns, "req_servo_on").unwrap()),
        Some(0x2060)
    );
    send(&mut robot, after_ns, "req_alarm_reset");
    send(&mut robot, after_ns, "req_servo_on");
    assert_eq!(status(&mut robot, after_ns), (0xC4, 0x40));
    assert_eq!(
        send(&mut robot, after_ns, "req_move_base_50mm_s"),
        Some(vector(HSES_PAGE, "ans_move_accepted"))
    );
    assert_eq!(status(&mut robot, 200 * SECOND_NS), (0xC4, 0x40));
}

#[test]
fn an_emergency_stop_in_mid_move_stops_the_arm_and_keeps_the_servo_off() {
    let mut robot = ready(&["estop@0"]);
    send(&mut robot, 0, "req_move_base_50mm_s");
    assert_eq!(status(&mut robot, 60 * SECOND_NS), (0xC4, 0));
    assert_eq!(
        added(&send(&mut robot, 60 * SECOND_NS, "req_servo_on").unwrap()),
        Some(0x3450)
    );
}

#[test]
fn a_silent_robot_moves_and_answers_nothing() {
    let mut robot = ready(&["robot-silent@0"]);
    assert_eq!(send(&mut robot, 0, "req_move_base_50mm_s"), None);
    assert_eq!(send(&mut robot, 1, "req_status"), None);
    assert_eq!(robot.pose(100 * SECOND_NS).position_um, [500_000, -250_000, 750_000]);
}

#[test]
fn a_robot_that_stops_elsewhere_says_so() {
    let mut robot = ready(&["elsewhere=2.5@0"]);
    send(&mut robot, 0, "req_move_base_50mm_s");
    assert_eq!(robot.pose(100 * SECOND_NS).position_um, [500_000, -250_000, 752_500]);
    assert_eq!(status(&mut robot, 100 * SECOND_NS), (0xC4, 0x40));
}

#[test]
fn lost_answers_are_a_seeded_share() {
    let lost = |seed: u64| {
        let mut robot = Controller::new(Settings {
            seed,
            ..settings(&["answer-lost=0.25"])
        });
        (0..1000)
            .map(|_| send(&mut robot, 0, "req_status").is_none())
            .collect::<Vec<_>>()
    };
    let count = lost(1).into_iter().filter(|is_lost| *is_lost).count();
    assert!((200..300).contains(&count), "{count}");
    assert_eq!(lost(1), lost(1));
    assert_ne!(lost(1), lost(2));
}
