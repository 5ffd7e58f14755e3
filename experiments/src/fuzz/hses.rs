//! What the decoders of HSES must bear, shared with the targets in `fuzz/`.

use bladescan::robot::hses::{self, Answer, DATA_BYTES_MAX, FileAnswer, FileEvent, FileSettings, Files};
use bladescan::robot::{
    AlarmClass, Command, Exchange, ExchangeSettings, FILE_BYTES_MAX, FileCommand, FileContent, FileEnding, FileName,
    Protocol, Reply, RobotEvent, Variable, VariableKind,
};
use bladescan::stamp::Stamp;

/// Reads an answer, and its data as the reply to every command. Whether it is an answer.
pub fn answer(bytes: &[u8]) -> bool {
    let Ok(answer) = Answer::decode(bytes) else {
        return false;
    };
    assert!(answer.data.len() <= DATA_BYTES_MAX);
    for command in commands() {
        match (hses::reply(&command, &answer), &command) {
            (Ok(Reply::Values(values)), Command::Read { count, .. }) => assert_eq!(values.count(), usize::from(*count)),
            (Ok(Reply::Signals(groups)), Command::ReadSignals { count, .. }) => {
                assert_eq!(groups.len(), usize::from(*count));
            }
            _ => {}
        }
    }
    true
}

/// Hands a datagram to a conversation in which a question is open. Whether it was the answer.
pub fn exchange(bytes: &[u8]) -> bool {
    let mut exchange = Exchange::new(ExchangeSettings {
        protocol: Protocol::Hses,
        answer_timeout_ms: 300,
        ask_attempts: 3,
        set_repeat_ms: 100,
        set_timeout_ms: 1000,
    });
    exchange.say(Stamp::START, Command::Status);
    exchange.handle_bytes(Stamp::START, bytes);
    let event = exchange.poll_event();
    assert!(
        event.is_some() && exchange.poll_event().is_none(),
        "one datagram, one event"
    );
    !matches!(event, Some(RobotEvent::Dropped { .. }))
}

/// Reads a frame of the file port.
pub fn file_answer(bytes: &[u8]) -> bool {
    FileAnswer::decode(bytes).is_ok_and(|answer| answer.data.len() <= DATA_BYTES_MAX)
}

/// Hands datagrams, each with its length in two bytes before it, to a transfer that the first byte chooses. Whether it
/// ended.
pub fn file_transfer(bytes: &[u8]) -> bool {
    let Some((choice, mut rest)) = bytes.split_first() else {
        return false;
    };
    let settings = FileSettings {
        answer_timeout_ms: 100,
        attempts: 3,
    };
    let mut files = Files::new(settings);
    let begun = files.begin(Stamp::START, transfer(*choice));
    assert!(begun.is_ok() && files.poll_output().is_some());
    while let Some((size, tail)) = rest.split_first_chunk::<2>() {
        let (datagram, tail) = tail.split_at(tail.len().min(usize::from(u16::from_le_bytes(*size))));
        rest = tail;
        files.handle_datagram(Stamp::START, datagram);
        let said = [files.poll_output(), files.poll_output()];
        assert!(said[1].is_none(), "one datagram, one answer at most");
        while let Some(event) = files.poll_event() {
            if let FileEvent::Saved { content, .. } = event {
                assert!(content.len() <= bytes.len().min(FILE_BYTES_MAX));
            }
        }
    }
    files.is_idle()
}

/// Answers of every length that means something.
pub fn answer_seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for length in [0, 1, 2, 4, 8, 16, 44, 48, 52, 60, 268] {
        for service in [0x81, 0x8E] {
            seeds.push(robot_frame(service, &ramp(length)));
        }
    }
    for (count, width) in [(2, 1), (4, 1), (3, 2), (3, 4), (2, 16), (2, 52), (9, 52), (474, 1)] {
        let mut data = u32::to_le_bytes(count).to_vec();
        data.extend(ramp(count as usize * width));
        seeds.push(robot_frame(0xB3, &data));
    }
    let mut pose = ramp(52);
    pose[..20].fill(0);
    pose[0] = 16;
    seeds.push(robot_frame(0x81, &pose));
    let mut refused = robot_frame(0x90, &[]);
    refused[25..30].copy_from_slice(&[0x1F, 1, 0, 0x10, 0x20]);
    seeds.push(refused);
    seeds
}

/// Frames of the file port.
pub fn file_seeds() -> Vec<Vec<u8>> {
    let frame = |service, block, data: &[u8]| file_frame(service, block, data);
    vec![
        frame(0xB2, 0x8000_0001, b"SCAN1.JBI\r\nSCAN2.JBI\r\n"),
        frame(0x96, 1, b"/JOB\r\n"),
        frame(0x96, 0x8000_0002, b"//NAME SCAN1\r\n"),
        frame(0x96, 1, &ramp(479)),
        frame(0x95, 0, b""),
        frame(0x95, 1, b""),
        frame(0x95, 0x8000_0003, b""),
        frame(0x89, 0, b""),
    ]
}

/// Whole transfers, as [`file_transfer`] takes them.
pub fn transfer_seeds() -> Vec<Vec<u8>> {
    let transfer = |choice: u8, frames: &[Vec<u8>]| {
        let mut bytes = vec![choice];
        for frame in frames {
            bytes.extend((frame.len() as u16).to_le_bytes());
            bytes.extend(frame);
        }
        bytes
    };
    let load: Vec<Vec<u8>> = [0, 1, 2, 0x8000_0003]
        .map(|block| file_frame(0x95, block, b""))
        .to_vec();
    let save = [
        file_frame(0x96, 1, b"/JOB\r\n"),
        file_frame(0x96, 0x8000_0002, b"END\r\n"),
    ];
    vec![
        transfer(0, &[file_frame(0xB2, 0x8000_0001, b"SCAN1.JBI\r\n")]),
        transfer(1, &save),
        transfer(1, &[save[0].clone(), save[0].clone(), save[1].clone(), save[1].clone()]),
        transfer(2, &load),
        transfer(3, &[file_frame(0x89, 0, b"")]),
    ]
}

/// Makes the data size of a frame true again.
pub fn mend_frame(bytes: &mut [u8]) {
    if bytes.len() >= 32 {
        let size = ((bytes.len() - 32) as u16).to_le_bytes();
        bytes[6..8].copy_from_slice(&size);
    }
}

fn transfer(choice: u8) -> FileCommand {
    let name = FileName::parse("SCAN1.JBI").expect("a file name");
    match choice % 4 {
        0 => FileCommand::List(FileEnding::Jbi),
        1 => FileCommand::Save(name),
        2 => FileCommand::Load {
            name,
            content: FileContent::new(vec![b'x'; 900]).expect("900 bytes"),
        },
        _ => FileCommand::Delete(name),
    }
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
        VariableKind::Register,
    ];
    let reads = kinds.into_iter().flat_map(|kind| {
        let first = Variable { kind, index: 0 };
        [1, 2, 3, 4, 9, 474].map(move |count| Command::Read { first, count })
    });
    let signals = [1, 2, 474].map(|count| Command::ReadSignals { first_group: 1, count });
    let class = AlarmClass::Major;
    [
        Command::Status,
        Command::Alarm(0),
        Command::AlarmHistory { class, index: 0 },
        Command::Position,
        Command::Pulses,
        Command::ExecutingJob,
        Command::SystemInformation,
        Command::HoldOn,
    ]
    .into_iter()
    .chain(signals)
    .chain(reads)
}

fn ramp(length: usize) -> Vec<u8> {
    (0..length).map(|at| at as u8).collect()
}

fn robot_frame(service: u8, data: &[u8]) -> Vec<u8> {
    frame(1, service, 0x8000_0000, data)
}

fn file_frame(service: u8, block: u32, data: &[u8]) -> Vec<u8> {
    frame(2, service, block, data)
}

fn frame(division: u8, service: u8, block: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"YERC\x20\0\0\0\x03".to_vec();
    bytes.extend([division, 1, 1]);
    bytes.extend(block.to_le_bytes());
    bytes.extend(b"99999999");
    bytes.extend([service, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend(data);
    mend_frame(&mut bytes);
    bytes
}
