//! The conversation with the camera bridge, as a value: bytes and time in, bytes and events out.
//!
//! Greeting, capabilities, settings (with the echo compared) and arming follow each other; then one trigger at a time.
//! A frame is handed out only when every byte of it has been checked.

mod hear;
mod report;
#[cfg(test)]
mod tests;

pub use report::{CameraEvent, CameraOutput, ExchangeSettings, Opened, Trouble};

use crate::camera::capture::Assembly;
use crate::camera::message::{
    AcquisitionPhase, Arm, Bye, CameraError, Caps, ClientMessage, ComponentKind, Configured, Greeting, Hello,
    TRIGGER_ALL, Trigger, TriggerId,
};
use crate::camera::settings::CameraSettings;
use crate::camera::wire::{FLAG_ERROR, FrameReader, FrameWriter};
use crate::stamp::{Stamp, earlier};
use std::collections::VecDeque;

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
    assembly: Option<Box<Assembly>>,
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
        let request_id = self.say_act(ClientMessage::Trigger(Trigger {
            trigger_id,
            view_id: trigger_id.view_index(),
            config_id,
            deadline_ms: 0,
            tag: format!("view {} attempt {}", trigger_id.view_index(), trigger_id.attempt()),
        }));
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
                self.say(ClientMessage::Abort {
                    trigger_id: TRIGGER_ALL,
                });
                self.say(ClientMessage::Disarm);
            }
            Stage::Armed => {
                self.say(ClientMessage::Disarm);
            }
        }
        self.say(ClientMessage::Bye(Bye {
            reason: 1,
            text: "done".into(),
        }));
        self.outbox.push_back(CameraOutput::Close);
        self.stage = Stage::Leaving {
            due: now.plus_ms(LEAVE_MS),
        };
    }

    /// Whether a trigger would be taken now.
    pub fn is_armed(&self) -> bool {
        matches!(self.stage, Stage::Armed)
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
            Stage::Connecting { .. } => self.break_off(Trouble::Unreachable(reason.to_owned())),
            _ => self.lose(Trouble::Closed(reason.to_owned())),
        }
    }

    /// Bytes have come.
    pub fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        if matches!(self.stage, Stage::Apart | Stage::Over) {
            return;
        }
        self.last_heard = now;
        let mut reader = std::mem::take(&mut self.reader);
        reader.push(bytes);
        while !matches!(self.stage, Stage::Over) {
            match reader.next_frame() {
                Ok(None) => break,
                Ok(Some(frame)) => self.handle_frame(now, &frame),
                Err(error) => self.accuse(error.code(), error.to_string()),
            }
        }
        self.reader = reader;
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        match &self.stage {
            Stage::Apart | Stage::Over => return,
            Stage::Connecting { due } if *due <= now => {
                let seconds = self.times.connect_timeout_ms as f64 * 1e-3;
                return self.break_off(Trouble::Unreachable(format!("no connection within {seconds} s")));
            }
            Stage::Opening { request, due, .. } if *due <= now => {
                let reason = format!("no reply to {request:?} within {} ms", self.times.reply_timeout_ms);
                return self.break_off(Trouble::Silent(reason));
            }
            Stage::InFlight(flight) if flight.due <= now => {
                let (trigger_id, reason) = (flight.trigger_id, flight.phase.late());
                self.abort(now, trigger_id, reason.to_owned(), true);
            }
            Stage::Aborting { due, .. } if *due <= now => {
                return self.break_off(Trouble::Silent("no reply to ABORT".into()));
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
            return self.break_off(Trouble::Silent(reason));
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

    fn abort(&mut self, now: Stamp, trigger_id: TriggerId, reason: String, retryable: bool) {
        self.say(ClientMessage::Abort {
            trigger_id: TRIGGER_ALL,
        });
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
            Opening::Hello => ClientMessage::Hello(Hello::controller(RUN_ID, "bladescan")),
            Opening::Caps => ClientMessage::GetCaps,
            Opening::Configure => ClientMessage::Configure(self.wanted),
            Opening::Arm => ClientMessage::Arm(Arm {
                mode: Arm::SOFTWARE,
                config_id,
            }),
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
            &ClientMessage::Error(CameraError {
                about_request_id: 0,
                trigger_id: TRIGGER_ALL,
                code,
                phase: AcquisitionPhase::None,
                retryable: false,
                retry_after_ms: 0,
                vendor_code: 0,
                text: text.clone(),
            }),
            0,
            FLAG_ERROR,
            false,
        );
        self.say(ClientMessage::Bye(Bye {
            reason: 3,
            text: text.clone(),
        }));
        self.break_off(Trouble::Protocol(text));
    }

    /// Closes the connection, which is of no use any more.
    fn break_off(&mut self, trouble: Trouble) {
        self.outbox.push_back(CameraOutput::Close);
        self.lose(trouble);
    }

    /// The connection is over.
    fn lose(&mut self, trouble: Trouble) {
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
        let append = |payload: &mut Vec<u8>| message.encode(payload);
        let bytes = self.writer.write_with(message.kind(), request_id, flags, append);
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
/// Each connection is a run of its own as long as none is opened again.
const RUN_ID: u64 = 1;

/// The components every configuration asks for.
pub const COMPONENTS_WANTED: u32 = ComponentKind::WANTED;
