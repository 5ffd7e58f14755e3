//! The host against a controller over a line that loses, doubles and garbles bytes.
//!
//! The controller here is a second, small reading of the page, written for these tests: it takes blocks, dedups a
//! repeated one, carries a command out when EOT comes, and answers.

use super::*;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A controller that counts what it carries out.
#[derive(Default)]
struct Controller {
    heard: Vec<u8>,
    block: Option<Vec<u8>>,
    carried_out: u32,
    answering: Option<u8>,
    answer: Vec<u8>,
    says: Vec<u8>,
    due_ms: Option<u64>,
    tries: u32,
}

impl Controller {
    fn hear(&mut self, byte: u8) {
        self.heard.push(byte);
        match (self.answering, self.heard.as_slice()) {
            (None, [.., 0x05]) if !self.in_block() => {
                self.heard.clear();
                self.block = None;
                self.says.extend(ACK0);
            }
            (None, [.., 0x04]) if !self.in_block() => {
                self.heard.clear();
                if self.block.take().is_some() {
                    self.carried_out += 1;
                    self.answering = Some(0);
                    self.says.extend(ENQ);
                }
            }
            (None, [0x01, .., 0x03, low, high]) => {
                let body = &self.heard[1..self.heard.len() - 2];
                let total: u32 = body.iter().map(|&byte| u32::from(byte)).sum();
                if total as u16 == u16::from(*low) | u16::from(*high) << 8 {
                    self.block = Some(body.to_vec());
                    self.says.extend(ACK1);
                } else {
                    self.says.extend(NAK);
                }
                self.heard.clear();
            }
            (Some(0), [.., 0x10, 0x30]) => {
                self.heard.clear();
                self.answering = Some(1);
                self.says.extend(&self.answer);
            }
            (Some(1), [.., 0x15]) => {
                self.heard.clear();
                self.says.extend(&self.answer);
            }
            (Some(_), [.., 0x10, 0x31]) => {
                self.heard.clear();
                self.answering = None;
                self.says.extend(EOT);
            }
            _ => {}
        }
    }

    fn in_block(&self) -> bool {
        self.heard.len() > 1 && self.heard[0] == 0x01
    }

    /// Its own timer: says again what was not answered, a few times.
    fn wait(&mut self) {
        self.tries += 1;
        self.heard.clear();
        match self.answering {
            _ if self.tries > 4 => self.answering = None,
            Some(0) => self.says.extend(ENQ),
            Some(_) => self.says.extend(&self.answer),
            None => {}
        }
    }
}

/// What one line does to the bytes of one direction.
fn spoil(chance: &mut ChaCha8Rng, percent: u32, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    for &byte in bytes {
        if chance.random_range(0..100) >= percent {
            out.push(byte);
            continue;
        }
        match chance.random_range(0..3) {
            0 => {}
            1 => out.extend([byte, byte]),
            _ => out.push(byte ^ 1 << chance.random_range(0..7)),
        }
    }
    out
}

/// How a command ends, how often the controller has carried it out, and how often its block left.
fn talk(seed: u64, percent: u32, command: &Command) -> (LinkEvent, u32, usize) {
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let mut controller = Controller {
        answer: match command {
            Command::Status => bsc("ans_status_ready"),
            _ => bsc("ans_ok"),
        },
        ..Controller::default()
    };
    let mut link = SerialLink::new(SETTINGS);
    let mut now_ms = 0;
    let (mut block_count, mut nak_count) = (0, 0);
    link.say(at(0), command).unwrap();
    for _ in 0..STEPS_MAX {
        for bytes in sent(&mut link) {
            block_count += usize::from(bytes[0] == 0x01);
            for byte in spoil(&mut chance, percent, &bytes) {
                controller.hear(byte);
            }
        }
        let says = std::mem::take(&mut controller.says);
        if says.is_empty() {
            let controller_ms = *controller.due_ms.get_or_insert(now_ms + 400);
            let link_ms = link.wake_at().map_or(u64::MAX, |due| due.ns / 1_000_000);
            now_ms = now_ms.max(controller_ms.min(link_ms));
            if controller_ms <= link_ms {
                controller.due_ms = None;
                controller.wait();
            } else {
                link.handle_wake(at(now_ms));
            }
        } else {
            controller.due_ms = None;
            now_ms += 1;
            let heard = spoil(&mut chance, percent, &says);
            nak_count += heard.iter().filter(|&&byte| byte == 0x15).count();
            link.handle_bytes(at(now_ms), &heard);
        }
        let ended = events(&mut link)
            .into_iter()
            .find(|event| !matches!(event, LinkEvent::Dropped { .. }));
        if let Some(event) = ended {
            return (event, controller.carried_out, block_count.saturating_sub(nak_count));
        }
    }
    panic!("seed {seed}: no end within {STEPS_MAX} steps");
}

const STEPS_MAX: usize = 2000;

#[test]
fn a_good_line_carries_every_command_out_once() {
    assert_eq!(talk(0, 0, &Command::StartJob), (done(), 1, 1));
    assert!(is_ready(&talk(0, 0, &Command::Status).0));
}

#[test]
fn an_act_over_a_bad_line_is_never_carried_out_twice_nor_reported_done_without_being_done() {
    let (mut done_count, mut unanswered_count) = (0, 0);
    for seed in 0..3000 {
        let (event, carried_out, unasked_blocks) = talk(seed, 1 + (seed % 5) as u32, &Command::StartJob);
        assert!(carried_out <= 1, "seed {seed}");
        assert!(unasked_blocks <= 1, "seed {seed}: the block left without a NAK");
        if event == done() {
            assert_eq!(carried_out, 1, "seed {seed}");
            done_count += 1;
        } else {
            assert_eq!(event, LinkEvent::Unanswered, "seed {seed}");
            unanswered_count += 1;
        }
    }
    assert!(
        done_count > 1000 && unanswered_count > 10,
        "{done_count} {unanswered_count}"
    );
}

#[test]
fn an_ask_over_a_bad_line_is_answered_rightly_or_not_at_all() {
    let mut ready_count = 0;
    for seed in 0..1000 {
        match talk(seed, 1 + (seed % 3) as u32, &Command::Status).0 {
            event if is_ready(&event) => ready_count += 1,
            event => assert!(
                matches!(event, LinkEvent::Unanswered | LinkEvent::Refused(_)),
                "seed {seed}: {event:?}"
            ),
        }
    }
    assert!(ready_count > 900, "{ready_count}");
}

proptest! {
    /// Whatever comes, in whatever pieces and at whatever times: no panic, and the command ends exactly once.
    #[test]
    fn every_command_ends_once_whatever_comes(
        heard in prop::collection::vec(
            (
                0u64..400,
                prop_oneof![
                    Just(ENQ.to_vec()),
                    Just(EOT.to_vec()),
                    Just(NAK.to_vec()),
                    Just(ACK0.to_vec()),
                    Just(ACK1.to_vec()),
                    Just(bsc("ans_ok")),
                    Just(bsc("job_put_first")),
                    Just(bsc("job_put_last")),
                    prop::collection::vec(any::<u8>(), 0..30),
                ],
            ),
            0..40,
        )
    ) {
        let mut link = SerialLink::new(SETTINGS);
        let mut now_ms = 0;
        link.say(at(0), &Command::StartJob).unwrap();
        let mut told = Vec::new();
        for (wait_ms, bytes) in heard {
            now_ms += wait_ms;
            while let Some(due) = link.wake_at().filter(|due| *due <= at(now_ms)) {
                link.handle_wake(due);
            }
            link.handle_bytes(at(now_ms), &bytes);
            told.extend(events(&mut link));
        }
        let mut wakes = 0;
        while let Some(due) = link.wake_at() {
            link.handle_wake(due);
            wakes += 1;
            prop_assert!(wakes < 100);
        }
        told.extend(events(&mut link));
        let ends = told.iter().filter(|event| {
            matches!(event, LinkEvent::Answered(_) | LinkEvent::Refused(_) | LinkEvent::Unanswered)
        });
        prop_assert_eq!(ends.count(), 1);
        prop_assert!(link.is_idle());
    }

    /// Blocks are read back as an independent reading of the page reads them.
    #[test]
    fn blocks_are_read_as_they_were_written(text in prop::collection::vec(0x20u8..0xFF, 0..700)) {
        let blocks = block::blocks(Header::JOB, None, &text);
        let mut joined = Vec::new();
        for (index, written) in blocks.iter().enumerate() {
            let bytes = written.encode();
            let body = match index {
                0 => bytes.strip_prefix(b"\x0102,001\x02").unwrap(),
                _ => bytes.strip_prefix(b"\x02").unwrap(),
            };
            let (inner, check) = body.split_at(body.len() - 2);
            let (end, inner) = inner.split_last().unwrap();
            prop_assert_eq!(*end, if index + 1 == blocks.len() { 0x03 } else { 0x17 });
            joined.extend_from_slice(inner);
            let total: u64 = bytes[1..bytes.len() - 2].iter().map(|&byte| u64::from(byte)).sum();
            prop_assert_eq!(u64::from(check[0]) + 256 * u64::from(check[1]), total % 65_536);
            let mut reader = block::BlockReader::default();
            let read: Vec<_> = bytes.iter().filter_map(|&byte| reader.push(byte)).collect();
            prop_assert_eq!(read, [Ok(written.clone())]);
        }
        prop_assert_eq!(joined, text);
    }
}
