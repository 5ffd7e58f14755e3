//! Frames on their way to a client, a chunk at a time.

use super::connection::ConnectionId;
use crate::camera::message::{ComponentEnd, FrameBegin, FrameChunk, FrameEnd, FrameStatus, ServerMessage, TriggerId};
use crate::stamp::Stamp;
use std::sync::Arc;

/// A complete frame with its head.
#[derive(Debug)]
pub(super) struct Frame {
    pub(super) begin: FrameBegin,
    /// The bytes of each component, as [`FrameBegin::components`] lists them.
    pub(super) components: Vec<Vec<u8>>,
}

/// Which sending of a frame it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sending {
    /// It ends the acquisition.
    First,
    /// It was fetched from the store.
    Again,
}

/// A frame on its way.
#[derive(Debug)]
pub(super) struct Transfer {
    pub(super) connection: ConnectionId,
    pub(super) frame: Arc<Frame>,
    pub(super) sending: Sending,
    /// When the other side last took bytes.
    pub(super) last_moved: Stamp,
    next: Next,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    Begin,
    Chunk {
        component: usize,
        chunk: u32,
        offset: usize,
    },
    End,
    Nothing,
}

impl Transfer {
    pub(super) fn new(now: Stamp, connection: ConnectionId, frame: Arc<Frame>, sending: Sending) -> Self {
        Self {
            connection,
            frame,
            sending,
            last_moved: now,
            next: Next::Begin,
        }
    }

    pub(super) fn trigger_id(&self) -> TriggerId {
        self.frame.begin.trigger_id
    }

    /// Whether FRAME_BEGIN has been said.
    pub(super) fn has_begun(&self) -> bool {
        self.next != Next::Begin
    }

    /// Whether everything has been said.
    pub(super) fn is_over(&self) -> bool {
        self.next == Next::Nothing
    }

    /// What is said next; `None` after the end.
    pub(super) fn next_message(&mut self) -> Option<ServerMessage<'_>> {
        match self.next {
            Next::Begin => {
                self.next = self.chunk_or_end(0);
                Some(ServerMessage::FrameBegin(Box::new(self.frame.begin.clone())))
            }
            Next::Chunk {
                component,
                chunk,
                offset,
            } => {
                let length = self.frame.components[component].len();
                let end = length.min(offset + CHUNK_BYTES);
                self.next = match end == length {
                    true => self.chunk_or_end(component + 1),
                    false => Next::Chunk {
                        component,
                        chunk: chunk + 1,
                        offset: end,
                    },
                };
                Some(ServerMessage::FrameChunk(FrameChunk {
                    frame_id: self.frame.begin.frame_id,
                    component_index: component as u16,
                    chunk_index: chunk,
                    offset_bytes: offset as u64,
                    data: &self.frame.components[component][offset..end],
                }))
            }
            Next::End => {
                self.next = Next::Nothing;
                let sent = self.frame.components.iter().map(|bytes| end_of(bytes)).collect();
                Some(ServerMessage::FrameEnd(self.end(FrameStatus::Complete, sent)))
            }
            Next::Nothing => None,
        }
    }

    /// The end of a frame that is broken off here: what was really sent.
    pub(super) fn broken_off(&self) -> FrameEnd {
        let (component, offset) = match self.next {
            Next::Begin => (0, 0),
            Next::Chunk { component, offset, .. } => (component, offset),
            Next::End | Next::Nothing => (self.frame.components.len(), 0),
        };
        let sent = |(index, bytes): (usize, &Vec<u8>)| match index.cmp(&component) {
            std::cmp::Ordering::Less => end_of(bytes),
            std::cmp::Ordering::Equal => end_of(&bytes[..offset]),
            std::cmp::Ordering::Greater => end_of(&[]),
        };
        let sent = self.frame.components.iter().enumerate().map(sent).collect();
        self.end(FrameStatus::Aborted, sent)
    }

    fn end(&self, status: FrameStatus, components: Vec<ComponentEnd>) -> FrameEnd {
        FrameEnd {
            frame_id: self.frame.begin.frame_id,
            trigger_id: self.frame.begin.trigger_id,
            status,
            valid_count: self.frame.begin.valid_count,
            components,
        }
    }

    fn chunk_or_end(&self, component: usize) -> Next {
        match component < self.frame.components.len() {
            true => Next::Chunk {
                component,
                chunk: 0,
                offset: 0,
            },
            false => Next::End,
        }
    }
}

fn end_of(bytes: &[u8]) -> ComponentEnd {
    ComponentEnd {
        byte_count: bytes.len() as u64,
        crc: crc32c::crc32c(bytes),
    }
}

/// Chunks of a component of so many bytes.
pub(super) fn chunk_count(bytes: u64) -> u32 {
    bytes.div_ceil(CHUNK_BYTES as u64) as u32
}

/// Data bytes of a usual chunk.
pub(super) const CHUNK_BYTES: usize = 262_144;
