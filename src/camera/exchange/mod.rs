//! The conversation with the camera bridge, as a value: bytes and time in, bytes and events out.
//!
//! Greeting, capabilities, settings (with the echo compared) and arming follow each other; then one trigger at a time.
//! A frame is handed out only when every byte of it has been checked.

mod report;
#[cfg(test)]
mod tests;

pub use report::{CameraEvent, CameraOutput, ExchangeSettings, Opened, Trouble};

use crate::camera::capture::{Assembly, FrameError};
use crate::camera::message::{CameraError, TriggerOk};
use crate::camera::message::{
    Caps, ClientMessage, ComponentKind, Configured, Greeting, ServerMessage, TRIGGER_ALL, TriggerId,
};
use crate::camera::settings::{CameraSettings, difference};
use crate::camera::wire::{FLAG_ERROR, FLAG_REPLY, FrameReader, FrameWriter, WireFrame};
use crate::stamp::{Stamp, earlier};
use std::collections::VecDeque;
use std::sync::Arc;

/// The conversation.
#[derive(Debug)]
pub struct Exchange {
    times: ExchangeSettings,
    wanted: CameraSettings,
    stage: Stage,
    reader: FrameReader,
    writer: FrameWriter,
    next_request_id: u32,
    last_heard: Stamp,
    ping_due: Stamp,
    greeting: Option<Greeting>,
    caps: Option<Caps>,
    configured: Option<Configured>,
    outbox: VecDeque<CameraOutput>,
    events: VecDeque<CameraEvent>,
}

#[derive(Debug)]
enum Stage {
    Apart,
    Connecting {
        due: Stamp,
    },
    /// A request of the opening is out.
    Opening {
        request: Opening,
        request_id: u32,
        due: Stamp,
    },
    Armed,
    InFlight(Flight),
    Aborting {
        trigger_id: TriggerId,
        reason: String,
        retryable: bool,
        due: Stamp,
    },
    Leaving {
        due: Stamp,
    },
    Over,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Opening {
    Hello,
    Caps,
    Configure,
    Arm,
}

#[derive(Debug)]
struct Flight {
    trigger_id: TriggerId,
    request_id: u32,
    phase: Phase,
    due: Stamp,
    frame_due: Stamp,
    assembly: Option<Assembly>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Acknowledge,
    Exposure,
    Frame,
}

impl Exchange {
    /// A conversation that has not begun, about these settings.
    pub fn new(times: ExchangeSettings, wanted: CameraSettings) -> Self {
        Self {
            times,
            wanted,
            stage: Stage::Apart,
            reader: FrameReader::default(),
            writer: FrameWriter::default(),
            next_request_id: 1,
            last_heard: Stamp::START,
            ping_due: Stamp::START,
            greeting: None,
            caps: None,
            configured: None,
            outbox: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Opens the conversation.
    pub fn open(&mut self, now: Stamp) {
        self.stage = Stage::Connecting {
            due: now.plus_ms(self.times.connect_timeout_ms),
        };
        self.outbox.push_back(CameraOutput::Connect);
    }

    /// Starts one acquisition. Only when [`Self::is_armed`].
    pub fn trigger(&mut self, now: Stamp, trigger_id: TriggerId) {
        let config_id = self.configured.as_ref().map_or(0, |configured| configured.config_id);
        let request_id = self.say_act(ClientMessage::Trigger {
            trigger_id,
            config_id,
            deadline_ms: 0,
            tag: format!("view {} attempt {}", trigger_id.view_index(), trigger_id.attempt()),
        });
        let due = now.plus_ms(TRIGGER_OK_MS);
        self.stage = Stage::InFlight(Flight {
            trigger_id,
            request_id,
            phase: Phase::Acknowledge,
            due,
            frame_due: due,
            assembly: None,
        });
    }

    /// Says goodbye (aborting what is in flight) and closes. Does nothing when the connection is over already.
    pub fn leave(&mut self, now: Stamp) {
        match &self.stage {
            Stage::Apart | Stage::Over | Stage::Leaving { .. } => return,
            Stage::Connecting { .. } => {
                self.outbox.push_back(CameraOutput::Close);
                self.stage = Stage::Over;
                self.events.push_back(CameraEvent::Left);
                return;
            }
            Stage::Opening { .. } => {}
            Stage::InFlight(_) | Stage::Aborting { .. } => {
                self.say(ClientMessage::AbortAll);
                self.say(ClientMessage::Disarm);
            }
            Stage::Armed => {
                self.say(ClientMessage::Disarm);
            }
        }
        self.say(ClientMessage::Bye {
            reason: 1,
            text: "done".into(),
        });
        self.outbox.push_back(CameraOutput::Close);
        self.stage = Stage::Leaving {
            due: now.plus_ms(LEAVE_MS),
        };
    }

    /// Whether a trigger would be taken now.
    pub fn is_armed(&self) -> bool {
        matches!(self.stage, Stage::Armed)
    }

    /// Whether an acquisition is under way.
    pub fn is_in_flight(&self) -> bool {
        matches!(self.stage, Stage::InFlight(_) | Stage::Aborting { .. })
    }

    /// Whether the connection is over.
    pub fn is_over(&self) -> bool {
        matches!(self.stage, Stage::Apart | Stage::Over)
    }

    /// The TCP connection stands.
    pub fn handle_connected(&mut self, now: Stamp) {
        if !matches!(self.stage, Stage::Connecting { .. }) {
            return;
        }
        self.last_heard = now;
        self.ping_due = now.plus_ms(self.times.ping_interval_ms);
        self.request(now, Opening::Hello);
    }

    /// The TCP connection did not come about, or has ended.
    pub fn handle_closed(&mut self, _now: Stamp, reason: &str) {
        match self.stage {
            Stage::Apart | Stage::Over => {}
            Stage::Leaving { .. } => {
                self.stage = Stage::Over;
                self.events.push_back(CameraEvent::Left);
            }
            Stage::Connecting { .. } => self.lose(Trouble::Unreachable(reason.to_owned())),
            _ => self.lose(Trouble::Closed(reason.to_owned())),
        }
    }

    /// Bytes have come.
    pub fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        if matches!(self.stage, Stage::Apart | Stage::Over) {
            return;
        }
        self.last_heard = now;
        self.reader.push(bytes);
        loop {
            match self.reader.next_frame() {
                Ok(None) => return,
                Ok(Some(frame)) => self.handle_frame(now, &frame),
                Err(error) => return self.accuse(error.code(), error.to_string()),
            }
            if matches!(self.stage, Stage::Over) {
                return;
            }
        }
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        match &self.stage {
            Stage::Apart | Stage::Over => return,
            Stage::Connecting { due } if *due <= now => {
                let seconds = self.times.connect_timeout_ms as f64 * 1e-3;
                return self.lose(Trouble::Unreachable(format!("no connection within {seconds} s")));
            }
            Stage::Opening { request, due, .. } if *due <= now => {
                let reason = format!("no reply to {request:?} within {} ms", self.times.reply_timeout_ms);
                return self.lose(Trouble::Silent(reason));
            }
            Stage::InFlight(flight) if flight.due <= now => {
                let (trigger_id, reason) = (flight.trigger_id, flight.phase.late());
                self.abort(now, trigger_id, reason.to_owned(), true);
            }
            Stage::Aborting { due, .. } if *due <= now => {
                return self.lose(Trouble::Silent("no reply to ABORT".into()));
            }
            Stage::Leaving { due } if *due <= now => {
                self.stage = Stage::Over;
                self.events.push_back(CameraEvent::Left);
                return;
            }
            _ => {}
        }
        if matches!(self.stage, Stage::Connecting { .. } | Stage::Leaving { .. }) {
            return;
        }
        if now >= self.last_heard.plus_ms(self.times.dead_after_ms) {
            let reason = format!("nothing heard for {} ms", self.times.dead_after_ms);
            return self.lose(Trouble::Silent(reason));
        }
        if now >= self.ping_due {
            self.say(ClientMessage::Ping { sender_ns: now.ns });
            self.ping_due = now.plus_ms(self.times.ping_interval_ms);
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        let alive = Some(self.ping_due.min(self.last_heard.plus_ms(self.times.dead_after_ms)));
        match &self.stage {
            Stage::Apart | Stage::Over => None,
            Stage::Connecting { due } | Stage::Leaving { due } => Some(*due),
            Stage::Opening { due, .. } | Stage::Aborting { due, .. } => earlier(Some(*due), alive),
            Stage::InFlight(flight) => earlier(Some(flight.due), alive),
            Stage::Armed => alive,
        }
    }

    /// The next thing the shell must do.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<CameraOutput> {
        self.outbox.pop_front()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<CameraEvent> {
        self.events.pop_front()
    }

    fn handle_frame(&mut self, now: Stamp, frame: &WireFrame) {
        match ServerMessage::decode(frame.kind, &frame.payload) {
            Ok(Some(message)) => self.handle_message(now, frame.request_id, message),
            Ok(None) => self.note(format!("message of unknown type {:#06x}", frame.kind)),
            Err(error) => self.accuse(108, format!("message {:#06x}: {error}", frame.kind)),
        }
    }

    fn handle_message(&mut self, now: Stamp, request_id: u32, message: ServerMessage) {
        match message {
            ServerMessage::HelloOk(greeting) if self.opening(Opening::Hello, request_id) => {
                self.greeting = Some(greeting);
                self.request(now, Opening::Caps);
            }
            ServerMessage::Caps(caps) if self.opening(Opening::Caps, request_id) => {
                self.caps = Some(caps);
                self.request(now, Opening::Configure);
            }
            ServerMessage::Configured(configured) if self.opening(Opening::Configure, request_id) => {
                if let Some(difference) = difference(&self.wanted, &configured.settings) {
                    return self.lose(Trouble::Echo(difference));
                }
                self.configured = Some(configured);
                self.request(now, Opening::Arm);
            }
            ServerMessage::Armed if self.opening(Opening::Arm, request_id) => self.ready(),
            ServerMessage::TriggerOk(accepted) => self.handle_trigger_ok(now, request_id, accepted),
            ServerMessage::ExposureDone { trigger_id } => self.handle_exposure_done(trigger_id),
            ServerMessage::FrameBegin(begin) => {
                let max = self.greeting.as_ref().map_or(0, |greeting| greeting.frame_bytes_max);
                let expected = self.configured.as_ref().map(|configured| configured.config_id);
                match &mut self.stage {
                    Stage::InFlight(flight) if flight.trigger_id == begin.trigger_id && flight.assembly.is_none() => {
                        if Some(begin.config_id) != expected {
                            let text = format!("a frame of settings {} instead of {expected:?}", begin.config_id);
                            return self.accuse(206, text);
                        }
                        match Assembly::begin(*begin, max) {
                            Ok(assembly) => flight.assembly = Some(assembly),
                            Err(error) => self.accuse(108, error.to_string()),
                        }
                    }
                    _ => self.note(format!(
                        "a frame of trigger {:#x}, which is not open",
                        begin.trigger_id.0
                    )),
                }
            }
            ServerMessage::FrameChunk {
                frame_id,
                component_index,
                chunk_index,
                offset_bytes,
                data,
            } => {
                if let Stage::InFlight(Flight {
                    assembly: Some(assembly),
                    ..
                }) = &mut self.stage
                    && let Err(error) = assembly.push(frame_id, component_index, chunk_index, offset_bytes, &data)
                {
                    self.accuse(108, error.to_string());
                }
            }
            ServerMessage::FrameEnd(end) => self.handle_frame_end(now, &end),
            ServerMessage::Aborted { .. } => self.handle_aborted(),
            ServerMessage::Status(status) => self.events.push_back(CameraEvent::Status(status)),
            ServerMessage::Event { code, text } => self.note(format!("camera event {code}: {text}")),
            ServerMessage::Ping { sender_ns } => {
                let pong = ClientMessage::Pong {
                    sender_ns,
                    host_ns: now.ns,
                };
                self.send(&pong, request_id, FLAG_REPLY, false);
            }
            ServerMessage::Pong { .. } | ServerMessage::Disarmed => {}
            ServerMessage::Error(error) => self.handle_error(request_id, error),
            ServerMessage::Bye { reason, text } => {
                if !matches!(self.stage, Stage::Leaving { .. }) {
                    self.outbox.push_back(CameraOutput::Close);
                    self.lose(Trouble::Closed(format!(
                        "the camera said goodbye (reason {reason}): {text}"
                    )));
                }
            }
            ServerMessage::HelloOk(_)
            | ServerMessage::Caps(_)
            | ServerMessage::Configured(_)
            | ServerMessage::Armed => self.note(format!("a reply to request {request_id}, which is not open")),
        }
    }

    fn ready(&mut self) {
        self.stage = Stage::Armed;
        let missing = "the opening went through every stage";
        self.events.push_back(CameraEvent::Ready(Box::new(Opened {
            greeting: self.greeting.clone().expect(missing),
            caps: self.caps.clone().expect(missing),
            configured: self.configured.expect(missing),
        })));
    }

    fn handle_trigger_ok(&mut self, now: Stamp, request_id: u32, accepted: TriggerOk) {
        let frame_bytes = self.configured.map_or(0, |configured| configured.frame_bytes);
        let extra_ms = self.times.frame_timeout_extra_ms;
        match &mut self.stage {
            Stage::InFlight(flight)
                if flight.phase == Phase::Acknowledge
                    && flight.request_id == request_id
                    && flight.trigger_id == accepted.trigger_id =>
            {
                flight.phase = Phase::Exposure;
                flight.due = now.plus_ms(u64::from(accepted.predicted_exposure_us) / 1000 + EXPOSURE_EXTRA_MS);
                let transfer_ms = frame_bytes / TRANSFER_BYTES_PER_MS;
                flight.frame_due = now.plus_ms(u64::from(accepted.predicted_total_us) / 1000 + transfer_ms + extra_ms);
            }
            _ => self.note(format!(
                "TRIGGER_OK for {:#x}, which is not open",
                accepted.trigger_id.0
            )),
        }
    }

    fn handle_exposure_done(&mut self, trigger_id: TriggerId) {
        match &mut self.stage {
            Stage::InFlight(flight) if flight.trigger_id == trigger_id && flight.phase == Phase::Exposure => {
                flight.phase = Phase::Frame;
                flight.due = flight.frame_due;
                self.events.push_back(CameraEvent::ExposureDone { trigger_id });
            }
            _ => self.note(format!("EXPOSURE_DONE for {:#x}, which is not open", trigger_id.0)),
        }
    }

    fn handle_frame_end(&mut self, now: Stamp, end: &crate::camera::message::FrameEnd) {
        let Stage::InFlight(flight) = &mut self.stage else {
            return self.note(format!("the end of frame {}, which is not open", end.frame_id));
        };
        let trigger_id = flight.trigger_id;
        let Some(assembly) = flight.assembly.take() else {
            return self.note(format!("the end of frame {}, which never began", end.frame_id));
        };
        if flight.phase != Phase::Frame {
            return self.accuse(203, "a frame before its EXPOSURE_DONE".into());
        }
        match assembly.end(end) {
            Ok(capture) => {
                self.stage = Stage::Armed;
                self.events.push_back(CameraEvent::Frame(Arc::new(capture)));
            }
            // The stream is whole, the frame is not: nothing of it is used.
            Err(error @ (FrameError::Crc(_) | FrameError::End)) => {
                self.stage = Stage::Armed;
                self.events.push_back(CameraEvent::Failed {
                    trigger_id,
                    reason: error.to_string(),
                    retryable: true,
                });
            }
            Err(error) => self.abort(now, trigger_id, error.to_string(), true),
        }
    }

    fn handle_aborted(&mut self) {
        if let Stage::Aborting { .. } = self.stage
            && let Stage::Aborting {
                trigger_id,
                reason,
                retryable,
                ..
            } = std::mem::replace(&mut self.stage, Stage::Armed)
        {
            self.events.push_back(CameraEvent::Failed {
                trigger_id,
                reason,
                retryable,
            });
        }
    }

    fn handle_error(&mut self, request_id: u32, error: CameraError) {
        match &self.stage {
            Stage::Opening { request_id: open, .. } if *open == request_id => self.lose(Trouble::Refused(error)),
            Stage::InFlight(flight) if flight.trigger_id.0 == error.trigger_id || flight.request_id == request_id => {
                let trigger_id = flight.trigger_id;
                self.stage = Stage::Armed;
                self.events.push_back(CameraEvent::Failed {
                    trigger_id,
                    reason: format!("camera error {}: {}", error.code, error.text),
                    retryable: error.retryable,
                });
            }
            // An abort that finds nothing in flight ends the same way.
            Stage::Aborting { .. } if error.trigger_id == TRIGGER_ALL || error.code == 406 => self.handle_aborted(),
            _ => self.note(format!("camera error {}: {}", error.code, error.text)),
        }
    }

    fn abort(&mut self, now: Stamp, trigger_id: TriggerId, reason: String, retryable: bool) {
        self.say(ClientMessage::AbortAll);
        self.stage = Stage::Aborting {
            trigger_id,
            reason,
            retryable,
            due: now.plus_ms(self.times.reply_timeout_ms),
        };
    }

    fn opening(&self, wanted: Opening, reply_to: u32) -> bool {
        matches!(self.stage, Stage::Opening { request, request_id, .. } if request == wanted && request_id == reply_to)
    }

    fn request(&mut self, now: Stamp, request: Opening) {
        let config_id = self.configured.map_or(0, |configured| configured.config_id);
        let request_id = self.say(match request {
            Opening::Hello => ClientMessage::Hello {
                client_name: "bladescan".into(),
            },
            Opening::Caps => ClientMessage::GetCaps,
            Opening::Configure => ClientMessage::Configure(self.wanted),
            Opening::Arm => ClientMessage::Arm { config_id },
        });
        self.stage = Stage::Opening {
            request,
            request_id,
            due: now.plus_ms(self.times.reply_timeout_ms),
        };
    }

    /// The other side broke the protocol: say so, leave, and believe nothing more.
    fn accuse(&mut self, code: u16, text: String) {
        self.send(
            &ClientMessage::Error {
                code,
                text: text.clone(),
            },
            0,
            FLAG_ERROR,
            false,
        );
        self.say(ClientMessage::Bye {
            reason: 3,
            text: text.clone(),
        });
        self.outbox.push_back(CameraOutput::Close);
        self.lose(Trouble::Protocol(text));
    }

    fn lose(&mut self, trouble: Trouble) {
        if !matches!(trouble, Trouble::Closed(_) | Trouble::Protocol(_)) {
            self.outbox.push_back(CameraOutput::Close);
        }
        self.stage = Stage::Over;
        self.events.push_back(CameraEvent::Lost(trouble));
    }

    fn note(&mut self, text: String) {
        self.events.push_back(CameraEvent::Note(text));
    }

    fn say(&mut self, message: ClientMessage) -> u32 {
        let request_id = self.take_request_id();
        self.send(&message, request_id, 0, false);
        request_id
    }

    fn say_act(&mut self, message: ClientMessage) -> u32 {
        let request_id = self.take_request_id();
        self.send(&message, request_id, 0, true);
        request_id
    }

    fn take_request_id(&mut self) -> u32 {
        let request_id = self.next_request_id;
        self.next_request_id = self.next_request_id.checked_add(1).unwrap_or(1);
        request_id
    }

    fn send(&mut self, message: &ClientMessage, request_id: u32, flags: u16, act: bool) {
        let (kind, payload) = message.encode();
        let bytes = self.writer.write(&WireFrame {
            kind,
            request_id,
            flags,
            payload,
        });
        self.outbox.push_back(CameraOutput::Bytes { bytes, act });
    }
}

impl Phase {
    fn late(self) -> &'static str {
        match self {
            Self::Acknowledge => "the trigger was not acknowledged in time",
            Self::Exposure => "the exposure did not end in time",
            Self::Frame => "the frame did not come in time",
        }
    }
}

const TRIGGER_OK_MS: u64 = 500;
const EXPOSURE_EXTRA_MS: u64 = 1000;
const TRANSFER_BYTES_PER_MS: u64 = 20_000;
const LEAVE_MS: u64 = 1000;

/// The components every configuration asks for.
pub const COMPONENTS_WANTED: u32 = ComponentKind::WANTED;
