//! The client against lines of the page.

use super::*;
use crate::robot::{Move, Path, Speed, WirePose};
use crate::vectors::host;
use proptest::prelude::*;

const SETTINGS: TcpSettings = TcpSettings {
    connect_timeout_ms: 3000,
    answer_timeout_ms: 1000,
    give_up_ms: 200,
};

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

fn bytes(name: &str, kind: Kind) -> RobotOutput {
    RobotOutput::Bytes {
        bytes: host(name),
        kind,
    }
}

fn outputs(link: &mut TcpLink) -> Vec<RobotOutput> {
    std::iter::from_fn(|| link.poll_output()).collect()
}

fn events(link: &mut TcpLink) -> Vec<LinkEvent> {
    std::iter::from_fn(|| link.poll_event()).collect()
}

fn hear(link: &mut TcpLink, names: &[&str]) {
    for name in names {
        link.handle_bytes(at(2), &host(name));
    }
}

/// A link that has said `command` over a new connection with this greeting.
fn saying(command: &Command, greeting: &str) -> TcpLink {
    let mut link = TcpLink::new(SETTINGS);
    link.say(at(0), command).unwrap();
    assert_eq!(outputs(&mut link), [RobotOutput::Connect]);
    link.handle_connected(at(1));
    assert_eq!(outputs(&mut link), [bytes("connect", Kind::Ask)]);
    hear(&mut link, &[greeting]);
    link
}

fn refused(code: u16) -> LinkEvent {
    LinkEvent::Refused(refusal(code))
}

fn done() -> LinkEvent {
    LinkEvent::Answered(Reply::Done)
}

fn is_ready(event: &LinkEvent) -> bool {
    matches!(event, LinkEvent::Answered(Reply::Status(status)) if status.remote() && status.servo_on())
}

#[test]
fn the_page_is_said_byte_by_byte() {
    let mut link = saying(&Command::Status, "greeting_always");
    assert_eq!(outputs(&mut link), [bytes("req_status", Kind::Ask)]);
    hear(&mut link, &["agree_status", "ans_status_ready"]);
    assert!(is_ready(&events(&mut link)[0]) && link.is_idle());
    link.say(at(3), &Command::HoldOn).unwrap();
    assert_eq!(outputs(&mut link), [bytes("req_hold", Kind::Set)]);
    hear(&mut link, &["agree_hold"]);
    assert_eq!(outputs(&mut link), [bytes("data_hold_on", Kind::Set)]);
    hear(&mut link, &["ans_ok"]);
    assert_eq!(events(&mut link), [done()]);
    assert_eq!(link.wake_at(), None);
}

/// All that the server says in a conversation of two commands, and what the client makes of it, cut as `cuts` says.
fn cut_conversation(cuts: &[usize]) -> (Vec<LinkEvent>, Vec<RobotOutput>) {
    let mut link = TcpLink::new(SETTINGS);
    let mut told = Vec::new();
    let mut sent = Vec::new();
    link.say(at(0), &Command::Status).unwrap();
    link.handle_connected(at(0));
    let says = [
        ["greeting_always", "agree_status", "ans_status_ready"]
            .map(host)
            .concat(),
        ["agree_hold", "ans_ok"].map(host).concat(),
    ];
    let mut cuts = cuts.iter().cycle();
    for (turn, said) in says.iter().enumerate() {
        if turn == 1 {
            link.say(at(0), &Command::HoldOn).unwrap();
        }
        let mut rest = said.as_slice();
        while !rest.is_empty() {
            let (segment, behind) = rest.split_at((*cuts.next().unwrap()).min(rest.len()));
            link.handle_bytes(at(0), segment);
            rest = behind;
        }
        sent.extend(outputs(&mut link));
        told.extend(events(&mut link));
    }
    (told, sent)
}

#[test]
fn an_exchange_may_be_cut_and_joined_anywhere() {
    let whole = cut_conversation(&[1000]);
    assert!(whole.0.len() == 2 && is_ready(&whole.0[0]) && whole.0[1] == done());
    for first in 1..80 {
        assert_eq!(cut_conversation(&[first, 1000]), whole, "cut at {first}");
    }
    for size in 1..20 {
        assert_eq!(cut_conversation(&[size]), whole, "segments of {size}");
    }
}

#[test]
fn without_keep_alive_every_command_has_its_own_connection() {
    let mut link = saying(&Command::Status, "greeting_once");
    hear(&mut link, &["agree_status", "ans_status_ready"]);
    assert!(is_ready(&events(&mut link)[0]));
    assert_eq!(outputs(&mut link), [bytes("req_status", Kind::Ask), RobotOutput::Close]);
    link.say(at(5), &Command::Status).unwrap();
    assert_eq!(outputs(&mut link), [RobotOutput::Connect]);
}

#[test]
fn a_count_of_commands_is_never_used_up() {
    let mut link = saying(&Command::Status, "greeting_three");
    hear(&mut link, &["agree_status", "ans_status_ready"]);
    link.say(at(5), &Command::Status).unwrap();
    hear(&mut link, &["agree_status", "ans_status_ready"]);
    let request = bytes("req_status", Kind::Ask);
    assert_eq!(outputs(&mut link), [request.clone(), request, RobotOutput::Close]);
    assert_eq!(events(&mut link).len(), 2);
}

#[test]
fn refusals_are_told_with_their_code() {
    let mut link = saying(&Command::HoldOn, "greeting_always");
    hear(&mut link, &["agree_hold", "ans_hold_refused_2100"]);
    assert_eq!(events(&mut link), [refused(0x2100)]);
    for (line, code) in [("2010\r\n", 0x2010), ("ERROR: HOLD is not successful\r\n", 0)] {
        link.say(at(3), &Command::HoldOn).unwrap();
        hear(&mut link, &["agree_hold"]);
        link.handle_bytes(at(3), line.as_bytes());
        assert_eq!(events(&mut link), [refused(code)]);
    }
}

#[test]
fn a_refused_request_is_a_refusal_and_the_end_of_the_connection() {
    let mut link = saying(&Command::HoldOn, "greeting_always");
    hear(&mut link, &["req_refused"]);
    let told = events(&mut link);
    assert!(
        matches!(told.as_slice(), [LinkEvent::Refused(_), LinkEvent::Lost { .. }]),
        "{told:?}"
    );
    assert_eq!(outputs(&mut link).last(), Some(&RobotOutput::Close));
    assert!(link.is_idle());
}

#[test]
fn a_connection_that_cannot_be_had_leaves_the_command_unanswered() {
    let lost = |told: &[LinkEvent]| matches!(told, [LinkEvent::Lost { .. }, LinkEvent::Unanswered]);
    let mut refused = saying(&Command::Status, "greeting_refused");
    assert!(lost(&events(&mut refused)));
    let mut closed = TcpLink::new(SETTINGS);
    closed.say(at(0), &Command::Status).unwrap();
    closed.handle_closed(at(1), "connection refused");
    assert!(lost(&events(&mut closed)) && closed.is_idle());
    let mut silent = TcpLink::new(SETTINGS);
    silent.say(at(0), &Command::Status).unwrap();
    assert_eq!(silent.wake_at(), Some(at(3000)));
    silent.handle_wake(at(2999));
    assert!(events(&mut silent).is_empty());
    silent.handle_wake(at(3000));
    assert!(lost(&events(&mut silent)));
    assert_eq!(outputs(&mut silent), [RobotOutput::Connect, RobotOutput::Close]);
    let mut mute = TcpLink::new(SETTINGS);
    mute.say(at(0), &Command::Status).unwrap();
    mute.handle_connected(at(10));
    mute.handle_wake(at(1010));
    assert!(lost(&events(&mut mute)) && mute.wake_at().is_none());
}

#[test]
fn silence_closes_the_connection_and_the_command_is_unanswered() {
    for heard in [&[][..], &["agree_hold"]] {
        let mut link = saying(&Command::HoldOn, "greeting_always");
        hear(&mut link, heard);
        outputs(&mut link);
        assert_eq!(link.wake_at(), Some(at(1002)));
        link.handle_wake(at(1002));
        assert_eq!(events(&mut link), [LinkEvent::Unanswered]);
        assert_eq!(outputs(&mut link), [RobotOutput::Close]);
        link.say(at(1003), &Command::HoldOn).unwrap();
        assert_eq!(outputs(&mut link), [RobotOutput::Connect]);
    }
}

#[test]
fn a_connection_lost_in_the_middle_leaves_the_command_unanswered() {
    let mut link = saying(&Command::StartJob, "greeting_always");
    link.handle_closed(at(3), "reset by peer");
    let told = events(&mut link);
    assert!(matches!(
        told.as_slice(),
        [LinkEvent::Lost { .. }, LinkEvent::Unanswered]
    ));
    link.handle_closed(at(4), "again");
    assert!(events(&mut link).is_empty());
}

#[test]
fn a_line_that_makes_no_sense_breaks_the_connection_off() {
    for (heard, line) in [
        (&["agree_status"][..], "194\r\n"),
        (&[], "OK: HOLD\r\n"),
        (&["agree_status"], "HTTP/1.1 400 Bad Request\r\n"),
    ] {
        let mut link = saying(&Command::Status, "greeting_always");
        hear(&mut link, heard);
        link.handle_bytes(at(3), line.as_bytes());
        let told = events(&mut link);
        let dropped = matches!(
            told.as_slice(),
            [LinkEvent::Dropped { malformed: true, .. }, LinkEvent::Unanswered]
        );
        assert!(dropped, "{line} {told:?}");
        assert_eq!(outputs(&mut link).last(), Some(&RobotOutput::Close));
    }
}

#[test]
fn a_line_without_an_end_is_not_gathered_for_ever() {
    let mut link = saying(&Command::Status, "greeting_always");
    link.handle_bytes(at(3), &vec![b'A'; lines::LINE_BYTES_MAX]);
    assert!(events(&mut link).is_empty());
    link.handle_bytes(at(3), b"AAAA");
    let told = events(&mut link);
    assert!(matches!(told[0], LinkEvent::Dropped { malformed: true, .. }));
    assert_eq!(told[1], LinkEvent::Unanswered);
    assert!(matches!(told[2], LinkEvent::Dropped { malformed: false, .. }));
}

#[test]
fn what_the_controller_is_stands_in_the_greeting() {
    let mut link = saying(&Command::SystemInformation, "greeting_simulated");
    let told = events(&mut link);
    let [LinkEvent::Answered(Reply::SystemInformation(system))] = told.as_slice() else {
        panic!("{told:?}")
    };
    assert!(system.simulated() && system.software == "SIMULATED 0.1.0");
    assert!(outputs(&mut link).is_empty());
    link.say(at(5), &Command::SystemInformation).unwrap();
    assert_eq!(events(&mut link).len(), 1);
}

#[test]
fn a_command_given_up_before_its_data_is_never_carried_out() {
    let mut link = saying(&Command::ServoOn, "greeting_always");
    assert_eq!(outputs(&mut link).len(), 1);
    link.give_up(at(3));
    assert!(link.is_idle());
    link.handle_bytes(at(3), b"OK: SVON\r\n");
    assert_eq!(outputs(&mut link), [RobotOutput::Close]);
    let told = events(&mut link);
    assert!(
        matches!(told.as_slice(), [LinkEvent::Dropped { malformed: false, .. }]),
        "{told:?}"
    );
}

#[test]
fn the_answer_to_a_command_given_up_is_dropped_and_a_hold_follows_on_the_same_connection() {
    let mut link = saying(&Command::Status, "greeting_always");
    link.give_up(at(3));
    assert!(!link.is_idle());
    assert_eq!(link.wake_at(), Some(at(203)));
    hear(&mut link, &["agree_status", "ans_status_ready"]);
    assert!(link.is_idle());
    assert!(matches!(
        events(&mut link).as_slice(),
        [LinkEvent::Dropped { malformed: false, .. }]
    ));
    outputs(&mut link);
    link.say(at(4), &Command::HoldOn).unwrap();
    assert_eq!(outputs(&mut link), [bytes("req_hold", Kind::Set)]);
}

#[test]
fn a_command_given_up_and_not_answered_costs_the_connection_but_no_event() {
    let mut link = saying(&Command::Status, "greeting_always");
    outputs(&mut link);
    link.give_up(at(3));
    link.handle_wake(at(203));
    assert!(link.is_idle() && events(&mut link).is_empty());
    assert_eq!(outputs(&mut link), [RobotOutput::Close]);
}

#[test]
fn a_hold_replaces_a_command_that_waits_for_the_connection() {
    let mut link = TcpLink::new(SETTINGS);
    link.say(at(0), &Command::Status).unwrap();
    link.give_up(at(1));
    link.say(at(1), &Command::HoldOn).unwrap();
    assert_eq!(outputs(&mut link), [RobotOutput::Connect]);
    link.handle_connected(at(2));
    hear(&mut link, &["greeting_always"]);
    let sent = outputs(&mut link);
    assert_eq!(sent, [bytes("connect", Kind::Ask), bytes("req_hold", Kind::Set)]);
}

#[test]
fn moves_keep_the_configuration_that_the_position_told() {
    let target = Command::Move(Move {
        base_from_tool: WirePose {
            position_um: [500_000, -250_000, 750_000],
            rotation_e4_deg: [1_800_000, 0, -900_000],
        },
        path: Path::Link,
        speed: Speed::Link(1250),
        tool: 1,
    });
    let mut link = saying(&Command::Position, "greeting_always");
    assert_eq!(outputs(&mut link), [bytes("req_position", Kind::Ask)]);
    link.handle_bytes(at(2), b"OK: RPOSC\r\n");
    assert_eq!(outputs(&mut link), [bytes("data_position", Kind::Ask)]);
    hear(&mut link, &["ans_position"]);
    link.say(at(3), &target).unwrap();
    outputs(&mut link);
    link.handle_bytes(at(3), b"OK: MOVJ\r\n");
    assert_eq!(outputs(&mut link), [bytes("data_move_link", Kind::Act)]);
    let mut fresh = TcpLink::new(SETTINGS);
    assert_eq!(fresh.say(at(0), &target), Err(Unsupported::UnknownForm));
    assert!(fresh.is_idle() && fresh.poll_output().is_none());
}

#[test]
fn a_line_that_nobody_asked_for_is_dropped_with_an_event() {
    let mut link = saying(&Command::Status, "greeting_always");
    hear(&mut link, &["agree_status", "ans_status_ready", "ans_status_ready"]);
    let told = events(&mut link);
    assert!(matches!(told[1], LinkEvent::Dropped { malformed: false, .. }));
    assert_eq!(told.len(), 2);
}

proptest! {
    /// Whatever a server sends: no panic, and each command ends exactly once.
    #[test]
    fn every_command_ends_once_whatever_comes(
        heard in prop::collection::vec(
            prop_oneof![
                Just(b"OK: HOLD\r\n".to_vec()),
                Just(b"0000\r\n".to_vec()),
                Just(b"OK: DX Information Server(1) Keep-Alive:2.\r\n".to_vec()),
                Just(b"NG: no\r\n".to_vec()),
                Just(b"ERROR: x(2010)\r\n".to_vec()),
                prop::collection::vec(any::<u8>(), 0..40),
            ],
            0..12,
        )
    ) {
        let mut link = TcpLink::new(SETTINGS);
        let mut now = 0;
        for _ in 0..3 {
            prop_assert!(link.is_idle());
            link.say(at(now), &Command::HoldOn).unwrap();
            link.handle_connected(at(now));
            for bytes in &heard {
                link.handle_bytes(at(now), bytes);
            }
            while let Some(due) = link.wake_at() {
                link.handle_wake(due);
                now = due.ns / 1_000_000;
            }
            let told = events(&mut link);
            let ends = told.iter().filter(|event| {
                matches!(event, LinkEvent::Answered(_) | LinkEvent::Refused(_) | LinkEvent::Unanswered)
            });
            prop_assert_eq!(ends.count(), 1);
            let acts = outputs(&mut link).into_iter().filter(|output| *output == bytes("data_hold_on", Kind::Set));
            prop_assert!(acts.count() <= 1);
        }
    }
}
