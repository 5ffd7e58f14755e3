//! Triggers, frames, aborts, the store.

use super::*;

/// Three seconds of a run's own conversation with the bridge, which triggers once; the connection is cut at `cut_ms`.
/// The vendor's side exposes for 40 ms and has the frame after 200 ms.
fn a_run(cut_ms: Option<u64>) -> (Vec<CameraEvent>, usize) {
    let mut bench = Bench::new();
    let times = ExchangeSettings {
        connect_timeout_ms: 3000,
        reply_timeout_ms: 5000,
        frame_timeout_extra_ms: 2000,
        ping_interval_ms: 1000,
        dead_after_ms: 5000,
        reconnect_timeout_ms: 60_000,
        device_timeout_ms: 60_000,
    };
    let mut exchange = Exchange::new(times, RUN, Seed(3), vec![SETTINGS]);
    exchange.open(at(0));
    let (mut events, mut acquired_ms, mut id) = (Vec::new(), None, ConnectionId(0));
    for ms in 1..3000 {
        let now = at(ms);
        bench.bridge.handle_wake(now);
        exchange.handle_wake(now);
        if cut_ms == Some(ms) {
            bench.bridge.handle_closed(now, id);
            exchange.handle_closed(now, "the cable is out");
        }
        if acquired_ms.is_some_and(|began| ms == began + 40) {
            bench.bridge.handle_line(now, r#"{"is":"exposed","acquisition":1}"#);
        }
        if acquired_ms.is_some_and(|began| ms == began + 200) {
            bench
                .bridge
                .handle_line(now, r#"{"is":"frame","acquisition":1,"esm":"a"}"#);
        }
        while let Some(output) = exchange.poll_output() {
            match output {
                CameraOutput::Connect => {
                    id = ConnectionId(id.0 + 1);
                    bench.bridge.handle_connected(now, id, "here");
                    exchange.handle_connected(now);
                }
                CameraOutput::Bytes { bytes, .. } => bench.bridge.handle_bytes(now, id, &bytes),
                CameraOutput::Close => bench.bridge.handle_closed(now, id),
            }
        }
        while let Some(output) = bench.bridge.poll_output() {
            match output {
                BridgeOutput::Bytes { connection, bytes } if connection == id => {
                    exchange.handle_bytes(now, &bytes);
                    bench.bridge.handle_written(now, connection, bytes.len());
                }
                BridgeOutput::Line(line) if line.contains("configure") => {
                    let config_id = bench.bridge.next_config_id - 1;
                    let line = format!(r#"{{"is":"configured","config_id":{config_id}}}"#);
                    bench.bridge.handle_line(now, &line);
                }
                BridgeOutput::Line(line) if line.contains("acquire") => {
                    assert_eq!(acquired_ms.replace(ms), None, "nothing is exposed twice");
                }
                BridgeOutput::Convert(_) => bench.bridge.handle_picture(now, 1, Ok(picture(7.0))),
                _ => {}
            }
        }
        while let Some(event) = exchange.poll_event() {
            if matches!(event, CameraEvent::Ready(_)) {
                exchange.trigger(now, TriggerId::new(0, 0));
            }
            events.push(event);
        }
    }
    assert!(exchange.is_armed(), "{events:?}");
    let frames = events.iter().filter(|event| match event {
        CameraEvent::Frame(capture) => {
            assert_eq!(capture.grid_mm()[PIXELS - 1], [7.0; 3]);
            true
        }
        _ => false,
    });
    let frame_count = frames.count();
    (events, frame_count)
}

#[test]
fn the_conversation_of_a_run_gets_its_frame_from_the_bridge() {
    let (events, frame_count) = a_run(None);
    assert_eq!(frame_count, 1, "{events:?}");
}

#[test]
fn a_connection_cut_at_any_moment_costs_no_exposure_and_no_frame() {
    for cut_ms in (2..260).step_by(6) {
        let (events, frame_count) = a_run(Some(cut_ms));
        assert_eq!(frame_count, 1, "cut at {cut_ms} ms: {events:?}");
    }
}

#[test]
fn an_acquisition_goes_through_its_states_and_ends_armed() {
    let mut bench = Bench::armed();
    let ServerMessage::TriggerOk(accepted) = bench.ask(at(10), 0, &trigger(9)) else {
        panic!()
    };
    assert_eq!(accepted.repeated, Repeated::New);
    assert_eq!(bench.bridge.state(), CameraState::Exposing);
    assert!(bench.orders.last().unwrap().contains("acquire"));
    bench.expose(at(50));
    assert_eq!(bench.bridge.state(), CameraState::Reconstructing);
    bench.finish(at(90));
    assert_eq!(bench.bridge.state(), CameraState::Armed);
    let heard = bench.heard(0);
    assert_eq!(kinds(&heard)[0], 0x22);
    assert_eq!(kinds(&heard)[1..], WHOLE);
    let Heard::Message(ServerMessage::FrameBegin(begin), _) = &heard[1] else {
        panic!()
    };
    assert_eq!(
        (begin.trigger_id, begin.view_id, begin.exposure_end_ns),
        (TriggerId(9), 3, at(50).ns)
    );
    assert_eq!(
        heard[2..5],
        [Heard::Chunk(12 * PIXELS), Heard::Chunk(PIXELS), Heard::Chunk(PIXELS)]
    );
}

#[test]
fn a_repeated_trigger_is_not_exposed_again() {
    let mut bench = Bench::armed();
    bench.ask(at(10), 0, &trigger(9));
    let orders = bench.orders.len();
    let again = |bench: &mut Bench| match bench.ask(at(20), 0, &trigger(9)) {
        ServerMessage::TriggerOk(accepted) => accepted.repeated,
        other => panic!("{other:?}"),
    };
    assert_eq!(again(&mut bench), Repeated::InFlight);
    assert_eq!(bench.refused(at(20), 0, &trigger(10)), 204);
    bench.finish(at(30));
    bench.heard(0);
    assert_eq!(again(&mut bench), Repeated::Done);
    // Also when nothing is armed any more, and on another connection of the run.
    bench.ask(at(40), 0, &ClientMessage::Disarm);
    assert_eq!(again(&mut bench), Repeated::Done);
    assert_eq!(bench.refused(at(40), 0, &trigger(10)), 202);
    assert_eq!(bench.orders.len(), orders);
}

#[test]
fn an_abort_is_answered_in_every_phase_and_nothing_more_comes() {
    let aborted = |bench: &mut Bench| match bench.ask(at(50), 0, &ABORT) {
        ServerMessage::Aborted(Aborted { trigger_id, phase }) => (trigger_id, phase),
        other => panic!("{other:?}"),
    };
    let mut bench = Bench::armed();
    assert_eq!(aborted(&mut bench), (TRIGGER_ALL, AcquisitionPhase::None));
    bench.ask(at(10), 0, &trigger(1));
    assert_eq!(aborted(&mut bench), (1, AcquisitionPhase::Exposure));
    assert_eq!(bench.orders.last().unwrap(), r#"{"do":"abort","acquisition":1}"#);
    bench.ask(at(60), 0, &trigger(2));
    bench.expose(at(70));
    bench.heard(0);
    assert_eq!(aborted(&mut bench), (2, AcquisitionPhase::Reconstruction));
    // What the vendor's side still says of it is passed over.
    bench.say_vendor(at(80), r#"{"is":"frame","acquisition":2,"esm":"a"}"#);
    assert!(bench.conversions.is_empty() && bench.heard(0).is_empty());
    assert_eq!(bench.bridge.state(), CameraState::Armed);
    assert_eq!(bench.refused(at(90), 0, &fetch(2)), 602);
}

#[test]
fn an_abort_on_the_way_ends_the_frame_with_what_was_sent() {
    let mut bench = Bench::armed();
    bench.ask(at(10), 0, &trigger(1));
    bench.say_vendor(at(20), r#"{"is":"frame","acquisition":1,"esm":"a"}"#);
    bench.bridge.handle_picture(at(20), 1, Ok(picture(1.0)));
    // The client takes EXPOSURE_DONE was run before; now FRAME_BEGIN and one chunk.
    for _ in 0..2 {
        let Some(BridgeOutput::Bytes { connection, bytes }) = bench.bridge.poll_output() else {
            panic!()
        };
        bench.clients[0].hear(&bytes);
        bench.bridge.handle_written(at(20), connection, bytes.len());
    }
    assert_eq!(bench.bridge.state(), CameraState::Sending);
    bench.heard(0);
    let ServerMessage::Aborted(aborted) = bench.ask(at(30), 0, &ABORT) else {
        panic!()
    };
    assert_eq!((aborted.trigger_id, aborted.phase), (1, AcquisitionPhase::Transfer));
    let heard = bench.heard(0);
    let [Heard::Message(ServerMessage::FrameEnd(FrameEnd { status, components, .. }), FLAG_LAST)] = &heard[..] else {
        panic!("{heard:?}")
    };
    assert_eq!(*status, FrameStatus::Aborted);
    let sent: Vec<u64> = components.iter().map(|component| component.byte_count).collect();
    assert_eq!(sent, [12 * PIXELS as u64, 0, 0]);
    assert_eq!(bench.refused(at(40), 0, &fetch(1)), 602);
    assert_eq!(bench.bridge.state(), CameraState::Armed);
}

#[test]
fn a_frame_outlives_its_connection_and_is_fetched_by_the_run_that_comes_back() {
    let mut bench = Bench::armed();
    bench.ask(at(10), 0, &trigger(1));
    let id = bench.clients[0].id;
    bench.bridge.handle_closed(at(20), id);
    assert_eq!(bench.bridge.state(), CameraState::Exposing);
    bench.expose(at(30));
    let back = bench.controller(at(40));
    let ServerMessage::FetchOk(found) = bench.ask(at(40), back, &fetch(1)) else {
        panic!()
    };
    assert_eq!(found.state, FetchState::InFlight);
    assert!(found.remaining_us > 0);
    bench.finish(at(50));
    assert_eq!(kinds(&bench.heard(back)), WHOLE);
    assert_eq!(bench.bridge.state(), CameraState::Idle);
    // The settings are as before.
    let arm = Arm {
        mode: Arm::SOFTWARE,
        config_id: 1,
    };
    assert!(matches!(
        bench.ask(at(60), back, &ClientMessage::Arm(arm)),
        ServerMessage::Armed { .. }
    ));
}

#[test]
fn a_frame_that_nobody_waits_for_is_stored() {
    let mut bench = Bench::armed();
    bench.ask(at(10), 0, &trigger(1));
    let id = bench.clients[0].id;
    bench.bridge.handle_closed(at(20), id);
    bench.finish(at(30));
    assert_eq!(bench.bridge.state(), CameraState::Idle);
    let back = bench.controller(at(40));
    let ServerMessage::FetchOk(found) = bench.ask(at(40), back, &fetch(1)) else {
        panic!()
    };
    assert_eq!((found.state, found.remaining_us), (FetchState::Stored, 0));
    assert_eq!(kinds(&bench.heard(back)), WHOLE);
}

#[test]
fn the_store_keeps_four_frames_with_the_same_bytes_and_another_run_forgets_them() {
    let mut bench = Bench::armed();
    for trigger_id in 1..=5 {
        bench.acquire(at(10 * trigger_id), trigger_id);
    }
    assert_eq!(bench.refused(at(100), 0, &fetch(1)), 602);
    for trigger_id in 2..=5 {
        assert!(matches!(
            bench.ask(at(100), 0, &fetch(trigger_id)),
            ServerMessage::FetchOk(_)
        ));
        let heard = bench.heard(0);
        assert_eq!(kinds(&heard), WHOLE);
        let Heard::Message(ServerMessage::FrameBegin(begin), _) = &heard[0] else {
            panic!()
        };
        assert_eq!((begin.frame_id, begin.trigger_id), (trigger_id, TriggerId(trigger_id)));
    }
    bench.send(
        at(110),
        0,
        &ClientMessage::Bye(Bye {
            reason: Bye::DONE,
            text: String::new(),
        }),
    );
    let other = bench.connect(at(120));
    bench.ask(
        at(120),
        other,
        &ClientMessage::Hello(Hello::controller(RUN + 1, "other")),
    );
    assert_eq!(bench.refused(at(120), other, &fetch(5)), 602);
}

#[test]
fn what_is_in_flight_of_another_run_is_aborted() {
    let mut bench = Bench::armed();
    bench.ask(at(10), 0, &trigger(1));
    let id = bench.clients[0].id;
    bench.bridge.handle_closed(at(20), id);
    let other = bench.connect(at(30));
    bench.ask(
        at(30),
        other,
        &ClientMessage::Hello(Hello::controller(RUN + 1, "other")),
    );
    assert_eq!(bench.orders.last().unwrap(), r#"{"do":"abort","acquisition":1}"#);
    assert_eq!(bench.bridge.state(), CameraState::Idle);
}

#[test]
fn a_transfer_of_the_bridge_is_what_the_assembly_of_the_client_takes() {
    let mut bench = Bench::armed();
    bench.ask(at(0), 0, &trigger(1));
    bench.finish(at(10));
    let heard = bench.heard(0);
    let begin = heard.iter().find_map(|heard| match heard {
        Heard::Message(ServerMessage::FrameBegin(begin), _) => Some(begin.clone()),
        _ => None,
    });
    assert!(Assembly::begin(*begin.unwrap(), 1 << 20).is_ok());
}
