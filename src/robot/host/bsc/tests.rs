//! The host's end of the line: against the page, state by state, and against a controller over a bad line.

mod bad_line;
mod table;

use super::*;
use crate::robot::FileContent;
use crate::vectors::bsc;

const SETTINGS: SerialSettings = SerialSettings {
    timer_a_ms: 300,
    timer_b_ms: 2000,
    retry_1: 3,
    retry_2: 2,
    gap_ms: 50,
    answer_timeout_ms: 1000,
};
const ENQ: &[u8] = &[0x05];
const EOT: &[u8] = &[0x04];
const NAK: &[u8] = &[0x15];
const ACK0: &[u8] = &[0x10, 0x30];
const ACK1: &[u8] = &[0x10, 0x31];

fn at(ms: u64) -> Stamp {
    Stamp::START.plus_ms(ms)
}

fn sent(link: &mut SerialLink) -> Vec<Vec<u8>> {
    let bytes = |output| match output {
        RobotOutput::Bytes { bytes, .. } => bytes,
        other => panic!("{other:?}"),
    };
    std::iter::from_fn(|| link.poll_output()).map(bytes).collect()
}

fn events(link: &mut SerialLink) -> Vec<LinkEvent> {
    std::iter::from_fn(|| link.poll_event()).collect()
}

/// Hears `bytes` and gives what is sent upon them.
fn hear(link: &mut SerialLink, ms: u64, bytes: &[u8]) -> Vec<Vec<u8>> {
    link.handle_bytes(at(ms), bytes);
    sent(link)
}

/// A link whose block of `command` is on the line.
fn sending(command: &Command) -> SerialLink {
    let mut link = SerialLink::new(SETTINGS);
    link.say(at(0), command).unwrap();
    assert_eq!(sent(&mut link), [ENQ]);
    assert_eq!(hear(&mut link, 1, ACK0).len(), 1);
    link
}

/// A link that has said `command` and awaits its answer.
fn awaiting(command: &Command) -> SerialLink {
    let mut link = sending(command);
    assert_eq!(hear(&mut link, 2, ACK1), [EOT]);
    link
}

/// The controller sends `blocks`.
fn controller_says(link: &mut SerialLink, ms: u64, blocks: &[Vec<u8>]) {
    assert_eq!(hear(link, ms, ENQ), [ACK0]);
    for (index, block) in blocks.iter().enumerate() {
        assert_eq!(hear(link, ms, block), [[ACK1, ACK0][index % 2]]);
    }
    assert!(hear(link, ms, EOT).is_empty());
}

fn done() -> LinkEvent {
    LinkEvent::Answered(Reply::Done)
}

fn is_ready(event: &LinkEvent) -> bool {
    matches!(event, LinkEvent::Answered(Reply::Status(status)) if status.remote() && status.servo_on())
}

fn drops(told: &[LinkEvent]) -> usize {
    told.iter()
        .filter(|event| matches!(event, LinkEvent::Dropped { .. }))
        .count()
}

#[test]
fn commands_of_the_page_are_said_byte_by_byte() {
    for (command, name) in [
        (Command::Status, "cmd_rstats"),
        (Command::Position, "cmd_rposc"),
        (Command::HoldOn, "cmd_hold_on"),
        (Command::HoldOff, "cmd_hold_off"),
        (Command::ServoOn, "cmd_servo_on"),
        (Command::AlarmReset, "cmd_reset"),
        (Command::ErrorCancel, "cmd_cancel"),
        (Command::StartJob, "cmd_start"),
        (Command::SystemInformation, "cmd_job_names"),
    ] {
        let mut link = SerialLink::new(SETTINGS);
        link.say(at(0), &command).unwrap();
        let out = |bytes: &[u8], kind| {
            Some(RobotOutput::Bytes {
                bytes: bytes.to_vec(),
                kind,
            })
        };
        assert_eq!(link.poll_output(), out(ENQ, Kind::Ask));
        link.handle_bytes(at(1), &bsc("ack0"));
        assert_eq!(link.poll_output(), out(&bsc(name), command.kind()), "{name}");
        link.handle_bytes(at(2), &bsc("ack1"));
        assert_eq!(link.poll_output(), out(EOT, Kind::Ask));
        assert_eq!(link.poll_output(), None);
    }
}

#[test]
fn answers_of_the_page_end_their_commands() {
    let mut link = awaiting(&Command::Status);
    controller_says(&mut link, 10, &[bsc("ans_status_ready")]);
    let told = events(&mut link);
    assert!(told.len() == 1 && is_ready(&told[0]), "{told:?}");
    assert!(link.is_idle() && link.wake_at().is_none());
    let mut link = awaiting(&Command::HoldOn);
    controller_says(&mut link, 10, &[bsc("ans_ok")]);
    assert_eq!(events(&mut link), [done()]);
    let mut link = awaiting(&Command::SystemInformation);
    controller_says(&mut link, 10, &[bsc("ans_job_names")]);
    let told = events(&mut link);
    assert!(matches!(&told[0], LinkEvent::Answered(Reply::SystemInformation(system)) if system.simulated()));
    for command in [Command::StartJob, Command::Status] {
        let mut link = awaiting(&command);
        controller_says(&mut link, 10, &[bsc("ans_refused_2010")]);
        let refusal = Refusal {
            status: 0x1F,
            added_status: 0x2010,
        };
        assert_eq!(events(&mut link), [LinkEvent::Refused(refusal)]);
    }
}

#[test]
fn an_exchange_may_come_byte_by_byte() {
    let mut link = SerialLink::new(SETTINGS);
    link.say(at(0), &Command::Status).unwrap();
    let controller = [ACK0, ACK1, ENQ, &bsc("ans_status_ready"), EOT].concat();
    for (ms, byte) in controller.into_iter().enumerate() {
        link.handle_bytes(at(ms as u64), &[byte]);
    }
    let expected: Vec<Vec<u8>> = [ENQ, &bsc("cmd_rstats"), EOT, ACK0, ACK1].map(<[u8]>::to_vec).into();
    assert_eq!(sent(&mut link), expected);
    let told = events(&mut link);
    assert!(told.len() == 1 && is_ready(&told[0]), "{told:?}");
}

#[test]
fn an_answer_that_does_not_fit_leaves_the_command_unanswered() {
    for (command, answer) in [
        (Command::Status, "ans_ok"),
        (Command::HoldOn, "ans_status_ready"),
        (Command::Position, "ans_status_ready"),
        (Command::HoldOn, "cmd_rstats"),
    ] {
        let mut link = awaiting(&command);
        controller_says(&mut link, 10, &[bsc(answer)]);
        let told = events(&mut link);
        assert!(matches!(told[0], LinkEvent::Dropped { malformed: true, .. }));
        assert_eq!(told[1..], [LinkEvent::Unanswered]);
    }
}

#[test]
fn an_acts_block_is_sent_once_whatever_is_lost() {
    let mut link = sending(&Command::StartJob);
    link.handle_wake(at(301));
    assert_eq!(sent(&mut link), [EOT], "silence ends the transmission");
    assert!(events(&mut link).is_empty());
    // The controller had taken it all the same, and says so.
    let mut taken = sending(&Command::StartJob);
    taken.handle_wake(at(301));
    sent(&mut taken);
    controller_says(&mut taken, 400, &[bsc("ans_ok")]);
    assert_eq!(events(&mut taken), [done()]);
    // It had not.
    assert_eq!(link.wake_at(), Some(at(1301)));
    link.handle_wake(at(1301));
    assert_eq!(events(&mut link), [LinkEvent::Unanswered]);
    assert!(sent(&mut link).is_empty() && link.is_idle());
}

#[test]
fn an_act_that_was_not_taken_is_sent_again() {
    let mut link = sending(&Command::StartJob);
    for _ in 0..SETTINGS.retry_2 {
        assert_eq!(hear(&mut link, 5, NAK), [bsc("cmd_start")]);
    }
    assert_eq!(hear(&mut link, 6, NAK), [EOT]);
    assert_eq!(events(&mut link), [LinkEvent::Unanswered]);
}

#[test]
fn an_asks_block_is_sent_again_on_silence() {
    let mut link = sending(&Command::Status);
    for attempt in 0..u64::from(SETTINGS.retry_2) {
        link.handle_wake(at(301 + 300 * attempt));
        assert_eq!(sent(&mut link), [bsc("cmd_rstats")]);
    }
    assert_eq!(hear(&mut link, 800, ACK1), [EOT]);
    controller_says(&mut link, 900, &[bsc("ans_status_ready")]);
    assert!(is_ready(&events(&mut link)[0]));
}

#[test]
fn a_controller_that_does_not_listen_is_asked_retry_1_times() {
    let mut link = SerialLink::new(SETTINGS);
    link.say(at(0), &Command::ServoOn).unwrap();
    let mut enq_count = sent(&mut link).len();
    while events(&mut link).is_empty() {
        let due = link.wake_at().unwrap();
        link.handle_wake(due);
        enq_count += sent(&mut link).iter().filter(|bytes| *bytes == ENQ).count();
    }
    assert_eq!(enq_count, 1 + SETTINGS.retry_1 as usize);
    assert!(link.is_idle() && link.wake_at().is_none());
}

#[test]
fn the_host_yields_when_both_want_to_send() {
    let mut link = SerialLink::new(SETTINGS);
    link.say(at(0), &Command::HoldOn).unwrap();
    sent(&mut link);
    controller_says_then_asks(&mut link);
    assert_eq!(hear(&mut link, 20, ACK0), [bsc("cmd_hold_on")]);
    assert_eq!(hear(&mut link, 21, ACK1), [EOT]);
    controller_says(&mut link, 30, &[bsc("ans_ok")]);
    let told = events(&mut link);
    assert_eq!((drops(&told), told.last()), (1, Some(&done())), "{told:?}");
}

fn controller_says_then_asks(link: &mut SerialLink) {
    assert_eq!(hear(link, 10, ENQ), [ACK0]);
    assert_eq!(hear(link, 11, &bsc("ans_status_ready")), [ACK1]);
    assert_eq!(hear(link, 12, EOT), [ENQ], "the line is free again");
}

#[test]
fn a_controller_that_yields_too_is_sent_the_block() {
    let mut link = SerialLink::new(SETTINGS);
    link.say(at(0), &Command::HoldOn).unwrap();
    sent(&mut link);
    assert_eq!(hear(&mut link, 10, ENQ), [ACK0]);
    assert_eq!(hear(&mut link, 11, ACK0), [bsc("cmd_hold_on")]);
}

#[test]
fn a_repeated_block_is_acknowledged_again_and_delivered_once() {
    let mut link = awaiting(&Command::Status);
    assert_eq!(hear(&mut link, 10, ENQ), [ACK0]);
    for _ in 0..3 {
        assert_eq!(hear(&mut link, 11, &bsc("ans_status_ready")), [ACK1]);
    }
    hear(&mut link, 12, EOT);
    let told = events(&mut link);
    assert!(told.len() == 1 && is_ready(&told[0]), "{told:?}");
}

#[test]
fn a_block_that_stops_in_its_middle_is_refused_and_read_when_it_comes_again() {
    let mut link = awaiting(&Command::Status);
    hear(&mut link, 10, ENQ);
    let answer = bsc("ans_status_ready");
    assert!(hear(&mut link, 11, &answer[..9]).is_empty());
    assert_eq!(link.wake_at(), Some(at(61)));
    link.handle_wake(at(61));
    assert_eq!(sent(&mut link), [NAK]);
    assert_eq!(hear(&mut link, 70, &answer), [ACK1]);
    hear(&mut link, 71, EOT);
    assert!(events(&mut link).iter().any(is_ready));
}

#[test]
fn a_late_answer_never_confirms_the_hold_that_follows() {
    // Given up while its answer was owed.
    let mut link = awaiting(&Command::StartJob);
    link.give_up(at(5));
    assert!(link.is_idle());
    link.say(at(6), &Command::HoldOn).unwrap();
    sent(&mut link);
    assert_eq!(hear(&mut link, 7, ACK0), [bsc("cmd_hold_on")]);
    hear(&mut link, 8, ACK1);
    controller_says(&mut link, 10, &[bsc("ans_ok")]);
    let told = events(&mut link);
    assert!(drops(&told) == 1 && told.len() == 1, "{told:?}");
    controller_says(&mut link, 20, &[bsc("ans_ok")]);
    assert_eq!(events(&mut link), [done()]);
    // Unanswered, then answered late.
    let mut link = awaiting(&Command::StartJob);
    link.handle_wake(at(1002));
    assert_eq!(events(&mut link), [LinkEvent::Unanswered]);
    link.say(at(1003), &Command::HoldOn).unwrap();
    hear(&mut link, 1004, ACK0);
    hear(&mut link, 1005, ACK1);
    controller_says(&mut link, 1010, &[bsc("ans_ok")]);
    let told = events(&mut link);
    assert!(drops(&told) == 1 && told.len() == 1, "{told:?}");
}

#[test]
fn an_answer_that_never_comes_costs_one_further_answer_and_no_more() {
    let mut link = awaiting(&Command::Status);
    link.handle_wake(at(1002));
    let mut ms = 1010;
    let mut answered = Vec::new();
    events(&mut link);
    for _ in 0..3 {
        link.say(at(ms), &Command::Status).unwrap();
        hear(&mut link, ms, ACK0);
        hear(&mut link, ms, ACK1);
        controller_says(&mut link, ms + 10, &[bsc("ans_status_ready")]);
        ms += 1000;
        link.handle_wake(at(ms));
        answered.push(events(&mut link).iter().any(is_ready));
    }
    assert_eq!(answered, [false, true, true]);
}

#[test]
fn giving_up_frees_the_line_for_a_hold() {
    // Before the controller listens.
    let mut link = SerialLink::new(SETTINGS);
    link.say(at(0), &Command::StartJob).unwrap();
    sent(&mut link);
    link.give_up(at(1));
    assert!(link.is_idle() && sent(&mut link) == [EOT]);
    // While the block is on its way.
    let mut link = sending(&Command::StartJob);
    link.give_up(at(3));
    assert!(link.is_idle() && sent(&mut link) == [EOT]);
    assert!(events(&mut link).is_empty());
    // While the answer comes: it is taken off the line first.
    let mut link = awaiting(&Command::Status);
    hear(&mut link, 10, ENQ);
    link.give_up(at(11));
    assert!(!link.is_idle());
    assert_eq!(hear(&mut link, 12, &bsc("ans_status_ready")), [ACK1]);
    hear(&mut link, 13, EOT);
    assert!(link.is_idle());
    assert_eq!(drops(&events(&mut link)), 1);
}

fn file(name: &str) -> FileName {
    FileName::parse(name).unwrap()
}

fn load(text: &[u8]) -> FileCommand {
    FileCommand::Load {
        name: file("SCAN1.JBI"),
        content: FileContent::new(text.to_vec()).unwrap(),
    }
}

/// Says `command` up to its end and gives its blocks.
fn transferred(link: &mut SerialLink, command: &FileCommand) -> Vec<Vec<u8>> {
    link.transfer(at(0), command).unwrap();
    assert_eq!(sent(link), [ENQ]);
    let mut blocks = hear(link, 1, ACK0);
    for ack in [ACK1, ACK0].into_iter().cycle() {
        match hear(link, 2, ack).pop() {
            Some(bytes) if bytes == EOT => return blocks,
            block => blocks.push(block.unwrap()),
        }
    }
    unreachable!("the acknowledgements do not end")
}

#[test]
fn a_job_of_500_bytes_goes_over_in_blocks_and_comes_back() {
    let text: Vec<u8> = (0..500u32).map(|index| b'A' + (index % 26) as u8).collect();
    let mut link = SerialLink::new(SETTINGS);
    let blocks = transferred(&mut link, &load(&text));
    assert_eq!(blocks[0], bsc("job_put_first"));
    assert_eq!(blocks.iter().map(Vec::len).collect::<Vec<_>>(), [21, 260, 248]);
    let progress = |done_bytes, total_bytes| LinkEvent::Progress {
        done_bytes,
        total_bytes,
    };
    let told = [10, 266, 510].map(|done| progress(done, Some(510)));
    assert_eq!(events(&mut link), told);
    controller_says(&mut link, 10, &[bsc("ans_ok")]);
    assert_eq!(events(&mut link), [done()]);

    let asked = transferred(&mut link, &FileCommand::Save(file("SCAN1.JBI")));
    assert_eq!(asked, [bsc("job_get")]);
    controller_says(&mut link, 30, &blocks);
    let saved = LinkEvent::Saved {
        name: file("SCAN1.JBI"),
        content: text,
    };
    let told = events(&mut link);
    assert_eq!(told[..3], [10, 266, 510].map(|done| progress(done, None)));
    assert_eq!(told[3..], [saved]);
}

#[test]
fn a_file_that_was_not_asked_for_is_not_taken() {
    let mut link = SerialLink::new(SETTINGS);
    transferred(&mut link, &FileCommand::Save(file("SCAN2.JBI")));
    controller_says(&mut link, 30, &[bsc("job_put_first"), bsc("job_put_last")]);
    let told = events(&mut link);
    assert_eq!((drops(&told), told.last()), (1, Some(&LinkEvent::Unanswered)));
}

#[test]
fn jobs_are_listed_and_deleted_by_commands() {
    let mut link = SerialLink::new(SETTINGS);
    let asked = transferred(&mut link, &FileCommand::List(FileEnding::Jbi));
    assert_eq!(asked, [bsc("cmd_job_names")]);
    controller_says(&mut link, 10, &[bsc("ans_job_names")]);
    let names = vec!["SCAN1.JBI".to_owned(), "SIMULATED.JBI".to_owned()];
    assert_eq!(events(&mut link), [LinkEvent::Listed { names }]);
    let asked = transferred(&mut link, &FileCommand::Delete(file("SCAN1.JBI")));
    assert_eq!(asked, [bsc("cmd_job_delete")]);
    controller_says(&mut link, 20, &[bsc("ans_ok")]);
    assert_eq!(events(&mut link), [done()]);
}

#[test]
fn a_half_sent_job_counts_for_nothing_and_is_not_sent_again() {
    let mut link = SerialLink::new(SETTINGS);
    link.transfer(at(0), &load(b"NOP\r\nEND\r\n")).unwrap();
    sent(&mut link);
    hear(&mut link, 1, ACK0);
    link.handle_wake(at(301));
    assert_eq!(sent(&mut link), [EOT]);
    assert_eq!(events(&mut link), [LinkEvent::Unanswered]);
}

#[test]
fn giving_up_a_file_that_comes_ends_it_at_the_next_block() {
    let mut link = SerialLink::new(SETTINGS);
    transferred(&mut link, &FileCommand::Save(file("SCAN1.JBI")));
    hear(&mut link, 10, ENQ);
    link.give_up(at(11));
    assert!(!link.is_idle());
    assert_eq!(hear(&mut link, 12, &bsc("job_put_first")), [EOT]);
    assert!(link.is_idle());
    assert_eq!(drops(&events(&mut link)), 1);
}

#[test]
fn only_jobs_without_control_characters_go_over_the_line() {
    let mut link = SerialLink::new(SETTINGS);
    for text in [&b"NOP\x03END"[..], b"\x10"] {
        assert!(matches!(link.transfer(at(0), &load(text)), Err(Unsupported::Text(_))));
    }
    for command in [
        FileCommand::List(FileEnding::Dat),
        FileCommand::Save(file("TOOL.CND")),
        FileCommand::Delete(file("VAR.DAT")),
    ] {
        assert!(link.transfer(at(0), &command).is_err(), "{command:?}");
    }
    assert!(link.is_idle() && link.poll_output().is_none());
}
