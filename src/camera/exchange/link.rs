//! One connection: its numbers, its signs of life, what is said on it.

use super::report::{CameraEvent, CameraOutput, Trouble};
use super::{Exchange, Stage};
use crate::camera::message::{AcquisitionPhase, Bye, CameraError, ClientMessage, Pong, TRIGGER_ALL};
use crate::camera::wire::{FLAG_ERROR, FLAG_REPLY, FrameReader, FrameWriter};
use crate::stamp::Stamp;

/// What begins anew with each connection.
#[derive(Debug)]
pub(super) struct Link {
    pub(super) reader: FrameReader,
    writer: FrameWriter,
    next_request_id: u32,
    pub(super) last_heard: Stamp,
    ping_due: Stamp,
    /// The ping that is not answered yet: its request id.
    ping: Option<u32>,
}

impl Default for Link {
    fn default() -> Self {
        Self::begun(Stamp::START, 0)
    }
}

impl Link {
    pub(super) fn begun(now: Stamp, ping_interval_ms: u64) -> Self {
        Self {
            reader: FrameReader::default(),
            writer: FrameWriter::default(),
            next_request_id: 1,
            last_heard: now,
            ping_due: now.plus_ms(ping_interval_ms),
            ping: None,
        }
    }

    pub(super) fn wake_at(&self, dead_after_ms: u64) -> Stamp {
        self.ping_due.min(self.last_heard.plus_ms(dead_after_ms))
    }

    /// The next ping goes out now.
    pub(super) fn hurry_ping(&mut self, now: Stamp) {
        self.ping_due = now;
    }

    fn take_request_id(&mut self) -> u32 {
        let request_id = self.next_request_id;
        self.next_request_id = self.next_request_id.checked_add(1).unwrap_or(1);
        request_id
    }
}

impl Exchange {
    /// Signs of life in both directions; a connection that has stood long enough ends its outage.
    pub(super) fn watch_connection(&mut self, now: Stamp) {
        if now >= self.link.last_heard.plus_ms(self.times.dead_after_ms) {
            let reason = format!("nothing heard for {} ms", self.times.dead_after_ms);
            return self.break_off(now, Trouble::Silent(reason));
        }
        if now >= self.link.ping_due {
            let request_id = self.say(&ClientMessage::Ping { sender_ns: now.ns });
            self.link.ping = Some(request_id);
            self.link.ping_due = now.plus_ms(self.times.ping_interval_ms);
        }
        let stands = matches!(self.stage, Stage::Standing) && self.armed;
        if stands && now >= self.armed_since.plus_ms(self.times.dead_after_ms) {
            self.outage = None;
            self.patience_until = None;
        }
    }

    pub(super) fn handle_ping(&mut self, now: Stamp, request_id: u32, sender_ns: u64) {
        let pong = ClientMessage::Pong(Pong {
            sender_ns,
            device_ns: 0,
            host_ns: now.ns,
        });
        self.send(&pong, request_id, FLAG_REPLY, false);
    }

    pub(super) fn handle_pong(&mut self, now: Stamp, request_id: u32, pong: &Pong) {
        if self.link.ping != Some(request_id) || pong.sender_ns > now.ns {
            return self.note(format!("PONG to request {request_id}, which is not open"));
        }
        self.link.ping = None;
        self.clock.handle_answer(now, pong.sender_ns, pong.device_ns);
        if self.clock.is_telling()
            && let Some(estimate) = self.clock.estimate()
        {
            self.events.push_back(CameraEvent::Clock(estimate));
        }
    }

    /// The other side broke the protocol: say so, leave, and believe nothing more of this connection.
    pub(super) fn accuse(&mut self, now: Stamp, code: u16, text: String) {
        let error = CameraError {
            about_request_id: 0,
            trigger_id: TRIGGER_ALL,
            code,
            phase: AcquisitionPhase::None,
            retryable: false,
            retry_after_ms: 0,
            vendor_code: 0,
            text: text.clone(),
        };
        self.send(&ClientMessage::Error(error), 0, FLAG_ERROR, false);
        self.say_goodbye(Bye::PROTOCOL, &text);
        self.break_off(now, Trouble::Protocol(text));
    }

    pub(super) fn say_goodbye(&mut self, reason: u16, text: &str) {
        let bye = Bye {
            reason,
            text: text.to_owned(),
        };
        self.send(&ClientMessage::Bye(bye), 0, 0, false);
    }

    pub(super) fn say(&mut self, message: &ClientMessage) -> u32 {
        let request_id = self.link.take_request_id();
        self.send(message, request_id, 0, false);
        request_id
    }

    pub(super) fn say_act(&mut self, message: &ClientMessage) -> u32 {
        let request_id = self.link.take_request_id();
        self.send(message, request_id, 0, true);
        request_id
    }

    fn send(&mut self, message: &ClientMessage, request_id: u32, flags: u16, act: bool) {
        let append = |payload: &mut Vec<u8>| message.encode(payload);
        let bytes = self.link.writer.write_with(message.kind(), request_id, flags, append);
        self.outbox.push_back(CameraOutput::Bytes { bytes, act });
    }
}
