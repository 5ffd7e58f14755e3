//! Greeting, capabilities, settings, arming; and other settings later.

use super::*;

#[test]
fn the_opening_greets_with_the_run_and_ends_armed() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    bench.connect();
    assert!(matches!(&bench.heard[0], (1, ClientMessage::Hello(hello)) if hello.run_id == RUN_ID && hello.role == 1));
    bench.serve();
    assert_eq!(bench.take_said(), ["hello", "get-caps", "configure", "arm"]);
    assert!(matches!(&bench.events[..], [CameraEvent::Ready(_)]));
}

#[test]
fn matching_scores_are_asked_for_where_they_are_offered() {
    let confidence = ComponentKind::Confidence.bit();
    for offered in [0, confidence] {
        let mut bench = Bench::new(vec![PAGE_SETTINGS]);
        bench.caps.components = bench.caps.components & !confidence | offered;
        bench.connect();
        bench.serve();
        assert!(bench.exchange.is_armed());
        let [CameraEvent::Ready(opened)] = &bench.events[..] else {
            panic!("{:?}", bench.events)
        };
        let in_force = opened.configured.settings.components;
        assert_eq!(in_force, PAGE_SETTINGS.components | offered);
    }
}

#[test]
fn an_echo_that_differs_is_trouble_named_by_its_setting() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    bench.connect();
    for _ in 0..2 {
        let (request_id, message) = bench.heard.remove(0);
        let answer = match message {
            ClientMessage::Hello(_) => ServerMessage::HelloOk(bench.greeting.clone()),
            _ => ServerMessage::Caps(bench.caps.clone()),
        };
        bench.reply(request_id, &answer);
    }
    let (request_id, _) = bench.heard.remove(0);
    let configured = ServerMessage::Configured(Configured {
        config_id: 1,
        predicted_exposure_us: 0,
        predicted_total_us: 0,
        frame_bytes: 28,
        settings: CameraSettings {
            exposure_us: 999,
            ..PAGE_SETTINGS
        },
    });
    bench.reply(request_id, &configured);
    let expected = Trouble::Settings("exposure_us: asked for 1000, in force 999".into());
    assert_eq!(bench.lost(), Some(&expected));
    assert_eq!(bench.take_said().last(), Some(&"bye"));
}

#[test]
fn what_the_camera_cannot_do_is_said_before_anything_is_configured() {
    for (spoil, expected) in [
        (
            (|settings: &mut CameraSettings| settings.exposure_us = 50_001) as fn(&mut CameraSettings),
            "camera.exposure_us is 50001 us, but this camera allows 10 to 50000 us",
        ),
        (
            |settings| settings.hdr_us = [9, 0],
            "camera.hdr_low_us is 9 us, but this camera allows 10 to 50000 us",
        ),
        (
            |settings| settings.image_count = 61,
            "camera.image_count is 61, but this camera allows 12 to 60",
        ),
        (
            |settings| settings.led_percent = 101,
            "camera.led_percent is 101 %, but this camera allows 1 to 100 %",
        ),
        (
            |settings| settings.compression = 4,
            "camera.compression is number 4, but this camera allows 0, 1, 2, 3",
        ),
        (
            |settings| settings.components = 0b11101,
            "components 0, 2, 3, 4 are needed, but this camera offers 0, 2, 4",
        ),
        (
            |settings| {
                settings.binning = false;
                settings.roi_px = [80, 4, 1368, 0, 1368, 0];
            },
            "camera.roi_px is 80 x 4 px at 1368, 0, but this camera allows 80 x 4 to 1440 x 1080 px in steps of 8 x 4 px",
        ),
    ] {
        let mut spoilt = PAGE_SETTINGS;
        spoil(&mut spoilt);
        // Settings that only a later view asks for count as well.
        let mut bench = Bench::new(vec![PAGE_SETTINGS, spoilt]);
        bench.connect();
        bench.serve();
        assert_eq!(bench.lost(), Some(&Trouble::Settings(expected.into())));
        assert_eq!(bench.take_said(), ["hello", "get-caps", "bye"]);
    }
}

#[test]
fn fewer_passes_than_asked_for_are_trouble() {
    let mut bench = Bench::new(vec![CameraSettings {
        hdr_us: [500, 2000],
        ..PAGE_SETTINGS
    }]);
    bench.caps.hdr_slot_count = 1;
    bench.connect();
    bench.serve();
    assert!(matches!(bench.lost(), Some(Trouble::Settings(text)) if text.contains("2 more passes")));
}

#[test]
fn other_settings_are_brought_into_force_between_two_acquisitions() {
    let mut bench = Bench::exposing();
    let other = CameraSettings {
        exposure_us: 4000,
        ..PAGE_SETTINGS
    };
    bench.say(&exposure_done());
    bench.exchange.want(bench.now(), other);
    bench.pump();
    assert!(bench.take_said().is_empty(), "the frame is still to come");
    bench.say_frame();
    bench.serve();
    assert_eq!(bench.take_said(), ["disarm", "configure", "arm"]);
    assert!(bench.exchange.is_armed());
    bench.exchange.want(bench.now(), PAGE_SETTINGS);
    assert!(!bench.exchange.is_armed());
    bench.pump();
    bench.serve();
    assert!(bench.exchange.is_armed());
    assert!(bench.lost().is_none());
}

#[test]
fn settings_wanted_while_others_are_asked_for_come_into_force_after_them() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    bench.connect();
    let other = CameraSettings {
        led_percent: 30,
        ..PAGE_SETTINGS
    };
    while !bench.said.contains(&"configure") {
        let (request_id, message) = bench.heard.remove(0);
        let answer = match message {
            ClientMessage::Hello(_) => ServerMessage::HelloOk(bench.greeting.clone()),
            _ => ServerMessage::Caps(bench.caps.clone()),
        };
        bench.reply(request_id, &answer);
    }
    bench.exchange.want(bench.now(), other);
    bench.serve();
    assert_eq!(
        bench.take_said(),
        ["hello", "get-caps", "configure", "configure", "arm"]
    );
    assert!(bench.exchange.is_armed());
}

#[test]
fn a_camera_that_another_run_holds_is_asked_again_for_as_long_as_a_dead_connection_lives() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    while bench.lost().is_none() {
        bench.connect();
        let (request_id, _) = bench.heard.remove(0);
        let refusal = error(TriggerId(TRIGGER_ALL), code::CONTROLLER_BUSY, 0);
        bench.reply(request_id, &refusal);
        let count = bench.connect_count;
        while bench.connect_count == count && bench.lost().is_none() {
            bench.pass_ms(100);
        }
        assert!(bench.ms <= 6100);
    }
    assert!(matches!(bench.lost(), Some(Trouble::Refused(error)) if error.code == 201));
    assert!(
        bench.connect_count > 3 && bench.ms >= 6000,
        "{} {}",
        bench.connect_count,
        bench.ms
    );
}

#[test]
fn after_a_busy_start_the_first_lost_connection_has_all_its_time() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    bench.connect();
    let (request_id, _) = bench.heard.remove(0);
    let refusal = error(TriggerId(TRIGGER_ALL), code::CONTROLLER_BUSY, 0);
    bench.reply(request_id, &refusal);
    while bench.connect_count == 1 {
        bench.pass_ms(100);
    }
    bench.connect();
    bench.serve();
    assert!(bench.exchange.is_armed());
    bench.pass_alive_ms(4000);
    bench.take_events();
    bench.lose_connection();
    assert!(
        matches!(&bench.events[..], [CameraEvent::Away { within_ms: 60_000, .. }]),
        "{:?}",
        bench.events
    );
}

#[test]
fn where_nothing_listens_at_first_is_trouble_at_once() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    bench.exchange.handle_closed(bench.now(), "refused");
    bench.pump();
    assert_eq!(bench.lost(), Some(&Trouble::Unreachable("refused".into())));
    assert!(bench.exchange.is_over());
}

#[test]
fn a_server_in_an_unexpected_state_is_brought_back_but_not_for_ever() {
    let mut bench = Bench::new(vec![PAGE_SETTINGS]);
    bench.connect();
    let mut refused = 0;
    while bench.lost().is_none() {
        if let Some(index) = bench
            .heard
            .iter()
            .position(|(_, message)| matches!(message, ClientMessage::Configure(_)))
        {
            let (request_id, _) = bench.heard.remove(index);
            refused += 1;
            let ServerMessage::Error(refusal) = error(TriggerId(TRIGGER_ALL), code::WRONG_STATE, 0) else {
                unreachable!()
            };
            let retryable = false;
            bench.reply(request_id, &ServerMessage::Error(CameraError { retryable, ..refusal }));
        } else {
            // One answer at a time, so that the CONFIGURE is refused.
            let (request_id, message) = bench.heard.remove(0);
            let state = CameraState::Idle;
            let answer = match message {
                ClientMessage::Hello(_) => ServerMessage::HelloOk(bench.greeting.clone()),
                ClientMessage::GetCaps => ServerMessage::Caps(bench.caps.clone()),
                ClientMessage::Disarm => ServerMessage::Disarmed { state },
                ClientMessage::Abort { trigger_id } => ServerMessage::Aborted(Aborted {
                    trigger_id,
                    phase: AcquisitionPhase::None,
                }),
                other => panic!("{other:?}"),
            };
            bench.reply(request_id, &answer);
        }
    }
    assert_eq!(refused, 3);
    let said = bench.take_said();
    assert_eq!(said[2..6], ["configure", "abort", "disarm", "configure"]);
    assert_eq!(said.last(), Some(&"bye"));
}
