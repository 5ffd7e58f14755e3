//! Section 2: what is wrong with a frame is found, in the order of the page, and ends the connection.

use super::bench::{Bench, is_error, require};
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::LineId;
use crate::camera::message::{Bye, CameraState, ClientMessage};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Nothing,
        "2-magic",
        "a frame that does not begin with A3DP is a protocol error: ERROR 101, BYE 3, close",
        "GET_STATUS with the magic B3DP",
        |bench| bad_header(bench, 101, |header| header[0] = b'B'),
    ),
    clause(
        Needs::Nothing,
        "2-header-crc",
        "a header whose CRC does not agree: ERROR 102, BYE 3, close",
        "GET_STATUS with one bit of the header CRC changed",
        |bench| bad_frame(bench, 102, |bytes| bytes[28] ^= 1),
    ),
    clause(
        Needs::Nothing,
        "2-major",
        "another major version in a header: ERROR 105, BYE 3, close",
        "GET_STATUS with major 2 in the header",
        |bench| bad_header(bench, 105, |header| header[4] = 2),
    ),
    clause(
        Needs::Nothing,
        "2-header-len",
        "another header length: ERROR 108, BYE 3, close",
        "GET_STATUS with header_len 36",
        |bench| bad_header(bench, 108, |header| header[5] = 36),
    ),
    clause(
        Needs::Nothing,
        "2-reserved",
        "reserved bytes of a header that are not 0: ERROR 109, BYE 3, close",
        "GET_STATUS with byte 22 set",
        |bench| bad_header(bench, 109, |header| header[22] = 1),
    ),
    clause(
        Needs::Nothing,
        "2-unknown-flag",
        "an unknown flag bit: ERROR 109, BYE 3, close",
        "GET_STATUS with flag bit 3",
        |bench| bad_header(bench, 109, |header| header[20] = 8),
    ),
    clause(
        Needs::Nothing,
        "2-oversize",
        "a payload of more than 65,536 bytes: ERROR 104, BYE 3, close, before the payload comes",
        "the header of a GET_STATUS that announces 65,537 bytes, and nothing after it",
        |bench| {
            bad_header(bench, 104, |header| {
                header[8..12].copy_from_slice(&65_537u32.to_le_bytes());
            })
        },
    ),
    clause(
        Needs::Nothing,
        "2-sequence-skip",
        "a sequence number that was skipped: ERROR 107, BYE 3, close",
        "GET_STATUS with a sequence number one too high",
        |bench| bad_header(bench, 107, |header| header[16] += 1),
    ),
    clause(
        Needs::Nothing,
        "2-sequence-repeat",
        "a sequence number that comes twice: ERROR 107, BYE 3, close",
        "GET_STATUS with a sequence number one too low",
        |bench| bad_header(bench, 107, |header| header[16] -= 1),
    ),
    clause(
        Needs::Nothing,
        "2-sequence-first",
        "the first frame of a connection has sequence number 0",
        "HELLO with sequence number 1",
        first_sequence,
    ),
    clause(
        Needs::Nothing,
        "2-payload-crc",
        "a payload whose CRC does not agree: ERROR 103, BYE 3, close",
        "PING with one bit of its payload changed",
        |bench| {
            let line = bench.controller()?;
            let (mut bytes, _) = bench.lines.frame(line, &ClientMessage::Ping { sender_ns: 1 });
            bytes[33] ^= 1;
            bench.lines.send(line, bytes);
            is_thrown_out(bench, line, 103)
        },
    ),
    clause(
        Needs::Nothing,
        "2-order",
        "of several mistakes the first in the page's order counts: magic, header CRC, version, length, reserved, size, sequence",
        "headers with every later mistake beside the one that must be named",
        order,
    ),
    clause(
        Needs::Nothing,
        "2-pieces",
        "frames may come in any pieces of the stream",
        "GET_STATUS byte by byte, then two GET_STATUS in one piece",
        pieces,
    ),
    clause(
        Needs::Nothing,
        "2-payload-short",
        "a payload shorter than its fields is malformed: ERROR 108, BYE 3, close",
        "PING with 7 bytes",
        |bench| malformed(bench, 0x60, REQUEST_ID, 0, &[0; 7]),
    ),
    clause(
        Needs::Nothing,
        "2-payload-long",
        "a payload longer than its fields is malformed: ERROR 108, BYE 3, close",
        "PING with 9 bytes",
        |bench| malformed(bench, 0x60, REQUEST_ID, 0, &[0; 9]),
    ),
    clause(
        Needs::Nothing,
        "2-payload-reserved",
        "reserved bytes of a payload are 0: ERROR 108 or 109, BYE 3, close",
        "ARM with a reserved byte set",
        |bench| {
            let line = bench.controller()?;
            let frame = bench
                .lines
                .raw_frame(line, 0x12, REQUEST_ID, 0, &[1, 1, 0, 0, 1, 0, 0, 0]);
            bench.lines.send(line, frame);
            let heard = bench
                .lines
                .reply(line, REQUEST_ID, "ERROR 108 or 109", super::bench::REPLY_MS)?;
            is_error(&heard, 109).or_else(|_| is_error(&heard, 108))?;
            is_closed(bench, line)
        },
    ),
    clause(
        Needs::Nothing,
        "3.6-flags",
        "flags that do not fit the type: ERROR 108, BYE 3, close",
        "GET_STATUS with the reply flag",
        |bench| malformed(bench, 0x50, REQUEST_ID, 1, &[]),
    ),
    clause(
        Needs::Nothing,
        "3.6-request-0",
        "request id 0 on a request: ERROR 108, BYE 3, close",
        "GET_STATUS with request id 0",
        |bench| malformed(bench, 0x50, 0, 0, &[]),
    ),
    clause(
        Needs::Nothing,
        "3.6-survives",
        "a connection that breaks the protocol is ended alone: others go on",
        "an observer sends a bad magic while a controller is connected",
        |bench| {
            let controller = bench.controller()?;
            let observer = bench.observer()?;
            let (mut bytes, _) = bench.lines.frame(observer, &ClientMessage::GetStatus);
            change_header(&mut bytes, |header| header[0] = 0);
            bench.lines.send(observer, bytes);
            is_thrown_out(bench, observer, 101)?;
            bench.is_in(controller, CameraState::Idle)
        },
    ),
];

/// GET_STATUS with changed bytes.
fn bad_frame(bench: &mut Bench<'_, '_>, code: u16, change: impl Fn(&mut [u8])) -> Result<(), Miss> {
    let line = bench.controller()?;
    let (mut bytes, _) = bench.lines.frame(line, &ClientMessage::GetStatus);
    change(&mut bytes);
    bench.lines.send(line, bytes);
    is_thrown_out(bench, line, code)
}

/// GET_STATUS with a changed header whose CRC agrees.
fn bad_header(bench: &mut Bench<'_, '_>, code: u16, change: fn(&mut [u8])) -> Result<(), Miss> {
    bad_frame(bench, code, |bytes| change_header(bytes, change))
}

fn change_header(bytes: &mut [u8], change: impl Fn(&mut [u8])) {
    change(&mut bytes[..28]);
    let crc = crc32c::crc32c(&bytes[..28]);
    bytes[28..32].copy_from_slice(&crc.to_le_bytes());
}

/// A frame that is whole but makes no message of its type.
fn malformed(bench: &mut Bench<'_, '_>, kind: u16, request_id: u32, flags: u16, payload: &[u8]) -> Result<(), Miss> {
    let line = bench.controller()?;
    let frame = bench.lines.raw_frame(line, kind, request_id, flags, payload);
    bench.lines.send(line, frame);
    is_thrown_out(bench, line, 108)
}

fn first_sequence(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let line = bench.connect()?;
    let run_id = bench.new_run();
    let (mut bytes, _) = bench
        .lines
        .frame(line, &ClientMessage::Hello(super::bench::hello(run_id)));
    change_header(&mut bytes, |header| header[16] = 1);
    bench.lines.send(line, bytes);
    is_thrown_out(bench, line, 107)
}

fn order(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    type Change = fn(&mut [u8]);
    let mistakes: [(u16, Change); 6] = [
        (101, |header| header[0] = 0),
        (105, |header| header[4] = 9),
        (108, |header| header[5] = 40),
        (109, |header| header[20] = 0x80),
        (104, |header| header[8..12].fill(0xFF)),
        (107, |header| header[16] = 99),
    ];
    for (first, (code, _)) in mistakes.iter().enumerate() {
        bad_frame(bench, *code, |bytes| {
            change_header(bytes, |header| {
                for (_, change) in &mistakes[first..] {
                    change(header);
                }
            });
        })?;
    }
    // A header CRC that does not agree counts before everything but the magic.
    bad_frame(bench, 102, |bytes| {
        change_header(bytes, |header| header[4] = 9);
        bytes[28] ^= 1;
    })
}

fn pieces(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let line = bench.controller()?;
    let (bytes, request_id) = bench.lines.frame(line, &ClientMessage::GetStatus);
    for byte in bytes {
        bench.lines.send(line, vec![byte]);
    }
    bench.reply(line, request_id, &ClientMessage::GetStatus)?;
    let (mut bytes, first) = bench.lines.frame(line, &ClientMessage::GetStatus);
    let (more, second) = bench.lines.frame(line, &ClientMessage::GetStatus);
    bytes.extend(more);
    bench.lines.send(line, bytes);
    bench.reply(line, first, &ClientMessage::GetStatus)?;
    bench.reply(line, second, &ClientMessage::GetStatus)?;
    Ok(())
}

/// An ERROR of this code, BYE 3 and the end of the connection must come, in this order.
pub(super) fn is_thrown_out(bench: &mut Bench<'_, '_>, line: LineId, code: u16) -> Result<(), Miss> {
    let what = format!("ERROR {code}");
    let heard = bench.lines.hear(line, &what, super::bench::REPLY_MS)?;
    is_error(&heard, code)?;
    is_closed(bench, line)
}

/// BYE 3 and the end of the connection must come.
fn is_closed(bench: &mut Bench<'_, '_>, line: LineId) -> Result<(), Miss> {
    ends_with_bye(bench, line, Bye::PROTOCOL)
}

/// BYE with this reason and the end of the connection must come next.
pub(super) fn ends_with_bye(bench: &mut Bench<'_, '_>, line: LineId, reason: u16) -> Result<(), Miss> {
    let what = format!("BYE {reason}");
    let heard = bench
        .lines
        .hear_if(line, &what, super::bench::REPLY_MS, |heard| heard.kind == 0x7F)?;
    let found = bench.lines.line(line).goodbye().map(|bye| bye.reason);
    require(found == Some(reason), || format!("BYE {reason} belongs here: {heard}"))?;
    require(bench.lines.is_closed_within(line, CLOSE_MS), || {
        "the connection was not closed after BYE".into()
    })
}

const CLOSE_MS: u64 = 2000;

/// Of requests that are written by hand: higher than those that the bench counts.
const REQUEST_ID: u32 = 90;
