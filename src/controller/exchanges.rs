//! The last exchanges with each device, for the file that a fault leaves.
//!
//! Of a message only its size and its first bytes are kept. The chunks of a frame are one exchange.

use super::{Input, Output};
use crate::camera::{CameraOutput, message_name};
use crate::job::hex;
use crate::robot::{RobotOutput, hses};
use crate::stamp::Stamp;
use serde_json::{Value, json};
use std::collections::VecDeque;

/// The last exchanges with robot and camera.
#[derive(Debug, Clone, Default)]
pub(super) struct Exchanges {
    robot: Ring,
    camera: Ring,
    camera_received: Stream,
    camera_sent: Stream,
}

#[derive(Debug, Clone, Default)]
struct Ring(VecDeque<Exchange>);

#[derive(Debug, Clone)]
struct Exchange {
    at: Stamp,
    what: What,
}

#[derive(Debug, Clone)]
enum What {
    /// The connection, in words.
    Link(String),
    Message {
        direction: Direction,
        head: Vec<u8>,
        byte_count: usize,
        message_count: usize,
    },
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Direction {
    Sent,
    Received,
}

/// Where the messages of A3DP/1 begin in one direction of a connection.
#[derive(Debug, Clone, Default)]
struct Stream {
    /// What has come of the header of the next message.
    header: Vec<u8>,
    /// Bytes of the payload that are still to come.
    payload_left: usize,
}

impl Exchanges {
    /// Something came in.
    pub(super) fn note_input(&mut self, now: Stamp, input: &Input) {
        match input {
            Input::RobotBytes(bytes) => self.robot.message(now, Direction::Received, bytes, bytes.len()),
            Input::CameraBytes(bytes) => {
                self.camera_received
                    .walk(now, Direction::Received, bytes, &mut self.camera);
            }
            Input::RobotConnected => self.robot.link(now, "connected"),
            Input::RobotClosed { reason } => self.robot.link(now, &format!("closed: {reason}")),
            Input::RobotUnreachable { reason } => self.robot.link(now, &format!("unreachable: {reason}")),
            Input::CameraConnected => self.camera.link(now, "connected"),
            Input::CameraClosed { reason } => self.camera.link(now, &format!("closed: {reason}")),
            _ => {}
        }
    }

    /// Something goes out.
    pub(super) fn note_output(&mut self, now: Stamp, output: &Output) {
        match output {
            Output::Robot(RobotOutput::Bytes { bytes, .. }) => {
                self.robot.message(now, Direction::Sent, bytes, bytes.len());
            }
            Output::Robot(RobotOutput::Connect) => self.robot.link(now, "connecting"),
            Output::Robot(RobotOutput::Close) => self.robot.link(now, "closed by us"),
            Output::Camera(CameraOutput::Bytes { bytes, .. }) => {
                self.camera_sent.walk(now, Direction::Sent, bytes, &mut self.camera);
            }
            Output::Camera(CameraOutput::Connect) => {
                self.camera_received = Stream::default();
                self.camera_sent = Stream::default();
                self.camera.link(now, "connecting");
            }
            Output::Camera(CameraOutput::Close) => self.camera.link(now, "closed by us"),
            _ => {}
        }
    }

    /// The list `exchanges` of `fault.json`, in the order in which they were.
    pub(super) fn value(&self) -> Value {
        let robot = self
            .robot
            .0
            .iter()
            .enumerate()
            .map(|(at, exchange)| (exchange.at, exchange.robot_value(self.robot.0.range(..at))));
        let camera = self
            .camera
            .0
            .iter()
            .map(|exchange| (exchange.at, exchange.camera_value()));
        let mut all: Vec<(Stamp, Value)> = robot.chain(camera).collect();
        // Stable: what one device said at one moment stays in its order.
        all.sort_by_key(|(at, _)| *at);
        all.into_iter().map(|(_, value)| value).collect()
    }
}

impl Ring {
    fn link(&mut self, now: Stamp, words: &str) {
        self.push(now, What::Link(words.to_owned()));
    }

    fn message(&mut self, now: Stamp, direction: Direction, bytes: &[u8], byte_count: usize) {
        let head = bytes[..bytes.len().min(HEAD_BYTES)].to_vec();
        self.push(
            now,
            What::Message {
                direction,
                head,
                byte_count,
                message_count: 1,
            },
        );
    }

    fn push(&mut self, at: Stamp, what: What) {
        if self.0.len() == EXCHANGES_MAX {
            self.0.pop_front();
        }
        self.0.push_back(Exchange { at, what });
    }

    /// Adds another chunk of a frame to the chunk before it; false if that is not what came last.
    fn add_chunk(&mut self, bytes: usize) -> bool {
        match self.0.back_mut().map(|exchange| &mut exchange.what) {
            Some(What::Message {
                head,
                byte_count,
                message_count,
                ..
            }) if kind(head) == Some(FRAME_CHUNK) => {
                *byte_count += bytes;
                *message_count += 1;
                true
            }
            _ => false,
        }
    }

    /// The first bytes of a payload complete the head of its message.
    fn extend_head(&mut self, bytes: &[u8]) {
        if let Some(What::Message {
            head, message_count: 1, ..
        }) = self.0.back_mut().map(|exchange| &mut exchange.what)
        {
            let room = HEAD_BYTES.saturating_sub(head.len());
            head.extend_from_slice(&bytes[..bytes.len().min(room)]);
        }
    }
}

impl Stream {
    /// Notes every message that begins in these bytes.
    fn walk(&mut self, now: Stamp, direction: Direction, mut bytes: &[u8], ring: &mut Ring) {
        while !bytes.is_empty() {
            if self.payload_left > 0 {
                let (payload, rest) = bytes.split_at(self.payload_left.min(bytes.len()));
                ring.extend_head(payload);
                self.payload_left -= payload.len();
                bytes = rest;
                continue;
            }
            let missing = A3DP_HEADER_BYTES - self.header.len();
            let (part, rest) = bytes.split_at(missing.min(bytes.len()));
            self.header.extend_from_slice(part);
            bytes = rest;
            if self.header.len() < A3DP_HEADER_BYTES {
                return;
            }
            let header = std::mem::take(&mut self.header);
            let Some(payload_count) = payload_count(&header) else {
                // Out of step: the conversation ends the connection, so the rest is one message.
                return ring.message(now, direction, &header, header.len() + bytes.len());
            };
            self.payload_left = payload_count;
            let byte_count = header.len() + payload_count;
            let is_chunk = kind(&header) == Some(FRAME_CHUNK);
            if !(is_chunk && ring.add_chunk(byte_count)) {
                ring.message(now, direction, &header, byte_count);
            }
        }
    }
}

impl Exchange {
    fn robot_value<'a>(&self, before: impl DoubleEndedIterator<Item = &'a Exchange>) -> Value {
        self.value("robot", |direction, head| robot_words(direction, head, before))
    }

    fn camera_value(&self) -> Value {
        self.value("camera", |_, head| {
            kind(head).map_or_else(|| "no message of A3DP".into(), |kind| message_name(kind).into())
        })
    }

    fn value(&self, device: &str, name: impl FnOnce(Direction, &[u8]) -> String) -> Value {
        let at_s = self.at.seconds();
        match &self.what {
            What::Link(words) => json!({ "at_s": at_s, "device": device, "connection": words }),
            What::Message {
                direction,
                head,
                byte_count,
                message_count,
            } => json!({
                "at_s": at_s,
                "device": device,
                "direction": match direction {
                    Direction::Sent => "sent",
                    Direction::Received => "received",
                },
                "message": name(*direction, head),
                "messages": message_count,
                "bytes": byte_count,
                "first_bytes_hex": hex(head),
            }),
        }
    }
}

/// A message of the robot in words: a datagram by its command, the text of a stream as it is.
fn robot_words<'a>(direction: Direction, head: &[u8], before: impl DoubleEndedIterator<Item = &'a Exchange>) -> String {
    if !hses::is_frame(head) {
        let text = String::from_utf8_lossy(head);
        return text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    }
    match direction {
        Direction::Sent => hses::request_name(head).into(),
        Direction::Received => {
            // An answer does not say what it answers: the request of the same number does.
            let asked = before
                .rev()
                .find_map(|exchange| exchange.sent_datagram().filter(|sent| sent.get(11) == head.get(11)));
            let name = asked.map_or("a request long ago", hses::request_name);
            match head.get(25) {
                Some(0) => format!("answer: {name}"),
                _ => format!("refusal: {name}"),
            }
        }
    }
}

impl Exchange {
    fn sent_datagram(&self) -> Option<&[u8]> {
        match &self.what {
            What::Message {
                direction: Direction::Sent,
                head,
                ..
            } => Some(head),
            _ => None,
        }
    }
}

/// The type of a message of A3DP/1, if these bytes begin one.
fn kind(head: &[u8]) -> Option<u16> {
    payload_count(head).map(|_| u16::from_le_bytes([head[6], head[7]]))
}

fn payload_count(header: &[u8]) -> Option<usize> {
    let length: [u8; 4] = header.get(8..12)?.try_into().ok()?;
    header.starts_with(b"A3DP").then(|| u32::from_le_bytes(length) as usize)
}

/// Exchanges kept of each device.
const EXCHANGES_MAX: usize = 64;
/// Bytes kept of each: every header, and the beginning of what follows.
const HEAD_BYTES: usize = 48;
const A3DP_HEADER_BYTES: usize = crate::camera::HEADER_BYTES;
const FRAME_CHUNK: u16 = 0x31;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{FrameWriter, WireFrame};
    use crate::robot::Command;

    fn list(exchanges: &Exchanges) -> Vec<Value> {
        exchanges.value().as_array().unwrap().clone()
    }

    fn camera_bytes(kinds: &[(u16, usize)]) -> Vec<u8> {
        let mut writer = FrameWriter::default();
        let write = |(kind, length): &(u16, usize)| {
            writer.write(&WireFrame {
                kind: *kind,
                request_id: 0,
                flags: 0,
                payload: &vec![7; *length],
            })
        };
        kinds.iter().flat_map(write).collect()
    }

    #[test]
    fn messages_of_the_camera_are_found_however_the_stream_is_cut_and_chunks_are_one_exchange() {
        let bytes = camera_bytes(&[(0x21, 4), (0x30, 100), (0x31, 5000), (0x31, 6000), (0x32, 0)]);
        for piece in [1, 7, 31, 33, 4096, bytes.len()] {
            let mut exchanges = Exchanges::default();
            for part in bytes.chunks(piece) {
                exchanges.note_input(Stamp { ns: 5 }, &Input::CameraBytes(part.to_vec()));
            }
            let found = list(&exchanges);
            let names: Vec<&str> = found.iter().map(|value| value["message"].as_str().unwrap()).collect();
            assert_eq!(names, ["TRIGGER_OK", "FRAME_BEGIN", "FRAME_CHUNK", "FRAME_END"]);
            let of_chunks = (&found[2]["messages"], &found[2]["bytes"]);
            assert_eq!(of_chunks, (&json!(2), &json!(11_000 + 2 * 32)));
            let lengths = [0, 1].map(|at| found[at]["first_bytes_hex"].as_str().unwrap().len() / 2);
            assert_eq!(lengths, [36, HEAD_BYTES], "in pieces of {piece}");
        }
    }

    #[test]
    fn an_answer_of_the_robot_is_named_after_the_request_of_its_number() {
        let mut exchanges = Exchanges::default();
        for (id, command) in [(3, Command::Status), (4, Command::HoldOn)] {
            let bytes = hses::request(&command, id).unwrap().encode();
            let kind = crate::robot::Kind::Ask;
            exchanges.note_output(Stamp::START, &Output::Robot(RobotOutput::Bytes { bytes, kind }));
        }
        let mut answer = crate::vectors::hses("ans_status_ready");
        answer[11] = 3;
        exchanges.note_input(Stamp { ns: 1 }, &Input::RobotBytes(answer));
        let found = list(&exchanges);
        assert_eq!(found[0]["message"], "status");
        assert_eq!(found[1]["message"], "hold");
        assert_eq!(found[2]["message"], "answer: status");
    }

    #[test]
    fn only_the_last_of_each_device_are_kept() {
        let mut exchanges = Exchanges::default();
        exchanges.note_input(Stamp::START, &Input::CameraConnected);
        for ns in 0..1000 {
            exchanges.note_input(Stamp { ns }, &Input::RobotBytes(b"OK\r".to_vec()));
        }
        let found = list(&exchanges);
        assert_eq!(found.len(), EXCHANGES_MAX + 1);
        assert_eq!(found[0]["connection"], "connected");
        assert_eq!((&found[1]["message"], &found[1]["bytes"]), (&json!("OK "), &json!(3)));
        assert_eq!(found[64]["at_s"], json!(999.0 * 1e-9));
    }
}
