//! Commands on several variables as commands on one each: host control carries no more.

use crate::robot::command::Command;
use crate::robot::reply::Reply;
use crate::robot::variable::{Values, Variable};
use std::collections::VecDeque;

/// A command as the single ones it consists of; what they read is put together again.
#[derive(Debug)]
pub(super) struct OneByOne {
    left: VecDeque<Command>,
    read: Option<Values>,
}

impl OneByOne {
    /// At least one command.
    pub(super) fn new(command: &Command) -> Self {
        let left = match command {
            Command::Read { first, count } => (0..*count)
                .map(|offset| Command::Read {
                    first: after(*first, offset),
                    count: 1,
                })
                .collect(),
            Command::Write { first, values } => (0..values.count() as u16)
                .map(|offset| Command::Write {
                    first: after(*first, offset),
                    values: values.slice(usize::from(offset), 1),
                })
                .collect(),
            other => VecDeque::from([other.clone()]),
        };
        Self { left, read: None }
    }

    /// The next single command to say; `None` when all have been said.
    pub(super) fn next(&mut self) -> Option<Command> {
        self.left.pop_front()
    }

    /// Takes the reply to a single command; the reply to the whole when it was the last.
    pub(super) fn take(&mut self, reply: Reply) -> Option<Reply> {
        let Reply::Values(values) = reply else {
            return self.left.is_empty().then_some(reply);
        };
        let read = match self.read.take() {
            None => values,
            Some(before) => before.joined(values),
        };
        if self.left.is_empty() {
            return Some(Reply::Values(read));
        }
        self.read = Some(read);
        None
    }
}

fn after(first: Variable, offset: u16) -> Variable {
    Variable {
        index: first.index + offset,
        ..first
    }
}
