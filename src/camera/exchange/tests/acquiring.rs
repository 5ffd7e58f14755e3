//! One acquisition on one connection: its limits, its failures, its frame.

use super::*;

fn failure(events: &[CameraEvent]) -> Option<(&str, bool)> {
    events.iter().find_map(|event| match event {
        CameraEvent::Failed { reason, retryable, .. } => Some((reason.as_str(), *retryable)),
        _ => None,
    })
}

#[test]
fn a_whole_frame_of_the_page_goes_through() {
    let mut bench = Bench::exposing();
    bench.events.clear();
    bench.say(&exposure_done());
    bench.say_vector("status");
    bench.say_frame();
    let events = bench.take_events();
    assert!(matches!(events[0], CameraEvent::ExposureDone { trigger_id, .. } if trigger_id == TRIGGER));
    assert!(matches!(events[1], CameraEvent::Status(_)));
    assert!(matches!(&events[2], CameraEvent::Frame(capture) if capture.trigger_id == TRIGGER));
    assert!(bench.exchange.is_armed());
}

#[test]
fn the_end_of_an_exposure_is_told_in_the_time_of_the_run() {
    let mut bench = Bench::armed();
    bench.pass_ms(0);
    bench.serve();
    assert_eq!(bench.exchange.clock().unwrap().offset_ns, CLOCK_AHEAD_NS as i64);
    bench.exchange.trigger(bench.now(), TRIGGER);
    bench.pump();
    let (request_id, _) = bench.heard.pop().unwrap();
    bench.reply(request_id, &trigger_ok(Repeated::New));
    bench.events.clear();
    bench.say(&exposure_done());
    let ended = Some(Stamp { ns: 2_000_000 });
    assert_eq!(
        bench.take_events(),
        [CameraEvent::ExposureDone {
            trigger_id: TRIGGER,
            ended
        }]
    );
}

#[test]
fn a_late_acquisition_is_aborted_and_everything_is_set_anew() {
    for (exposed, late_ms, expected) in [
        // 1.5 times 108 ms + 1 s; 1.5 times 208 ms + 28 bytes at 20 MB/s + 2 s.
        (false, 1162, "the exposure did not end in time"),
        (true, 2312, "the frame did not come in time"),
    ] {
        let mut bench = Bench::exposing();
        if exposed {
            bench.say(&exposure_done());
        }
        bench.pass_alive_ms(late_ms - 1);
        assert_eq!(failure(&bench.events), None);
        bench.pass_ms(1);
        assert_eq!(failure(&bench.events), Some((expected, true)));
        assert!(!bench.exchange.is_armed());
        bench.serve();
        assert_eq!(bench.take_said(), ["abort", "disarm", "configure", "arm"]);
        assert!(bench.exchange.is_armed());
    }
}

#[test]
fn a_trigger_that_is_not_acknowledged_is_aborted() {
    let mut bench = Bench::armed();
    bench.exchange.trigger(bench.now(), TRIGGER);
    bench.pass_alive_ms(1500);
    assert_eq!(
        failure(&bench.events),
        Some(("the trigger was not acknowledged in time", true))
    );
}

#[test]
fn an_abort_without_a_reply_leads_to_a_new_connection() {
    let mut bench = Bench::exposing();
    bench.pass_alive_ms(1500);
    bench.heard.clear();
    bench.said.clear();
    let connect_count = bench.connect_count;
    for _ in 0..12 {
        bench.pass_ms(500);
        bench.say(&status(CameraState::Exposing));
        if bench.connect_count > connect_count {
            return;
        }
    }
    // The abort was served above: provoke one that is not.
    let mut bench = Bench::exposing();
    bench.pass_ms(1162);
    for _ in 0..12 {
        bench.pass_ms(500);
        bench.say(&status(CameraState::Exposing));
    }
    assert!(bench.connect_count > 1, "{:?}", bench.events);
}

#[test]
fn announced_pauses_move_the_limits_by_a_minute_at_most() {
    for (announced_ms, moved_ms) in [(700, 700), (90_000, 60_000)] {
        let mut bench = Bench::exposing();
        bench.say(&device_event(DeviceEvent::COOLDOWN_PAUSE, announced_ms));
        bench.pass_alive_ms(1161 + moved_ms);
        assert_eq!(failure(&bench.events), None);
        bench.pass_ms(1);
        assert!(failure(&bench.events).is_some());
    }
}

#[test]
fn a_trigger_that_the_camera_has_seen_before_gives_no_frame() {
    let mut bench = Bench::armed();
    bench.exchange.trigger(bench.now(), TRIGGER);
    bench.pump();
    let (request_id, _) = bench.heard.pop().unwrap();
    bench.reply(request_id, &trigger_ok(Repeated::Done));
    assert!(matches!(failure(&bench.events), Some((_, true))));
    bench.serve();
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_frame_with_a_wrong_crc_fails_and_the_next_is_taken() {
    let mut bench = Bench::exposing();
    bench.say(&exposure_done());
    for name in &FRAME[..4] {
        bench.say_vector(name);
    }
    let end = a3dp("frame_end");
    let mut end = match ServerMessage::decode(0x32, &end[HEADER_BYTES..]).unwrap() {
        Some(ServerMessage::FrameEnd(end)) => end,
        other => panic!("{other:?}"),
    };
    end.components[0].crc ^= 1;
    bench.say(&ServerMessage::FrameEnd(end));
    assert_eq!(
        failure(&bench.events),
        Some(("the CRC of component 0 does not fit", true))
    );
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_frame_larger_than_the_settings_announce_is_refused_before_memory_is_taken() {
    let mut bench = Bench::exposing();
    bench.say(&exposure_done());
    let begin = FrameBegin {
        width_px: 3,
        components: vector_frame_begin()
            .components
            .into_iter()
            .map(|component| crate::camera::Component {
                byte_count: component.byte_count / 2 * 3,
                ..component
            })
            .collect(),
        ..vector_frame_begin()
    };
    bench.say(&ServerMessage::FrameBegin(Box::new(begin)));
    assert_eq!(bench.take_said(), ["error", "bye"]);
    assert!(matches!(
        bench.events.last(),
        Some(CameraEvent::Away { reason, .. }) if reason == "42 bytes announced where 28 are allowed"
    ));
}

#[test]
fn a_frame_of_an_older_trigger_is_noted_and_left() {
    let mut bench = Bench::exposing();
    bench.say(&exposure_done());
    bench.events.clear();
    let begin = FrameBegin {
        trigger_id: TriggerId(4 << 16),
        ..vector_frame_begin()
    };
    bench.say(&ServerMessage::FrameBegin(Box::new(begin)));
    assert!(matches!(&bench.take_events()[..], [CameraEvent::Note(_)]));
    bench.say_frame();
    assert!(matches!(&bench.take_events()[..], [CameraEvent::Frame(_)]));
    // The same frame once more changes nothing.
    bench.say_frame();
    assert!(
        bench
            .take_events()
            .iter()
            .all(|event| matches!(event, CameraEvent::Note(_)))
    );
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_cold_frame_is_told() {
    let mut bench = Bench::exposing();
    bench.say(&exposure_done());
    let mut begin = vector_frame_begin();
    begin.flags.warm_up_incomplete = true;
    bench.say(&ServerMessage::FrameBegin(Box::new(begin)));
    assert_eq!(bench.events.last(), Some(&CameraEvent::Cold { trigger_id: TRIGGER }));
}

#[test]
fn leaving_in_mid_exposure_aborts_disarms_and_says_goodbye() {
    let mut bench = Bench::exposing();
    bench.exchange.leave(bench.now());
    bench.pump();
    assert_eq!(bench.take_said(), ["abort", "disarm", "bye"]);
    bench.say(&exposure_done());
    bench.lose_connection();
    assert_eq!(bench.take_events().last(), Some(&CameraEvent::Left));
    assert!(bench.exchange.is_over());
}
