mod faults;
mod session;

use super::*;
use crate::camera::fields::{Field, Rest};
use crate::camera::message::{Aborted, HelloOk, NO_TRIGGER, TriggerOk};
use crate::test_client::{Client, arm, configure, hello, small_settings, trigger};
use crate::vectors::{CAMERA_PAGE, vector};

const MS_NS: u64 = 1_000_000;
const CLIENT: u64 = 1;

/// A camera, one client, and virtual time.
struct Bench {
    device: Device,
    client: Client,
    now_ns: u64,
    jobs: Vec<u64>,
    exposed: Vec<u64>,
    closed: Vec<u64>,
}

impl Bench {
    fn new(faults: &[&str]) -> Self {
        let mut device = Device::new(DeviceSettings {
            optics: Optics::fine(),
            speed: 1.0,
            boot_id: 9,
            faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        });
        device.handle_connected(0, CLIENT);
        Self {
            device,
            client: Client::default(),
            now_ns: 0,
            jobs: Vec::new(),
            exposed: Vec::new(),
            closed: Vec::new(),
        }
    }

    fn armed(faults: &[&str]) -> Self {
        let mut bench = Self::new(faults);
        bench.arm();
        bench
    }

    fn arm(&mut self) {
        assert!(matches!(self.ask(&hello()), Message::HelloOk(_)));
        assert!(matches!(
            self.ask(&configure(&small_settings())),
            Message::Configured(_)
        ));
        assert_eq!(self.ask(&arm(1)), Message::Armed(state_now(2)));
    }

    fn reconnect(&mut self) {
        self.device.handle_closed(self.now_ns, CLIENT);
        self.device.handle_connected(self.now_ns, CLIENT);
        self.client = Client::default();
    }

    fn send(&mut self, message: &Message) -> Vec<Message> {
        let bytes = self.client.request(message);
        self.send_bytes(&bytes)
    }

    fn send_bytes(&mut self, bytes: &[u8]) -> Vec<Message> {
        self.device.handle_bytes(self.now_ns, CLIENT, bytes);
        self.receive()
    }

    /// The one answer to a request.
    fn ask(&mut self, message: &Message) -> Message {
        let mut answers = self.send(message);
        assert_eq!(answers.len(), 1, "{answers:?}");
        answers.remove(0)
    }

    fn receive(&mut self) -> Vec<Message> {
        let mut messages = Vec::new();
        while let Some(output) = self.device.poll_output() {
            match output {
                DeviceOutput::Bytes {
                    connection: CLIENT,
                    bytes,
                } => {
                    messages.extend(self.client.read(&bytes).into_iter().map(|(_, message)| message));
                }
                DeviceOutput::Expose { job, .. } => self.jobs.push(job),
                DeviceOutput::Exposed { job } => self.exposed.push(job),
                DeviceOutput::Close { connection } => self.closed.push(connection),
                DeviceOutput::Bytes { .. } | DeviceOutput::Violation(_) => (),
            }
        }
        messages
    }

    /// Lets time pass, each wake at its time; leaves out the signs of life.
    fn pass(&mut self, until_ns: u64) -> Vec<Message> {
        self.pass_with_signs_of_life(until_ns)
            .into_iter()
            .map(|(_, message)| message)
            .filter(|message| !matches!(message, Message::Status(_) | Message::Ping(_)))
            .collect()
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
        let job = *self.jobs.last().unwrap();
        self.device.handle_frame(self.now_ns, job, frame());
    }

    /// Triggers, renders at once, and gives everything that comes within two seconds.
    fn take(&mut self, trigger_id: u64) -> Vec<Message> {
        let mut messages = self.send(&trigger(trigger_id, 0));
        self.render();
        messages.extend(self.pass(self.now_ns + 2000 * MS_NS));
        messages
    }
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
                let component = components.entry(chunk.component_index).or_default();
                assert_eq!(chunk.offset_bytes, component.len() as u64);
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

const WHOLE_FRAME: [u16; 7] = [0x21, 0x22, 0x30, 0x31, 0x31, 0x31, 0x32];
