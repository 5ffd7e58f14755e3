//! What the two links of host control have in common: one transaction at a time.

use super::{LinkEvent, LinkOutput, SerialLink, TcpLink, Unsupported};
use crate::robot::command::Command;
use crate::stamp::Stamp;
use std::fmt::Debug;

/// A link of host control.
pub trait HostLink: Debug + Send {
    /// Whether its connection can be opened again when it has ended.
    fn can_be_reopened(&self) -> bool;
    /// Whether a command can be said.
    fn is_idle(&self) -> bool;
    /// Says `command`; only when idle.
    ///
    /// # Errors
    ///
    /// Host control has no words for it; nothing has been sent.
    fn say(&mut self, now: Stamp, command: &Command) -> Result<(), Unsupported>;
    /// Forgets the open transaction, so that another can follow as soon as the wire allows.
    fn give_up(&mut self, now: Stamp);
    /// The connection stands.
    fn handle_connected(&mut self, now: Stamp);
    /// The connection did not come about or has ended.
    fn handle_closed(&mut self, now: Stamp, reason: &str);
    /// Bytes have come.
    fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]);
    /// Time has passed.
    fn handle_wake(&mut self, now: Stamp);
    /// When [`Self::handle_wake`] wants to be called next.
    fn wake_at(&self) -> Option<Stamp>;
    /// The next thing to do with the wire.
    fn poll_output(&mut self) -> Option<LinkOutput>;
    /// The next event.
    fn poll_event(&mut self) -> Option<LinkEvent>;
}

impl HostLink for TcpLink {
    fn can_be_reopened(&self) -> bool {
        true
    }

    fn is_idle(&self) -> bool {
        self.is_idle()
    }

    fn say(&mut self, now: Stamp, command: &Command) -> Result<(), Unsupported> {
        self.say(now, command)
    }

    fn give_up(&mut self, now: Stamp) {
        self.give_up(now);
    }

    fn handle_connected(&mut self, now: Stamp) {
        self.handle_connected(now);
    }

    fn handle_closed(&mut self, now: Stamp, reason: &str) {
        self.handle_closed(now, reason.to_owned());
    }

    fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.handle_bytes(now, bytes);
    }

    fn handle_wake(&mut self, now: Stamp) {
        self.handle_wake(now);
    }

    fn wake_at(&self) -> Option<Stamp> {
        self.wake_at()
    }

    fn poll_output(&mut self) -> Option<LinkOutput> {
        self.poll_output()
    }

    fn poll_event(&mut self) -> Option<LinkEvent> {
        self.poll_event()
    }
}

/// A serial line is open or it is not: nothing connects it.
impl HostLink for SerialLink {
    fn can_be_reopened(&self) -> bool {
        false
    }

    fn is_idle(&self) -> bool {
        self.is_idle()
    }

    fn say(&mut self, now: Stamp, command: &Command) -> Result<(), Unsupported> {
        self.say(now, command)
    }

    fn give_up(&mut self, now: Stamp) {
        self.give_up(now);
    }

    fn handle_connected(&mut self, _now: Stamp) {}

    fn handle_closed(&mut self, _now: Stamp, _reason: &str) {}

    fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]) {
        self.handle_bytes(now, bytes);
    }

    fn handle_wake(&mut self, now: Stamp) {
        self.handle_wake(now);
    }

    fn wake_at(&self) -> Option<Stamp> {
        self.wake_at()
    }

    fn poll_output(&mut self) -> Option<LinkOutput> {
        self.poll_output()
    }

    fn poll_event(&mut self) -> Option<LinkEvent> {
        self.poll_event()
    }
}
