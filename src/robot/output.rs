//! What a conversation wants done with its wire, whatever the link.

use super::command::Kind;

/// What is to be done with the wire to the robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RobotOutput {
    /// Open the connection (host control over TCP), then call `handle_connected`; if that fails, `handle_closed`.
    Connect,
    /// Send these bytes: one datagram of HSES, or a piece of a stream.
    Bytes {
        /// The bytes.
        bytes: Vec<u8>,
        /// Of the command that they belong to ([`Kind::waits_for_journal`]); [`Kind::Ask`] where they belong to none.
        kind: Kind,
    },
    /// Close the connection or give up opening it; nothing more of it is handed in.
    Close,
}
