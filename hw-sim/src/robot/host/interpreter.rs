//! Commands of host control, each read and carried out on the controller.

use crate::checks::refuse_first;
use crate::robot::controller::Controller;
use crate::robot::host::arguments::{Arguments, decimal, integer, integers, list};
use crate::robot::host::variable::{coordinate, form_of_host, host_form, kind, pose, pose_text, value, value_text};
use crate::robot::host::{self, Call, bytes};
use crate::robot::job::instruction::Instruction;
use crate::robot::moves::{CartesianOrder, FORM_IS_GIVEN, OrderedSpeed, Path, PulseOrder};
use crate::robot::pose::Pose;
use crate::robot::refused::{Answer, Refused};
use crate::robot::switches::{Cycle, Mode};

/// Carries a command out. Its name may be of small letters; trailing ends of line do not count.
pub fn interpret(controller: &mut Controller, now_ns: u64, call: &Call) -> host::Answer {
    match carry_out(controller, now_ns, call) {
        Ok(Outcome::Done) => host::Answer::Done,
        Ok(Outcome::Data(data)) => host::Answer::Data(data),
        Ok(Outcome::Later(look_ns)) => host::Answer::Later(look_ns),
        Err(refused) => host::Answer::Refused(interpreter_code(refused)),
    }
}

/// What a command comes to that is not refused.
enum Outcome {
    Done,
    Data(String),
    Later(u64),
}

impl From<()> for Outcome {
    fn from((): ()) -> Self {
        Self::Done
    }
}

impl From<String> for Outcome {
    fn from(data: String) -> Self {
        Self::Data(data)
    }
}

fn carry_out(controller: &mut Controller, now_ns: u64, call: &Call) -> Answer<Outcome> {
    let data = call.data.trim_end_matches(['\r', '\n']);
    let arguments = Arguments::read(data);
    Ok(match call.name.to_ascii_uppercase().as_str() {
        "RALARM" => alarms(controller, now_ns, &arguments)?.into(),
        "RPOSJ" => pulses(controller, now_ns, &arguments)?.into(),
        "RPOSC" => position(controller, now_ns, &arguments)?.into(),
        "RSTATS" => {
            arguments.none()?;
            list(controller.status(now_ns)).into()
        }
        "RGROUP" => {
            arguments.none()?;
            list([ROBOT_1, NO_STATION, MASTER_TASK]).into()
        }
        "RJSEQ" => {
            arguments.none()?;
            let job = controller.executing_job(now_ns);
            refuse_first([(job.name.is_empty(), Refused::NO_JOB_SELECTED)])?;
            list([job.name, job.line.to_string(), job.step.to_string()]).into()
        }
        "RJDIR" => directory(controller, &arguments)?.into(),
        "START" => controller.start(now_ns, arguments.at_most_one()?)?.into(),
        "SETMJ" => {
            let [name] = arguments.exactly()?;
            controller.set_master_job(now_ns, MASTER_TASK as u16, name)?.into()
        }
        "GETMJ" => {
            arguments.none()?;
            let name = controller.master_job(now_ns, MASTER_TASK as u16)?;
            name.ok_or(Refused::NO_JOB_SELECTED)?.into()
        }
        "JSEQ" => {
            let [name, line] = arguments.exactly()?;
            let line: u32 = integer(line)?;
            refuse_first([(line > LINE_MAX, Refused::OPERAND_RANGE)])?;
            controller.select_job(now_ns, name, line)?.into()
        }
        "DELETE" => delete(controller, now_ns, &arguments)?.into(),
        "JWAIT" => wait(controller, now_ns, call, &arguments)?,
        "HOLD" => controller.set_hold(now_ns, arguments.flag()?)?.into(),
        "SVON" => controller.set_servo(now_ns, arguments.flag()?)?.into(),
        "HLOCK" => controller.set_pendant_lock(now_ns, arguments.flag()?)?.into(),
        "RESET" => {
            arguments.none()?;
            controller.reset_alarms(now_ns)?.into()
        }
        "CANCEL" => {
            arguments.none()?;
            controller.cancel_error(now_ns)?.into()
        }
        "MODE" => controller.set_mode(now_ns, mode(&arguments)?)?.into(),
        "CYCLE" => controller.set_cycle(now_ns, cycle(&arguments)?)?.into(),
        "MDSP" => controller.show_text(now_ns, &bytes(data))?.into(),
        "CGROUP" => {
            let groups: [&str; 2] = arguments.exactly()?;
            refuse_first([(integers(&groups)? != [ROBOT_1, NO_STATION], Refused(WRONG_GROUP))])?.into()
        }
        "CTASK" => {
            let task: [&str; 1] = arguments.exactly()?;
            let [task] = integers(&task)?;
            refuse_first([
                (!(0..16).contains(&task), Refused::OPERAND_RANGE),
                (task != MASTER_TASK, Refused(WRONG_GROUP)),
            ])?
            .into()
        }
        "IOREAD" => read_signals(controller, now_ns, &arguments)?.into(),
        "IOWRITE" => write_signals(controller, now_ns, &arguments)?.into(),
        "SAVEV" => {
            let [kind_number, index] = arguments.exactly()?;
            let (kind, index) = (kind(kind_number)?, integer(index)?);
            value_text(&controller.variable(now_ns, kind, index)?).into()
        }
        "LOADV" => {
            let ([kind_number, index], texts) = arguments.at_least()?;
            let (value, index) = (value(kind(kind_number)?, texts)?, integer(index)?);
            controller.set_variable(now_ns, index, value)?.into()
        }
        "MOVJ" => {
            let [speed, place @ ..] = arguments.exactly::<16>()?;
            let speed = percent(speed)?;
            let order = cartesian(place, Path::Link, speed, Target::Absolute)?;
            controller.move_cartesian(now_ns, &order)?.into()
        }
        "MOVL" => line(controller, now_ns, &arguments, Target::Absolute)?.into(),
        "IMOV" => line(controller, now_ns, &arguments, Target::Increment)?.into(),
        "PMOVJ" => {
            let [speed, pulses @ ..] = arguments.exactly::<14>()?;
            let order = pulse_order(pulses, Path::Link, percent(speed)?)?;
            controller.move_pulses(now_ns, &order)?.into()
        }
        "PMOVL" => {
            let [class, speed, pulses @ ..] = arguments.exactly::<15>()?;
            let order = pulse_order(pulses, Path::Straight, tool_speed(class, speed)?)?;
            controller.move_pulses(now_ns, &order)?.into()
        }
        _ => return Err(Refused::COMMAND),
    })
}

/// Code and data of the error, then of four alarms.
fn alarms(controller: &mut Controller, now_ns: u64, arguments: &Arguments) -> Answer<String> {
    arguments.none()?;
    let error = if controller.has_error { [ERROR_CODE, 0] } else { [0, 0] };
    let mut numbers = error.to_vec();
    for number in 1..=4 {
        let alarm = controller.alarm(now_ns, number)?;
        numbers.extend(alarm.map_or([0, 0], |alarm| [alarm.code, alarm.data]));
    }
    Ok(list(numbers))
}

fn pulses(controller: &mut Controller, now_ns: u64, arguments: &Arguments) -> Answer<String> {
    arguments.none()?;
    let axes = controller.position_pulses(now_ns).axes;
    Ok(list(axes.into_iter().chain([0; AXIS_FIELDS - 8])))
}

/// X to TZ, type and tool; after them, when asked for, the external axes.
fn position(controller: &mut Controller, now_ns: u64, arguments: &Arguments) -> Answer<String> {
    let [frame, has_external] = arguments.exactly()?;
    let frame = coordinate(frame)?;
    let has_external = Arguments::read(has_external).flag()?;
    refuse_first([(frame.user != 0, Refused(NO_USER_FRAME))])?;
    let position = controller.position_base(now_ns);
    let [x, y, z, rx, ry, rz, external @ ..] = position.axes;
    let mut text = format!(
        "{},{},{}",
        pose_text([x, y, z, rx, ry, rz]),
        host_form(position.form),
        position.tool
    );
    if has_external {
        let external = external.into_iter().chain([0; AXIS_FIELDS - 8]);
        text = format!("{text},{}", list(external));
    }
    Ok(text)
}

/// Names of all jobs for `*`; for a job, which the sheet calls the parent, those of the jobs it calls.
fn directory(controller: &Controller, arguments: &Arguments) -> Answer<String> {
    let [parent] = arguments.exactly()?;
    if parent == "*" {
        return Ok(list(controller.job_names()));
    }
    let job = controller.files.job(parent).ok_or(Refused::NO_SUCH_JOB)?;
    let mut called: Vec<&str> = Vec::new();
    for instruction in &job.instructions {
        if let Instruction::Call { job, .. } = instruction {
            called.push(job);
        }
    }
    called.sort_unstable();
    called.dedup();
    Ok(list(called))
}

/// Deletes a job; for `*` every one that may be deleted.
fn delete(controller: &mut Controller, now_ns: u64, arguments: &Arguments) -> Answer<()> {
    let [name] = arguments.exactly()?;
    if name != "*" {
        return controller.delete_file(now_ns, &format!("{name}.JBI"));
    }
    for name in controller.job_names() {
        match controller.delete_file(now_ns, &format!("{name}.JBI")) {
            Ok(()) | Err(Refused::FILE_KEPT) => (),
            Err(refused) => return Err(refused),
        }
    }
    Ok(())
}

/// 0 once what runs has come to its end, -1 when something stopped it or the time is over. The client's time is real time,
/// whatever the speed of the simulation; -1 waits for ever.
fn wait(controller: &mut Controller, now_ns: u64, call: &Call, arguments: &Arguments) -> Answer<Outcome> {
    let [limit_s] = arguments.exactly()?;
    let limit_s: i32 = integer(limit_s)?;
    refuse_first([(!(-1..=32_767).contains(&limit_s), Refused::OPERAND_RANGE)])?;
    let [word_1, word_2] = controller.status(now_ns);
    if word_1 & RUNNING == 0 {
        let is_done = word_1 & PLAY != 0 && word_2 & STOPPED == 0 && word_2 & SERVO_ON != 0;
        return Ok(Outcome::Data(if is_done { "0" } else { "-1" }.to_owned()));
    }
    let limit_ns = u64::try_from(limit_s).map(|limit_s| call.since_ns + limit_s * 1_000_000_000);
    match limit_ns {
        Ok(limit_ns) if limit_ns <= now_ns => Ok(Outcome::Data("-1".to_owned())),
        Ok(limit_ns) => Ok(Outcome::Later(limit_ns.min(now_ns + LOOK_NS))),
        Err(_) => Ok(Outcome::Later(now_ns + LOOK_NS)),
    }
}

fn mode(arguments: &Arguments) -> Answer<Mode> {
    match arguments.exactly()? {
        ["1"] => Ok(Mode::Teach),
        ["2"] => Ok(Mode::Play),
        [_] => Err(Refused::OPERAND_RANGE),
    }
}

fn cycle(arguments: &Arguments) -> Answer<Cycle> {
    match arguments.exactly()? {
        ["1"] => Ok(Cycle::Step),
        ["2"] => Ok(Cycle::Once),
        ["3"] => Ok(Cycle::Auto),
        [_] => Err(Refused::OPERAND_RANGE),
    }
}

/// First byte and count of bytes of signals that begin with a whole byte.
fn signal_bytes(start: &str, bit_count: &str) -> Answer<(u16, u16)> {
    let (start, bit_count): (u32, u16) = (integer(start)?, integer(bit_count)?);
    let first = u16::try_from(start / 10).map_err(|_| Refused::OPERAND_RANGE)?;
    let is_whole = start % 10 == 0 && bit_count % 8 == 0;
    refuse_first([(
        !is_whole || !(1..=SIGNAL_BYTES_MAX).contains(&(bit_count / 8)),
        Refused::OPERAND_RANGE,
    )])?;
    Ok((first, bit_count / 8))
}

fn read_signals(controller: &mut Controller, now_ns: u64, arguments: &Arguments) -> Answer<String> {
    let [start, bit_count] = arguments.exactly()?;
    let (first, count) = signal_bytes(start, bit_count)?;
    let bytes: Vec<u8> = (0..count)
        .map(|at| controller.signal_byte(now_ns, first.saturating_add(at)))
        .collect::<Answer<_>>()?;
    Ok(list(bytes))
}

/// Sets nothing unless everything can be set.
fn write_signals(controller: &mut Controller, now_ns: u64, arguments: &Arguments) -> Answer<()> {
    let ([start, bit_count], texts) = arguments.at_least()?;
    let (first, count) = signal_bytes(start, bit_count)?;
    refuse_first([(texts.len() != usize::from(count), Refused::OPERAND_COUNT)])?;
    let bytes: Vec<u8> = texts.iter().map(|text| integer(text)).collect::<Answer<_>>()?;
    let mut trial = controller.clone();
    for (at, byte) in (0..count).zip(bytes) {
        trial.set_signal_byte(now_ns, first.saturating_add(at), byte)?;
    }
    *controller = trial;
    Ok(())
}

/// Whether a pose is the target or leads to it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Target {
    Absolute,
    Increment,
}

fn line(controller: &mut Controller, now_ns: u64, arguments: &Arguments, target: Target) -> Answer<()> {
    let [class, speed, place @ ..] = arguments.exactly::<17>()?;
    let order = cartesian(place, Path::Straight, tool_speed(class, speed)?, target)?;
    controller.move_cartesian(now_ns, &order)
}

/// Coordinate, pose, type, tool, external axes.
fn cartesian(fields: [&str; 15], path: Path, speed: OrderedSpeed, target: Target) -> Answer<CartesianOrder> {
    let [frame, x, y, z, rx, ry, rz, form, tool, external @ ..] = fields;
    let frame = coordinate(frame)?;
    let (position_um, turn_e4_deg) = pose([x, y, z, rx, ry, rz])?;
    let form: i32 = integer(form)?;
    refuse_first([
        (!(0..64).contains(&form), Refused::OPERAND_RANGE),
        (integers(&external)? != [0; 6], Refused::OPERAND_RANGE),
        (frame.user != 0, Refused(NO_USER_FRAME)),
    ])?;
    let is_increment = target == Target::Increment;
    Ok(CartesianOrder {
        path,
        is_increment,
        speed,
        coordinate: frame.code,
        pose: Pose {
            position_um,
            turn_e4_deg,
        },
        // A text has no bit that says "as it is": the type is meant. Beside an increment it means nothing.
        form: if is_increment {
            0
        } else {
            form_of_host(form) | FORM_IS_GIVEN
        },
        form_ext: 0,
        tool: integer(tool)?,
        user: frame.user,
    })
}

/// Twelve axes and the tool.
fn pulse_order(fields: [&str; 13], path: Path, speed: OrderedSpeed) -> Answer<PulseOrder> {
    let [pulses @ .., tool] = fields;
    let [s, l, u, r, b, t, seventh, eighth, others @ ..]: [i32; AXIS_FIELDS] = integers(&pulses)?;
    refuse_first([(others != [0; AXIS_FIELDS - 8], Refused::OPERAND_RANGE)])?;
    Ok(PulseOrder {
        path,
        speed,
        pulses: [s, l, u, r, b, t, seventh, eighth],
        tool: integer(tool)?,
    })
}

/// Share of the fastest move, in percent.
fn percent(text: &str) -> Answer<OrderedSpeed> {
    Ok(OrderedSpeed {
        class: 0,
        value: decimal(text, 2)?,
    })
}

/// Of the tool point in mm/s, or of the turn in degrees a second.
fn tool_speed(class: &str, speed: &str) -> Answer<OrderedSpeed> {
    let class = match class {
        "0" => 1,
        "1" => 2,
        _ => return Err(Refused::OPERAND_RANGE),
    };
    Ok(OrderedSpeed {
        class,
        value: decimal(speed, 1)?,
    })
}

/// The refusal as the interpreter says it, whose codes end at 5480: those of HSES alone have one that means the same, or
/// else 1012, operand out of range. Which one a DX200 says is unknown.
pub(super) fn interpreter_code(refused: Refused) -> u16 {
    match refused {
        Refused(code @ ..=INTERPRETER_CODE_MAX) => code,
        Refused::POSITION_UNDEFINED => Refused::POSITION_MISSING.0,
        Refused::USE_FORBIDDEN => NOT_ACCESSIBLE,
        Refused::DATA_SIZE => Refused::OPERAND_COUNT.0,
        Refused::USER_FRAME => NO_USER_FRAME,
        Refused::GROUP => WRONG_GROUP,
        Refused::FILE_NOT_REMOTE => Refused::NOT_REMOTE.0,
        Refused::FILE_NOT_FOUND => Refused::NO_SUCH_JOB.0,
        _ => Refused::OPERAND_RANGE.0,
    }
}

/// Bits of the groups: the robot, and no station.
const ROBOT_1: i32 = 1;
const NO_STATION: i32 = 0;
const MASTER_TASK: i32 = 0;
/// Axes of the robot and six external ones.
const AXIS_FIELDS: usize = 12;
/// Of one IOREAD or IOWRITE.
const SIGNAL_BYTES_MAX: u16 = 256;
/// Largest line of JSEQ.
const LINE_MAX: u32 = 9999;
/// While something runs, JWAIT looks this often.
const LOOK_NS: u64 = 10_000_000;
/// Code that RALARM gives an error. The simulator's own choice of number.
const ERROR_CODE: u32 = 1;
const INTERPRETER_CODE_MAX: u16 = 0x5480;
const NOT_ACCESSIBLE: u16 = 0x2110;
const NO_USER_FRAME: u16 = 0x3350;
const WRONG_GROUP: u16 = 0x3370;
const RUNNING: u32 = 1 << 3;
const PLAY: u32 = 1 << 6;
/// Holds, alarm, error.
const STOPPED: u32 = 0b11_1110;
const SERVO_ON: u32 = 1 << 6;

#[cfg(test)]
#[path = "interpreter_tests.rs"]
mod tests;
