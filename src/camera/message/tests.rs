use super::*;
use crate::camera::settings::tests::PAGE_SETTINGS;
use crate::camera::wire::HEADER_BYTES;
use crate::vectors::a3dp;

const PAGE_TRIGGER: TriggerId = TriggerId(5 << 16 | 1);

fn heard(name: &str) -> ServerMessage {
    let bytes = a3dp(name);
    let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
    ServerMessage::decode(kind, &bytes[HEADER_BYTES..]).unwrap().unwrap()
}

#[test]
fn what_the_client_says_equals_the_vectors_of_the_page() {
    let done = "done".to_owned();
    for (message, name) in [
        (
            ClientMessage::Hello {
                run_id: 0xB1AD_E5CA_0000_0001,
                client_name: "bladescan".into(),
            },
            "hello",
        ),
        (ClientMessage::GetCaps, "get_caps"),
        (ClientMessage::Configure(PAGE_SETTINGS), "configure"),
        (ClientMessage::Arm { config_id: 77 }, "arm"),
        (ClientMessage::Disarm, "disarm"),
        (
            ClientMessage::Trigger {
                trigger_id: TriggerId::new(5, 1),
                config_id: 77,
                deadline_ms: 15_000,
                tag: "view 5".into(),
            },
            "trigger",
        ),
        (ClientMessage::AbortAll, "abort"),
        (ClientMessage::Ping { sender_ns: 123_456_789 }, "ping"),
        (ClientMessage::Bye { reason: 1, text: done }, "bye"),
    ] {
        let vector = a3dp(name);
        let (kind, payload) = message.encode();
        assert_eq!(kind.to_le_bytes(), vector[6..8], "{name}");
        assert_eq!(payload, vector[HEADER_BYTES..], "{name}");
    }
}

#[test]
fn what_the_server_says_on_the_page_is_understood() {
    let ServerMessage::HelloOk(greeting) = heard("hello_ok") else {
        panic!()
    };
    assert!(greeting.simulated);
    assert_eq!(
        (greeting.serial.as_str(), greeting.frame_bytes_max),
        ("SIM-0001", 64 << 20)
    );
    let ServerMessage::Caps(caps) = heard("caps") else {
        panic!()
    };
    assert_eq!((caps.sensor_px, caps.optics.as_str()), ([1440, 1080], "fine"));
    assert_eq!(caps.working_distance_mm, [200.0, 260.0, 320.0]);
    assert_eq!(caps.camera_1_mm, [0.0; 3]);
    assert_eq!((caps.spacing_mm, caps.components), (0.04, 0b10101));
    let ServerMessage::Configured(configured) = heard("configured") else {
        panic!()
    };
    assert_eq!((configured.config_id, configured.settings), (77, PAGE_SETTINGS));
    assert_eq!(configured.frame_bytes, 5_443_200);
    assert_eq!(heard("armed"), ServerMessage::Armed);
    assert_eq!(heard("disarmed"), ServerMessage::Disarmed);
    let ServerMessage::TriggerOk(accepted) = heard("trigger_ok") else {
        panic!()
    };
    assert_eq!(
        (accepted.trigger_id, accepted.predicted_total_us),
        (PAGE_TRIGGER, 208_000)
    );
    assert_eq!(
        heard("exposure_done"),
        ServerMessage::ExposureDone {
            trigger_id: PAGE_TRIGGER
        }
    );
    let ServerMessage::FrameBegin(begin) = heard("frame_begin") else {
        panic!()
    };
    assert_eq!((begin.width_px, begin.height_px, begin.valid_count), (2, 1, 1));
    assert_eq!(begin.components[0].byte_count, 24);
    let ServerMessage::FrameEnd(end) = heard("frame_end") else {
        panic!()
    };
    assert_eq!((end.status, end.components.len(), end.trigger_id), (0, 3, PAGE_TRIGGER));
    assert_eq!(
        heard("aborted"),
        ServerMessage::Aborted {
            trigger_id: PAGE_TRIGGER.0
        }
    );
    let ServerMessage::Status(status) = heard("status") else {
        panic!()
    };
    assert_eq!((status.state, status.temperature_c[3]), (2, None));
    let ServerMessage::Event { code: 5, text } = heard("event") else {
        panic!()
    };
    assert_eq!(text, "LED pause 200 ms");
    let ServerMessage::Pong { sender_ns, device_ns } = heard("pong") else {
        panic!()
    };
    assert_eq!((sender_ns, device_ns), (123_456_789, 6_000_000));
    let ServerMessage::Error(error) = heard("error") else {
        panic!()
    };
    assert_eq!((error.code, error.retryable, error.about_request_id), (202, true, 5));
}

#[test]
fn cut_and_padded_payloads_are_refused_without_a_panic() {
    for name in [
        "hello_ok",
        "caps",
        "configured",
        "armed",
        "trigger_ok",
        "exposure_done",
        "frame_begin",
        "frame_end",
        "aborted",
        "status",
        "event",
        "pong",
        "error",
        "bye",
    ] {
        let bytes = a3dp(name);
        let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
        let payload = &bytes[HEADER_BYTES..];
        for length in 0..payload.len() {
            assert!(
                ServerMessage::decode(kind, &payload[..length]).is_err(),
                "{name} cut to {length}"
            );
        }
        let mut long = payload.to_vec();
        long.push(0);
        assert!(ServerMessage::decode(kind, &long).is_err(), "{name} padded");
    }
}
