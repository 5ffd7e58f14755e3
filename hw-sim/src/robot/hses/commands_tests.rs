use core::net::SocketAddr;

use rand::Rng;

use super::*;
use crate::draws::{Purpose, generator};
use crate::robot::controller::{Options, Panel, RobotOutput, Settings};
use crate::robot::hses::{Port, SERVICE_WRITE_PLURAL};
use crate::vectors::{HSES_PAGE, all, vector};

const SECOND_NS: u64 = 1_000_000_000;
const JOB: &str = "/JOB\r\n//NAME SCAN1\r\n//INST\r\nNOP\r\nTIMER T=10.0\r\nINC D001\r\nEND\r\n";

fn client() -> SocketAddr {
    ([127, 0, 0, 1], 4711).into()
}

/// A frame typed by hand from the sheet.
fn frame(command: u16, instance: u16, attribute: u8, service: u8, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"YERC\x20\0".to_vec();
    bytes.extend((data.len() as u16).to_le_bytes());
    bytes.extend(b"\x03\x01\0\x07\0\0\0\099999999");
    bytes.extend(command.to_le_bytes());
    bytes.extend(instance.to_le_bytes());
    bytes.extend([attribute, service, 0, 0]);
    bytes.extend(data);
    bytes
}

fn with(options: Options) -> Controller {
    let mut robot = Controller::new(Settings {
        jobs: vec![("SCAN1".to_owned(), JOB.to_owned())],
        options,
        ..Settings::default()
    });
    robot.set_servo(0, true).unwrap();
    robot
}

fn ready() -> Controller {
    with(Options::default())
}

/// Answer and how many violations were told.
fn send(robot: &mut Controller, now_ns: u64, bytes: &[u8]) -> (Vec<u8>, usize) {
    robot.handle_datagram(now_ns, Port::Robot, client(), bytes);
    let (mut answer, mut violation_count) = (None, 0);
    while let Some(output) = robot.poll_output() {
        match output {
            RobotOutput::Datagram { bytes, .. } => answer = Some(bytes),
            RobotOutput::Violation(_) => violation_count += 1,
        }
    }
    (answer.unwrap(), violation_count)
}

/// Data of an answer that is done; status, or the added status of 0x1F, of one that is refused.
fn ask(
    robot: &mut Controller,
    command: u16,
    instance: u16,
    attribute: u8,
    service: u8,
    data: &[u8],
) -> Result<Vec<u8>, u16> {
    ask_at(robot, 0, command, instance, attribute, service, data)
}

fn ask_at(
    robot: &mut Controller,
    now_ns: u64,
    command: u16,
    instance: u16,
    attribute: u8,
    service: u8,
    data: &[u8],
) -> Result<Vec<u8>, u16> {
    let (answer, _) = send(robot, now_ns, &frame(command, instance, attribute, service, data));
    assert_eq!((answer[11], answer[24]), (7, service | 0x80));
    match answer[25] {
        0 => Ok(answer[32..].to_vec()),
        0x1F => Err(u16::from_le_bytes([answer[28], answer[29]])),
        status => Err(u16::from(status)),
    }
}

fn bytes_of(words: &[i32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

#[test]
fn every_record_is_read_whole_and_by_attribute() {
    let mut robot = with(Options {
        has_alarm_sub_texts: true,
        ..Options::default()
    });
    robot.handle_panel(0, Panel::Alarm(4315));
    for (command, instance, attribute_count, byte_count) in [
        (0x70, 1, 5, 60),
        (0x70, 4, 5, 60),
        (0x71, 1, 5, 60),
        (0x71, 1001, 5, 60),
        (0x71, 4100, 5, 60),
        (0x72, 1, 2, 8),
        (0x73, 1, 4, 44),
        (0x74, 1, 8, 32),
        (0x74, 101, 8, 32),
        (0x75, 1, 13, 52),
        (0x75, 101, 13, 52),
        (0x76, 1, 8, 32),
        (0x77, 1, 8, 32),
        (0x78, 2701, 1, 1),
        (0x79, 999, 1, 2),
        (0x7A, 199, 1, 1),
        (0x7B, 199, 1, 2),
        (0x7C, 199, 1, 4),
        (0x7D, 199, 1, 4),
        (0x7E, 199, 1, 16),
        (0x88, 1, 2, 28),
        (0x88, 301, 2, 28),
        (0x89, 11, 3, 48),
        (0x30A, 1, 8, 268),
        (0x30B, 1001, 8, 268),
    ] {
        let whole = ask(&mut robot, command, instance, 0, SERVICE_GET_ALL, &[]).unwrap();
        assert_eq!(whole.len(), byte_count, "{command:#x} {instance}");
        let fields =
            (1..=attribute_count).map(|attribute| ask(&mut robot, command, instance, attribute, SERVICE_GET, &[]));
        assert_eq!(
            fields.map(Result::unwrap).collect::<Vec<_>>().concat(),
            whole,
            "{command:#x}"
        );
        let beyond = ask(&mut robot, command, instance, attribute_count + 1, SERVICE_GET, &[]);
        assert_eq!(beyond, Err(0x09), "{command:#x}");
        assert_eq!(ask(&mut robot, command, instance, 1, SERVICE_GET_ALL, &[]), Err(0x09));
        assert_eq!(
            ask(&mut robot, command, instance, 0, SERVICE_GET_ALL, &[0]),
            Err(0xB003)
        );
        assert_eq!(
            ask(&mut robot, command, instance, 0, 0x33, &[]),
            Err(0x08),
            "{command:#x}"
        );
    }
}

#[test]
fn instances_that_do_not_exist_have_their_status() {
    let mut robot = ready();
    for (command, instance) in [
        (0x70, 0),
        (0x70, 5),
        (0x71, 0),
        (0x71, 101),
        (0x71, 1000),
        (0x71, 5001),
        (0x72, 2),
        (0x73, 2),
        (0x74, 2),
        (0x75, 2),
        (0x75, 102),
        (0x76, 101),
        (0x77, 2),
        (0x79, 1000),
        (0x7A, 200),
        (0x88, 2),
        (0x89, 1),
    ] {
        assert_eq!(
            ask(&mut robot, command, instance, 0, SERVICE_GET_ALL, &[]),
            Err(0x28),
            "{command:#x} {instance}"
        );
    }
    // Of signals alone the sheet says 0x1F with A001.
    assert_eq!(ask(&mut robot, 0x78, 2957, 0, SERVICE_GET_ALL, &[]), Err(0xA001));
    for command in [0x6F, 0x8C, 0x8D, 0x30A, 0x30C, 0x411] {
        assert_eq!(
            ask(&mut robot, command, 1, 0, SERVICE_GET_ALL, &[]),
            Err(0x08),
            "{command:#x}"
        );
    }
}

#[test]
fn small_writes_have_two_widths_and_the_unusual_one_is_told() {
    let mut robot = ready();
    let four = |value: i32| value.to_le_bytes().to_vec();
    for (command, instance, native, four_bytes) in [
        (0x78, 2701, vec![200], four(200)),
        (0x79, 5, vec![0x34, 0x12], four(0x1234)),
        (0x7A, 7, vec![200], four(200)),
        (0x7B, 3, vec![0xFE, 0xFF], four(-2)),
    ] {
        for (data, expected_count) in [(&native, 0), (&four_bytes, 1)] {
            let zeros = vec![0; native.len()];
            ask(&mut robot, command, instance, 1, SERVICE_SET, &zeros).unwrap();
            let (answer, violation_count) = send(&mut robot, 0, &frame(command, instance, 1, SERVICE_SET, data));
            assert_eq!((answer[25], violation_count), (0, expected_count), "{command:#x}");
            assert_eq!(
                ask(&mut robot, command, instance, 1, SERVICE_GET, &[]),
                Ok(native.clone())
            );
        }
        let beyond = four(0x0001_0000);
        assert_eq!(
            ask(&mut robot, command, instance, 1, SERVICE_SET, &beyond),
            Err(0xB004),
            "{command:#x}"
        );
        assert_eq!(
            ask(&mut robot, command, instance, 1, SERVICE_SET, &[0; 3]),
            Err(0xB003),
            "{command:#x}"
        );
        assert_eq!(
            ask(&mut robot, command, instance, 0, SERVICE_SET_ALL, &native),
            Ok(Vec::new())
        );
    }
    assert_eq!(ask(&mut robot, 0x79, 560, 1, SERVICE_SET, &[0, 0]), Err(0x28));
    assert_eq!(ask(&mut robot, 0x78, 1, 1, SERVICE_SET, &[0]), Err(0xB002));
    assert_eq!(ask(&mut robot, 0x78, 5301, 1, SERVICE_SET, &[0]), Err(0xA001));
}

#[test]
fn wide_variables_are_written_and_read() {
    let mut robot = ready();
    let position = bytes_of(&[17, 4, 1, 0, 0, 100_000, -200_000, 300_000, 1_800_000, 0, 0, 0, 0]);
    assert_eq!(ask(&mut robot, 0x7F, 10, 0, SERVICE_GET_ALL, &[]), Err(0xB001));
    for (command, data) in [
        (0x7C, bytes_of(&[-123_456])),
        (0x7D, 1.5_f32.to_le_bytes().to_vec()),
        (0x7E, b"PART-0001\0\0\0\0\0\0\0".to_vec()),
        (0x7F, position),
        (0x80, bytes_of(&[16, 1, 2, 3, 4, 5, 6, 7, 8])),
        (0x81, bytes_of(&[0, 1, 2, 3, 4, 5, 6, 7, 8])),
    ] {
        assert_eq!(
            ask(&mut robot, command, 10, 0, SERVICE_SET_ALL, &data),
            Ok(Vec::new()),
            "{command:#x}"
        );
        assert_eq!(ask(&mut robot, command, 10, 0, SERVICE_GET_ALL, &[]), Ok(data.clone()));
        assert_eq!(
            ask(&mut robot, command, 10, 0, SERVICE_SET_ALL, &data[1..]),
            Err(0xB003),
            "{command:#x}"
        );
    }
    assert_eq!(
        ask(&mut robot, 0x80, 11, 3, SERVICE_SET, &bytes_of(&[7])),
        Ok(Vec::new())
    );
    assert_eq!(
        ask(&mut robot, 0x80, 11, 0, SERVICE_GET_ALL, &[]),
        Ok(bytes_of(&[0, 0, 7, 0, 0, 0, 0, 0, 0]))
    );
    // The manual has P variables whole only.
    assert_eq!(ask(&mut robot, 0x7F, 10, 1, SERVICE_GET, &[]), Err(0x08));
    assert_eq!(ask(&mut robot, 0x7F, 10, 1, SERVICE_SET, &[0; 4]), Err(0x08));
    let no_type = bytes_of(&[15, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(ask(&mut robot, 0x7F, 10, 0, SERVICE_SET_ALL, &no_type), Err(0xB007));
}

#[test]
fn texts_of_32_bytes_are_an_option() {
    let mut robot = with(Options {
        has_long_strings: true,
        ..Options::default()
    });
    let data = b"PART-0001 OF A LONG NAME\0\0\0\0\0\0\0\0";
    assert_eq!(ask(&mut robot, 0x8C, 1, 1, SERVICE_SET, data), Ok(Vec::new()));
    assert_eq!(ask(&mut robot, 0x8C, 1, 1, SERVICE_GET, &[]), Ok(data.to_vec()));
    assert_eq!(ask(&mut robot, 0x7E, 1, 1, SERVICE_GET, &[]), Ok(data[..16].to_vec()));
    let plural = ask(&mut robot, 0x30C, 0, 0, SERVICE_READ_PLURAL, &bytes_of(&[14])).unwrap();
    assert_eq!(plural.len(), 4 + 14 * 32);
}

#[test]
fn plurals_are_written_and_read_up_to_what_a_datagram_holds() {
    let mut robot = ready();
    for (command, first, byte_count, count_max) in [
        (0x300, 2701, 1, 256),
        (0x301, 0, 2, 237),
        (0x302, 0, 1, 200),
        (0x303, 0, 2, 200),
        (0x304, 100, 4, 100),
        (0x305, 0, 4, 118),
        (0x306, 0, 16, 29),
        (0x307, 0, 52, 9),
        (0x308, 0, 36, 13),
        (0x309, 0, 36, 13),
    ] {
        let mut data = bytes_of(&[count_max]);
        for index in 0..count_max {
            let mut element = vec![0; byte_count];
            element[byte_count - 1] = (index % 2) as u8;
            if byte_count > 16 {
                element[byte_count - 1] = 0;
                element[4 * 7] = index as u8;
            }
            data.extend(element);
        }
        let written = ask(&mut robot, command, first, 0, SERVICE_WRITE_PLURAL, &data);
        assert_eq!(written, Ok(Vec::new()), "{command:#x}");
        let read = ask(
            &mut robot,
            command,
            first,
            0,
            SERVICE_READ_PLURAL,
            &bytes_of(&[count_max]),
        );
        assert_eq!(read, Ok(data.clone()), "{command:#x}");
        let cut = ask(
            &mut robot,
            command,
            first,
            0,
            SERVICE_WRITE_PLURAL,
            &data[..data.len() - 1],
        );
        assert_eq!(cut, Err(0xB003), "{command:#x}");
        for (count, code) in [(0, 0xB004), (475, 0xB004), (-1, 0xB004)] {
            let refused = ask(&mut robot, command, first, 0, SERVICE_READ_PLURAL, &bytes_of(&[count]));
            assert_eq!(refused, Err(code), "{command:#x} {count}");
        }
        assert_eq!(
            ask(&mut robot, command, first, 1, SERVICE_READ_PLURAL, &bytes_of(&[2])),
            Err(0x09)
        );
        assert_eq!(
            ask(&mut robot, command, first, 0, SERVICE_GET_ALL, &bytes_of(&[2])),
            Err(0x08)
        );
    }
    assert_eq!(
        ask(&mut robot, 0x302, 0, 0, SERVICE_READ_PLURAL, &bytes_of(&[3])),
        Err(0xB004)
    );
    assert_eq!(
        ask(&mut robot, 0x304, 199, 0, SERVICE_READ_PLURAL, &bytes_of(&[2])),
        Err(0x28)
    );
    assert_eq!(
        ask(&mut robot, 0x304, 65_535, 0, SERVICE_READ_PLURAL, &bytes_of(&[1])),
        Err(0x28)
    );
    assert_eq!(
        ask(&mut robot, 0x300, 2956, 0, SERVICE_READ_PLURAL, &bytes_of(&[2])),
        Err(0xA001)
    );
    assert_eq!(
        ask(&mut robot, 0x300, 1, 0, SERVICE_WRITE_PLURAL, &[2, 0, 0, 0, 1, 1]),
        Err(0xB002)
    );
}

#[test]
fn a_plural_write_with_one_wrong_element_writes_none() {
    let mut robot = ready();
    let mut data = bytes_of(&[2]);
    data.extend(1.0_f32.to_le_bytes());
    data.extend(f32::NAN.to_le_bytes());
    assert_eq!(ask(&mut robot, 0x305, 0, 0, SERVICE_WRITE_PLURAL, &data), Err(0xB004));
    assert_eq!(ask(&mut robot, 0x7D, 0, 1, SERVICE_GET, &[]), Ok(vec![0; 4]));
    let over_the_end = bytes_of(&[2, 5, 6]);
    assert_eq!(
        ask(&mut robot, 0x304, 199, 0, SERVICE_WRITE_PLURAL, &over_the_end),
        Err(0x28)
    );
    assert_eq!(ask(&mut robot, 0x7C, 199, 1, SERVICE_GET, &[]), Ok(vec![0; 4]));
}

#[test]
fn a_job_is_selected_started_watched_and_held() {
    let mut robot = ready();
    let mut select = b"SCAN1".to_vec();
    select.resize(36, 0);
    assert_eq!(ask(&mut robot, 0x86, 1, 1, SERVICE_SET, &bytes_of(&[1])), Err(0x4060));
    assert_eq!(ask(&mut robot, 0x87, 1, 0, SERVICE_SET_ALL, &select), Ok(Vec::new()));
    assert_eq!(ask(&mut robot, 0x87, 10, 0, SERVICE_SET_ALL, &select), Ok(Vec::new()));
    assert_eq!(robot.master_job(0, 0), Ok(Some("SCAN1".to_owned())));
    assert_eq!(
        ask(&mut robot, 0x84, 2, 1, SERVICE_SET, &bytes_of(&[2])),
        Ok(Vec::new())
    );
    assert_eq!(
        ask(&mut robot, 0x86, 1, 1, SERVICE_SET, &bytes_of(&[1])),
        Ok(Vec::new())
    );
    let watched = ask_at(&mut robot, SECOND_NS, 0x73, 1, 0, SERVICE_GET_ALL, &[]).unwrap();
    let mut expected = b"SCAN1".to_vec();
    expected.resize(32, 0);
    expected.extend(bytes_of(&[1, 0, 10_000]));
    assert_eq!(watched, expected);
    let status = ask_at(&mut robot, SECOND_NS, 0x72, 1, 0, SERVICE_GET_ALL, &[]);
    assert_eq!(status, Ok(bytes_of(&[0xCA, 0x40])));
    let done = ask_at(&mut robot, 20 * SECOND_NS, 0x7C, 1, 1, SERVICE_GET, &[]);
    assert_eq!(done, Ok(bytes_of(&[1])));
    let status = ask_at(&mut robot, 20 * SECOND_NS, 0x72, 1, 1, SERVICE_GET, &[]);
    assert_eq!(status, Ok(bytes_of(&[0xC2])));
    for (instance, line, code) in [
        (1, 4, 0xB004),
        (1, 10_000, 0xB004),
        (1, -1, 0xB004),
        (2, 0, 0x28),
        (26, 0, 0x28),
    ] {
        let mut select = select[..32].to_vec();
        select.extend(bytes_of(&[line]));
        let refused = ask_at(&mut robot, 20 * SECOND_NS, 0x87, instance, 0, SERVICE_SET_ALL, &select);
        assert_eq!(refused, Err(code), "{instance} {line}");
    }
}

#[test]
fn orders_have_their_values_and_attributes() {
    let mut robot = ready();
    for (command, instance, largest) in [
        (0x82, 1, 1),
        (0x82, 2, 1),
        (0x83, 1, 2),
        (0x83, 2, 2),
        (0x83, 3, 2),
        (0x84, 2, 3),
    ] {
        for (value, is_done) in [(0, false), (1, true), (largest, true), (largest + 1, false)] {
            let answer = ask(&mut robot, command, instance, 1, SERVICE_SET, &bytes_of(&[value]));
            assert_eq!(
                answer,
                if is_done { Ok(Vec::new()) } else { Err(0xB004) },
                "{command:#x} {value}"
            );
        }
        assert_eq!(
            ask(&mut robot, command, instance, 0, SERVICE_SET, &bytes_of(&[1])),
            Err(0x09)
        );
        assert_eq!(ask(&mut robot, command, instance, 1, SERVICE_GET, &[]), Err(0x08));
        assert_eq!(ask(&mut robot, command, 9, 1, SERVICE_SET, &bytes_of(&[1])), Err(0x28));
        assert_eq!(ask(&mut robot, command, instance, 1, SERVICE_SET, &[1]), Err(0xB003));
    }
    let mut shown = b"SCAN".to_vec();
    shown.resize(32, 0);
    assert_eq!(ask(&mut robot, 0x85, 1, 1, SERVICE_SET, &shown), Ok(Vec::new()));
    assert_eq!(robot.pendant_text(), b"SCAN");
    assert_eq!(ask(&mut robot, 0x85, 1, 1, SERVICE_SET, &[b'A'; 31]), Err(0xB003));
    assert_eq!(ask(&mut robot, 0x85, 1, 1, SERVICE_SET, &[b'A'; 32]), Err(0xB004));
}

#[test]
fn a_frame_with_a_wrong_field_is_told_and_answered_with_its_code() {
    let mut robot = ready();
    let mut bad = vector(HSES_PAGE, "req_hold_on");
    bad[9] = 2;
    let (answer, violation_count) = send(&mut robot, 0, &bad);
    assert_eq!(
        (answer[25], answer[28], answer[29], violation_count),
        (0x1F, 0xA3, 0xE4, 1)
    );
    assert_eq!(robot.status(0)[1] & 8, 0);
}

#[test]
fn the_other_form_of_errors_is_an_option() {
    let mut robot = with(Options {
        errors_in_added_status: true,
        ..Options::default()
    });
    assert_eq!(ask(&mut robot, 0x6F, 1, 0, SERVICE_GET_ALL, &[]), Err(0xA000));
    assert_eq!(ask(&mut robot, 0x72, 9, 0, SERVICE_GET_ALL, &[]), Err(0xA001));
    assert_eq!(ask(&mut robot, 0x72, 1, 7, SERVICE_GET_ALL, &[]), Err(0xA002));
}

#[test]
fn every_robot_request_of_the_page_is_one_that_the_controller_has() {
    let of_robot = |(name, bytes): &(String, Vec<u8>)| name.starts_with("req_") && bytes[9] == 1;
    for (name, bytes) in all(HSES_PAGE).into_iter().filter(of_robot) {
        let mut robot = with(Options {
            has_long_strings: true,
            has_alarm_sub_texts: true,
            ..Options::default()
        });
        let (answer, violation_count) = send(&mut robot, 0, &bytes);
        assert!(
            !matches!(answer[25], 0x08 | 0x09 | 0x28),
            "{name}: status {:#x}",
            answer[25]
        );
        assert_eq!(violation_count, 0, "{name}");
    }
}

#[test]
fn no_bytes_bring_the_controller_down_or_make_it_grow() {
    let mut rng = generator(1, Purpose::Test, 1, 0);
    let mut robot = with(Options {
        has_long_strings: true,
        has_alarm_sub_texts: true,
        ..Options::default()
    });
    let mut now_ns = 0;
    for round in 0..100_000 {
        let mut draw = || rng.next_u32();
        let port = if draw() % 3 == 0 { Port::File } else { Port::Robot };
        let mut data = vec![0; draw() as usize % 120];
        // Small words, so that counts and codes are often in range.
        data.iter_mut().for_each(|byte| {
            *byte = if draw() % 2 == 0 {
                (draw() % 4) as u8
            } else {
                draw() as u8
            }
        });
        let command = [0x70 + draw() % 30, 0x300 + draw() % 14, draw() % 65_536][draw() as usize % 3] as u16;
        let instance = [draw() % 130, draw() % 6000, 2700 + draw() % 20][draw() as usize % 3] as u16;
        let service = [1, 2, 0x0E, 0x10, 0x33, 0x34, 9, 0x15, 0x16, 0x32, draw() as u8][draw() as usize % 11];
        let mut bytes = frame(command, instance, (draw() % 4) as u8, service, &data);
        if port == Port::File {
            (bytes[9], bytes[10], bytes[12]) = (2, (draw() % 2) as u8, (draw() % 3) as u8);
            if draw() % 2 == 0 {
                bytes[24..29].fill(0);
            }
            bytes[15] = if draw() % 2 == 0 { 0x80 } else { 0 };
        }
        if draw() % 4 == 0 {
            let at = draw() as usize % bytes.len();
            bytes[at] ^= 1 << (draw() % 8);
        }
        bytes.truncate(if draw() % 8 == 0 {
            draw() as usize % (bytes.len() + 1)
        } else {
            bytes.len()
        });
        now_ns += u64::from(draw() % 5_000_000);
        robot.handle_datagram(now_ns, port, client(), &bytes);
        let mut output_count = 0;
        while let Some(output) = robot.poll_output() {
            output_count += 1;
            if let RobotOutput::Datagram { bytes, .. } = output {
                assert!(bytes.len() <= 511, "round {round}");
                assert_eq!(usize::from(u16::from_le_bytes([bytes[6], bytes[7]])), bytes.len() - 32);
            }
        }
        assert!(output_count <= 4, "round {round}");
    }
    assert!(robot.job_names().len() <= 1000);
}

#[path = "moves_tests.rs"]
mod moves;
