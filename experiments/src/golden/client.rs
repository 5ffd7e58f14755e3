//! What the client has to say to golden frames, and what it must understand.

use bladescan::robot::hses::{self, Answer, FileEvent, FileSettings, Files};
use bladescan::robot::{
    AlarmClass, Command, Cycle, FileCommand, FileContent, FileEnding, FileName, Form, Frame, JobName, Move, MovePulses,
    Path, PositionVariable, Reply, RobotOutput, Speed, Values, Variable, VariableKind, WirePose,
};
use bladescan::stamp::Stamp;

/// What a golden request comes from.
pub(super) enum Asked {
    /// A command.
    Command(Command),
    /// A transfer of a file; the controller answers with these blocks (number field, data) in turn.
    Transfer(FileCommand, Vec<(u32, Vec<u8>)>),
}

/// The pose of the golden move and position.
const POSE: WirePose = WirePose {
    position_um: [500_000, -250_000, 750_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};

/// The pose that the two clients were given.
const PEERS_POSE: WirePose = WirePose {
    position_um: [100_000, -200_000, 300_000],
    rotation_e4_deg: [1_800_000, 0, -900_000],
};

const LAST: u32 = 0x8000_0000;

/// What the golden request `name` says; the text of the frame is of the file that goes.
pub(super) fn asked(name: &str, text: &[u8]) -> Option<Asked> {
    use VariableKind::{Byte, Double, Position, Register};
    let block = |number: u32| vec![(number, b"x".to_vec())];
    Some(Asked::Command(match name {
        "req_status_0x72_all" | "status_0x72" => Command::Status,
        "req_alarm_0x70_1_all" | "alarm_0x70_1" => Command::Alarm(0),
        "req_alarm_hist_0x71_1001_all" | "alarm_hist_0x71_1001" => {
            let class = AlarmClass::Minor;
            Command::AlarmHistory { class, index: 0 }
        }
        "job_0x73" => Command::ExecutingJob,
        "req_position_base_R1" | "pos_cart_0x75_101" => Command::Position,
        "pos_pulse_0x75_1" => Command::Pulses,
        "sysinfo_0x89_11" => Command::SystemInformation,
        "req_hold_on" | "hold_on_0x83_1" => Command::HoldOn,
        "req_hold_off" | "hold_off_0x83_1" => Command::HoldOff,
        "req_servo_on" | "servo_on_0x83_2" => Command::ServoOn,
        "req_servo_off" | "servo_off_0x83_2" => Command::ServoOff,
        "req_alarm_reset" | "alarm_reset_0x82_1" => Command::AlarmReset,
        "req_error_cancel" | "error_cancel_0x82_2" => Command::ErrorCancel,
        "req_cycle_1cycle" => Command::SetCycle(Cycle::Once),
        "req_cycle_auto" | "cycle_auto_0x84_2" => Command::SetCycle(Cycle::Continuous),
        "pendant_text_0x85" => Command::ShowText("SCAN".into()),
        "req_start_job" | "job_start_0x86" => Command::StartJob,
        "req_select_job_SCAN1_line0" => select("SCAN1"),
        "job_select_0x87" => select("SCANJOB"),
        "io_read_0x78_2701" => signals(1),
        "plural_io_read_0x300" => signals(2),
        "reg_read_0x79_5" => read(Register, 5, 1),
        "reg_write_0x79_5" => write(5, Values::Register(vec![0x1234])),
        "b_read_0x7a_0" => read(Byte, 0, 1),
        "req_read_B10" => read(Byte, 10, 1),
        "b_write_0x7a_7" => write(7, Values::Byte(vec![200])),
        "req_write_B10_5" => write(10, Values::Byte(vec![5])),
        "plural_b_read_0x302" => read(Byte, 0, 4),
        "i_write_0x7b_3" => write(3, Values::Integer(vec![-2])),
        "d_read_0x7c_1" => read(Double, 1, 1),
        "req_read_D42" => read(Double, 42, 1),
        "d_write_0x7c_1" => write(1, Values::Double(vec![-123_456])),
        "req_write_D42_7" => write(42, Values::Double(vec![7])),
        "req_plural_read_D100_x3" => read(Double, 100, 3),
        "plural_d_read_0x304" => read(Double, 10, 3),
        "plural_d_write_0x304" => write(10, Values::Double(vec![1, -2, 3])),
        "r_write_0x7d_2" => write(2, Values::Real(vec![1.5])),
        "s16_write_0x7e_1" => write(1, Values::Text(vec!["PART-0001".into()])),
        "req_read_P5_all" => read(Position, 5, 1),
        "p_read_0x7f_10" => read(Position, 10, 1),
        "plural_p_read_0x307" => read(Position, 0, 2),
        "req_write_P5_base" => write(5, Values::Position(vec![cartesian(Frame::Base, POSE, 0)])),
        "p_write_0x7f_10" => write(10, Values::Position(vec![cartesian(Frame::Robot, PEERS_POSE, 4)])),
        "req_move_cart_linear_base_50mm_s" => straight(POSE),
        "mov_cart_0x8a_linear" => straight(PEERS_POSE),
        "req_move_pulse_link_5pct" => by_axes([1000, -2000, 3000, 0, 0, 0, 0, 0]),
        "mov_pulse_0x8b_joint" => by_axes([1000, -2000, 3000, 4000, 5000, -6000, 0, 0]),
        _ => {
            let (command, blocks) = match name {
                "file_req_list_JBI" => (FileCommand::List(FileEnding::Jbi), vec![]),
                "file_list" | "file_client_ack_list_last" => (FileCommand::List(FileEnding::Jbi), block(LAST | 1)),
                "file_req_save_SCAN1" => (FileCommand::Save(file("SCAN1.JBI")), vec![]),
                "file_save_recv" => (FileCommand::Save(file("AAA.JBI")), block(LAST | 1)),
                "file_req_load_SCAN1" => (load("SCAN1.JBI", b"x"), vec![]),
                "file_load_block1_last" => (load("SCAN1.JBI", text), vec![(0, vec![])]),
                "file_load_send" => (load("AAA.JBI", text), vec![(0, vec![])]),
                "file_req_delete_SCAN1" => (FileCommand::Delete(file("SCAN1.JBI")), vec![]),
                "file_delete" => (FileCommand::Delete(file("AAA.JBI")), vec![]),
                _ => return None,
            };
            return Some(Asked::Transfer(command, blocks));
        }
    }))
}

/// Why the client does not say what the golden request `name` says.
pub(super) fn left_out(name: &str) -> Option<&'static str> {
    Some(match name {
        "axiscfg_0x74_101" => "names of axes: a station file knows its robot",
        "poserr_0x76_1" => "position error: nothing is decided by it",
        "torque_0x77_1" => "torque: nothing is decided by it",
        "hlock_on_0x83_3" => "a scan does not lock people out of their pendant",
        "mgmt_time_0x88_1" => "operating hours: nothing is decided by them",
        "s32_write_0x8c_1" => "texts of 32 bytes: sources disagree whether a DX200 has them",
        "alarm_sub_0x30a" => "alarms with sub-texts: not known of a DX200; 0x70 tells code and name",
        _ => return None,
    })
}

/// Words of the golden request `name` in which we differ by choice: index of the 4-byte word of the data, and why.
pub(super) fn chosen_words(name: &str) -> &'static [(usize, &'static str)] {
    match name {
        "mov_cart_0x8a_linear" => &[
            (4, "we move in the base frame (16), not in the robot's (17)"),
            (13, "we send no configuration where bit 7 says keep it"),
        ],
        _ => &[],
    }
}

/// The datagrams that the client sends, with the id `id`.
pub(super) fn sent(asked: &Asked, id: u8) -> Vec<Vec<u8>> {
    match asked {
        Asked::Command(command) => hses::request(command, id)
            .into_iter()
            .map(|request| request.encode())
            .collect(),
        Asked::Transfer(command, blocks) => {
            let mut files = files(command);
            let mut datagrams: Vec<Vec<u8>> = Vec::new();
            let mut blocks = blocks.iter();
            loop {
                while let Some(RobotOutput::Bytes { bytes, .. }) = files.poll_output() {
                    datagrams.push(bytes);
                }
                let (Some((number, data)), Some(request)) = (blocks.next(), datagrams.first()) else {
                    break;
                };
                files.handle_datagram(Stamp::START, &block_answer(request, *number, data));
            }
            for datagram in &mut datagrams {
                datagram[11] = id;
            }
            datagrams
        }
    }
}

/// The controller's frame `number` in answer to the file request `request`.
fn block_answer(request: &[u8], number: u32, data: &[u8]) -> Vec<u8> {
    let mut bytes = request[..24].to_vec();
    bytes[6..8].copy_from_slice(&(data.len() as u16).to_le_bytes());
    bytes[10] = 1;
    bytes[12..16].copy_from_slice(&number.to_le_bytes());
    bytes.extend([request[29] | 0x80, 0, 0, 0, 0, 0, 0, 0]);
    bytes.extend(data);
    bytes
}

/// Whether the client reads a golden answer as what it is; `None` for an answer that it has no use for.
pub(super) fn understood(name: &str, bytes: &[u8]) -> Option<bool> {
    let answer = Answer::decode(bytes).ok();
    let reply = |command: Command| answer.as_ref().and_then(|answer| hses::reply(&command, answer).ok());
    let refused = |status, added| {
        answer
            .as_ref()
            .is_some_and(|answer| (answer.status, answer.added_status) == (status, added))
    };
    Some(match name {
        "ans_status_play_remote_servo_on" => {
            matches!(reply(Command::Status), Some(Reply::Status(status)) if status.remote() && status.servo_on() && !status.running())
        }
        "ans_status_running" => matches!(reply(Command::Status), Some(Reply::Status(status)) if status.running()),
        "ans_status_hold_alarm" => {
            matches!(reply(Command::Status), Some(Reply::Status(status)) if status.held_by_command() && status.alarm())
        }
        "ans_set_ok" => reply(Command::HoldOn) == Some(Reply::Done),
        "ans_err_2010_on_move" => refused(0x1F, 0x2010),
        "ans_err_2100_cmd_remote_not_set" => refused(0x1F, 0x2100),
        "ans_err_3450_servo_on_refused" => refused(0x1F, 0x3450),
        "ans_err_undefined_command_0x08" => refused(0x08, 0),
        "ans_position_base_R1" => {
            matches!(reply(Command::Position), Some(Reply::Position(position)) if position.base_from_tool == POSE && position.tool == 1)
        }
        "ans_alarm_none" => reply(Command::Alarm(0)) == Some(Reply::Alarm(None)),
        "ans_alarm_4315" => matches!(reply(Command::Alarm(0)), Some(Reply::Alarm(Some(alarm))) if alarm.code == 4315),
        "ans_jobinfo_SCAN1" => {
            matches!(reply(Command::ExecutingJob), Some(Reply::ExecutingJob(job)) if job.name == "SCAN1" && (job.line, job.step) == (12, 3))
        }
        "file_data_list_last" => {
            matches!(came(&FileCommand::List(FileEnding::Jbi), bytes), Some(FileEvent::Listed { names, .. }) if names == ["SCAN1.JBI", "SCAN2.JBI"])
        }
        "file_ans_load_ready" => {
            let mut files = files(&load("SCAN1.JBI", b"x"));
            let request = files.poll_output();
            files.handle_datagram(Stamp::START, bytes);
            request.is_some() && files.poll_output().is_some() && files.poll_event().is_none()
        }
        "file_err_E2B3_not_found" => {
            matches!(came(&FileCommand::Save(file("SCAN1.JBI")), bytes), Some(FileEvent::Refused { refusal, .. }) if refusal.added_status == 0xE2B3)
        }
        _ => return None,
    })
}

/// What came of a transfer that got one answer.
fn came(command: &FileCommand, answer: &[u8]) -> Option<FileEvent> {
    let mut files = files(command);
    files.handle_datagram(Stamp::START, answer);
    files.poll_event()
}

fn files(command: &FileCommand) -> Files {
    let mut files = Files::new(FileSettings {
        answer_timeout_ms: 1000,
        attempts: 3,
    });
    files.begin(Stamp::START, command.clone()).expect("nothing is open");
    files
}

fn file(name: &str) -> FileName {
    FileName::parse(name).expect("a file name")
}

fn load(name: &str, text: &[u8]) -> FileCommand {
    FileCommand::Load {
        name: file(name),
        content: FileContent::new(text.to_vec()).unwrap_or_else(|_| FileContent::new(vec![b'x']).expect("one byte")),
    }
}

fn select(job: &str) -> Command {
    Command::SelectJob {
        job: JobName::parse(job).expect("a job's name"),
        line: 0,
    }
}

fn signals(count: u16) -> Command {
    Command::ReadSignals {
        first_group: 2701,
        count,
    }
}

fn read(kind: VariableKind, index: u16, count: u16) -> Command {
    let first = Variable { kind, index };
    Command::Read { first, count }
}

fn write(index: u16, values: Values) -> Command {
    let kind = values.kind();
    let first = Variable { kind, index };
    Command::Write { first, values }
}

fn cartesian(frame: Frame, pose: WirePose, form: u8) -> PositionVariable {
    PositionVariable::Cartesian {
        frame,
        pose,
        form: Form(form),
        tool: 1,
    }
}

fn straight(base_from_tool: WirePose) -> Command {
    Command::Move(Move {
        base_from_tool,
        path: Path::Straight,
        speed: Speed::ToolPoint(500),
        tool: 1,
    })
}

fn by_axes(pulses: [i32; 8]) -> Command {
    Command::MovePulses(MovePulses {
        pulses,
        path: Path::Link,
        speed: Speed::Link(500),
        tool: 1,
    })
}
