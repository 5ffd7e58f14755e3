//! The bridge: serves A3DP/1 to a controller and observers, and has the vendor's side take the pictures.
//!
//! A value: bytes, lines of the vendor's side, converted pictures and time go in; bytes, lines and work for the shell
//! come out. Nothing is registered here; a picture is brought into the camera frame and passed on.
//! `docs/protocols/camera.md` fixes one side, `docs/protocols/bridge.md` the other.

mod config;
mod connection;
mod convert;
mod device;
mod esm;
mod flight;
mod picture;
mod range_image;
mod ranges;
mod requests;
mod session;
#[cfg(test)]
mod tests;
mod transfer;
mod vendor;

pub use config::{BridgeConfig, ConfigError};
pub use connection::ConnectionId;
pub use convert::{Conversion, FrameError};
pub use esm::from_esm;
pub use picture::{Axes, Beside, ConvertError, Picture, VendorFile, Wanted};
pub use range_image::{RangeImage, from_range_image};
pub use vendor::{Ask, Condition, FrameFiles, LINE_BYTES_MAX, LineError, RangeFiles, Ready, Said};

use crate::camera::message::{CameraState, CameraStatus, Caps, ServerMessage, TriggerId};
use crate::camera::settings::CameraSettings;
use crate::stamp::{Stamp, earlier};
use connection::{Connection, Role};
use device::Device;
use flight::Flight;
use requests::Configuring;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use transfer::{Frame, Transfer};

/// The bridge.
#[derive(Debug)]
pub struct Bridge {
    caps: Caps,
    calibration_id: u64,
    calibration_date: u32,
    axes: Axes,
    reconstruction_us: u32,
    ready_timeout_ms: u64,
    boot_id: u64,
    device: Device,
    identity: Option<Ready>,
    condition: Condition,
    condition_due: Stamp,
    counts: Counts,
    connections: BTreeMap<ConnectionId, Connection>,
    controller: Option<ConnectionId>,
    next_session_id: u32,
    run: Run,
    configuring: Option<Configuring>,
    in_force: Option<InForce>,
    next_config_id: u32,
    armed: bool,
    flight: Option<Flight>,
    next_acquisition: u32,
    next_frame_id: u64,
    transfer: Option<Transfer>,
    /// Frames that wait until the one on its way is there.
    waiting: VecDeque<Transfer>,
    outbox: VecDeque<BridgeOutput>,
}

/// What the shell must do.
#[derive(Debug, Clone, PartialEq)]
pub enum BridgeOutput {
    /// Send these bytes; then call [`Bridge::handle_written`].
    Bytes {
        /// On which connection.
        connection: ConnectionId,
        /// What to send.
        bytes: Vec<u8>,
    },
    /// Close a connection after what was sent.
    Close {
        /// Which.
        connection: ConnectionId,
    },
    /// Say this line to the vendor's side.
    Line(String),
    /// Read the files of a frame, convert them, and call [`Bridge::handle_picture`].
    Convert(Box<Conversion>),
    /// Start the vendor's side, anew if it still runs; then call [`Bridge::handle_vendor_started`].
    StartVendor,
    /// A line for the log.
    Note(String),
}

/// What belongs to one run: nothing of it survives another.
#[derive(Debug, Default)]
struct Run {
    id: u64,
    /// Trigger ids taken, the newest last.
    known: VecDeque<TriggerId>,
    /// Complete frames, the newest last.
    store: VecDeque<Arc<Frame>>,
}

/// Settings in force.
#[derive(Debug, Clone, Copy)]
struct InForce {
    config_id: u32,
    settings: CameraSettings,
    predicted_exposure_us: u32,
    predicted_total_us: u32,
}

/// Counters since the start.
#[derive(Debug, Default)]
struct Counts {
    triggers: u32,
    frames: u32,
    missed: u32,
    vendor_timeouts: u32,
    last_error: u16,
}

impl Bridge {
    /// A bridge whose vendor's side is not there yet. `boot_id` is new at each start.
    pub fn new(config: &BridgeConfig, boot_id: u64) -> Self {
        Self {
            caps: config.caps(),
            calibration_id: config.camera.calibration_id,
            calibration_date: config.camera.calibration_date,
            axes: config.axes(),
            reconstruction_us: config.vendor.reconstruction_ms.saturating_mul(1000),
            ready_timeout_ms: config.vendor.ready_timeout_ms,
            boot_id,
            device: Device::ToStart { at: Stamp::START },
            identity: None,
            condition: Condition::default(),
            condition_due: Stamp::START,
            counts: Counts::default(),
            connections: BTreeMap::new(),
            controller: None,
            next_session_id: 1,
            run: Run::default(),
            configuring: None,
            in_force: None,
            next_config_id: 1,
            armed: false,
            flight: None,
            next_acquisition: 1,
            next_frame_id: 1,
            transfer: None,
            waiting: VecDeque::new(),
            outbox: VecDeque::new(),
        }
    }

    /// Whether the vendor's side has said which device it has. Nobody should be let in before.
    pub fn is_ready(&self) -> bool {
        self.identity.is_some()
    }

    /// The state that STATUS tells.
    pub fn state(&self) -> CameraState {
        match self.device {
            Device::ToStart { .. } | Device::Starting { .. } | Device::Lost => CameraState::Offline,
            Device::Resetting => CameraState::Resetting,
            Device::Fault => CameraState::Fault,
            Device::Present => match &self.flight {
                Some(flight) => flight.state(),
                None if self.transfer.is_some() => CameraState::Sending,
                None if self.armed => CameraState::Armed,
                None => CameraState::Idle,
            },
        }
    }

    /// Somebody has connected.
    pub fn handle_connected(&mut self, now: Stamp, connection: ConnectionId, address: &str) {
        let mut new = Connection::new(connection, address.to_owned(), now);
        if self.connections.len() >= CONNECTIONS_MAX {
            new.close(&mut self.outbox);
            return self.note(format!(
                "{address} is turned away: {CONNECTIONS_MAX} connections are open"
            ));
        }
        self.connections.insert(connection, new);
    }

    /// Bytes of a connection have been written.
    pub fn handle_written(&mut self, now: Stamp, connection: ConnectionId, byte_count: usize) {
        if let Some(found) = self.connections.get_mut(&connection) {
            found.unsent = found.unsent.saturating_sub(byte_count);
        }
        if let Some(transfer) = self
            .transfer
            .as_mut()
            .filter(|transfer| transfer.connection == connection)
        {
            transfer.last_moved = now;
        }
    }

    /// Time has passed.
    pub fn handle_wake(&mut self, now: Stamp) {
        self.watch_device(now);
        self.watch_requests(now);
        self.watch_flight(now);
        self.watch_connections(now);
    }

    /// When [`Self::handle_wake`] wants to be called next.
    pub fn wake_at(&self) -> Option<Stamp> {
        let connections = self.connections.values().filter(|connection| !connection.closing);
        let connections = connections
            .map(|connection| {
                let dead = connection.last_heard.plus_ms(DEAD_AFTER_MS);
                match connection.role {
                    Role::Stranger => dead,
                    Role::Controller | Role::Observer => dead.min(connection.status_due),
                }
            })
            .min();
        let configuring = self.configuring.as_ref().map(|configuring| configuring.due);
        let flight = self.flight.as_ref().map(Flight::due);
        let transfer = self
            .transfer
            .as_ref()
            .map(|transfer| transfer.last_moved.plus_ms(STALL_MS));
        let mut at = self.device_due();
        for other in [connections, configuring, flight, transfer] {
            at = earlier(at, other);
        }
        at
    }

    /// The next thing the shell must do.
    #[must_use]
    pub fn poll_output(&mut self) -> Option<BridgeOutput> {
        if self.outbox.is_empty() {
            self.move_frame();
        }
        self.outbox.pop_front()
    }

    /// Says the next piece of the frame on its way, if the other side takes its bytes.
    fn move_frame(&mut self) {
        while self.outbox.is_empty() {
            let Some(transfer) = &mut self.transfer else { return };
            let Some(connection) = self.connections.get_mut(&transfer.connection) else {
                return;
            };
            if connection.unsent > UNSENT_MAX {
                return;
            }
            if let Some(message) = transfer.next_message() {
                connection.say(&mut self.outbox, &message);
            }
            let (is_over, last_moved) = (transfer.is_over(), transfer.last_moved);
            if is_over {
                self.next_transfer(last_moved);
            }
        }
    }

    /// Lets the next waiting frame go.
    fn next_transfer(&mut self, now: Stamp) {
        self.transfer = self.waiting.pop_front();
        if let Some(transfer) = &mut self.transfer {
            transfer.last_moved = now;
        }
    }

    fn status(&self) -> CameraStatus {
        let flights = u8::from(self.flight.is_some());
        CameraStatus {
            state: self.state(),
            queue_count: flights,
            temperature_c: self.condition.temperature_c,
            warm_up_done_s: self.condition.warm_up_done_s,
            warm_up_required_s: self.condition.warm_up_required_s,
            trigger_count: self.counts.triggers,
            frame_count: self.counts.frames,
            missed_count: self.counts.missed,
            vendor_timeout_count: self.counts.vendor_timeouts,
            lost_packet_count: self.condition.lost_packet_count,
            link_mbit_s: self.condition.link_mbit_s,
            last_error: self.counts.last_error,
        }
    }

    /// Says something to everyone greeted.
    fn announce(&mut self, message: &ServerMessage<'_>) {
        for connection in self.connections.values_mut() {
            if connection.role != Role::Stranger {
                connection.say(&mut self.outbox, message);
            }
        }
    }

    fn ask_vendor(&mut self, ask: &Ask) {
        self.outbox.push_back(BridgeOutput::Line(ask.line()));
    }

    fn note(&mut self, text: String) {
        self.outbox.push_back(BridgeOutput::Note(text));
    }
}

/// Trigger ids remembered of a run.
const KNOWN_MAX: usize = 1024;
/// Complete frames stored of a run.
const STORE_MAX: usize = 4;
/// Observers beside the controller.
const OBSERVERS_MAX: usize = 3;
/// Connections at a time, greeted or not.
const CONNECTIONS_MAX: usize = 16;
/// Bytes handed to the shell before the next chunk waits.
const UNSENT_MAX: usize = 1 << 20;
/// A client of which nothing is heard for so long is gone.
const DEAD_AFTER_MS: u64 = 5000;
/// A client that takes nothing of its frame for so long is cut off.
const STALL_MS: u64 = 5000;
/// Between two STATUS.
const STATUS_MS: u64 = 1000;
