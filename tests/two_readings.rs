//! The client and the simulated controller, two readings of one page, understand each other in every command.

use bladescan::robot::hses::{FileEvent, FileSettings, Files};
use bladescan::robot::{
    self, AlarmClass, Command, Cycle, Exchange, ExchangeSettings, FileCommand, FileContent, FileEnding, FileName, Form,
    Frame, JobName, PositionVariable, Protocol, Reply, RobotEvent, Values, Variable, VariableKind, WirePose,
};
use bladescan::stamp::Stamp;
use hw_sim::robot::controller::{Controller, RobotOutput, Settings};
use hw_sim::robot::hses::Port;
use hw_sim::robot::pose::Pose;

struct Cell {
    controller: Controller,
    exchange: Exchange,
    files: Files,
}

impl Cell {
    fn new() -> Self {
        let controller = Controller::new(Settings {
            home: Pose::from_mm_deg([800.0, 0.0, 900.0], [0.0; 3]),
            workspace_min_um: [-2_000_000; 3],
            workspace_max_um: [2_000_000; 3],
            ..Settings::default()
        });
        let exchange = Exchange::new(ExchangeSettings {
            protocol: Protocol::Hses,
            answer_timeout_ms: 300,
            ask_attempts: 3,
            set_repeat_ms: 100,
            set_timeout_ms: 1000,
        });
        let files = Files::new(FileSettings {
            answer_timeout_ms: 300,
            attempts: 3,
        });
        Self {
            controller,
            exchange,
            files,
        }
    }

    /// Hands a datagram to the controller and returns its answers.
    fn answers(&mut self, port: Port, bytes: &[u8]) -> Vec<Vec<u8>> {
        let from = ([127, 0, 0, 1], 5000).into();
        self.controller.handle_datagram(0, port, from, bytes);
        let outputs = std::iter::from_fn(|| self.controller.poll_output());
        outputs
            .map(|output| match output {
                RobotOutput::Datagram { bytes, .. } => bytes,
                RobotOutput::Violation(text) => panic!("the client has broken the protocol: {text}"),
            })
            .collect()
    }

    fn say(&mut self, command: Command) -> RobotEvent {
        self.exchange.say(Stamp::START, command);
        while let Some(robot::RobotOutput::Bytes { bytes, .. }) = self.exchange.poll_output() {
            for answer in self.answers(Port::Robot, &bytes) {
                self.exchange.handle_bytes(Stamp::START, &answer);
            }
        }
        self.exchange.poll_event().expect("an answer, since nothing is lost")
    }

    fn reply(&mut self, command: Command) -> Reply {
        match self.say(command) {
            RobotEvent::Answered { reply, .. } => reply,
            event => panic!("{event:?}"),
        }
    }

    fn transfer(&mut self, command: FileCommand) -> FileEvent {
        self.files.begin(Stamp::START, command).unwrap();
        while let Some(robot::RobotOutput::Bytes { bytes, .. }) = self.files.poll_output() {
            for answer in self.answers(Port::File, &bytes) {
                self.files.handle_datagram(Stamp::START, &answer);
            }
        }
        self.files.poll_event().expect("an end, since nothing is lost")
    }

    fn list(&mut self) -> Vec<String> {
        match self.transfer(FileCommand::List(FileEnding::Jbi)) {
            FileEvent::Listed { names, .. } => names,
            event => panic!("{event:?}"),
        }
    }
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
fn every_question_is_answered() {
    let mut cell = Cell::new();
    let histories = [
        AlarmClass::Major,
        AlarmClass::Minor,
        AlarmClass::UserSystem,
        AlarmClass::UserUser,
        AlarmClass::Offline,
    ]
    .map(|class| Command::AlarmHistory { class, index: 0 });
    let signals = [1, 2, 32].map(|count| Command::ReadSignals {
        first_group: 2701,
        count,
    });
    let questions = [
        Command::Status,
        Command::Alarm(0),
        Command::Alarm(3),
        Command::Position,
        Command::Pulses,
        Command::ExecutingJob,
        Command::SystemInformation,
        Command::ShowText("SCAN 1 OF 36".into()),
    ];
    for question in questions.into_iter().chain(histories).chain(signals) {
        let event = cell.say(question);
        assert!(matches!(event, RobotEvent::Answered { .. }), "{event:?}");
    }
}

#[test]
fn values_are_read_back_as_they_were_written() {
    let mut cell = Cell::new();
    let position = |tool| PositionVariable::Cartesian {
        frame: Frame::Base,
        pose: WirePose {
            position_um: [500_000, -250_000, 750_000],
            rotation_e4_deg: [1_800_000, 0, -900_000],
        },
        form: Form(0b100),
        tool,
    };
    let by_axes = PositionVariable::Pulses {
        pulses: [1000, -2000, 3000, -4, 5, -6, 0, 0],
        tool: 1,
    };
    for values in [
        Values::Byte(vec![200]),
        Values::Byte(vec![7; 50]),
        Values::Integer(vec![-2]),
        Values::Integer(vec![i16::MIN, 0, i16::MAX]),
        Values::Double(vec![i32::MIN]),
        Values::Double(vec![-1; 50]),
        Values::Real(vec![1.5]),
        Values::Real(vec![-0.25, 3e30]),
        Values::Text(vec!["PART-0001".into()]),
        Values::Text(vec!["A".into(), String::new(), "0123456789ABCDEF".into()]),
        Values::Position(vec![position(1)]),
        Values::Position(vec![by_axes]),
        Values::Position((0..9).map(position).collect()),
        Values::Register(vec![0x1234]),
        Values::Register(vec![1, 0xFFFE, 3]),
    ] {
        let (kind, count) = (values.kind(), values.count());
        assert_eq!(cell.reply(write(10, values.clone())), Reply::Done, "{values:?}");
        assert_eq!(cell.reply(read(kind, 10, count)), Reply::Values(values));
    }
    for groups in [vec![0xA5], vec![1, 2, 3, 0xFF]] {
        let first_group = 2701;
        let count = groups.len() as u16;
        let written = cell.reply(Command::WriteSignals {
            first_group,
            groups: groups.clone(),
        });
        assert_eq!(written, Reply::Done);
        assert_eq!(
            cell.reply(Command::ReadSignals { first_group, count }),
            Reply::Signals(groups)
        );
    }
}

#[test]
fn what_the_controller_does_not_have_is_refused_in_words() {
    let mut cell = Cell::new();
    for command in [
        Command::ReadSignals {
            first_group: 9999,
            count: 1,
        },
        read(VariableKind::Double, 60_000, 1),
        // An input from outside cannot be written.
        Command::WriteSignals {
            first_group: 2001,
            groups: vec![1],
        },
    ] {
        let RobotEvent::Refused { refusal, .. } = cell.say(command.clone()) else {
            panic!("{command:?} was not refused")
        };
        assert!(!refusal.words().contains("look it up"), "{}", refusal.words());
    }
}

#[test]
fn a_job_goes_to_the_controller_comes_back_is_deleted_and_can_be_selected() {
    let mut cell = Cell::new();
    let name = FileName::parse("WITNESS.JBI").unwrap();
    let comments: String = (0..60).map(|line| format!("'LINE {line:03} OF THE JOB\r\n")).collect();
    let text = format!(
        "/JOB\r\n//NAME WITNESS\r\n//POS\r\n///NPOS 0,0,0,0,0,0\r\n//INST\r\n///DATE 2026/11/22 07:00\r\n///ATTR SC,RW\r\n\
         ///GROUP1 RB1\r\nNOP\r\n{comments}END\r\n"
    );
    assert!(text.len() > 3 * 400, "several blocks");
    let content = FileContent::new(text.clone().into_bytes()).unwrap();
    let load = FileCommand::Load {
        name: name.clone(),
        content,
    };
    let loaded = FileEvent::Loaded { name: name.clone() };
    assert_eq!(cell.transfer(load.clone()), loaded);
    assert!(cell.list().contains(&"WITNESS.JBI".to_owned()));
    let FileEvent::Saved { content, .. } = cell.transfer(FileCommand::Save(name.clone())) else {
        panic!()
    };
    assert_eq!(String::from_utf8(content).unwrap(), text);
    let deleted = FileEvent::Deleted { name: name.clone() };
    assert_eq!(cell.transfer(FileCommand::Delete(name.clone())), deleted);
    assert!(!cell.list().contains(&"WITNESS.JBI".to_owned()));
    let FileEvent::Refused { refusal, .. } = cell.transfer(FileCommand::Delete(name)) else {
        panic!()
    };
    assert!(refusal.words().contains("file"), "{}", refusal.words());

    assert_eq!(cell.transfer(load), loaded);
    let job = JobName::parse("WITNESS").unwrap();
    for command in [
        Command::ServoOn,
        Command::SetCycle(Cycle::Once),
        Command::SelectJob { job, line: 0 },
    ] {
        assert_eq!(cell.reply(command), Reply::Done);
    }
    let Reply::ExecutingJob(job) = cell.reply(Command::ExecutingJob) else {
        panic!()
    };
    assert_eq!((job.name.as_str(), job.line), ("WITNESS", 0));
}
