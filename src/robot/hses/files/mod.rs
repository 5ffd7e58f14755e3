//! File control as a value: bytes and time in, bytes and events out (`docs/protocols/hses.md`, section 8).
//!
//! One transfer is open at a time. The controller repeats nothing by itself, so what remains unanswered is said again
//! here: the request, the last acknowledgement, or the last block. A block that comes again is acknowledged again and
//! not stored twice. The id stays the same through a transfer; block numbers tell repetitions apart.

use super::wire::{Block, FileAnswer, FileFrame, FileService};
use crate::robot::command::Kind;
use crate::robot::file::{FILE_BYTES_MAX, FileCommand, FileEnding, FileName};
use crate::robot::output::RobotOutput;
use crate::robot::reply::Refusal;
use crate::stamp::Stamp;
use std::collections::VecDeque;
use thiserror::Error;

/// Times and bounds of file control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileSettings {
    /// How long one answer, block or acknowledgement may take, ms.
    pub answer_timeout_ms: u64,
    /// How often the same frame is sent before the transfer counts as unanswered.
    pub attempts: u32,
}

/// What came of a transfer, or of a datagram that fits none.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FileEvent {
    /// The files of one ending.
    Listed {
        /// Which ending.
        ending: FileEnding,
        /// Their names as the controller writes them, in its order.
        names: Vec<String>,
    },
    /// A file has come from the controller.
    Saved {
        /// Its name.
        name: FileName,
        /// Its bytes, at most [`FILE_BYTES_MAX`].
        content: Vec<u8>,
    },
    /// A file has gone to the controller, and it has acknowledged the last block.
    Loaded {
        /// Its name.
        name: FileName,
    },
    /// A file of the controller is gone.
    Deleted {
        /// Its name.
        name: FileName,
    },
    /// The controller said no, at the beginning or in the middle. Of a file that was to go to it, nothing is known.
    Refused {
        /// What was asked.
        command: FileCommand,
        /// Why not.
        refusal: Refusal,
    },
    /// The transfer stopped without an answer. Of a file that was to go or to be deleted, nothing is known.
    Unanswered {
        /// What was asked.
        command: FileCommand,
    },
    /// The controller's file is larger than [`FILE_BYTES_MAX`] or has more than [`FILE_BLOCKS_MAX`] blocks; it is no
    /// longer acknowledged.
    TooLarge {
        /// What was asked.
        command: FileCommand,
    },
    /// A datagram that fits nothing open; it is dropped.
    Dropped {
        /// Why.
        reason: String,
        /// Whether its bytes make no sense (rather than being late, early or foreign).
        malformed: bool,
    },
}

/// A transfer is open already.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("a file is on its way already")]
pub struct FilesBusy;

/// The most blocks of one file.
pub const FILE_BLOCKS_MAX: u32 = 1 << 16;

/// The bytes of one block that we send: all public clients' controllers take as many, though 479 may go.
pub const FILE_BLOCK_BYTES: usize = 400;

/// File control.
#[derive(Debug)]
pub struct Files {
    settings: FileSettings,
    next_id: u8,
    open: Option<Transfer>,
    closed: Option<Closed>,
    outbox: VecDeque<RobotOutput>,
    events: VecDeque<FileEvent>,
}

#[derive(Debug)]
struct Transfer {
    command: FileCommand,
    id: u8,
    service: FileService,
    progress: Progress,
    /// What was said last, and how often.
    said: Vec<u8>,
    sent_count: u32,
    due: Stamp,
    /// Whether the request itself was sent more than once.
    request_repeated: bool,
    /// How often the block before was acknowledged again.
    echo_count: u32,
}

#[derive(Debug)]
enum Progress {
    /// Blocks come: so many have been stored.
    Coming { block_count: u32, content: Vec<u8> },
    /// Blocks go: this one is unanswered; 0 is the request.
    Going { block: u32 },
    /// One answer is awaited.
    Deleting,
}

/// The last transfer from the controller: its last block may come again if our acknowledgement was lost.
#[derive(Debug)]
struct Closed {
    id: u8,
    service: FileService,
    last: Block,
    echo_count: u32,
}

/// What an answer does to the open transfer.
enum Step {
    /// It does not fit; why.
    Drop(&'static str),
    /// Say this and wait on.
    Say(FileFrame),
    /// Acknowledge the same block again; nothing new has come.
    Echo(FileFrame),
    /// Over; say this last.
    Finish(Option<FileFrame>),
    /// Over, without a word.
    TooLarge,
}

impl Files {
    /// File control in which nothing has been asked.
    pub fn new(settings: FileSettings) -> Self {
        Self {
            settings,
            next_id: 1,
            open: None,
            closed: None,
            outbox: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Begins a transfer.
    ///
    /// # Errors
    ///
    /// Another is open.
    pub fn begin(&mut self, now: Stamp, command: FileCommand) -> Result<(), FilesBusy> {
        if self.open.is_some() {
            return Err(FilesBusy);
        }
        let id = self.next_id;
        self.next_id = self.next_id.checked_add(1).unwrap_or(1);
        let coming = Progress::Coming {
            block_count: 0,
            content: Vec::new(),
        };
        let (service, progress, data) = match &command {
            FileCommand::List(ending) => (FileService::List, coming, format!("*.{}", ending.as_str())),
            FileCommand::Save(name) => (FileService::Save, coming, name.to_string()),
            FileCommand::Load { name, .. } => (FileService::Load, Progress::Going { block: 0 }, name.to_string()),
            FileCommand::Delete(name) => (FileService::Delete, Progress::Deleting, name.to_string()),
        };
        let request = FileFrame {
            id,
            block: Block(0),
            service,
            data: data.into_bytes(),
        };
        self.open = Some(Transfer {
            command,
            id,
            service,
            progress,
            said: request.encode(),
            sent_count: 0,
            due: now,
            request_repeated: false,
            echo_count: 0,
        });
        self.send(now);
        Ok(())
    }

    /// Stops answering: the controller gives the transfer up by itself, and what still comes is dropped.
    pub fn forget_open(&mut self) {
        self.open = None;
    }

    /// Whether a transfer can begin.
    pub fn is_idle(&self) -> bool {
        self.open.is_none()
    }

    /// A datagram has come from the controller.
    pub fn handle_datagram(&mut self, now: Stamp, bytes: &[u8]) {
        let answer = match FileAnswer::decode(bytes) {
            Ok(answer) => answer,
            Err(error) => return self.drop_datagram(error.to_string(), true),
        };
        let fits = |open: &&mut Transfer| open.id == answer.id && open.service as u8 == answer.service;
        let Some(open) = self.open.as_mut().filter(fits) else {
            return self.handle_stray(&answer);
        };
        if answer.status != 0 {
            let command = open.command.clone();
            self.open = None;
            let refusal = Refusal {
                status: answer.status,
                added_status: answer.added_status,
            };
            return self.events.push_back(FileEvent::Refused { command, refusal });
        }
        match open.step(&answer, self.settings.attempts) {
            Step::Drop(why) => self.drop_answer(&answer, why),
            Step::Say(frame) => {
                open.say(&frame);
                self.send(now);
            }
            Step::Echo(frame) => self.push(frame.encode(), Kind::Ask),
            Step::Finish(frame) => self.finish(frame),
            Step::TooLarge => {
                if let Some(open) = self.open.take() {
                    self.events.push_back(FileEvent::TooLarge { command: open.command });
                }
            }
        }
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        let Some(open) = &mut self.open else { return };
        if open.due > now {
            return;
        }
        if open.command.kind().bears_repetition() && open.sent_count < self.settings.attempts {
            open.request_repeated |= open.is_at_the_request();
            self.send(now);
        } else if let Some(open) = self.open.take() {
            self.events.push_back(FileEvent::Unanswered { command: open.command });
        }
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        self.open.as_ref().map(|open| open.due)
    }

    /// The next datagram to send, to the file control port.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<RobotOutput> {
        self.outbox.pop_front()
    }

    /// The next event.
    #[must_use]
    pub fn poll_event(&mut self) -> Option<FileEvent> {
        self.events.pop_front()
    }

    /// Queues what the open transfer says last, once more.
    fn send(&mut self, now: Stamp) {
        if let Some(open) = &mut self.open {
            open.sent_count += 1;
            open.due = now.plus_ms(self.settings.answer_timeout_ms);
            let (bytes, kind) = (open.said.clone(), open.command.kind());
            self.push(bytes, kind);
        }
    }

    fn push(&mut self, bytes: Vec<u8>, kind: Kind) {
        self.outbox.push_back(RobotOutput::Bytes { bytes, kind });
    }

    fn finish(&mut self, last_word: Option<FileFrame>) {
        let Some(open) = self.open.take() else { return };
        if let Some(frame) = last_word {
            self.closed = Some(Closed {
                id: open.id,
                service: open.service,
                last: frame.block,
                echo_count: 0,
            });
            self.push(frame.encode(), Kind::Ask);
        }
        let content = match open.progress {
            Progress::Coming { content, .. } => content,
            Progress::Going { .. } | Progress::Deleting => Vec::new(),
        };
        self.events.push_back(match open.command {
            FileCommand::List(ending) => FileEvent::Listed {
                ending,
                names: names(&content),
            },
            FileCommand::Save(name) => FileEvent::Saved { name, content },
            FileCommand::Load { name, .. } => FileEvent::Loaded { name },
            FileCommand::Delete(name) => FileEvent::Deleted { name },
        });
    }

    /// An answer that does not belong to the open transfer: the last block of the one before, or late, or foreign.
    fn handle_stray(&mut self, answer: &FileAnswer) {
        let echoes = |closed: &&mut Closed| {
            (closed.id, closed.service as u8, closed.last) == (answer.id, answer.service, answer.block)
                && answer.status == 0
                && closed.echo_count < self.settings.attempts
        };
        let Some(closed) = self.closed.as_mut().filter(echoes) else {
            return self.drop_answer(answer, "is late or foreign");
        };
        closed.echo_count += 1;
        let frame = acknowledgement(closed.id, closed.service, closed.last);
        self.push(frame.encode(), Kind::Ask);
    }

    fn drop_answer(&mut self, answer: &FileAnswer, why: &str) {
        let FileAnswer { id, block, service, .. } = answer;
        let reason = format!("file answer {id} (service {service:#04x}, block {:#x}) {why}", block.0);
        self.drop_datagram(reason, false);
    }

    fn drop_datagram(&mut self, reason: String, malformed: bool) {
        self.events.push_back(FileEvent::Dropped { reason, malformed });
    }
}

impl Transfer {
    /// What a good answer of this transfer does to it.
    fn step(&mut self, answer: &FileAnswer, echo_max: u32) -> Step {
        let number = answer.block.number();
        let flag_alone = answer.block == Block::new(0, true);
        match &mut self.progress {
            Progress::Deleting => Step::Finish(None),
            Progress::Going { block } => {
                let FileCommand::Load { content, .. } = &self.command else {
                    return Step::Drop("belongs to no file");
                };
                let block_count = content.as_bytes().len().div_ceil(FILE_BLOCK_BYTES) as u32;
                // A bare flag can only mean the last block, unless a second answer to the request may be under way.
                let last_by_flag = flag_alone && *block == block_count && !self.request_repeated;
                if number != *block && !last_by_flag {
                    return Step::Drop("acknowledges another block");
                }
                if *block == block_count {
                    return Step::Finish(None);
                }
                *block += 1;
                let begin = (*block as usize - 1) * FILE_BLOCK_BYTES;
                let rest = &content.as_bytes()[begin..];
                Step::Say(FileFrame {
                    id: self.id,
                    block: Block::new(*block, *block == block_count),
                    service: self.service,
                    data: rest[..rest.len().min(FILE_BLOCK_BYTES)].to_vec(),
                })
            }
            Progress::Coming { block_count, content } => {
                let sole = flag_alone && *block_count == 0;
                let again = acknowledgement(self.id, self.service, answer.block);
                if number == *block_count && number > 0 {
                    if self.echo_count == echo_max {
                        return Step::Drop("has come too often");
                    }
                    self.echo_count += 1;
                    return Step::Echo(again);
                }
                if number != *block_count + 1 && !sole {
                    return Step::Drop("is out of order");
                }
                if content.len() + answer.data.len() > FILE_BYTES_MAX || *block_count == FILE_BLOCKS_MAX {
                    return Step::TooLarge;
                }
                *block_count += 1;
                content.extend_from_slice(&answer.data);
                if answer.block.is_last() {
                    Step::Finish(Some(again))
                } else {
                    Step::Say(again)
                }
            }
        }
    }

    /// Takes up what is said from now on.
    fn say(&mut self, frame: &FileFrame) {
        self.said = frame.encode();
        self.sent_count = 0;
        self.echo_count = 0;
    }

    fn is_at_the_request(&self) -> bool {
        match self.progress {
            Progress::Coming { block_count, .. } => block_count == 0,
            Progress::Going { block } => block == 0,
            Progress::Deleting => true,
        }
    }
}

fn acknowledgement(id: u8, service: FileService, block: Block) -> FileFrame {
    FileFrame {
        id,
        block,
        service,
        data: Vec::new(),
    }
}

/// The names of a list: one a line.
fn names(content: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(content);
    let lines = text.split(['\r', '\n', '\0']).map(str::trim);
    lines.filter(|line| !line.is_empty()).map(str::to_owned).collect()
}

#[cfg(test)]
mod tests;
