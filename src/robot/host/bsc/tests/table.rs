//! Each state of the page's table against each event.

use super::*;

const STATES: [&str; 6] = ["idle", "asking", "sending", "awaiting", "receiving", "received"];

/// A link in the named state; all that it has sent is taken.
fn link_in(state: &str) -> SerialLink {
    let mut link = match state {
        "idle" => SerialLink::new(SETTINGS),
        "asking" => {
            let mut link = SerialLink::new(SETTINGS);
            link.say(at(0), &Command::StartJob).unwrap();
            link
        }
        "sending" => sending(&Command::StartJob),
        "awaiting" => awaiting(&Command::StartJob),
        "receiving" => {
            let mut link = awaiting(&Command::StartJob);
            hear(&mut link, 3, ENQ);
            link
        }
        "received" => {
            let mut link = awaiting(&Command::StartJob);
            hear(&mut link, 3, &[ENQ, &bsc("ans_ok")].concat());
            link
        }
        other => panic!("{other}"),
    };
    sent(&mut link);
    assert!(events(&mut link).is_empty());
    link
}

/// What an event of the table does: what is sent, what the caller hears, how many drops it is told.
struct Row(&'static str, &'static [&'static [u8]], Option<LinkEvent>, usize);

fn check(event: &str, rows: [Row; 6], play: impl Fn(&mut SerialLink)) {
    for (state, Row(named, sends, ends, drop_count)) in STATES.into_iter().zip(rows) {
        assert_eq!(state, named);
        let mut link = link_in(state);
        play(&mut link);
        assert_eq!(sent(&mut link), sends, "{event} while {state}");
        let told = events(&mut link);
        let ended = told.iter().find(|event| !matches!(event, LinkEvent::Dropped { .. }));
        assert_eq!(ended, ends.as_ref(), "{event} while {state}");
        assert_eq!(drops(&told), drop_count, "{event} while {state}: {told:?}");
    }
}

#[test]
fn every_event_in_every_state_does_what_the_table_says() {
    let command = bsc("cmd_start");
    let command: &'static [u8] = command.leak();
    let ok: &'static [u8] = bsc("ans_ok").leak();
    let mut bad = ok.to_vec();
    bad[9] ^= 1;
    let hears = |bytes: Vec<u8>| move |link: &mut SerialLink| link.handle_bytes(at(4), &bytes);
    let block: &'static [&'static [u8]] = vec![command].leak();

    check(
        "ENQ",
        [
            Row("idle", &[ACK0], None, 0),
            Row("asking", &[ACK0], None, 0),
            Row("sending", &[], None, 1),
            Row("awaiting", &[ACK0], None, 0),
            Row("receiving", &[ACK0], None, 0),
            Row("received", &[ACK0], Some(done()), 0),
        ],
        hears(ENQ.to_vec()),
    );
    check(
        "ACK0",
        [
            Row("idle", &[], None, 1),
            Row("asking", block, None, 0),
            Row("sending", &[], None, 1),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[], None, 1),
            Row("received", &[], None, 1),
        ],
        hears(ACK0.to_vec()),
    );
    check(
        "ACK1",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[], None, 1),
            Row("sending", &[EOT], None, 0),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[], None, 1),
            Row("received", &[], None, 1),
        ],
        hears(ACK1.to_vec()),
    );
    check(
        "NAK",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[ENQ], None, 0),
            Row("sending", block, None, 0),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[], None, 1),
            Row("received", &[], None, 1),
        ],
        hears(NAK.to_vec()),
    );
    check(
        "EOT",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[], None, 1),
            Row("sending", &[], None, 0),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[], None, 1),
            Row("received", &[], Some(done()), 0),
        ],
        hears(EOT.to_vec()),
    );
    check(
        "a good block",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[], None, 1),
            Row("sending", &[], None, 1),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[ACK1], None, 0),
            Row("received", &[ACK1], None, 0),
        ],
        hears(ok.to_vec()),
    );
    check(
        "a bad block",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[], None, 1),
            Row("sending", &[], None, 1),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[NAK], None, 1),
            Row("received", &[NAK], None, 1),
        ],
        hears(bad),
    );
    check(
        "another block",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[], None, 1),
            Row("sending", &[], None, 1),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[NAK], None, 1),
            Row("received", &[NAK], None, 1),
        ],
        hears(bsc("job_put_last")),
    );
    check(
        "noise",
        [
            Row("idle", &[], None, 1),
            Row("asking", &[], None, 1),
            Row("sending", &[], None, 1),
            Row("awaiting", &[], None, 1),
            Row("receiving", &[], None, 1),
            Row("received", &[], None, 1),
        ],
        hears(b"xyz".to_vec()),
    );
    check(
        "the next timer",
        [
            Row("idle", &[], None, 0),
            Row("asking", &[ENQ], None, 0),
            Row("sending", &[EOT], None, 0),
            Row("awaiting", &[], Some(LinkEvent::Unanswered), 0),
            Row("receiving", &[], Some(LinkEvent::Unanswered), 1),
            Row("received", &[], Some(done()), 0),
        ],
        |link| {
            if let Some(due) = link.wake_at() {
                link.handle_wake(due);
            }
        },
    );
}
