//! The shell: sockets, timers, the pool, files and the console. It moves bytes and decides nothing.

mod bridge;
mod camera_lines;
mod clock;
mod console;
mod conversation;
mod datagrams;
mod file_transfer;
mod hold_on_panic;
mod journal_file;
mod live;
mod pool;
mod reconstruct;
mod replay;
mod robot_wire;
mod simulated;
mod wires;

pub use bridge::{BridgeError, BridgeReport, serve_bridge};
pub use camera_lines::camera_lines;
pub use console::Console;
pub use conversation::{Conversation, ConversationError};
pub use file_transfer::{TransferError, Transferred, transfer};
pub use journal_file::{JournalError, JournalFile, pack_file};
pub use live::{Links, Live, LiveError, Outcome, RobotPlace, run};
pub use pool::Pool;
pub use reconstruct::{ReconstructError, reconstruct, write_files};
pub use replay::{Difference, Rebuilt, ReplayError, ReplayReport, rebuild, replay};
pub use simulated::{SimulatedCell, SimulatedError, SimulatedOptions};
