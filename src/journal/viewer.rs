//! What MCAP viewers show: Foxglove's published protobuf messages, in metres.

use crate::event::Event;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    FrameTransform, Log, PackedElementField, PointCloud, Pose, Quaternion, Timestamp, Vector3, log,
};
use foxglove::{Encode, Schema};
use nalgebra::{Isometry3, Point3};

/// The frame of the model: the camera frame at view 0.
pub(super) const MODEL_FRAME: &str = "model";

/// The frame of one view.
pub(super) fn view_frame(view_index: usize) -> String {
    format!("view_{view_index:02}")
}

/// A cloud; `points_mm` in the frame `frame_id`.
pub(super) fn cloud<'a>(unix_ns: u64, frame_id: &str, points_mm: impl Iterator<Item = &'a Point3<f64>>) -> Vec<u8> {
    let field = |name: &str, offset| PackedElementField {
        name: name.into(),
        offset,
        r#type: NumericType::Float32 as i32,
    };
    let data: Vec<u8> = points_mm
        .flat_map(|point| [point.x, point.y, point.z])
        .flat_map(|mm| ((mm * 1e-3) as f32).to_le_bytes())
        .collect();
    encode(&PointCloud {
        timestamp: Some(timestamp(unix_ns)),
        frame_id: frame_id.into(),
        pose: Some(Pose {
            position: Some(Vector3 { x: 0.0, y: 0.0, z: 0.0 }),
            orientation: Some(Quaternion {
                x: 0.0,
                y: 0.0,
                z: 0.0,
                w: 1.0,
            }),
        }),
        point_stride: 12,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        data: data.into(),
    })
}

/// Where the frame `child` lies in the model.
pub(super) fn transform(unix_ns: u64, child: &str, model_from_child_mm: &Isometry3<f64>) -> Vec<u8> {
    let translation = model_from_child_mm.translation.vector * 1e-3;
    let rotation = model_from_child_mm.rotation;
    encode(&FrameTransform {
        timestamp: Some(timestamp(unix_ns)),
        parent_frame_id: MODEL_FRAME.into(),
        child_frame_id: child.into(),
        translation: Some(Vector3 {
            x: translation.x,
            y: translation.y,
            z: translation.z,
        }),
        rotation: Some(Quaternion {
            x: rotation.i,
            y: rotation.j,
            z: rotation.k,
            w: rotation.w,
        }),
    })
}

/// An event in words.
pub(super) fn log(unix_ns: u64, event: &Event) -> Vec<u8> {
    let level = match event {
        Event::Faulted { .. } => log::Level::Error,
        Event::FrameFailed { .. } | Event::ViewDiscarded { .. } | Event::ViewMissing { .. } => log::Level::Warning,
        _ => log::Level::Info,
    };
    encode(&Log {
        timestamp: Some(timestamp(unix_ns)),
        level: level as i32,
        message: event.words(),
        name: "bladescan".into(),
        file: String::new(),
        line: 0,
    })
}

pub(super) fn cloud_schema() -> Option<Schema> {
    PointCloud::get_schema()
}

pub(super) fn transform_schema() -> Option<Schema> {
    FrameTransform::get_schema()
}

pub(super) fn log_schema() -> Option<Schema> {
    Log::get_schema()
}

fn timestamp(unix_ns: u64) -> Timestamp {
    let second = 1_000_000_000;
    Timestamp::new((unix_ns / second) as u32, (unix_ns % second) as u32)
}

fn encode(message: &impl Encode) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(message.encoded_len().unwrap_or(0));
    message
        .encode(&mut bytes)
        .expect("a growing buffer takes every message");
    bytes
}
