//! The camera bridge over A3DP/1: meaning to bytes and back, without I/O.
//!
//! [`Exchange`] opens the session, triggers and hands out whole [`Capture`]s. The bytes are fixed by
//! `docs/protocols/camera.md`.

mod capture;
mod exchange;
mod message;
mod payload;
mod picture;
mod settings;
mod wire;

pub use capture::{Assembly, Capture, FrameError};
pub use exchange::{COMPONENTS_WANTED, CameraEvent, CameraOutput, Exchange, ExchangeSettings, Opened, Trouble};
pub use message::{
    CameraError, CameraStatus, Caps, ClientMessage, Component, ComponentKind, Configured, FrameBegin, FrameEnd,
    Greeting, ServerMessage, TRIGGER_ALL, TriggerId, TriggerOk,
};
pub use payload::PayloadError;
pub use picture::Pictures;
pub use settings::CameraSettings;
pub use wire::{FrameReader, FrameWriter, WireError, WireFrame};
