//! What the two links of host control have in common: one transaction at a time.

use super::{LinkEvent, Unsupported};
use crate::robot::command::Command;
use crate::robot::output::RobotOutput;
use crate::stamp::Stamp;
use std::fmt::Debug;

/// A link of host control.
pub trait HostLink: Debug + Send {
    /// Whether a command can be said.
    fn is_idle(&self) -> bool;
    /// Says `command`; only when idle.
    ///
    /// # Errors
    ///
    /// Host control has no words for it; nothing has been sent.
    fn say(&mut self, now: Stamp, command: &Command) -> Result<(), Unsupported>;
    /// Forgets the open transaction, so that another can follow as soon as the wire allows. What has been sent of it may
    /// still take effect.
    fn give_up(&mut self, now: Stamp);
    /// Something put out for the open transaction was not sent and never will be.
    fn handle_withheld(&mut self, now: Stamp);
    /// The connection that was asked for stands.
    fn handle_connected(&mut self, now: Stamp);
    /// The connection could not be opened, or was closed by the other side.
    fn handle_closed(&mut self, now: Stamp, reason: &str);
    /// Bytes have come.
    fn handle_bytes(&mut self, now: Stamp, bytes: &[u8]);
    /// Time has passed.
    fn handle_wake(&mut self, now: Stamp);
    /// When [`Self::handle_wake`] wants to be called next.
    fn wake_at(&self) -> Option<Stamp>;
    /// The next thing to do with the wire.
    #[must_use]
    fn poll_output(&mut self) -> Option<RobotOutput>;
    /// The next event.
    #[must_use]
    fn poll_event(&mut self) -> Option<LinkEvent>;
}
