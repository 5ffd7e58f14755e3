//! One connection of a controller or an observer.

use super::BridgeOutput;
use crate::camera::message::{Hello, ServerMessage};
use crate::camera::wire::{FLAG_ERROR, FLAG_LAST, FLAG_REPLY, FrameReader, FrameWriter};
use crate::stamp::Stamp;
use std::collections::VecDeque;

/// Names a connection; the shell chooses it and never uses one twice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct ConnectionId(pub u64);

/// What may be said on a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// Nothing but HELLO and BYE.
    Stranger,
    Controller,
    Observer,
}

#[derive(Debug)]
pub(super) struct Connection {
    id: ConnectionId,
    /// Where it comes from.
    pub(super) address: String,
    pub(super) reader: FrameReader,
    writer: FrameWriter,
    pub(super) role: Role,
    /// What it greeted with.
    pub(super) name: String,
    pub(super) run_id: u64,
    pub(super) last_heard: Stamp,
    pub(super) status_due: Stamp,
    /// Bytes handed to the shell and not yet written.
    pub(super) unsent: usize,
    /// Nothing more is said or heard on it.
    pub(super) closing: bool,
}

impl Connection {
    pub(super) fn new(id: ConnectionId, address: String, now: Stamp) -> Self {
        Self {
            id,
            address,
            reader: FrameReader::default(),
            writer: FrameWriter::default(),
            role: Role::Stranger,
            name: String::new(),
            run_id: 0,
            last_heard: now,
            status_due: now,
            unsent: 0,
            closing: false,
        }
    }

    pub(super) fn greet(&mut self, role: Role, hello: &Hello) {
        self.role = role;
        self.name.clone_from(&hello.client_name);
        self.run_id = hello.run_id;
    }

    /// Says something that answers a request.
    pub(super) fn reply(&mut self, outbox: &mut VecDeque<BridgeOutput>, request_id: u32, message: &ServerMessage<'_>) {
        self.send(outbox, request_id, FLAG_REPLY, message);
    }

    /// Says something by itself.
    pub(super) fn say(&mut self, outbox: &mut VecDeque<BridgeOutput>, message: &ServerMessage<'_>) {
        self.send(outbox, 0, 0, message);
    }

    fn send(&mut self, outbox: &mut VecDeque<BridgeOutput>, request_id: u32, flags: u16, message: &ServerMessage<'_>) {
        if self.closing {
            return;
        }
        let flags = flags
            | match message {
                ServerMessage::Error(_) => FLAG_ERROR,
                ServerMessage::FrameEnd(_) => FLAG_LAST,
                _ => 0,
            };
        let bytes = self
            .writer
            .write_with(message.kind(), request_id, flags, |payload| message.encode(payload));
        self.unsent += bytes.len();
        outbox.push_back(BridgeOutput::Bytes {
            connection: self.id,
            bytes,
        });
    }

    /// Ends it after what was said.
    pub(super) fn close(&mut self, outbox: &mut VecDeque<BridgeOutput>) {
        if !self.closing {
            self.closing = true;
            outbox.push_back(BridgeOutput::Close { connection: self.id });
        }
    }
}
