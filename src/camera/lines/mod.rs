//! Connections to a camera on which one thing is said at a time: for looking at a camera without a run, and for the
//! conformance suite, which opens several at once and says wrong things on purpose.
//!
//! Everything outside is one function that is handed in: it does a [`Deed`] and tells the time and what has happened.
//! The program gives one with sockets; tests give the simulated camera on virtual time.

mod heard;
mod line;
#[cfg(test)]
mod tests;

pub use heard::{Heard, message_name};
pub use line::{Line, StatusSeen};

use super::message::{ClientMessage, Pong, ServerMessage};
use crate::stamp::{Stamp, earlier};
use line::Standing;
use thiserror::Error;

/// What is to be done outside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Deed {
    /// Open a connection; what becomes of it is news.
    Connect {
        /// Names it.
        line: LineId,
    },
    /// Send.
    Bytes {
        /// On which connection.
        line: LineId,
        /// What.
        bytes: Vec<u8>,
    },
    /// Close a connection, once its bytes are sent. No news comes of it any more.
    Close {
        /// Which.
        line: LineId,
    },
    /// Wait for the first news, but no longer than this.
    Wait {
        /// Until when.
        until: Stamp,
    },
}

/// What has happened outside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum News {
    /// A connection stands.
    Connected {
        /// Which.
        line: LineId,
    },
    /// Bytes have come.
    Bytes {
        /// On which connection.
        line: LineId,
        /// What.
        bytes: Vec<u8>,
    },
    /// A connection did not come about, or has ended.
    Closed {
        /// Which.
        line: LineId,
        /// Why, for people.
        reason: String,
    },
}

/// Names a connection, from 0 in the order of opening.
pub type LineId = usize;

/// Does a deed; says what time it is then and, after [`Deed::Wait`], what has happened.
pub type Carry<'a> = Box<dyn FnMut(Deed) -> (Stamp, Option<News>) + 'a>;

/// Why a line does not give what was expected of it.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum LineError {
    /// No connection came about.
    #[error("no connection: {0}")]
    Unreachable(String),
    /// The connection has ended.
    #[error("the connection has ended: {0}")]
    Closed(String),
    /// Nothing of the kind has come.
    #[error("no {what} within {ms} ms")]
    Silent {
        /// What was waited for.
        what: String,
        /// How long.
        ms: u64,
    },
    /// What came cannot be believed.
    #[error("{0}")]
    Protocol(String),
}

/// All connections of one client. From HELLO_OK on, each is kept alive while this side waits for anything.
pub struct Lines<'a> {
    carry: Carry<'a>,
    lines: Vec<Line>,
    now: Stamp,
}

impl<'a> Lines<'a> {
    /// Nothing is connected.
    pub fn new(carry: Carry<'a>) -> Self {
        Self {
            carry,
            lines: Vec::new(),
            now: Stamp::START,
        }
    }

    /// What time it is.
    pub fn now(&self) -> Stamp {
        self.now
    }

    /// What is known of a connection.
    pub fn line(&self, line: LineId) -> &Line {
        &self.lines[line]
    }

    /// Opens a connection and waits until it stands.
    ///
    /// # Errors
    ///
    /// It did not come about in time.
    pub fn connect(&mut self) -> Result<LineId, LineError> {
        let line = self.lines.len();
        self.lines.push(Line::new(self.now));
        self.carry_out(Deed::Connect { line });
        let until = self.now.plus_ms(CONNECT_MS);
        while matches!(self.lines[line].standing, Standing::Opening) {
            if !self.wait(until) {
                self.close(line);
                return Err(LineError::Unreachable(format!("none within {CONNECT_MS} ms")));
            }
        }
        match &self.lines[line].standing {
            Standing::Closed(reason) => Err(LineError::Unreachable(reason.clone())),
            _ => Ok(line),
        }
    }

    /// Says a message in a frame as it should be, and returns its request id.
    pub fn say(&mut self, line: LineId, message: &ClientMessage) -> u32 {
        let (bytes, request_id) = self.lines[line].frame(message);
        self.send(line, bytes);
        request_id
    }

    /// A frame as [`Self::say`] sends it, and its request id, to be changed and sent by [`Self::send`].
    pub fn frame(&mut self, line: LineId, message: &ClientMessage) -> (Vec<u8>, u32) {
        self.lines[line].frame(message)
    }

    /// The next frame of a type and flags that need not fit.
    pub fn raw_frame(&mut self, line: LineId, kind: u16, request_id: u32, flags: u16, payload: &[u8]) -> Vec<u8> {
        self.lines[line].raw_frame(kind, request_id, flags, payload)
    }

    /// Sends bytes as they are.
    pub fn send(&mut self, line: LineId, bytes: Vec<u8>) {
        self.lines[line].said_at = self.now;
        if self.lines[line].is_open() {
            self.carry_out(Deed::Bytes { line, bytes });
        }
    }

    /// Closes a connection without a word.
    pub fn close(&mut self, line: LineId) {
        if !matches!(self.lines[line].standing, Standing::Closed(_)) {
            self.lines[line].standing = Standing::Closed("closed by this side".into());
            self.carry_out(Deed::Close { line });
        }
    }

    /// Neither answers pings on this connection any more nor sends any.
    pub fn fall_silent(&mut self, line: LineId) {
        self.lines[line].lively = false;
    }

    /// Lets time pass while everything that comes is taken in.
    pub fn pass(&mut self, ms: u64) {
        let until = self.now.plus_ms(ms);
        while self.now < until {
            self.wait(until);
        }
    }

    /// The next frame of a connection, in the order of coming. Pings are answered and states noted by themselves.
    ///
    /// # Errors
    ///
    /// Nothing has come in time, or the connection has ended and everything that came before is taken.
    pub fn hear(&mut self, line: LineId, what: &str, ms: u64) -> Result<Heard, LineError> {
        self.hear_if(line, what, ms, |_| true)
    }

    /// The first frame of a connection that fits; the others stay for [`Self::hear`].
    ///
    /// # Errors
    ///
    /// As [`Self::hear`].
    pub fn hear_if(
        &mut self,
        line: LineId,
        what: &str,
        ms: u64,
        fits: impl Fn(&Heard) -> bool,
    ) -> Result<Heard, LineError> {
        let until = self.now.plus_ms(ms);
        loop {
            let state = &mut self.lines[line];
            if let Some(place) = state.heard.iter().position(&fits) {
                return Ok(state.heard.remove(place).expect("the place was just found"));
            }
            if let Some(odd) = &state.broken {
                return Err(LineError::Protocol(odd.clone()));
            }
            if let Standing::Closed(reason) = &state.standing {
                let goodbye = state.goodbye.as_ref();
                let goodbye = goodbye.map(|bye| format!(" after BYE {}: {}", bye.reason, bye.text));
                return Err(LineError::Closed(reason.clone() + &goodbye.unwrap_or_default()));
            }
            if !self.wait(until) {
                let what = what.to_owned();
                return Err(LineError::Silent { what, ms });
            }
        }
    }

    /// The reply to a request, whatever came before it.
    ///
    /// # Errors
    ///
    /// As [`Self::hear`].
    pub fn reply(&mut self, line: LineId, request_id: u32, what: &str, ms: u64) -> Result<Heard, LineError> {
        self.hear_if(line, what, ms, |heard| {
            heard.is_reply() && heard.request_id == request_id
        })
    }

    /// Waits until the other side has closed a connection.
    pub fn is_closed_within(&mut self, line: LineId, ms: u64) -> bool {
        let until = self.now.plus_ms(ms);
        while self.lines[line].is_open() {
            if !self.wait(until) {
                return false;
            }
        }
        true
    }

    /// Takes in the next news; false when there was none until then.
    fn wait(&mut self, until: Stamp) -> bool {
        let due = self.lines.iter().filter_map(Line::ping_due).min();
        let wake = earlier(due, Some(until)).unwrap_or(until);
        let news = self.carry_out(Deed::Wait { until: wake });
        let came = news.is_some();
        match news {
            Some(News::Connected { line }) => self.lines[line].standing = Standing::Open,
            Some(News::Bytes { line, bytes }) => self.take(line, &bytes),
            Some(News::Closed { line, reason }) => self.lines[line].standing = Standing::Closed(reason),
            None => {}
        }
        for line in 0..self.lines.len() {
            if self.lines[line].ping_due().is_some_and(|due| due <= self.now) {
                let ping = self.lines[line].ping(self.now);
                self.send(line, ping);
            }
        }
        came || self.now < until
    }

    fn take(&mut self, line: LineId, bytes: &[u8]) {
        let now = self.now;
        for sender in self.lines[line].take(now, bytes) {
            let pong = Pong {
                sender_ns: sender.sender_ns,
                device_ns: 0,
                host_ns: now.ns,
            };
            let pong = self.lines[line].pong(sender.request_id, &pong);
            self.send(line, pong);
        }
    }

    fn carry_out(&mut self, deed: Deed) -> Option<News> {
        let (now, news) = (self.carry)(deed);
        self.now = self.now.max(now);
        news
    }
}

/// The message of a frame, or why there is none.
///
/// # Errors
///
/// The payload does not follow the page, or no server says such a type.
pub fn server_message(heard: &Heard) -> Result<ServerMessage<'_>, LineError> {
    match ServerMessage::decode(heard.kind, &heard.payload) {
        Ok(Some(message)) => Ok(message),
        Ok(None) => Err(LineError::Protocol(format!("no server says {heard}"))),
        Err(error) => Err(LineError::Protocol(format!("{error} in {heard}"))),
    }
}

const CONNECT_MS: u64 = 3000;
