//! Properties of the codec: whatever comes is read or refused, and what is said can be read by another hand.

use super::*;
use crate::robot::{
    AlarmClass, Command, Cycle, FileCommand, FileContent, FileEnding, FileName, Form, Frame, JobName, Move, MovePulses,
    Path, PositionVariable, Reply, RobotOutput, Speed, Values, Variable, VariableKind, WirePose,
};
use crate::stamp::Stamp;
use proptest::array::{uniform3, uniform8};
use proptest::collection::vec;
use proptest::prelude::*;

fn wire_pose() -> impl Strategy<Value = WirePose> {
    (uniform3(any::<i32>()), uniform3(any::<i32>())).prop_map(|(position_um, rotation_e4_deg)| WirePose {
        position_um,
        rotation_e4_deg,
    })
}

fn position() -> impl Strategy<Value = PositionVariable> {
    let frame = prop_oneof![
        Just(Frame::Base),
        Just(Frame::Robot),
        any::<u8>().prop_map(Frame::User),
        Just(Frame::Tool)
    ];
    prop_oneof![
        (uniform8(any::<i32>()), 0..64u8).prop_map(|(pulses, tool)| PositionVariable::Pulses { pulses, tool }),
        (frame, wire_pose(), any::<u8>(), 0..64u8).prop_map(|(frame, pose, form, tool)| {
            let form = Form(form);
            PositionVariable::Cartesian {
                frame,
                pose,
                form,
                tool,
            }
        }),
    ]
}

/// Values of every kind that one frame carries.
fn values() -> impl Strategy<Value = Values> {
    // What ends in spaces is read back without them.
    let text = "[!-~]([ -~]{0,14}[!-~])?";
    prop_oneof![
        vec(any::<u8>(), 1..=237).prop_map(|half| match half.as_slice() {
            [one] => Values::Byte(vec![*one]),
            half => Values::Byte([half, half].concat()),
        }),
        vec(any::<i16>(), 1..=237).prop_map(Values::Integer),
        vec(any::<i32>(), 1..=118).prop_map(Values::Double),
        vec(any::<f32>(), 1..=118).prop_map(Values::Real),
        vec(text, 1..=29).prop_map(Values::Text),
        vec(position(), 1..=9).prop_map(Values::Position),
        vec(any::<u16>(), 1..=237).prop_map(Values::Register),
    ]
}

fn read(values: &Values, index: u16) -> Command {
    let kind = values.kind();
    Command::Read {
        first: Variable { kind, index },
        count: values.count() as u16,
    }
}

fn write(values: &Values, index: u16) -> Command {
    let kind = values.kind();
    Command::Write {
        first: Variable { kind, index },
        values: values.clone(),
    }
}

fn speed() -> impl Strategy<Value = Speed> {
    prop_oneof![
        (1..=10_000u32).prop_map(Speed::Link),
        any::<u32>().prop_map(Speed::ToolPoint),
        any::<u32>().prop_map(Speed::Turn)
    ]
}

fn path() -> impl Strategy<Value = Path> {
    prop_oneof![Just(Path::Straight), Just(Path::Link)]
}

/// Every command, of values only those that one frame carries.
fn command() -> impl Strategy<Value = Command> {
    let class = prop_oneof![
        Just(AlarmClass::Major),
        Just(AlarmClass::Minor),
        Just(AlarmClass::UserSystem),
        Just(AlarmClass::UserUser),
        Just(AlarmClass::Offline)
    ];
    let plain = prop::sample::select(vec![
        Command::Status,
        Command::Position,
        Command::Pulses,
        Command::ExecutingJob,
        Command::SystemInformation,
        Command::HoldOn,
        Command::HoldOff,
        Command::ServoOn,
        Command::ServoOff,
        Command::AlarmReset,
        Command::ErrorCancel,
        Command::SetCycle(Cycle::Step),
        Command::SetCycle(Cycle::Once),
        Command::SetCycle(Cycle::Continuous),
        Command::StartJob,
    ]);
    prop_oneof![
        plain,
        (0..4u8).prop_map(Command::Alarm),
        (class, 0..100u8).prop_map(|(class, index)| Command::AlarmHistory { class, index }),
        "[ -~]{0,30}".prop_map(Command::ShowText),
        ("[A-Z0-9_-]{1,32}", 0..=9999u32).prop_map(|(job, line)| {
            let job = JobName::parse(&job).unwrap();
            Command::SelectJob { job, line }
        }),
        (values(), any::<u16>()).prop_map(|(values, index)| read(&values, index)),
        (values(), any::<u16>()).prop_map(|(values, index)| write(&values, index)),
        (any::<u16>(), 1..=237u16).prop_map(|(first_group, half)| {
            let count = half * 2;
            Command::ReadSignals { first_group, count }
        }),
        (any::<u16>(), any::<u8>()).prop_map(|(first_group, group)| {
            let groups = vec![group];
            Command::WriteSignals { first_group, groups }
        }),
        (any::<u16>(), any::<i32>()).prop_map(|(variable, value)| Command::Order { variable, value }),
        (wire_pose(), path(), speed(), any::<u8>()).prop_map(|(base_from_tool, path, speed, tool)| {
            Command::Move(Move {
                base_from_tool,
                path,
                speed,
                tool,
            })
        }),
        (uniform8(any::<i32>()), path(), speed(), any::<u8>()).prop_map(|(pulses, path, speed, tool)| {
            Command::MovePulses(MovePulses {
                pulses,
                path,
                speed,
                tool,
            })
        }),
    ]
}

/// A request as another reader takes it apart.
#[derive(Debug, PartialEq)]
struct Parsed {
    id: u8,
    command: u16,
    instance: u16,
    attribute: u8,
    service: u8,
    data: Vec<u8>,
}

fn parsed(bytes: &[u8]) -> Parsed {
    assert!((32..=511).contains(&bytes.len()));
    assert_eq!(bytes[..6], *b"YERC\x20\0");
    assert_eq!(usize::from(u16_at(bytes, 6)), bytes.len() - 32);
    assert_eq!(bytes[8..11], [3, 1, 0]);
    assert_eq!(bytes[12..24], *b"\0\0\0\099999999");
    assert_eq!(bytes[30..32], [0, 0]);
    Parsed {
        id: bytes[11],
        command: u16_at(bytes, 24),
        instance: u16_at(bytes, 26),
        attribute: bytes[28],
        service: bytes[29],
        data: bytes[32..].to_vec(),
    }
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from(bytes[at]) | u16::from(bytes[at + 1]) << 8
}

fn words(data: &[u8]) -> Vec<i32> {
    data.chunks(4)
        .map(|four| i32::from_le_bytes(four.try_into().unwrap()))
        .collect()
}

/// Of the page's table: the single command, the plural one, the width.
fn row(kind: VariableKind) -> (u16, u16, usize) {
    match kind {
        VariableKind::Register => (0x79, 0x301, 2),
        VariableKind::Byte => (0x7A, 0x302, 1),
        VariableKind::Integer => (0x7B, 0x303, 2),
        VariableKind::Double => (0x7C, 0x304, 4),
        VariableKind::Real => (0x7D, 0x305, 4),
        VariableKind::Text => (0x7E, 0x306, 16),
        VariableKind::Position => (0x7F, 0x307, 52),
    }
}

/// An answer of the robot port as a controller builds it.
fn answer(request: &Parsed, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"YERC\x20\0".to_vec();
    bytes.extend((data.len() as u16).to_le_bytes());
    bytes.extend([3, 1, 1, request.id, 0, 0, 0, 0x80]);
    bytes.extend(b"99999999");
    bytes.extend([request.service | 0x80, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend(data);
    bytes
}

/// A frame of the file port: sometimes nonsense, mostly nearly right.
fn file_frame() -> impl Strategy<Value = Vec<u8>> {
    let service = prop::sample::select(vec![0x89, 0x95, 0x96, 0xB2]);
    let block = prop_oneof![0..4u32, Just(0x8000_0000), 0x8000_0001..0x8000_0004u32, any::<u32>()];
    let status = prop_oneof![9 => Just(0u8), 1 => any::<u8>()];
    let nearly =
        (1..3u8, service, block, status, vec(any::<u8>(), 0..=479)).prop_map(|(id, service, block, status, data)| {
            let mut bytes = b"YERC\x20\0".to_vec();
            bytes.extend((data.len() as u16).to_le_bytes());
            bytes.extend([3, 2, 1, id]);
            bytes.extend(block.to_le_bytes());
            bytes.extend(b"99999999");
            bytes.extend([service, status, 1, 0, 0x8B, 0xE2, 0, 0]);
            bytes.extend(data);
            bytes
        });
    prop_oneof![9 => nearly, 1 => vec(any::<u8>(), 0..600)]
}

fn file_command() -> impl Strategy<Value = FileCommand> {
    let name = FileName::parse("SCAN1.JBI").unwrap();
    let content = FileContent::new(vec![b'x'; 900]).unwrap();
    prop::sample::select(vec![
        FileCommand::List(FileEnding::Jbi),
        FileCommand::Save(name.clone()),
        FileCommand::Load {
            name: name.clone(),
            content,
        },
        FileCommand::Delete(name),
    ])
}

proptest! {
    #![proptest_config(ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(1), failure_persistence: None, ..ProptestConfig::with_cases(512) })]

    #[test]
    fn any_bytes_are_an_answer_or_an_error(bytes in vec(any::<u8>(), 0..600), head in 0..3usize) {
        let mut bytes = bytes;
        if head > 0 && bytes.len() >= 32 {
            bytes[..6].copy_from_slice(b"YERC\x20\0");
            let size = (bytes.len() - 32) as u16;
            bytes[6..8].copy_from_slice(&size.to_le_bytes());
            bytes[9] = head as u8;
            bytes[10] = 1;
        }
        if let Ok(answer) = Answer::decode(&bytes) {
            prop_assert_eq!(&answer.data, &bytes[32..]);
            prop_assert!(answer.data.len() <= DATA_BYTES_MAX);
        }
        if let Ok(answer) = FileAnswer::decode(&bytes) {
            prop_assert_eq!(&answer.data, &bytes[32..]);
            prop_assert!(answer.data.len() <= DATA_BYTES_MAX);
        }
    }

    #[test]
    fn any_data_are_a_reply_or_an_error(command in command(), data in vec(any::<u8>(), 0..=479), length in 0..480usize, counted: bool) {
        let mut data = data;
        // Half the time, the length and the count that the command's answer has.
        if let (true, Command::Read { first, count }) = (counted, &command) {
            data.resize(4 + usize::from(*count) * row(first.kind).2, 0);
            data[..4].copy_from_slice(&u32::from(*count).to_le_bytes());
        } else {
            data.truncate(length);
        }
        let request = parsed(&request(&command, 1).unwrap().encode());
        let answer = Answer::decode(&answer(&request, &data)).unwrap();
        match reply(&command, &answer) {
            Ok(Reply::Values(values)) => {
                let Command::Read { first, count } = command else { panic!("values to {command:?}") };
                prop_assert_eq!((values.kind(), values.count()), (first.kind, usize::from(count)));
            }
            Ok(Reply::Signals(groups)) => prop_assert!(groups.len() <= data.len()),
            _ => {}
        }
    }

    #[test]
    fn values_that_are_written_are_read_back(values in values(), index: u16) {
        let written = parsed(&request(&write(&values, index), 1).unwrap().encode());
        let (one, many, width) = row(values.kind());
        let whole = values.kind() == VariableKind::Position;
        let (number, attribute, service) = match (values.count(), whole) {
            (1, true) => (one, 0, 0x02),
            (1, false) => (one, 1, 0x10),
            _ => (many, 0, 0x34),
        };
        prop_assert_eq!((written.command, written.instance), (number, index));
        prop_assert_eq!((written.attribute, written.service), (attribute, service));
        let prefix = if values.count() == 1 { 0 } else { 4 };
        prop_assert_eq!(written.data.len(), prefix + values.count() * width);
        // A controller answers a read with what was written.
        let read = read(&values, index);
        let asked = parsed(&request(&read, 2).unwrap().encode());
        prop_assert_eq!((asked.command, asked.instance), (number, index));
        let answer = Answer::decode(&answer(&asked, &written.data)).unwrap();
        prop_assert_eq!(reply(&read, &answer), Ok(Reply::Values(values)));
    }

    #[test]
    fn every_request_is_a_frame_that_says_the_command(command in command(), id: u8) {
        let said = parsed(&request(&command, id).unwrap().encode());
        prop_assert_eq!(said.id, id);
        let data = &said.data;
        let parts = (said.command, said.instance, said.attribute, said.service);
        match command {
            Command::Move(target) => {
                let words = words(data);
                prop_assert_eq!(parts, (0x8A, if target.path == Path::Link { 1 } else { 2 }, 1, 2));
                prop_assert_eq!((words.len(), words[0], words[1], words[4]), (26, 1, 0, 16));
                prop_assert_eq!(&words[5..8], &target.base_from_tool.position_um);
                prop_assert_eq!(&words[8..11], &target.base_from_tool.rotation_e4_deg);
                prop_assert_eq!(words[15], i32::from(target.tool));
                let rest = words.iter().enumerate().filter(|(at, _)| ![0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15].contains(at));
                prop_assert!(rest.into_iter().all(|(_, word)| *word == 0));
                prop_assert!(words[3] >= 0, "a speed is never negative");
            }
            Command::MovePulses(target) => {
                let words = words(data);
                prop_assert_eq!(parts, (0x8B, if target.path == Path::Link { 1 } else { 2 }, 1, 2));
                prop_assert_eq!((words.len(), words[0], words[1]), (22, 1, 0));
                prop_assert_eq!(&words[4..12], &target.pulses);
                prop_assert_eq!(words[12], i32::from(target.tool));
            }
            Command::SelectJob { job, line } => {
                prop_assert_eq!(parts, (0x87, 1, 0, 2));
                prop_assert_eq!(data.len(), 36);
                let name = String::from_utf8(data[..32].to_vec()).unwrap();
                prop_assert_eq!(name.trim_end_matches('\0'), job.as_str());
                prop_assert_eq!(words(&data[32..]), vec![line as i32]);
            }
            Command::ShowText(text) => {
                prop_assert_eq!((parts, data.len()), ((0x85, 1, 1, 0x10), 32));
                prop_assert_eq!(&data[..text.len()], text.as_bytes());
                prop_assert!(data[text.len()..].iter().all(|byte| *byte == 0));
            }
            Command::Order { variable, value } => {
                prop_assert_eq!(parts, (0x7C, variable, 1, 0x10));
                prop_assert_eq!(words(data), vec![value]);
            }
            Command::ReadSignals { first_group, count } => {
                prop_assert_eq!(parts, (0x300, first_group, 0, 0x33));
                prop_assert_eq!(words(data), vec![i32::from(count)]);
            }
            Command::WriteSignals { first_group, groups } => {
                prop_assert_eq!(parts, (0x78, first_group, 1, 0x10));
                prop_assert_eq!(data, &groups);
            }
            Command::Alarm(index) => prop_assert_eq!(parts, (0x70, u16::from(index) + 1, 0, 1)),
            Command::AlarmHistory { index, .. } => {
                prop_assert_eq!((parts.0, parts.1 % 1000), (0x71, u16::from(index) + 1));
            }
            _ => prop_assert!(data.len() <= DATA_BYTES_MAX),
        }
    }

    #[test]
    fn a_transfer_answers_a_datagram_with_one_at_most_and_keeps_its_bound(command in file_command(), frames in vec(file_frame(), 0..12)) {
        let settings = FileSettings { answer_timeout_ms: 100, attempts: 3 };
        let mut files = Files::new(settings);
        files.begin(Stamp::START, command).unwrap();
        prop_assert!(files.poll_output().is_some());
        let mut came = 0;
        for frame in &frames {
            came += frame.len();
            files.handle_datagram(Stamp::START, frame);
            if let Some(RobotOutput::Bytes { bytes, .. }) = files.poll_output() {
                prop_assert!((32..=511).contains(&bytes.len()));
            }
            prop_assert!(files.poll_output().is_none());
            if let Some(FileEvent::Saved { content, .. }) = files.poll_event() {
                prop_assert!(content.len() <= came);
            }
            prop_assert!(files.poll_event().is_none());
        }
    }
}
