//! One datagram lost, doubled or late, at any place of a run.

use super::carry::Weather;
use super::drive::drive;
use super::setup::{Ended, Happening, Link, Outcome, Phase, Setup, Tamper, Way, When};
use bladescan::session::ArmEvent;
use hw_sim::robot::controller::Panel;

/// A short run over a good wire, held by the operator in the middle of its second move.
fn held_once(way: Way) -> Setup {
    Setup {
        link: Link::Hses,
        way,
        target_count: 3,
        weather: Weather::default(),
        tampers: Vec::new(),
        faults: Vec::new(),
        incidents: vec![
            (
                When::In(Phase::Standing),
                Happening::Panel(Panel::SpeedRestriction(false)),
            ),
            (When::After(500_000_000), Happening::OperatorHold),
        ],
        exposure_ns: 150_000_000,
        seed: 1,
    }
}

/// The run of `setup` with `tampers`; it must be sound.
#[track_caller]
fn with(setup: &Setup, tampers: &[Tamper]) -> Outcome {
    let setup = Setup {
        tampers: tampers.to_vec(),
        ..setup.clone()
    };
    let outcome = drive(&setup);
    assert!(outcome.is_sound(), "{tampers:?}: {outcome:#?}");
    outcome
}

/// The indices of all datagrams of a command in a run.
fn indices(outcome: &Outcome, command: u16) -> Vec<usize> {
    let sent = outcome.sent.iter().enumerate();
    sent.filter(|(_, (said, _))| *said == command)
        .map(|(index, _)| index)
        .collect()
}

#[test]
fn any_one_datagram_may_get_lost() {
    for way in [Way::Direct, Way::Job] {
        let setup = held_once(way);
        for index in 0..drive(&setup).sent.len() {
            let outcome = with(&setup, &[Tamper::Lose { index }]);
            assert_eq!(outcome.ended, Ended::Finished, "{way:?}, {index} lost");
        }
    }
}

#[test]
fn any_one_datagram_to_the_scan_job_may_come_again_at_any_time() {
    let setup = held_once(Way::Job);
    let whole = drive(&setup);
    assert_eq!(whole.ended, Ended::Finished);
    let asks = [indices(&whole, STATUS), indices(&whole, POSITION)].concat();
    for index in (0..whole.sent.len()).filter(|index| !asks.contains(index)) {
        for late_ns in (0..12).map(|step| 1_300_000 + step * 470_000_000) {
            with(&setup, &[Tamper::Again { index, late_ns }]);
        }
    }
}

#[test]
fn a_selection_that_gets_lost_after_a_hold_does_not_let_the_interrupted_move_go_on() {
    let setup = held_once(Way::Job);
    let selections = indices(&drive(&setup), SELECT);
    assert_eq!(selections.len(), 3, "first start, hold, second start");
    let lost: Vec<Tamper> = selections[1..]
        .iter()
        .map(|index| Tamper::Lose { index: *index })
        .collect();
    for tampers in [&lost[..1], &lost[1..], &lost] {
        assert_eq!(with(&setup, tampers).ended, Ended::Finished);
    }
}

#[test]
fn an_order_that_is_written_over_is_said_again() {
    let setup = held_once(Way::Job);
    let orders = indices(&drive(&setup), ONE_DOUBLE);
    // The order with which the first start begins comes again while a later one is open.
    let first = orders[0];
    let late = |late_ns| with(&setup, &[Tamper::Again { index: first, late_ns }]);
    for step in 1..20 {
        assert_eq!(late(step * 100_000_000).ended, Ended::Finished);
    }
}

#[test]
fn a_start_whose_answer_is_that_to_its_double_has_happened() {
    let setup = held_once(Way::Job);
    let whole = drive(&setup);
    let index = indices(&whole, START)[0];
    let from_ns = whole.sent[index].1;
    let to_ns = from_ns + 1_000_000;
    let late_ns = 30_000_000;
    let outcome = with(
        &setup,
        &[Tamper::Again { index, late_ns }, Tamper::Deaf { from_ns, to_ns }],
    );
    assert_eq!(outcome.ended, Ended::Finished);
}

#[test]
fn a_move_cut_short_by_somebody_is_not_said_anew_though_its_answer_got_lost() {
    let mut setup = held_once(Way::Direct);
    let whole = drive(&setup);
    let from_ns = whole.sent[indices(&whole, MOVE)[0]].1;
    let press = When::At(from_ns + 300_000_000);
    setup.incidents = vec![
        (press, Happening::Panel(Panel::Hold(true))),
        (When::After(50_000_000), Happening::Panel(Panel::Hold(false))),
    ];
    let to_ns = from_ns + 650_000_000;
    let outcome = with(&setup, &[Tamper::Deaf { from_ns, to_ns }]);
    assert_eq!(outcome.ended, Ended::Fault("robot-elsewhere"));
}

#[test]
fn servo_power_that_is_found_off_by_a_refusal_is_named_so() {
    let mut setup = held_once(Way::Direct);
    let whole = drive(&setup);
    let to_servo_off = whole.sent[indices(&whole, MOVE)[1]].1 - 100_000;
    setup.incidents = vec![(When::At(to_servo_off), Happening::Panel(Panel::Servo(false)))];
    let outcome = with(&setup, &[]);
    assert_eq!(outcome.ended, Ended::Fault("robot-servo"));
    let arrived = |event: &&(u64, ArmEvent)| matches!(event.1, ArmEvent::Arrived { .. });
    assert_eq!(outcome.events.iter().filter(arrived).count(), 1);
}

#[test]
fn the_scan_job_reads_an_order_once_so_that_none_is_read_in_halves() {
    let job = include_str!("../../docs/robot/BLADESCAN.JBI");
    let reading = |line: &&str| line.contains("D010") && !line.starts_with('\'');
    let lines: Vec<&str> = job.lines().filter(reading).collect();
    assert_eq!(
        lines,
        ["SET D020 D010", "SET D020 D010"],
        "at its start, and in its loop"
    );
}

const STATUS: u16 = 0x72;
const POSITION: u16 = 0x75;
const ONE_DOUBLE: u16 = 0x7C;
const START: u16 = 0x86;
const SELECT: u16 = 0x87;
const MOVE: u16 = 0x8A;
