use super::*;
use crate::vectors::{HSES_PAGE, all, vector};

fn parse(bytes: &[u8]) -> Result<Request, Malformed> {
    Request::parse(Port::Robot, bytes)
}

#[test]
fn every_robot_request_of_the_page_is_read() {
    let requests: Vec<_> = all(HSES_PAGE)
        .into_iter()
        .filter(|(name, bytes)| name.starts_with("req_") && bytes[9] == 1)
        .collect();
    assert!(requests.len() >= 11);
    for (name, bytes) in requests {
        let request = parse(&bytes).unwrap();
        assert_eq!(request.id, bytes[11], "{name}");
        assert_eq!(request.data, bytes[32..], "{name}");
    }
}

#[test]
fn the_move_of_the_page_has_its_fields() {
    let request = parse(&vector(HSES_PAGE, "req_move_base_50mm_s")).unwrap();
    assert_eq!(
        (request.command, request.instance, request.attribute, request.service),
        (0x8A, 2, 1, 2)
    );
    let words: [i32; 26] = words(&request.data).unwrap();
    assert_eq!(
        words[..11],
        [1, 0, 1, 500, 16, 500_000, -250_000, 750_000, 1_800_000, 0, -900_000]
    );
    assert_eq!(words[15], 1);
}

#[test]
fn every_damaged_header_byte_that_is_fixed_makes_it_malformed() {
    let good = vector(HSES_PAGE, "req_hold_on");
    let chosen_by_the_client = [11, 24, 25, 26, 27, 28, 29];
    for at in (0..32).filter(|at| !chosen_by_the_client.contains(at)) {
        let mut bad = good.clone();
        bad[at] ^= 0x40;
        assert!(parse(&bad).is_err(), "byte {at}");
    }
}

#[test]
fn a_cut_or_a_longer_datagram_is_malformed() {
    let mut bytes = vector(HSES_PAGE, "req_hold_on");
    for length in 0..bytes.len() {
        assert!(parse(&bytes[..length]).is_err(), "{length}");
    }
    bytes.push(0);
    assert_eq!(parse(&bytes), Err(Malformed::DataSize { stated: 4, found: 5 }));
}

#[test]
fn what_is_wrong_with_a_frame_has_the_code_of_the_sheet_or_no_answer() {
    let good = vector(HSES_PAGE, "req_hold_on");
    for (at, value, code) in [
        (0, b'X', Some(0xE4A6)),
        (4, 0x21, Some(0xE4A5)),
        (6, 5, Some(0xE4A7)),
        (7, 2, Some(0xE49E)),
        (8, 0x33, None),
        (9, 2, Some(0xE4A3)),
        (10, 1, Some(0xE4A2)),
        (12, 1, Some(0xE4A1)),
        (16, 0, None),
        (30, 1, None),
    ] {
        let mut bad = good.clone();
        bad[at] = value;
        let malformed = parse(&bad).unwrap_err();
        let answer = Request::answer_malformed(Port::Robot, &bad, malformed);
        let found = answer.map(|answer| {
            assert_eq!((answer[24], answer[25], answer[26]), (0x90, 0x1F, 1));
            u16_at(&answer, 28)
        });
        assert_eq!(found, code, "byte {at}");
    }
    let answer = vector(HSES_PAGE, "ans_set_ok");
    let malformed = parse(&answer).unwrap_err();
    assert_eq!(Request::answer_malformed(Port::Robot, &answer, malformed), None);
}

#[test]
fn errors_have_two_forms() {
    let request = parse(&vector(HSES_PAGE, "req_position")).unwrap();
    for (refusal, status, added) in [
        (Refusal::UndefinedCommand, 0x08, 0xA000_u16),
        (Refusal::InvalidAttribute, 0x09, 0xA002),
        (Refusal::NoInstance, 0x28, 0xA001),
    ] {
        let first = request.refused(refusal, false);
        assert_eq!((first[25], first[26], u16_at(&first, 28)), (status, 0, 0));
        let second = request.refused(refusal, true);
        assert_eq!((second[25], second[26], u16_at(&second, 28)), (0x1F, 1, added));
    }
}

#[test]
fn a_transfer_has_blocks_from_1_on_and_a_request_none() {
    // A client's acknowledgement of the last block of a list, as the sheet has it.
    let mut bytes = b"YERC\x20\0\0\0\x03\x02\x01\0\x01\0\0\x8099999999\0\0\0\0\0\x32\0\0".to_vec();
    let request = Request::parse(Port::File, &bytes).unwrap();
    assert!(request.is_continuation);
    assert_eq!((request.block, request.service), (LAST_BLOCK | 1, 0x32));
    bytes[12] = 0;
    assert_eq!(
        Request::parse(Port::File, &bytes),
        Err(Malformed::Field { field: FIELD_BLOCK })
    );
    bytes[10] = 0;
    assert!(Request::parse(Port::File, &bytes).is_err());
    bytes[15] = 0;
    assert!(!Request::parse(Port::File, &bytes).unwrap().is_continuation);
}
