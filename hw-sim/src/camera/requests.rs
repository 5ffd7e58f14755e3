//! What a client says, by who says it, and what it is answered.

use crate::camera::a3dp::{FLAG_ERROR, FLAG_REPLY, RawFrame};
use crate::camera::bridge::Refusal;
use crate::camera::connection::Role;
use crate::camera::device::{BYE_PROTOCOL_ERROR, Device};
use crate::camera::fields::{Str16, Zero};
use crate::camera::identity::{ROLE_CONTROLLER, ROLE_OBSERVER, VERSION, hello_ok};
use crate::camera::message::{Event, Hello, Message, MessageError, NO_TRIGGER, Pong, StateNow};
use crate::fault::Fault;

impl Device {
    /// The checks stand in the order of the page: bytes, role, then what the request itself checks.
    pub(super) fn take_frame(&mut self, now_ns: u64, connection: u64, frame: &RawFrame) {
        let role = self.connections[&connection].role;
        let message = match Message::read(frame.kind, &frame.payload) {
            Ok(message) => message,
            Err(MessageError::UnknownType(_)) if role != Role::Stranger => {
                return self.refuse(connection, frame, &Refusal::new(106, "unknown type"));
            }
            Err(MessageError::UnknownType(_)) => return self.refuse_without_session(connection, frame),
            Err(MessageError::Payload { cause, kind }) => {
                let text = format!("type {kind:#06x}: {cause}");
                return self.fail(connection, frame.request_id, cause.code(), &text);
            }
        };
        if !flags_agree(frame, &message) {
            let text = "flags or request id do not fit the message";
            return self.fail(connection, frame.request_id, 108, text);
        }
        match (role, message) {
            (_, Message::Bye(_)) => self.close(connection),
            (Role::Stranger, Message::Hello(hello)) => self.greet(now_ns, connection, frame, &hello),
            (Role::Stranger, _) => self.refuse_without_session(connection, frame),
            (Role::Observer, message) if !is_for_observers(&message) => {
                self.refuse(connection, frame, &Refusal::new(207, "an observer only listens"));
            }
            (_, message) => self.take_message(now_ns, connection, frame, message),
        }
    }

    fn take_message(&mut self, now_ns: u64, connection: u64, frame: &RawFrame, message: Message) {
        let request_id = frame.request_id;
        let reply = match message {
            Message::Hello(_) => Err(Refusal::new(203, "session is open already")),
            Message::GetCaps => Ok(Message::Caps(self.caps.clone())),
            Message::Configure(records) => return self.configure(now_ns, connection, frame, &records.0),
            Message::Arm(arm) => self.bridge.arm(now_ns, &arm).map(state_now).map(Message::Armed),
            Message::Disarm => self.bridge.disarm().map(state_now).map(Message::Disarmed),
            Message::Trigger(trigger) => {
                let taken = self.bridge.trigger(now_ns, connection, request_id, &trigger);
                // An EVENT that tells why stands before the refusal.
                self.advance(now_ns);
                return self.refuse_if(connection, frame, taken);
            }
            Message::Fetch(trigger_id) => {
                let fetched = self.bridge.fetch(now_ns, connection, request_id, trigger_id);
                return self.refuse_if(connection, frame, fetched);
            }
            Message::Abort(trigger_id) => return self.abort(connection, frame, trigger_id),
            Message::GetStatus => Ok(self.bridge.status()),
            Message::Ping(sender_ns) => Ok(Message::Pong(Pong {
                sender_ns,
                device_ns: now_ns,
                host_ns: now_ns,
            })),
            Message::Pong(_) | Message::Error(_) | Message::Bye(_) => return,
            _ => Err(Refusal::new(106, "not a message to a camera")),
        };
        match reply {
            Ok(reply) => self.send(connection, request_id, FLAG_REPLY, &reply),
            Err(refusal) => self.refuse(connection, frame, &refusal),
        }
    }

    fn greet(&mut self, now_ns: u64, connection: u64, frame: &RawFrame, hello: &Hello) {
        if hello.min_version > VERSION || hello.max_version < VERSION {
            self.refuse(connection, frame, &Refusal::new(105, "only version 1.0 is spoken"));
            return self.bye(connection, BYE_PROTOCOL_ERROR, "version");
        }
        let role = match hello.role {
            ROLE_CONTROLLER if hello.run_id != 0 => Role::Controller,
            ROLE_OBSERVER => Role::Observer,
            _ => return self.refuse(connection, frame, &Refusal::new(301, "role or run")),
        };
        if !(1..=NAME_BYTES_MAX).contains(&hello.client_name.0.len()) {
            return self.refuse(connection, frame, &Refusal::new(301, "a name has 1 to 64 bytes"));
        }
        let admitted = match role {
            Role::Controller => self.admit_controller(now_ns, hello.run_id),
            _ => self.admit_observer(),
        };
        if let Err(text) = admitted {
            self.refuse(connection, frame, &Refusal::new(201, &text));
            return self.bye(connection, BYE_REFUSED, "busy");
        }
        if role == Role::Controller {
            self.bridge.handle_controller(connection, hello.run_id);
        }
        self.session_count += 1;
        if let Some(state) = self.connections.get_mut(&connection) {
            state.greet(now_ns, role, &hello.client_name.0);
        }
        let reply = Message::HelloOk(hello_ok(hello.role, self.session_count, self.boot_id));
        self.send(connection, frame.request_id, FLAG_REPLY, &reply);
    }

    /// Makes room for a controller, or says who has its place. One of the same run is replaced.
    fn admit_controller(&mut self, now_ns: u64, run_id: u64) -> Result<(), String> {
        for fault in &self.settings.faults {
            if let Fault::ControllerBusy { span_s } = fault {
                let span_ns = span_s.map_or(u64::MAX, |span_s| (span_s * 1e9) as u64);
                let until_ns = *self.busy_until_ns.get_or_insert(now_ns.saturating_add(span_ns));
                if now_ns < until_ns {
                    return Err("\"another controller\" has the camera".to_owned());
                }
            }
        }
        let Some(holder) = self.bridge.controller else {
            return Ok(());
        };
        if self.bridge.run_id() == Some(run_id) {
            self.bye(holder, BYE_REPLACED, "replaced by the same run");
            return Ok(());
        }
        let name = self.connections.get(&holder).map(|state| state.holder());
        Err(format!("{} has the camera", name.unwrap_or_default()))
    }

    fn admit_observer(&self) -> Result<(), String> {
        let observers = self.connections.values().filter(|state| state.role == Role::Observer);
        let names: Vec<String> = observers.map(|state| state.holder()).collect();
        if names.len() < OBSERVER_COUNT_MAX {
            Ok(())
        } else {
            Err(format!("{} observe already", names.join(", ")))
        }
    }

    fn configure(&mut self, now_ns: u64, connection: u64, frame: &RawFrame, records: &[u8]) {
        match self.bridge.configure(now_ns, records, &self.caps, &self.settings) {
            Ok(configured) => {
                let text = format!("config {}", configured.config_id);
                let reply = Message::Configured(configured);
                self.send(connection, frame.request_id, FLAG_REPLY, &reply);
                let event = Message::Event(Event {
                    code: EVENT_CONFIG_CHANGED,
                    reserved: Zero,
                    trigger_id: NO_TRIGGER,
                    device_ns: now_ns,
                    duration_ms: 0,
                    text: Str16(text),
                });
                self.tell_all(&event, |role| role == Role::Observer);
            }
            Err(refusal) => self.refuse(connection, frame, &refusal),
        }
    }

    fn abort(&mut self, connection: u64, frame: &RawFrame, trigger_id: u64) {
        let (aborted, ends) = self.bridge.abort(trigger_id);
        self.send(connection, frame.request_id, FLAG_REPLY, &Message::Aborted(aborted));
        for (to, end) in ends {
            self.send(to, 0, 0, &Message::FrameEnd(end));
        }
    }

    fn refuse_without_session(&mut self, connection: u64, frame: &RawFrame) {
        let refusal = Refusal::new(205, "no session: HELLO comes first");
        self.refuse(connection, frame, &refusal);
    }

    fn refuse_if(&mut self, connection: u64, frame: &RawFrame, outcome: Result<(), Refusal>) {
        if let Err(refusal) = outcome {
            self.refuse(connection, frame, &refusal);
        }
    }

    fn refuse(&mut self, connection: u64, frame: &RawFrame, refusal: &Refusal) {
        self.send_error(connection, frame.request_id, refusal);
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

fn is_for_observers(message: &Message) -> bool {
    matches!(
        message,
        Message::GetCaps | Message::GetStatus | Message::Ping(_) | Message::Pong(_) | Message::Error(_)
    )
}

fn state_now(state: u8) -> StateNow {
    StateNow { state, reserved: Zero }
}

const NAME_BYTES_MAX: usize = 64;
const OBSERVER_COUNT_MAX: usize = 3;
const BYE_REFUSED: u16 = 5;
const BYE_REPLACED: u16 = 6;
const EVENT_CONFIG_CHANGED: u16 = 6;
