//! The conversation against answers of the pages, over HSES and over host control.

use super::*;
use crate::robot::{Values, Variable, VariableKind};
use crate::vectors::{host, hses};

const SETTINGS: ExchangeSettings = ExchangeSettings {
    protocol: Protocol::Hses,
    answer_timeout_ms: 300,
    ask_attempts: 3,
    set_repeat_ms: 100,
    set_timeout_ms: 1000,
};

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

/// The page's answer `name`, given the id of the last request in `sent`.
fn answer_to(sent: &RobotOutput, name: &str) -> Vec<u8> {
    let mut bytes = hses(name);
    let RobotOutput::Bytes { bytes: request, .. } = sent else {
        panic!("{sent:?}")
    };
    bytes[11] = request[11];
    bytes
}

fn drain(exchange: &mut Exchange) -> Vec<RobotOutput> {
    std::iter::from_fn(|| exchange.poll_output()).collect()
}

#[test]
fn an_ask_is_repeated_and_then_counts_as_unanswered() {
    let mut exchange = Exchange::new(SETTINGS);
    exchange.say(at(0), Command::Status);
    assert_eq!(drain(&mut exchange).len(), 1);
    for ms in [300, 600] {
        assert_eq!(exchange.wake_at(), Some(at(ms)));
        exchange.handle_wake(at(ms));
        assert_eq!(drain(&mut exchange).len(), 1);
    }
    exchange.handle_wake(at(900));
    assert!(drain(&mut exchange).is_empty());
    assert_eq!(
        exchange.poll_event(),
        Some(RobotEvent::Unanswered {
            command: Command::Status
        })
    );
    assert_eq!(exchange.wake_at(), None);
}

#[test]
fn an_unanswered_act_is_never_sent_twice() {
    let mut exchange = Exchange::new(SETTINGS);
    exchange.say(at(0), Command::ServoOn);
    assert_eq!(drain(&mut exchange).len(), 1);
    exchange.handle_wake(at(300));
    exchange.handle_wake(at(600));
    assert!(drain(&mut exchange).is_empty());
    assert_eq!(
        exchange.poll_event(),
        Some(RobotEvent::Unanswered {
            command: Command::ServoOn
        })
    );
}

#[test]
fn hold_waits_for_nothing_and_is_repeated_until_confirmed() {
    let mut exchange = Exchange::new(SETTINGS);
    exchange.say(at(0), Command::Status);
    exchange.say(at(1), Command::HoldOn);
    let sent = drain(&mut exchange);
    assert_eq!(sent.len(), 2);
    assert!(matches!(sent[1], RobotOutput::Bytes { kind: Kind::Set, .. }));
    exchange.handle_wake(at(101));
    let again = drain(&mut exchange);
    assert_eq!(again.len(), 1);
    exchange.handle_bytes(at(110), &answer_to(&again[0], "ans_set_ok"));
    assert_eq!(
        exchange.poll_event(),
        Some(RobotEvent::Answered {
            command: Command::HoldOn,
            reply: Reply::Done
        })
    );
    exchange.handle_bytes(at(120), &answer_to(&sent[0], "ans_status_ready"));
    assert!(matches!(
        exchange.poll_event(),
        Some(RobotEvent::Answered {
            command: Command::Status,
            ..
        })
    ));
}

#[test]
fn what_cannot_be_said_is_told_without_waiting_for_anything() {
    let mut exchange = Exchange::new(SETTINGS);
    exchange.say(at(5), Command::JobNames);
    assert!(drain(&mut exchange).is_empty());
    assert!(exchange.wake_at().is_some_and(|wake| wake <= at(5)));
    assert!(matches!(exchange.poll_event(), Some(RobotEvent::Unsayable { .. })));
    assert_eq!(exchange.wake_at(), None);
}

#[test]
fn a_late_or_foreign_answer_is_dropped_with_an_event() {
    let mut exchange = Exchange::new(SETTINGS);
    exchange.say(at(0), Command::Status);
    let first = drain(&mut exchange);
    exchange.handle_wake(at(300));
    let second = drain(&mut exchange);
    exchange.handle_bytes(at(310), &answer_to(&first[0], "ans_status_ready"));
    assert!(matches!(
        exchange.poll_event(),
        Some(RobotEvent::Dropped { malformed: false, .. })
    ));
    exchange.handle_bytes(at(320), &answer_to(&second[0], "ans_status_ready"));
    assert!(matches!(exchange.poll_event(), Some(RobotEvent::Answered { .. })));
    exchange.handle_bytes(at(330), b"noise");
    assert!(matches!(
        exchange.poll_event(),
        Some(RobotEvent::Dropped { malformed: true, .. })
    ));
}
/// A conversation over TCP whose connection stands, in which nothing is open.
fn over_tcp() -> Exchange {
    let mut exchange = Exchange::new(ExchangeSettings {
        protocol: Protocol::HostControl,
        ..SETTINGS
    });
    exchange.say(at(0), Command::Status);
    assert_eq!(drain(&mut exchange), [RobotOutput::Connect]);
    exchange.handle_connected(at(1));
    for name in ["greeting_always", "agree_status", "ans_status_ready"] {
        drain(&mut exchange);
        exchange.handle_bytes(at(2), &host(name));
    }
    assert!(matches!(exchange.poll_event(), Some(RobotEvent::Answered { .. })));
    exchange
}

fn is_sent(outputs: &[RobotOutput], text: &str) -> bool {
    outputs.iter().any(|output| match output {
        RobotOutput::Bytes { bytes, .. } => String::from_utf8_lossy(bytes).contains(text),
        _ => false,
    })
}

#[test]
fn several_variables_are_read_one_by_one_where_a_request_carries_one() {
    let mut exchange = over_tcp();
    let first = Variable {
        kind: VariableKind::Double,
        index: 42,
    };
    exchange.say(at(10), Command::Read { first, count: 3 });
    for (variable, value) in [("2,42", "7"), ("2,43", "-8"), ("2,44", "9")] {
        assert!(exchange.poll_event().is_none());
        assert!(is_sent(&drain(&mut exchange), "HOSTCTRL_REQUEST SAVEV 5"));
        exchange.handle_bytes(at(11), b"OK: SAVEV\r\n");
        assert!(is_sent(&drain(&mut exchange), variable));
        exchange.handle_bytes(at(12), format!("{value}\r").as_bytes());
    }
    let Some(RobotEvent::Answered { command, reply }) = exchange.poll_event() else {
        panic!("the whole is answered once")
    };
    assert_eq!(command, Command::Read { first, count: 3 });
    assert_eq!(reply, Reply::Values(Values::Double(vec![7, -8, 9])));
    assert!(exchange.poll_event().is_none());
}

#[test]
fn a_refusal_of_one_variable_is_that_of_all() {
    let mut exchange = over_tcp();
    let first = Variable {
        kind: VariableKind::Double,
        index: 42,
    };
    let values = Values::Double(vec![1, 2]);
    exchange.say(at(10), Command::Write { first, values });
    drain(&mut exchange);
    exchange.handle_bytes(at(11), b"OK: LOADV\r\n");
    drain(&mut exchange);
    exchange.handle_bytes(at(12), b"ERROR: LOADV is not successful(2100)\r\n");
    assert!(matches!(
        exchange.poll_event(),
        Some(RobotEvent::Refused { refusal, .. }) if refusal.added_status == 0x2100
    ));
    assert!(!is_sent(&drain(&mut exchange), "LOADV"), "the second is not tried");
}

#[test]
fn a_hold_over_one_wire_cuts_short_what_is_open() {
    let mut exchange = over_tcp();
    exchange.say(at(10), Command::Status);
    assert!(is_sent(&drain(&mut exchange), "RSTATS"));
    exchange.forget_open(at(11));
    exchange.say(at(11), Command::HoldOn);
    // Nobody answers the question: as soon as the wire allows, by a new connection if need be, the hold goes out.
    let mut sent = false;
    for _ in 0..20 {
        let outputs = drain(&mut exchange);
        if outputs.contains(&RobotOutput::Connect) {
            exchange.handle_connected(at(400));
            drain(&mut exchange);
            exchange.handle_bytes(at(401), &host("greeting_always"));
        }
        sent |= is_sent(&outputs, "HOSTCTRL_REQUEST HOLD");
        match exchange.wake_at() {
            Some(wake) if !sent => exchange.handle_wake(wake),
            _ => break,
        }
    }
    assert!(sent || is_sent(&drain(&mut exchange), "HOSTCTRL_REQUEST HOLD"));
    while let Some(event) = exchange.poll_event() {
        let told = format!("{event:?}");
        assert!(
            !told.contains("command: Status"),
            "what was forgotten is not told: {told}"
        );
    }
}

#[test]
fn a_serial_line_that_has_ended_says_so_to_everything_said_afterwards() {
    let mut exchange = Exchange::new(ExchangeSettings {
        protocol: Protocol::Serial,
        ..SETTINGS
    });
    exchange.say(at(0), Command::ServoOn);
    drain(&mut exchange);
    exchange.handle_closed(at(5), "pulled");
    assert!(matches!(exchange.poll_event(), Some(RobotEvent::Lost { .. })));
    assert!(matches!(exchange.poll_event(), Some(RobotEvent::Unanswered { .. })));
    exchange.say(at(6), Command::ServoOff);
    assert!(matches!(exchange.poll_event(), Some(RobotEvent::Unsayable { reason, .. }) if reason.contains("pulled")));
}
