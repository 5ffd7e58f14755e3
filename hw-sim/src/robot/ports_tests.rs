use super::*;
use crate::robot::host::bsc::{Contention, Link, LinkOutput, Message};
use crate::vectors::{HSES_PAGE, vector};

const MS: u64 = 1_000_000;

fn client() -> SocketAddr {
    "127.0.0.1:4711".parse().unwrap()
}

fn ports(faults: &[&str], options: LinkOptions) -> Ports {
    let settings = Settings {
        faults: faults.iter().map(|fault| fault.parse().unwrap()).collect(),
        ..Settings::default()
    };
    Ports::new(settings, options)
}

/// Outputs with their times, up to a time.
fn run(ports: &mut Ports, until_ns: u64) -> Vec<(u64, PortOutput)> {
    let mut heard = Vec::new();
    let mut now_ns = 0;
    loop {
        heard.extend(core::iter::from_fn(|| ports.poll_output()).map(|output| (now_ns, output)));
        match ports.wake_at().filter(|wake_ns| *wake_ns <= until_ns) {
            Some(wake_ns) => {
                now_ns = wake_ns;
                ports.handle_input(now_ns, PortInput::Wake);
            }
            None => return heard,
        }
    }
}

fn datagram(name: &str) -> PortInput {
    PortInput::Datagram {
        port: Port::Robot,
        from: client(),
        bytes: vector(HSES_PAGE, name),
    }
}

fn bytes(connection: u64, text: &str) -> PortInput {
    PortInput::Bytes {
        connection,
        bytes: text.as_bytes().to_vec(),
    }
}

/// Pieces of one connection with their times.
fn pieces(heard: &[(u64, PortOutput)], of: u64) -> Vec<(u64, String)> {
    heard
        .iter()
        .filter_map(|(at_ns, output)| match output {
            PortOutput::Bytes { connection, bytes } if *connection == of => {
                Some((*at_ns, String::from_utf8(bytes.clone()).unwrap()))
            }
            _ => None,
        })
        .collect()
}

#[test]
fn several_host_control_clients_are_served_beside_hses() {
    let mut ports = ports(&[], LinkOptions::default());
    for connection in [1, 2] {
        ports.handle_input(0, PortInput::Connected { connection });
        ports.handle_input(0, bytes(connection, "CONNECT Robot_access\r\n"));
    }
    ports.handle_input(0, bytes(1, "HOSTCTRL_REQUEST SVON 2\r\n1\r"));
    ports.handle_input(0, bytes(2, "HOSTCTRL_REQUEST RSTATS 0\r\n"));
    ports.handle_input(0, datagram("req_status"));
    let heard = run(&mut ports, 1_000 * MS);
    let greeting = (0, "OK: DX Information Server(SIMULATED 0.1.0).\r\n".to_owned());
    for (connection, name, answer) in [(1, "SVON", "0000\r\n"), (2, "RSTATS", "196,64\r")] {
        let expected = [
            greeting.clone(),
            (0, format!("OK: {name}\r\n")),
            (50 * MS, answer.to_owned()),
        ];
        assert_eq!(pieces(&heard, connection), expected);
        assert!(heard.contains(&(50 * MS, PortOutput::Close { connection })));
    }
    // Servo power is on by now, for the other protocol, too.
    assert!(
        heard
            .iter()
            .any(|(_, output)| matches!(output, PortOutput::Datagram { bytes, .. } if bytes[36] == 0x40))
    );
}

#[test]
fn a_ninth_connection_is_refused_until_one_of_the_others_ends() {
    let mut ports = ports(&[], LinkOptions::default());
    for connection in 1..=9 {
        ports.handle_input(0, PortInput::Connected { connection });
    }
    let heard = run(&mut ports, 0);
    assert_eq!(pieces(&heard, 9), [(0, "NG: too many connections\r\n".to_owned())]);
    assert!(heard.contains(&(0, PortOutput::Close { connection: 9 })));
    ports.handle_input(1, PortInput::Closed { connection: 3 });
    ports.handle_input(1, PortInput::Connected { connection: 10 });
    ports.handle_input(1, bytes(10, "CONNECT Robot_access\r\n"));
    assert_eq!(pieces(&run(&mut ports, 1), 10).len(), 1);
}

/// Time until the answer to RSTATS has come over the serial line.
fn serial_ns(options: LinkOptions, speed: f64) -> u64 {
    let settings = Settings {
        speed,
        ..Settings::default()
    };
    let mut ports = Ports::new(settings, options);
    let mut host = Link::new(Timing::default(), Contention::Yield);
    host.send(0, Message::new("01,000", b"RSTATS\r"));
    let mut now_ns = 0;
    for _ in 0..100 {
        while let Some(output) = host.poll_output() {
            match output {
                LinkOutput::Bytes(bytes) => ports.handle_input(now_ns, PortInput::Serial(bytes)),
                LinkOutput::Message(message) => {
                    assert_eq!(message, Message::new("90,001", b"196,0\r"));
                    return now_ns;
                }
                other => assert_eq!(other, LinkOutput::Sent),
            }
        }
        match ports.poll_output() {
            Some(PortOutput::Serial(bytes)) => host.handle_bytes(now_ns, &bytes),
            Some(other) => panic!("{other:?}"),
            None => {
                now_ns = ports.wake_at().unwrap();
                ports.handle_input(now_ns, PortInput::Wake);
            }
        }
    }
    panic!("no answer");
}

#[test]
fn the_serial_line_takes_the_time_of_its_characters() {
    // Out and back: ENQ, ACK0, a block, ACK1, EOT. RSTATS takes 18 characters, its answer 17.
    let characters = 1 + 2 + 18 + 2 + 1 + 1 + 2 + 17 + 2 + 1;
    let character_ns = 11.0 / 9600.0 * 1e9;
    let expected_ns = f64::from(characters) * character_ns;
    let taken_ns = serial_ns(LinkOptions::default(), 1.0) as f64;
    assert!((taken_ns - expected_ns).abs() < 1e3, "{taken_ns} {expected_ns}");
    let fast_ns = serial_ns(LinkOptions::default(), 20.0) as f64;
    assert!((fast_ns - expected_ns / 20.0).abs() < 1e3, "{fast_ns}");
    let unpaced = LinkOptions {
        serial_baud: None,
        ..LinkOptions::default()
    };
    assert_eq!(serial_ns(unpaced, 1.0), 0);
}

#[test]
fn a_watched_serial_line_tells_when_each_character_comes() {
    let mut ports = ports(&[], LinkOptions::default());
    ports.handle_input(0, PortInput::Serial(vec![5]));
    ports.handle_input(MS, PortInput::Serial(vec![4, 5]));
    assert_eq!(ports.poll_passed(), None, "nobody watches");
    ports.watch_serial();
    // However late the caller is: the first ENQ comes when it must, and so does what answers it.
    ports.handle_input(100 * MS, PortInput::Wake);
    let passed: Vec<_> = std::iter::from_fn(|| ports.poll_passed())
        .map(|passed| (passed.from, passed.byte, passed.at_ns / 1000))
        .collect();
    let expected = [
        (LineEnd::Host, 5, 1145),
        (LineEnd::Host, 4, 2291),
        (LineEnd::Host, 5, 3437),
        (LineEnd::Robot, 0x10, 2291),
        (LineEnd::Robot, b'0', 3437),
        (LineEnd::Robot, 0x10, 4583),
        (LineEnd::Robot, b'0', 5729),
    ];
    assert_eq!(passed, expected);
}

#[test]
fn the_file_port_of_hses_is_served_through_a_network_of_its_own() {
    let mut ports = ports(&["net-delay=10"], LinkOptions::default());
    // The list of all jobs, as in the sheet.
    let head = "YERC\x20\0\x05\0\x03\x02\0\0\0\0\0\099999999\0\0\0\0\0\x32\0\0*.JBI";
    ports.handle_input(
        0,
        PortInput::Datagram {
            port: Port::File,
            from: client(),
            bytes: head.as_bytes().to_vec(),
        },
    );
    let heard = run(&mut ports, 100 * MS);
    let [(at_ns, PortOutput::Datagram { port, to, bytes })] = &heard[..] else {
        panic!("{heard:?}")
    };
    assert_eq!((*at_ns, *port, *to), (20 * MS, Port::File, client()));
    assert!(
        bytes.ends_with(b"SIMULATED.JBI\r\n") || bytes.ends_with(b"SIMULATED.JBI"),
        "{bytes:?}"
    );
}

#[test]
fn a_delayed_network_delays_both_ways_on_every_path() {
    let mut ports = ports(&["net-delay=10"], LinkOptions::default());
    ports.handle_input(0, datagram("req_status"));
    ports.handle_input(0, PortInput::Connected { connection: 1 });
    ports.handle_input(0, bytes(1, "CONNECT Robot_access\r\n"));
    let heard = run(&mut ports, 1_000 * MS);
    assert_eq!(heard.len(), 2);
    assert!(heard.iter().all(|(at_ns, _)| *at_ns == 20 * MS), "{heard:?}");
}

#[test]
fn a_stall_holds_the_answer_to_the_move_and_all_after_it_for_two_seconds() {
    let mut ports = ports(&["stall@0"], LinkOptions::default());
    ports.handle_input(0, datagram("req_servo_on"));
    ports.handle_input(0, datagram("req_move_base_50mm_s"));
    ports.handle_input(MS, datagram("req_status"));
    let times: Vec<u64> = run(&mut ports, 10_000 * MS)
        .into_iter()
        .map(|(at_ns, _)| at_ns)
        .collect();
    assert_eq!(times, [0, 2_000 * MS, 2_000 * MS]);
}

#[test]
fn a_silent_controller_says_nothing_on_any_link() {
    let mut ports = ports(&[], LinkOptions::default());
    ports.handle_input(0, PortInput::Connected { connection: 1 });
    ports.handle_input(0, PortInput::Panel(Panel::Power(false)));
    ports.handle_input(0, bytes(1, "CONNECT Robot_access\r\n"));
    ports.handle_input(0, PortInput::Serial(vec![5]));
    ports.handle_input(0, datagram("req_status"));
    assert_eq!(run(&mut ports, 1_000 * MS), []);
}

#[test]
fn the_same_seed_meets_the_same_fate_and_nothing_else_does() {
    let heard = |seed, other: bool| {
        let settings = Settings {
            seed,
            faults: vec!["net-loss=0.3".parse().unwrap(), "net-duplicate=0.3".parse().unwrap()],
            ..Settings::default()
        };
        let mut ports = Ports::new(settings, LinkOptions::default());
        for at_ns in 0..100 {
            ports.handle_input(at_ns, datagram("req_status"));
            if other {
                ports.handle_input(at_ns, PortInput::Serial(vec![5]));
            }
        }
        let mut heard = run(&mut ports, 1_000 * MS);
        heard.retain(|(_, output)| matches!(output, PortOutput::Datagram { .. }));
        heard.len()
    };
    assert_eq!(heard(1, false), heard(1, true), "another path has draws of its own");
    assert_ne!(heard(1, false), heard(2, false));
}
