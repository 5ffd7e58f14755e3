//! The conversation against a server that is played message by message.

mod acquiring;
mod device;
mod opening;
mod reconnecting;

use super::*;
use crate::camera::code;
use crate::camera::message::{
    Aborted, AcquisitionPhase, CameraError, CameraState, CameraStatus, DeviceEvent, ExposureDone, FetchOk, FetchState,
    FrameBegin, Pong, Repeated, ServerMessage, TriggerOk,
};
use crate::camera::settings::tests::PAGE_SETTINGS;
use crate::camera::wire::{FLAG_REPLY, FrameReader, FrameWriter, HEADER_BYTES, WireFrame};
use crate::vectors::a3dp;

const TIMES: ExchangeSettings = ExchangeSettings {
    connect_timeout_ms: 3000,
    reply_timeout_ms: 5000,
    frame_timeout_extra_ms: 2000,
    ping_interval_ms: 1000,
    dead_after_ms: 5000,
    reconnect_timeout_ms: 60_000,
    device_timeout_ms: 60_000,
};
const RUN_ID: u64 = 0x77;
/// The acquisition of the page's frame.
const TRIGGER: TriggerId = TriggerId(5 << 16 | 1);
const FRAME: [&str; 5] = [
    "frame_begin",
    "frame_chunk_0",
    "frame_chunk_1",
    "frame_chunk_2",
    "frame_end",
];

/// A conversation and the server's side of it.
struct Bench {
    exchange: Exchange,
    ms: u64,
    writer: FrameWriter,
    reader: FrameReader,
    greeting: Greeting,
    caps: Caps,
    /// What comes of the next CONFIGURE.
    config_id: u32,
    connect_count: usize,
    connect_times_ms: Vec<u64>,
    /// What the client has said and nobody has answered.
    heard: Vec<(u32, ClientMessage)>,
    /// Everything it has said, in words.
    said: Vec<&'static str>,
    events: Vec<CameraEvent>,
}

impl Bench {
    /// Not connected yet.
    fn new(planned: Vec<CameraSettings>) -> Self {
        let exchange = Exchange::new(TIMES, RUN_ID, Seed(1), planned);
        let mut bench = Self {
            exchange,
            ms: 0,
            writer: FrameWriter::default(),
            reader: FrameReader::default(),
            greeting: vector_greeting(),
            caps: vector_caps(),
            config_id: 0x4D,
            connect_count: 0,
            connect_times_ms: Vec::new(),
            heard: Vec::new(),
            said: Vec::new(),
            events: Vec::new(),
        };
        bench.exchange.open(bench.now());
        bench.pump();
        bench
    }

    /// Armed with the page's settings.
    fn armed() -> Self {
        let mut bench = Self::new(vec![PAGE_SETTINGS]);
        bench.connect();
        bench.serve();
        assert!(bench.exchange.is_armed());
        bench.said.clear();
        bench
    }

    /// With the page's trigger accepted.
    fn exposing() -> Self {
        let mut bench = Self::armed();
        bench.exchange.trigger(bench.now(), TRIGGER);
        bench.pump();
        let (request_id, _) = bench.heard.pop().unwrap();
        bench.reply(request_id, &trigger_ok(Repeated::New));
        bench.said.clear();
        bench
    }

    fn now(&self) -> Stamp {
        Stamp::START.plus_ms(self.ms)
    }

    /// Takes what the conversation wants done.
    fn pump(&mut self) {
        while let Some(output) = self.exchange.poll_output() {
            match output {
                CameraOutput::Connect => {
                    self.connect_count += 1;
                    self.connect_times_ms.push(self.ms);
                    self.heard.clear();
                }
                CameraOutput::Close => {}
                CameraOutput::Bytes { bytes, act } => {
                    self.reader.push(&bytes);
                    let frame = self.reader.next_frame().unwrap().unwrap();
                    let message = ClientMessage::decode(frame.kind, frame.payload).unwrap().unwrap();
                    assert_eq!(act, matches!(message, ClientMessage::Trigger(_)), "{message:?}");
                    if !matches!(message, ClientMessage::Ping { .. } | ClientMessage::GetStatus) {
                        self.said.push(name(&message));
                    }
                    // Its answer changes nothing here.
                    if !matches!(message, ClientMessage::GetStatus) {
                        self.heard.push((frame.request_id, message));
                    }
                }
            }
        }
        self.events.extend(std::iter::from_fn(|| self.exchange.poll_event()));
    }

    fn connect(&mut self) {
        (self.writer, self.reader) = Default::default();
        self.exchange.handle_connected(self.now());
        self.pump();
    }

    /// Answers what a willing server answers at once. FETCH and TRIGGER stay.
    fn serve(&mut self) {
        loop {
            let index = self.heard.iter().position(|(_, message)| {
                !matches!(
                    message,
                    ClientMessage::Fetch { .. }
                        | ClientMessage::Trigger(_)
                        | ClientMessage::Bye(_)
                        | ClientMessage::Error(_)
                )
            });
            let Some(index) = index else { return };
            let (request_id, message) = self.heard.remove(index);
            let state = CameraState::Idle;
            let answer = match message {
                ClientMessage::Hello(_) => ServerMessage::HelloOk(self.greeting.clone()),
                ClientMessage::GetCaps => ServerMessage::Caps(self.caps.clone()),
                ClientMessage::Configure(settings) => {
                    self.config_id += 1;
                    ServerMessage::Configured(Configured {
                        config_id: self.config_id - 1,
                        predicted_exposure_us: 108_000,
                        predicted_total_us: 208_000,
                        frame_bytes: 28,
                        settings,
                    })
                }
                ClientMessage::Arm(_) => ServerMessage::Armed { state },
                ClientMessage::Disarm => ServerMessage::Disarmed { state },
                ClientMessage::Abort { trigger_id } => ServerMessage::Aborted(Aborted {
                    trigger_id,
                    phase: AcquisitionPhase::None,
                }),
                ClientMessage::Ping { sender_ns } => ServerMessage::Pong(Pong {
                    sender_ns,
                    device_ns: sender_ns + CLOCK_AHEAD_NS,
                    host_ns: 0,
                }),
                other => panic!("nothing answers {other:?}"),
            };
            self.reply(request_id, &answer);
        }
    }

    fn reply(&mut self, request_id: u32, message: &ServerMessage<'_>) {
        let bytes = self
            .writer
            .write_with(message.kind(), request_id, FLAG_REPLY, |payload| {
                message.encode(payload)
            });
        self.receive(&bytes);
    }

    /// Says something by itself.
    fn say(&mut self, message: &ServerMessage<'_>) {
        let bytes = self
            .writer
            .write_with(message.kind(), 0, 0, |payload| message.encode(payload));
        self.receive(&bytes);
    }

    /// Says a message of the page, renumbered to fit.
    fn say_vector(&mut self, name: &str) {
        let bytes = a3dp(name);
        let bytes = self.writer.write(&WireFrame {
            kind: u16::from_le_bytes([bytes[6], bytes[7]]),
            request_id: 0,
            flags: u16::from_le_bytes([bytes[20], bytes[21]]),
            payload: &bytes[HEADER_BYTES..],
        });
        self.receive(&bytes);
    }

    fn receive(&mut self, bytes: &[u8]) {
        self.exchange.handle_bytes(self.now(), bytes);
        self.pump();
    }

    /// Says the page's frame.
    fn say_frame(&mut self) {
        for name in FRAME {
            self.say_vector(name);
        }
    }

    fn lose_connection(&mut self) {
        self.exchange.handle_closed(self.now(), "reset by peer");
        self.pump();
    }

    /// Lets time pass, wake by wake.
    fn pass_ms(&mut self, ms: u64) {
        let end = self.ms + ms;
        while let Some(wake) = self
            .exchange
            .wake_at()
            .filter(|wake| *wake <= Stamp::START.plus_ms(end))
        {
            self.ms = self.ms.max(wake.ns.div_ceil(1_000_000));
            self.exchange.handle_wake(self.now());
            self.pump();
        }
        self.ms = end;
    }

    /// Lets time pass with a sign of life of the server every half second.
    fn pass_alive_ms(&mut self, ms: u64) {
        for _ in 0..ms / 500 {
            self.pass_ms(500);
            self.say(&status(CameraState::Armed));
            self.serve();
        }
        self.pass_ms(ms % 500);
    }

    /// What it has said since it was last asked, in words, without pings.
    fn take_said(&mut self) -> Vec<&'static str> {
        std::mem::take(&mut self.said)
    }

    fn take_events(&mut self) -> Vec<CameraEvent> {
        std::mem::take(&mut self.events)
    }

    fn lost(&self) -> Option<&Trouble> {
        self.events.iter().find_map(|event| match event {
            CameraEvent::Lost(trouble) => Some(trouble),
            _ => None,
        })
    }
}

fn vector_greeting() -> Greeting {
    let bytes = a3dp("hello_ok");
    match ServerMessage::decode(0x02, &bytes[HEADER_BYTES..]).unwrap() {
        Some(ServerMessage::HelloOk(greeting)) => greeting,
        other => panic!("{other:?}"),
    }
}

fn vector_caps() -> Caps {
    let bytes = a3dp("caps");
    match ServerMessage::decode(0x04, &bytes[HEADER_BYTES..]).unwrap() {
        Some(ServerMessage::Caps(caps)) => caps,
        other => panic!("{other:?}"),
    }
}

fn vector_frame_begin() -> FrameBegin {
    let bytes = a3dp("frame_begin");
    match ServerMessage::decode(0x30, &bytes[HEADER_BYTES..]).unwrap() {
        Some(ServerMessage::FrameBegin(begin)) => *begin,
        other => panic!("{other:?}"),
    }
}

fn trigger_ok(repeated: Repeated) -> ServerMessage<'static> {
    ServerMessage::TriggerOk(TriggerOk {
        trigger_id: TRIGGER,
        repeated,
        predicted_exposure_us: 108_000,
        predicted_total_us: 208_000,
    })
}

fn exposure_done() -> ServerMessage<'static> {
    ServerMessage::ExposureDone(ExposureDone {
        trigger_id: TRIGGER,
        exposure_begin_ns: 0,
        exposure_end_ns: CLOCK_AHEAD_NS + 2_000_000,
    })
}

fn fetch_ok(state: FetchState, remaining_us: u32) -> ServerMessage<'static> {
    ServerMessage::FetchOk(FetchOk {
        trigger_id: TRIGGER,
        state,
        remaining_us,
    })
}

fn error(about: TriggerId, code: u16, retry_after_ms: u32) -> ServerMessage<'static> {
    ServerMessage::Error(CameraError {
        about_request_id: 0,
        trigger_id: about.0,
        code,
        phase: AcquisitionPhase::None,
        retryable: true,
        retry_after_ms,
        vendor_code: 0,
        text: code::name(code).unwrap().into(),
    })
}

fn device_event(code: u16, duration_ms: u32) -> ServerMessage<'static> {
    ServerMessage::Event(DeviceEvent {
        code,
        trigger_id: TRIGGER_ALL,
        device_ns: 0,
        duration_ms,
        text: "said by the device".into(),
    })
}

fn status(state: CameraState) -> ServerMessage<'static> {
    ServerMessage::Status(CameraStatus {
        state,
        queue_count: 0,
        temperature_c: [None; 4],
        warm_up_done_s: 0,
        warm_up_required_s: 0,
        trigger_count: 0,
        frame_count: 0,
        missed_count: 0,
        vendor_timeout_count: 0,
        lost_packet_count: 0,
        link_mbit_s: 0,
        last_error: 0,
    })
}

fn name(message: &ClientMessage) -> &'static str {
    match message {
        ClientMessage::Hello(_) => "hello",
        ClientMessage::GetCaps => "get-caps",
        ClientMessage::Configure(_) => "configure",
        ClientMessage::Arm(_) => "arm",
        ClientMessage::Disarm => "disarm",
        ClientMessage::Trigger(_) => "trigger",
        ClientMessage::Fetch { .. } => "fetch",
        ClientMessage::Abort { .. } => "abort",
        ClientMessage::GetStatus => "get-status",
        ClientMessage::Ping { .. } => "ping",
        ClientMessage::Pong(_) => "pong",
        ClientMessage::Error(_) => "error",
        ClientMessage::Bye(_) => "bye",
    }
}

/// How far the server's clock is ahead of the run's.
const CLOCK_AHEAD_NS: u64 = 7_000_000_000;
