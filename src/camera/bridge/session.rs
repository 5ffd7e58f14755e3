//! Who is connected, what each may say, and what becomes of a run when one leaves.

use super::connection::{ConnectionId, Role};
use super::transfer::Sending;
use super::{Ask, Bridge, DEAD_AFTER_MS, OBSERVERS_MAX, Run, STALL_MS, STATUS_MS};
use crate::camera::code;
use crate::camera::message::{
    AcquisitionPhase, Bye, CameraError, ClientMessage, FRAME_BYTES_LIMIT, Greeting, Hello, Pong, ServerMessage,
    TRIGGER_ALL,
};
use crate::camera::payload::PayloadError;
use crate::camera::wire::{CHUNK_PAYLOAD_MAX, CONTROL_PAYLOAD_MAX, FLAG_ERROR, FLAG_REPLY, WireFrame};
use crate::stamp::Stamp;

impl Bridge {
    /// Bytes have come.
    pub fn handle_bytes(&mut self, now: Stamp, id: ConnectionId, bytes: &[u8]) {
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        connection.last_heard = now;
        let mut reader = std::mem::take(&mut connection.reader);
        reader.push(bytes);
        while self.connections.get(&id).is_some_and(|connection| !connection.closing) {
            match reader.next_frame() {
                Ok(None) => break,
                Ok(Some(frame)) => self.handle_frame(now, id, &frame),
                Err(error) => self.accuse(now, id, 0, error.code(), &error.to_string()),
            }
        }
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.reader = reader;
        }
    }

    /// A connection has ended.
    pub fn handle_closed(&mut self, now: Stamp, id: ConnectionId) {
        self.leave(now, id);
        self.connections.remove(&id);
    }

    fn handle_frame(&mut self, now: Stamp, id: ConnectionId, frame: &WireFrame<'_>) {
        let request_id = frame.request_id;
        let message = match ClientMessage::decode(frame.kind, frame.payload) {
            Ok(Some(message)) => message,
            Ok(None) => {
                let text = format!("no client says {:#06x}", frame.kind);
                return self.refuse(id, request_id, code::UNKNOWN_TYPE, &text);
            }
            Err(PayloadError::Settings(error)) if request_id != 0 && frame.flags == 0 => {
                return match self.may_control(id) {
                    Ok(()) => self.refuse(id, request_id, error.code(), &error.to_string()),
                    Err(code) => self.refuse(id, request_id, code, REFUSED_ROLE),
                };
            }
            Err(error) => return self.accuse(now, id, request_id, code::MALFORMED_PAYLOAD, &error.to_string()),
        };
        if let Err(text) = check_header(&message, frame) {
            return self.accuse(now, id, request_id, code::MALFORMED_PAYLOAD, text);
        }
        match message {
            ClientMessage::Bye(_) => self.part(now, id, None),
            ClientMessage::Hello(hello) => self.hello(now, id, request_id, &hello),
            message => self.handle_message(now, id, request_id, message),
        }
    }

    fn handle_message(&mut self, now: Stamp, id: ConnectionId, request_id: u32, message: ClientMessage) {
        let Some(connection) = self.connections.get(&id) else {
            return;
        };
        if connection.role == Role::Stranger {
            return self.refuse(id, request_id, code::NO_SESSION, "HELLO comes first");
        }
        match message {
            ClientMessage::GetCaps => {
                let caps = self.caps.clone();
                self.reply(id, request_id, &ServerMessage::Caps(caps));
            }
            ClientMessage::GetStatus => {
                let status = self.status();
                self.reply(id, request_id, &ServerMessage::Status(status));
            }
            ClientMessage::Ping { sender_ns } => {
                let pong = Pong {
                    sender_ns,
                    device_ns: now.ns,
                    host_ns: now.ns,
                };
                self.reply(id, request_id, &ServerMessage::Pong(pong));
            }
            ClientMessage::Pong(_) => {}
            ClientMessage::Error(error) => self.note(format!("a client says: error {}: {}", error.code, error.text)),
            _ if connection.role == Role::Observer => self.refuse(id, request_id, code::READ_ONLY, REFUSED_ROLE),
            ClientMessage::Configure(settings) => self.configure(now, id, request_id, settings),
            ClientMessage::Arm(arm) => self.arm(id, request_id, arm),
            ClientMessage::Disarm => self.disarm(id, request_id),
            ClientMessage::Trigger(trigger) => self.trigger(now, id, request_id, &trigger),
            ClientMessage::Fetch { trigger_id } => self.fetch(now, id, request_id, trigger_id),
            ClientMessage::Abort { trigger_id } => self.abort(now, id, request_id, trigger_id),
            ClientMessage::Hello(_) | ClientMessage::Bye(_) => unreachable!("dealt with before"),
        }
    }

    fn may_control(&self, id: ConnectionId) -> Result<(), u16> {
        match self.connections.get(&id).map(|connection| connection.role) {
            Some(Role::Controller) => Ok(()),
            Some(Role::Observer) => Err(code::READ_ONLY),
            _ => Err(code::NO_SESSION),
        }
    }

    fn hello(&mut self, now: Stamp, id: ConnectionId, request_id: u32, hello: &Hello) {
        match self.connections.get(&id).map(|connection| connection.role) {
            Some(Role::Stranger) => {}
            Some(Role::Observer) => return self.refuse(id, request_id, code::READ_ONLY, REFUSED_ROLE),
            _ => return self.refuse(id, request_id, code::WRONG_STATE, "greeted already"),
        }
        if hello.min_version > VERSION || hello.max_version < VERSION {
            self.refuse(id, request_id, code::UNSUPPORTED_VERSION, "version 1.0 is spoken here");
            return self.part(now, id, Some((Bye::PROTOCOL, "no common version")));
        }
        let role = match hello.role {
            Hello::CONTROLLER if hello.run_id != 0 => Role::Controller,
            Hello::OBSERVER if hello.run_id == 0 => Role::Observer,
            _ => return self.refuse(id, request_id, code::OUT_OF_RANGE, "role or run_id: out of range"),
        };
        if !(1..=NAME_BYTES_MAX).contains(&hello.client_name.len()) {
            return self.refuse(id, request_id, code::OUT_OF_RANGE, "client_name: 1 to 64 bytes");
        }
        if let Some(holder) = self.holder_of(role, hello.run_id) {
            self.refuse(id, request_id, code::CONTROLLER_BUSY, &holder);
            return self.part(now, id, Some((Bye::REFUSED, "the role is taken")));
        }
        if role == Role::Controller {
            self.take_control(now, id, hello.run_id);
        }
        let greeting = self.greeting(hello.role);
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.greet(role, hello);
            connection.status_due = now.plus_ms(STATUS_MS);
            connection.reply(&mut self.outbox, request_id, &ServerMessage::HelloOk(greeting));
        }
    }

    /// Who has the role that is asked for, in words; `None` when it can be had.
    fn holder_of(&self, role: Role, run_id: u64) -> Option<String> {
        if role == Role::Controller {
            let holder = self.connections.get(&self.controller?)?;
            let words = format!("the controller is {} at {}", holder.name, holder.address);
            return (holder.run_id != run_id).then_some(words);
        }
        let observers = self
            .connections
            .values()
            .filter(|connection| connection.role == Role::Observer);
        (observers.count() >= OBSERVERS_MAX).then(|| format!("{OBSERVERS_MAX} observers are connected"))
    }

    /// Makes a connection the controller's: one of the same run gives way, another run is forgotten.
    fn take_control(&mut self, now: Stamp, id: ConnectionId, run_id: u64) {
        if let Some(older) = self.controller {
            self.part(
                now,
                older,
                Some((Bye::REPLACED, "another connection of the run took the place")),
            );
        }
        if self.run.id != run_id {
            if let Some(flight) = self.flight.take() {
                self.ask_vendor(&Ask::Abort {
                    acquisition: flight.acquisition,
                });
            }
            self.run = Run {
                id: run_id,
                ..Run::default()
            };
        }
        self.controller = Some(id);
    }

    fn greeting(&mut self, role: u8) -> Greeting {
        let session_id = self.next_session_id;
        self.next_session_id = session_id.checked_add(1).unwrap_or(1);
        let identity = self.identity.as_ref();
        let word = |of: fn(&super::Ready) -> &String| identity.map(of).cloned().unwrap_or_default();
        Greeting {
            version: VERSION,
            role,
            simulated: identity.is_some_and(|identity| identity.simulated),
            session_id,
            boot_id: self.boot_id,
            calibration_id: self.calibration_id,
            calibration_date: self.calibration_date,
            clock_hz: 1_000_000_000,
            control_payload_max: CONTROL_PAYLOAD_MAX as u32,
            chunk_payload_max: CHUNK_PAYLOAD_MAX as u32,
            frame_bytes_max: FRAME_BYTES_LIMIT,
            vendor: word(|identity| &identity.vendor),
            model: word(|identity| &identity.model),
            serial: word(|identity| &identity.serial),
            firmware: word(|identity| &identity.firmware),
            sdk_version: word(|identity| &identity.sdk_version),
        }
    }

    /// Ends a connection from this side, with a BYE if there is anything to say.
    fn part(&mut self, now: Stamp, id: ConnectionId, bye: Option<(u16, &str)>) {
        if let Some(connection) = self.connections.get_mut(&id) {
            if let Some((reason, text)) = bye {
                let text = text.to_owned();
                connection.say(&mut self.outbox, &ServerMessage::Bye(Bye { reason, text }));
            }
            connection.close(&mut self.outbox);
        }
        self.leave(now, id);
    }

    /// Ends every connection: the bridge shuts down.
    pub fn shut_down(&mut self, now: Stamp) {
        let ids: Vec<ConnectionId> = self.connections.keys().copied().collect();
        for id in ids {
            self.part(now, id, Some((Bye::SHUTTING_DOWN, "the bridge shuts down")));
        }
        self.ask_vendor(&Ask::End);
    }

    /// What follows when a connection is of no use any more. An acquisition in flight lives on.
    fn leave(&mut self, now: Stamp, id: ConnectionId) {
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.role = Role::Stranger;
        }
        self.waiting.retain(|transfer| transfer.connection != id);
        if self.transfer.as_ref().is_some_and(|transfer| transfer.connection == id) {
            self.next_transfer(now);
        }
        if self.controller == Some(id) {
            self.controller = None;
            self.armed = false;
            if let Some(flight) = &mut self.flight {
                flight.listener = None;
            }
        }
    }

    /// The other side broke the protocol: say so, leave, and believe nothing more.
    fn accuse(&mut self, now: Stamp, id: ConnectionId, request_id: u32, code: u16, text: &str) {
        self.refuse(id, request_id, code, text);
        self.part(now, id, Some((Bye::PROTOCOL, text)));
    }

    /// Answers a request with an error that is about nothing in flight.
    pub(super) fn refuse(&mut self, id: ConnectionId, request_id: u32, code: u16, text: &str) {
        self.refuse_trigger(id, request_id, TRIGGER_ALL, code, text);
    }

    /// Answers a request that names an acquisition with an error.
    pub(super) fn refuse_trigger(&mut self, id: ConnectionId, request_id: u32, trigger_id: u64, code: u16, text: &str) {
        self.counts.last_error = code;
        let error = ServerMessage::Error(CameraError {
            about_request_id: request_id,
            trigger_id,
            code,
            phase: match trigger_id {
                TRIGGER_ALL => AcquisitionPhase::None,
                _ => AcquisitionPhase::Acknowledge,
            },
            retryable: matches!(
                code,
                code::TRIGGER_IN_FLIGHT | code::NOT_ARMED | code::RESET_IN_PROGRESS | code::DEVICE_LOST
            ),
            retry_after_ms: 0,
            vendor_code: 0,
            text: text.to_owned(),
        });
        let Some(connection) = self.connections.get_mut(&id) else {
            return;
        };
        match request_id {
            0 => connection.say(&mut self.outbox, &error),
            _ => connection.reply(&mut self.outbox, request_id, &error),
        }
    }

    pub(super) fn reply(&mut self, id: ConnectionId, request_id: u32, message: &ServerMessage<'_>) {
        if let Some(connection) = self.connections.get_mut(&id) {
            connection.reply(&mut self.outbox, request_id, message);
        }
    }

    /// Tells each its condition, and parts from the dead and the stalled.
    pub(super) fn watch_connections(&mut self, now: Stamp) {
        let stalled = self
            .transfer
            .as_ref()
            .filter(|transfer| now >= transfer.last_moved.plus_ms(STALL_MS));
        if let Some((id, sending)) = stalled.map(|transfer| (transfer.connection, transfer.sending)) {
            let what = if sending == Sending::First { "its" } else { "a fetched" };
            self.note(format!("a client takes nothing of {what} frame"));
            self.part(now, id, Some((Bye::TIMEOUT, "the frame is not taken")));
        }
        let ids: Vec<ConnectionId> = self.connections.keys().copied().collect();
        let status = ServerMessage::Status(self.status());
        for id in ids {
            let Some(connection) = self.connections.get_mut(&id).filter(|connection| !connection.closing) else {
                continue;
            };
            if now >= connection.last_heard.plus_ms(DEAD_AFTER_MS) {
                self.part(now, id, Some((Bye::TIMEOUT, "nothing heard for 5 s")));
            } else if connection.role != Role::Stranger && now >= connection.status_due {
                connection.status_due = now.plus_ms(STATUS_MS);
                connection.say(&mut self.outbox, &status);
            }
        }
    }
}

/// Flags and request id must fit the type.
fn check_header(message: &ClientMessage, frame: &WireFrame<'_>) -> Result<(), &'static str> {
    let (flags_fit, needs_id) = match message {
        ClientMessage::Pong(_) => (frame.flags == FLAG_REPLY, false),
        ClientMessage::Error(_) => (
            frame.flags & FLAG_ERROR != 0 && frame.flags & !(FLAG_REPLY | FLAG_ERROR) == 0,
            false,
        ),
        ClientMessage::Bye(_) => (frame.flags == 0, false),
        _ => (frame.flags == 0, true),
    };
    if !flags_fit {
        return Err("the flags do not fit the type");
    }
    if needs_id && frame.request_id == 0 {
        return Err("a request with id 0");
    }
    Ok(())
}

const VERSION: [u8; 2] = [1, 0];
const NAME_BYTES_MAX: usize = 64;
const REFUSED_ROLE: &str = "only a controller may say this";
