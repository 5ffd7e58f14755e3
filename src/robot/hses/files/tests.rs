//! Transfers against the vectors of the page, and against a controller played by the page over a bad line.

use super::*;
use crate::robot::file::FileContent;
use crate::vectors::hses;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

const SETTINGS: FileSettings = FileSettings {
    answer_timeout_ms: 100,
    attempts: 8,
};

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

fn scan1() -> FileName {
    FileName::parse("SCAN1.JBI").unwrap()
}

fn load(content: &[u8]) -> FileCommand {
    FileCommand::Load {
        name: scan1(),
        content: FileContent::new(content.to_vec()).unwrap(),
    }
}

fn drain(files: &mut Files) -> Vec<Vec<u8>> {
    std::iter::from_fn(|| match files.poll_output()? {
        RobotOutput::Bytes { bytes, .. } => Some(bytes),
        other => panic!("{other:?}"),
    })
    .collect()
}

fn events(files: &mut Files) -> Vec<FileEvent> {
    std::iter::from_fn(|| files.poll_event()).collect()
}

fn begun(command: FileCommand) -> Files {
    let mut files = Files::new(SETTINGS);
    files.begin(at(0), command).unwrap();
    files
}

/// What the client sends to the page's datagrams, one after the other, and the events at the end.
fn conversation(command: FileCommand, answers: &[&str]) -> (Vec<Vec<u8>>, Vec<FileEvent>) {
    let mut files = begun(command);
    let mut sent = drain(&mut files);
    for answer in answers {
        files.handle_datagram(at(1), &hses(answer));
        sent.extend(drain(&mut files));
    }
    (sent, events(&mut files))
}

fn vectors(names: &[&str]) -> Vec<Vec<u8>> {
    names.iter().map(|name| hses(name)).collect()
}

#[test]
fn a_list_goes_as_on_the_page() {
    let (sent, events) = conversation(FileCommand::List(FileEnding::Jbi), &["file_ans_list"]);
    assert_eq!(sent, vectors(&["file_req_list", "file_ack_list"]));
    let names = vec!["SCAN1.JBI".into(), "SCAN2.JBI".into()];
    let ending = FileEnding::Jbi;
    assert_eq!(events, [FileEvent::Listed { ending, names }]);
}

#[test]
fn a_file_comes_as_on_the_page() {
    let (sent, events) = conversation(FileCommand::Save(scan1()), &["file_ans_save_1", "file_ans_save_2"]);
    assert_eq!(sent, vectors(&["file_req_save", "file_ack_save_1", "file_ack_save_2"]));
    let content = b"/JOB\r\n//NAME SCAN1\r\n".to_vec();
    assert_eq!(events, [FileEvent::Saved { name: scan1(), content }]);
}

#[test]
fn a_file_goes_as_on_the_page() {
    let answers = ["file_ans_load_ready", "file_ans_load_1"];
    let (sent, events) = conversation(load(b"/JOB\r\n//NAME SCAN1\r\n"), &answers);
    assert_eq!(sent, vectors(&["file_req_load", "file_load_1"]));
    assert_eq!(events, [FileEvent::Loaded { name: scan1() }]);
}

#[test]
fn a_file_is_deleted_as_on_the_page_and_never_asked_twice() {
    let (sent, events_) = conversation(FileCommand::Delete(scan1()), &["file_ans_deleted"]);
    assert_eq!(sent, vectors(&["file_req_delete"]));
    assert_eq!(events_, [FileEvent::Deleted { name: scan1() }]);
    let mut files = begun(FileCommand::Delete(scan1()));
    assert_eq!(drain(&mut files).len(), 1);
    files.handle_wake(at(100));
    assert!(drain(&mut files).is_empty());
    let command = FileCommand::Delete(scan1());
    assert_eq!(events(&mut files), [FileEvent::Unanswered { command }]);
}

#[test]
fn a_refusal_ends_the_transfer_in_words_that_help() {
    for (answers, added, word) in [
        (&["file_ans_not_found"][..], 0xE2B3, "no such file"),
        (&["file_ans_save_1", "file_ans_stalled"], 0xE28B, "waited too long"),
    ] {
        let (_, events) = conversation(FileCommand::Save(scan1()), answers);
        let [FileEvent::Refused { refusal, .. }] = events.as_slice() else {
            panic!("{events:?}")
        };
        assert_eq!((refusal.status, refusal.added_status), (0x1F, added));
        assert!(refusal.words().contains(word), "{}", refusal.words());
    }
}

#[test]
fn a_repeated_block_is_acknowledged_again_and_not_stored_twice() {
    let answers = [
        "file_ans_save_1",
        "file_ans_save_1",
        "file_ans_save_2",
        "file_ans_save_2",
    ];
    let (sent, events) = conversation(FileCommand::Save(scan1()), &answers);
    let acknowledged = [
        "file_ack_save_1",
        "file_ack_save_1",
        "file_ack_save_2",
        "file_ack_save_2",
    ];
    assert_eq!(sent[1..], vectors(&acknowledged));
    let content = b"/JOB\r\n//NAME SCAN1\r\n".to_vec();
    assert_eq!(events, [FileEvent::Saved { name: scan1(), content }]);
}

#[test]
fn two_machines_that_answer_each_other_fall_silent() {
    let mut files = begun(FileCommand::Save(scan1()));
    drain(&mut files);
    for name in ["file_ans_save_1", "file_ans_save_2"] {
        for _ in 0..100 {
            files.handle_datagram(at(1), &hses(name));
        }
        assert!(drain(&mut files).len() <= 1 + SETTINGS.attempts as usize, "{name}");
    }
}

#[test]
fn a_block_out_of_order_is_dropped_with_an_event() {
    let (sent, events) = conversation(FileCommand::Save(scan1()), &["file_ans_save_2"]);
    assert_eq!(sent, vectors(&["file_req_save"]));
    assert!(matches!(events[..], [FileEvent::Dropped { malformed: false, .. }]));
}

#[test]
fn foreign_and_garbled_datagrams_are_dropped_with_an_event() {
    let mut files = begun(FileCommand::Save(scan1()));
    let mut foreign = hses("file_ans_save_1");
    foreign[11] = 77;
    for (bytes, garbled) in [
        (foreign, false),
        (hses("file_ans_list"), false),
        (hses("ans_set_ok"), true),
        (b"noise".to_vec(), true),
    ] {
        files.handle_datagram(at(1), &bytes);
        let dropped = events(&mut files);
        assert!(matches!(dropped[..], [FileEvent::Dropped { malformed, .. }] if malformed == garbled));
    }
    assert!(!files.is_idle());
}

#[test]
fn silence_is_asked_into_so_many_times_and_then_told() {
    for (command, answers) in [
        (FileCommand::Save(scan1()), &[][..]),
        (FileCommand::Save(scan1()), &["file_ans_save_1"]),
        (load(b"x"), &["file_ans_load_ready"]),
    ] {
        let mut files = begun(command.clone());
        for answer in answers {
            files.handle_datagram(at(0), &hses(answer));
        }
        let said = drain(&mut files).pop().unwrap();
        for attempt in 1..u64::from(SETTINGS.attempts) {
            assert_eq!(files.wake_at(), Some(at(attempt * 100)));
            files.handle_wake(at(attempt * 100));
            assert_eq!(drain(&mut files), std::slice::from_ref(&said));
        }
        files.handle_wake(at(800));
        assert_eq!(events(&mut files), [FileEvent::Unanswered { command }]);
        assert_eq!((files.wake_at(), files.is_idle()), (None, true));
    }
}

#[test]
fn a_file_beyond_the_bound_is_given_up() {
    let mut files = begun(FileCommand::Save(scan1()));
    let block = |number: u32| {
        let mut bytes = hses("file_ans_save_1");
        bytes.truncate(32);
        bytes[6..8].copy_from_slice(&479u16.to_le_bytes());
        bytes[12..16].copy_from_slice(&number.to_le_bytes());
        bytes.resize(32 + 479, b' ');
        bytes
    };
    let fitting = (FILE_BYTES_MAX / 479) as u32;
    for number in 1..=fitting {
        files.handle_datagram(at(1), &block(number));
        assert!(files.poll_event().is_none());
    }
    files.handle_datagram(at(1), &block(fitting + 1));
    let command = FileCommand::Save(scan1());
    assert_eq!(events(&mut files), [FileEvent::TooLarge { command }]);
    assert!(files.is_idle());
}

#[test]
fn empty_blocks_without_end_are_given_up_too() {
    let mut files = begun(FileCommand::Save(scan1()));
    let mut block = hses("file_ans_save_1");
    block.truncate(32);
    block[6] = 0;
    for number in 1..=FILE_BLOCKS_MAX + 1 {
        assert!(!files.is_idle());
        block[12..16].copy_from_slice(&number.to_le_bytes());
        files.handle_datagram(at(1), &block);
        drain(&mut files);
    }
    assert!(matches!(events(&mut files)[..], [FileEvent::TooLarge { .. }]));
}

#[test]
fn one_transfer_is_open_at_a_time() {
    let mut files = begun(FileCommand::List(FileEnding::Jbi));
    assert_eq!(files.begin(at(1), FileCommand::Save(scan1())), Err(FilesBusy));
    files.forget_open();
    assert_eq!(files.begin(at(2), FileCommand::Save(scan1())), Ok(()));
}

#[test]
fn a_controller_that_only_marks_the_last_block_is_understood() {
    let bare_flag = |name: &str| {
        let mut bytes = hses(name);
        bytes[12..16].copy_from_slice(&0x8000_0000u32.to_le_bytes());
        bytes
    };
    let mut files = begun(FileCommand::List(FileEnding::Jbi));
    files.handle_datagram(at(1), &bare_flag("file_ans_list"));
    assert!(matches!(events(&mut files)[..], [FileEvent::Listed { .. }]));
    let acknowledged = drain(&mut files).pop().unwrap();
    assert_eq!(acknowledged[12..16], [0, 0, 0, 0x80]);

    let mut files = begun(load(b"x"));
    files.handle_datagram(at(1), &hses("file_ans_load_ready"));
    files.handle_datagram(at(2), &bare_flag("file_ans_load_1"));
    assert!(matches!(events(&mut files)[..], [FileEvent::Loaded { .. }]));

    // After a repeated request the bare flag could be the second answer to it.
    let mut files = begun(load(b"x"));
    files.handle_wake(at(100));
    files.handle_datagram(at(101), &hses("file_ans_load_ready"));
    files.handle_datagram(at(102), &bare_flag("file_ans_load_1"));
    assert!(matches!(events(&mut files)[..], [FileEvent::Dropped { .. }]));
}

/// A controller by the page, at its least helpful: it repeats nothing by itself, takes every request as a new one, and
/// refuses a block out of order.
struct Controller {
    files: BTreeMap<String, Vec<u8>>,
    sending: Option<Sending>,
    receiving: Option<(String, Vec<u8>, u32)>,
}

struct Sending {
    blocks: Vec<Vec<u8>>,
    /// The one that is not acknowledged, from 0.
    at: usize,
}

impl Controller {
    fn handle(&mut self, datagram: &[u8]) -> Option<Vec<u8>> {
        assert_eq!((&datagram[..6], datagram[8], datagram[9]), (&b"YERC\x20\0"[..], 3, 2));
        assert_eq!(datagram[6..8], ((datagram.len() - 32) as u16).to_le_bytes());
        assert_eq!(datagram[16..24], *b"99999999");
        let block = u32::from_le_bytes(datagram[12..16].try_into().unwrap());
        let (ack, service, data) = (datagram[10], datagram[29], &datagram[32..]);
        assert_eq!(ack, u8::from(block != 0));
        let answer = |block: u32, added: u16, data: &[u8]| {
            let mut bytes = datagram[..24].to_vec();
            bytes[6..8].copy_from_slice(&(data.len() as u16).to_le_bytes());
            bytes[10] = 1;
            bytes[12..16].copy_from_slice(&block.to_le_bytes());
            let status = if added == 0 { 0 } else { 0x1F };
            bytes.extend([service | 0x80, status, u8::from(added != 0), 0]);
            bytes.extend(added.to_le_bytes());
            bytes.extend([0, 0]);
            bytes.extend(data);
            Some(bytes)
        };
        let named = || String::from_utf8(data.to_vec()).unwrap();
        match (service, block & 0x7FFF_FFFF) {
            (0x09, 0) => answer(
                0,
                if self.files.remove(&named()).is_some() {
                    0
                } else {
                    0xE2B3
                },
                b"",
            ),
            (0x15, 0) => {
                self.receiving = Some((named(), Vec::new(), 0));
                answer(0, 0, b"")
            }
            (0x15, number) => {
                let Some((name, content, stored)) = &mut self.receiving else {
                    return answer(block, 0xE4A1, b"");
                };
                if number == *stored + 1 {
                    content.extend(data);
                    *stored += 1;
                } else if number != *stored {
                    return answer(block, 0xE4A1, b"");
                }
                if block >> 31 == 1 {
                    self.files.insert(name.clone(), content.clone());
                }
                answer(block, 0, b"")
            }
            (0x16 | 0x32, 0) => {
                let content = match service {
                    0x32 => self
                        .files
                        .keys()
                        .map(|name| format!("{name}\r\n"))
                        .collect::<String>()
                        .into_bytes(),
                    _ => self.files.get(&named())?.clone(),
                };
                let blocks: Vec<Vec<u8>> = content.chunks(479).map(<[u8]>::to_vec).collect();
                self.sending = Some(Sending { blocks, at: 0 });
                self.data_block().and_then(|(block, data)| answer(block, 0, &data))
            }
            (_, number) => {
                let sending = self.sending.as_mut()?;
                match sending.at + 1 {
                    awaited if number as usize == awaited => sending.at += 1,
                    // The client asks again into our silence: our block was lost.
                    awaited if number as usize + 1 == awaited => {}
                    _ => return None,
                }
                self.data_block().and_then(|(block, data)| answer(block, 0, &data))
            }
        }
    }

    /// The block that is to be acknowledged next, with its number.
    fn data_block(&self) -> Option<(u32, Vec<u8>)> {
        let Sending { blocks, at } = self.sending.as_ref()?;
        let last = u32::from(at + 1 == blocks.len()) << 31;
        Some(((*at as u32 + 1) | last, blocks.get(*at)?.clone()))
    }
}

/// A line that loses, doubles and delays datagrams.
struct Line {
    rng: ChaCha8Rng,
    /// By arrival, ms, then by the order of sending; whether for the controller.
    on_the_way: BTreeMap<(u64, u64), (bool, Vec<u8>)>,
    sent_count: u64,
}

impl Line {
    fn put(&mut self, now_ms: u64, to_controller: bool, bytes: &[u8]) {
        let copies = [0, 1, 1, 1, 1, 1, 1, 1, 2, 2][self.rng.random_range(0..10)];
        for _ in 0..copies {
            self.sent_count += 1;
            let arrival_ms = now_ms + self.rng.random_range(1..=70);
            let place = (arrival_ms, self.sent_count);
            self.on_the_way.insert(place, (to_controller, bytes.to_vec()));
        }
    }
}

/// Plays `command` over a bad line; the controller, and how the transfer ended.
fn over_a_bad_line(seed: u64, command: FileCommand, held: &[u8]) -> (Controller, FileEvent) {
    let mut controller = Controller {
        files: BTreeMap::from([("SCAN1.JBI".into(), held.to_vec()), ("SCAN2.JBI".into(), vec![1])]),
        sending: None,
        receiving: None,
    };
    let mut line = Line {
        rng: ChaCha8Rng::seed_from_u64(seed),
        on_the_way: BTreeMap::new(),
        sent_count: 0,
    };
    let mut files = begun(command);
    let mut now_ms = 0;
    loop {
        for bytes in drain(&mut files) {
            line.put(now_ms, true, &bytes);
        }
        for event in events(&mut files) {
            if !matches!(event, FileEvent::Dropped { malformed: false, .. }) {
                return (controller, event);
            }
        }
        let wake = files.wake_at().expect("an open transfer has a bound");
        match line.on_the_way.first_entry() {
            Some(first) if at(first.key().0) <= wake => {
                now_ms = first.key().0;
                let (to_controller, bytes) = first.remove();
                if !to_controller {
                    files.handle_datagram(at(now_ms), &bytes);
                } else if let Some(answer) = controller.handle(&bytes) {
                    line.put(now_ms, false, &answer);
                }
            }
            _ => {
                now_ms = wake.ns / 1_000_000;
                files.handle_wake(wake);
            }
        }
    }
}

fn content(seed: u64, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    rand::Rng::fill_bytes(&mut ChaCha8Rng::seed_from_u64(seed), &mut bytes);
    bytes
}

#[test]
fn over_a_bad_line_a_file_comes_whole_or_not_at_all() {
    let mut whole = 0;
    for seed in 0..300 {
        let held = content(seed, 1 + (seed as usize * 37) % 5000);
        match over_a_bad_line(seed, FileCommand::Save(scan1()), &held).1 {
            FileEvent::Saved { content, .. } => {
                assert_eq!(content, held, "seed {seed}");
                whole += 1;
            }
            event => assert!(matches!(event, FileEvent::Unanswered { .. }), "seed {seed}: {event:?}"),
        }
        let (_, listed) = over_a_bad_line(seed, FileCommand::List(FileEnding::Jbi), &held);
        assert!(
            matches!(&listed, FileEvent::Listed { names, .. } if names == &["SCAN1.JBI", "SCAN2.JBI"]),
            "seed {seed}: {listed:?}"
        );
    }
    assert!(whole > 150, "only {whole} of 300 came whole");
}

#[test]
fn over_a_bad_line_a_file_that_counts_as_loaded_is_loaded() {
    let mut loaded = 0;
    for seed in 0..300 {
        let (before, after) = (
            content(seed + 1000, 700),
            content(seed, 1 + (seed as usize * 37) % 5000),
        );
        let (controller, event) = over_a_bad_line(seed, load(&after), &before);
        let held = &controller.files["SCAN1.JBI"];
        match event {
            FileEvent::Loaded { .. } => {
                assert_eq!(held, &after, "seed {seed}");
                loaded += 1;
            }
            FileEvent::Unanswered { .. } | FileEvent::Refused { .. } => {
                assert!(held == &before || held == &after, "seed {seed}");
            }
            event => panic!("seed {seed}: {event:?}"),
        }
    }
    assert!(loaded > 150, "only {loaded} of 300 were loaded");
}

#[test]
fn over_a_bad_line_a_file_that_counts_as_deleted_is_gone() {
    let mut deleted = 0;
    for seed in 0..300 {
        let (controller, event) = over_a_bad_line(seed, FileCommand::Delete(scan1()), b"x");
        if matches!(event, FileEvent::Deleted { .. }) {
            assert!(!controller.files.contains_key("SCAN1.JBI"), "seed {seed}");
            deleted += 1;
        }
    }
    assert!(deleted > 150, "only {deleted} of 300 were deleted");
}
