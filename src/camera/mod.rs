//! The camera bridge over A3DP/1: meaning to bytes and back, without I/O.
//!
//! [`Exchange`] opens the session, triggers and hands out whole [`Capture`]s. The bytes are fixed by
//! `docs/protocols/camera.md`.

pub mod bridge;
mod capture;
pub mod code;
pub mod conformance;
mod exchange;
pub mod lines;
mod message;
mod payload;
mod picture;
mod settings;
mod suggest;
mod visit;
mod wire;

pub use capture::{Assembly, Capture, CapturedPoints, FrameError};
pub use exchange::{
    COMPONENTS_WANTED, CameraEvent, CameraOutput, ClockEstimate, Exchange, ExchangeSettings, Opened, Trouble,
};
pub use message::{
    Aborted, AcquisitionPhase, Arm, Bye, CameraError, CameraState, CameraStatus, Caps, ClientMessage, Component,
    ComponentEnd, ComponentKind, Configured, DeviceEvent, ExposureDone, FRAME_BYTES_LIMIT, FetchOk, FetchState,
    FrameBegin, FrameChunk, FrameEnd, FrameFlags, FrameStatus, Greeting, Hello, Pong, Repeated, ServerMessage,
    TRIGGER_ALL, Trigger, TriggerId, TriggerOk, message_name,
};
pub use payload::PayloadError;
pub use picture::Pictures;
pub use settings::{CameraSettings, SettingsError, VolumeOfInterest, difference};
pub use suggest::{Exposed, PASS_FRACTION, Served, Suggestion, series_us, suggest};
pub use visit::{Clock, Visit, VisitError};
pub use wire::{
    CHUNK_PAYLOAD_MAX, CONTROL_PAYLOAD_MAX, FLAG_ERROR, FLAG_LAST, FLAG_REPLY, FrameReader, FrameWriter, HEADER_BYTES,
    WireError, WireFrame,
};
