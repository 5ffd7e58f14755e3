//! The recording of a run: every input before it is handled, every output, and what a viewer shows.
//!
//! [`Record`]s are made here and read back here; the MCAP container is written by [`Writer`] and read by [`Recording`].
//! Opening files is the shell's business. Topics and encodings: `docs/journal.md`.

mod encode;
mod read;
mod viewer;
mod write;

pub use encode::{InputMemo, input_record, output_records, read_input};
pub use read::{ReadError, Recording};
pub use write::{Writer, pack};

use crate::stamp::Stamp;

/// One message of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// Where it belongs.
    pub topic: Topic,
    /// When, since the run began.
    pub stamp: Stamp,
    /// Its bytes.
    pub payload: Vec<u8>,
}

/// The topics of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic {
    /// Bytes from the robot, as they came.
    RobotReceived,
    /// Bytes to the robot.
    RobotSent,
    /// Bytes from the camera, as they came.
    CameraReceived,
    /// Bytes to the camera.
    CameraSent,
    /// All other inputs, JSON.
    Input,
    /// All other outputs, JSON.
    Output,
    /// Events, JSON.
    Event,
    /// Events in words, `foxglove.Log`.
    Log,
    /// Clouds of the views, `foxglove.PointCloud` in frame `view_NN`, metres.
    ViewCloud,
    /// Poses of the views in the model, `foxglove.FrameTransform`, metres.
    Transform,
    /// The finished model, `foxglove.PointCloud` in frame `model`, metres.
    Model,
}

impl Topic {
    /// All topics, in the order of their channels.
    pub const ALL: [Self; 11] = [
        Self::RobotReceived,
        Self::RobotSent,
        Self::CameraReceived,
        Self::CameraSent,
        Self::Input,
        Self::Output,
        Self::Event,
        Self::Log,
        Self::ViewCloud,
        Self::Transform,
        Self::Model,
    ];

    /// Its name in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::RobotReceived => "/robot/received",
            Self::RobotSent => "/robot/sent",
            Self::CameraReceived => "/camera/received",
            Self::CameraSent => "/camera/sent",
            Self::Input => "/input",
            Self::Output => "/output",
            Self::Event => "/event",
            Self::Log => "/log",
            Self::ViewCloud => "/view/cloud",
            Self::Transform => "/tf",
            Self::Model => "/model",
        }
    }

    /// The topic of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|topic| topic.name() == name)
    }

    /// Whether its messages are inputs of the run (the others follow from them).
    pub fn is_input(self) -> bool {
        matches!(self, Self::RobotReceived | Self::CameraReceived | Self::Input)
    }
}

/// The name of the metadata record that describes the run.
const RUN_METADATA: &str = "bladescan.run";
/// The attachment with the recipe, word for word.
const RECIPE_ATTACHMENT: &str = "recipe.toml";
/// The attachment with the station, word for word.
const STATION_ATTACHMENT: &str = "station.toml";
