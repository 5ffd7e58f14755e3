//! The table of section 3.1: what each request gets in each state.

use super::bench::{Bench, arm, hello, is_error, require, trigger, trigger_ok, unexpected};
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::{Heard, LineId, server_message};
use crate::camera::message::{
    AcquisitionPhase, CameraState, ClientMessage, Repeated, ServerMessage, TRIGGER_ALL, TriggerId,
};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Device,
        "3.1-idle",
        "IDLE: CONFIGURE, ARM, DISARM, ABORT are taken; ARM with another config id 206, TRIGGER 202, HELLO again 203",
        "every request of the table in IDLE",
        idle,
    ),
    clause(
        Needs::Device,
        "3.1-armed",
        "ARMED: CONFIGURE and ARM get 203, HELLO again 203; DISARM and ABORT are taken, ABORT leaves it ARMED",
        "every request of the table but TRIGGER in ARMED",
        armed,
    ),
    clause(
        Needs::Exposures,
        "3.1-exposing",
        "EXPOSING: CONFIGURE, ARM, DISARM and HELLO get 203, another TRIGGER 204, the same one `repeated` 1, FETCH of another 602",
        "TRIGGER and every request of the table in one piece",
        exposing,
    ),
    clause(
        Needs::Exposures,
        "3.1-reconstructing",
        "RECONSTRUCTING: as EXPOSING",
        "every request of the table as soon as EXPOSURE_DONE has come",
        |bench| busy_after(bench, 0x22),
    ),
    clause(
        Needs::Exposures,
        "3.1-sending",
        "SENDING: as EXPOSING, but FETCH of another gets 204",
        "every request of the table as soon as FRAME_BEGIN of a large frame has come",
        |bench| busy_after(bench, 0x30),
    ),
    clause(
        Needs::Nothing,
        "3.1-offline",
        "OFFLINE: CONFIGURE, ARM and TRIGGER get 501; DISARM and ABORT are taken",
        "every request of the table, where the server is OFFLINE",
        |bench| away(bench, CameraState::Offline, 501),
    ),
    clause(
        Needs::Nothing,
        "3.1-fault",
        "FAULT: CONFIGURE, ARM and TRIGGER get 500; DISARM and ABORT are taken",
        "every request of the table, where the server is in FAULT",
        |bench| away(bench, CameraState::Fault, 500),
    ),
    clause(
        Needs::Nothing,
        "3.1-resetting",
        "RESETTING: CONFIGURE, ARM and TRIGGER get 504; DISARM and ABORT are taken",
        "every request of the table, where the server is RESETTING",
        |bench| away(bench, CameraState::Resetting, 504),
    ),
    clause(
        Needs::Device,
        "3.1-order",
        "a request is checked in this order: bytes (108), role (207), state, values",
        "TRIGGER with a wrong config id in IDLE (202); CONFIGURE with an exposure of 0 in ARMED (203)",
        |bench| {
            let line = bench.controller()?;
            let settings = bench.context.small;
            let configured = bench.configure(line, &settings)?;
            let wrong = bench.trigger(0, configured.config_id.wrapping_add(7));
            bench.refused(line, &wrong, 202)?;
            bench.arm(line, configured.config_id)?;
            let mut unfit = settings;
            unfit.exposure_us = 0;
            bench.refused(line, &ClientMessage::Configure(unfit), 203).map(|_| ())
        },
    ),
];

fn idle(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let line = bench.controller()?;
    bench.is_in(line, CameraState::Idle)?;
    reads(bench, line)?;
    says_hello_again(bench, line)?;
    is_disarmed(bench, line, CameraState::Idle)?;
    aborts_nothing(bench, line)?;
    let never = TriggerId::new(bench.view, 9);
    bench.refused(line, &ClientMessage::Fetch { trigger_id: never }, 602)?;
    let settings = bench.context.small;
    let configured = bench.configure(line, &settings)?;
    let request = bench.trigger(0, configured.config_id);
    bench.refused(line, &request, 202)?;
    bench.refused(line, &arm(configured.config_id.wrapping_add(7)), 206)?;
    bench.arm(line, configured.config_id)?;
    bench.is_in(line, CameraState::Armed)
}

fn armed(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let settings = bench.context.small;
    let (line, configured) = bench.armed(&settings)?;
    reads(bench, line)?;
    says_hello_again(bench, line)?;
    bench.refused(line, &ClientMessage::Configure(settings), 203)?;
    bench.refused(line, &arm(configured.config_id), 203)?;
    let never = TriggerId::new(bench.view, 9);
    bench.refused(line, &ClientMessage::Fetch { trigger_id: never }, 602)?;
    aborts_nothing(bench, line)?;
    bench.is_in(line, CameraState::Armed)?;
    is_disarmed(bench, line, CameraState::Idle)?;
    is_disarmed(bench, line, CameraState::Idle)
}

/// OFFLINE, FAULT or RESETTING, where the server is in it.
fn away(bench: &mut Bench<'_, '_>, state: CameraState, code: u16) -> Result<(), Miss> {
    if bench.context.state != state {
        let found = bench.context.state;
        return Err(Miss::Skipped(format!(
            "cannot be brought about from here: the server is {found:?}"
        )));
    }
    let line = bench.controller()?;
    gets_what_the_table_says(bench, line, state, code)
}

/// Every request of the table while the device is away.
pub(super) fn gets_what_the_table_says(
    bench: &mut Bench<'_, '_>,
    line: LineId,
    state: CameraState,
    code: u16,
) -> Result<(), Miss> {
    reads(bench, line)?;
    says_hello_again(bench, line)?;
    let settings = bench.context.small;
    for request in [ClientMessage::Configure(settings), arm(1), bench.trigger(9, 1)] {
        bench.refused(line, &request, code)?;
    }
    is_disarmed(bench, line, state)?;
    aborts_nothing(bench, line)
}

/// Everything in one piece with the trigger, so that all of it arrives during the exposure.
fn exposing(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let settings = bench.context.small;
    let (line, configured) = bench.armed(&settings)?;
    let start = bench.trigger(0, configured.config_id);
    let (mut bytes, started) = bench.lines.frame(line, &start);
    let asked = busy_requests(bench, line, configured.config_id, Gets::Code(602), &mut bytes);
    bench.lines.send(line, bytes);
    trigger_ok(&bench.reply(line, started, &start)?)?;
    for request in &asked {
        let heard = bench.reply(line, request.id, &request.message)?;
        request.is_answered_by(&heard)?;
    }
    let course = bench.follow(line, 0, &configured)?;
    course.is_complete()?;
    bench.is_in(line, CameraState::Armed)
}

/// Everything as soon as a frame of this type has come. What is answered only after the end counts for nothing.
fn busy_after(bench: &mut Bench<'_, '_>, kind: u16) -> Result<(), Miss> {
    let settings = match kind {
        0x30 => bench.context.large,
        _ => bench.context.small,
    };
    let (line, configured) = bench.armed(&settings)?;
    bench.start(line, 0, configured.config_id)?;
    let id = bench.trigger_id(0);
    let limit_ms = super::bench::frame_ms(&configured);
    let mut course = super::course::Course::default();
    let (step, no_frame) = match kind {
        0x30 => ("FRAME_BEGIN", Gets::Code(204)),
        _ => ("EXPOSURE_DONE", Gets::NoFrame),
    };
    while course.steps.last() != Some(&step) {
        course.step(bench.lines, line, id, limit_ms)?;
    }
    let mut bytes = Vec::new();
    let asked = busy_requests(bench, line, configured.config_id, no_frame, &mut bytes);
    bench.lines.send(line, bytes);
    let mut answers = Vec::new();
    for request in &asked {
        answers.push(bench.reply(line, request.id, &request.message)?);
    }
    course.go_on(bench.lines, line, id, limit_ms)?;
    course.is_complete()?;
    let ended_at = course.ends[0].0;
    if answers.iter().any(|answer| answer.at >= ended_at) {
        return Err(Miss::Skipped(
            "the frame was whole before the requests were answered".into(),
        ));
    }
    asked
        .iter()
        .zip(&answers)
        .try_for_each(|(request, heard)| request.is_answered_by(heard))
}

/// A request while an acquisition is in flight, and what it must get.
struct Asked {
    id: u32,
    message: ClientMessage,
    gets: Gets,
}

enum Gets {
    Kind(u16),
    Code(u16),
    Repeated,
    /// 602, or 204 where the frame begins to be sent meanwhile.
    NoFrame,
}

impl Asked {
    fn is_answered_by(&self, heard: &Heard) -> Result<(), Miss> {
        let name = crate::camera::lines::message_name(self.message.kind());
        let in_words = |miss: Miss| match miss {
            Miss::Failed(words) => Miss::Failed(format!("to {name}: {words}")),
            skipped => skipped,
        };
        match self.gets {
            Gets::Kind(kind) => require(heard.kind == kind, || format!("to {name}: {heard}")),
            Gets::Code(code) => is_error(heard, code).map(|_| ()).map_err(in_words),
            Gets::NoFrame => is_error(heard, 602)
                .or_else(|miss| is_error(heard, 204).map_err(|_| miss))
                .map(|_| ())
                .map_err(in_words),
            Gets::Repeated => {
                let accepted = trigger_ok(heard).map_err(in_words)?;
                require(accepted.repeated == Repeated::InFlight, || {
                    format!("`repeated` must be 1: {heard}")
                })
            }
        }
    }
}

/// `no_frame`: what FETCH of an unknown trigger gets.
fn busy_requests(
    bench: &mut Bench<'_, '_>,
    line: LineId,
    config_id: u32,
    no_frame: Gets,
    bytes: &mut Vec<u8>,
) -> Vec<Asked> {
    let run_id = bench.new_run();
    let never = TriggerId::new(bench.view, 9);
    let requests = [
        (ClientMessage::GetCaps, Gets::Kind(0x04)),
        (ClientMessage::GetStatus, Gets::Kind(0x51)),
        (ClientMessage::Ping { sender_ns: 3 }, Gets::Kind(0x61)),
        (ClientMessage::Configure(bench.context.small), Gets::Code(203)),
        (arm(config_id), Gets::Code(203)),
        (ClientMessage::Disarm, Gets::Code(203)),
        (trigger(bench.trigger_id(1), config_id, 0), Gets::Code(204)),
        (bench.trigger(0, config_id), Gets::Repeated),
        (ClientMessage::Fetch { trigger_id: never }, no_frame),
        (ClientMessage::Hello(hello(run_id)), Gets::Code(203)),
    ];
    let frame = |(message, gets): (ClientMessage, Gets)| {
        let (frame, id) = bench.lines.frame(line, &message);
        bytes.extend(frame);
        Asked { id, message, gets }
    };
    requests.into_iter().map(frame).collect()
}

/// What every role may ask in every state is answered.
pub(super) fn reads(bench: &mut Bench<'_, '_>, line: LineId) -> Result<(), Miss> {
    for (request, kind) in [
        (ClientMessage::GetCaps, 0x04),
        (ClientMessage::GetStatus, 0x51),
        (ClientMessage::Ping { sender_ns: 5 }, 0x61),
    ] {
        let heard = bench.ask(line, &request)?;
        require(heard.kind == kind, || format!("not the reply to {request:?}: {heard}"))?;
    }
    Ok(())
}

fn says_hello_again(bench: &mut Bench<'_, '_>, line: LineId) -> Result<(), Miss> {
    let run_id = bench.new_run();
    bench
        .refused(line, &ClientMessage::Hello(hello(run_id)), 203)
        .map(|_| ())
}

/// DISARM is answered with the state that then is.
fn is_disarmed(bench: &mut Bench<'_, '_>, line: LineId, expected: CameraState) -> Result<(), Miss> {
    let heard = bench.ask(line, &ClientMessage::Disarm)?;
    match server_message(&heard)? {
        ServerMessage::Disarmed { state } => require(state == expected, || format!("{expected:?} belongs in {heard}")),
        _ => Err(unexpected("DISARMED", &heard)),
    }
}

/// ABORT with nothing in flight is answered with phase 0.
pub(super) fn aborts_nothing(bench: &mut Bench<'_, '_>, line: LineId) -> Result<(), Miss> {
    let trigger_id = TRIGGER_ALL;
    let heard = bench.ask(line, &ClientMessage::Abort { trigger_id })?;
    match server_message(&heard)? {
        ServerMessage::Aborted(aborted) => require(aborted.phase == AcquisitionPhase::None, || {
            format!("phase 0 belongs in {heard}")
        }),
        _ => Err(unexpected("ABORTED", &heard)),
    }
}
