//! A recorded transcript of host control over TCP: what two public clients and a responder said to each other.
//!
//! The simulated server must answer the recorded clients as the responder did; our client must say what they said, and
//! understand the responder. Where either differs, the difference is told with its reason.

use std::error::Error;

use bladescan::robot::host::{HostLink, LinkEvent, TcpLink, TcpSettings, text};
use bladescan::robot::{Command, Reply, RobotOutput};
use bladescan::stamp::Stamp;
use hw_sim::fault::Fault;
use hw_sim::robot::controller::{Controller, Settings};
use hw_sim::robot::host::interpreter::interpret;
use hw_sim::robot::host::tcp::{Connection, TcpOutput};
use hw_sim::robot::host::{Answer, Call};
use hw_sim::robot::pose::Pose;
use serde_json::Value;

use super::host::{Likeness, command, likeness};
use super::{Tally, bytes};

/// One connection: what the client and the server said, piece by piece.
#[derive(Default)]
struct Conversation {
    label: String,
    client: Vec<String>,
    server: Vec<String>,
}

/// Checks all conversations of the transcript, in their order.
pub(super) fn check(segments: &[Value], tally: &mut Tally) -> Result<Vec<String>, Box<dyn Error>> {
    let mut lines = Vec::new();
    for conversation in &conversations(segments)? {
        lines.extend(served(conversation, tally));
        lines.extend(said(conversation, tally));
    }
    Ok(lines)
}

/// Each CONNECT begins one.
fn conversations(segments: &[Value]) -> Result<Vec<Conversation>, Box<dyn Error>> {
    let mut conversations: Vec<Conversation> = Vec::new();
    for segment in segments {
        let piece = String::from_utf8(bytes(&segment["hex"])?)?;
        let is_client = segment["dir"] == "c>s";
        if is_client && piece.starts_with("CONNECT") {
            let label = segment["label"].as_str().unwrap_or_default().to_owned();
            conversations.push(Conversation {
                label,
                ..Conversation::default()
            });
        }
        let conversation = conversations
            .last_mut()
            .ok_or("a transcript that does not begin with CONNECT")?;
        let side = if is_client {
            &mut conversation.client
        } else {
            &mut conversation.server
        };
        side.push(piece);
    }
    Ok(conversations)
}

impl Conversation {
    /// Name of the command, its data without the closing CR, and what both are called together.
    fn request(&self) -> (&str, &str, String) {
        let name = self
            .client
            .get(1)
            .and_then(|line| line.split(' ').nth(1))
            .unwrap_or_default();
        let data = self
            .client
            .get(2)
            .map_or("", |data| data.trim_end_matches(['\r', '\n']));
        let shown = data.split(',').take(3).collect::<Vec<_>>().join(",");
        let dots = if data.len() > shown.len() { ",.." } else { "" };
        (
            name,
            data,
            format!("{} {}", self.label, format!("{name} {shown}{dots}").trim_end()),
        )
    }

    fn answer(&self) -> &str {
        self.server.last().map_or("", String::as_str)
    }
}

/// Whether the simulated server says what the recorded one said.
fn served(conversation: &Conversation, tally: &mut Tally) -> Vec<String> {
    let (name, data, title) = conversation.request();
    let mut robot = robot(conversation.answer());
    let mut connection = Connection::new(PAUSE_NS);
    let mut pieces = Vec::new();
    let mut is_closed = false;
    let mut violations = 0;
    for said in &conversation.client {
        connection.handle_bytes(0, said.as_bytes(), &mut |now_ns, call| {
            interpret(&mut robot, now_ns, call)
        });
    }
    while let Some(now_ns) = connection.wake_at() {
        connection.handle_wake(now_ns, &mut |now_ns, call| interpret(&mut robot, now_ns, call));
    }
    while let Some(output) = connection.poll_output() {
        match output {
            TcpOutput::Bytes(piece) => pieces.push(String::from_utf8_lossy(&piece).into_owned()),
            TcpOutput::Close => is_closed = true,
            TcpOutput::Violation(_) => violations += 1,
        }
    }
    let [greeting, confirmation, answer] = pieces.as_slice() else {
        return vec![tally.check(false, &title, "simulator says three lines")];
    };
    let is_greeting = greeting.starts_with("OK: DX Information Server(") && greeting.ends_with(").\r\n");
    let mut lines = vec![tally.check(
        is_greeting && conversation.server.get(1) == Some(confirmation) && is_closed && violations == 0,
        &title,
        "simulator greets, confirms, answers once and closes",
    )];
    let golden = conversation.answer();
    if answer == golden {
        lines.push(tally.check(true, &title, "simulator answers it, byte for byte"));
        return lines;
    }
    let Some((is_right, why)) = excused(name, data, answer, golden) else {
        lines.push(tally.check(
            false,
            &title,
            &format!("simulator answers it: {answer:?}, not {golden:?}"),
        ));
        return lines;
    };
    lines.push(tally.check(is_right, &title, "simulator answers it in kind"));
    lines.push(tally.differ(&title, why));
    lines
}

/// Where the simulator answers otherwise with a reason: whether it keeps what must be kept, and the reason.
fn excused(name: &str, data: &str, answer: &str, golden: &str) -> Option<(bool, &'static str)> {
    let is_data = |text: &str| text.ends_with('\r') && !text.contains('\n');
    let count = |text: &str| text.split(',').count();
    let is_alike = is_data(answer) && is_data(golden) && count(answer) == count(golden);
    Some(match name {
        "RPOSC" => {
            let pose = |text: &str| match text::reply(&Command::Position, text.trim_end()) {
                Ok(Reply::Position(position)) => Some(position.base_from_tool),
                _ => None,
            };
            let same = pose(answer).is_some() && pose(answer) == pose(golden);
            (
                is_alike && same,
                "the same pose, angles with four decimals, not two; the simulated arm is of type 1 with tool 1, not 0 and 0",
            )
        }
        "RPOSJ" => (
            is_alike,
            "the simulated arm stands elsewhere: the responder's pulses belong to no pose",
        ),
        "RJSEQ" => (
            is_alike && answer.starts_with("SCAN1,12,"),
            "the job's step follows from its moves; the responder's line 12 has step 3",
        ),
        "RJDIR" => (
            answer == "SCAN1,SCAN2,SIMULATED\r",
            "a simulated controller has a job SIMULATED besides",
        ),
        "IOREAD" => (
            is_alike,
            "the responder has outputs 10010 on that no job of the simulator sets",
        ),
        "MOVL" => (
            answer == "ERROR: MOVL is not successful(1012)\r\n" && type_1_is_taken(data),
            "type 0 (flip) is refused with 1012: the simulated arm knows type 1 alone; the responder takes everything",
        ),
        _ => return None,
    })
}

/// Whether nothing but its type stood against a move.
fn type_1_is_taken(data: &str) -> bool {
    let mut fields: Vec<&str> = data.split(',').map(str::trim).collect();
    if let Some(field) = fields.get_mut(MOVE_TYPE_FIELD) {
        *field = "1";
    }
    interpret(&mut robot(""), 0, &call("MOVL", &fields.join(","))) == Answer::Done
}

fn call(name: &str, data: &str) -> Call {
    Call {
        name: name.to_owned(),
        data: data.to_owned(),
        since_ns: 0,
    }
}

/// A controller in the state that the responder told: its pose, its jobs, one cycle, servo on, D042 = 42; where it
/// answered 2100, command remote off.
fn robot(answer: &str) -> Controller {
    let job = |name: &str| {
        let comments = "'A LINE\r\n".repeat(14);
        let text = format!(
            "/JOB\r\n//NAME {name}\r\n//POS\r\n///NPOS 0,0,0,0,0,0\r\n//INST\r\n///DATE 2026/01/02 03:04\r\n\
             ///ATTR SC,RW\r\n///GROUP1 RB1\r\nNOP\r\n{comments}END\r\n"
        );
        (name.to_owned(), text)
    };
    let is_remote = !answer.contains("(2100)");
    let mut robot = Controller::new(Settings {
        home: Pose::from_mm_deg([353.769, 202.779, 120.658], [-1.34, 35.78, 27.84]),
        faults: if is_remote { Vec::new() } else { vec![Fault::RemoteOff] },
        jobs: vec![job("SCAN1"), job("SCAN2")],
        ..Settings::default()
    });
    if is_remote {
        for (name, data) in [
            ("CYCLE", "2"),
            ("SVON", "1"),
            ("JSEQ", "SCAN1,12"),
            ("LOADV", "2,42,42"),
        ] {
            interpret(&mut robot, 0, &call(name, data));
        }
    }
    robot
}

/// Whether our client says the same, and understands the recorded server.
fn said(conversation: &Conversation, tally: &mut Tally) -> Vec<String> {
    let (name, data, title) = conversation.request();
    let command = match command(name, data) {
        Ok(command) => command,
        Err(why) => {
            let mut lines = vec![tally.differ(&title, why)];
            if let Some((_, code)) = conversation.answer().split_once("not successful(") {
                let is_read = code.starts_with(&format!("{:04X})", text::refusal_code(conversation.answer())));
                lines.push(tally.check(is_read, &title, "client reads the code of the refusal"));
            }
            return lines;
        }
    };
    let now = Stamp::START;
    let mut link = TcpLink::new(TcpSettings {
        connect_timeout_ms: 1000,
        answer_timeout_ms: 1000,
        give_up_ms: 1000,
    });
    if link.say(now, &command).is_err() {
        return vec![tally.check(false, &title, "client has words for it")];
    }
    let mut pieces = heard(&mut link);
    link.handle_connected(now);
    pieces.extend(heard(&mut link));
    for line in &conversation.server {
        link.handle_bytes(now, line.as_bytes());
        pieces.extend(heard(&mut link));
    }
    let is_understood = matches!(link.poll_event(), Some(LinkEvent::Answered(_))) && link.poll_event().is_none();
    let mut lines = vec![tally.check(is_understood, &title, "client understands the answer")];
    let golden = conversation.client.concat();
    let ours = pieces.concat().replacen(" Keep-Alive:-1", "", 1);
    let our_data = pieces.concat();
    let our_data = our_data
        .rsplit_once('\n')
        .map_or("", |(_, data)| data.trim_end_matches('\r'));
    let our_name = pieces.get(1).and_then(|line| line.split(' ').nth(1));
    if ours == golden {
        lines.push(tally.check(true, &title, "client says it, byte for byte (but for Keep-Alive:-1)"));
    } else {
        let is_alike = our_name == Some(name) && likeness(our_data, data) == Likeness::SameFields;
        lines.push(tally.check(is_alike, &title, "client says the same fields"));
        lines.push(tally.differ(
            &title,
            "no spaces behind commas, decimals written out, and the size that counts them",
        ));
    }
    lines
}

/// What the link sends now.
fn heard(link: &mut TcpLink) -> Vec<String> {
    let mut pieces = Vec::new();
    while let Some(output) = link.poll_output() {
        if let RobotOutput::Bytes { bytes, .. } = output {
            pieces.push(String::from_utf8_lossy(&bytes).into_owned());
        }
    }
    pieces
}

/// Between the confirmation and the answer, as public clients need it.
const PAUSE_NS: u64 = 50_000_000;
/// Where MOVL names the arm's configuration.
const MOVE_TYPE_FIELD: usize = 9;
