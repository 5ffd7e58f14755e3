//! Runs, roles, lost connections and what FETCH brings.

use super::*;

/// Triggers, and loses the connection at once; the frame is rendered.
fn lost_while_exposing(trigger_id: u64) -> Bench {
    let mut bench = Bench::armed(&[]);
    bench.send(&trigger(trigger_id, 0));
    bench.render();
    bench.reconnect();
    bench.greet();
    bench
}

#[test]
fn a_second_controller_hears_who_has_the_camera_and_the_first_is_served() {
    let mut bench = Bench::armed(&[]);
    bench.device.handle_address(CLIENT, "127.0.0.1:4711".parse().unwrap());
    bench.connect();
    let answers = bench.send(&hello_as(1, 2));
    assert_eq!(names(&answers), [0x70, 0x7F]);
    let Message::Error(refused) = &answers[0] else { panic!() };
    assert_eq!(refused.code, 201);
    assert_eq!(refused.text.0, "\"test\" at 127.0.0.1:4711 has the camera");
    assert!(matches!(answers[1], Message::Bye(Bye { reason: 5, .. })));
    assert_eq!(bench.closed, [2]);
    bench.on = CLIENT;
    assert_eq!(bench.state(), 2);
}

#[test]
fn a_controller_of_the_same_run_takes_the_place_of_the_one_before() {
    let mut bench = Bench::armed(&[]);
    bench.connect();
    let greeting = bench.greet();
    assert_eq!((greeting.session_id, greeting.boot_id), (2, 9));
    assert!(matches!(
        bench.elsewhere[..],
        [(CLIENT, Message::Bye(Bye { reason: 6, .. }))]
    ));
    assert_eq!(bench.closed, [CLIENT]);
    assert_eq!(bench.state(), 1, "disarmed");
    let id = bench.device.bridge.config_id();
    assert_eq!(
        bench.ask(&arm(id)),
        Message::Armed(state_now(2)),
        "the settings stay in force"
    );
}

#[test]
fn three_observers_hear_status_and_events_and_a_fourth_is_refused() {
    let mut bench = Bench::new(&[]);
    bench.greet();
    for _ in 0..3 {
        bench.connect();
        let Message::HelloOk(greeting) = bench.ask(&hello_as(2, 0)) else {
            panic!()
        };
        assert_eq!(greeting.role, 2);
    }
    bench.connect();
    assert_eq!(names(&bench.send(&hello_as(2, 0))), [0x70, 0x7F]);
    assert_eq!(bench.closed, [5]);
    bench.on = CLIENT;
    bench.arm();
    let events: Vec<u64> = bench
        .elsewhere
        .iter()
        .filter(|(_, message)| matches!(message, Message::Event(Event { code: 6, .. })))
        .map(|(connection, _)| *connection)
        .collect();
    assert_eq!(events, [2, 3, 4]);
    bench.elsewhere.clear();
    assert_eq!(names(&bench.take(0)), WHOLE_FRAME);
    assert!(bench.elsewhere.iter().all(|(_, message)| is_sign_of_life(message)));
    let statuses = |connection| {
        let of = |(on, message): &&(u64, Message)| *on == connection && message.kind() == 0x51;
        bench.elsewhere.iter().filter(of).count()
    };
    assert_eq!([2, 3, 4].map(statuses), [2; 3]);
}

#[test]
fn an_observer_may_only_look() {
    let mut bench = Bench::new(&[]);
    bench.ask(&hello_as(2, 0));
    assert_eq!(names(&bench.send(&Message::GetCaps)), [0x04]);
    assert_eq!(names(&bench.send(&Message::GetStatus)), [0x51]);
    assert_eq!(names(&bench.send(&Message::Ping(1))), [0x61]);
    for message in [
        hello(),
        configure(&small_settings()),
        arm(1),
        Message::Disarm,
        trigger(0, 0),
        Message::Fetch(0),
        Message::Abort(0),
    ] {
        assert_eq!(code(&bench.ask(&message)), 207, "{message:?}");
    }
    let unknown = bench.client().frame(0x66, 99, 0, vec![1]);
    assert_eq!(
        code(&bench.send_bytes(&unknown)[0]),
        106,
        "its bytes come before its role"
    );
    assert!(bench.closed.is_empty());
    bench.connect();
    bench.greet();
}

#[test]
fn an_acquisition_outlives_its_connection_and_fetch_brings_it() {
    let mut bench = lost_while_exposing(7);
    assert_eq!(bench.state(), 3);
    bench.pass(50 * MS_NS);
    assert_eq!(bench.ask(&Message::Fetch(7)), fetched(7, 1, 158_000));
    assert_eq!(names(&bench.pass(S_NS)), WHOLE_FRAME[1..]);
    assert_eq!(bench.state(), 1, "not armed");
    assert_eq!(bench.jobs.len(), 1);
}

#[test]
fn exposure_done_comes_again_on_the_connection_that_fetches() {
    let mut bench = lost_while_exposing(7);
    assert_eq!(bench.pass(150 * MS_NS), [], "nobody has fetched yet");
    assert_eq!(bench.state(), 4);
    assert_eq!(names(&bench.send(&Message::Fetch(7))), [0x34, 0x22]);
    assert_eq!(names(&bench.pass(S_NS)), WHOLE_FRAME[2..]);
}

#[test]
fn without_fetch_the_frame_goes_to_the_store() {
    let mut bench = lost_while_exposing(7);
    assert_eq!(bench.pass(S_NS), []);
    assert_eq!(bench.state(), 1);
    let messages = bench.send(&Message::Fetch(7));
    assert_eq!(messages[0], fetched(7, 2, 0));
    assert_eq!(names(&messages), [0x34, 0x30, 0x31]);
    assert_eq!(names(&bench.pass(2 * S_NS)), [0x31, 0x31, 0x32]);
}

#[test]
fn a_frame_cut_off_by_the_end_of_its_connection_is_stored_whole() {
    let mut bench = Bench::armed(&[]);
    let whole = bench.take(6);
    bench.send(&trigger(7, 0));
    bench.render();
    let begin_ns = bench.now_ns;
    assert_eq!(names(&bench.pass(begin_ns + 208 * MS_NS)), [0x22, 0x30, 0x31]);
    bench.reconnect();
    bench.greet();
    assert_eq!(bench.state(), 1);
    let mut again = bench.send(&Message::Fetch(7));
    again.extend(bench.pass(bench.now_ns + S_NS));
    assert_eq!(data(&again), data(&whole));
}

#[test]
fn a_stored_frame_comes_with_the_same_bytes_and_frame_id_as_often_as_it_is_asked_for() {
    let mut bench = Bench::armed(&[]);
    let first = bench.take(7);
    for _ in 0..2 {
        let mut again = bench.send(&Message::Fetch(7));
        again.extend(bench.pass(bench.now_ns + S_NS));
        let payloads = |messages: &[Message]| messages.iter().map(Message::to_payload).collect::<Vec<_>>();
        assert!(payloads(&again[1..]) == payloads(&first[2..]));
    }
    assert_eq!(bench.status().frame_count, 1, "a frame fetched is no new frame");
}

#[test]
fn the_store_keeps_four_frames_of_the_run() {
    let mut bench = Bench::armed(&[]);
    for id in 0..5 {
        assert_eq!(names(&bench.take(id)), WHOLE_FRAME);
    }
    let miss = bench.ask(&Message::Fetch(0));
    assert_eq!(error(&miss), (602, 0, 0, 0));
    assert_eq!(names(&bench.send(&Message::Fetch(1)))[..1], [0x34]);
    assert_eq!(code(&bench.ask(&Message::Fetch(2))), 204, "another frame is on its way");
    bench.pass(bench.now_ns + S_NS);
    assert_eq!(code(&bench.ask(&Message::Fetch(99))), 602);
    bench.send(&trigger(9, 0));
    bench.send(&Message::Abort(9));
    assert_eq!(code(&bench.ask(&Message::Fetch(9))), 602, "it ended without a frame");
}

#[test]
fn another_run_starts_afresh_and_the_same_run_does_not() {
    let mut bench = lost_while_exposing(7);
    bench.pass(S_NS);
    bench.arm();
    let repeated = |bench: &mut Bench| match bench.ask(&bench.trigger(7)) {
        Message::TriggerOk(TriggerOk { repeated, .. }) => repeated,
        other => panic!("{other:?}"),
    };
    assert_eq!(repeated(&mut bench), 2);
    bench.send(&bench.trigger(8));
    bench.reconnect();
    assert!(matches!(bench.ask(&hello_as(1, 2)), Message::HelloOk(_)));
    assert_eq!(bench.state(), 1, "what was in flight is aborted");
    assert_eq!(code(&bench.ask(&Message::Fetch(7))), 602);
    bench.arm();
    assert_eq!(repeated(&mut bench), 0);
}

#[test]
fn a_thousand_trigger_ids_are_remembered() {
    let mut bench = Bench::armed(&[]);
    for id in 0..1100 {
        bench.send(&trigger(id, 0));
        bench.send(&Message::Abort(id));
    }
    for id in 76..1100 {
        let Message::TriggerOk(reply) = bench.ask(&trigger(id, 0)) else {
            panic!()
        };
        assert_eq!(reply.repeated, 2);
    }
}

#[test]
fn frames_are_never_interleaved() {
    let mut bench = Bench::armed(&[]);
    bench.take(7);
    bench.send(&trigger(8, 0));
    bench.render();
    let due_ns = bench.now_ns + 208 * MS_NS;
    bench.pass(due_ns - 1);
    let mut messages = bench.send(&Message::Fetch(7));
    messages.extend(bench.pass(bench.now_ns + S_NS));
    assert_eq!(
        names(&messages),
        [0x34, 0x30, 0x31, 0x31, 0x31, 0x32, 0x30, 0x31, 0x31, 0x31, 0x32]
    );
}

#[test]
fn an_abort_stops_a_stored_frame_which_stays_in_the_store() {
    let mut bench = Bench::armed(&[]);
    bench.take(7);
    bench.send(&Message::Fetch(7));
    let answers = bench.send(&Message::Abort(7));
    assert_eq!(names(&answers), [0x41, 0x32]);
    let Message::FrameEnd(end) = &answers[1] else { panic!() };
    assert_eq!((end.tail.status, end.components[0].byte_count), (1, 38_400));
    assert_eq!(bench.pass(bench.now_ns + S_NS), []);
    assert_eq!(names(&bench.send(&Message::Fetch(7)))[..2], [0x34, 0x30]);
}

#[test]
fn an_orphan_can_be_aborted_by_the_one_who_comes_back() {
    let mut bench = lost_while_exposing(7);
    assert_eq!(names(&bench.send(&Message::Abort(NO_TRIGGER))), [0x41]);
    assert_eq!(bench.state(), 1);
    assert_eq!(code(&bench.ask(&Message::Fetch(7))), 602);
}
