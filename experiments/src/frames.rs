//! Frames of other HSES clients: what the simulated controller answers to each.

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use hw_sim::robot::controller::{Controller, Options, RobotOutput, Settings};
use hw_sim::robot::hses::Port;
use hw_sim::robot::variables::{Position, Value};
use serde_json::Value as Json;

#[derive(Args)]
pub(crate) struct FramesArguments {
    /// JSON list of objects with `name` and `hex`, or with `op` and a list of frames for each client.
    file: PathBuf,
}

/// One client's frames of one operation, in their order.
struct Operation {
    name: String,
    frames: Vec<Vec<u8>>,
}

pub(crate) fn run(arguments: &FramesArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let vectors: Vec<Json> = serde_json::from_slice(&std::fs::read(&arguments.file)?)?;
    let mut wrong = 0;
    let operations = operations(&vectors)?;
    for operation in &operations {
        let mut robot = controller(&operation.name);
        let mut verdicts = Vec::new();
        for frame in &operation.frames {
            verdicts.push(answer(&mut robot, frame));
        }
        let verdict = verdicts.join(", then ");
        let expected = expected(&operation.name);
        let is_right = verdict.starts_with(expected);
        wrong += usize::from(!is_right);
        let mark = if is_right { "ok" } else { "WRONG" };
        writeln!(out, "{mark:5} {}: {verdict}", operation.name)?;
    }
    writeln!(out, "{} operations, {wrong} wrong", operations.len())?;
    if wrong > 0 {
        return Err("the simulated controller answers otherwise than expected".into());
    }
    Ok(())
}

fn operations(vectors: &[Json]) -> Result<Vec<Operation>, Box<dyn Error>> {
    let mut found = Vec::new();
    for vector in vectors {
        if let (Some(name), Some(hex)) = (vector["name"].as_str(), vector["hex"].as_str()) {
            if name.starts_with("req_") || name.contains("_req_") || name.contains("client") || name.contains("block") {
                let mut frames = beginning(name);
                frames.push(bytes(hex)?);
                let name = name.to_owned();
                found.push(Operation { name, frames });
            }
            continue;
        }
        let name = vector["op"].as_str().ok_or("a vector with neither name nor op")?;
        for client in ["fs100", "yrcom"] {
            let Some(frames) = vector[client].as_array().filter(|frames| !frames.is_empty()) else {
                continue;
            };
            let frames = frames.iter().map(|hex| bytes(hex.as_str().unwrap_or_default()));
            found.push(Operation {
                name: format!("{name} ({client})"),
                frames: frames.collect::<Result<_, _>>()?,
            });
        }
    }
    Ok(found)
}

/// What must be said before a frame that goes on with a transfer.
fn beginning(name: &str) -> Vec<Vec<u8>> {
    let request = |service: u8, data: &[u8]| {
        let mut bytes = b"YERC\x20\0".to_vec();
        bytes.extend((data.len() as u16).to_le_bytes());
        bytes.extend(b"\x03\x02\0\x01\0\0\0\099999999\0\0\0\0\0");
        bytes.extend([service, 0, 0]);
        bytes.extend(data);
        bytes
    };
    match name {
        "file_client_ack_list_last" => vec![request(0x32, b"*.JBI")],
        "file_load_block1_last" => vec![request(0x15, b"SCAN1.JBI")],
        _ => Vec::new(),
    }
}

/// A controller on which everything that the frames name is there.
fn controller(name: &str) -> Controller {
    let has_long_strings = name.starts_with("s32");
    let mut robot = Controller::new(Settings {
        jobs: ["SCAN1", "SCANJOB", "AAA"].map(job).to_vec(),
        options: Options {
            has_long_strings,
            ..Options::default()
        },
        ..Settings::default()
    });
    let position = Position {
        kind: 16,
        ..Position::default()
    };
    let set = [0, 1, 5, 10].map(|number| robot.set_variable(0, number, Value::P(position)));
    let made_ready = robot.set_servo(0, true).and(robot.select_job(0, "SCAN1", 0));
    debug_assert!(set.iter().all(Result::is_ok) && made_ready.is_ok());
    robot
}

fn job(name: &str) -> (String, String) {
    let text = format!("/JOB\r\n//NAME {name}\r\n//INST\r\nNOP\r\nEND\r\n");
    (name.to_owned(), text)
}

/// "done" with the size of the data, "refused" with the code, or "nothing"; and what was told.
fn answer(robot: &mut Controller, frame: &[u8]) -> String {
    let port = if frame.get(9) == Some(&2) {
        Port::File
    } else {
        Port::Robot
    };
    robot.handle_datagram(0, port, ([127, 0, 0, 1], 5000).into(), frame);
    let (mut verdict, mut told) = ("nothing".to_owned(), String::new());
    while let Some(output) = robot.poll_output() {
        match output {
            RobotOutput::Datagram { bytes, .. } => {
                let added = u16::from_le_bytes([bytes[28], bytes[29]]);
                verdict = match bytes[25] {
                    0 => format!("done, {} B", bytes.len() - 32),
                    0x1F => format!("refused {added:04X}"),
                    status => format!("refused {status:02X}"),
                };
            }
            RobotOutput::Violation(text) => told = format!(" [{text}]"),
        }
    }
    verdict + &told
}

/// How the answer to an operation begins.
fn expected(name: &str) -> &'static str {
    match name.split(' ').next().unwrap_or_default() {
        // Newer controllers only.
        "alarm_sub_0x30a" => "refused 08",
        // A text that is no whole job: no END, or no //INST.
        "file_load_send" if name.ends_with("(yrcom)") => "done, 0 B, then refused 5310",
        "file_load_send" => "done, 0 B, then refused 5130",
        "file_load_block1_last" => "done, 0 B, then refused 5130",
        _ => "done",
    }
}

fn bytes(digits: &str) -> Result<Vec<u8>, Box<dyn Error>> {
    let pairs = (0..digits.len() / 2).map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16));
    Ok(pairs.collect::<Result<_, _>>()?)
}
