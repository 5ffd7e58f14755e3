//! Inputs and outputs of the controller as records, and inputs back.

use super::{Record, Topic, viewer};
use crate::camera::CameraOutput;
use crate::controller::{Command, Device, Input, Output};
use crate::job::{StageTime, sha256};
use crate::robot::RobotOutput;
use crate::stamp::Stamp;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// An input as the recording has it. All but a finished job can be fed back as it is; a job is run again.
#[derive(Debug, Clone)]
pub enum InputMemo {
    /// The input itself.
    Whole(Input),
    /// A job ended; the record holds the digest of what came of it.
    JobDone {
        /// Which job.
        job_id: u32,
        /// How long its stages took.
        times: Vec<StageTime>,
    },
}

/// The JSON form of the inputs that are not plain bytes.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(tag = "input", rename_all = "kebab-case")]
enum Written {
    Begin,
    Wake,
    RobotUnreachable {
        reason: String,
    },
    RobotConnected,
    RobotClosed {
        reason: String,
    },
    CameraConnected,
    CameraClosed {
        reason: String,
    },
    Operator {
        command: Command,
    },
    JobDone {
        job_id: u32,
        digest: String,
        times: Vec<StageTime>,
    },
    Restarted {
        version: String,
    },
    Synced {
        view_index: usize,
        attempt: u16,
    },
    Withheld {
        device: Device,
    },
    JournalFailed {
        reason: String,
    },
}

/// The record of an input.
pub fn input_record(stamp: Stamp, input: &Input) -> Record {
    let (topic, payload) = match input {
        Input::RobotBytes(bytes) => (Topic::RobotReceived, bytes.clone()),
        Input::CameraBytes(bytes) => (Topic::CameraReceived, bytes.clone()),
        other => (Topic::Input, json_bytes(&written(other))),
    };
    Record { topic, stamp, payload }
}

fn written(input: &Input) -> Written {
    match input {
        Input::Begin => Written::Begin,
        Input::Wake => Written::Wake,
        Input::RobotUnreachable { reason } => Written::RobotUnreachable { reason: reason.clone() },
        Input::RobotConnected => Written::RobotConnected,
        Input::RobotClosed { reason } => Written::RobotClosed { reason: reason.clone() },
        Input::CameraConnected => Written::CameraConnected,
        Input::CameraClosed { reason } => Written::CameraClosed { reason: reason.clone() },
        Input::Operator(command) => Written::Operator { command: *command },
        Input::JobDone { job_id, done } => Written::JobDone {
            job_id: *job_id,
            digest: done.digest.clone(),
            times: done.times.clone(),
        },
        Input::Restarted { version } => Written::Restarted {
            version: version.clone(),
        },
        Input::Synced { view_index, attempt } => Written::Synced {
            view_index: *view_index,
            attempt: *attempt,
        },
        Input::Withheld { device } => Written::Withheld { device: *device },
        Input::JournalFailed { reason } => Written::JournalFailed { reason: reason.clone() },
        Input::RobotBytes(_) | Input::CameraBytes(_) => unreachable!("bytes have topics of their own"),
    }
}

/// Reads an input back; `None` if the record is not one, or its JSON makes no sense.
pub fn read_input(record: &Record) -> Option<InputMemo> {
    let bytes = record.payload.clone();
    let input = match record.topic {
        Topic::RobotReceived => Input::RobotBytes(bytes),
        Topic::CameraReceived => Input::CameraBytes(bytes),
        Topic::Input => match serde_json::from_slice(&bytes).ok()? {
            Written::Begin => Input::Begin,
            Written::Wake => Input::Wake,
            Written::RobotUnreachable { reason } => Input::RobotUnreachable { reason },
            Written::RobotConnected => Input::RobotConnected,
            Written::RobotClosed { reason } => Input::RobotClosed { reason },
            Written::CameraConnected => Input::CameraConnected,
            Written::CameraClosed { reason } => Input::CameraClosed { reason },
            Written::Operator { command } => Input::Operator(command),
            Written::Restarted { version } => Input::Restarted { version },
            Written::Synced { view_index, attempt } => Input::Synced { view_index, attempt },
            Written::Withheld { device } => Input::Withheld { device },
            Written::JournalFailed { reason } => Input::JournalFailed { reason },
            Written::JobDone { job_id, times, .. } => return Some(InputMemo::JobDone { job_id, times }),
        },
        _ => return None,
    };
    Some(InputMemo::Whole(input))
}

/// The records of an output. `start_unix_ns` dates the viewer's messages.
pub fn output_records(stamp: Stamp, output: &Output, start_unix_ns: u64) -> Vec<Record> {
    let record = |topic, payload| Record { topic, stamp, payload };
    let output_record = |value: Value| record(Topic::Output, json_bytes(&value));
    let unix_ns = start_unix_ns + stamp.ns;
    match output {
        Output::Robot(RobotOutput::Bytes { bytes, .. }) => vec![record(Topic::RobotSent, bytes.clone())],
        Output::Robot(RobotOutput::Connect) => vec![output_record(json!({ "output": "robot-connect" }))],
        Output::Robot(RobotOutput::Close) => vec![output_record(json!({ "output": "robot-close" }))],
        Output::Camera(CameraOutput::Bytes { bytes, .. }) => vec![record(Topic::CameraSent, bytes.clone())],
        Output::Camera(CameraOutput::Connect) => vec![output_record(json!({ "output": "camera-connect" }))],
        Output::Camera(CameraOutput::Close) => vec![output_record(json!({ "output": "camera-close" }))],
        Output::Job { job_id, job } => vec![output_record(json!({
            "output": "job",
            "job_id": job_id,
            "name": job.name(),
            "view_index": job.view_index(),
        }))],
        Output::Sync { view_index, attempt } => vec![output_record(json!({
            "output": "sync",
            "view_index": view_index,
            "attempt": attempt,
        }))],
        Output::Event(event) => vec![
            record(Topic::Event, json_bytes(event)),
            record(Topic::Log, viewer::log(unix_ns, event)),
        ],
        Output::ViewCloud { view_index, cloud } => vec![record(
            Topic::ViewCloud,
            viewer::cloud(unix_ns, &viewer::view_frame(*view_index), cloud.points().iter()),
        )],
        Output::ViewPose {
            view_index,
            model_from_view,
        } => vec![record(
            Topic::Transform,
            viewer::transform(unix_ns, &viewer::view_frame(*view_index), model_from_view),
        )],
        Output::Model(model) => vec![record(
            Topic::Model,
            viewer::cloud(
                unix_ns,
                viewer::MODEL_FRAME,
                model.points().iter().map(|point| &point.position),
            ),
        )],
        Output::File { name, bytes } => vec![output_record(json!({
            "output": "file",
            "name": name,
            "bytes": bytes.len(),
            "sha256": sha256(bytes),
        }))],
    }
}

fn json_bytes(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("these types always have a JSON text")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_input_but_a_job_reads_back_as_it_was() {
        let inputs = [
            Input::Begin,
            Input::Wake,
            Input::RobotBytes(vec![1, 2, 3]),
            Input::RobotConnected,
            Input::RobotClosed { reason: "reset".into() },
            Input::RobotUnreachable {
                reason: "refused".into(),
            },
            Input::CameraConnected,
            Input::CameraBytes(vec![0; 5]),
            Input::CameraClosed { reason: "end".into() },
            Input::Operator(Command::Hold),
            Input::Restarted { version: "2".into() },
            Input::Synced {
                view_index: 3,
                attempt: 1,
            },
            Input::Withheld { device: Device::Robot },
            Input::JournalFailed { reason: "full".into() },
        ];
        for input in inputs {
            let record = input_record(Stamp::START, &input);
            let Some(InputMemo::Whole(back)) = read_input(&record) else {
                panic!("{input:?} did not read back");
            };
            assert_eq!(format!("{back:?}"), format!("{input:?}"));
        }
    }
}
