//! Messages: what the client says and hears (section 4 of the page).

mod client;
mod decode;
#[cfg(test)]
mod tests;

pub use client::ClientMessage;

use super::settings::CameraSettings;
use serde::{Deserialize, Serialize};

/// Names one acquisition: `view_index << 16 | attempt`, so that a retake is another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TriggerId(pub u64);

impl TriggerId {
    /// The id of an attempt at a view.
    pub fn new(view_index: u32, attempt: u16) -> Self {
        Self(u64::from(view_index) << 16 | u64::from(attempt))
    }

    /// Which view.
    pub fn view_index(self) -> u32 {
        (self.0 >> 16) as u32
    }

    /// Which attempt, from 0.
    pub fn attempt(self) -> u16 {
        self.0 as u16
    }
}

/// The id that stands for "none" and "all".
pub const TRIGGER_ALL: u64 = u64::MAX;

/// What the client hears.
#[derive(Debug, Clone, PartialEq)]
pub enum ServerMessage {
    /// Greeting accepted.
    HelloOk(Greeting),
    /// Capabilities.
    Caps(Caps),
    /// Settings in force.
    Configured(Configured),
    /// Armed.
    Armed,
    /// Disarmed.
    Disarmed,
    /// Trigger accepted, or known already.
    TriggerOk(TriggerOk),
    /// The part may move.
    ExposureDone {
        /// Of which acquisition.
        trigger_id: TriggerId,
    },
    /// A frame begins.
    FrameBegin(Box<FrameBegin>),
    /// A piece of it.
    FrameChunk {
        /// Of which frame.
        frame_id: u64,
        /// Place in its component table.
        component_index: u16,
        /// From 0 in each component.
        chunk_index: u32,
        /// Bytes of the component before this chunk.
        offset_bytes: u64,
        /// The bytes.
        data: Vec<u8>,
    },
    /// A frame ends.
    FrameEnd(FrameEnd),
    /// An acquisition was aborted.
    Aborted {
        /// Which; [`TRIGGER_ALL`] when none was in flight.
        trigger_id: u64,
    },
    /// The camera's condition.
    Status(CameraStatus),
    /// Something happened.
    Event {
        /// What.
        code: u16,
        /// In words.
        text: String,
    },
    /// The server wants a sign of life.
    Ping {
        /// Its clock.
        sender_ns: u64,
    },
    /// Answers our PING.
    Pong {
        /// Our clock, echoed.
        sender_ns: u64,
        /// The device's clock.
        device_ns: u64,
    },
    /// Something went wrong.
    Error(CameraError),
    /// The server leaves.
    Bye {
        /// Why.
        reason: u16,
        /// In words.
        text: String,
    },
}

/// Who the camera is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Greeting {
    /// Nothing was measured.
    pub simulated: bool,
    /// New each time the bridge starts.
    pub boot_id: u64,
    /// Which calibration.
    pub calibration_id: u64,
    /// The largest frame it sends, bytes; at most 64 MiB.
    pub frame_bytes_max: u64,
    /// Vendor.
    pub vendor: String,
    /// Real model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
}

/// What the camera can do, as far as we use it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Caps {
    /// Sensor width and height, pixels.
    pub sensor_px: [u16; 2],
    /// Nearest, nominal and farthest working distance along z, mm.
    pub working_distance_mm: [f32; 3],
    /// Point spacing at the nominal distance, unbinned, mm.
    pub spacing_mm: f32,
    /// Centre of projection of camera 1 in the camera frame, mm; NaN if unknown.
    pub camera_1_mm: [f32; 3],
    /// Components offered: bit n = kind n.
    pub components: u32,
    /// Name of the lens set.
    pub optics: String,
}

/// The settings in force and what they cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configured {
    /// Names the settings.
    pub config_id: u32,
    /// From trigger to EXPOSURE_DONE, µs.
    pub predicted_exposure_us: u32,
    /// From trigger to FRAME_BEGIN, µs.
    pub predicted_total_us: u32,
    /// Bytes of one frame.
    pub frame_bytes: u64,
    /// The echo.
    pub settings: CameraSettings,
}

/// The answer to a trigger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TriggerOk {
    /// Which acquisition.
    pub trigger_id: TriggerId,
    /// From now to EXPOSURE_DONE, µs.
    pub predicted_exposure_us: u32,
    /// From now to FRAME_BEGIN, µs.
    pub predicted_total_us: u32,
}

/// The head of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameBegin {
    /// Names the frame.
    pub frame_id: u64,
    /// The acquisition it belongs to.
    pub trigger_id: TriggerId,
    /// The settings it was taken with.
    pub config_id: u32,
    /// Device clock, ns.
    pub exposure_end_ns: u64,
    /// Flag bits of the page.
    pub frame_flags: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixels with 3D.
    pub valid_count: u32,
    /// Pixels overexposed.
    pub saturated_count: u32,
    /// The components that follow.
    pub components: Vec<Component>,
}

/// One component of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component {
    /// What it is.
    pub kind: ComponentKind,
    /// How many chunks follow.
    pub chunk_count: u32,
    /// How many bytes.
    pub byte_count: u64,
}

/// Kinds of components that we ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComponentKind {
    /// f32 x, y, z.
    Xyz,
    /// Camera 1's picture.
    Intensity,
    /// Validity bits.
    Mask,
}

impl ComponentKind {
    /// The components that every configuration of ours asks for.
    pub const WANTED: u32 = 1 | 1 << 2 | 1 << 4;

    fn from_wire(kind: u16, format: u32) -> Option<Self> {
        match (kind, format) {
            (0, 0x0260_00C0) => Some(Self::Xyz),
            (2, 0x0108_0001) => Some(Self::Intensity),
            (4, 0x0108_0001) => Some(Self::Mask),
            _ => None,
        }
    }

    /// Bytes of one pixel.
    pub fn pixel_bytes(self) -> u64 {
        match self {
            Self::Xyz => 12,
            Self::Intensity | Self::Mask => 1,
        }
    }
}

/// The tail of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameEnd {
    /// Which frame.
    pub frame_id: u64,
    /// Which acquisition.
    pub trigger_id: TriggerId,
    /// 0 complete, 1 aborted, 2 failed.
    pub status: u8,
    /// Pixels with 3D.
    pub valid_count: u32,
    /// Bytes and CRC-32C of each component.
    pub components: Vec<(u64, u32)>,
}

/// The camera's condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraStatus {
    /// State number of the page.
    pub state: u8,
    /// Projector, camera 1, camera 2, board; `None` if unknown.
    pub temperature_c: [Option<f32>; 4],
    /// Triggers missed since the bridge started.
    pub missed_count: u32,
}

/// An ERROR message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraError {
    /// The request it refuses, or 0.
    pub about_request_id: u32,
    /// The acquisition it ends, or [`TRIGGER_ALL`].
    pub trigger_id: u64,
    /// Code of section 6.
    pub code: u16,
    /// Trying again may help.
    pub retryable: bool,
    /// In words.
    pub text: String,
}
