//! Looking at a camera without a run: who it is, how it is, what it would set, a frame.

use super::capture::{Assembly, Capture};
use super::lines::{Carry, Heard, LineError, LineId, Lines, StatusSeen, server_message};
use super::message::{
    Arm, Bye, CameraError, CameraStatus, Caps, ClientMessage, Configured, FrameStatus, Greeting, Hello, ServerMessage,
    TRIGGER_ALL, Trigger, TriggerId,
};
use super::settings::CameraSettings;
use crate::stamp::Stamp;
use thiserror::Error;

/// One connection to a camera on which questions are asked one by one.
pub struct Visit<'a> {
    lines: Lines<'a>,
    line: LineId,
    greeting: Greeting,
    armed: bool,
}

/// Why the camera did not do what was asked.
#[derive(Debug, Error)]
pub enum VisitError {
    /// The connection, or what came on it.
    #[error(transparent)]
    Line(#[from] LineError),
    /// It said no.
    #[error("{what} is refused: {} ({})", .error.text, .error.code)]
    Refused {
        /// What was asked.
        what: &'static str,
        /// What it said.
        error: CameraError,
    },
    /// A frame that cannot be believed, or none.
    #[error("no frame: {0}")]
    Frame(String),
}

/// How the device's clock stands to ours.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// Device clock less the clock of this program (which starts at 0), ns.
    pub offset_ns: i64,
    /// The quickest round trip of those tried: the offset is uncertain by half of it, ns.
    pub round_trip_ns: u64,
}

impl<'a> Visit<'a> {
    /// Connects and greets.
    ///
    /// # Errors
    ///
    /// Nobody is there, or the greeting is refused.
    pub fn open(carry: Carry<'a>, hello: Hello) -> Result<Self, VisitError> {
        let mut lines = Lines::new(carry);
        let line = lines.connect()?;
        let heard = ask(&mut lines, line, "HELLO", &ClientMessage::Hello(hello))?;
        match server_message(&heard)? {
            ServerMessage::HelloOk(greeting) => Ok(Self {
                lines,
                line,
                greeting,
                armed: false,
            }),
            _ => Err(other(&heard)),
        }
    }

    /// Who the camera is.
    pub fn greeting(&self) -> &Greeting {
        &self.greeting
    }

    /// What time it is, since the visit began.
    pub fn now(&self) -> Stamp {
        self.lines.now()
    }

    /// What it can do.
    ///
    /// # Errors
    ///
    /// It does not say.
    pub fn caps(&mut self) -> Result<Caps, VisitError> {
        let heard = self.ask("GET_CAPS", &ClientMessage::GetCaps)?;
        match server_message(&heard)? {
            ServerMessage::Caps(caps) => Ok(caps),
            _ => Err(other(&heard)),
        }
    }

    /// How it is.
    ///
    /// # Errors
    ///
    /// It does not say.
    pub fn status(&mut self) -> Result<CameraStatus, VisitError> {
        let heard = self.ask("GET_STATUS", &ClientMessage::GetStatus)?;
        match server_message(&heard)? {
            ServerMessage::Status(status) => Ok(status),
            _ => Err(other(&heard)),
        }
    }

    /// How its clock stands to ours, from a few pings.
    ///
    /// # Errors
    ///
    /// It does not answer.
    pub fn clock(&mut self) -> Result<Clock, VisitError> {
        let mut best: Option<Clock> = None;
        for _ in 0..PING_COUNT {
            let sent_ns = self.lines.now().ns;
            let heard = self.ask("PING", &ClientMessage::Ping { sender_ns: sent_ns })?;
            let ServerMessage::Pong(pong) = server_message(&heard)? else {
                return Err(other(&heard));
            };
            let round_trip_ns = heard.at.ns.saturating_sub(sent_ns);
            let middle_ns = sent_ns + round_trip_ns / 2;
            let clock = Clock {
                offset_ns: pong.device_ns.wrapping_sub(middle_ns) as i64,
                round_trip_ns,
            };
            if best.is_none_or(|best| round_trip_ns < best.round_trip_ns) {
                best = Some(clock);
            }
        }
        Ok(best.expect("at least one ping was answered"))
    }

    /// The next status that comes by itself.
    ///
    /// # Errors
    ///
    /// None comes while five were due.
    pub fn next_status(&mut self) -> Result<StatusSeen, VisitError> {
        let seen = self.lines.line(self.line).statuses().len();
        for _ in 0..STATUS_MS / STATUS_STEP_MS {
            self.lines.pass(STATUS_STEP_MS);
            let line = self.lines.line(self.line);
            if let Some(status) = line.statuses().get(seen) {
                return Ok(status.clone());
            }
            if !line.is_open() {
                let goodbye = line
                    .goodbye()
                    .map_or_else(|| "without goodbye".to_owned(), |bye| bye.text.clone());
                return Err(LineError::Closed(goodbye).into());
            }
        }
        let what = "STATUS".to_owned();
        Err(LineError::Silent { what, ms: STATUS_MS }.into())
    }

    /// Sets settings, which are then in force.
    ///
    /// # Errors
    ///
    /// They are refused.
    pub fn configure(&mut self, settings: &CameraSettings) -> Result<Configured, VisitError> {
        if self.armed {
            self.ask("DISARM", &ClientMessage::Disarm)?;
            self.armed = false;
        }
        let heard = self.ask("CONFIGURE", &ClientMessage::Configure(*settings))?;
        match server_message(&heard)? {
            ServerMessage::Configured(configured) => Ok(configured),
            _ => Err(other(&heard)),
        }
    }

    /// Takes one frame with the settings in force. The camera flashes.
    ///
    /// # Errors
    ///
    /// The camera refuses, gives up, is late, or sends a frame that cannot be believed.
    pub fn capture(&mut self, configured: &Configured, trigger_id: TriggerId) -> Result<Capture, VisitError> {
        let config_id = configured.config_id;
        if !self.armed {
            let mode = Arm::SOFTWARE;
            self.ask("ARM", &ClientMessage::Arm(Arm { mode, config_id }))?;
            self.armed = true;
        }
        let trigger = Trigger {
            trigger_id,
            view_id: trigger_id.view_index(),
            config_id,
            deadline_ms: 0,
            tag: String::new(),
        };
        self.ask("TRIGGER", &ClientMessage::Trigger(trigger))?;
        // Section 3.7 of the page, and more patience, since nothing else waits.
        let limit_ms = u64::from(configured.predicted_total_us) * 3 / 2000
            + configured.frame_bytes / TRANSFER_BYTES_PER_MS
            + PATIENCE_MS;
        let until = self.lines.now().plus_ms(limit_ms);
        let mut assembly = None;
        loop {
            let left_ms = until.ms_since(self.lines.now());
            let heard = self.lines.hear(self.line, "whole frame", left_ms)?;
            let unfit = |error: super::capture::FrameError| VisitError::Frame(error.to_string());
            match server_message(&heard)? {
                ServerMessage::FrameBegin(begin) if begin.trigger_id == trigger_id => {
                    assembly = Some(Assembly::begin(*begin, self.greeting.frame_bytes_max).map_err(unfit)?);
                }
                ServerMessage::FrameChunk(chunk) => match &mut assembly {
                    Some(assembly) => assembly.push(&chunk).map_err(unfit)?,
                    None => return Err(VisitError::Frame("a chunk came before FRAME_BEGIN".into())),
                },
                ServerMessage::FrameEnd(end) => {
                    let Some(assembly) = assembly.take() else {
                        return Err(VisitError::Frame("FRAME_END came before FRAME_BEGIN".into()));
                    };
                    if end.status != FrameStatus::Complete {
                        return Err(VisitError::Frame("the camera gave it up".into()));
                    }
                    return assembly.end(&end).map_err(unfit);
                }
                ServerMessage::Error(error) if [trigger_id.0, TRIGGER_ALL].contains(&error.trigger_id) => {
                    return Err(VisitError::Refused { what: "TRIGGER", error });
                }
                _ => {}
            }
        }
    }

    /// Disarms where it armed, and says goodbye.
    pub fn leave(mut self) {
        if self.armed {
            self.ask("DISARM", &ClientMessage::Disarm).ok();
        }
        let text = "done".to_owned();
        let reason = Bye::DONE;
        self.lines.say(self.line, &ClientMessage::Bye(Bye { reason, text }));
        self.lines.is_closed_within(self.line, LEAVE_MS);
        self.lines.close(self.line);
    }

    fn ask(&mut self, what: &'static str, message: &ClientMessage) -> Result<Heard, VisitError> {
        ask(&mut self.lines, self.line, what, message)
    }
}

fn ask(lines: &mut Lines<'_>, line: LineId, what: &'static str, message: &ClientMessage) -> Result<Heard, VisitError> {
    let request_id = lines.say(line, message);
    let heard = lines.reply(line, request_id, &format!("reply to {what}"), REPLY_MS)?;
    match server_message(&heard)? {
        ServerMessage::Error(error) => Err(VisitError::Refused { what, error }),
        _ => Ok(heard),
    }
}

fn other(heard: &Heard) -> VisitError {
    LineError::Protocol(format!("the reply is to another request: {heard}")).into()
}

const REPLY_MS: u64 = 5000;
const LEAVE_MS: u64 = 1000;
const PING_COUNT: usize = 8;
const STATUS_MS: u64 = 5000;
const STATUS_STEP_MS: u64 = 50;
const TRANSFER_BYTES_PER_MS: u64 = 20_000;
const PATIENCE_MS: u64 = 10_000;
