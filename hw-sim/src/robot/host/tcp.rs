//! Host control over TCP port 80: one connection as a value, bytes and time in, bytes out.
//!
//! `CONNECT`, its answer, then requests one at a time: `HOSTCTRL_REQUEST name size`, `OK: name`, the data by its size, the
//! answer. A request that is malformed gets `NG:` and ends the connection; one that cannot be carried out gets `ERROR:`.

use std::collections::VecDeque;

use crate::robot::host::{Answer, Call, Interpret, bytes, text};

/// A client's connection. It waits for `CONNECT` first.
#[derive(Clone, Debug)]
pub struct Connection {
    pause_ns: u64,
    received: Vec<u8>,
    state: State,
    /// Requests that may still come; none for any number of them.
    remaining: Option<u32>,
    outputs: VecDeque<TcpOutput>,
}

/// What a connection wants done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TcpOutput {
    /// Bytes for the client; each piece is meant to be a segment of its own.
    Bytes(Vec<u8>),
    /// The connection ends here, once its bytes are sent.
    Close,
    /// The client broke the protocol.
    Violation(String),
}

#[derive(Clone, Debug)]
enum State {
    Connecting,
    Waiting,
    /// The data of a request is to come.
    Receiving {
        name: String,
        byte_count: usize,
        confirmed_ns: u64,
    },
    /// The command is under way; it is looked at again at the time given.
    Running {
        call: Call,
        look_ns: u64,
        confirmed_ns: u64,
    },
    /// The answer is known and waits for its time.
    Answering {
        answer: Vec<u8>,
        at_ns: u64,
    },
    Closed,
}

impl Connection {
    /// Connection just opened. `pause_ns` is the least time between `OK: name` and the answer of a command: public
    /// clients read once for each of them and fail when both come in one segment.
    pub fn new(pause_ns: u64) -> Self {
        Self {
            pause_ns,
            received: Vec::new(),
            state: State::Connecting,
            remaining: Some(1),
            outputs: VecDeque::new(),
        }
    }

    /// Takes a piece of the stream, however it is cut.
    pub fn handle_bytes(&mut self, now_ns: u64, bytes: &[u8], interpret: &mut Interpret) {
        if !matches!(self.state, State::Closed) {
            self.received.extend_from_slice(bytes);
            self.advance(now_ns, interpret);
        }
        if self.received.len() > RECEIVED_BYTES_MAX {
            self.refuse("more requests than answers were waited for");
        }
    }

    /// Lets happen what is due.
    pub fn handle_wake(&mut self, now_ns: u64, interpret: &mut Interpret) {
        self.advance(now_ns, interpret);
    }

    /// When [`Connection::handle_wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        match &self.state {
            State::Running { look_ns, .. } => Some(*look_ns),
            State::Answering { at_ns, .. } => Some(*at_ns),
            _ => None,
        }
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<TcpOutput> {
        self.outputs.pop_front()
    }

    /// Whether the connection has ended from this side.
    pub fn is_closed(&self) -> bool {
        matches!(self.state, State::Closed)
    }

    fn advance(&mut self, now_ns: u64, interpret: &mut Interpret) {
        while self.step(now_ns, interpret) {}
    }

    /// Whether there was something to do.
    fn step(&mut self, now_ns: u64, interpret: &mut Interpret) -> bool {
        match std::mem::replace(&mut self.state, State::Closed) {
            State::Connecting => match self.take_line() {
                Some(line) => self.connect(&line),
                None => self.stay(State::Connecting),
            },
            State::Waiting => match self.take_line() {
                Some(line) => self.request(now_ns, &line, interpret),
                None => self.stay(State::Waiting),
            },
            State::Receiving {
                name,
                byte_count,
                confirmed_ns,
            } => {
                if self.received.len() < byte_count {
                    return self.stay(State::Receiving {
                        name,
                        byte_count,
                        confirmed_ns,
                    });
                }
                let data: Vec<u8> = self.received.drain(..byte_count).collect();
                let data = self.without_end(&name, data);
                self.run(now_ns, name, data, confirmed_ns, interpret)
            }
            State::Running {
                call,
                look_ns,
                confirmed_ns,
            } if look_ns <= now_ns => self.look(now_ns, call, confirmed_ns, interpret),
            State::Answering { answer, at_ns } if at_ns <= now_ns => {
                self.outputs.push_back(TcpOutput::Bytes(answer));
                self.count();
                !self.is_closed()
            }
            State::Closed => {
                self.received.clear();
                false
            }
            waiting => self.stay(waiting),
        }
    }

    fn stay(&mut self, state: State) -> bool {
        self.state = state;
        false
    }

    /// The next whole line without its end. Ends of line before a request are left over from the data of the one before.
    fn take_line(&mut self) -> Option<String> {
        if matches!(self.received.first(), Some(b'\r' | b'\n')) {
            let count = self.received.iter().take_while(|byte| is_end(byte)).count();
            self.received.drain(..count);
            self.violation("an end of line that no size counts");
        }
        match self.received.iter().position(|byte| *byte == b'\n') {
            Some(end) if end < LINE_BYTES_MAX => {
                let line: Vec<u8> = self.received.drain(..=end).collect();
                let line = text(&line[..end]);
                match line.strip_suffix('\r') {
                    Some(line) => Some(line.to_owned()),
                    None => {
                        self.violation("a line that ends in LF alone");
                        Some(line)
                    }
                }
            }
            None if self.received.len() < LINE_BYTES_MAX => None,
            _ => {
                self.received.clear();
                Some(String::new())
            }
        }
    }

    fn connect(&mut self, line: &str) -> bool {
        let Some(rest) = line.strip_prefix("CONNECT Robot_access") else {
            return self.refuse(&format!("{line:?} is no CONNECT Robot_access"));
        };
        let keep_alive = match rest {
            "" => {
                self.remaining = Some(1);
                String::new()
            }
            _ => match rest.strip_prefix(" Keep-Alive:").map(str::parse::<i32>) {
                Some(Ok(KEEP_ALIVE_FOREVER)) => {
                    self.remaining = None;
                    format!(" Keep-Alive:{KEEP_ALIVE_FOREVER}")
                }
                Some(Ok(count @ KEEP_ALIVE_MIN..=KEEP_ALIVE_MAX)) => {
                    self.remaining = Some(count.unsigned_abs());
                    format!(" Keep-Alive:{count}")
                }
                _ => return self.refuse(&format!("{line:?} has no Keep-Alive:n with n = -1 or 2 to 32767")),
            },
        };
        let version = env!("CARGO_PKG_VERSION");
        self.say(&format!(
            "OK: DX Information Server(SIMULATED {version}){keep_alive}.\r\n"
        ));
        self.state = State::Waiting;
        true
    }

    fn request(&mut self, now_ns: u64, line: &str, interpret: &mut Interpret) -> bool {
        let words: Vec<&str> = line.split(' ').collect();
        let ["HOSTCTRL_REQUEST", name, size] = words[..] else {
            return self.refuse(&format!("{line:?} is no HOSTCTRL_REQUEST name size"));
        };
        if name.is_empty() || !name.bytes().all(|byte| byte.is_ascii_alphanumeric()) {
            return self.refuse(&format!("{name:?} is no name of a command"));
        }
        let Some(byte_count) = size.parse::<usize>().ok().filter(|size| *size <= DATA_BYTES_MAX) else {
            return self.refuse(&format!("{size:?} is no size from 0 to {DATA_BYTES_MAX}"));
        };
        self.say(&format!("OK: {name}\r\n"));
        let name = name.to_owned();
        if byte_count == 0 {
            return self.run(now_ns, name, String::new(), now_ns, interpret);
        }
        self.state = State::Receiving {
            name,
            byte_count,
            confirmed_ns: now_ns,
        };
        true
    }

    /// Data without the end that its size counts: a CR, or CR LF as some clients have it.
    fn without_end(&mut self, name: &str, mut data: Vec<u8>) -> String {
        let byte_count = data.iter().rev().take_while(|byte| is_end(byte)).count();
        if byte_count == 0 {
            self.violation(&format!("the data of {name} has no CR that its size counts"));
        }
        data.truncate(data.len() - byte_count);
        text(&data)
    }

    fn run(&mut self, now_ns: u64, name: String, data: String, confirmed_ns: u64, interpret: &mut Interpret) -> bool {
        let call = Call {
            name,
            data,
            since_ns: now_ns,
        };
        self.look(now_ns, call, confirmed_ns, interpret)
    }

    fn look(&mut self, now_ns: u64, call: Call, confirmed_ns: u64, interpret: &mut Interpret) -> bool {
        let answer = match interpret(now_ns, &call) {
            Answer::Later(look_ns) => {
                return self.stay(State::Running {
                    call,
                    look_ns: look_ns.max(now_ns + 1),
                    confirmed_ns,
                });
            }
            Answer::Done => "0000\r\n".to_owned(),
            Answer::Data(data) => format!("{data}\r"),
            Answer::Refused(code) => format!("ERROR: {} is not successful({code:04X})\r\n", call.name),
        };
        self.state = State::Answering {
            answer: bytes(&answer),
            at_ns: now_ns.max(confirmed_ns + self.pause_ns),
        };
        true
    }

    /// One request is over.
    fn count(&mut self) {
        self.remaining = self.remaining.map(|remaining| remaining.saturating_sub(1));
        if self.remaining == Some(0) {
            self.close();
        } else {
            self.state = State::Waiting;
        }
    }

    fn refuse(&mut self, why: &str) -> bool {
        self.violation(why);
        // The client's own words do not belong into a line of ours.
        self.say("NG: request refused\r\n");
        self.close();
        false
    }

    fn close(&mut self) {
        self.state = State::Closed;
        self.received.clear();
        self.outputs.push_back(TcpOutput::Close);
    }

    fn say(&mut self, line: &str) {
        self.outputs.push_back(TcpOutput::Bytes(line.as_bytes().to_vec()));
    }

    fn violation(&mut self, what: &str) {
        self.outputs.push_back(TcpOutput::Violation(what.to_owned()));
    }
}

fn is_end(byte: &u8) -> bool {
    matches!(byte, b'\r' | b'\n')
}

const KEEP_ALIVE_FOREVER: i32 = -1;
const KEEP_ALIVE_MIN: i32 = 2;
const KEEP_ALIVE_MAX: i32 = 32_767;
/// Of a line of the client; unknown, and no client's line comes near it.
const LINE_BYTES_MAX: usize = 256;
/// Of the data of a request: 256 bytes of I/O as decimal numbers have room.
const DATA_BYTES_MAX: usize = 2048;
/// Of what a client sends ahead, before its earlier requests are answered.
const RECEIVED_BYTES_MAX: usize = 8192;

#[cfg(test)]
#[path = "tcp_tests.rs"]
mod tests;
