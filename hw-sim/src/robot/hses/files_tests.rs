use rand::Rng;

use super::*;
use crate::draws::{Purpose, generator, uniform};
use crate::robot::controller::{Panel, RobotOutput, Settings};
use crate::robot::hses::Port;

const SECOND_NS: u64 = 1_000_000_000;
const JOB: &str = "/JOB\r\n//NAME SCAN1\r\n//INST\r\nNOP\r\nEND\r\n";

fn client(port: u16) -> SocketAddr {
    ([127, 0, 0, 1], port).into()
}

/// A frame typed by hand from the sheet.
fn frame(ack: u8, id: u8, block: u32, service: u8, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"YERC\x20\0".to_vec();
    bytes.extend((data.len() as u16).to_le_bytes());
    bytes.extend([3, 2, ack, id]);
    bytes.extend(block.to_le_bytes());
    bytes.extend(b"99999999\0\0\0\0\0");
    bytes.extend([service, 0, 0]);
    bytes.extend(data);
    bytes
}

fn request(service: u8, name: &str) -> Vec<u8> {
    frame(0, 1, 0, service, name.as_bytes())
}

fn robot(faults: &[&str]) -> Controller {
    Controller::new(Settings {
        faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        ..Settings::default()
    })
}

/// Answer to a frame and whether a violation was told.
fn ask(robot: &mut Controller, now_ns: u64, bytes: &[u8]) -> (Option<Vec<u8>>, bool) {
    robot.handle_datagram(now_ns, Port::File, client(1), bytes);
    drain(robot)
}

fn drain(robot: &mut Controller) -> (Option<Vec<u8>>, bool) {
    let (mut answer, mut is_violation) = (None, false);
    while let Some(output) = robot.poll_output() {
        match output {
            RobotOutput::Datagram { port, bytes, .. } => {
                assert_eq!(port, Port::File);
                assert_eq!(answer, None);
                answer = Some(bytes);
            }
            RobotOutput::Violation(_) => is_violation = true,
        }
    }
    (answer, is_violation)
}

/// Added status of an answer, 0 for one that is done.
fn added(answer: &[u8]) -> u16 {
    assert_eq!((answer[9], answer[10]), (2, 1));
    match answer[25] {
        0 => 0,
        0x1F => u16::from_le_bytes([answer[28], answer[29]]),
        status => panic!("{status:#x}"),
    }
}

fn block(answer: &[u8]) -> u32 {
    u32::from_le_bytes(answer[12..16].try_into().unwrap())
}

fn refusal(robot: &mut Controller, bytes: &[u8]) -> u16 {
    added(&ask(robot, 0, bytes).0.unwrap())
}

/// Puts a file over a network that loses and doubles datagrams, each side's with these chances. The client says its last
/// word again until it is answered.
fn put(
    robot: &mut Controller,
    name: &str,
    text: &[u8],
    mut is_lost: impl FnMut() -> bool,
    mut is_doubled: impl FnMut() -> bool,
) -> u16 {
    let chunks: Vec<&[u8]> = text.chunks(400).collect();
    let mut frames = vec![request(SERVICE_LOAD, name)];
    for (index, chunk) in chunks.iter().enumerate() {
        let last = if index + 1 == chunks.len() { LAST_BLOCK } else { 0 };
        frames.push(frame(1, 1, (index as u32 + 1) | last, SERVICE_LOAD, chunk));
    }
    for (index, bytes) in frames.iter().enumerate() {
        let answer = (0..100).find_map(|_| {
            let mut answer = None;
            for _ in 0..=usize::from(is_doubled()) {
                if !is_lost() {
                    let (found, is_violation) = ask(robot, 0, bytes);
                    assert!(!is_violation);
                    answer = found.filter(|_| !is_lost());
                }
            }
            answer
        });
        let answer = answer.expect("answered at last");
        assert_eq!(block(&answer) & !LAST_BLOCK, index as u32);
        if added(&answer) != 0 {
            return added(&answer);
        }
    }
    0
}

/// Gets a file or a list over such a network.
fn get(
    robot: &mut Controller,
    first: &[u8],
    mut is_lost: impl FnMut() -> bool,
    mut is_doubled: impl FnMut() -> bool,
) -> Vec<u8> {
    let (mut word, mut text, mut expected) = (first.to_vec(), Vec::new(), 1);
    let service = first[29];
    for _ in 0..10_000 {
        for _ in 0..=usize::from(is_doubled()) {
            if is_lost() {
                continue;
            }
            let (answer, is_violation) = ask(robot, 0, &word);
            assert!(!is_violation);
            let Some(answer) = answer.filter(|_| !is_lost()) else {
                continue;
            };
            assert_eq!(added(&answer), 0);
            if block(&answer) & !LAST_BLOCK == expected {
                text.extend_from_slice(&answer[32..]);
                word = frame(1, 1, block(&answer), service, &[]);
                if block(&answer) & LAST_BLOCK != 0 {
                    ask(robot, 0, &word);
                    return text;
                }
                expected += 1;
            }
        }
    }
    panic!("no end");
}

fn never() -> bool {
    false
}

/// A job of about this many bytes.
fn long_job(name: &str, byte_count: usize) -> String {
    let lines = "'A COMMENT OF SOME LENGTH\r\n".repeat(byte_count / 27);
    format!("/JOB\r\n//NAME {name}\r\n//INST\r\nNOP\r\n{lines}END\r\n")
}

#[test]
fn the_transfers_of_the_sheet_are_answered_byte_for_byte() {
    let mut robot = robot(&[]);
    let ready = b"YERC\x20\0\0\0\x03\x02\x01\x01\0\0\0\099999999\x95\0\0\0\0\0\0\0".to_vec();
    assert_eq!(ask(&mut robot, 0, &request(0x15, "SCAN1.JBI")), (Some(ready), false));
    let taken = b"YERC\x20\0\0\0\x03\x02\x01\x01\x01\0\0\x8099999999\x95\0\0\0\0\0\0\0".to_vec();
    let block = frame(1, 1, LAST_BLOCK | 1, 0x15, JOB.as_bytes());
    assert_eq!(ask(&mut robot, 0, &block), (Some(taken), false));
    let mut list = b"YERC\x20\0\x1a\0\x03\x02\x01\x01\x01\0\0\x8099999999\xb2\0\0\0\0\0\0\0".to_vec();
    list.extend(b"SCAN1.JBI\r\nSIMULATED.JBI\r\n");
    assert_eq!(ask(&mut robot, 0, &request(0x32, "*.JBI")), (Some(list), false));
    assert_eq!(
        ask(&mut robot, 0, &frame(1, 1, LAST_BLOCK | 1, 0x32, &[])),
        (None, false)
    );
    let deleted = b"YERC\x20\0\0\0\x03\x02\x01\x01\0\0\0\099999999\x89\0\0\0\0\0\0\0".to_vec();
    assert_eq!(ask(&mut robot, 0, &request(0x09, "SCAN1.JBI")), (Some(deleted), false));
    let gone = b"YERC\x20\0\0\0\x03\x02\x01\x01\0\0\0\099999999\x96\x1f\x01\0\xb3\xe2\0\0".to_vec();
    assert_eq!(ask(&mut robot, 0, &request(0x16, "SCAN1.JBI")), (Some(gone), false));
}

#[test]
fn a_file_of_many_blocks_goes_both_ways_and_stays_itself() {
    let mut robot = robot(&[]);
    let text = long_job("BIG", 20_000);
    assert_eq!(put(&mut robot, "BIG.JBI", text.as_bytes(), never, never), 0);
    assert_eq!(
        get(&mut robot, &request(SERVICE_SAVE, "BIG.JBI"), never, never),
        text.as_bytes()
    );
    // A multiple of the block, and one block exactly.
    for byte_count in [479, 958] {
        let text = vec![b'A'; byte_count];
        assert_eq!(put(&mut robot, "A.DAT", &text, never, never), 0);
        assert_eq!(get(&mut robot, &request(SERVICE_SAVE, "A.DAT"), never, never), text);
    }
}

#[test]
fn lost_and_doubled_blocks_change_nothing_in_what_is_transferred() {
    for seed in 0..40 {
        let mut rng = generator(seed, Purpose::Test, 0, 0);
        let mut robot = robot(&[]);
        let name = format!("J{seed}");
        let text = long_job(&name, 500 + rng.next_u32() as usize % 5000);
        let chance = std::cell::RefCell::new(rng);
        let drawn = |share: f64| uniform(&mut chance.borrow_mut()) < share;
        let file = format!("{name}.JBI");
        assert_eq!(put(&mut robot, &file, text.as_bytes(), || drawn(0.2), || drawn(0.2)), 0);
        let got = get(&mut robot, &request(SERVICE_SAVE, &file), || drawn(0.2), || drawn(0.2));
        assert_eq!(got, text.as_bytes(), "seed {seed}");
    }
}

#[test]
fn a_transfer_without_remote_or_of_a_wrong_name_is_refused() {
    let mut robot = robot(&[]);
    for (service, name, code) in [
        (SERVICE_SAVE, "NONE.JBI", 0xE2B3),
        (SERVICE_DELETE, "NONE.JBI", 0xE2B3),
        (SERVICE_DELETE, "SIMULATED.JBI", 0xE2AF),
        (SERVICE_LOAD, "SIMULATED.JBI", 0xE28C),
        (SERVICE_SAVE, "NONE", 0xE2A0),
        (SERVICE_SAVE, "A/B.JBI", 0xE2A0),
        (SERVICE_SAVE, "NONE.JBI\0", 0xE2A0),
        (SERVICE_LIST, "*.EXE", 0xE2A0),
        (SERVICE_LIST, "*.DAT", 0xE29C),
        (SERVICE_SAVE, "", 0xE49D),
        (SERVICE_SAVE, "ABCDEFGHIJABCDEFGHIJABCDEFGHIJABCDEFGHIJ.JBI", 0xE2B4),
    ] {
        assert_eq!(
            refusal(&mut robot, &request(service, name)),
            code,
            "{service:#x} {name:?}"
        );
    }
    let answer = ask(&mut robot, 0, &request(0x77, "A.JBI")).0.unwrap();
    assert_eq!(answer[25], 0x08);
    robot.handle_panel(0, Panel::Remote(false));
    for service in [SERVICE_SAVE, SERVICE_LOAD, SERVICE_DELETE] {
        assert_eq!(refusal(&mut robot, &request(service, "SIMULATED.JBI")), 0xE2B2);
    }
}

#[test]
fn a_text_that_is_no_job_is_refused_at_its_last_block_and_told_with_its_line() {
    let mut robot = robot(&[]);
    ask(&mut robot, 0, &request(SERVICE_LOAD, "SCAN1.JBI"));
    let text = JOB.replace("NOP\r\n", "NOP\r\nFLY\r\n");
    robot.handle_datagram(
        0,
        Port::File,
        client(1),
        &frame(1, 1, LAST_BLOCK | 1, SERVICE_LOAD, text.as_bytes()),
    );
    let Some(RobotOutput::Violation(told)) = robot.poll_output() else {
        panic!()
    };
    assert!(told.contains("SCAN1.JBI") && told.contains("line 5"), "{told}");
    assert_eq!(added(&drain(&mut robot).0.unwrap()), 0x5110);
    assert_eq!(robot.job_names(), ["SIMULATED"]);
}

#[test]
fn a_running_job_bars_loading_and_deleting_jobs_alone() {
    let mut robot = robot(&[]);
    let text = JOB.replace("NOP\r\n", "NOP\r\nTIMER T=100.0\r\n");
    assert_eq!(put(&mut robot, "SCAN1.JBI", text.as_bytes(), never, never), 0);
    robot.set_servo(0, true).unwrap();
    robot.start(0, Some("SCAN1")).unwrap();
    assert_eq!(refusal(&mut robot, &request(SERVICE_LOAD, "SCAN1.JBI")), 0x2010);
    assert_eq!(refusal(&mut robot, &request(SERVICE_DELETE, "SCAN1.JBI")), 0x2010);
    assert_eq!(put(&mut robot, "A.DAT", b"1\r\n", never, never), 0);
    assert_eq!(
        get(&mut robot, &request(SERVICE_SAVE, "SCAN1.JBI"), never, never),
        text.as_bytes()
    );
}

#[test]
fn a_silent_client_loses_its_transfer_and_is_told() {
    let mut robot = robot(&[]);
    ask(&mut robot, 0, &request(SERVICE_LOAD, "SCAN1.JBI"));
    let due_ns = robot.wake_at().unwrap();
    assert_eq!(due_ns, 10 * SECOND_NS);
    robot.handle_wake(due_ns - 1);
    assert_eq!(drain(&mut robot), (None, false));
    robot.handle_wake(due_ns);
    assert_eq!(added(&drain(&mut robot).0.unwrap()), 0xE28B);
    assert_eq!(robot.wake_at(), None);
    let late = ask(
        &mut robot,
        due_ns,
        &frame(1, 1, LAST_BLOCK | 1, SERVICE_LOAD, JOB.as_bytes()),
    );
    assert_eq!((added(&late.0.unwrap()), late.1), (0xE4A2, true));
}

#[test]
fn another_client_waits_for_the_end_of_a_transfer() {
    let mut robot = robot(&[]);
    ask(&mut robot, 0, &request(SERVICE_LOAD, "SCAN1.JBI"));
    robot.handle_datagram(0, Port::File, client(2), &request(SERVICE_LIST, "*.JBI"));
    assert_eq!(added(&drain(&mut robot).0.unwrap()), 0x2090);
    assert_eq!(
        block(&ask(&mut robot, 0, &request(SERVICE_LIST, "*.JBI")).0.unwrap()),
        LAST_BLOCK | 1
    );
}

#[test]
fn a_block_out_of_turn_ends_the_transfer() {
    let mut robot = robot(&[]);
    ask(&mut robot, 0, &request(SERVICE_LOAD, "SCAN1.JBI"));
    let (answer, is_violation) = ask(&mut robot, 0, &frame(1, 1, 3, SERVICE_LOAD, b"X"));
    assert_eq!((added(&answer.unwrap()), is_violation), (0xE4A1, true));
    assert_eq!(robot.wake_at(), None);
}

#[test]
fn a_block_that_is_kept_back_comes_when_asked_for_again() {
    let mut robot = robot(&["file-stall@2"]);
    let text = long_job("BIG", 2000);
    let mut asked = 0;
    let mut count = || {
        asked += 1;
        false
    };
    assert_eq!(put(&mut robot, "BIG.JBI", text.as_bytes(), &mut count, never), 0);
    assert_eq!(
        get(&mut robot, &request(SERVICE_SAVE, "BIG.JBI"), never, never),
        text.as_bytes()
    );
    // A request and six blocks, each once there and once back, and one word said twice.
    assert_eq!(asked, 2 * (1 + text.len().div_ceil(400)) + 1);
}

#[test]
fn an_acknowledgement_without_the_mark_of_the_last_block_ends_a_transfer_too() {
    let mut robot = robot(&[]);
    ask(&mut robot, 0, &request(SERVICE_LIST, "*.JBI"));
    assert_eq!(ask(&mut robot, 0, &frame(1, 1, 1, SERVICE_LIST, &[])), (None, false));
    assert_eq!(robot.wake_at(), None);
    assert_eq!(ask(&mut robot, 0, &frame(1, 1, 1, SERVICE_LIST, &[])), (None, false));
}
