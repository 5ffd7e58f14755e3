//! Each fault, at its phases.

use super::*;

/// A trigger that meets this fault, on a connection that was armed; what came, and the bench after it.
fn met(fault: &str) -> (Vec<Message>, Bench) {
    let mut bench = Bench::armed(&[fault]);
    let messages = bench.take(0);
    (messages, bench)
}

/// Types of what came.
fn came(fault: &str) -> Vec<u16> {
    let (messages, bench) = met(fault);
    assert_eq!(bench.device.met_faults().len(), 1, "{fault}");
    names(&messages)
}

#[test]
fn a_connection_can_end_at_every_phase_and_the_acquisition_lives_on() {
    for (phase, kinds) in [
        ("acknowledge", &[][..]),
        ("exposure", &[0x21]),
        ("reconstruction", &[0x21, 0x22]),
        ("transfer", &[0x21, 0x22, 0x30, 0x31]),
    ] {
        let (messages, mut bench) = met(&format!("camera-gone@0:{phase}"));
        assert_eq!(names(&messages), kinds, "{phase}");
        assert_eq!(bench.closed, [CLIENT]);
        bench.reconnect();
        assert_eq!(bench.greet().boot_id, 9);
        let mut fetched = bench.send(&Message::Fetch(0));
        fetched.extend(bench.pass(bench.now_ns + S_NS));
        assert_eq!(names(&fetched), [0x34, 0x30, 0x31, 0x31, 0x31, 0x32], "{phase}");
        assert_eq!(bench.jobs.len(), 1);
    }
    let (messages, mut bench) = met("camera-gone@0:request");
    assert_eq!((names(&messages), bench.jobs.len()), (vec![], 0));
    bench.reconnect();
    bench.greet();
    assert_eq!(code(&bench.ask(&Message::Fetch(0))), 602, "it was never triggered");
}

#[test]
fn in_the_transfer_the_connection_ends_in_the_middle_of_a_chunk() {
    let mut bench = Bench::armed(&["camera-gone@0"]);
    let mut bytes_came = Vec::new();
    bench.send(&trigger(0, 0));
    bench.render();
    while let Some(wake_ns) = bench.device.wake_at().filter(|_| bench.closed.is_empty()) {
        bench.now_ns = wake_ns;
        bench.device.handle_wake(wake_ns);
        while let Some(output) = bench.device.poll_output() {
            match output {
                DeviceOutput::Bytes { bytes, .. } => bytes_came.push(bytes.len()),
                DeviceOutput::Close { connection } => bench.closed.push(connection),
                _ => (),
            }
        }
    }
    assert_eq!(
        bytes_came[bytes_came.len() - 2..],
        [32 + 24 + 38_400, (32 + 24 + 3_200) / 2]
    );
}

#[test]
fn a_fault_happens_once_and_only_at_its_view_and_attempt() {
    let mut bench = Bench::armed(&["camera-error=403@2.1"]);
    assert_eq!(names(&bench.take(1 << 16)), WHOLE_FRAME);
    assert_eq!(names(&bench.take(2 << 16)), WHOLE_FRAME);
    assert_eq!(names(&bench.take(2 << 16 | 1)), [0x21, 0x22, 0x70]);
    assert_eq!(names(&bench.take(2 << 16 | 2)), WHOLE_FRAME);
    let met: Vec<String> = bench.device.met_faults().iter().map(ToString::to_string).collect();
    assert_eq!(met, ["camera-error=403@2.1"]);
}

#[test]
fn a_silent_camera_neither_reads_nor_sends_nor_closes_until_the_run_comes_back() {
    for (phase, kinds) in [
        ("request", &[][..]),
        ("acknowledge", &[]),
        ("exposure", &[0x21]),
        ("reconstruction", &[0x21, 0x22]),
        ("transfer", &[0x21, 0x22, 0x30, 0x31]),
    ] {
        let (messages, mut bench) = met(&format!("camera-silent@0:{phase}"));
        assert_eq!(names(&messages), kinds, "{phase}");
        assert_eq!(bench.send(&Message::GetStatus), []);
        assert!(bench.closed.is_empty());
        bench.device.handle_closed(bench.now_ns, CLIENT);
        bench.connect();
        let refused = bench.send(&hello_as(1, 2));
        assert_eq!(
            names(&refused),
            [0x70, 0x7F],
            "the end of the connection went unnoticed"
        );
        bench.connect();
        bench.greet();
        let expected = if phase == "request" { 0x70 } else { 0x34 };
        assert_eq!(names(&bench.send(&Message::Fetch(0)))[0], expected, "{phase}");
        assert_eq!(bench.elsewhere, [], "nothing comes on the silent one");
    }
    let (_, mut bench) = met("camera-silent@0");
    bench.pass(bench.now_ns + 5 * S_NS);
    bench.connect();
    assert!(
        matches!(bench.ask(&hello_as(1, 2)), Message::HelloOk(_)),
        "given up by then"
    );
}

#[test]
fn a_restarted_bridge_has_another_boot_id_and_knows_of_nothing() {
    for phase in ["request", "acknowledge", "exposure", "reconstruction", "transfer"] {
        let mut bench = Bench::armed(&[&format!("camera-restart@1:{phase}")]);
        bench.take(0);
        bench.send(&trigger(1 << 16, 0));
        bench.render();
        bench.pass(bench.now_ns + S_NS);
        assert_eq!(bench.closed, [CLIENT], "{phase}");
        bench.connect();
        assert_eq!(bench.greet().boot_id, 10);
        assert_eq!(bench.status().trigger_count, 0);
        assert_eq!(code(&bench.ask(&Message::Fetch(0))), 602);
        assert_eq!(code(&bench.ask(&Message::Fetch(1 << 16))), 602);
        assert_eq!(code(&bench.ask(&arm(1))), 206);
        bench.arm();
        assert_eq!(names(&bench.take(1 << 16)), WHOLE_FRAME, "{phase}");
    }
}

#[test]
fn everyone_is_kicked_with_a_word_and_may_come_back() {
    let mut bench = Bench::armed(&["camera-kick@0:exposure"]);
    bench.connect();
    bench.ask(&hello_as(2, 0));
    bench.on = CLIENT;
    let messages = bench.take(0);
    assert_eq!(names(&messages), [0x21, 0x7F]);
    let is_shutting_down = |message: &Message| matches!(message, Message::Bye(Bye { reason: 2, .. }));
    assert!(is_shutting_down(&messages[1]));
    assert!(
        bench
            .elsewhere
            .iter()
            .any(|(on, message)| *on == 2 && is_shutting_down(message))
    );
    assert_eq!(bench.closed, [1, 2]);
    bench.connect();
    assert_eq!(bench.greet().boot_id, 9);
    assert_eq!(bench.send(&Message::Fetch(0))[0], fetched(0, 2, 0));
}

#[test]
fn an_error_comes_at_every_phase() {
    for (phase, kinds, page_phase) in [
        ("acknowledge", &[0x70][..], 1),
        ("exposure", &[0x21, 0x70], 2),
        ("reconstruction", &[0x21, 0x22, 0x70], 3),
        ("transfer", &[0x21, 0x22, 0x30, 0x31, 0x70, 0x32], 4),
    ] {
        let (messages, mut bench) = met(&format!("camera-error=403@0:{phase}"));
        assert_eq!(names(&messages), kinds);
        let at = kinds.iter().position(|kind| *kind == 0x70).unwrap();
        assert_eq!(error(&messages[at]), (403, 0, page_phase, 1));
        assert_eq!(names(&bench.take(1)), WHOLE_FRAME);
    }
}

#[test]
fn a_device_that_leaves_is_noticed_at_every_phase() {
    for fault in ["camera-reset=1@0", "camera-lost=1@0", "camera-broken@0"] {
        let is_broken = fault.starts_with("camera-broken");
        for phase in ["request", "acknowledge", "exposure", "reconstruction", "transfer"] {
            let (messages, mut bench) = met(&format!("{fault}:{phase}"));
            let kinds = names(&messages);
            let error_at = kinds.iter().position(|kind| *kind == 0x70).unwrap();
            let event_at = kinds.iter().position(|kind| *kind == 0x52);
            assert_eq!(
                event_at,
                (!is_broken).then(|| error_at - 1),
                "{fault} {phase} {kinds:x?}"
            );
            assert_eq!(kinds.contains(&0x21), phase != "request");
            assert_eq!(bench.state(), if is_broken { 6 } else { 1 });
        }
    }
}

#[test]
fn a_missed_trigger_is_an_event_and_an_error_and_counts() {
    let (messages, mut bench) = met("missed-trigger@0");
    assert_eq!(names(&messages), [0x21, 0x52, 0x70]);
    assert!(matches!(
        &messages[1],
        Message::Event(Event {
            code: 1,
            trigger_id: 0,
            ..
        })
    ));
    assert_eq!(error(&messages[2]), (401, 0, 2, 1));
    assert_eq!(bench.status().missed_count, 1);
    assert!(bench.exposed.is_empty(), "nothing was exposed");
    assert_eq!(came("missed-trigger@0:acknowledge"), [0x52, 0x70]);
}

#[test]
fn a_hot_camera_refuses_for_a_while() {
    for (phase, page_phase) in [("acknowledge", 1), ("exposure", 2), ("reconstruction", 3)] {
        let (messages, mut bench) = met(&format!("over-temperature=3@0:{phase}"));
        let [.., Message::Event(event), last] = &messages[..] else {
            panic!()
        };
        assert_eq!((event.code, error(last)), (2, (502, 0, page_phase, 1)));
        let Message::Error(refused) = bench.ask(&trigger(1, 0)) else {
            panic!()
        };
        assert_eq!(refused.code, 502);
        bench.pass_on(u64::from(refused.retry_after_ms) * MS_NS);
        assert_eq!(names(&bench.take(2)), WHOLE_FRAME);
    }
}

#[test]
fn a_vendor_time_out_leaves_the_device_in_use_for_a_while() {
    for (phase, expected) in [("exposure", 402), ("reconstruction", 403)] {
        let (messages, mut bench) = met(&format!("vendor-timeout=5@0:{phase}"));
        assert_eq!(code(messages.last().unwrap()), expected);
        assert_eq!(bench.status().vendor_timeout_count, 1);
        let Message::Error(refused) = bench.ask(&trigger(1, 0)) else {
            panic!()
        };
        assert_eq!((refused.code, refused.retryable), (503, 1));
        bench.pass_on(u64::from(refused.retry_after_ms) * MS_NS);
        assert_eq!(names(&bench.take(2)), WHOLE_FRAME);
    }
}

#[test]
fn a_cool_down_pause_is_announced_and_lasts() {
    let mut bench = Bench::armed(&["cool-down=7.5@0"]);
    bench.send(&trigger(0, 0));
    bench.render();
    let messages = bench.pass(200 * MS_NS);
    let [Message::Event(pause)] = &messages[..] else {
        panic!("{messages:?}")
    };
    assert_eq!((pause.code, pause.duration_ms), (5, 7500));
    assert_eq!(bench.pass_on(7400 * MS_NS), []);
    assert_eq!(names(&bench.pass_on(S_NS)), WHOLE_FRAME[1..]);
}

#[test]
fn a_late_frame_is_late_in_real_time() {
    let mut bench = Bench::armed(&["late-frame=1.5@0"]);
    bench.send(&trigger(0, 0));
    bench.render();
    assert_eq!(names(&bench.pass(1707 * MS_NS)), [0x22]);
    assert_eq!(names(&bench.pass(1708 * MS_NS)), [0x30, 0x31]);
    let mut bench = Bench::armed(&["late-frame=1.5@0:exposure"]);
    bench.send(&trigger(0, 0));
    bench.render();
    assert_eq!(bench.pass(1607 * MS_NS), []);
    assert_eq!(names(&bench.pass(1708 * MS_NS)), [0x22, 0x30, 0x31]);
}

#[test]
fn corrupt_chunk_makes_the_crc_of_a_component_disagree_and_the_stored_frame_is_whole() {
    let (messages, mut bench) = met("corrupt-chunk@0");
    let [came, stated] = sums(&messages);
    assert_ne!(came[0], stated[0]);
    assert_eq!(came[0].0, stated[0].0);
    assert_eq!(came[1..], stated[1..]);
    let mut again = bench.send(&Message::Fetch(0));
    again.extend(bench.pass(bench.now_ns + S_NS));
    let [came, stated] = sums(&again);
    assert_eq!(came, stated);
}

#[test]
fn what_is_wrong_with_a_message_breaks_the_stream_at_it() {
    for (phase, before) in [
        ("acknowledge", &[][..]),
        ("exposure", &[0x21]),
        ("reconstruction", &[0x21, 0x22]),
        ("transfer", &[0x21, 0x22, 0x30, 0x31]),
    ] {
        for (name, code) in [
            ("corrupt-header", 102),
            ("corrupt-payload", 103),
            ("oversize", 104),
            ("skip-seq", 107),
        ] {
            let (messages, bench) = met(&format!("{name}@0:{phase}"));
            assert_eq!(names(&messages), before, "{name} {phase}");
            assert_eq!(bench.broken, [(CLIENT, code)], "{name} {phase}");
        }
        let (messages, bench) = met(&format!("duplicate-seq@0:{phase}"));
        assert_eq!(messages.len(), before.len() + 1, "the first of the two is right");
        assert_eq!(bench.broken, [(CLIENT, 107)]);
    }
}

#[test]
fn an_older_frame_comes_in_the_place_of_the_one_that_is_due() {
    let mut bench = Bench::armed(&["older-frame@0", "older-frame@1"]);
    assert_eq!(names(&bench.take(0)), WHOLE_FRAME, "there is no older one yet");
    let messages = bench.take(1 << 16);
    assert_eq!(names(&messages), WHOLE_FRAME);
    let Message::FrameBegin(begin) = &messages[2] else {
        panic!()
    };
    assert_eq!(begin.head.trigger_id, 0);
    assert_eq!(names(&bench.send(&Message::Fetch(1 << 16)))[..2], [0x34, 0x30]);
}

#[test]
fn messages_that_come_too_often_or_not_at_all() {
    assert_eq!(
        came("double-exposure@0"),
        [0x21, 0x22, 0x22, 0x30, 0x31, 0x31, 0x31, 0x32]
    );
    assert_eq!(came("no-exposure@0"), [0x21, 0x30, 0x31, 0x31, 0x31, 0x32]);
    assert_eq!(came("early-end@0"), [0x21, 0x22, 0x30, 0x31, 0x32]);
    assert_eq!(
        came("double-frame@0"),
        [&WHOLE_FRAME[..], &[0x30, 0x31, 0x31, 0x31, 0x32]].concat()
    );
}

#[test]
fn a_frame_that_ends_early_claims_to_be_complete() {
    let (messages, _) = met("early-end@0");
    let Some(Message::FrameEnd(end)) = messages.last() else {
        panic!()
    };
    assert_eq!((end.tail.status, end.components[1].byte_count), (0, 3200));
}

#[test]
fn a_wrong_count_stands_in_frame_end_and_if_asked_for_in_frame_begin() {
    for (fault, expected) in [
        ("wrong-count@0", [3200, 3201]),
        ("wrong-count@0:reconstruction", [3201, 3201]),
    ] {
        let (messages, _) = met(fault);
        let (Message::FrameBegin(begin), Some(Message::FrameEnd(end))) = (&messages[2], messages.last()) else {
            panic!()
        };
        assert_eq!([begin.head.valid_count, end.tail.valid_count], expected);
    }
}

#[test]
fn an_empty_frame_has_no_valid_point() {
    let (messages, _) = met("empty-frame@0");
    let Message::FrameBegin(begin) = &messages[2] else {
        panic!()
    };
    assert_eq!(begin.head.valid_count, 0);
    let Message::FrameChunk(xyz) = &messages[3] else {
        panic!()
    };
    assert!(
        xyz.data
            .0
            .chunks_exact(4)
            .all(|value| f32::from_le_bytes(value.try_into().unwrap()).is_nan())
    );
}

#[test]
fn a_degraded_frame_says_so() {
    let (messages, mut bench) = met("degraded@0");
    let Message::FrameBegin(begin) = &messages[2] else {
        panic!()
    };
    assert_eq!(begin.head.frame_flags, 1 | 1 << 9 | 1 << 11);
    assert!(bench.status().lost_packet_count > 0);
}

#[test]
fn config_echo_differs_from_what_was_asked_for() {
    let mut bench = Bench::new(&["config-echo"]);
    bench.greet();
    let Message::Configured(configured) = bench.ask(&configure(&small_settings())) else {
        panic!()
    };
    assert_ne!(configured.settings.0, small_settings().to_records());
}

#[test]
fn another_controller_has_the_camera_for_a_while_or_to_the_end() {
    for (fault, is_served_later) in [("controller-busy=2", true), ("controller-busy", false)] {
        let mut bench = Bench::new(&[fault]);
        let answers = bench.send(&hello());
        assert_eq!(names(&answers), [0x70, 0x7F]);
        assert_eq!((code(&answers[0]), &bench.closed[..]), (201, &[CLIENT][..]));
        bench.pass(2 * S_NS - 1);
        bench.connect();
        assert_eq!(code(&bench.send(&hello())[0]), 201);
        bench.pass(2 * S_NS);
        bench.connect();
        let answers = bench.send(&hello());
        assert_eq!(matches!(answers[..], [Message::HelloOk(_)]), is_served_later);
    }
}

#[test]
fn a_fault_in_the_transfer_meets_a_frame_that_is_fetched_too() {
    let mut bench = Bench::armed(&["camera-gone@0:exposure", "skip-seq@0"]);
    bench.take(0);
    bench.reconnect();
    bench.greet();
    bench.send(&Message::Fetch(0));
    bench.pass(bench.now_ns + S_NS);
    assert_eq!(bench.broken, [(2, 107)]);
    assert_eq!(bench.device.met_faults().len(), 2);
}

#[test]
fn a_faster_simulation_predicts_its_own_time() {
    let mut bench = Bench::new(&[]);
    bench.device.settings.speed = 20.0;
    bench.greet();
    let Message::Configured(configured) = bench.ask(&configure(&small_settings())) else {
        panic!()
    };
    assert_eq!(
        (configured.predicted_exposure_us, configured.predicted_total_us),
        (5400, 10_400)
    );
}
