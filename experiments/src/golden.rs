//! Golden frames of HSES and host control: the client's must equal them, the simulated controller must answer them.

mod client;
mod conversation;
mod host;
mod serial;

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;

use bladescan::job::hex;
use bladescan::robot::hses::{self, Answer};
use bladescan::robot::{Command, Refusal};
use clap::Args;
use client::Asked;
use hw_sim::robot::controller::{Controller, RobotOutput, Settings};
use hw_sim::robot::hses::Port;
use hw_sim::robot::pose::Pose;
use serde_json::Value;

#[derive(Args)]
pub(crate) struct GoldenArguments {
    /// JSON list of objects with `name` and `hex` (a datagram of HSES or a block of the serial line), with `op` and the
    /// datagrams of one or two clients, or with `dir` and `hex`: a recorded exchange on the serial line or over TCP.
    files: Vec<PathBuf>,
}

/// What was compared.
#[derive(Default)]
struct Tally {
    checked: usize,
    wrong: usize,
    left_out: usize,
    unserved: usize,
    refused: usize,
    differing: usize,
}

pub(crate) fn run(arguments: &GoldenArguments) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut wrong = 0;
    for file in &arguments.files {
        let vectors: Vec<Value> = serde_json::from_slice(&std::fs::read(file)?)?;
        let mut tally = Tally::default();
        let is_transcript = vectors.iter().any(|vector| vector["dir"] == "c>s");
        let is_recording = vectors.iter().any(|vector| vector["dir"].is_string());
        if is_transcript {
            for line in conversation::check(&vectors, &mut tally)? {
                writeln!(out, "{line}")?;
            }
        } else if is_recording {
            for (what, right) in crate::bsc::check(&vectors)? {
                writeln!(out, "{}", tally.check(right, "serial", &what))?;
            }
        }
        for vector in vectors.iter().filter(|_| !is_recording) {
            let lines = match vector["name"].as_str() {
                Some(name) => match bytes(&vector["hex"])? {
                    golden if golden.starts_with(b"YERC") => frame(name, &golden, &mut tally),
                    golden => serial::frame(name, vector, &golden, &mut tally),
                },
                None => operation(vector, &mut tally)?,
            };
            for line in lines {
                writeln!(out, "{line}")?;
            }
        }
        writeln!(
            out,
            "{}: {} vectors, {} left out; {} checks, {} wrong, {} differences named; the simulator does not know {} requests and refuses {} for its state",
            file.display(),
            vectors.len(),
            tally.left_out,
            tally.checked,
            tally.wrong,
            tally.differing,
            tally.unserved,
            tally.refused
        )?;
        wrong += tally.wrong;
    }
    if wrong > 0 {
        return Err("a golden vector is not met".into());
    }
    Ok(())
}

/// Checks one golden frame: as a request if we say it, else as an answer.
fn frame(name: &str, golden: &[u8], tally: &mut Tally) -> Vec<String> {
    let text = golden.get(32..).unwrap_or_default();
    let Some(asked) = client::asked(name, text) else {
        return match client::understood(name, golden) {
            Some(right) => vec![tally.check(right, name, "client understands it")],
            None => vec![tally.leave_out(name, client::left_out(name).unwrap_or("nothing here answers so"))],
        };
    };
    let id = golden.get(11).copied().unwrap_or_default();
    // Of a transfer, the golden frame is the last datagram.
    let equal = client::sent(&asked, id).last().is_some_and(|sent| sent == golden);
    let mut lines = vec![tally.check(equal, name, "client sends it")];
    if let Asked::Command(command) = &asked {
        lines.extend(tally.serve(name, command, golden));
    }
    lines
}

/// Checks what two public clients send for one operation: we send the same, or what the one with native widths sends.
fn operation(vector: &Value, tally: &mut Tally) -> Result<Vec<String>, Box<dyn Error>> {
    let name = vector["op"].as_str().ok_or("neither name nor op")?;
    let mut clients = Vec::new();
    for client in ["fs100", "yrcom"] {
        let datagrams: Vec<Vec<u8>> = vector[client]
            .as_array()
            .ok_or("a client without a list")?
            .iter()
            .map(bytes)
            .collect::<Result<_, _>>()?;
        if !datagrams.is_empty() {
            clients.push((client, datagrams));
        }
    }
    let (first, golden) = clients.first().ok_or("an operation without datagrams")?;
    let text = golden
        .last()
        .and_then(|datagram| datagram.get(32..))
        .unwrap_or_default();
    let Some(asked) = client::asked(name, text) else {
        return Ok(vec![
            tally.leave_out(name, client::left_out(name).unwrap_or("unknown here")),
        ]);
    };
    let mut expected = golden.clone();
    let mut ours = client::sent(&asked, 0);
    let mut lines = Vec::new();
    for (word, why) in client::chosen_words(name) {
        let place = 32 + 4 * word..36 + 4 * word;
        for datagram in expected.iter_mut().chain(&mut ours) {
            datagram[place.clone()].fill(0);
        }
        lines.push(format!("      {name}: {why}"));
    }
    let also = match clients.get(1) {
        Some((_, other)) if other == golden => "as both clients do",
        Some(_) => "as one client does; the other differs",
        None => "as the only client does",
    };
    lines.push(tally.check(ours == expected, name, &format!("client sends it {also} ({first})")));
    // Where we differ by choice, the simulator owes no answer to what we never say.
    if let (Asked::Command(command), []) = (&asked, client::chosen_words(name)) {
        lines.extend(tally.serve(name, command, &golden[0]));
    }
    Ok(lines)
}

impl Tally {
    fn check(&mut self, right: bool, name: &str, what: &str) -> String {
        self.checked += 1;
        self.wrong += usize::from(!right);
        format!("{:5} {name}: {what}", if right { "ok" } else { "WRONG" })
    }

    fn leave_out(&mut self, name: &str, why: &str) -> String {
        self.left_out += 1;
        format!("out   {name}: {why}")
    }

    /// A difference that is meant.
    fn differ(&mut self, name: &str, why: &str) -> String {
        self.differing += 1;
        format!("      {name}: {why}")
    }

    /// Whether the simulator answers well; a command that it does not know, or refuses for its state (no such job, a
    /// position never set, an arm that does not reach), is counted, not judged.
    fn serve(&mut self, name: &str, command: &Command, golden: &[u8]) -> Option<String> {
        match answered(command, golden) {
            Served::Well => Some(self.check(true, name, "simulator answers it")),
            Served::Badly => Some(self.check(false, name, "simulator answers it")),
            Served::Unknown => {
                self.unserved += 1;
                None
            }
            Served::Refused(words) => {
                self.refused += 1;
                Some(format!("      {name}: simulator refuses it: {words}"))
            }
        }
    }
}

/// How the simulator takes a request.
enum Served {
    Well,
    Badly,
    Unknown,
    Refused(String),
}

/// How a ready simulated controller takes the golden request, and whether the client understands its answer.
fn answered(command: &Command, request: &[u8]) -> Served {
    let mut robot = Controller::new(Settings {
        home: Pose::from_mm_deg([800.0, 0.0, 900.0], [0.0; 3]),
        workspace_min_um: [-2_000_000; 3],
        workspace_max_um: [2_000_000; 3],
        speed: 1.0,
        seed: 1,
        faults: Vec::new(),
        ..Settings::default()
    });
    let from = ([127, 0, 0, 1], 5000).into();
    let mut ask = |datagram: &[u8]| {
        robot.handle_datagram(0, Port::Robot, from, datagram);
        match robot.poll_output() {
            Some(RobotOutput::Datagram { bytes, .. }) => Some(bytes),
            _ => None,
        }
    };
    if matches!(command, Command::Move(_) | Command::MovePulses(_) | Command::StartJob) {
        ask(&hses::request(&Command::ServoOn, 9).expect("it fits").encode());
    }
    let Some(answer) = ask(request).and_then(|bytes| Answer::decode(&bytes).ok()) else {
        return Served::Badly;
    };
    let refusal = Refusal {
        status: answer.status,
        added_status: answer.added_status,
    };
    match (answer.status, answer.added_status) {
        (0, _) if answer.id == request[11] && hses::reply(command, &answer).is_ok() => Served::Well,
        (UNDEFINED_COMMAND, _) | (_, 0xA000) => Served::Unknown,
        (0x1F, state) if !is_about_form(state) => Served::Refused(refusal.words()),
        _ => Served::Badly,
    }
}

/// Whether a refusal blames the frame rather than the controller's state.
fn is_about_form(added_status: u16) -> bool {
    matches!(added_status, 0 | 0x1010..=0x1013 | 0xA001..=0xA101 | 0xB003 | 0xE49D..=0xE4A9)
}

pub(crate) fn bytes(digits: &Value) -> Result<Vec<u8>, Box<dyn Error>> {
    let digits = digits.as_str().ok_or("a vector without hex")?;
    let bytes = (0..digits.len() / 2)
        .map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16))
        .collect::<Result<Vec<u8>, _>>()?;
    debug_assert_eq!(hex(&bytes), digits);
    Ok(bytes)
}

/// The status byte of a controller that does not know a command.
const UNDEFINED_COMMAND: u8 = 0x08;
