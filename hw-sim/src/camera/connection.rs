//! One client's connection: the frames of both directions, who speaks, and its signs of life.

use std::net::SocketAddr;

use crate::camera::a3dp::{FLAG_LAST, Header, KIND_FRAME_CHUNK, Parser};
use crate::camera::fields::Field;
use crate::camera::message::Message;
use crate::camera::script::Mark;
use crate::camera::transfer::Chunk;

/// Connection of a client.
#[derive(Clone, Debug)]
pub(super) struct Connection {
    pub(super) parser: Parser,
    pub(super) role: Role,
    /// Name that the client gave.
    pub(super) name: String,
    pub(super) address: Option<SocketAddr>,
    /// Nothing passes any more, and nobody notices.
    pub(super) is_silent: bool,
    next_seq: u32,
    heard_ns: u64,
    status_ns: u64,
    ping_ns: u64,
    ping_id: u32,
}

/// What a client may say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// HELLO and BYE.
    Stranger,
    Controller,
    Observer,
}

/// What a connection needs at its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sign {
    Status,
    /// Its request id.
    Ping(u32),
    /// Nothing was heard for too long.
    Dead,
}

impl Connection {
    pub(super) fn new(now_ns: u64) -> Self {
        Self {
            parser: Parser::default(),
            role: Role::Stranger,
            name: String::new(),
            address: None,
            is_silent: false,
            next_seq: 0,
            heard_ns: now_ns,
            status_ns: u64::MAX,
            ping_ns: u64::MAX,
            ping_id: 1,
        }
    }

    pub(super) fn handle_bytes(&mut self, now_ns: u64, bytes: &[u8]) {
        self.heard_ns = now_ns;
        self.parser.handle_bytes(bytes);
    }

    /// The client was greeted: signs of life begin.
    pub(super) fn greet(&mut self, now_ns: u64, role: Role, name: &str) {
        self.role = role;
        self.name = name.to_owned();
        self.status_ns = now_ns + SIGN_OF_LIFE_NS;
        self.ping_ns = now_ns + SIGN_OF_LIFE_NS / 2;
    }

    /// Client and address, for the words of a refusal.
    pub(super) fn holder(&self) -> String {
        let address = self.address.map(|address| format!(" at {address}"));
        format!("{:?}{}", self.name, address.unwrap_or_default())
    }

    /// When [`Connection::poll_sign`] has something.
    pub(super) fn wake_at(&self) -> u64 {
        self.status_ns.min(self.ping_ns).min(self.heard_ns + PEER_DEAD_NS)
    }

    /// Next sign that is due.
    pub(super) fn poll_sign(&mut self, now_ns: u64) -> Option<Sign> {
        if self.status_ns <= now_ns {
            self.status_ns = now_ns + SIGN_OF_LIFE_NS;
            Some(Sign::Status)
        } else if self.ping_ns <= now_ns {
            self.ping_ns = now_ns + SIGN_OF_LIFE_NS;
            let id = self.ping_id;
            self.ping_id = id.wrapping_add(1).max(1);
            Some(Sign::Ping(id))
        } else {
            (self.heard_ns + PEER_DEAD_NS <= now_ns).then_some(Sign::Dead)
        }
    }

    /// Bytes of a message, with what is wrong with them; none on a silent connection.
    pub(super) fn frame(&mut self, request_id: u32, flags: u16, message: &Message, mark: Mark) -> Option<Vec<u8>> {
        let last = if matches!(message, Message::FrameEnd(_)) {
            FLAG_LAST
        } else {
            0
        };
        self.write(
            message.kind(),
            request_id,
            flags | last,
            [&message.to_payload(), &[]],
            mark,
        )
    }

    /// Bytes of a chunk.
    pub(super) fn chunk_frame(&mut self, chunk: &Chunk, mark: Mark) -> Option<Vec<u8>> {
        self.write(
            KIND_FRAME_CHUNK,
            0,
            0,
            [&chunk.head().to_payload(), &chunk.data()],
            mark,
        )
    }

    fn write(&mut self, kind: u16, request_id: u32, flags: u16, payload: [&[u8]; 2], mark: Mark) -> Option<Vec<u8>> {
        if self.is_silent {
            return None;
        }
        let seq = self.next_seq.wrapping_add(u32::from(mark.is_after_gap));
        self.next_seq = seq.wrapping_add(1);
        let header = Header {
            kind,
            request_id,
            seq,
            flags,
        };
        let bytes = header.frame_bytes(payload, mark.damage);
        Some(if mark.is_doubled { bytes.repeat(2) } else { bytes })
    }
}

const SIGN_OF_LIFE_NS: u64 = 1_000_000_000;
const PEER_DEAD_NS: u64 = 5_000_000_000;
