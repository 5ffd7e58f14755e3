//! The bridge in virtual time: clients on one side, lines of the vendor's side on the other.

mod acquisitions;
mod conformance;
mod device;
mod sessions;

use super::*;
use crate::camera::message::{
    Aborted, AcquisitionPhase, Arm, Bye, CameraError, ClientMessage, DeviceEvent, FetchState, Hello, Repeated,
    TRIGGER_ALL, Trigger,
};
use crate::camera::settings::tests::PAGE_SETTINGS;
use crate::camera::wire::{FLAG_ERROR, FLAG_LAST, FLAG_REPLY, FrameReader, FrameWriter};
use crate::camera::{
    Assembly, CameraEvent, CameraOutput, CameraSettings, Exchange, ExchangeSettings, FrameEnd, FrameStatus,
};
use crate::seed::Seed;

const SETTINGS: CameraSettings = CameraSettings {
    binning: false,
    roi_px: [80, 4, 0, 0, 0, 0],
    ..PAGE_SETTINGS
};
const PIXELS: usize = 320;
const RUN: u64 = 11;

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

fn config() -> BridgeConfig {
    BridgeConfig::parse(include_str!("../../../../config/bridges/a5000.toml")).unwrap()
}

fn picture(xyz: f32) -> Picture {
    Picture {
        width_px: 80,
        height_px: 4,
        xyz: vec![xyz; 3 * PIXELS]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
        intensity: vec![100; PIXELS],
        confidence: None,
        mask: vec![0; PIXELS],
        valid_count: PIXELS as u32,
    }
}

/// A message heard, with what the tests look at of its frame; chunks only as their length.
#[derive(Debug, Clone, PartialEq)]
enum Heard {
    Message(ServerMessage<'static>, u16),
    Chunk(usize),
}

/// One client's end of a connection.
struct Client {
    id: ConnectionId,
    reader: FrameReader,
    writer: FrameWriter,
    next_request_id: u32,
    heard: VecDeque<Heard>,
    closed: bool,
}

/// The bridge with its clients and its orders to the vendor's side.
struct Bench {
    bridge: Bridge,
    clients: Vec<Client>,
    orders: Vec<String>,
    conversions: Vec<Conversion>,
    starts: usize,
}

impl Bench {
    /// A bridge whose device is there.
    fn new() -> Self {
        let mut bench = Self {
            bridge: Bridge::new(&config(), 5),
            clients: Vec::new(),
            orders: Vec::new(),
            conversions: Vec::new(),
            starts: 0,
        };
        bench.bridge.handle_wake(at(0));
        bench.run(at(0));
        assert_eq!((bench.starts, bench.bridge.is_ready()), (1, false));
        bench.say_vendor(
            at(0),
            r#"{"is":"ready","vendor":"V","model":"M","serial":"S","says_exposed":true}"#,
        );
        assert!(bench.bridge.is_ready());
        bench
    }

    fn say_vendor(&mut self, now: Stamp, line: &str) {
        self.bridge.handle_line(now, line);
        self.run(now);
    }

    fn connect(&mut self, now: Stamp) -> usize {
        let id = ConnectionId(self.clients.len() as u64 + 1);
        self.bridge.handle_connected(now, id, "somewhere");
        self.clients.push(Client {
            id,
            reader: FrameReader::default(),
            writer: FrameWriter::default(),
            next_request_id: 1,
            heard: VecDeque::new(),
            closed: false,
        });
        self.run(now);
        self.clients.len() - 1
    }

    /// Carries out what the bridge wants, at once.
    fn run(&mut self, now: Stamp) {
        while let Some(output) = self.bridge.poll_output() {
            match output {
                BridgeOutput::Bytes { connection, bytes } => {
                    let client = self.clients.iter_mut().find(|client| client.id == connection).unwrap();
                    client.hear(&bytes);
                    self.bridge.handle_written(now, connection, bytes.len());
                }
                BridgeOutput::Close { connection } => {
                    let client = self.clients.iter_mut().find(|client| client.id == connection).unwrap();
                    client.closed = true;
                    self.bridge.handle_closed(now, connection);
                }
                BridgeOutput::Line(line) => self.orders.push(line),
                BridgeOutput::Convert(conversion) => self.conversions.push(*conversion),
                BridgeOutput::StartVendor => self.starts += 1,
                BridgeOutput::Note(_) => {}
            }
        }
    }

    fn send(&mut self, now: Stamp, client: usize, message: &ClientMessage) {
        let Client {
            id,
            writer,
            next_request_id,
            ..
        } = &mut self.clients[client];
        let bytes = writer.write_with(message.kind(), *next_request_id, 0, |payload| message.encode(payload));
        *next_request_id += 1;
        let id = *id;
        self.bridge.handle_bytes(now, id, &bytes);
        self.run(now);
    }

    /// Sends a request and gives the reply; nothing else may have come.
    fn ask(&mut self, now: Stamp, client: usize, message: &ClientMessage) -> ServerMessage<'static> {
        self.send(now, client, message);
        self.reply(client)
    }

    fn reply(&mut self, client: usize) -> ServerMessage<'static> {
        match self.clients[client].heard.pop_front() {
            Some(Heard::Message(message, flags)) => {
                assert_eq!(flags & FLAG_REPLY, FLAG_REPLY, "{message:?}");
                message
            }
            other => panic!("{other:?}"),
        }
    }

    fn refused(&mut self, now: Stamp, client: usize, message: &ClientMessage) -> u16 {
        match self.ask(now, client, message) {
            ServerMessage::Error(error) => error.code,
            other => panic!("{other:?}"),
        }
    }

    /// Everything heard since, without STATUS.
    fn heard(&mut self, client: usize) -> Vec<Heard> {
        let heard = self.clients[client].heard.drain(..);
        heard
            .filter(|heard| !matches!(heard, Heard::Message(ServerMessage::Status(_), _)))
            .collect()
    }

    fn controller(&mut self, now: Stamp) -> usize {
        let client = self.connect(now);
        let greeting = self.ask(now, client, &ClientMessage::Hello(Hello::controller(RUN, "test")));
        assert!(matches!(greeting, ServerMessage::HelloOk(_)), "{greeting:?}");
        client
    }

    fn configured(&mut self, now: Stamp, client: usize) -> u32 {
        self.send(now, client, &ClientMessage::Configure(SETTINGS));
        let config_id = self.bridge.next_config_id - 1;
        self.say_vendor(now, &format!(r#"{{"is":"configured","config_id":{config_id}}}"#));
        let ServerMessage::Configured(configured) = self.reply(client) else {
            panic!()
        };
        assert_eq!((configured.config_id, configured.settings), (config_id, SETTINGS));
        config_id
    }

    fn arm(&mut self, now: Stamp, client: usize) -> u32 {
        let config_id = self.configured(now, client);
        let arm = Arm {
            mode: Arm::SOFTWARE,
            config_id,
        };
        let armed = self.ask(now, client, &ClientMessage::Arm(arm));
        assert_eq!(
            armed,
            ServerMessage::Armed {
                state: CameraState::Armed
            }
        );
        config_id
    }

    /// A bench with an armed controller: client 0.
    fn armed() -> Self {
        let mut bench = Self::new();
        let client = bench.controller(at(0));
        bench.arm(at(0), client);
        bench
    }

    fn expose(&mut self, now: Stamp) {
        let acquisition = self.bridge.next_acquisition - 1;
        self.say_vendor(now, &format!(r#"{{"is":"exposed","acquisition":{acquisition}}}"#));
    }

    fn finish(&mut self, now: Stamp) {
        let acquisition = self.bridge.next_acquisition - 1;
        self.say_vendor(
            now,
            &format!(r#"{{"is":"frame","acquisition":{acquisition},"esm":"a"}}"#),
        );
        assert!(self.conversions.pop().is_some());
        self.bridge
            .handle_picture(now, acquisition, Ok(picture(acquisition as f32)));
        self.run(now);
    }

    /// One whole acquisition of client 0.
    fn acquire(&mut self, now: Stamp, trigger_id: u64) {
        let accepted = self.ask(now, 0, &trigger(trigger_id));
        assert!(matches!(accepted, ServerMessage::TriggerOk(_)), "{accepted:?}");
        self.finish(now);
        let end = self.heard(0).pop();
        assert!(
            matches!(end, Some(Heard::Message(ServerMessage::FrameEnd(_), FLAG_LAST))),
            "{end:?}"
        );
    }
}

impl Client {
    fn hear(&mut self, bytes: &[u8]) {
        self.reader.push(bytes);
        while let Some(frame) = self.reader.next_frame().unwrap() {
            let heard = match ServerMessage::decode(frame.kind, frame.payload).unwrap().unwrap() {
                ServerMessage::FrameChunk(chunk) => Heard::Chunk(chunk.data.len()),
                message => Heard::Message(owned(message), frame.flags),
            };
            self.heard.push_back(heard);
        }
    }
}

/// Every message but a chunk owns what it has.
fn owned(message: ServerMessage<'_>) -> ServerMessage<'static> {
    let mut bytes = Vec::new();
    message.encode(&mut bytes);
    let bytes: &'static [u8] = bytes.leak();
    ServerMessage::decode(message.kind(), bytes).unwrap().unwrap()
}

fn trigger(trigger_id: u64) -> ClientMessage {
    ClientMessage::Trigger(Trigger {
        trigger_id: TriggerId(trigger_id),
        view_id: 3,
        config_id: 1,
        deadline_ms: 0,
        tag: "view".into(),
    })
}

fn fetch(trigger_id: u64) -> ClientMessage {
    ClientMessage::Fetch {
        trigger_id: TriggerId(trigger_id),
    }
}

const ABORT: ClientMessage = ClientMessage::Abort {
    trigger_id: TRIGGER_ALL,
};

fn error_of(heard: &[Heard]) -> CameraError {
    match heard {
        [Heard::Message(ServerMessage::Error(error), FLAG_ERROR)] => error.clone(),
        other => panic!("{other:?}"),
    }
}

fn kinds(heard: &[Heard]) -> Vec<u16> {
    let kind = |heard: &Heard| match heard {
        Heard::Message(message, _) => message.kind(),
        Heard::Chunk(_) => 0x31,
    };
    heard.iter().map(kind).collect()
}

/// FRAME_BEGIN, a chunk of each component, FRAME_END.
const WHOLE: [u16; 5] = [0x30, 0x31, 0x31, 0x31, 0x32];
