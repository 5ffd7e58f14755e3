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
mod journalled;
mod live;
mod pool;
mod reconstruct;
mod recording_file;
mod recover;
mod replay;
mod robot_wire;
mod run_dir;
mod simulated;
mod wires;

pub use bridge::{BridgeError, BridgeReport, serve_bridge};
pub use camera_lines::camera_lines;
pub use console::{Console, Voice};
pub use conversation::{Conversation, ConversationError};
pub use file_transfer::{TransferError, Transferred, transfer};
pub use journal_file::{JournalError, JournalFile};
pub use journalled::{Journal, Journalled, Progress};
pub use live::{Beginning, Links, Live, LiveError, Outcome, RobotPlace, run};
pub use pool::Pool;
pub use reconstruct::{ReconstructError, reconstruct, write_files};
pub use recording_file::{FileError, PackError, RecordingFile, pack_file};
pub use recover::{Recovered, recover};
pub use replay::{Difference, Rebuilt, ReplayError, ReplayReport, rebuild, replay};
pub use run_dir::{put_aside, settle};
pub use simulated::{SimulatedCell, SimulatedError, SimulatedOptions};
