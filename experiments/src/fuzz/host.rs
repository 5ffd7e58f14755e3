//! What the decoders of host control must bear, over TCP and the serial line, shared with the targets in `fuzz/`.

use bladescan::robot::host::bsc::block::{BlockReader, TEXT_BYTES_MAX, sum};
use bladescan::robot::host::{HostLink, LinkEvent, SerialLink, SerialSettings, TcpLink, TcpSettings, text};
use bladescan::robot::{Command, Reply, RobotOutput, Values, Variable, VariableKind};
use bladescan::stamp::Stamp;

/// Reads a line as the answer to every command. Whether it is the answer to one of them.
pub fn answer(bytes: &[u8]) -> bool {
    let line = String::from_utf8_lossy(bytes);
    let mut taken = text::result_code(&line).is_some() || text::refusal_code(&line) != 0;
    let _ = (text::form(&line), text::system_information(&line));
    for command in commands() {
        let reply = text::reply(&command, &line);
        match (&reply, &command) {
            (Ok(Reply::Values(values)), _) => assert_eq!(values.count(), 1),
            (Ok(Reply::Signals(groups)), Command::ReadSignals { count, .. }) => {
                assert_eq!(groups.len(), usize::from(*count));
            }
            _ => {}
        }
        // These two take any line.
        let any = matches!(reply, Ok(Reply::SystemInformation(_) | Reply::Values(Values::Text(_))));
        taken |= reply.is_ok() && !any;
    }
    taken
}

/// Hands bytes, in segments, to a TCP client that says a hold. Whether it was answered or refused.
pub fn tcp(bytes: &[u8]) -> bool {
    let mut link = TcpLink::new(TcpSettings {
        connect_timeout_ms: 1000,
        answer_timeout_ms: 500,
        give_up_ms: 100,
    });
    let said = link.say(Stamp::START, &Command::HoldOn);
    assert!(said.is_ok());
    link.handle_connected(Stamp::START);
    for segment in segments(bytes) {
        link.handle_bytes(Stamp::START, segment);
    }
    while let Some(due) = link.wake_at() {
        link.handle_wake(due);
    }
    let data = |output: &RobotOutput| matches!(output, RobotOutput::Bytes { bytes, .. } if bytes == b"1\r");
    let data_count = std::iter::from_fn(|| link.poll_output()).filter(data).count();
    assert!(data_count <= 1, "the data of one command leave once");
    ended(std::iter::from_fn(|| link.poll_event()))
}

/// Reads blocks. Whether there is one.
pub fn block(bytes: &[u8]) -> bool {
    let mut reader = BlockReader::default();
    let mut taken = false;
    for block in bytes.iter().filter_map(|&byte| reader.push(byte)).flatten() {
        assert!(block.text.len() <= TEXT_BYTES_MAX);
        taken = true;
    }
    taken
}

/// Hands bytes, in segments, to a serial host that starts a job. Whether it was answered or refused.
pub fn serial(bytes: &[u8]) -> bool {
    let mut link = SerialLink::new(SerialSettings::default());
    let mut now = Stamp::START;
    let said = link.say(now, &Command::StartJob);
    assert!(said.is_ok());
    for segment in segments(bytes) {
        now = now.plus_ms(SEGMENT_MS);
        link.handle_bytes(now, segment);
    }
    while let Some(due) = link.wake_at() {
        link.handle_wake(due);
    }
    assert!(link.is_idle());
    let block =
        |output: &RobotOutput| matches!(output, RobotOutput::Bytes { bytes, .. } if bytes.first() == Some(&0x01));
    let block_count = std::iter::from_fn(|| link.poll_output()).filter(block).count();
    let nak_count = bytes.iter().filter(|&&byte| byte == 0x15).count();
    assert!(block_count <= 1 + nak_count, "an act's block leaves again only on NAK");
    ended(std::iter::from_fn(|| link.poll_event()))
}

/// Answers as lines.
pub fn answer_seeds() -> Vec<Vec<u8>> {
    [
        "196,64",
        "0,0,4315,1,0,0,0,0,0,0",
        "500.000,-250.000,750.000,180.0000,0.0000,-90.0000,1,1",
        "1000,-2000,3000,0,0,42,0,0,0,0,0,0",
        "SCAN1,12,3",
        "0,1,2,3,4,5,6,0",
        "1,2,500.000,-250.000,750.000,180.00,0.00,-90.00,1,1",
        "-7",
        "3.25",
        "85,3",
        "0000",
        "ERROR: MOVL is not successful(2010)",
        "OK: DX Information Server( 1.07) Keep-Alive:-1.",
    ]
    .map(|line| line.as_bytes().to_vec())
    .to_vec()
}

/// All that a server says while a hold is said.
pub fn tcp_seeds() -> Vec<Vec<u8>> {
    let greeting = "OK: DX Information Server( 1.07) Keep-Alive:-1.\r\n";
    [
        format!("{greeting}OK: HOLD\r\n0000\r\n"),
        format!("{greeting}OK: HOLD\r\nERROR: HOLD is not successful(2100)\r\n"),
        format!("{greeting}NG: undefined command\r\n"),
        "OK: DX Information Server( 1.07).\r\nOK: HOLD\r\n0000\r\n".into(),
        "NG: too many connections\r\n".into(),
    ]
    .map(String::into_bytes)
    .to_vec()
}

/// Single blocks.
pub fn block_seeds() -> Vec<Vec<u8>> {
    let long = "X".repeat(TEXT_BYTES_MAX);
    vec![
        encoded("\x0190,000\x020000\r\x03"),
        encoded("\x0190,001\x02196,64\r\x03"),
        encoded("\x0102,001\x02SCAN1.JBI\r\x17"),
        encoded("\x02/JOB\r\n//NAME SCAN1\r\nEND\r\n\x03"),
        encoded(&format!("\x02{long}\x17")),
    ]
}

/// All that a controller says while a job is started.
pub fn serial_seeds() -> Vec<Vec<u8>> {
    let ok = encoded("\x0190,000\x020000\r\x03");
    let whole = [b"\x100\x101\x05".as_slice(), &ok, b"\x04"].concat();
    let refused = [b"\x100\x15\x101\x05".as_slice(), &ok, &ok, b"\x04"].concat();
    let contended = [b"\x05".as_slice(), &ok, b"\x04\x100\x101\x05", &ok, b"\x04"].concat();
    vec![whole, refused, contended]
}

/// Makes the sum of a single block true again.
pub fn mend_block(bytes: &mut [u8]) {
    if let [_, body @ .., low, high] = bytes {
        [*low, *high] = sum(body).to_le_bytes();
    }
}

fn encoded(block: &str) -> Vec<u8> {
    let mut bytes = block.as_bytes().to_vec();
    bytes.extend([0, 0]);
    mend_block(&mut bytes);
    bytes
}

/// Pieces whose size depends on the bytes alone.
fn segments(bytes: &[u8]) -> std::slice::Chunks<'_, u8> {
    bytes.chunks(1 + bytes.len() % 13)
}

/// Whether the one command that was said has an answer; it must have ended exactly once.
fn ended(told: impl Iterator<Item = LinkEvent>) -> bool {
    let ends: Vec<LinkEvent> = told
        .filter(|event| {
            matches!(
                event,
                LinkEvent::Answered(_) | LinkEvent::Refused(_) | LinkEvent::Unanswered
            )
        })
        .collect();
    assert_eq!(ends.len(), 1, "one command, one end");
    ends[0] != LinkEvent::Unanswered
}

/// Every command whose answer has data.
fn commands() -> impl Iterator<Item = Command> {
    let kinds = [
        VariableKind::Byte,
        VariableKind::Integer,
        VariableKind::Double,
        VariableKind::Real,
        VariableKind::Text,
        VariableKind::Position,
    ];
    let reads = kinds.into_iter().map(|kind| Command::Read {
        first: Variable { kind, index: 0 },
        count: 1,
    });
    let signals = [1, 2, 256].map(|count| Command::ReadSignals { first_group: 1, count });
    [
        Command::Status,
        Command::Alarm(0),
        Command::Position,
        Command::Pulses,
        Command::ExecutingJob,
        Command::SystemInformation,
    ]
    .into_iter()
    .chain(signals)
    .chain(reads)
}

/// Between two segments on the serial line.
const SEGMENT_MS: u64 = 40;
