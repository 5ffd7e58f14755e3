//! A conversation with the robot outside of a run: one command, one answer.

use super::clock::Clock;
use super::datagrams::DATAGRAM_BYTES;
use super::live::RobotPlace;
use super::robot_wire::RobotWire;
use crate::controller::Input;
use crate::robot::{Command, Exchange, ExchangeSettings, Reply, RobotEvent, RobotOutput};
use thiserror::Error;
use tokio::sync::mpsc;

/// A conversation with the robot.
pub struct Conversation {
    exchange: Exchange,
    wire: RobotWire,
    news_sender: mpsc::Sender<Input>,
    news: mpsc::Receiver<Input>,
    clock: Clock,
    /// Why the connection ended last.
    lost: Option<String>,
}

/// Why there is no answer that can be used.
#[derive(Debug, Error)]
pub enum ConversationError {
    /// A socket of ours, or the serial line.
    #[error("{0}")]
    Wire(String),
    /// The robot said no.
    #[error("{command}: {words}")]
    Refused {
        /// What was said.
        command: &'static str,
        /// Why not, and what to do.
        words: String,
    },
    /// Nobody answered.
    #[error("{command}: no answer{}", .lost.as_ref().map(|lost| format!(" ({lost})")).unwrap_or_default())]
    Unanswered {
        /// What was said.
        command: &'static str,
        /// Why the connection ended, if it did.
        lost: Option<String>,
    },
    /// What is spoken here has no words for it.
    #[error("{command}: {reason}")]
    Unsayable {
        /// What was to be said.
        command: &'static str,
        /// Why not.
        reason: String,
    },
}

impl Conversation {
    /// A conversation in which nothing has been said. Nothing is sent before the first command.
    ///
    /// # Errors
    ///
    /// A socket of ours cannot be opened.
    pub fn open(place: &RobotPlace, settings: ExchangeSettings) -> Result<Self, ConversationError> {
        let (news_sender, news) = mpsc::channel(NEWS_MAX);
        let (wire, _) =
            RobotWire::open(place, &news_sender).map_err(|error| ConversationError::Wire(error.to_string()))?;
        Ok(Self {
            exchange: Exchange::new(settings),
            wire,
            news_sender,
            news,
            clock: Clock::start(),
            lost: None,
        })
    }

    /// Says `command` and waits for what comes of it.
    ///
    /// # Errors
    ///
    /// The robot refuses, nobody answers, or what is spoken has no words for it.
    pub async fn say(&mut self, command: Command) -> Result<Reply, ConversationError> {
        self.exchange.say(self.clock.now(), command);
        let mut datagram = vec![0u8; DATAGRAM_BYTES];
        loop {
            self.carry_out().await;
            if let Some(result) = self.take_events() {
                return result;
            }
            let wake = self.exchange.wake_at();
            let input = tokio::select! {
                input = self.wire.recv(&mut datagram) => input,
                Some(input) = self.news.recv() => input,
                () = self.clock.sleep_until(wake) => Input::Wake,
            };
            let now = self.clock.now();
            match input {
                Input::RobotBytes(bytes) => self.exchange.handle_bytes(now, &bytes),
                Input::RobotConnected => self.exchange.handle_connected(now),
                Input::RobotClosed { reason } => {
                    self.exchange.handle_closed(now, &reason);
                    self.lost = Some(reason);
                }
                Input::RobotUnreachable { reason } => return Err(ConversationError::Wire(reason)),
                _ => self.exchange.handle_wake(now),
            }
        }
    }

    async fn carry_out(&mut self) {
        while let Some(output) = self.exchange.poll_output() {
            match output {
                RobotOutput::Connect => self.wire.connect(&self.news_sender),
                RobotOutput::Close => self.wire.close(),
                RobotOutput::Bytes { bytes, .. } => self.wire.send(bytes).await,
            }
        }
    }

    fn take_events(&mut self) -> Option<Result<Reply, ConversationError>> {
        while let Some(event) = self.exchange.poll_event() {
            return Some(match event {
                RobotEvent::Answered { reply, .. } => Ok(reply),
                RobotEvent::Refused { command, refusal } => Err(ConversationError::Refused {
                    command: command.name(),
                    words: refusal.words(),
                }),
                RobotEvent::Unanswered { command } => Err(ConversationError::Unanswered {
                    command: command.name(),
                    lost: self.lost.take(),
                }),
                RobotEvent::Unsayable { command, reason } => Err(ConversationError::Unsayable {
                    command: command.name(),
                    reason,
                }),
                RobotEvent::Lost { reason } => {
                    self.lost = Some(reason);
                    continue;
                }
                RobotEvent::Dropped { .. } => continue,
            });
        }
        None
    }
}

const NEWS_MAX: usize = 32;
