//! What each request gets in each state: the table of the page.

use super::*;

/// A camera in this state of the page, with settings in force where it has any.
fn in_state(state: u8) -> Bench {
    let fault = match state {
        0 => "camera-lost=35@0",
        6 => "camera-broken@0",
        _ => "camera-reset=35@0",
    };
    let faults: &[&str] = if matches!(state, 0 | 6 | 7) { &[fault] } else { &[] };
    let mut bench = Bench::armed(faults);
    match state {
        1 => drop(bench.ask(&Message::Disarm)),
        2 => (),
        _ => {
            bench.send(&trigger(0, 0));
            let until_ns = match state {
                3 => 10 * MS_NS,
                4 => 150 * MS_NS,
                _ => 250 * MS_NS,
            };
            bench.pass(until_ns);
            if state == 5 {
                bench.render();
                bench.receive();
            }
        }
    }
    assert_eq!(bench.state(), state);
    bench
}

/// Kind of the answer, or the code of the ERROR.
fn answer(state: u8, request: &Message) -> u16 {
    let mut bench = in_state(state);
    let answers = bench.send(request);
    assert!(bench.closed.is_empty(), "the connection stays open");
    match &answers[0] {
        Message::Error(error) => error.code,
        other => other.kind(),
    }
}

fn answers(request: &Message) -> [u16; 8] {
    [0, 1, 2, 3, 4, 5, 6, 7].map(|state| answer(state, request))
}

#[test]
fn what_only_asks_is_answered_in_every_state() {
    assert_eq!(answers(&Message::GetCaps), [0x04; 8]);
    assert_eq!(answers(&Message::GetStatus), [0x51; 8]);
    assert_eq!(answers(&Message::Ping(1)), [0x61; 8]);
    assert_eq!(answers(&Message::Abort(NO_TRIGGER)), [0x41; 8]);
    assert_eq!(answers(&hello()), [203; 8]);
    assert_eq!(answers(&Message::Fetch(99)), [602, 602, 602, 602, 602, 204, 602, 602]);
}

#[test]
fn settings_change_in_idle_only() {
    let request = configure(&small_settings());
    assert_eq!(answers(&request), [501, 0x11, 203, 203, 203, 203, 500, 504]);
    let mut bad = small_settings();
    bad.exposure_us = 1;
    assert_eq!(
        answers(&configure(&bad)),
        [501, 301, 203, 203, 203, 203, 500, 504],
        "the state comes before the values"
    );
    let damaged = Message::Configure(Rest(vec![1, 2, 3]));
    assert_eq!(answers(&damaged), [108; 8], "and the bytes before the state");
}

#[test]
fn arming_needs_idle_and_disarming_nothing_in_flight() {
    assert_eq!(answers(&arm(1)), [501, 0x14, 203, 203, 203, 203, 500, 504]);
    assert_eq!(answers(&arm(9)), [501, 206, 203, 203, 203, 203, 500, 504]);
    let disarmed = 0x15;
    assert_eq!(
        answers(&Message::Disarm),
        [disarmed, disarmed, disarmed, 203, 203, 203, disarmed, disarmed]
    );
}

#[test]
fn a_new_trigger_needs_armed_and_an_old_one_nothing() {
    assert_eq!(answers(&trigger(5, 0)), [501, 202, 0x21, 204, 204, 204, 500, 504]);
    let repeated = |state: u8| match in_state(state).ask(&trigger(0, 0)) {
        Message::TriggerOk(reply) => reply.repeated,
        other => panic!("{other:?}"),
    };
    assert_eq!([0, 3, 4, 5, 6, 7].map(repeated), [2, 1, 1, 1, 2, 2]);
}

#[test]
fn a_reset_is_announced_ends_what_is_in_flight_and_takes_the_settings() {
    let mut bench = Bench::armed(&["camera-reset=35@0"]);
    bench.connect();
    bench.ask(&hello_as(2, 0));
    bench.on = CLIENT;
    let messages = bench.take(0);
    assert_eq!(names(&messages), [0x21, 0x52, 0x70]);
    let Message::Event(event) = &messages[1] else { panic!() };
    assert_eq!((event.code, event.duration_ms), (3, 35_000));
    let Message::Error(ended) = &messages[2] else { panic!() };
    assert_eq!(
        (ended.code, ended.trigger_id, ended.phase, ended.retry_after_ms),
        (504, 0, 2, 35_000)
    );
    let refused = bench.ask(&configure(&small_settings()));
    let Message::Error(refused) = refused else { panic!() };
    assert!((30_000..35_000).contains(&refused.retry_after_ms));
    let back = bench.pass_on(35 * S_NS);
    assert!(matches!(back[..], [Message::Event(Event { code: 4, .. })]), "{back:?}");
    assert_eq!(bench.state(), 1);
    assert_eq!(code(&bench.ask(&arm(1))), 206, "no settings are in force");
    bench.arm();
    assert_eq!(names(&bench.take(1)), WHOLE_FRAME);
    let seen_by_observer: Vec<u16> = bench
        .elsewhere
        .iter()
        .filter_map(|(_, message)| match message {
            Message::Event(event) => Some(event.code),
            _ => None,
        })
        .collect();
    assert_eq!(seen_by_observer, [3, 4, 6]);
}

#[test]
fn a_lost_device_does_not_say_how_long_it_stays_away() {
    let mut bench = Bench::armed(&["camera-lost=2@0:transfer"]);
    let messages = bench.take(0);
    assert_eq!(names(&messages), [0x21, 0x22, 0x30, 0x31, 0x52, 0x70, 0x32]);
    let Message::Event(event) = &messages[4] else { panic!() };
    assert_eq!((event.code, event.duration_ms), (3, 0));
    assert_eq!(error(&messages[5]), (501, 0, 4, 1));
    let Message::FrameEnd(end) = &messages[6] else { panic!() };
    assert_eq!(end.tail.status, 2);
    assert_eq!(bench.state(), 0);
}

#[test]
fn frames_and_trigger_ids_outlive_a_reset() {
    let mut bench = Bench::armed(&["camera-reset=3@1"]);
    bench.take(1 << 8);
    bench.take(1 << 16);
    assert_eq!(bench.state(), 7);
    let mut again = bench.send(&Message::Fetch(1 << 8));
    again.extend(bench.pass(bench.now_ns + 100 * MS_NS));
    assert_eq!(names(&again), [0x34, 0x30, 0x31, 0x31, 0x31, 0x32]);
    let Message::TriggerOk(reply) = bench.ask(&trigger(1 << 16, 0)) else {
        panic!()
    };
    assert_eq!((reply.repeated, reply.predicted_total_us), (2, 0));
}
