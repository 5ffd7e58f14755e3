//! Host control over a serial line, as the host (`docs/protocols/bsc_like.md`).
//!
//! [`block`] writes and checks single blocks, `line` is one end of the line in both roles, and [`SerialLink`] says commands
//! and moves files over it.

pub mod block;
mod line;
#[cfg(test)]
mod tests;

use super::text;
use super::{HostLink, LinkEvent, Unsupported};
use crate::robot::command::{Command, Kind};
use crate::robot::file::{FileCommand, FileEnding, FileName};
use crate::robot::output::RobotOutput;
use crate::robot::reply::{Refusal, Reply};
use crate::robot::variable::Form;
use crate::stamp::{Stamp, earlier};
use block::Header;
use line::{Line, LineEvent, Transmission};
use std::collections::VecDeque;

/// Times and bounds of the line, named as in the controller's parameters where it has them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SerialSettings {
    /// Timer A (RS034): how long a control character may take, ms.
    pub timer_a_ms: u64,
    /// Timer B (RS035): how long the next block may take, ms.
    pub timer_b_ms: u64,
    /// Retry 1 (RS036): how often ENQ is sent again.
    pub retry_1: u32,
    /// Retry 2 (RS037): how often a block is sent again.
    pub retry_2: u32,
    /// After how long a silence inside of a block counts as its end, ms.
    pub gap_ms: u64,
    /// How long the controller may take from the end of a command to the ENQ of its answer, ms.
    pub answer_timeout_ms: u64,
}

impl Default for SerialSettings {
    /// The controller's own defaults; the last two are ours.
    fn default() -> Self {
        Self {
            timer_a_ms: 3000,
            timer_b_ms: 20_000,
            retry_1: 10,
            retry_2: 3,
            gap_ms: 500,
            answer_timeout_ms: 5000,
        }
    }
}

/// The host's end of the serial line: one command or file at a time.
#[derive(Debug)]
pub struct SerialLink {
    settings: SerialSettings,
    line: Line,
    open: Option<Open>,
    /// Until this moment the next answer counts as one to a command that nobody waits for any more.
    owed_until: Option<Stamp>,
    form: Option<Form>,
    /// Why the line has ended, if it has.
    ended: Option<String>,
    events: VecDeque<LinkEvent>,
}

#[derive(Debug)]
struct Open {
    what: What,
    /// When the wait for the answer ends; `None` while the command itself is being sent.
    due: Option<Stamp>,
    /// An answer was taken for an owed one while this was open.
    skipped: bool,
}

#[derive(Debug)]
enum What {
    Command(Command),
    Load { total_bytes: usize },
    Save(FileName),
    List,
    Delete,
}

impl SerialLink {
    /// A link on which nothing has been said.
    pub fn new(settings: SerialSettings) -> Self {
        Self {
            settings,
            line: Line::new(settings),
            open: None,
            owed_until: None,
            form: None,
            ended: None,
            events: VecDeque::new(),
        }
    }

    /// Does something with the controller's jobs; only when idle.
    ///
    /// A job that goes to the controller is sent like an act: none of its blocks leaves twice on silence, since nothing
    /// shows that a controller knows a repeated block. A half-sent job counts for nothing.
    ///
    /// # Errors
    ///
    /// The file is no job, or has a byte that the line cannot carry; nothing has been sent.
    pub fn transfer(&mut self, now: Stamp, command: &FileCommand) -> Result<(), Unsupported> {
        let said = |text: String| block::blocks(Header::COMMAND, None, text.as_bytes());
        let (what, blocks, kind) = match command {
            FileCommand::List(FileEnding::Jbi) => (What::List, said("RJDIR *\r".into()), command.kind()),
            FileCommand::List(_) => return Err(Unsupported::Command(command.name())),
            FileCommand::Save(name) => {
                job(name)?;
                let blocks = block::blocks(Header::JOB_REQUEST, None, file_line(name).as_bytes());
                (What::Save(name.clone()), blocks, command.kind())
            }
            FileCommand::Load { name, content } => {
                job(name)?;
                let (line, text) = (file_line(name), content.as_bytes());
                if !block::carries(text) {
                    let beginning = &text[..text.len().min(SHOWN_BYTES_MAX)];
                    return Err(Unsupported::Text(String::from_utf8_lossy(beginning).into_owned()));
                }
                let total_bytes = line.len() + text.len();
                let blocks = block::blocks(Header::JOB, Some(line.as_bytes()), text);
                (What::Load { total_bytes }, blocks, Kind::Act)
            }
            FileCommand::Delete(name) => (What::Delete, said(format!("DELETE {}\r", job(name)?)), command.kind()),
        };
        self.begin(now, what, blocks, kind);
        Ok(())
    }
}

impl HostLink for SerialLink {
    fn is_idle(&self) -> bool {
        self.open.is_none() && self.line.is_idle()
    }

    /// An act's block is sent again only when the controller says that it has not taken it. When nothing is said, the
    /// transmission is ended, and its answer is awaited all the same.
    fn say(&mut self, now: Stamp, command: &Command) -> Result<(), Unsupported> {
        if let Some(reason) = &self.ended {
            return Err(Unsupported::Ended(reason.clone()));
        }
        let phrase = text::phrase(command, self.form)?;
        let text = match phrase.data.as_str() {
            "" => format!("{}\r", phrase.name),
            data => format!("{} {data}\r", phrase.name),
        };
        let blocks = block::blocks(Header::COMMAND, None, text.as_bytes());
        self.begin(now, What::Command(command.clone()), blocks, command.kind());
        Ok(())
    }

    /// The answer of what is given up, should one come, is dropped.
    fn give_up(&mut self, now: Stamp) {
        if let Some(open) = self.open.take()
            && (open.due.is_some() || self.line.is_sending())
        {
            self.owe(now);
        }
        self.line.stop(now);
        self.hear_line(now);
    }

    /// A block that is given up is not waited for anyway.
    fn handle_withheld(&mut self, _now: Stamp) {}

    /// A serial line is open or it is not: nothing connects it.
    fn handle_connected(&mut self, _now: Stamp) {}

    /// A line that has ended stays so.
    fn handle_closed(&mut self, _now: Stamp, reason: &str) {
        let reason = reason.to_owned();
        self.line = Line::new(self.settings);
        self.ended = Some(reason.clone());
        self.events.push_back(LinkEvent::Lost { reason });
        if self.open.is_some() {
            self.end(LinkEvent::Unanswered);
        }
    }

    fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.line.handle_bytes(now, bytes);
        self.hear_line(now);
    }

    fn handle_wake(&mut self, now: Stamp) {
        self.line.handle_wake(now);
        self.hear_line(now);
        // An answer that has begun is waited for as long as the line's own timers allow.
        if self.answer_due().is_some_and(|due| due <= now) {
            if self.open.as_ref().is_some_and(|open| !open.skipped) {
                self.owe(now);
            }
            self.end(LinkEvent::Unanswered);
        }
    }

    fn wake_at(&self) -> Option<Stamp> {
        earlier(self.line.wake_at(), self.answer_due())
    }

    fn poll_output(&mut self) -> Option<RobotOutput> {
        let (bytes, kind) = self.line.outbox.pop_front()?;
        Some(RobotOutput::Bytes { bytes, kind })
    }

    fn poll_event(&mut self) -> Option<LinkEvent> {
        self.events.pop_front()
    }
}

impl SerialLink {
    fn begin(&mut self, now: Stamp, what: What, blocks: Vec<block::Block>, kind: Kind) {
        debug_assert!(self.is_idle(), "one transaction at a time");
        self.open = Some(Open {
            what,
            due: None,
            skipped: false,
        });
        self.line.send(now, blocks, kind);
    }

    fn answer_due(&self) -> Option<Stamp> {
        let due = self.open.as_ref().and_then(|open| open.due);
        due.filter(|_| self.line.is_idle())
    }

    /// The controller may still answer something that nobody waits for.
    fn owe(&mut self, now: Stamp) {
        self.owed_until = Some(now.plus_ms(self.settings.timer_b_ms));
    }

    fn hear_line(&mut self, now: Stamp) {
        while let Some(event) = self.line.events.pop_front() {
            match event {
                LineEvent::Sent | LineEvent::Unsettled => {
                    let due = now.plus_ms(self.settings.answer_timeout_ms);
                    if let Some(open) = &mut self.open {
                        open.due = Some(due);
                    }
                }
                LineEvent::NotSent => self.end(LinkEvent::Unanswered),
                LineEvent::Progress(done_bytes) => self.tell_progress(done_bytes),
                LineEvent::Delivered(transmission) => self.hear(now, transmission),
                LineEvent::Noise { reason, malformed } => self.dropped(reason, malformed),
            }
        }
    }

    fn tell_progress(&mut self, done_bytes: usize) {
        let total_bytes = match &self.open {
            Some(Open {
                what: What::Load { total_bytes },
                due: None,
                ..
            }) => Some(*total_bytes),
            Some(Open {
                what: What::Save(_),
                due: Some(_),
                ..
            }) => None,
            _ => return,
        };
        self.events.push_back(LinkEvent::Progress {
            done_bytes,
            total_bytes,
        });
    }

    /// A transmission of the controller: the answer to what is open, unless it comes too early or is owed to another.
    fn hear(&mut self, now: Stamp, transmission: Transmission) {
        let owed = self.owed_until.take().is_some_and(|until| now < until);
        match &mut self.open {
            Some(open) if open.due.is_some() && !owed => self.answer(transmission),
            open => {
                if let Some(open) = open {
                    open.skipped = open.due.is_some();
                }
                self.dropped("an answer that is late or foreign".into(), false);
            }
        }
    }

    fn answer(&mut self, Transmission { header, text }: Transmission) {
        let Some(open) = &self.open else { return };
        let line = String::from_utf8_lossy(&text);
        let line = line.trim_end_matches('\r');
        let code = text::result_code(line).filter(|_| header == Header::RESULT);
        let event = match (&open.what, header) {
            (_, Header::RESULT) if code.is_some_and(|code| code != 0) => Ok(LinkEvent::Refused(Refusal {
                status: 0x1F,
                added_status: code.unwrap_or(0),
            })),
            (What::Command(command), Header::RESULT) if code == Some(0) && !text::expects_data(command) => {
                Ok(LinkEvent::Answered(Reply::Done))
            }
            (What::Load { .. } | What::Delete, Header::RESULT) if code == Some(0) => {
                Ok(LinkEvent::Answered(Reply::Done))
            }
            (What::Command(command), Header::DATA) if text::expects_data(command) => {
                if *command == Command::Position {
                    self.form = text::form(line).or(self.form);
                }
                let reply =
                    text::reply(command, line).map_err(|error| format!("answer to {}: {error}", command.name()));
                reply.map(LinkEvent::Answered)
            }
            (What::List, Header::DATA) => Ok(LinkEvent::Listed { names: listed(line) }),
            (What::Save(name), Header::JOB) => saved(name, &text),
            (_, Header(header)) => Err(format!(
                "an answer {} {:?} that does not fit what was said",
                String::from_utf8_lossy(&header),
                line.chars().take(SHOWN_BYTES_MAX).collect::<String>()
            )),
        };
        match event {
            Ok(event) => self.end(event),
            Err(reason) => {
                self.dropped(reason, true);
                self.end(LinkEvent::Unanswered);
            }
        }
    }

    fn end(&mut self, event: LinkEvent) {
        if self.open.take().is_some() {
            self.events.push_back(event);
        }
    }

    fn dropped(&mut self, reason: String, malformed: bool) {
        self.events.push_back(LinkEvent::Dropped { reason, malformed });
    }
}

/// The job that the file holds.
fn job(name: &FileName) -> Result<&str, Unsupported> {
    let not_a_job = || Unsupported::Value {
        field: "a file that is no job",
        value: name.to_string(),
    };
    name.as_str().strip_suffix(".JBI").ok_or_else(not_a_job)
}

/// The first block of a file: its name and CR.
fn file_line(name: &FileName) -> String {
    format!("{name}\r")
}

/// Name, CR, text.
fn saved(name: &FileName, transmission: &[u8]) -> Result<LinkEvent, String> {
    match transmission.strip_prefix(file_line(name).as_bytes()) {
        Some(content) => Ok(LinkEvent::Saved {
            name: name.clone(),
            content: content.to_vec(),
        }),
        None => Err(format!("another file than {name}")),
    }
}

/// Names of jobs, with the ending that they have as files.
fn listed(line: &str) -> Vec<String> {
    let names = line.split(',').map(str::trim).filter(|name| !name.is_empty());
    names
        .map(|name| format!("{}.JBI", name.trim_end_matches(".JBI")))
        .collect()
}

/// Of a text that is refused, this much is told.
const SHOWN_BYTES_MAX: usize = 40;
