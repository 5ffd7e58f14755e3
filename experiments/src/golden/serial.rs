//! Golden frames of the serial line: header, text and sum of one block each.

use bladescan::robot::host::bsc::block::{Block, BlockReader, Header, blocks, sum};
use bladescan::robot::host::text;
use bladescan::robot::{Command, Form, Reply};
use hw_sim::robot::host::bsc::{Contention, Link, LinkOutput, Message, Timing, check_sum};
use serde_json::Value;

use super::Tally;
use super::host::{Likeness, command, likeness};

/// Checks one golden frame.
pub(super) fn frame(name: &str, vector: &Value, golden: &[u8], tally: &mut Tally) -> Vec<String> {
    if name == "bcc_manual_example_sum" {
        let sums = [sum(golden), check_sum(golden)];
        return vec![tally.check(sums == [MANUAL_SUM; 2], name, "client and simulator sum to 01DB")];
    }
    let Some((header, text, last)) = written(name, vector) else {
        return vec![tally.leave_out(name, "neither its text nor its name says what it holds")];
    };
    let block = Block {
        header: header.map(|header| Header(*header)),
        text: text.clone().into_bytes(),
        last,
    };
    let mut reader = BlockReader::default();
    let read: Vec<_> = golden.iter().filter_map(|&byte| reader.push(byte)).collect();
    let mut lines = vec![
        tally.check(block.encode() == golden, name, "client writes it"),
        tally.check(read == [Ok(block.clone())], name, "client reads it"),
    ];
    match header {
        Some(b"01,000") => {
            lines.extend(said(name, &text, golden, tally));
            let message = Message::new("01,000", text.as_bytes());
            lines.push(tally.check(
                taken(&[golden]).as_deref() == Some(&[LinkOutput::Message(message)]),
                name,
                "simulator takes it",
            ));
        }
        Some(b"02,051") => {
            let message = Message::new("02,051", text.as_bytes());
            let is_taken = taken(&[golden]).as_deref() == Some(&[LinkOutput::Message(message)]);
            lines.push(tally.check(is_taken, name, "simulator takes it"));
        }
        Some(b"90,000" | b"90,001") => {
            let header = if header == Some(b"90,000") { "90,000" } else { "90,001" };
            let sent = sent(Message::new(header, text.as_bytes()), 1);
            lines.push(tally.check(sent == Some(vec![golden.to_vec()]), name, "simulator sends it"));
            let answer = text.trim_end_matches('\r');
            let is_understood = match (name, text::result_code(answer)) {
                ("ctrl_ok", code) => code == Some(0),
                ("ctrl_err_2010", code) => code == Some(0x2010),
                _ => {
                    matches!(text::reply(&Command::Status, answer), Ok(Reply::Status(status)) if (status.data_1, status.data_2) == (194, 64))
                }
            };
            lines.push(tally.check(is_understood, name, "client understands it"));
        }
        // Both golden blocks of the file are of one transmission: each is taken and sent beside the client's other one.
        _ => {
            let ours: Vec<Vec<u8>> = blocks(Header::JOB, Some(FILE_LINE.as_bytes()), FILE_TEXT.as_bytes())
                .iter()
                .map(Block::encode)
                .collect();
            let at = usize::from(last);
            lines.push(tally.check(
                ours.get(at).is_some_and(|block| block == golden),
                name,
                "client cuts the file so",
            ));
            let mut with_golden = ours.clone();
            with_golden[at] = golden.to_vec();
            let pieces: Vec<&[u8]> = with_golden.iter().map(Vec::as_slice).collect();
            let message = Message::file("02,001", "SCAN1.JBI", FILE_TEXT.as_bytes());
            let is_taken = taken(&pieces).as_deref() == Some(&[LinkOutput::Message(message.clone())]);
            lines.push(tally.check(is_taken, name, "simulator takes it"));
            let is_sent = sent(message, 2).is_some_and(|blocks| blocks[at] == golden);
            lines.push(tally.check(is_sent, name, "simulator sends it"));
        }
    }
    lines
}

/// Header, text and whether it is the last block, by the vector's text or else by its name.
fn written(name: &str, vector: &Value) -> Option<(Option<&'static [u8; 6]>, String, bool)> {
    if let Some(text) = vector["text"].as_str() {
        let (header, text) = text.split_once(" | ")?;
        return (header == "01,000").then(|| (Some(b"01,000"), text.replace("<CR>", "\r"), true));
    }
    let (header, text, last): (Option<&[u8; 6]>, _, _) = match name {
        "ctrl_ok" => (Some(b"90,000"), "0000\r", true),
        "ctrl_err_2010" => (Some(b"90,000"), "2010\r", true),
        "ctrl_data_rstats" => (Some(b"90,001"), "194,64\r", true),
        "file_put_hdr_block" => (Some(b"02,001"), FILE_LINE, false),
        "file_put_last_block" => (None, FILE_TEXT, true),
        "file_get_request" => (Some(b"02,051"), FILE_LINE, true),
        _ => return None,
    };
    Some((header, text.to_owned(), last))
}

/// Whether the client, given the command alone, says the golden text.
fn said(name: &str, golden_text: &str, golden: &[u8], tally: &mut Tally) -> Vec<String> {
    let line = golden_text.trim_end_matches('\r');
    let (word, data) = line.split_once(' ').unwrap_or((line, ""));
    let command = match command(word, data) {
        Ok(command) => command,
        Err(why) => return vec![tally.differ(name, why)],
    };
    // The golden move names type 1, no flip: that of an arm that reported it.
    let Ok(phrase) = text::phrase(&command, Some(Form::from_host_bits(1))) else {
        return vec![tally.check(false, name, "client has words for it")];
    };
    match likeness(&phrase.data, data) {
        Likeness::Equal => {
            let line = [phrase.name, &phrase.data].join(" ");
            let ours = blocks(Header::COMMAND, None, format!("{}\r", line.trim_end()).as_bytes());
            let is_equal = matches!(ours.as_slice(), [block] if block.encode() == golden);
            vec![tally.check(is_equal, name, "client says it, byte for byte")]
        }
        Likeness::SameFields => vec![
            tally.check(phrase.name == word, name, "client says the same fields"),
            tally.differ(name, "we write angles with four decimals, the NX100 two"),
        ],
        Likeness::Other => vec![tally.check(false, name, "client says it")],
    }
}

/// What the simulator's end of the line tells of a host's transmission of these blocks; `None` when it does not acknowledge
/// each in turn.
fn taken(blocks: &[&[u8]]) -> Option<Vec<LinkOutput>> {
    let mut link = Link::new(Timing::default(), Contention::Insist);
    link.handle_bytes(0, &[ENQ]);
    for at in 0..=blocks.len() {
        let acknowledged = LinkOutput::Bytes(ACK[at % 2].to_vec());
        if outputs(&mut link) != [acknowledged] {
            return None;
        }
        link.handle_bytes(0, blocks.get(at).copied().unwrap_or(&[EOT]));
    }
    Some(outputs(&mut link))
}

/// The blocks that the simulator's end of the line sends for a message of `count` blocks; `None` when it does not bid, send
/// them in turn and end.
fn sent(message: Message, count: usize) -> Option<Vec<Vec<u8>>> {
    let mut link = Link::new(Timing::default(), Contention::Insist);
    link.send(0, message);
    if outputs(&mut link) != [LinkOutput::Bytes(vec![ENQ])] {
        return None;
    }
    let mut blocks = Vec::new();
    for at in 0..count {
        link.handle_bytes(0, &ACK[at % 2]);
        match outputs(&mut link).as_slice() {
            [LinkOutput::Bytes(block)] => blocks.push(block.clone()),
            _ => return None,
        }
    }
    link.handle_bytes(0, &ACK[count % 2]);
    let is_ended = outputs(&mut link).contains(&LinkOutput::Bytes(vec![EOT]));
    is_ended.then_some(blocks)
}

fn outputs(link: &mut Link) -> Vec<LinkOutput> {
    std::iter::from_fn(|| link.poll_output()).collect()
}

/// Of the manual's worked example.
const MANUAL_SUM: u16 = 0x01DB;
const FILE_LINE: &str = "SCAN1.JBI\r";
const FILE_TEXT: &str = "/JOB\r\n//NAME SCAN1\r\nEND\r\n";
const ENQ: u8 = 0x05;
const EOT: u8 = 0x04;
const ACK: [[u8; 2]; 2] = [*b"\x100", *b"\x101"];
