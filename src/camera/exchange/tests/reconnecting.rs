//! Lost connections.

use super::*;

impl Bench {
    /// Until the next attempt to connect.
    fn pass_until_connect(&mut self) {
        let count = self.connect_count;
        while self.connect_count == count {
            assert!(self.lost().is_none(), "{:?}", self.lost());
            let wake = self.exchange.wake_at().unwrap();
            self.ms = self.ms.max(wake.ns.div_ceil(1_000_000));
            self.exchange.handle_wake(self.now());
            self.pump();
        }
    }

    /// Back on a new connection, as far as a willing server brings it.
    fn come_back(&mut self) {
        self.pass_until_connect();
        self.connect();
        self.serve();
    }

    fn answer_fetch(&mut self, answer: &ServerMessage<'_>) {
        let fetched = |(_, message): &(u32, ClientMessage)| matches!(message, ClientMessage::Fetch { .. });
        let index = self.heard.iter().position(fetched).unwrap();
        let (request_id, _) = self.heard.remove(index);
        self.reply(request_id, answer);
    }
}

#[test]
fn a_lost_connection_is_opened_again_and_the_open_frame_is_fetched_not_taken_anew() {
    let mut bench = Bench::exposing();
    bench.events.clear();
    bench.lose_connection();
    assert!(matches!(
        &bench.events[..],
        [CameraEvent::Away { within_ms: 60_000, .. }]
    ));
    bench.come_back();
    assert_eq!(bench.take_said(), ["hello", "get-caps", "fetch"]);
    assert!(matches!(
        bench.events.last(),
        Some(CameraEvent::Back {
            restarted: false,
            fetched: Some(TRIGGER),
            ..
        })
    ));
    bench.events.clear();
    bench.answer_fetch(&fetch_ok(FetchState::InFlight, 90_000));
    bench.say(&exposure_done());
    assert!(matches!(&bench.events[..], [CameraEvent::ExposureDone { .. }]));
    bench.say_frame();
    assert!(matches!(bench.events.last(), Some(CameraEvent::Frame(capture)) if capture.trigger_id == TRIGGER));
    bench.serve();
    assert_eq!(bench.take_said(), ["configure", "arm"]);
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_stored_frame_tells_that_its_exposure_is_over() {
    let mut bench = Bench::exposing();
    bench.lose_connection();
    bench.come_back();
    bench.events.clear();
    bench.answer_fetch(&fetch_ok(FetchState::Stored, 0));
    assert!(matches!(&bench.events[..], [CameraEvent::ExposureDone { .. }]));
    bench.say_frame();
    assert!(matches!(&bench.events[1..], [CameraEvent::Frame(_)]));
}

#[test]
fn a_frame_that_breaks_off_is_fetched_whole_and_its_exposure_is_told_once() {
    let mut bench = Bench::exposing();
    bench.say(&exposure_done());
    bench.say_vector("frame_begin");
    bench.say_vector("frame_chunk_0");
    bench.events.clear();
    bench.lose_connection();
    bench.come_back();
    bench.answer_fetch(&fetch_ok(FetchState::Stored, 0));
    bench.say_frame();
    assert!(
        bench
            .events
            .iter()
            .all(|event| !matches!(event, CameraEvent::ExposureDone { .. }))
    );
    assert!(
        matches!(bench.events.last(), Some(CameraEvent::Frame(capture)) if capture.intensity.as_deref() == Some(&[200, 10]))
    );
}

#[test]
fn a_bridge_that_was_started_anew_has_lost_the_open_frame() {
    let mut bench = Bench::exposing();
    bench.lose_connection();
    bench.greeting.boot_id += 1;
    bench.come_back();
    assert_eq!(bench.take_said(), ["hello", "get-caps", "configure", "arm"]);
    let events = bench.take_events();
    assert!(events.iter().any(|event| matches!(
        event,
        CameraEvent::Back {
            restarted: true,
            fetched: None,
            ..
        }
    )));
    assert!(events.iter().any(
        |event| matches!(event, CameraEvent::Failed { trigger_id: TRIGGER, retryable: true, reason, .. } if reason.contains("anew"))
    ));
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_frame_that_the_store_does_not_have_is_lost() {
    let mut bench = Bench::exposing();
    bench.lose_connection();
    bench.come_back();
    bench.answer_fetch(&error(TRIGGER, code::STORE_MISS, 0));
    assert!(
        bench
            .events
            .iter()
            .any(|event| matches!(event, CameraEvent::Failed { retryable: true, .. }))
    );
    bench.serve();
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_fetched_frame_that_does_not_come_is_aborted() {
    let mut bench = Bench::exposing();
    bench.lose_connection();
    bench.come_back();
    bench.said.clear();
    bench.answer_fetch(&fetch_ok(FetchState::InFlight, 100_000));
    // 1.5 times 100 ms + 28 bytes at 20 MB/s + 2 s.
    bench.pass_alive_ms(2149);
    assert!(bench.take_said().is_empty());
    bench.pass_ms(1);
    assert_eq!(bench.take_said(), ["abort"]);
}

#[test]
fn pauses_between_attempts_double_to_five_seconds_within_a_quarter_and_end_in_time() {
    let mut bench = Bench::armed();
    bench.connect_times_ms.clear();
    bench.lose_connection();
    while bench.lost().is_none() {
        bench.pass_until_connect();
        bench.exchange.handle_closed(bench.now(), "refused");
        bench.pump();
    }
    let times = std::mem::take(&mut bench.connect_times_ms);
    let mut expected = 200.0;
    let mut last = 0;
    let (final_attempt, pauses) = times.split_last().unwrap();
    for &time in pauses {
        let share = (time - last) as f64 / expected;
        assert!((0.749..=1.251).contains(&share), "{times:?}");
        (last, expected) = (time, f64::min(expected * 2.0, 5000.0));
    }
    assert_eq!(*final_attempt, 60_000);
    assert!(matches!(bench.lost(), Some(Trouble::Unreachable(text)) if text == "refused; tried again for 60.0 s"));
}

#[test]
fn the_pauses_are_those_of_the_seed() {
    let times = |seed| {
        let mut bench = Bench::armed();
        bench.exchange.chance = Seed(seed).stream(Stream::Reconnecting);
        bench.connect_times_ms.clear();
        bench.lose_connection();
        for _ in 0..5 {
            bench.pass_until_connect();
            bench.exchange.handle_closed(bench.now(), "refused");
            bench.pump();
        }
        bench.connect_times_ms
    };
    assert_eq!(times(3), times(3));
    assert_ne!(times(3), times(4));
}

#[test]
fn a_silent_connection_is_pinged_then_opened_again() {
    let mut bench = Bench::armed();
    let heard_ms = bench.ms;
    bench.pass_until_connect();
    assert!((heard_ms + 5000..heard_ms + 5300).contains(&bench.ms), "{}", bench.ms);
    assert!(
        matches!(bench.events.last(), Some(CameraEvent::Away { reason, .. }) if reason == "nothing heard for 5000 ms")
    );
}

#[test]
fn a_corrupt_byte_ends_the_connection_and_nothing_of_it_is_believed() {
    let mut bench = Bench::exposing();
    bench.events.clear();
    let mut bytes = bench
        .writer
        .write_with(0x22, 0, 0, |payload| exposure_done().encode(payload));
    bytes[40] ^= 1;
    bench.receive(&bytes);
    assert_eq!(bench.take_said(), ["error", "bye"]);
    assert!(matches!(&bench.events[..], [CameraEvent::Away { .. }]));
    bench.come_back();
    assert_eq!(bench.take_said(), ["hello", "get-caps", "fetch"]);
}

#[test]
fn three_connections_that_break_during_a_view_are_enough() {
    let mut bench = Bench::exposing();
    for _ in 0..2 {
        bench.lose_connection();
        bench.come_back();
        bench.answer_fetch(&fetch_ok(FetchState::InFlight, 90_000));
    }
    assert!(bench.lost().is_none());
    bench.lose_connection();
    assert!(matches!(bench.lost(), Some(Trouble::Closed(text)) if text.contains("3 connections in a row")));
}

#[test]
fn a_connection_that_breaks_each_time_after_arming_is_given_up_in_the_same_time() {
    let mut bench = Bench::armed();
    while bench.lost().is_none() {
        bench.lose_connection();
        if bench.lost().is_none() {
            bench.come_back();
        }
    }
    assert!((60_000..66_000).contains(&bench.ms), "{}", bench.ms);
}

#[test]
fn after_an_outage_that_is_over_the_next_one_has_all_its_time() {
    let mut bench = Bench::armed();
    bench.lose_connection();
    bench.pass_ms(30_000);
    bench.come_back();
    bench.pass_alive_ms(10_000);
    bench.events.clear();
    bench.lose_connection();
    assert!(matches!(
        &bench.events[..],
        [CameraEvent::Away { within_ms: 60_000, .. }]
    ));
}

#[test]
fn another_camera_is_not_taken_for_the_one_before() {
    let mut bench = Bench::armed();
    bench.lose_connection();
    bench.greeting.serial = "SIM-0002".into();
    bench.come_back();
    let expected = Trouble::Another("serial SIM-0002 instead of SIM-0001".into());
    assert_eq!(bench.lost(), Some(&expected));
}

#[test]
fn a_connection_that_another_has_replaced_is_not_opened_again() {
    let mut bench = Bench::armed();
    bench.say(&ServerMessage::Bye(Bye {
        reason: Bye::REPLACED,
        text: "replaced".into(),
    }));
    assert!(matches!(bench.lost(), Some(Trouble::Replaced(_))));
}

#[test]
fn leaving_while_away_needs_no_goodbye() {
    let mut bench = Bench::armed();
    bench.lose_connection();
    bench.exchange.leave(bench.now());
    bench.pump();
    assert!(bench.take_said().is_empty());
    assert_eq!(bench.take_events().last(), Some(&CameraEvent::Left));
}
