use super::*;
use crate::camera::settings::difference;
use crate::camera::settings::tests::PAGE_SETTINGS;
use crate::camera::wire::{HEADER_BYTES, WireFrame};
use crate::vectors::a3dp;

const TIMES: ExchangeSettings = ExchangeSettings {
    connect_timeout_ms: 3000,
    reply_timeout_ms: 5000,
    frame_timeout_extra_ms: 2000,
    ping_interval_ms: 1000,
    dead_after_ms: 5000,
};
const PAGE_TRIGGER: TriggerId = TriggerId(5 << 16 | 1);

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

/// Plays the server's side from the page's vectors, renumbered to fit the conversation.
struct Server {
    writer: FrameWriter,
}

impl Server {
    fn says(&mut self, name: &str, request_id: u32) -> Vec<u8> {
        let bytes = a3dp(name);
        self.writer.write(&WireFrame {
            kind: u16::from_le_bytes([bytes[6], bytes[7]]),
            request_id,
            flags: u16::from_le_bytes([bytes[20], bytes[21]]),
            payload: &bytes[HEADER_BYTES..],
        })
    }
}

fn armed() -> (Exchange, Server) {
    let mut exchange = Exchange::new(TIMES, PAGE_SETTINGS);
    let mut server = Server {
        writer: FrameWriter::default(),
    };
    exchange.open(at(0));
    assert_eq!(exchange.poll_output(), Some(CameraOutput::Connect));
    exchange.handle_connected(at(1));
    for (request_id, name) in [(1, "hello_ok"), (2, "caps"), (3, "configured"), (4, "armed")] {
        let bytes = server.says(name, request_id);
        exchange.handle_bytes(at(2), &bytes);
    }
    assert!(matches!(exchange.poll_event(), Some(CameraEvent::Ready(_))));
    assert!(exchange.is_armed());
    (exchange, server)
}

fn events(exchange: &mut Exchange) -> Vec<CameraEvent> {
    std::iter::from_fn(|| exchange.poll_event()).collect()
}

#[test]
fn the_opening_and_a_whole_frame_of_the_page_go_through() {
    let (mut exchange, mut server) = armed();
    exchange.trigger(at(10), PAGE_TRIGGER);
    for (request_id, name) in [
        (5, "trigger_ok"),
        (0, "exposure_done"),
        (0, "status"),
        (0, "frame_begin"),
        (0, "frame_chunk_0"),
        (0, "frame_chunk_1"),
        (0, "frame_chunk_2"),
        (0, "frame_end"),
    ] {
        let bytes = server.says(name, request_id);
        exchange.handle_bytes(at(20), &bytes);
    }
    let events = events(&mut exchange);
    assert!(matches!(events[0], CameraEvent::ExposureDone { trigger_id } if trigger_id == PAGE_TRIGGER));
    assert!(matches!(events[1], CameraEvent::Status(_)));
    assert!(matches!(&events[2], CameraEvent::Frame(capture) if capture.trigger_id == PAGE_TRIGGER));
    assert!(exchange.is_armed());
}

#[test]
fn only_the_trigger_is_an_act() {
    let (mut exchange, _) = armed();
    exchange.trigger(at(10), PAGE_TRIGGER);
    exchange.leave(at(11));
    let acts: Vec<bool> = std::iter::from_fn(|| exchange.poll_output())
        .filter_map(|output| match output {
            CameraOutput::Bytes { act, .. } => Some(act),
            _ => None,
        })
        .collect();
    assert_eq!(acts.iter().filter(|&&act| act).count(), 1);
    assert!(acts[4]); // after HELLO, GET_CAPS, CONFIGURE, ARM
}

#[test]
fn a_corrupt_byte_ends_the_connection_and_no_frame_comes_of_it() {
    let (mut exchange, mut server) = armed();
    exchange.trigger(at(10), PAGE_TRIGGER);
    let mut bytes = server.says("trigger_ok", 5);
    bytes[40] ^= 1;
    exchange.handle_bytes(at(11), &bytes);
    assert!(matches!(
        events(&mut exchange).as_slice(),
        [CameraEvent::Lost(Trouble::Protocol(_))]
    ));
    assert!(exchange.is_over());
}

#[test]
fn a_late_exposure_is_aborted_and_may_be_tried_again() {
    let (mut exchange, mut server) = armed();
    exchange.trigger(at(10), PAGE_TRIGGER);
    let bytes = server.says("trigger_ok", 5);
    exchange.handle_bytes(at(20), &bytes);
    // Predicted exposure 108 ms + 1 s; the camera is alive meanwhile.
    let bytes = server.says("status", 0);
    exchange.handle_bytes(at(1100), &bytes);
    exchange.handle_wake(at(1128));
    let bytes = server.says("aborted", 7);
    exchange.handle_bytes(at(1130), &bytes);
    let events = events(&mut exchange);
    assert!(
        matches!(events.last(), Some(CameraEvent::Failed { retryable: true, reason, .. }) if reason.contains("exposure"))
    );
    assert!(exchange.is_armed());
}

#[test]
fn a_silent_camera_is_pinged_and_then_lost() {
    let (mut exchange, _) = armed();
    let mut now = exchange.wake_at().unwrap();
    let mut pings = 0;
    while !exchange.is_over() {
        exchange.handle_wake(now);
        while let Some(output) = exchange.poll_output() {
            pings += usize::from(matches!(output, CameraOutput::Bytes { bytes, .. } if bytes[6] == 0x60));
        }
        now = exchange.wake_at().unwrap_or(now);
    }
    assert!(pings >= 4);
    assert_eq!(now.ms_since(at(2)), 5000);
    assert!(matches!(
        events(&mut exchange).as_slice(),
        [CameraEvent::Lost(Trouble::Silent(_))]
    ));
}

#[test]
fn an_echo_that_differs_is_trouble_named_by_its_setting() {
    let mut other = PAGE_SETTINGS;
    other.exposure_us = 999;
    assert_eq!(
        difference(&PAGE_SETTINGS, &other).unwrap(),
        "exposure_us: asked for 1000, in force 999"
    );
    assert_eq!(difference(&PAGE_SETTINGS, &PAGE_SETTINGS), None);
}
