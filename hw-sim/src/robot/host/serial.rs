//! The serial port of host control: the BSC-LIKE link before the interpreter and the files.
//!
//! A message comes, is carried out, and is answered with a message of the controller's own. Headers: 01,000 a command;
//! 02,xxx files, 03,xxx variables, 04,xxx signals, of which the ones from xx,050 on ask for what the others put; 90,000
//! says done, or the code of a refusal; 90,001 carries data.

use std::collections::VecDeque;

use crate::robot::controller::Controller;
use crate::robot::host::bsc::{Contention, Link, LinkOutput, Message, Timing};
use crate::robot::host::interpreter::{interpret, interpreter_code};
use crate::robot::host::{Answer, Call, bytes, text};
use crate::robot::refused::Refused;

/// The controller's end of the serial line.
#[derive(Clone, Debug)]
pub struct Serial {
    link: Link,
    /// A command that is not over yet, and when it is looked at again.
    running: Option<(Call, u64)>,
    outputs: VecDeque<SerialOutput>,
}

/// What the serial port wants done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SerialOutput {
    /// Bytes for the line.
    Bytes(Vec<u8>),
    /// The host broke the protocol, or the line did.
    Violation(String),
}

impl Serial {
    /// Port with an idle line.
    pub fn new(timing: Timing) -> Self {
        Self {
            link: Link::new(timing, Contention::Insist),
            running: None,
            outputs: VecDeque::new(),
        }
    }

    /// Takes a piece of what comes over the line.
    pub fn handle_bytes(&mut self, now_ns: u64, bytes: &[u8], controller: &mut Controller) {
        self.link.handle_bytes(now_ns, bytes);
        self.drain(now_ns, controller);
    }

    /// Lets happen what is due.
    pub fn handle_wake(&mut self, now_ns: u64, controller: &mut Controller) {
        self.link.handle_wake(now_ns);
        if let Some((call, _)) = self.running.take_if(|(_, look_ns)| *look_ns <= now_ns) {
            self.run(now_ns, call, controller);
        }
        self.drain(now_ns, controller);
    }

    /// When [`Serial::handle_wake`] has something to do.
    pub fn wake_at(&self) -> Option<u64> {
        let look_ns = self.running.as_ref().map(|(_, look_ns)| *look_ns);
        self.link.wake_at().into_iter().chain(look_ns).min()
    }

    /// Next thing to do.
    pub fn poll_output(&mut self) -> Option<SerialOutput> {
        self.outputs.pop_front()
    }

    fn drain(&mut self, now_ns: u64, controller: &mut Controller) {
        while let Some(output) = self.link.poll_output() {
            match output {
                LinkOutput::Bytes(bytes) => self.outputs.push_back(SerialOutput::Bytes(bytes)),
                LinkOutput::Message(message) => self.take(now_ns, &message, controller),
                LinkOutput::Sent => (),
                LinkOutput::Failed(message) => {
                    self.violation(format!("the host did not take the answer {}", message.header));
                }
                LinkOutput::Violation(what) => self.violation(what),
            }
        }
    }

    fn take(&mut self, now_ns: u64, message: &Message, controller: &mut Controller) {
        if self.running.take().is_some() {
            self.violation("a message before the answer to the one before".to_owned());
        }
        let Some((group, number)) = header_numbers(&message.header) else {
            return self.answer(now_ns, Answer::Refused(Refused::COMMAND.0));
        };
        match (group, number) {
            (COMMANDS, 0) => {
                let call = call(now_ns, &message.text());
                self.run(now_ns, call, controller);
            }
            (FILES, _) => self.file(now_ns, number, message, controller),
            (VARIABLES, _) => self.variable(now_ns, number, message, controller),
            (SIGNALS, 1) => self.ask(now_ns, "IOWRITE", line(message), controller),
            (SIGNALS, 51) => {
                let asked = line(message);
                match ask(now_ns, "IOREAD", asked.clone(), controller) {
                    Answer::Data(values) => {
                        let text = format!("{asked},{values}\r");
                        self.link.send(now_ns, Message::new("04,001", &bytes(&text)));
                    }
                    refused => self.answer(now_ns, refused),
                }
            }
            _ => {
                self.violation(format!("no message has the header {}", message.header));
                self.answer(now_ns, Answer::Refused(Refused::COMMAND.0));
            }
        }
    }

    /// 02,001 and on put the file that the first line names; 50 more ask for it, and get what a put would say.
    fn file(&mut self, now_ns: u64, number: u16, message: &Message, controller: &mut Controller) {
        let content = message.text();
        let end = content.iter().position(|byte| *byte == b'\r').unwrap_or(content.len());
        let name = text(&content[..end]);
        let is_of_kind = |number| extension(number).is_some_and(|extension| name.ends_with(extension));
        if is_of_kind(number) {
            let content = content.get(end + 1..).unwrap_or_default();
            let answer = match controller.put_file(now_ns, &name, content) {
                Ok(()) => Answer::Done,
                Err(error) => Answer::Refused(interpreter_code(error.refused)),
            };
            return self.answer(now_ns, answer);
        }
        let put = number.saturating_sub(ASKED);
        if is_of_kind(put) {
            return match controller.file(now_ns, &name) {
                Ok(content) => {
                    let message = Message::file(&format!("02,{put:03}"), &name, &content);
                    self.link.send(now_ns, message);
                }
                Err(refused) => self.answer(now_ns, Answer::Refused(interpreter_code(refused))),
            };
        }
        self.violation(format!("a file {name:?} with the header {}", message.header));
        self.answer(now_ns, Answer::Refused(Refused::OPERAND_RANGE.0));
    }

    /// 03,001 to 03,008 put `number,value`; 50 more ask for it with `number` and get what a put would say.
    fn variable(&mut self, now_ns: u64, number: u16, message: &Message, controller: &mut Controller) {
        let is_asked = number > ASKED;
        let put = if is_asked { number - ASKED } else { number };
        let Some(kind) = VARIABLE_KINDS.get(usize::from(put).wrapping_sub(1)) else {
            return self.answer(now_ns, Answer::Refused(Refused::COMMAND.0));
        };
        let data = format!("{kind},{}", line(message));
        if !is_asked {
            return self.ask(now_ns, "LOADV", data, controller);
        }
        match ask(now_ns, "SAVEV", data, controller) {
            Answer::Data(value) => {
                let text = format!("{},{value}\r", line(message));
                let header = format!("03,{put:03}");
                self.link.send(now_ns, Message::new(&header, &bytes(&text)));
            }
            refused => self.answer(now_ns, refused),
        }
    }

    fn ask(&mut self, now_ns: u64, name: &str, data: String, controller: &mut Controller) {
        let answer = ask(now_ns, name, data, controller);
        self.answer(now_ns, answer);
    }

    fn run(&mut self, now_ns: u64, call: Call, controller: &mut Controller) {
        match interpret(controller, now_ns, &call) {
            Answer::Later(look_ns) => self.running = Some((call, look_ns)),
            answer => self.answer(now_ns, answer),
        }
    }

    fn answer(&mut self, now_ns: u64, answer: Answer) {
        let message = match answer {
            Answer::Done | Answer::Later(_) => Message::new("90,000", b"0000\r"),
            Answer::Refused(code) => Message::new("90,000", format!("{code:04X}\r").as_bytes()),
            Answer::Data(data) => Message::new("90,001", &bytes(&format!("{data}\r"))),
        };
        self.link.send(now_ns, message);
    }

    fn violation(&mut self, what: String) {
        self.outputs.push_back(SerialOutput::Violation(what));
    }
}

/// The command of a text `NAME data`, without its ends of line.
fn call(now_ns: u64, line: &[u8]) -> Call {
    let line = text(line);
    let line = line.trim_end_matches(['\r', '\n']);
    let (name, data) = line.split_once(' ').unwrap_or((line, ""));
    Call {
        name: name.to_owned(),
        data: data.to_owned(),
        since_ns: now_ns,
    }
}

fn ask(now_ns: u64, name: &str, data: String, controller: &mut Controller) -> Answer {
    let call = Call {
        name: name.to_owned(),
        data,
        since_ns: now_ns,
    };
    interpret(controller, now_ns, &call)
}

/// The text of a message without its ends of line.
fn line(message: &Message) -> String {
    text(&message.text()).trim_end_matches(['\r', '\n']).to_owned()
}

/// Extension of the files that a number of a header puts.
fn extension(number: u16) -> Option<&'static str> {
    Some(match number {
        1 => ".JBI",
        2 => ".JBR",
        11..=30 | 232 | 241 => ".DAT",
        200..=204 => ".CND",
        240 => ".SYS",
        _ => return None,
    })
}

fn header_numbers(header: &str) -> Option<(u16, u16)> {
    let (group, number) = header.split_once(',')?;
    Some((group.parse().ok()?, number.parse().ok()?))
}

const COMMANDS: u16 = 1;
const FILES: u16 = 2;
const VARIABLES: u16 = 3;
const SIGNALS: u16 = 4;
/// Added to the number of a put to ask for it.
const ASKED: u16 = 50;
/// Kinds of SAVEV and LOADV behind 03,001 to 03,008: byte, integer, double, real, P as pulses, P as pose, EX as pulses, EX as
/// pose. A position itself says which of the two it is.
const VARIABLE_KINDS: [u16; 8] = [0, 1, 2, 3, 4, 4, 6, 6];

#[cfg(test)]
#[path = "serial_tests.rs"]
mod tests;
