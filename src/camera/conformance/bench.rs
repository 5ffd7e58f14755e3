//! What every clause does: greet, configure, arm, trigger, follow an acquisition to its end.

use super::course::Course;
use super::{Context, Miss};
use crate::camera::lines::{Heard, LineError, LineId, Lines, server_message};
use crate::camera::message::{
    Arm, Bye, CameraError, CameraState, ClientMessage, Configured, Greeting, Hello, Repeated, ServerMessage,
    TRIGGER_ALL, Trigger, TriggerId, TriggerOk,
};
use crate::camera::settings::CameraSettings;

/// The place where one clause is tried: its own connections, its own run, its own view number.
pub(super) struct Bench<'b, 'a> {
    pub(super) lines: &'b mut Lines<'a>,
    pub(super) context: &'b mut Context,
    pub(super) view: u32,
    opened: Vec<Opened>,
}

struct Opened {
    line: LineId,
    controls: bool,
}

impl<'b, 'a> Bench<'b, 'a> {
    pub(super) fn new(lines: &'b mut Lines<'a>, context: &'b mut Context, view: u32) -> Self {
        Self {
            lines,
            context,
            view,
            opened: Vec::new(),
        }
    }

    /// A run id that was not used before.
    pub(super) fn new_run(&mut self) -> u64 {
        self.context.next_run += 1;
        self.context.next_run
    }

    /// A connection on which nothing has been said.
    pub(super) fn connect(&mut self) -> Result<LineId, Miss> {
        let line = self.lines.connect()?;
        let controls = false;
        self.opened.push(Opened { line, controls });
        Ok(line)
    }

    /// A controller of a new run.
    pub(super) fn controller(&mut self) -> Result<LineId, Miss> {
        let run_id = self.new_run();
        Ok(self.greet(&hello(run_id))?.0)
    }

    /// An observer.
    pub(super) fn observer(&mut self) -> Result<LineId, Miss> {
        Ok(self.greet(&Hello::observer(NAME))?.0)
    }

    /// A connection that greets and is accepted. Where an earlier connection still holds the place, it waits until the
    /// server must have noticed its death.
    pub(super) fn greet(&mut self, hello: &Hello) -> Result<(LineId, Greeting), Miss> {
        for last_chance in [false, true] {
            let line = self.connect()?;
            let heard = self.ask(line, &ClientMessage::Hello(hello.clone()))?;
            match server_message(&heard)? {
                ServerMessage::HelloOk(greeting) => {
                    if let Some(opened) = self.opened.last_mut() {
                        opened.controls = hello.role == Hello::CONTROLLER;
                    }
                    return Ok((line, greeting));
                }
                ServerMessage::Error(error) if error.code == 201 && !last_chance => {
                    self.lines.close(line);
                    self.lines.pass(DEAD_MS);
                }
                _ => return Err(unexpected("HELLO_OK", &heard)),
            }
        }
        unreachable!("the last chance returns")
    }

    /// Says a request and gives back its reply.
    pub(super) fn ask(&mut self, line: LineId, message: &ClientMessage) -> Result<Heard, Miss> {
        let request_id = self.lines.say(line, message);
        self.reply(line, request_id, message)
    }

    pub(super) fn reply(&mut self, line: LineId, request_id: u32, message: &ClientMessage) -> Result<Heard, Miss> {
        let name = crate::camera::lines::message_name(message.kind());
        let what = format!("reply to {name} (request {request_id})");
        Ok(self.lines.reply(line, request_id, &what, REPLY_MS)?)
    }

    /// Says a request that must be refused with this code, and that leaves the connection open.
    pub(super) fn refused(&mut self, line: LineId, message: &ClientMessage, code: u16) -> Result<CameraError, Miss> {
        let heard = self.ask(line, message)?;
        let error = is_error(&heard, code)?;
        if error.about_request_id != heard.request_id {
            return Err(Miss::failed(format!(
                "about_request_id is not that of the header: {heard}"
            )));
        }
        Ok(error)
    }

    /// The state, asked for.
    pub(super) fn state(&mut self, line: LineId) -> Result<CameraState, Miss> {
        let heard = self.ask(line, &ClientMessage::GetStatus)?;
        match server_message(&heard)? {
            ServerMessage::Status(status) => Ok(status.state),
            _ => Err(unexpected("STATUS", &heard)),
        }
    }

    pub(super) fn is_in(&mut self, line: LineId, expected: CameraState) -> Result<(), Miss> {
        let found = self.state(line)?;
        require(found == expected, || {
            format!("the state is {found:?} where {expected:?} belongs")
        })
    }

    /// Sets settings that must be accepted.
    pub(super) fn configure(&mut self, line: LineId, settings: &CameraSettings) -> Result<Configured, Miss> {
        let heard = self.ask(line, &ClientMessage::Configure(*settings))?;
        match server_message(&heard)? {
            ServerMessage::Configured(configured) => Ok(configured),
            ServerMessage::Error(error) if matches!(error.code, 500 | 501 | 503 | 504) => Err(Miss::Skipped(format!(
                "the device is not there: {} {}",
                error.code, error.text
            ))),
            _ => Err(unexpected("CONFIGURED", &heard)),
        }
    }

    /// Arms for the settings in force.
    pub(super) fn arm(&mut self, line: LineId, config_id: u32) -> Result<(), Miss> {
        let heard = self.ask(line, &arm(config_id))?;
        match server_message(&heard)? {
            ServerMessage::Armed { .. } => Ok(()),
            _ => Err(unexpected("ARMED", &heard)),
        }
    }

    /// A controller of a new run, configured and armed.
    pub(super) fn armed(&mut self, settings: &CameraSettings) -> Result<(LineId, Configured), Miss> {
        let line = self.controller()?;
        let configured = self.configure(line, settings)?;
        self.arm(line, configured.config_id)?;
        Ok((line, configured))
    }

    /// Names an acquisition of this clause.
    pub(super) fn trigger_id(&self, attempt: u16) -> TriggerId {
        TriggerId::new(self.view, attempt)
    }

    /// The request that starts one.
    pub(super) fn trigger(&self, attempt: u16, config_id: u32) -> ClientMessage {
        trigger(self.trigger_id(attempt), config_id, 0)
    }

    /// Starts one that must be newly accepted.
    pub(super) fn start(&mut self, line: LineId, attempt: u16, config_id: u32) -> Result<TriggerOk, Miss> {
        let message = self.trigger(attempt, config_id);
        let heard = self.ask(line, &message)?;
        let accepted = trigger_ok(&heard)?;
        require(accepted.repeated == Repeated::New, || {
            format!("not newly accepted: {heard}")
        })?;
        require(accepted.trigger_id == self.trigger_id(attempt), || {
            format!("of another trigger: {heard}")
        })?;
        Ok(accepted)
    }

    /// Follows an acquisition that was accepted to its end, whatever that is.
    pub(super) fn follow(&mut self, line: LineId, attempt: u16, configured: &Configured) -> Result<Course, Miss> {
        let id = self.trigger_id(attempt);
        Course::follow(self.lines, line, id, frame_ms(configured))
    }

    /// A whole acquisition that must end with a complete frame.
    pub(super) fn acquire(&mut self, line: LineId, attempt: u16, configured: &Configured) -> Result<Course, Miss> {
        self.start(line, attempt, configured.config_id)?;
        let course = self.follow(line, attempt, configured)?;
        course.is_complete()?;
        Ok(course)
    }

    /// Leaves every connection, so that the next clause finds the server at rest.
    pub(super) fn leave(&mut self) {
        for opened in std::mem::take(&mut self.opened) {
            let line = opened.line;
            if !self.lines.line(line).is_open() {
                continue;
            }
            if opened.controls {
                for message in [
                    ClientMessage::Abort {
                        trigger_id: TRIGGER_ALL,
                    },
                    ClientMessage::Disarm,
                ] {
                    let request_id = self.lines.say(line, &message);
                    self.lines.reply(line, request_id, "reply", LEAVE_MS).ok();
                }
            }
            self.lines.say(line, &bye());
            self.lines.is_closed_within(line, LEAVE_MS);
            self.lines.close(line);
        }
    }
}

/// The greeting of a controller.
pub(super) fn hello(run_id: u64) -> Hello {
    Hello::controller(run_id, NAME)
}

pub(super) fn arm(config_id: u32) -> ClientMessage {
    let mode = Arm::SOFTWARE;
    ClientMessage::Arm(Arm { mode, config_id })
}

pub(super) fn trigger(trigger_id: TriggerId, config_id: u32, deadline_ms: u32) -> ClientMessage {
    ClientMessage::Trigger(Trigger {
        trigger_id,
        view_id: trigger_id.view_index(),
        config_id,
        deadline_ms,
        tag: NAME.into(),
    })
}

pub(super) fn bye() -> ClientMessage {
    ClientMessage::Bye(Bye {
        reason: Bye::DONE,
        text: "done".into(),
    })
}

pub(super) fn trigger_ok(heard: &Heard) -> Result<TriggerOk, Miss> {
    match server_message(heard)? {
        ServerMessage::TriggerOk(accepted) => Ok(accepted),
        ServerMessage::Error(error) if matches!(error.code, 500..=504) => Err(Miss::Skipped(format!(
            "the device is not ready: {} {}",
            error.code, error.text
        ))),
        _ => Err(unexpected("TRIGGER_OK", heard)),
    }
}

/// The ERROR that this must be.
pub(super) fn is_error(heard: &Heard, code: u16) -> Result<CameraError, Miss> {
    match server_message(heard)? {
        ServerMessage::Error(error) if error.code == code => Ok(error),
        _ => Err(unexpected(&format!("ERROR {code}"), heard)),
    }
}

pub(super) fn unexpected(expected: &str, heard: &Heard) -> Miss {
    let said = match server_message(heard) {
        Ok(ServerMessage::Error(error)) => format!(" (ERROR {}: {})", error.code, error.text),
        _ => String::new(),
    };
    Miss::failed(format!("{expected} was expected, {heard} came{said}"))
}

/// Fails with these words unless it holds.
pub(super) fn require(holds: bool, words: impl FnOnce() -> String) -> Result<(), Miss> {
    match holds {
        true => Ok(()),
        false => Err(Miss::failed(words())),
    }
}

/// Longest time from an accepted trigger to FRAME_END (3.7), with a second for a busy machine.
pub(super) fn frame_ms(configured: &Configured) -> u64 {
    u64::from(configured.predicted_total_us) * 3 / 2000 + configured.frame_bytes / 20_000 + 2000 + 1000
}

impl From<LineError> for Miss {
    fn from(error: LineError) -> Self {
        Self::failed(error.to_string())
    }
}

/// What the suite calls itself.
pub(super) const NAME: &str = "bladescan conformance";
/// A request's reply (3.7).
pub(super) const REPLY_MS: u64 = 5000;
/// After so long a silent peer must have been noticed (3.7), with a second for a busy machine.
pub(super) const DEAD_MS: u64 = 6500;
const LEAVE_MS: u64 = 2000;
