mod faults;
mod phases;
mod runs;
mod session;
mod states;

use super::*;
use crate::camera::fields::{Field, Rest, Zero};
use crate::camera::message::{
    Aborted, Arm, Event, FetchOk, Hello, HelloOk, NO_TRIGGER, Pong, StateNow, Status, TriggerOk,
};
use crate::test_client::{Client, arm, configure, hello, hello_as, small_settings, trigger};
use crate::vectors::{CAMERA_PAGE, vector};

const MS_NS: u64 = 1_000_000;
const S_NS: u64 = 1_000_000_000;
const CLIENT: u64 = 1;

/// A camera, its clients, and virtual time.
struct Bench {
    device: Device,
    clients: BTreeMap<u64, Client>,
    /// Connection that asks.
    on: u64,
    now_ns: u64,
    jobs: Vec<u64>,
    exposed: Vec<u64>,
    closed: Vec<u64>,
    /// What came on the other connections.
    elsewhere: Vec<(u64, Message)>,
    /// Codes of what was wrong with the stream of a connection.
    broken: Vec<(u64, u16)>,
}

impl Bench {
    fn new(faults: &[&str]) -> Self {
        let mut bench = Self {
            device: Device::new(DeviceSettings {
                optics: Optics::fine(),
                speed: 1.0,
                boot_id: 9,
                faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
            }),
            clients: BTreeMap::new(),
            on: 0,
            now_ns: 0,
            jobs: Vec::new(),
            exposed: Vec::new(),
            closed: Vec::new(),
            elsewhere: Vec::new(),
            broken: Vec::new(),
        };
        bench.connect();
        bench
    }

    fn armed(faults: &[&str]) -> Self {
        let mut bench = Self::new(faults);
        bench.greet();
        bench.arm();
        bench
    }

    /// A new connection, which asks from now on.
    fn connect(&mut self) -> u64 {
        self.on += 1;
        while self.clients.contains_key(&self.on) {
            self.on += 1;
        }
        self.clients.insert(self.on, Client::default());
        self.device.handle_connected(self.now_ns, self.on);
        self.on
    }

    /// The connection that asks ends, and another takes its place.
    fn reconnect(&mut self) {
        self.device.handle_closed(self.now_ns, self.on);
        self.connect();
    }

    fn greet(&mut self) -> HelloOk {
        let Message::HelloOk(greeting) = self.ask(&hello()) else {
            panic!()
        };
        greeting
    }

    fn arm(&mut self) {
        let id = self.configure();
        assert_eq!(self.ask(&arm(id)), Message::Armed(state_now(2)));
    }

    fn configure(&mut self) -> u32 {
        match self.ask(&configure(&small_settings())) {
            Message::Configured(configured) => configured.config_id,
            other => panic!("{other:?}"),
        }
    }

    fn client(&mut self) -> &mut Client {
        self.clients.get_mut(&self.on).unwrap()
    }

    fn send(&mut self, message: &Message) -> Vec<Message> {
        let bytes = self.client().request(message);
        self.send_bytes(&bytes)
    }

    fn send_bytes(&mut self, bytes: &[u8]) -> Vec<Message> {
        self.device.handle_bytes(self.now_ns, self.on, bytes);
        self.receive()
    }

    /// The one answer to a request.
    fn ask(&mut self, message: &Message) -> Message {
        let mut answers = self.send(message);
        assert_eq!(answers.len(), 1, "{:x?}", names(&answers));
        answers.remove(0)
    }

    fn receive(&mut self) -> Vec<Message> {
        let mut messages = Vec::new();
        while let Some(output) = self.device.poll_output() {
            match output {
                DeviceOutput::Bytes { connection, bytes } => {
                    for read in self.clients.get_mut(&connection).unwrap().try_read(&bytes) {
                        match read {
                            Ok((_, message)) if connection == self.on => messages.push(message),
                            Ok((_, message)) => self.elsewhere.push((connection, message)),
                            Err(error) => self.broken.push((connection, error.code())),
                        }
                    }
                }
                DeviceOutput::Expose { job, .. } => self.jobs.push(job),
                DeviceOutput::Exposed { job } => self.exposed.push(job),
                DeviceOutput::Close { connection } => self.closed.push(connection),
                DeviceOutput::Violation(_) => (),
            }
        }
        messages
    }

    /// Lets time pass, each wake at its time; leaves out the signs of life.
    fn pass(&mut self, until_ns: u64) -> Vec<Message> {
        self.pass_with_signs_of_life(until_ns)
            .into_iter()
            .map(|(_, message)| message)
            .filter(|message| !is_sign_of_life(message))
            .collect()
    }

    /// Lets this much time pass. The clients say something now and then.
    fn pass_on(&mut self, span_ns: u64) -> Vec<Message> {
        let end_ns = self.now_ns + span_ns;
        let mut messages = Vec::new();
        while self.now_ns < end_ns {
            messages.extend(self.pass(end_ns.min(self.now_ns + 2 * S_NS)));
            for (connection, client) in &mut self.clients {
                let bytes = client.request(&Message::Ping(0));
                self.device.handle_bytes(self.now_ns, *connection, &bytes);
            }
            let heard = self.receive().into_iter();
            messages.extend(heard.filter(|message| !is_sign_of_life(message)));
        }
        messages
    }

    fn pass_with_signs_of_life(&mut self, until_ns: u64) -> Vec<(u64, Message)> {
        let mut messages = Vec::new();
        while let Some(wake_ns) = self.device.wake_at().filter(|wake_ns| *wake_ns <= until_ns) {
            self.now_ns = wake_ns;
            self.device.handle_wake(wake_ns);
            messages.extend(self.receive().into_iter().map(|message| (wake_ns, message)));
        }
        self.now_ns = until_ns;
        messages
    }

    fn render(&mut self) {
        if let Some(job) = self.jobs.last() {
            self.device.handle_frame(self.now_ns, *job, frame());
        }
    }

    /// Triggers with the settings in force, renders at once, and gives everything that comes within two seconds.
    fn take(&mut self, trigger_id: u64) -> Vec<Message> {
        let mut messages = self.send(&self.trigger(trigger_id));
        self.render();
        messages.extend(self.pass(self.now_ns + 2000 * MS_NS));
        messages
    }

    /// A trigger with the settings last configured.
    fn trigger(&self, trigger_id: u64) -> Message {
        let Message::Trigger(mut asked) = trigger(trigger_id, 0) else {
            unreachable!()
        };
        asked.config_id = self.device.bridge.config_id();
        Message::Trigger(asked)
    }

    /// Asks for the state.
    fn status(&mut self) -> Status {
        match self.ask(&Message::GetStatus) {
            Message::Status(status) => status,
            other => panic!("{other:?}"),
        }
    }

    fn state(&mut self) -> u8 {
        self.status().state
    }
}

fn is_sign_of_life(message: &Message) -> bool {
    matches!(message, Message::Status(_) | Message::Ping(_) | Message::Pong(_))
}

fn frame() -> Frame {
    let count = 80 * 40;
    Frame {
        width_px: 80,
        height_px: 40,
        xyz_mm: (0..count).map(|index| [index as f32, 1.0, 280.0]).collect(),
        mask: vec![0; count],
        intensity: vec![100; count],
        confidence: vec![250; count],
        valid_count: count as u32,
        saturated_count: 0,
        surface_points_mm: Vec::new(),
    }
}

fn state_now(state: u8) -> StateNow {
    StateNow { state, reserved: Zero }
}

fn names(messages: &[Message]) -> Vec<u16> {
    messages.iter().map(Message::kind).collect()
}

/// Code, trigger, phase and retryable of an ERROR.
fn error(message: &Message) -> (u16, u64, u8, u8) {
    let Message::Error(error) = message else {
        panic!("{message:?}")
    };
    (error.code, error.trigger_id, error.phase, error.retryable)
}

fn code(message: &Message) -> u16 {
    error(message).0
}

/// Bytes and CRC of every component that came, and those that FRAME_END states.
fn sums(messages: &[Message]) -> [Vec<(u64, u32)>; 2] {
    let mut components: BTreeMap<u16, Vec<u8>> = BTreeMap::new();
    let mut stated = Vec::new();
    for message in messages {
        match message {
            Message::FrameChunk(chunk) => {
                let component = components.entry(chunk.head.component_index).or_default();
                assert_eq!(chunk.head.offset_bytes, component.len() as u64);
                component.extend_from_slice(&chunk.data.0);
            }
            Message::FrameEnd(end) => {
                stated = end.components.iter().map(|sum| (sum.byte_count, sum.crc32c)).collect();
            }
            _ => (),
        }
    }
    let came = components
        .values()
        .map(|bytes| (bytes.len() as u64, crc32c::crc32c(bytes)))
        .collect();
    [came, stated]
}

/// FETCH_OK of a trigger.
fn fetched(trigger_id: u64, state: u8, remaining_us: u32) -> Message {
    Message::FetchOk(FetchOk {
        trigger_id,
        state,
        reserved: Zero,
        remaining_us,
    })
}

/// Bytes of the chunks among messages.
fn data(messages: &[Message]) -> Vec<u8> {
    let chunks = messages.iter().filter_map(|message| match message {
        Message::FrameChunk(chunk) => Some(chunk.data.0.clone()),
        _ => None,
    });
    chunks.flatten().collect()
}

const WHOLE_FRAME: [u16; 7] = [0x21, 0x22, 0x30, 0x31, 0x31, 0x31, 0x32];
