//! One connection.

use super::heard::Heard;
use crate::camera::message::{Bye, CameraStatus, ClientMessage, DeviceEvent, Pong, ServerMessage};
use crate::camera::wire::{FLAG_ERROR, FLAG_REPLY, FrameReader, FrameWriter};
use crate::stamp::Stamp;
use std::collections::VecDeque;

/// What is known of one connection.
#[derive(Debug)]
pub struct Line {
    pub(super) standing: Standing,
    pub(super) heard: VecDeque<Heard>,
    pub(super) said_at: Stamp,
    pub(super) lively: bool,
    pub(super) broken: Option<String>,
    pub(super) goodbye: Option<Bye>,
    reader: FrameReader,
    writer: FrameWriter,
    next_request_id: u32,
    statuses: Vec<StatusSeen>,
    events: Vec<DeviceEvent>,
    pings: Vec<(Stamp, u32)>,
    own_pings: Vec<u32>,
    heard_at: Stamp,
    longest_silence_ms: u64,
}

/// A STATUS that came by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct StatusSeen {
    /// When.
    pub at: Stamp,
    /// What it said.
    pub status: CameraStatus,
}

#[derive(Debug)]
pub(super) enum Standing {
    Opening,
    Open,
    Closed(String),
}

/// A PING of the server that wants its PONG.
pub(super) struct PingHeard {
    pub(super) request_id: u32,
    pub(super) sender_ns: u64,
}

impl Line {
    pub(super) fn new(now: Stamp) -> Self {
        Self {
            standing: Standing::Opening,
            heard: VecDeque::new(),
            said_at: now,
            lively: false,
            broken: None,
            goodbye: None,
            reader: FrameReader::default(),
            writer: FrameWriter::default(),
            next_request_id: 1,
            statuses: Vec::new(),
            events: Vec::new(),
            pings: Vec::new(),
            own_pings: Vec::new(),
            heard_at: now,
            longest_silence_ms: 0,
        }
    }

    /// Whether it stands.
    pub fn is_open(&self) -> bool {
        matches!(self.standing, Standing::Open)
    }

    /// The statuses that came by themselves.
    pub fn statuses(&self) -> &[StatusSeen] {
        &self.statuses
    }

    /// The events that came.
    pub fn events(&self) -> &[DeviceEvent] {
        &self.events
    }

    /// When the server's pings came, and their request ids.
    pub fn pings(&self) -> &[(Stamp, u32)] {
        &self.pings
    }

    /// The goodbye, if one came.
    pub fn goodbye(&self) -> Option<&Bye> {
        self.goodbye.as_ref()
    }

    /// Why nothing on it is believed any more.
    pub fn broken(&self) -> Option<&str> {
        self.broken.as_deref()
    }

    /// The longest time between two things that came, ms.
    pub fn longest_silence_ms(&self) -> u64 {
        self.longest_silence_ms
    }

    /// Frames that nobody has taken yet.
    pub fn untaken(&self) -> impl Iterator<Item = &Heard> {
        self.heard.iter()
    }

    pub(super) fn ping_due(&self) -> Option<Stamp> {
        (self.lively && self.is_open() && self.goodbye.is_none()).then(|| self.said_at.plus_ms(PING_AFTER_MS))
    }

    pub(super) fn frame(&mut self, message: &ClientMessage) -> (Vec<u8>, u32) {
        let (flags, request_id) = match message {
            ClientMessage::Error(_) => (FLAG_ERROR, 0),
            ClientMessage::Bye(_) => (0, 0),
            _ => (0, self.take_request_id()),
        };
        let append = |payload: &mut Vec<u8>| message.encode(payload);
        let bytes = self.writer.write_with(message.kind(), request_id, flags, append);
        (bytes, request_id)
    }

    pub(super) fn raw_frame(&mut self, kind: u16, request_id: u32, flags: u16, payload: &[u8]) -> Vec<u8> {
        let append = |bytes: &mut Vec<u8>| bytes.extend_from_slice(payload);
        self.writer.write_with(kind, request_id, flags, append)
    }

    pub(super) fn pong(&mut self, request_id: u32, pong: &Pong) -> Vec<u8> {
        let message = ClientMessage::Pong(*pong);
        let append = |payload: &mut Vec<u8>| message.encode(payload);
        self.writer.write_with(message.kind(), request_id, FLAG_REPLY, append)
    }

    /// A sign of life whose answer nobody waits for.
    pub(super) fn ping(&mut self, now: Stamp) -> Vec<u8> {
        let (bytes, request_id) = self.frame(&ClientMessage::Ping { sender_ns: now.ns });
        self.own_pings.push(request_id);
        bytes
    }

    /// The id of the next request.
    pub(super) fn take_request_id(&mut self) -> u32 {
        let request_id = self.next_request_id;
        self.next_request_id = request_id.checked_add(1).unwrap_or(1);
        request_id
    }

    /// Takes bytes in and returns the pings to be answered.
    pub(super) fn take(&mut self, now: Stamp, bytes: &[u8]) -> Vec<PingHeard> {
        self.longest_silence_ms = self.longest_silence_ms.max(now.ms_since(self.heard_at));
        self.heard_at = now;
        let mut pings = Vec::new();
        if self.broken.is_some() {
            return pings;
        }
        self.reader.push(bytes);
        loop {
            let heard = match self.reader.next_frame() {
                Ok(Some(frame)) => Heard {
                    at: now,
                    kind: frame.kind,
                    request_id: frame.request_id,
                    flags: frame.flags,
                    payload: frame.payload.to_vec(),
                },
                Ok(None) => return pings,
                Err(error) => {
                    self.broken = Some(error.to_string());
                    return pings;
                }
            };
            if let Some(odd) = heard.oddity() {
                self.broken = Some(format!("{odd}: {heard}"));
            }
            match ServerMessage::decode(heard.kind, &heard.payload) {
                Ok(Some(ServerMessage::Ping { sender_ns })) => {
                    self.pings.push((now, heard.request_id));
                    if self.lively {
                        pings.push(PingHeard {
                            request_id: heard.request_id,
                            sender_ns,
                        });
                    }
                    continue;
                }
                Ok(Some(ServerMessage::Status(status))) if !heard.is_reply() => {
                    self.statuses.push(StatusSeen { at: now, status });
                    continue;
                }
                Ok(Some(ServerMessage::Event(event))) => {
                    self.events.push(event);
                    continue;
                }
                // The answer to a ping that was only a sign of life.
                Ok(Some(ServerMessage::Pong(_))) if self.own_pings.contains(&heard.request_id) => {
                    self.own_pings.retain(|ping| *ping != heard.request_id);
                    continue;
                }
                Ok(Some(ServerMessage::Bye(bye))) => self.goodbye = Some(bye),
                Ok(Some(ServerMessage::HelloOk(_))) => self.lively = true,
                Ok(_) => {}
                Err(error) => self.broken = Some(format!("{error} in {heard}")),
            }
            self.heard.push_back(heard);
        }
    }
}

/// A little less than the second of the page.
const PING_AFTER_MS: u64 = 800;
