use rand::RngExt;

use super::*;
use crate::draws::{Purpose, generator};

const PAUSE_NS: u64 = 50_000_000;

/// A controller that knows one answer to each of a few commands.
fn interpret(now_ns: u64, call: &Call) -> Answer {
    match (call.name.as_str(), call.data.as_str()) {
        ("RSTATS", "") => Answer::Data("194,64".to_owned()),
        ("RJDIR", "*") => Answer::Data("SCAN1,SCAN2".to_owned()),
        ("SVON", "1") => Answer::Done,
        ("START", "SCAN1") => Answer::Refused(0x2100),
        ("JWAIT", "2") if now_ns >= call.since_ns + 2_000_000_000 => Answer::Data("0".to_owned()),
        ("JWAIT", "2") => Answer::Later(call.since_ns + 2_000_000_000),
        _ => Answer::Refused(0x1010),
    }
}

/// What comes out, whether the connection closed, and what was wrong.
#[derive(Debug, Default, PartialEq)]
struct Heard {
    pieces: Vec<String>,
    is_closed: bool,
    violations: Vec<String>,
}

fn hear(connection: &mut Connection) -> Heard {
    let mut heard = Heard::default();
    while let Some(output) = connection.poll_output() {
        match output {
            TcpOutput::Bytes(piece) => heard.pieces.push(text(&piece)),
            TcpOutput::Close => heard.is_closed = true,
            TcpOutput::Violation(what) => heard.violations.push(what),
        }
    }
    heard
}

/// Everything said by the end, with time passing as the connection asks for it.
fn converse(pieces: &[&str]) -> (Heard, Connection) {
    let mut connection = Connection::new(PAUSE_NS);
    for piece in pieces {
        connection.handle_bytes(0, piece.as_bytes(), &mut interpret);
    }
    for _ in 0..100 {
        let Some(now_ns) = connection.wake_at() else { break };
        connection.handle_wake(now_ns, &mut interpret);
    }
    (hear(&mut connection), connection)
}

fn said(pieces: &[&str]) -> Heard {
    let heard = converse(pieces).0;
    assert_eq!(heard.violations, [""; 0], "{pieces:?}");
    heard
}

const CONNECT: &str = "CONNECT Robot_access\r\n";
const GREETING: &str = "OK: DX Information Server(SIMULATED 0.1.0).\r\n";

#[test]
fn the_exchanges_of_the_public_clients_are_served() {
    for (request, data, confirmation, answer) in [
        ("HOSTCTRL_REQUEST RSTATS 0\r\n", "", "OK: RSTATS\r\n", "194,64\r"),
        ("HOSTCTRL_REQUEST RJDIR 2\r\n", "*\r", "OK: RJDIR\r\n", "SCAN1,SCAN2\r"),
        ("HOSTCTRL_REQUEST SVON 2\r\n", "1\r", "OK: SVON\r\n", "0000\r\n"),
        // With CR LF, and the size that counts it.
        ("HOSTCTRL_REQUEST SVON 3\r\n", "1\r\n", "OK: SVON\r\n", "0000\r\n"),
        (
            "HOSTCTRL_REQUEST START 6\r\n",
            "SCAN1\r",
            "OK: START\r\n",
            "ERROR: START is not successful(2100)\r\n",
        ),
        (
            "HOSTCTRL_REQUEST DANCE 0\r\n",
            "",
            "OK: DANCE\r\n",
            "ERROR: DANCE is not successful(1010)\r\n",
        ),
    ] {
        let heard = said(&[CONNECT, request, data]);
        assert_eq!(heard.pieces, [GREETING, confirmation, answer]);
        assert!(heard.is_closed, "without Keep-Alive one command is all");
    }
}

#[test]
fn the_stream_may_be_cut_anywhere() {
    let whole = format!("{CONNECT}HOSTCTRL_REQUEST RJDIR 2\r\n*\r");
    let bytewise: Vec<&str> = (0..whole.len()).map(|at| &whole[at..=at]).collect();
    assert_eq!(said(&bytewise), said(&[&whole]));
    assert_eq!(said(&bytewise).pieces.len(), 3);
}

#[test]
fn keep_alive_counts_the_commands_down() {
    let request = "HOSTCTRL_REQUEST SVON 2\r\n1\r";
    let heard = said(&["CONNECT Robot_access Keep-Alive:3\r\n", request, request]);
    assert_eq!(
        heard.pieces[0],
        "OK: DX Information Server(SIMULATED 0.1.0) Keep-Alive:3.\r\n"
    );
    assert_eq!((heard.pieces.len(), heard.is_closed), (5, false));
    let heard = said(&["CONNECT Robot_access Keep-Alive:2\r\n", request, request, request]);
    assert_eq!((heard.pieces.len(), heard.is_closed), (5, true));
    let (heard, mut connection) = converse(&["CONNECT Robot_access Keep-Alive:-1\r\n", request]);
    assert!(heard.pieces[0].ends_with(" Keep-Alive:-1.\r\n"));
    for _ in 0..40_000 {
        connection.handle_bytes(u64::MAX, request.as_bytes(), &mut interpret);
        assert_eq!(hear(&mut connection).pieces, ["OK: SVON\r\n", "0000\r\n"]);
    }
}

#[test]
fn the_answer_comes_a_pause_after_the_confirmation() {
    let mut connection = Connection::new(PAUSE_NS);
    connection.handle_bytes(
        0,
        format!("{CONNECT}HOSTCTRL_REQUEST RSTATS 0\r\n").as_bytes(),
        &mut interpret,
    );
    assert_eq!(hear(&mut connection).pieces, [GREETING, "OK: RSTATS\r\n"]);
    assert_eq!(connection.wake_at(), Some(PAUSE_NS));
    connection.handle_wake(PAUSE_NS - 1, &mut interpret);
    assert_eq!(hear(&mut connection), Heard::default());
    connection.handle_wake(PAUSE_NS, &mut interpret);
    let heard = hear(&mut connection);
    assert_eq!((heard.pieces, heard.is_closed), (vec!["194,64\r".to_owned()], true));
}

#[test]
fn the_data_that_comes_after_the_pause_is_answered_at_once() {
    let mut connection = Connection::new(PAUSE_NS);
    connection.handle_bytes(
        0,
        format!("{CONNECT}HOSTCTRL_REQUEST SVON 2\r\n").as_bytes(),
        &mut interpret,
    );
    connection.handle_bytes(PAUSE_NS, b"1\r", &mut interpret);
    assert_eq!(hear(&mut connection).pieces, [GREETING, "OK: SVON\r\n", "0000\r\n"],);
}

#[test]
fn a_command_that_takes_its_time_is_looked_at_again() {
    let mut connection = Connection::new(PAUSE_NS);
    connection.handle_bytes(
        7,
        format!("{CONNECT}HOSTCTRL_REQUEST JWAIT 2\r\n2\r").as_bytes(),
        &mut interpret,
    );
    assert_eq!(connection.wake_at(), Some(2_000_000_007));
    connection.handle_wake(2_000_000_007, &mut interpret);
    assert_eq!(hear(&mut connection).pieces, [GREETING, "OK: JWAIT\r\n", "0\r"]);
}

#[test]
fn what_is_malformed_is_refused_told_and_closed() {
    for pieces in [
        &["GET / HTTP/1.1\r\n"][..],
        &["CONNECT Robot_access Keep-Alive:1\r\n"],
        &["CONNECT Robot_access Keep-Alive:32768\r\n"],
        &["CONNECT Robot_access Keep-Alive\r\n"],
        &["CONNECT robot_access\r\n"],
        &[&"A".repeat(LINE_BYTES_MAX)],
        &[CONNECT, "HOSTCTRL_REQUEST RSTATS\r\n"],
        &[CONNECT, "HOSTCTRL_REQUEST RSTATS -1\r\n"],
        &[CONNECT, "HOSTCTRL_REQUEST RSTATS 99999\r\n"],
        &[CONNECT, "HOSTCTRL_REQUEST  0\r\n"],
        &[CONNECT, "RSTATS\r\n"],
    ] {
        let (heard, connection) = converse(pieces);
        assert_eq!(
            heard.pieces.last().map(String::as_str),
            Some("NG: request refused\r\n"),
            "{pieces:?}"
        );
        assert_eq!(heard.violations.len(), 1, "{pieces:?}: {:?}", heard.violations);
        assert!(heard.is_closed && connection.is_closed());
    }
}

#[test]
fn data_without_its_cr_and_an_uncounted_end_are_told_but_served() {
    let keep_alive = "CONNECT Robot_access Keep-Alive:9\r\n";
    let request = "HOSTCTRL_REQUEST SVON 1\r\n1";
    let (heard, _) = converse(&[keep_alive, request, "\r\n", "HOSTCTRL_REQUEST RSTATS 0\r\n"]);
    assert_eq!(
        heard.pieces[1..],
        ["OK: SVON\r\n", "0000\r\n", "OK: RSTATS\r\n", "194,64\r"]
    );
    assert_eq!(heard.violations.len(), 2);
}

#[test]
fn a_client_that_never_waits_is_cut_off() {
    let request = "HOSTCTRL_REQUEST JWAIT 2\r\n2\r";
    let mut connection = Connection::new(PAUSE_NS);
    connection.handle_bytes(0, b"CONNECT Robot_access Keep-Alive:-1\r\n", &mut interpret);
    for _ in 0..RECEIVED_BYTES_MAX / request.len() + 2 {
        connection.handle_bytes(0, request.as_bytes(), &mut interpret);
    }
    let heard = hear(&mut connection);
    assert!(heard.is_closed && heard.violations.len() == 1, "{heard:?}");
}

#[test]
fn random_bytes_never_panic_and_never_grow_the_buffer() {
    let mut rng = generator(1, Purpose::Test, 0, 0);
    let words: [&[u8]; 6] = [
        b"CONNECT Robot_access Keep-Alive:-1\r\n",
        b"HOSTCTRL_REQUEST ",
        b"SVON 2\r\n",
        b"1\r",
        b"JWAIT 2\r\n2\r",
        b"\r\n",
    ];
    let mut connection = Connection::new(PAUSE_NS);
    let mut answer_count = 0;
    for now_ns in 0..100_000 {
        let piece = match rng.random_range(0..12) {
            which @ 0..6 => words[which].to_vec(),
            _ => vec![rng.random::<u8>()],
        };
        connection.handle_bytes(now_ns * PAUSE_NS, &piece, &mut interpret);
        answer_count += hear(&mut connection).pieces.len();
        assert!(connection.received.len() <= RECEIVED_BYTES_MAX);
        if connection.is_closed() {
            connection = Connection::new(PAUSE_NS);
        }
    }
    assert!(answer_count > 1000, "{answer_count}");
}
