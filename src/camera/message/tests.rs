use super::*;
use crate::camera::settings::tests::PAGE_SETTINGS;
use crate::camera::wire::{FrameWriter, HEADER_BYTES, WireFrame};
use crate::vectors::a3dp;

const PAGE_TRIGGER: TriggerId = TriggerId(5 << 16 | 1);

const CLIENT: [&str; 10] = [
    "hello",
    "get_caps",
    "configure",
    "arm",
    "disarm",
    "trigger",
    "fetch",
    "abort",
    "get_status",
    "bye",
];
const SERVER: [&str; 18] = [
    "hello_ok",
    "caps",
    "configured",
    "armed",
    "disarmed",
    "trigger_ok",
    "exposure_done",
    "frame_begin",
    "frame_chunk_0",
    "frame_chunk_1",
    "frame_chunk_2",
    "frame_end",
    "fetch_ok",
    "aborted",
    "status",
    "event",
    "pong",
    "error",
];

fn vector(name: &str) -> (u16, Vec<u8>) {
    let bytes = a3dp(name);
    (u16::from_le_bytes([bytes[6], bytes[7]]), bytes[HEADER_BYTES..].to_vec())
}

fn client(name: &str) -> ClientMessage {
    let (kind, payload) = vector(name);
    ClientMessage::decode(kind, &payload).unwrap().unwrap()
}

/// What the server says in a vector, compared while its bytes live.
fn server(name: &str, check: impl FnOnce(ServerMessage<'_>)) {
    let (kind, payload) = vector(name);
    check(ServerMessage::decode(kind, &payload).unwrap().unwrap());
}

#[test]
fn every_message_of_the_page_is_read_and_said_again_byte_for_byte() {
    for name in CLIENT.into_iter().chain(["ping", "pong", "error"]) {
        let (kind, payload) = vector(name);
        let message = ClientMessage::decode(kind, &payload).unwrap().unwrap();
        let mut again = Vec::new();
        message.encode(&mut again);
        assert_eq!((message.kind(), &again), (kind, &payload), "{name}");
    }
    for name in SERVER.into_iter().chain(["ping", "bye"]) {
        let (kind, payload) = vector(name);
        let message = ServerMessage::decode(kind, &payload).unwrap().unwrap();
        let mut again = Vec::new();
        message.encode(&mut again);
        assert_eq!((message.kind(), &again), (kind, &payload), "{name}");
    }
}

#[test]
fn no_vector_of_the_page_is_left_out() {
    let page = include_str!("../../../docs/protocols/camera.md");
    for line in page.lines().filter_map(|line| line.strip_prefix("```hex ")) {
        let known = CLIENT.contains(&line) || SERVER.contains(&line) || line == "ping";
        assert!(known, "{line}");
    }
}

#[test]
fn what_the_client_says_means_what_the_page_says() {
    assert_eq!(
        client("hello"),
        ClientMessage::Hello(Hello::controller(0xB1AD_E5CA_0000_0001, "bladescan"))
    );
    assert_eq!(client("configure"), ClientMessage::Configure(PAGE_SETTINGS));
    assert_eq!(
        client("arm"),
        ClientMessage::Arm(Arm {
            mode: Arm::SOFTWARE,
            config_id: 77
        })
    );
    assert_eq!(
        client("trigger"),
        ClientMessage::Trigger(Trigger {
            trigger_id: TriggerId::new(5, 1),
            view_id: 5,
            config_id: 77,
            deadline_ms: 15_000,
            tag: "view 5".into(),
        })
    );
    assert_eq!(
        client("fetch"),
        ClientMessage::Fetch {
            trigger_id: PAGE_TRIGGER
        }
    );
    assert_eq!(
        client("abort"),
        ClientMessage::Abort {
            trigger_id: TRIGGER_ALL
        }
    );
    assert_eq!(client("ping"), ClientMessage::Ping { sender_ns: 123_456_789 });
    let done = "done".to_owned();
    assert_eq!(
        client("bye"),
        ClientMessage::Bye(Bye {
            reason: Bye::DONE,
            text: done
        })
    );
}

#[test]
fn the_greeting_and_the_capabilities_keep_every_field() {
    server("hello_ok", |message| {
        let ServerMessage::HelloOk(greeting) = message else {
            panic!()
        };
        assert!(greeting.simulated);
        assert_eq!((greeting.session_id, greeting.boot_id), (7, 0x1122_3344_5566_7788));
        assert_eq!((greeting.calibration_id, greeting.calibration_date), (4242, 20_261_121));
        assert_eq!((greeting.clock_hz, greeting.frame_bytes_max), (1_000_000_000, 64 << 20));
        assert_eq!(
            (greeting.serial.as_str(), greeting.sdk_version.as_str()),
            ("SIM-0001", "none")
        );
    });
    server("caps", |message| {
        let ServerMessage::Caps(caps) = message else { panic!() };
        assert_eq!((caps.sensor_px, caps.optics.as_str()), ([1440, 1080], "fine"));
        assert_eq!((caps.roi_min_px, caps.roi_step_px), ([80, 4], [8, 4]));
        assert_eq!(
            (caps.exposure_min_us, caps.exposure_max_us, caps.exposure_default_us),
            (10, 50_000, 1000)
        );
        assert_eq!(
            (caps.image_count_min, caps.image_count_max, caps.image_count_default),
            (12, 60, 24)
        );
        assert_eq!((caps.led_max_percent, caps.led_recommended_percent), (100, 25));
        assert_eq!((caps.hdr_slot_count, caps.hdr_in_free_run), (2, false));
        assert_eq!(caps.working_distance_mm, [200.0, 260.0, 320.0]);
        assert_eq!((caps.camera_1_mm, caps.camera_2_mm), ([0.0; 3], [100.0, 0.0, 0.0]));
        assert_eq!((caps.projector_mm, caps.spacing_mm), ([50.0, 0.0, 0.0], 0.04));
        let masks = [
            caps.components,
            caps.outlier_filters,
            caps.compressions,
            caps.working_volumes,
        ];
        assert_eq!(masks, [0b10101, 0b1111, 0b1111, 0b11]);
    });
    server("configured", |message| {
        let ServerMessage::Configured(configured) = message else {
            panic!()
        };
        assert_eq!((configured.config_id, configured.settings), (77, PAGE_SETTINGS));
        assert_eq!(
            (configured.predicted_exposure_us, configured.frame_bytes),
            (108_000, 5_443_200)
        );
    });
}

#[test]
fn an_acquisition_keeps_every_field() {
    server("armed", |message| {
        assert_eq!(
            message,
            ServerMessage::Armed {
                state: CameraState::Armed
            }
        )
    });
    server("disarmed", |message| {
        assert_eq!(
            message,
            ServerMessage::Disarmed {
                state: CameraState::Idle
            }
        );
    });
    server("trigger_ok", |message| {
        let expected = TriggerOk {
            trigger_id: PAGE_TRIGGER,
            repeated: Repeated::New,
            predicted_exposure_us: 108_000,
            predicted_total_us: 208_000,
        };
        assert_eq!(message, ServerMessage::TriggerOk(expected));
    });
    server("exposure_done", |message| {
        let expected = ExposureDone {
            trigger_id: PAGE_TRIGGER,
            exposure_begin_ns: 1_000_000,
            exposure_end_ns: 2_000_000,
        };
        assert_eq!(message, ServerMessage::ExposureDone(expected));
    });
    server("fetch_ok", |message| {
        let expected = FetchOk {
            trigger_id: PAGE_TRIGGER,
            state: FetchState::InFlight,
            remaining_us: 90_000,
        };
        assert_eq!(message, ServerMessage::FetchOk(expected));
    });
    server("aborted", |message| {
        let expected = Aborted {
            trigger_id: PAGE_TRIGGER.0,
            phase: AcquisitionPhase::Exposure,
        };
        assert_eq!(message, ServerMessage::Aborted(expected));
    });
}

#[test]
fn a_frame_keeps_every_field() {
    server("frame_begin", |message| {
        let ServerMessage::FrameBegin(begin) = message else {
            panic!()
        };
        assert_eq!((begin.frame_id, begin.view_id, begin.config_id), (9, 5, 77));
        assert_eq!(
            (begin.exposure_begin_ns, begin.reconstruction_end_ns),
            (1_000_000, 3_000_000)
        );
        assert_eq!((begin.width_px, begin.height_px, begin.valid_count), (2, 1, 1));
        assert_eq!((begin.scale, begin.offset), ([1.0; 3], [0.0; 3]));
        let flags = FrameFlags {
            pass_count: 1,
            binned: true,
            degraded: false,
            warm_up_incomplete: false,
            simulated: true,
        };
        assert_eq!(begin.flags, flags);
        assert_eq!(begin.temperature_c, [Some(35.5), Some(30.0), Some(30.25), None]);
        let kinds: Vec<ComponentKind> = begin.components.iter().map(|component| component.kind).collect();
        assert_eq!(
            kinds,
            [ComponentKind::Xyz, ComponentKind::Intensity, ComponentKind::Mask]
        );
        assert_eq!(begin.components[0].byte_count, 24);
    });
    server("frame_chunk_1", |message| {
        let ServerMessage::FrameChunk(chunk) = message else {
            panic!()
        };
        assert_eq!((chunk.component_index, chunk.data), (1, &[200, 10][..]));
    });
    server("frame_end", |message| {
        let ServerMessage::FrameEnd(end) = message else {
            panic!()
        };
        assert_eq!((end.status, end.trigger_id), (FrameStatus::Complete, PAGE_TRIGGER));
        assert_eq!((end.components.len(), end.components[0].byte_count), (3, 24));
    });
}

#[test]
fn condition_event_and_error_keep_every_field() {
    server("status", |message| {
        let ServerMessage::Status(status) = message else {
            panic!()
        };
        assert_eq!((status.state, status.temperature_c[3]), (CameraState::Armed, None));
        assert_eq!((status.warm_up_done_s, status.warm_up_required_s), (2400, 2400));
        assert_eq!(
            (status.trigger_count, status.frame_count, status.link_mbit_s),
            (6, 6, 1000)
        );
    });
    server("event", |message| {
        let ServerMessage::Event(event) = message else { panic!() };
        assert_eq!(
            (event.code, event.trigger_id),
            (DeviceEvent::COOLDOWN_PAUSE, TRIGGER_ALL)
        );
        assert_eq!((event.device_ns, event.duration_ms), (5_000_000, 200));
        assert_eq!(event.text, "LED pause 200 ms");
    });
    server("pong", |message| {
        let expected = Pong {
            sender_ns: 123_456_789,
            device_ns: 6_000_000,
            host_ns: 7_000_000,
        };
        assert_eq!(message, ServerMessage::Pong(expected));
    });
    server("error", |message| {
        let ServerMessage::Error(error) = message else { panic!() };
        assert_eq!((error.code, error.retryable, error.about_request_id), (202, true, 5));
        assert_eq!(
            (error.phase, error.text.as_str()),
            (AcquisitionPhase::Acknowledge, "not armed")
        );
    });
}

#[test]
fn cut_and_padded_payloads_are_refused_without_a_panic() {
    for name in CLIENT.into_iter().chain(["ping"]) {
        let (kind, payload) = vector(name);
        for length in 0..payload.len() {
            assert!(
                ClientMessage::decode(kind, &payload[..length]).is_err(),
                "{name} cut to {length}"
            );
        }
        let padded = [&payload[..], &[0]].concat();
        assert!(ClientMessage::decode(kind, &padded).is_err(), "{name} padded");
    }
    for name in SERVER.into_iter().filter(|name| !name.starts_with("frame_chunk")) {
        let (kind, payload) = vector(name);
        for length in 0..payload.len() {
            assert!(
                ServerMessage::decode(kind, &payload[..length]).is_err(),
                "{name} cut to {length}"
            );
        }
        let padded = [&payload[..], &[0]].concat();
        assert!(ServerMessage::decode(kind, &padded).is_err(), "{name} padded");
    }
}

#[test]
fn components_of_every_kind_may_come_in_ascending_order_only() {
    let (_, payload) = vector("frame_begin");
    let Ok(Some(ServerMessage::FrameBegin(mut begin))) = ServerMessage::decode(0x30, &payload) else {
        panic!()
    };
    begin.components = ComponentKind::ALL
        .map(|kind| Component {
            kind,
            chunk_count: 1,
            byte_count: 2 * kind.pixel_bytes(),
        })
        .to_vec();
    let said = |begin: &FrameBegin| {
        let mut bytes = Vec::new();
        ServerMessage::FrameBegin(Box::new(begin.clone())).encode(&mut bytes);
        bytes
    };
    let expected = begin.clone();
    assert_eq!(
        ServerMessage::decode(0x30, &said(&begin)),
        Ok(Some(ServerMessage::FrameBegin(expected)))
    );
    begin.components.swap(1, 2);
    assert!(ServerMessage::decode(0x30, &said(&begin)).is_err());
}

#[test]
fn a_whole_vector_is_its_message_in_a_frame() {
    let bytes = a3dp("hello");
    let message = client("hello");
    let mut payload = Vec::new();
    message.encode(&mut payload);
    let frame = WireFrame {
        kind: message.kind(),
        request_id: 1,
        flags: 0,
        payload: &payload,
    };
    assert_eq!(FrameWriter::default().write(&frame), bytes);
}

#[test]
fn every_type_has_the_name_that_the_page_gives_it() {
    let page = include_str!("../../../docs/protocols/camera.md");
    let mut found = Vec::new();
    for row in page.lines() {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let ["", number, name, "client" | "server" | "either", ..] = cells[..] else {
            continue;
        };
        let number = number.strip_prefix("0x").unwrap();
        let kind = u16::from_str_radix(number, 16).unwrap();
        assert_eq!(message_name(kind), name);
        found.push(kind);
    }
    let named: Vec<u16> = (0..=u16::MAX)
        .filter(|&kind| message_name(kind) != "unknown type")
        .collect();
    assert_eq!(found, named);
}
