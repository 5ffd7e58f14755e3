//! States of the controller, as a person and the faults bring them about.

use crate::robot::alarms::{AlarmGroup, CODE_ESTOP};
use crate::robot::controller::{Controller, Options, Panel, Settings};
use crate::robot::moves::{CartesianOrder, OrderedSpeed, Path};
use crate::robot::pose::Pose;
use crate::robot::refused::Refused;
use crate::robot::switches::{Cycle, Mode};
use crate::robot::variables::{Kind, Value};

const SECOND_NS: u64 = 1_000_000_000;

fn with(faults: &[&str], options: Options) -> Controller {
    let mut robot = Controller::new(Settings {
        faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        options,
        ..Settings::default()
    });
    robot.set_servo(0, true).unwrap();
    robot
}

fn ready(faults: &[&str]) -> Controller {
    with(faults, Options::default())
}

fn to(x_mm: f64) -> CartesianOrder {
    CartesianOrder {
        path: Path::Straight,
        is_increment: false,
        speed: OrderedSpeed { class: 1, value: 5000 },
        coordinate: 16,
        pose: Pose::from_mm_deg([x_mm, 0.0, 900.0], [0.0; 3]),
        form: 0,
        form_ext: 0,
        tool: 1,
        user: 0,
    }
}

#[test]
fn each_precondition_has_its_refusal() {
    for (on, off, refused, status) in [
        (
            Panel::Remote(false),
            Panel::Remote(true),
            Refused::NOT_REMOTE,
            [0x44, 0x40],
        ),
        (
            Panel::CommandRemoteSelect(false),
            Panel::CommandRemoteSelect(true),
            Refused::NOT_REMOTE,
            [0x44, 0x40],
        ),
        (Panel::Play(false), Panel::Play(true), Refused::WRONG_MODE, [0xA4, 0x40]),
        (
            Panel::Hold(true),
            Panel::Hold(false),
            Refused::HELD_BY_PENDANT,
            [0xC4, 0x42],
        ),
        (
            Panel::PanelHold(true),
            Panel::PanelHold(false),
            Refused::HELD_BY_PANEL,
            [0xC4, 0x44],
        ),
        (
            Panel::ExternalHold(true),
            Panel::ExternalHold(false),
            Refused::HELD_EXTERNALLY,
            [0xC4, 0x44],
        ),
        (Panel::Servo(false), Panel::Servo(true), Refused::SERVO_OFF, [0xC4, 0]),
    ] {
        let mut robot = ready(&[]);
        robot.handle_panel(0, on);
        assert_eq!(robot.move_cartesian(0, &to(700.0)), Err(refused), "{on:?}");
        assert_eq!(robot.status(0), status, "{on:?}");
        robot.handle_panel(0, off);
        assert_eq!(robot.move_cartesian(0, &to(700.0)), Ok(()), "{off:?}");
    }
}

#[test]
fn an_error_stops_and_is_cancelled() {
    let mut robot = ready(&[]);
    robot.move_cartesian(0, &to(0.0)).unwrap();
    robot.handle_panel(SECOND_NS, Panel::Error);
    assert_eq!(robot.status(2 * SECOND_NS), [0xC4, 0x60]);
    assert_eq!(
        robot.move_cartesian(2 * SECOND_NS, &to(0.0)),
        Err(Refused::ALARM_PRESENT)
    );
    robot.reset_alarms(2 * SECOND_NS).unwrap();
    assert_eq!(robot.status(2 * SECOND_NS)[1], 0x60);
    robot.cancel_error(2 * SECOND_NS).unwrap();
    assert_eq!(robot.move_cartesian(2 * SECOND_NS, &to(0.0)), Ok(()));
}

#[test]
fn a_major_alarm_stays_until_the_controller_is_switched_off() {
    let mut robot = ready(&[]);
    robot.handle_panel(5, Panel::Alarm(1325));
    robot.reset_alarms(6).unwrap();
    robot.handle_panel(6, Panel::Reset);
    assert_eq!(robot.status(6), [0xC4, 0x10]);
    assert_eq!(robot.set_servo(6, true), Err(Refused::ALARM_PRESENT));
    assert_eq!(
        robot
            .alarm_history(6, AlarmGroup::Major, 1)
            .unwrap()
            .map(|alarm| alarm.code),
        Some(1325)
    );
    robot.handle_panel(7, Panel::Power(false));
    assert!(robot.is_silent());
    robot.handle_panel(8, Panel::Power(true));
    assert!(!robot.is_silent());
    assert_eq!(robot.status(8), [0xC4, 0]);
    assert_eq!(robot.set_servo(8, true), Ok(()));
}

#[test]
fn an_emergency_stop_may_leave_an_alarm_behind() {
    let mut robot = with(
        &[],
        Options {
            estop_latches_alarm: true,
            ..Options::default()
        },
    );
    robot.handle_panel(0, Panel::EmergencyStop(true));
    assert_eq!(robot.status(0), [0xC4, 0x10]);
    assert_eq!(robot.alarm(0, 1).unwrap().map(|alarm| alarm.code), Some(CODE_ESTOP));
    assert_eq!(robot.set_servo(0, true), Err(Refused::SERVO_REFUSED));
    robot.reset_alarms(0).unwrap();
    assert_eq!(robot.status(0)[1], 0x10);
    robot.handle_panel(1, Panel::EmergencyStop(false));
    assert_eq!(robot.set_servo(1, true), Err(Refused::ALARM_PRESENT));
    robot.reset_alarms(1).unwrap();
    assert_eq!(robot.set_servo(1, true), Ok(()));
}

#[test]
fn an_open_door_takes_servo_power_and_keeps_it_off() {
    let mut robot = ready(&["door@0"]);
    robot.move_cartesian(0, &to(0.0)).unwrap();
    assert_eq!(robot.status(SECOND_NS), [0xC4, 0]);
    assert_eq!(robot.set_servo(SECOND_NS, true), Err(Refused::SERVO_REFUSED));
    robot.handle_panel(SECOND_NS, Panel::Servo(true));
    assert_eq!(robot.status(SECOND_NS), [0xC4, 0]);
    robot.handle_panel(SECOND_NS, Panel::Door(false));
    assert_eq!(robot.set_servo(SECOND_NS, true), Ok(()));
}

#[test]
fn a_hold_at_the_pendant_and_a_drop_of_the_servo_happen_in_mid_move() {
    let mut robot = ready(&["pendant-hold@0", "servo-drop@1"]);
    robot.move_cartesian(0, &to(0.0)).unwrap();
    assert_eq!(robot.status(2 * SECOND_NS), [0xC4, 0x42]);
    let stood_mm = f64::from(robot.pose(2 * SECOND_NS).position_um[0]) / 1000.0;
    assert!((300.0..500.0).contains(&stood_mm), "{stood_mm}");
    robot.handle_panel(2 * SECOND_NS, Panel::Hold(false));
    robot.move_cartesian(2 * SECOND_NS, &to(0.0)).unwrap();
    assert_eq!(robot.status(4 * SECOND_NS), [0xC4, 0]);
    robot.set_servo(4 * SECOND_NS, true).unwrap();
    robot.move_cartesian(4 * SECOND_NS, &to(0.0)).unwrap();
    assert_eq!(robot.pose(10 * SECOND_NS).position_um[0], 0);
}

#[test]
fn a_loss_of_power_is_silence_and_then_a_controller_with_its_memory() {
    let mut robot = ready(&["power-loss=3@0"]);
    robot.set_variable(0, 5, Value::D(7)).unwrap();
    robot.move_cartesian(0, &to(0.0)).unwrap();
    assert_eq!(robot.status(500_000_000), [0xCC, 0x40]);
    robot.handle_wake(2 * SECOND_NS);
    assert!(robot.is_silent());
    robot.handle_wake(4 * SECOND_NS);
    assert!(!robot.is_silent());
    assert_eq!(robot.status(4 * SECOND_NS), [0xC4, 0]);
    assert_eq!(robot.variable(4 * SECOND_NS, Kind::D, 5), Ok(Value::D(7)));
}

#[test]
fn servo_power_sleeps_after_idleness_and_not_during_motion() {
    let mut robot = with(
        &[],
        Options {
            servo_sleep_s: Some(10.0),
            ..Options::default()
        },
    );
    robot
        .move_cartesian(
            5 * SECOND_NS,
            &CartesianOrder {
                speed: OrderedSpeed { class: 1, value: 100 },
                ..to(700.0)
            },
        )
        .unwrap();
    // 100 mm at 10 mm/s and a ramp, then ten seconds.
    assert_eq!(robot.status(25_199_000_000), [0xC4, 0x40]);
    assert_eq!(robot.status(25_201_000_000), [0xC4, 0]);
    assert_eq!(
        robot.move_cartesian(26 * SECOND_NS, &to(800.0)),
        Err(Refused::SERVO_OFF)
    );
}

#[test]
fn a_speed_restriction_shows_and_slows() {
    let mut robot = ready(&[]);
    robot.handle_panel(0, Panel::SpeedRestriction(true));
    assert_eq!(robot.status(0)[0], 0xD4);
    robot.move_cartesian(0, &to(300.0)).unwrap();
    // 500 mm at 250 mm/s instead of 500, and a ramp.
    assert!(robot.is_moving(2_199_999_999));
    assert!(!robot.is_moving(2_200_000_000));
}

#[test]
fn writes_need_command_remote_unless_an_option_says_otherwise() {
    let open = Options {
        writes_need_remote: false,
        ..Options::default()
    };
    for (options, expected) in [(Options::default(), Err(Refused::NOT_REMOTE)), (open, Ok(()))] {
        let mut robot = with(&[], options);
        robot.handle_panel(0, Panel::Remote(false));
        assert_eq!(robot.set_variable(0, 5, Value::D(7)), expected);
        assert_eq!(robot.set_register(0, 5, 7), expected);
        assert_eq!(robot.set_signal_byte(0, 2701, 7), expected);
        assert!(robot.variable(0, Kind::D, 5).is_ok());
        assert_eq!(robot.set_cycle(0, Cycle::Step), Err(Refused::NOT_REMOTE));
        assert_eq!(robot.show_text(0, b"IN ANY MODE"), Ok(()));
    }
}

#[test]
fn a_hold_needs_command_remote_only_by_option() {
    let mut robot = with(
        &[],
        Options {
            hold_needs_remote: true,
            ..Options::default()
        },
    );
    robot.handle_panel(0, Panel::Remote(false));
    assert_eq!(robot.set_hold(0, true), Err(Refused::NOT_REMOTE));
}

#[test]
fn the_mode_is_not_changed_in_motion() {
    let mut robot = ready(&[]);
    robot.move_cartesian(0, &to(0.0)).unwrap();
    assert_eq!(robot.set_mode(0, Mode::Teach), Err(Refused::MOVING));
    assert_eq!(robot.set_mode(10 * SECOND_NS, Mode::Teach), Ok(()));
    assert_eq!(robot.status(10 * SECOND_NS)[0], 0xA4);
    assert_eq!(robot.set_servo(10 * SECOND_NS, true), Err(Refused::WRONG_MODE));
}

#[test]
fn times_count_what_was_on() {
    let mut robot = ready(&[]);
    robot.move_cartesian(10 * SECOND_NS, &to(300.0)).unwrap();
    robot.set_servo(30 * SECOND_NS, false).unwrap();
    let times = [1, 10, 110, 210].map(|number| robot.management_time(60 * SECOND_NS, number).unwrap().elapsed_ns);
    assert_eq!(times, [60 * SECOND_NS, 30 * SECOND_NS, 1_200_000_000, 1_200_000_000]);
}

#[test]
fn a_busy_controller_answers_reads_alone() {
    use crate::robot::controller::RobotOutput;
    use crate::robot::hses::Port;
    use crate::vectors::{HSES_PAGE, vector};
    let mut robot = ready(&["busy=2@0"]);
    robot.move_cartesian(0, &to(0.0)).unwrap();
    let mut status = |now_ns, name| {
        let from = ([127, 0, 0, 1], 1).into();
        robot.handle_datagram(now_ns, Port::Robot, from, &vector(HSES_PAGE, name));
        let Some(RobotOutput::Datagram { bytes, .. }) = robot.poll_output() else {
            panic!()
        };
        (bytes[25], u16::from_le_bytes([bytes[28], bytes[29]]))
    };
    assert_eq!(status(SECOND_NS, "req_hold_off"), (0x1F, 0xE444));
    assert_eq!(status(SECOND_NS, "req_status"), (0, 0));
    assert_eq!(status(4 * SECOND_NS, "req_hold_off"), (0, 0));
}
