//! ABORT in each phase (section 3.2).

use super::bench::{Bench, frame_ms, require, trigger_ok};
use super::course::Course;
use super::states::aborts_nothing;
use super::triggers::is_quiet;
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::LineId;
use crate::camera::message::{AcquisitionPhase, CameraState, ClientMessage, FrameStatus, TRIGGER_ALL};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Nothing,
        "3.2-abort-nothing",
        "ABORT is answered by ABORTED with phase 0 when nothing is in flight",
        "ABORT in IDLE",
        |bench| {
            let line = bench.controller()?;
            aborts_nothing(bench, line)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-abort-exposure",
        "ABORT during the exposure: ABORTED in phase 1 or 2, nothing more of that trigger, the state is ARMED again",
        "TRIGGER and ABORT in one piece",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            let start = bench.trigger(0, configured.config_id);
            let (mut bytes, started) = bench.lines.frame(line, &start);
            let trigger_id = bench.trigger_id(0).0;
            let (more, _) = bench.lines.frame(line, &ClientMessage::Abort { trigger_id });
            bytes.extend(more);
            bench.lines.send(line, bytes);
            trigger_ok(&bench.reply(line, started, &start)?)?;
            let course = bench.follow(line, 0, &configured)?;
            is_aborted(bench, line, &course)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-abort-reconstruction",
        "ABORT during the reconstruction: ABORTED in phase 3, no complete frame, the state is ARMED again",
        "ABORT as soon as EXPOSURE_DONE has come",
        |bench| abort_after(bench, "EXPOSURE_DONE"),
    ),
    clause(
        Needs::Exposures,
        "3.2-abort-transfer",
        "ABORT during the transfer: ABORTED in phase 4, then FRAME_END with status 1 that lists what was sent; ARMED again",
        "ABORT as soon as FRAME_BEGIN of a large frame has come",
        |bench| abort_after(bench, "FRAME_BEGIN"),
    ),
    clause(
        Needs::Exposures,
        "3.2-abort-all",
        "ABORT of the id that stands for all ends whatever is in flight",
        "ABORT of FFFF FFFF FFFF FFFF as soon as TRIGGER_OK has come",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            bench.start(line, 0, configured.config_id)?;
            let trigger_id = TRIGGER_ALL;
            bench.lines.say(line, &ClientMessage::Abort { trigger_id });
            let course = bench.follow(line, 0, &configured)?;
            is_aborted(bench, line, &course)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-abort-then",
        "after ABORTED the next trigger is taken",
        "TRIGGER, ABORT, and one whole acquisition",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            bench.start(line, 0, configured.config_id)?;
            let trigger_id = TRIGGER_ALL;
            bench.lines.say(line, &ClientMessage::Abort { trigger_id });
            bench.follow(line, 0, &configured)?;
            bench.acquire(line, 1, &configured).map(|_| ())
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-abort-fetch",
        "what was aborted has no frame: FETCH gets ERROR 602",
        "TRIGGER, ABORT, FETCH",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            bench.start(line, 0, configured.config_id)?;
            let trigger_id = bench.trigger_id(0);
            bench.lines.say(
                line,
                &ClientMessage::Abort {
                    trigger_id: trigger_id.0,
                },
            );
            let course = bench.follow(line, 0, &configured)?;
            if is_complete(&course) {
                return Err(Miss::Skipped("the frame was whole before the ABORT came".into()));
            }
            bench
                .refused(line, &ClientMessage::Fetch { trigger_id }, 602)
                .map(|_| ())
        },
    ),
];

fn abort_after(bench: &mut Bench<'_, '_>, step: &'static str) -> Result<(), Miss> {
    let settings = match step {
        "FRAME_BEGIN" => bench.context.large,
        _ => bench.context.small,
    };
    let (line, configured) = bench.armed(&settings)?;
    bench.start(line, 0, configured.config_id)?;
    let (id, limit_ms) = (bench.trigger_id(0), frame_ms(&configured));
    let mut course = Course::default();
    while course.steps.last() != Some(&step) {
        require(!course.has_ended(), || format!("it ended before: {}", course.words()))?;
        course.step(bench.lines, line, id, limit_ms)?;
    }
    bench.lines.say(line, &ClientMessage::Abort { trigger_id: id.0 });
    course.go_on(bench.lines, line, id, limit_ms)?;
    is_aborted(bench, line, &course)
}

fn is_complete(course: &Course) -> bool {
    course.ends.iter().any(|(_, end)| end.status == FrameStatus::Complete)
}

/// ABORTED names the phase that was seen; a frame that had begun ends with status 1 and what was really sent; nothing
/// more comes; the state is ARMED.
fn is_aborted(bench: &mut Bench<'_, '_>, line: LineId, course: &Course) -> Result<(), Miss> {
    if is_complete(course) {
        return Err(Miss::Skipped("the frame was whole before the ABORT came".into()));
    }
    let Some(aborted) = course.aborted else {
        return Err(Miss::failed(format!("no ABORTED came: {}", course.words())));
    };
    let id = bench.trigger_id(0).0;
    require(aborted.trigger_id == id || aborted.trigger_id == TRIGGER_ALL, || {
        format!("ABORTED names {:#x}", aborted.trigger_id)
    })?;
    let before = course.steps.iter().take_while(|step| **step != "ABORTED");
    let seen = before.fold(AcquisitionPhase::Exposure, |_, step| match *step {
        "EXPOSURE_DONE" => AcquisitionPhase::Reconstruction,
        _ => AcquisitionPhase::Transfer,
    });
    let agrees =
        aborted.phase == seen || (seen, aborted.phase) == (AcquisitionPhase::Exposure, AcquisitionPhase::Acknowledge);
    require(agrees, || {
        format!("ABORTED in phase {:?} after {}", aborted.phase, course.words())
    })?;
    if course.begin.is_some() {
        let sent_as_said = course.ends.iter().all(|(_, end)| {
            let sums = end.components.iter().map(|sent| (sent.byte_count, sent.crc));
            let came = course
                .components
                .iter()
                .map(|bytes| (bytes.len() as u64, crc32c::crc32c(bytes)));
            end.status == FrameStatus::Aborted && sums.eq(came)
        });
        require(sent_as_said, || {
            format!(
                "FRAME_END does not list what was sent, or has not status 1: {}",
                course.words()
            )
        })?;
    }
    bench.lines.pass(QUIET_MS);
    is_quiet(bench, line)?;
    bench.is_in(line, CameraState::Armed)
}

const QUIET_MS: u64 = 1000;
