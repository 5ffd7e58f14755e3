//! The A3DP/1 server as a value: bytes, frames and time go in; bytes and exposures come out.

use std::collections::{BTreeMap, VecDeque};

use crate::camera::a3dp::{FLAG_ERROR, FLAG_LAST, FLAG_REPLY, Parser, RawFrame};
use crate::camera::fields::{Str8, Str16, Zero};
use crate::camera::identity::{LINK_MBIT_S, STATE_IDLE, TEMPERATURE_C, VERSION, WARM_UP_S, caps, hello_ok};
use crate::camera::message::{
    Arm, Bye, Caps, ErrorReport, Hello, Message, MessageError, Pong, StateNow, Status, Trigger,
};
use crate::camera::optics::Optics;
use crate::camera::render::{Capture, Frame};
use crate::camera::session::{Refusal, Session, Step};
use crate::fault::Fault;

/// What a camera is built with.
#[derive(Clone, Debug)]
pub struct DeviceSettings {
    /// Lens set.
    pub optics: Optics,
    /// Seconds of the camera in one second of the clock; positive. Time-outs are not scaled.
    pub speed: f64,
    /// New each time the device starts.
    pub boot_id: u64,
    /// What goes wrong; faults of the robot are ignored.
    pub faults: Vec<Fault>,
}

/// What the camera wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum DeviceOutput {
    /// Bytes for a client.
    Bytes {
        /// Connection to send on.
        connection: u64,
        /// Whole frames.
        bytes: Vec<u8>,
    },
    /// End of a connection, once its bytes are sent.
    Close {
        /// Connection to close.
        connection: u64,
    },
    /// Exposure begins now: a frame of what the camera sees must be computed and given back under this job.
    Expose {
        /// Count of the acquisition.
        job: u64,
        /// Acquisition as the client names it.
        trigger_id: u64,
        /// Settings that shape the frame.
        capture: Capture,
    },
    /// Exposure ended.
    Exposed {
        /// Job given with [`DeviceOutput::Expose`].
        job: u64,
    },
    /// A client broke the protocol.
    Violation(String),
}

/// The simulated camera. It serves one controller; a second one is refused.
#[derive(Clone, Debug)]
pub struct Device {
    settings: DeviceSettings,
    caps: Caps,
    connections: BTreeMap<u64, Connection>,
    session: Option<Session>,
    counts: Counts,
    outputs: VecDeque<DeviceOutput>,
}

/// What is counted over the life of a device.
#[derive(Clone, Debug, Default)]
pub(crate) struct Counts {
    pub(crate) sessions: u32,
    pub(crate) configs: u32,
    pub(crate) triggers: u32,
    pub(crate) frames: u32,
    pub(crate) last_error: u16,
    /// Whether the fault of this index has happened.
    pub(crate) met_faults: Vec<bool>,
}

#[derive(Clone, Debug)]
struct Connection {
    parser: Parser,
    next_seq: u32,
    heard_ns: u64,
    is_silent: bool,
}

impl Device {
    /// Camera that nobody is connected to.
    pub fn new(settings: DeviceSettings) -> Self {
        Self {
            caps: caps(&settings.optics),
            counts: Counts {
                met_faults: vec![false; settings.faults.len()],
                ..Counts::default()
            },
            settings,
            connections: BTreeMap::new(),
            session: None,
            outputs: VecDeque::new(),
        }
    }

    /// A client connected.
    pub fn handle_connected(&mut self, now_ns: u64, connection: u64) {
        self.handle_wake(now_ns);
        let new = Connection {
            parser: Parser::default(),
            next_seq: 0,
            heard_ns: now_ns,
            is_silent: false,
        };
        self.connections.insert(connection, new);
    }

    /// A client's connection ended.
    pub fn handle_closed(&mut self, now_ns: u64, connection: u64) {
        self.handle_wake(now_ns);
        self.forget(connection);
    }

    /// Bytes came from a client.
    pub fn handle_bytes(&mut self, now_ns: u64, connection: u64, bytes: &[u8]) {
        self.handle_wake(now_ns);
        let Some(state) = self.connections.get_mut(&connection) else {
            return;
        };
        state.heard_ns = now_ns;
        state.parser.handle_bytes(bytes);
        while let Some(frame) = self
            .connections
            .get_mut(&connection)
            .and_then(|state| state.parser.poll_frame())
        {
            match frame {
                Ok(frame) => self.take_frame(now_ns, connection, &frame),
                Err(error) => self.fail(connection, 0, error.code(), &error.to_string()),
            }
        }
    }

    /// The frame of a job is computed. One that nobody waits for any more is dropped.
    pub fn handle_frame(&mut self, now_ns: u64, job: u64, frame: Frame) {
        if let Some(session) = &mut self.session {
            session.take_frame(job, frame);
        }
        self.handle_wake(now_ns);
    }

    /// Time has passed: does everything that is due.
    pub fn handle_wake(&mut self, now_ns: u64) {
        self.advance_session(now_ns);
        let dead: Vec<u64> = self
            .connections
            .iter()
            .filter(|(_, state)| state.heard_ns + PEER_DEAD_NS <= now_ns)
            .map(|(connection, _)| *connection)
            .collect();
        for connection in dead {
            self.bye(connection, BYE_TIME_OUT, "nothing heard");
        }
    }

    /// When [`Device::handle_wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        let dead_ns = self
            .connections
            .values()
            .map(|state| state.heard_ns + PEER_DEAD_NS)
            .min();
        let session_ns = self.session.as_ref().and_then(Session::wake_at);
        [dead_ns, session_ns].into_iter().flatten().min()
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<DeviceOutput> {
        self.outputs.pop_front()
    }

    /// Says good-bye to everyone.
    pub fn shut_down(&mut self) {
        for connection in self.connections.keys().copied().collect::<Vec<_>>() {
            self.bye(connection, BYE_SHUTTING_DOWN, "shutting down");
        }
    }

    fn advance_session(&mut self, now_ns: u64) {
        while let Some(session) = &mut self.session {
            let connection = session.connection;
            match session.poll_step(now_ns, &mut self.counts, &self.settings) {
                Some(Step::Send(message)) => self.send(connection, 0, 0, &message),
                Some(Step::SendStatus) => {
                    let status = self.status();
                    self.send(connection, 0, 0, &status);
                }
                Some(Step::Ping(id)) => self.send(connection, id, 0, &Message::Ping(now_ns)),
                Some(Step::Error(refusal)) => self.send_error(connection, 0, &refusal),
                Some(Step::Exposed(job)) => self.outputs.push_back(DeviceOutput::Exposed { job }),
                Some(Step::FallSilent) => {
                    if let Some(state) = self.connections.get_mut(&connection) {
                        state.is_silent = true;
                    }
                }
                Some(Step::HangUp) => self.close(connection),
                None => return,
            }
        }
    }

    fn take_frame(&mut self, now_ns: u64, connection: u64, frame: &RawFrame) {
        let in_session = self
            .session
            .as_ref()
            .is_some_and(|session| session.connection == connection);
        let message = match Message::read(frame.kind, &frame.payload) {
            Ok(message) => message,
            Err(MessageError::UnknownType(_)) if in_session => {
                return self.refuse(connection, frame, Refusal::new(106, "unknown type"));
            }
            Err(MessageError::UnknownType(_)) => return self.refuse_without_session(connection, frame),
            Err(MessageError::Payload { cause, kind }) => {
                return self.fail(
                    connection,
                    frame.request_id,
                    cause.code(),
                    &format!("type {kind:#06x}: {cause}"),
                );
            }
        };
        if !flags_agree(frame, &message) {
            return self.fail(
                connection,
                frame.request_id,
                108,
                "flags or request id do not fit the message",
            );
        }
        match message {
            Message::Bye(_) => self.close(connection),
            Message::Hello(hello) if !in_session => self.greet(now_ns, connection, frame, &hello),
            _ if !in_session => self.refuse_without_session(connection, frame),
            message => self.take_message(now_ns, connection, frame, message),
        }
    }

    fn take_message(&mut self, now_ns: u64, connection: u64, frame: &RawFrame, message: Message) {
        let Some(session) = &mut self.session else { return };
        let reply = match message {
            Message::Hello(_) => Err(Refusal::new(203, "session is open already")),
            Message::GetCaps => Ok(Message::Caps(self.caps.clone())),
            Message::Configure(records) => session
                .configure(&records.0, &self.caps, &self.settings, &mut self.counts)
                .map(Message::Configured),
            Message::Arm(Arm { mode, config_id, .. }) => {
                session.arm(mode, config_id).map(state_now).map(Message::Armed)
            }
            Message::Disarm => session.disarm().map(state_now).map(Message::Disarmed),
            Message::Trigger(trigger) => return self.take_trigger(now_ns, connection, frame, &trigger),
            Message::Abort(trigger_id) => return self.take_abort(connection, frame, trigger_id),
            Message::GetStatus => Ok(self.status()),
            Message::Ping(sender_ns) => Ok(Message::Pong(Pong {
                sender_ns,
                device_ns: now_ns,
                host_ns: now_ns,
            })),
            Message::Pong(_) | Message::Error(_) | Message::Bye(_) => return,
            _ => Err(Refusal::new(106, "not a message to a camera")),
        };
        match reply {
            Ok(reply) => self.send(connection, frame.request_id, FLAG_REPLY, &reply),
            Err(refusal) => self.refuse(connection, frame, refusal),
        }
    }

    fn greet(&mut self, now_ns: u64, connection: u64, frame: &RawFrame, hello: &Hello) {
        if !(1..=NAME_BYTES_MAX).contains(&hello.client_name.0.len()) || !matches!(hello.role, 1 | 2) {
            return self.fail(connection, frame.request_id, 108, "name or role");
        }
        if hello.min_version > VERSION || hello.max_version < VERSION {
            self.refuse(connection, frame, Refusal::new(105, "only version 1.0 is spoken"));
            return self.bye(connection, BYE_PROTOCOL_ERROR, "version");
        }
        if hello.role == ROLE_OBSERVER {
            return self.refuse(connection, frame, Refusal::new(201, "observers are not served"));
        }
        if self.session.is_some() || self.settings.faults.contains(&Fault::ControllerBusy) {
            self.refuse(
                connection,
                frame,
                Refusal::new(201, "another controller has the camera"),
            );
            return self.bye(connection, BYE_REFUSED, "busy");
        }
        self.counts.sessions += 1;
        self.session = Some(Session::new(now_ns, connection));
        let reply = Message::HelloOk(hello_ok(self.counts.sessions, self.settings.boot_id));
        self.send(connection, frame.request_id, FLAG_REPLY, &reply);
    }

    fn take_trigger(&mut self, now_ns: u64, connection: u64, frame: &RawFrame, trigger: &Trigger) {
        if trigger.tag.0.len() > NAME_BYTES_MAX {
            return self.fail(connection, frame.request_id, 108, "tag is too long");
        }
        let Some(session) = &mut self.session else { return };
        match session.trigger(now_ns, trigger, &mut self.counts, &self.settings) {
            Ok((reply, exposure)) => {
                self.send(connection, frame.request_id, FLAG_REPLY, &Message::TriggerOk(reply));
                if let Some((job, capture)) = exposure {
                    self.outputs.push_back(DeviceOutput::Expose {
                        job,
                        trigger_id: trigger.trigger_id,
                        capture,
                    });
                }
            }
            Err(refusal) => self.refuse(connection, frame, refusal),
        }
    }

    fn take_abort(&mut self, connection: u64, frame: &RawFrame, trigger_id: u64) {
        let Some(session) = &mut self.session else { return };
        let (aborted, frame_end) = session.abort(trigger_id);
        self.send(connection, frame.request_id, FLAG_REPLY, &Message::Aborted(aborted));
        if let Some(frame_end) = frame_end {
            self.send(connection, 0, 0, &Message::FrameEnd(frame_end));
        }
    }

    fn status(&self) -> Message {
        Message::Status(Status {
            state: self.session.as_ref().map_or(STATE_IDLE, Session::state),
            queue_count: 0,
            reserved_1: Zero,
            temperature_c: TEMPERATURE_C,
            warm_up_done_s: WARM_UP_S,
            warm_up_required_s: WARM_UP_S,
            trigger_count: self.counts.triggers,
            frame_count: self.counts.frames,
            missed_count: 0,
            vendor_timeout_count: 0,
            lost_packet_count: 0,
            link_mbit_s: LINK_MBIT_S,
            last_error: self.counts.last_error,
            reserved_2: Zero,
        })
    }

    fn refuse_without_session(&mut self, connection: u64, frame: &RawFrame) {
        self.refuse(connection, frame, Refusal::new(205, "no session: HELLO comes first"));
    }

    fn refuse(&mut self, connection: u64, frame: &RawFrame, refusal: Refusal) {
        self.send_error(connection, frame.request_id, &refusal);
    }

    /// A protocol error: ERROR, BYE, end.
    fn fail(&mut self, connection: u64, request_id: u32, code: u16, text: &str) {
        self.outputs.push_back(DeviceOutput::Violation(format!(
            "a3dp connection {connection}: {code}: {text}"
        )));
        self.send_error(connection, request_id, &Refusal::new(code, text));
        self.bye(connection, BYE_PROTOCOL_ERROR, "protocol error");
    }

    fn bye(&mut self, connection: u64, reason: u16, text: &str) {
        self.send(
            connection,
            0,
            0,
            &Message::Bye(Bye {
                reason,
                text: Str8(text.to_owned()),
            }),
        );
        self.close(connection);
    }

    fn close(&mut self, connection: u64) {
        self.outputs.push_back(DeviceOutput::Close { connection });
        self.forget(connection);
    }

    /// The session of a connection ends with it, and with the session its settings, its acquisition and its trigger ids.
    fn forget(&mut self, connection: u64) {
        self.connections.remove(&connection);
        self.session.take_if(|session| session.connection == connection);
    }

    fn send_error(&mut self, connection: u64, request_id: u32, refusal: &Refusal) {
        self.counts.last_error = refusal.code;
        let error = Message::Error(ErrorReport {
            about_request_id: request_id,
            trigger_id: refusal.trigger_id,
            code: refusal.code,
            phase: refusal.phase,
            retryable: u8::from(refusal.is_retryable),
            retry_after_ms: 0,
            vendor_code: 0,
            text: Str16(refusal.text.clone()),
        });
        let flags = if request_id == 0 {
            FLAG_ERROR
        } else {
            FLAG_ERROR | FLAG_REPLY
        };
        self.send(connection, request_id, flags, &error);
    }

    fn send(&mut self, connection: u64, request_id: u32, flags: u16, message: &Message) {
        let Some(state) = self.connections.get_mut(&connection) else {
            return;
        };
        if state.is_silent {
            return;
        }
        let flags = if matches!(message, Message::FrameEnd(_)) {
            flags | FLAG_LAST
        } else {
            flags
        };
        let frame = RawFrame {
            kind: message.kind(),
            request_id,
            seq: state.next_seq,
            flags,
            payload: message.to_payload(),
        };
        state.next_seq = state.next_seq.wrapping_add(1);
        self.outputs.push_back(DeviceOutput::Bytes {
            connection,
            bytes: frame.to_bytes(),
        });
    }
}

/// A reply carries the reply flag, an ERROR the error flag, and every request an id.
fn flags_agree(frame: &RawFrame, message: &Message) -> bool {
    match message {
        Message::Pong(_) => frame.flags == FLAG_REPLY,
        Message::Error(_) => frame.flags & !FLAG_REPLY == FLAG_ERROR,
        Message::Bye(_) => frame.flags == 0,
        _ => frame.flags == 0 && frame.request_id != 0,
    }
}

fn state_now(state: u8) -> StateNow {
    StateNow { state, reserved: Zero }
}

const ROLE_OBSERVER: u8 = 2;
const NAME_BYTES_MAX: usize = 64;
const PEER_DEAD_NS: u64 = 5_000_000_000;
const BYE_SHUTTING_DOWN: u16 = 2;
const BYE_PROTOCOL_ERROR: u16 = 3;
const BYE_TIME_OUT: u16 = 4;
const BYE_REFUSED: u16 = 5;

#[cfg(test)]
#[path = "device_tests/mod.rs"]
mod tests;
