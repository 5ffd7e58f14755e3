//! Connections, roles, refusals.

use super::*;
use proptest::prelude::*;

#[test]
fn each_request_gets_what_the_page_says_in_each_state() {
    let mut bench = Bench::new();
    let client = bench.connect(at(0));
    assert_eq!(bench.refused(at(0), client, &ClientMessage::GetCaps), 205);
    bench.ask(at(0), client, &ClientMessage::Hello(Hello::controller(RUN, "test")));
    let arm = |config_id| {
        ClientMessage::Arm(Arm {
            mode: Arm::SOFTWARE,
            config_id,
        })
    };
    assert_eq!(
        bench.refused(at(0), client, &ClientMessage::Hello(Hello::controller(RUN, "test"))),
        203
    );
    assert_eq!(bench.refused(at(0), client, &arm(1)), 206);
    assert_eq!(bench.refused(at(0), client, &trigger(1)), 202);
    bench.arm(at(0), client);
    assert_eq!(bench.refused(at(0), client, &arm(1)), 203);
    assert_eq!(bench.refused(at(0), client, &ClientMessage::Configure(SETTINGS)), 203);
    bench.ask(at(0), client, &trigger(1));
    assert_eq!(bench.refused(at(0), client, &ClientMessage::Disarm), 203);
    assert_eq!(bench.refused(at(0), client, &arm(1)), 203);
    bench.say_vendor(at(0), r#"{"is":"lost","duration_ms":30000,"text":"reset"}"#);
    bench.heard(client);
    for (request, code) in [
        (ClientMessage::Configure(SETTINGS), 504),
        (arm(1), 504),
        (trigger(2), 504),
        (fetch(2), 602),
    ] {
        assert_eq!(bench.refused(at(0), client, &request), code);
    }
    bench.say_vendor(at(0), r#"{"is":"fault","text":"broken"}"#);
    bench.heard(client);
    for (request, code) in [
        (ClientMessage::Configure(SETTINGS), 500),
        (arm(1), 500),
        (trigger(2), 500),
    ] {
        assert_eq!(bench.refused(at(0), client, &request), code);
    }
    bench.bridge.handle_vendor_ended(at(0), "ended");
    bench.run(at(0));
    bench.heard(client);
    for (request, code) in [
        (ClientMessage::Configure(SETTINGS), 501),
        (arm(1), 501),
        (trigger(2), 501),
    ] {
        assert_eq!(bench.refused(at(0), client, &request), code);
    }
    let disarmed = bench.ask(at(0), client, &ClientMessage::Disarm);
    assert_eq!(
        disarmed,
        ServerMessage::Disarmed {
            state: CameraState::Offline
        }
    );
    assert!(matches!(
        bench.ask(at(0), client, &ClientMessage::GetCaps),
        ServerMessage::Caps(_)
    ));
}

#[test]
fn the_same_run_takes_its_place_and_another_is_told_who_has_it() {
    let mut bench = Bench::armed();
    let other = bench.connect(at(10));
    bench.send(
        at(10),
        other,
        &ClientMessage::Hello(Hello::controller(RUN + 1, "other")),
    );
    let heard = bench.heard(other);
    let [
        Heard::Message(ServerMessage::Error(error), _),
        Heard::Message(ServerMessage::Bye(bye), _),
    ] = &heard[..]
    else {
        panic!("{heard:?}")
    };
    assert_eq!((error.code, bye.reason), (201, Bye::REFUSED));
    assert!(error.text.contains("test at somewhere"), "{}", error.text);
    assert!(bench.clients[other].closed && !bench.clients[0].closed);
    let same = bench.controller(at(20));
    let heard = bench.heard(0);
    let [Heard::Message(ServerMessage::Bye(bye), _)] = &heard[..] else {
        panic!("{heard:?}")
    };
    assert_eq!(bye.reason, Bye::REPLACED);
    assert!(bench.clients[0].closed && !bench.clients[same].closed);
    assert_eq!(bench.bridge.state(), CameraState::Idle);
}

#[test]
fn observers_read_three_of_them_and_hear_status_and_events() {
    let mut bench = Bench::new();
    for _ in 0..3 {
        let observer = bench.connect(at(0));
        let greeting = bench.ask(at(0), observer, &ClientMessage::Hello(Hello::observer("watch")));
        assert!(matches!(greeting, ServerMessage::HelloOk(greeting) if greeting.role == Hello::OBSERVER));
    }
    let fourth = bench.connect(at(0));
    bench.send(at(0), fourth, &ClientMessage::Hello(Hello::observer("watch")));
    assert!(bench.clients[fourth].closed);
    assert_eq!(bench.refused(at(0), 0, &ABORT), 207);
    assert_eq!(bench.refused(at(0), 0, &ClientMessage::Configure(SETTINGS)), 207);
    assert!(matches!(
        bench.ask(at(0), 0, &ClientMessage::GetStatus),
        ServerMessage::Status(_)
    ));
    assert!(matches!(
        bench.ask(at(0), 0, &ClientMessage::Ping { sender_ns: 1 }),
        ServerMessage::Pong(_)
    ));
    let controller = bench.controller(at(0));
    bench.configured(at(0), controller);
    let heard = bench.heard(1);
    assert!(
        matches!(&heard[..], [Heard::Message(ServerMessage::Event(event), 0)] if event.code == DeviceEvent::CONFIG_CHANGED)
    );
    assert!(bench.heard(controller).is_empty());
    bench.bridge.handle_wake(at(1000));
    bench.run(at(1000));
    for client in [0, 1, 2, controller] {
        assert!(matches!(
            bench.clients[client].heard.back(),
            Some(Heard::Message(ServerMessage::Status(_), 0))
        ));
    }
}

#[test]
fn settings_are_refused_by_code_and_a_silent_vendor_too() {
    let mut bench = Bench::new();
    let client = bench.controller(at(0));
    let long = CameraSettings {
        exposure_us: 50_001,
        ..SETTINGS
    };
    assert_eq!(bench.refused(at(0), client, &ClientMessage::Configure(long)), 301);
    bench.send(at(0), client, &ClientMessage::Configure(SETTINGS));
    assert_eq!(bench.refused(at(0), client, &ClientMessage::Configure(SETTINGS)), 203);
    bench.bridge.handle_wake(at(4500));
    bench.run(at(4500));
    let heard = bench.heard(client);
    assert!(
        matches!(&heard[..], [Heard::Message(ServerMessage::Error(error), 3)] if error.code == 500),
        "{heard:?}"
    );
    bench.send(at(4600), client, &ClientMessage::Configure(SETTINGS));
    bench.say_vendor(at(4600), r#"{"is":"error","config_id":2,"code":503,"text":"in use"}"#);
    assert!(matches!(bench.reply(client), ServerMessage::Error(error) if error.code == 503));
}

#[test]
fn a_damaged_list_of_settings_leaves_the_connection_open_and_a_damaged_message_does_not() {
    let mut bench = Bench::new();
    let client = bench.controller(at(0));
    let id = bench.clients[client].id;
    let list = SETTINGS.encode();
    for (payload, code) in [(&list[..list.len() - 1], 108), (&list[5..], 305)] {
        let bytes = bench.clients[client]
            .writer
            .write_with(0x10, 7, 0, |bytes| bytes.extend_from_slice(payload));
        bench.bridge.handle_bytes(at(0), id, &bytes);
        bench.run(at(0));
        assert!(matches!(bench.reply(client), ServerMessage::Error(error) if error.code == code));
    }
    let bytes = bench.clients[client].writer.write_with(0x99, 8, 0, |_| {});
    bench.bridge.handle_bytes(at(0), id, &bytes);
    bench.run(at(0));
    assert!(matches!(bench.reply(client), ServerMessage::Error(error) if error.code == 106));
    assert!(!bench.clients[client].closed);
    let bytes = bench.clients[client]
        .writer
        .write_with(0x12, 9, 0, |bytes| bytes.push(1));
    bench.bridge.handle_bytes(at(0), id, &bytes);
    bench.run(at(0));
    let heard = bench.heard(client);
    assert_eq!(kinds(&heard), [0x70, 0x7F]);
    assert!(bench.clients[client].closed);
}

#[test]
fn request_id_0_and_flags_that_do_not_fit_end_the_connection() {
    for (request_id, flags) in [(0, 0), (1, FLAG_REPLY)] {
        let mut bench = Bench::new();
        let client = bench.connect(at(0));
        let hello = ClientMessage::Hello(Hello::controller(RUN, "test"));
        let bytes = bench.clients[client]
            .writer
            .write_with(hello.kind(), request_id, flags, |bytes| hello.encode(bytes));
        let id = bench.clients[client].id;
        bench.bridge.handle_bytes(at(0), id, &bytes);
        bench.run(at(0));
        assert_eq!(kinds(&bench.heard(client)), [0x70, 0x7F]);
        assert!(bench.clients[client].closed);
    }
}

#[test]
fn greetings_out_of_range_are_refused() {
    let mut bench = Bench::new();
    let client = bench.connect(at(0));
    let hello = |change: fn(&mut Hello)| {
        let mut hello = Hello::controller(RUN, "test");
        change(&mut hello);
        ClientMessage::Hello(hello)
    };
    assert_eq!(bench.refused(at(0), client, &hello(|hello| hello.role = 3)), 301);
    assert_eq!(bench.refused(at(0), client, &hello(|hello| hello.run_id = 0)), 301);
    assert_eq!(
        bench.refused(at(0), client, &hello(|hello| hello.client_name.clear())),
        301
    );
    assert_eq!(
        bench.refused(at(0), client, &hello(|hello| hello.min_version = [2, 0])),
        105
    );
    assert!(bench.clients[client].closed);
}

#[test]
fn a_silent_client_is_left_after_5_s_and_its_frame_is_kept() {
    let mut bench = Bench::armed();
    bench.ask(at(0), 0, &trigger(1));
    bench.bridge.handle_wake(at(4999));
    bench.run(at(4999));
    assert!(!bench.clients[0].closed);
    bench.bridge.handle_wake(at(5000));
    bench.run(at(5000));
    assert!(bench.clients[0].closed);
}

#[test]
fn a_client_that_takes_nothing_of_its_frame_is_cut_off_and_the_frame_is_stored() {
    let mut bench = Bench::new();
    let client = bench.controller(at(0));
    let whole = CameraSettings {
        binning: true,
        ..SETTINGS
    };
    bench.send(at(0), client, &ClientMessage::Configure(whole));
    bench.say_vendor(at(0), r#"{"is":"configured","config_id":1}"#);
    bench.reply(client);
    bench.ask(
        at(0),
        client,
        &ClientMessage::Arm(Arm {
            mode: Arm::SOFTWARE,
            config_id: 1,
        }),
    );
    bench.ask(at(0), client, &trigger(1));
    bench.say_vendor(at(0), r#"{"is":"frame","acquisition":1,"esm":"a"}"#);
    let pixels = 720 * 540;
    let big = Picture {
        width_px: 720,
        height_px: 540,
        xyz: vec![0; 12 * pixels],
        intensity: vec![0; pixels],
        confidence: None,
        mask: vec![0; pixels],
        valid_count: pixels as u32,
    };
    bench.bridge.handle_picture(at(0), 1, Ok(big));
    let mut handed_out = 0;
    while let Some(output) = bench.bridge.poll_output() {
        if let BridgeOutput::Bytes { bytes, .. } = output {
            handed_out += bytes.len();
        }
    }
    assert!(
        handed_out < UNSENT_MAX + 2 * (transfer::CHUNK_BYTES + 100),
        "{handed_out}"
    );
    // The client's end is alive, but no byte of the frame goes out.
    let id = bench.clients[client].id;
    for second in 1..=5 {
        let ping = ClientMessage::Ping { sender_ns: 1 };
        let bytes = bench.clients[client]
            .writer
            .write_with(0x60, 50, 0, |bytes| ping.encode(bytes));
        bench.bridge.handle_bytes(at(second * 1000), id, &bytes);
        bench.bridge.handle_wake(at(second * 1000));
    }
    let cut_off = BridgeOutput::Close { connection: id };
    assert!(std::iter::from_fn(|| bench.bridge.poll_output()).any(|output| output == cut_off));
    bench.bridge.handle_closed(at(5001), id);
    let back = bench.controller(at(5002));
    assert!(
        matches!(bench.ask(at(5002), back, &fetch(1)), ServerMessage::FetchOk(found) if found.state == FetchState::Stored)
    );
    assert_eq!(bench.heard(back).len(), 2 + 18 + 2 + 2);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_message_and_no_line_makes_it_panic(
        messages in prop::collection::vec(
            (prop::sample::select(vec![1u16, 3, 0x10, 0x12, 0x13, 0x20, 0x33, 0x40, 0x50, 0x60, 0x61, 0x70, 0x7F, 0x99]),
             prop::collection::vec(prop_oneof![Just(0u8), Just(1), Just(2), any::<u8>()], 0..48), 0u16..4),
            0..12,
        ),
        lines in prop::collection::vec(
            prop_oneof![
                (any::<u32>(), any::<u32>()).prop_map(|(a, b)| format!(
                    r#"{{"is":"configured","config_id":1,"predicted_exposure_us":{a},"predicted_total_us":{b}}}"#
                )),
                Just(r#"{"is":"exposed","acquisition":1}"#.to_owned()),
                Just(r#"{"is":"frame","acquisition":1,"esm":"a"}"#.to_owned()),
                any::<u32>().prop_map(|ms| format!(r#"{{"is":"pause","duration_ms":{ms}}}"#)),
                any::<u32>().prop_map(|ms| format!(r#"{{"is":"lost","duration_ms":{ms},"text":""}}"#)),
                Just(r#"{"is":"ready","vendor":"V","model":"M","serial":"S"}"#.to_owned()),
                ".{0,40}",
            ],
            0..12,
        ),
    ) {
        let mut bench = Bench::armed();
        bench.send(at(0), 0, &trigger(1));
        for (step, (kind, payload, flags)) in messages.iter().enumerate() {
            let client = bench.connect(at(step as u64));
            bench.send(at(step as u64), client, &ClientMessage::Hello(Hello::controller(RUN, "test")));
            let id = bench.clients[client].id;
            let bytes = bench.clients[client].writer.write_with(*kind, 2, *flags, |bytes| bytes.extend_from_slice(payload));
            bench.bridge.handle_bytes(at(step as u64), id, &bytes);
            bench.run(at(step as u64));
            if let Some(line) = lines.get(step) {
                bench.say_vendor(at(step as u64), line);
            }
            let wake = bench.bridge.wake_at().unwrap_or(at(0));
            bench.bridge.handle_wake(wake);
            bench.run(wake);
        }
    }
}
