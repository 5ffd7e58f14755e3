use rand::RngExt;

use super::*;
use crate::draws::{Purpose, generator};

const ACK0: &[u8] = b"\x100";
const ACK1: &[u8] = b"\x101";

fn hex(text: &str) -> Vec<u8> {
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

/// Frames of the sheet: header, text, bytes.
const FRAMES: [(&str, &str, &str); 9] = [
    ("01,000", "RSTATS\r", "0130312c303030025253544154530d031003"),
    ("01,000", "RPOSC 0,0\r", "0130312c3030300252504f534320302c300d036203"),
    ("01,000", "SVON 1\r", "0130312c3030300253564f4e20310d03c602"),
    (
        "01,000",
        "START SCAN1\r",
        "0130312c303030025354415254205343414e310d033304",
    ),
    ("01,000", "SAVEV 2,42\r", "0130312c30303002534156455620322c34320d039803"),
    ("02,051", "SCAN1.JBI\r", "0130322c303531025343414e312e4a42490d038f03"),
    ("90,000", "0000\r", "0139302c30303002303030300d03f701"),
    ("90,000", "2010\r", "0139302c30303002323031300d03fa01"),
    ("90,001", "194,64\r", "0139302c303031023139342c36340d036c02"),
];

/// Both ends of a line on virtual time. `spoil` sees every piece that goes over: its sender, its count, its bytes.
struct Bench<'a> {
    host: Link,
    controller: Link,
    now_ns: u64,
    piece_count: usize,
    spoil: &'a dyn Fn(usize, &mut Vec<u8>),
    /// Pieces as sent, `>` from the host, `<` from the controller.
    heard: Vec<(char, Vec<u8>)>,
    host_told: Vec<LinkOutput>,
    controller_told: Vec<LinkOutput>,
}

impl<'a> Bench<'a> {
    fn new(spoil: &'a dyn Fn(usize, &mut Vec<u8>)) -> Self {
        Self {
            host: Link::new(Timing::default(), Contention::Yield),
            controller: Link::new(Timing::default(), Contention::Insist),
            now_ns: 0,
            piece_count: 0,
            spoil,
            heard: Vec::new(),
            host_told: Vec::new(),
            controller_told: Vec::new(),
        }
    }

    /// Carries bytes until neither side says anything.
    fn carry(&mut self) {
        loop {
            let outputs = |link: &mut Link| core::iter::from_fn(|| link.poll_output()).collect::<Vec<_>>();
            let (of_host, of_controller) = (outputs(&mut self.host), outputs(&mut self.controller));
            if of_host.is_empty() && of_controller.is_empty() {
                return;
            }
            for (sender, output) in of_host
                .into_iter()
                .map(|output| ('>', output))
                .chain(of_controller.into_iter().map(|output| ('<', output)))
            {
                match output {
                    LinkOutput::Bytes(mut bytes) => {
                        self.heard.push((sender, bytes.clone()));
                        (self.spoil)(self.piece_count, &mut bytes);
                        self.piece_count += 1;
                        let to = if sender == '>' {
                            &mut self.controller
                        } else {
                            &mut self.host
                        };
                        to.handle_bytes(self.now_ns, &bytes);
                    }
                    told if sender == '>' => self.host_told.push(told),
                    told => self.controller_told.push(told),
                }
            }
        }
    }

    /// Lets time pass until nothing is due any more.
    fn run(&mut self) {
        self.carry();
        for _ in 0..1000 {
            let Some(wake_ns) = self.host.wake_at().into_iter().chain(self.controller.wake_at()).min() else {
                return;
            };
            self.now_ns = wake_ns;
            self.host.handle_wake(wake_ns);
            self.controller.handle_wake(wake_ns);
            self.carry();
        }
        panic!("the line never rests");
    }

    fn messages(&self) -> Vec<&Message> {
        let told = self.controller_told.iter().chain(&self.host_told);
        told.filter_map(|told| match told {
            LinkOutput::Message(message) => Some(message),
            _ => None,
        })
        .collect()
    }

    fn has_violation(&self) -> bool {
        let mut told = self.controller_told.iter().chain(&self.host_told);
        told.any(|told| matches!(told, LinkOutput::Violation(_)))
    }
}

fn keep(_: usize, _: &mut Vec<u8>) {}

fn command() -> Message {
    Message::new("01,000", b"RSTATS\r")
}

/// A file whose blocks are all equal.
fn monotonous_file() -> Message {
    Message::file("02,001", "SCAN1.JBI", &[b'='; 3 * TEXT_BYTES_MAX])
}

#[test]
fn the_check_sum_of_the_manual_holds() {
    assert_eq!(check_sum(&hex("050036acf103")), 0x01DB);
}

#[test]
fn the_frames_of_the_sheet_are_written_and_read() {
    for (header, text, frame) in FRAMES {
        let message = Message::new(header, text.as_bytes());
        assert_eq!(message.block_bytes(0), hex(frame), "{text:?}");
        let mut link = Link::new(Timing::default(), Contention::Insist);
        let bytes = [&[ENQ][..], &hex(frame), &[EOT]].concat();
        for byte in bytes {
            link.handle_bytes(0, &[byte]);
        }
        let outputs: Vec<LinkOutput> = core::iter::from_fn(|| link.poll_output()).collect();
        let expected = [
            LinkOutput::Bytes(ACK0.to_vec()),
            LinkOutput::Bytes(ACK1.to_vec()),
            LinkOutput::Message(message),
        ];
        assert_eq!(outputs, expected, "{text:?}");
    }
}

#[test]
fn the_blocks_of_a_file_are_those_of_the_sheet() {
    let message = Message::file("02,001", "SCAN1.JBI", b"/JOB\r\n//NAME SCAN1\r\nEND\r\n");
    assert_eq!(
        message.block_bytes(0),
        hex("0130322c303031025343414e312e4a42490d179e03")
    );
    assert_eq!(
        message.block_bytes(1),
        hex("022f4a4f420d0a2f2f4e414d45205343414e310d0a454e440d0a031e05")
    );
}

#[test]
fn a_command_goes_over_and_its_answer_comes_back() {
    let mut bench = Bench::new(&keep);
    bench.host.send(0, command());
    bench.run();
    assert_eq!(bench.messages(), [&command()]);
    bench.controller.send(bench.now_ns, Message::new("90,001", b"194,64\r"));
    bench.run();
    assert_eq!(
        bench.host_told[1],
        LinkOutput::Message(Message::new("90,001", b"194,64\r"))
    );
    let heard: Vec<(char, Vec<u8>)> = [
        ('>', "05"),
        ('<', "1030"),
        ('>', "0130312c303030025253544154530d031003"),
        ('<', "1031"),
        ('>', "04"),
        ('<', "05"),
        ('>', "1030"),
        ('<', "0139302c303031023139342c36340d036c02"),
        ('>', "1031"),
        ('<', "04"),
    ]
    .map(|(sender, bytes)| (sender, hex(bytes)))
    .to_vec();
    assert_eq!(bench.heard, heard);
    assert!(!bench.has_violation() && bench.now_ns == 0);
}

#[test]
fn the_blocks_of_a_long_message_are_acknowledged_in_turn_and_equal_ones_all_delivered() {
    let mut bench = Bench::new(&keep);
    bench.host.send(0, monotonous_file());
    bench.run();
    assert_eq!(bench.messages(), [&monotonous_file()]);
    let acknowledged: Vec<&[u8]> = bench
        .heard
        .iter()
        .filter(|(sender, _)| *sender == '<')
        .map(|(_, bytes)| &bytes[..])
        .collect();
    assert_eq!(acknowledged, [ACK0, ACK1, ACK0, ACK1, ACK0]);
}

#[test]
fn one_lost_piece_anywhere_but_the_last_changes_nothing_that_is_delivered() {
    for message in [command(), monotonous_file()] {
        let piece_count = 2 * message.blocks.len() + 2;
        for lost in 0..piece_count {
            let spoil = |count: usize, bytes: &mut Vec<u8>| {
                if count == lost {
                    bytes.clear();
                }
            };
            let mut bench = Bench::new(&spoil);
            bench.host.send(0, message.clone());
            bench.run();
            assert_eq!(bench.messages(), [&message], "piece {lost}");
            assert_eq!(bench.host_told, [LinkOutput::Sent], "piece {lost}");
        }
    }
}

#[test]
fn a_lost_eot_drops_the_message_after_timer_b() {
    let spoil = |count: usize, bytes: &mut Vec<u8>| {
        if count == 4 {
            bytes.clear();
        }
    };
    let mut bench = Bench::new(&spoil);
    bench.host.send(0, command());
    bench.run();
    assert_eq!(bench.messages().len(), 0);
    assert!(bench.has_violation() && bench.controller.is_idle());
    assert_eq!(bench.now_ns, Timing::default().timer_b_ns);
}

#[test]
fn a_repeated_block_is_acknowledged_again_and_not_delivered_twice() {
    let block = hex(FRAMES[0].2);
    let mut link = Link::new(Timing::default(), Contention::Insist);
    for bytes in [&[ENQ][..], &block, &block, &[EOT]] {
        link.handle_bytes(0, bytes);
    }
    let outputs: Vec<LinkOutput> = core::iter::from_fn(|| link.poll_output()).collect();
    assert_eq!(
        outputs,
        [
            LinkOutput::Bytes(ACK0.to_vec()),
            LinkOutput::Bytes(ACK1.to_vec()),
            LinkOutput::Bytes(ACK1.to_vec()),
            LinkOutput::Message(command()),
        ]
    );
    // One in the middle, by a host that sends the block again where we would ask.
    let file = monotonous_file();
    let mut link = Link::new(Timing::default(), Contention::Insist);
    let timer_a_ns = Timing::default().timer_a_ns;
    for (now_ns, bytes) in [
        (0, vec![ENQ]),
        (0, file.block_bytes(0)),
        (0, file.block_bytes(1)),
        (timer_a_ns, file.block_bytes(1)),
        (timer_a_ns, file.block_bytes(2)),
        (timer_a_ns, file.block_bytes(3)),
        (timer_a_ns, vec![EOT]),
    ] {
        link.handle_bytes(now_ns, &bytes);
    }
    assert!(core::iter::from_fn(|| link.poll_output()).any(|output| output == LinkOutput::Message(file.clone())));
}

#[test]
fn any_flipped_bit_of_a_block_costs_a_repetition_and_no_more() {
    let block_bytes = command().block_bytes(0);
    for bit in 0..8 * block_bytes.len() {
        let spoil = |count: usize, bytes: &mut Vec<u8>| {
            if count == 2 {
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
        };
        let mut bench = Bench::new(&spoil);
        bench.host.send(0, command());
        bench.run();
        assert_eq!(bench.messages(), [&command()], "bit {bit}");
        assert_eq!(bench.host_told.last(), Some(&LinkOutput::Sent), "bit {bit}");
        assert!(bench.has_violation(), "bit {bit}");
        assert!(bench.now_ns <= 2 * Timing::default().timer_a_ns, "bit {bit}");
    }
}

#[test]
fn a_block_never_acknowledged_is_sent_four_times_and_given_up() {
    let spoil = |_: usize, bytes: &mut Vec<u8>| {
        if bytes.len() > 2 {
            bytes[9] ^= 1;
        }
    };
    let mut bench = Bench::new(&spoil);
    bench.host.send(0, command());
    bench.run();
    let block_count = bench.heard.iter().filter(|(_, bytes)| bytes.len() > 2).count();
    assert_eq!(block_count, 4);
    assert_eq!(bench.heard.last(), Some(&('>', vec![EOT])));
    assert_eq!(bench.host_told, [LinkOutput::Failed(command())]);
    assert!(bench.controller.is_idle() && bench.host.is_idle());
}

#[test]
fn a_bid_that_nobody_hears_is_repeated_ten_times_and_given_up() {
    let spoil = |_: usize, bytes: &mut Vec<u8>| bytes.clear();
    let mut bench = Bench::new(&spoil);
    bench.host.send(0, command());
    bench.run();
    assert_eq!(
        bench.heard,
        [vec![('>', vec![ENQ]); 11], vec![('>', vec![EOT])]].concat()
    );
    assert_eq!(bench.host_told, [LinkOutput::Failed(command())]);
    assert_eq!(bench.now_ns, 11 * 3_000_000_000);
}

#[test]
fn when_both_bid_the_controller_goes_first_and_nothing_is_lost() {
    let mut bench = Bench::new(&keep);
    bench.host.send(0, command());
    bench.controller.send(0, Message::new("90,000", b"0000\r"));
    bench.run();
    assert_eq!(bench.messages().len(), 2);
    assert_eq!(
        bench.heard[..3],
        [('>', vec![ENQ]), ('<', vec![ENQ]), ('>', ACK0.to_vec())]
    );
    assert!(!bench.has_violation());
}

#[test]
fn an_eot_before_the_last_block_delivers_nothing() {
    let mut link = Link::new(Timing::default(), Contention::Insist);
    link.handle_bytes(0, &[ENQ]);
    link.handle_bytes(0, &monotonous_file().block_bytes(0));
    link.handle_bytes(0, &[EOT]);
    assert!(link.is_idle());
    let outputs: Vec<LinkOutput> = core::iter::from_fn(|| link.poll_output()).collect();
    assert!(matches!(&outputs[2..], [LinkOutput::Violation(_)]), "{outputs:?}");
}

#[test]
fn what_is_no_block_of_the_sheet_gets_nak() {
    let too_long = Block {
        header: Some("01,000".to_owned()),
        text: vec![b'A'; TEXT_BYTES_MAX + 1],
        is_last: true,
    };
    let bad_header = Block {
        header: Some("01.000".to_owned()),
        text: Vec::new(),
        is_last: true,
    };
    let no_header = Block {
        header: None,
        text: b"RSTATS\r".to_vec(),
        is_last: true,
    };
    for block in [too_long, bad_header, no_header] {
        let mut link = Link::new(Timing::default(), Contention::Insist);
        link.handle_bytes(0, &[ENQ]);
        link.handle_bytes(0, &block.to_bytes());
        link.handle_wake(QUIET_NS);
        let outputs: Vec<LinkOutput> = core::iter::from_fn(|| link.poll_output()).collect();
        assert_eq!(outputs.last(), Some(&LinkOutput::Bytes(vec![NAK])), "{block:?}");
        assert!(matches!(outputs[1], LinkOutput::Violation(_)));
    }
}

#[test]
fn random_bytes_and_times_never_panic_and_the_link_comes_to_rest() {
    let mut rng = generator(1, Purpose::Test, 1, 0);
    let mut link = Link::new(Timing::default(), Contention::Insist);
    let pieces = [
        vec![ENQ],
        vec![EOT],
        ACK0.to_vec(),
        ACK1.to_vec(),
        command().block_bytes(0),
    ];
    let (mut now_ns, mut message_count) = (0, 0);
    for _ in 0..100_000 {
        now_ns += rng.random_range(0..400_000_000);
        match rng.random_range(0..16) {
            which @ 0..5 => link.handle_bytes(now_ns, &pieces[which]),
            5 if link.is_idle() => link.send(now_ns, command()),
            6 => link.handle_wake(now_ns),
            _ => link.handle_bytes(now_ns, &[rng.random::<u8>()]),
        }
        while let Some(output) = link.poll_output() {
            message_count += usize::from(matches!(output, LinkOutput::Message(_)));
        }
    }
    assert!(message_count > 0);
    for _ in 0..100 {
        let Some(wake_ns) = link.wake_at() else { break };
        link.handle_wake(wake_ns);
    }
    assert!(link.is_idle() && link.wake_at().is_none());
}
