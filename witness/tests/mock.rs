//! Our client drives moto-hses-mock 0.4 (Apache-2.0, another reading of HSES): what both understand, and where the mock
//! differs from `docs/protocols/hses.md`.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the message")]

use bladescan::robot::hses::{FileEvent, FileSettings, Files};
use bladescan::robot::{
    AlarmClass, Command, Cycle, Exchange, ExchangeSettings, FileCommand, FileContent, FileEnding, FileName, Form,
    Frame, JobName, PositionVariable, Protocol, Reply, RobotEvent, RobotOutput, Values, Variable, VariableKind,
    WirePose,
};
use bladescan::stamp::Stamp;
use moto_hses_mock::state::SharedState;
use moto_hses_mock::{MockConfig, MockServer};
use std::net::UdpSocket;
use std::time::{Duration, Instant};
use tokio::runtime::Runtime;

const POSE: WirePose = WirePose {
    position_um: [500_000, -250_000, 750_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};

/// A mock that serves, and our two conversations with it.
struct Cell {
    runtime: Runtime,
    mock: SharedState,
    robot: UdpSocket,
    exchange: Exchange,
    file_port: UdpSocket,
    files: Files,
    begun: Instant,
}

impl Cell {
    fn new() -> Self {
        let runtime = Runtime::new().unwrap();
        let (server, ports) = (0..20)
            .find_map(|_| serve(&runtime))
            .expect("two free ports in twenty attempts");
        let mock = server.state().clone();
        runtime.spawn(async move { server.run().await });
        let [robot, file_port] = ports.map(|port| {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.connect(("127.0.0.1", port)).unwrap();
            socket.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
            socket
        });
        let exchange = Exchange::new(ExchangeSettings {
            protocol: Protocol::Hses,
            answer_timeout_ms: 2000,
            ask_attempts: 5,
            set_repeat_ms: 2000,
            set_timeout_ms: 10_000,
        });
        let files = Files::new(FileSettings {
            answer_timeout_ms: 2000,
            attempts: 5,
        });
        Self {
            runtime,
            mock,
            robot,
            exchange,
            file_port,
            files,
            begun: Instant::now(),
        }
    }

    fn now(&self) -> Stamp {
        Stamp {
            ns: self.begun.elapsed().as_nanos() as u64,
        }
    }

    /// Says `command` and waits for what comes of it; the exchange's own bounds end the wait.
    fn say(&mut self, command: Command) -> RobotEvent {
        let now = self.now();
        self.exchange.say(now, command);
        loop {
            while let Some(output) = self.exchange.poll_output() {
                send(&self.robot, output);
            }
            while let Some(event) = self.exchange.poll_event() {
                if !matches!(event, RobotEvent::Dropped { malformed: false, .. }) {
                    return event;
                }
            }
            match receive(&self.robot) {
                Some(bytes) => self.exchange.handle_bytes(self.now(), &bytes),
                None => self.exchange.handle_wake(self.now()),
            }
        }
    }

    fn reply(&mut self, command: Command) -> Reply {
        match self.say(command) {
            RobotEvent::Answered { reply, .. } => reply,
            event => panic!("{event:?}"),
        }
    }

    /// Transfers a file and waits for what comes of it; the transfer's own bounds end the wait.
    fn transfer(&mut self, command: FileCommand) -> FileEvent {
        let now = self.now();
        self.files.begin(now, command).unwrap();
        loop {
            while let Some(output) = self.files.poll_output() {
                send(&self.file_port, output);
            }
            while let Some(event) = self.files.poll_event() {
                if !matches!(event, FileEvent::Dropped { malformed: false, .. }) {
                    return event;
                }
            }
            match receive(&self.file_port) {
                Some(bytes) => self.files.handle_datagram(self.now(), &bytes),
                None => self.files.handle_wake(self.now()),
            }
        }
    }
}

/// A mock on two ports that were free a moment ago; `None` if somebody was faster.
fn serve(runtime: &Runtime) -> Option<(MockServer, [u16; 2])> {
    let sockets = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let ports = sockets.each_ref().map(|socket| socket.local_addr().unwrap().port());
    drop(sockets);
    let config = MockConfig::new("127.0.0.1", ports[0], ports[1]);
    let server = runtime.block_on(MockServer::new(config)).ok()?;
    Some((server, ports))
}

fn send(socket: &UdpSocket, output: RobotOutput) {
    let RobotOutput::Bytes { bytes, .. } = output else {
        panic!("datagrams need no {output:?}")
    };
    socket.send(&bytes).unwrap();
}

fn receive(socket: &UdpSocket) -> Option<Vec<u8>> {
    let mut bytes = [0; 2048];
    socket.recv(&mut bytes).ok().map(|length| bytes[..length].to_vec())
}

fn read(kind: VariableKind, index: u16, count: usize) -> Command {
    Command::Read {
        first: Variable { kind, index },
        count: count as u16,
    }
}

fn write(index: u16, values: Values) -> Command {
    let kind = values.kind();
    Command::Write {
        first: Variable { kind, index },
        values,
    }
}

#[test]
fn it_tells_status_alarms_position_and_job() {
    let mut cell = Cell::new();
    let Reply::Status(status) = cell.reply(Command::Status) else {
        panic!()
    };
    assert_eq!(status.data_1 & 0xFF, 0x44, "auto and play, by the mock's default");
    assert!(!status.remote() && !status.teach() && !status.running());
    // It answers 0x70 with 268 bytes; the page says 60.
    assert!(matches!(cell.reply(Command::Alarm(0)), Reply::Alarm(Some(alarm)) if alarm.code != 0));
    let class = AlarmClass::Major;
    assert!(matches!(
        cell.reply(Command::AlarmHistory { class, index: 0 }),
        Reply::Alarm(_)
    ));
    assert!(matches!(cell.reply(Command::ExecutingJob), Reply::ExecutingJob(_)));
    // Its fields have 16 bytes each; the page's are 24, 16 and 8, so its model falls out of the model's field.
    let Reply::SystemInformation(system) = cell.reply(Command::SystemInformation) else {
        panic!()
    };
    assert_eq!((system.software.as_str(), system.model.as_str()), ("V1.0.0", ""));
}

#[test]
fn it_keeps_values_as_they_were_written() {
    let mut cell = Cell::new();
    for values in [
        Values::Byte(vec![200]),
        Values::Byte(vec![1, 2, 3, 255]),
        Values::Integer(vec![-2]),
        Values::Integer(vec![-32768, 0, 32767]),
        Values::Double(vec![i32::MIN]),
        Values::Double(vec![1, -2, 3]),
        Values::Real(vec![1.5]),
        Values::Real(vec![-0.25, 3e30]),
        Values::Text(vec!["PART-0001".into()]),
        Values::Text(vec!["A".into(), "B".into()]),
        Values::Register(vec![0x1234]),
        Values::Register(vec![1, 0xFFFE, 3]),
    ] {
        let (kind, count) = (values.kind(), values.count());
        assert_eq!(cell.reply(write(10, values.clone())), Reply::Done, "{values:?}");
        assert_eq!(cell.reply(read(kind, 10, count)), Reply::Values(values));
    }
}

#[test]
fn it_has_one_position_and_reads_our_layout() {
    let mut cell = Cell::new();
    let written = PositionVariable::Cartesian {
        frame: Frame::Base,
        pose: POSE,
        form: Form(0b10_0101),
        tool: 3,
    };
    let values = Values::Position(vec![written]);
    assert_eq!(cell.reply(write(5, values.clone())), Reply::Done);
    // 44 bytes come back; the page says 52 and takes both. Whatever its number, the variable is the arm's position.
    assert_eq!(cell.reply(read(VariableKind::Position, 5, 1)), Reply::Values(values));
    let Reply::Position(position) = cell.reply(Command::Position) else {
        panic!()
    };
    assert_eq!((position.base_from_tool, position.tool), (POSE, 3));
}

#[test]
fn it_keeps_network_inputs() {
    let mut cell = Cell::new();
    for groups in [vec![0xA5], vec![0x01, 0x80]] {
        let count = groups.len() as u16;
        let first_group = 2701;
        let written = cell.reply(Command::WriteSignals {
            first_group,
            groups: groups.clone(),
        });
        assert_eq!(written, Reply::Done);
        let read = cell.reply(Command::ReadSignals { first_group, count });
        assert_eq!(read, Reply::Signals(groups));
    }
}

#[test]
fn it_takes_switches_and_starts_the_selected_job() {
    let mut cell = Cell::new();
    let job = JobName::parse("SCAN1").unwrap();
    for command in [
        Command::AlarmReset,
        Command::ErrorCancel,
        Command::HoldOn,
        Command::HoldOff,
        Command::ServoOn,
        Command::SetCycle(Cycle::Once),
        Command::ShowText("SCAN".into()),
        Command::SelectJob { job, line: 7 },
        Command::StartJob,
    ] {
        assert_eq!(cell.reply(command.clone()), Reply::Done, "{command:?}");
    }
    let state = cell.runtime.block_on(cell.mock.read());
    let selected = state.get_selected_job().unwrap();
    assert_eq!((selected.job_name.as_str(), selected.line_number), ("SCAN1", 7));
    assert!(state.get_running());
}

#[test]
fn its_refusals_are_refusals_though_it_has_codes_of_its_own() {
    let mut cell = Cell::new();
    // B variables end at 99 here. Status FF is of no source; the byte alone decides.
    let RobotEvent::Refused { refusal, .. } = cell.say(read(VariableKind::Byte, 200, 1)) else {
        panic!()
    };
    assert_eq!((refusal.status, refusal.added_status), (0xFF, 0x00FF));
}

#[test]
fn it_lists_saves_and_deletes_files() {
    let mut cell = Cell::new();
    let ending = FileEnding::Jbi;
    let name = FileName::parse("TEST.JBI").unwrap();
    // Its only block carries the bare last-block flag.
    let names = vec!["TEST.JBI".to_owned()];
    assert_eq!(
        cell.transfer(FileCommand::List(ending)),
        FileEvent::Listed { ending, names }
    );
    let held = cell
        .runtime
        .block_on(cell.mock.read())
        .get_file("TEST.JBI")
        .cloned()
        .unwrap();
    let FileEvent::Saved { content, .. } = cell.transfer(FileCommand::Save(name.clone())) else {
        panic!()
    };
    assert_eq!(content, held);
    assert_eq!(
        cell.transfer(FileCommand::Delete(name.clone())),
        FileEvent::Deleted { name }
    );
    let names = Vec::new();
    assert_eq!(
        cell.transfer(FileCommand::List(ending)),
        FileEvent::Listed { ending, names }
    );
}

#[test]
fn it_acknowledges_a_loaded_file_but_keeps_none() {
    let mut cell = Cell::new();
    let name = FileName::parse("SCAN1.JBI").unwrap();
    let content = FileContent::new(b"/JOB\r\n//NAME SCAN1\r\nNOP\r\nEND\r\n".to_vec()).unwrap();
    let load = FileCommand::Load {
        name: name.clone(),
        content,
    };
    assert_eq!(cell.transfer(load), FileEvent::Loaded { name });
    // The mock wants name, NUL and text in one frame; the page (and two clients) send the name alone, then blocks.
    assert!(cell.runtime.block_on(cell.mock.read()).get_file("SCAN1.JBI").is_none());
}
