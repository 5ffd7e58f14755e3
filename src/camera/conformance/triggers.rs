//! Triggers: accepted once, known again, ended once, in time (sections 3.2, 3.7, 4.7 to 4.9).

use super::bench::{Bench, REPLY_MS, frame_ms, hello, require, trigger, trigger_ok, unexpected};
use super::course::{Course, pause_ms};
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::{LineId, server_message};
use crate::camera::message::{CameraState, ClientMessage, Configured, FrameStatus, Repeated, ServerMessage, Trigger};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Exposures,
        "3.2-course",
        "TRIGGER_OK, one EXPOSURE_DONE, FRAME_BEGIN, chunks, FRAME_END come in this order; then the state is ARMED",
        "one acquisition",
        |bench| {
            let (line, configured) = armed(bench)?;
            let course = bench.acquire(line, 0, &configured)?;
            let wanted = ["EXPOSURE_DONE", "FRAME_BEGIN", "FRAME_CHUNK ...", "FRAME_END 0"];
            require(course.steps == wanted, || format!("what came: {}", course.words()))?;
            bench.is_in(line, CameraState::Armed)
        },
    ),
    clause(
        Needs::Exposures,
        "3.7-times",
        "TRIGGER_OK within 500 ms, EXPOSURE_DONE within 1.5 x predicted + 1 s, FRAME_END within 1.5 x predicted + bytes / (20 MB/s) + 2 s",
        "one acquisition, timed",
        times,
    ),
    clause(
        Needs::Exposures,
        "3.2-once",
        "every accepted trigger ends exactly once: nothing more comes of it",
        "one acquisition; then nothing for 1.5 s",
        |bench| {
            let (line, configured) = armed(bench)?;
            bench.acquire(line, 0, &configured)?;
            bench.lines.pass(QUIET_MS);
            is_quiet(bench, line)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-again",
        "after a complete frame the next trigger is taken",
        "three acquisitions one after the other; their frame ids differ",
        |bench| {
            let (line, configured) = armed(bench)?;
            let mut ids = Vec::new();
            for attempt in 0..3 {
                let course = bench.acquire(line, attempt, &configured)?;
                ids.extend(course.begin.map(|begin| begin.frame_id));
            }
            require(ids[0] != ids[1] && ids[1] != ids[2] && ids[0] != ids[2], || {
                format!("frame ids {ids:?}")
            })
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-repeat-in-flight",
        "the id of a trigger in flight is answered with `repeated` 1 and exposed once",
        "TRIGGER twice in one piece",
        |bench| {
            let (line, configured) = armed(bench)?;
            let message = bench.trigger(0, configured.config_id);
            let (mut bytes, first) = bench.lines.frame(line, &message);
            let (more, second) = bench.lines.frame(line, &message);
            bytes.extend(more);
            bench.lines.send(line, bytes);
            is_repeated(bench, line, first, &message, Repeated::New)?;
            is_repeated(bench, line, second, &message, Repeated::InFlight)?;
            let course = bench.follow(line, 0, &configured)?;
            course.is_complete()?;
            require(course.exposure_done.len() == 1, || {
                format!("what came: {}", course.words())
            })?;
            bench.lines.pass(QUIET_MS);
            is_quiet(bench, line)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-repeat-done",
        "the id of a trigger that is done is answered with `repeated` 2, is not exposed, and brings nothing",
        "one acquisition, the same TRIGGER again, then nothing for 1.5 s",
        |bench| {
            let (line, configured) = armed(bench)?;
            bench.acquire(line, 0, &configured)?;
            repeat_is(bench, line, configured.config_id, Repeated::Done)?;
            bench.lines.pass(QUIET_MS);
            is_quiet(bench, line)?;
            bench.is_in(line, CameraState::Armed)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-repeat-in-idle",
        "a repeated id is recognised before the state is looked at",
        "one acquisition, DISARM, the same TRIGGER again",
        |bench| {
            let (line, configured) = armed(bench)?;
            bench.acquire(line, 0, &configured)?;
            bench.ask(line, &ClientMessage::Disarm)?;
            repeat_is(bench, line, configured.config_id, Repeated::Done)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-repeat-reconnected",
        "the trigger ids of a run are remembered across connections",
        "one acquisition; another connection of the same run repeats the TRIGGER",
        |bench| {
            let run_id = bench.new_run();
            let (line, _) = bench.greet(&hello(run_id))?;
            let configured = configure_and_arm(bench, line)?;
            bench.acquire(line, 0, &configured)?;
            bench.leave();
            let (line, _) = bench.greet(&hello(run_id))?;
            repeat_is(bench, line, configured.config_id, Repeated::Done)
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-new-run",
        "a controller of another run starts afresh: trigger ids of the run before are new again",
        "one acquisition; a controller of another run uses the same id",
        |bench| {
            let (line, configured) = armed(bench)?;
            bench.acquire(line, 0, &configured)?;
            bench.leave();
            let (line, configured) = armed(bench)?;
            bench.acquire(line, 0, &configured).map(|_| ())
        },
    ),
    clause(
        Needs::Exposures,
        "4.7-deadline",
        "a frame that is not there by its deadline ends in ERROR 407 that names the trigger",
        "TRIGGER with a deadline of 1 ms",
        deadline,
    ),
    clause(
        Needs::Exposures,
        "4.7-tag",
        "a tag has at most 64 bytes, else ERROR 301",
        "TRIGGER with a tag of 64 bytes, and one of 65 bytes",
        |bench| {
            let (line, configured) = armed(bench)?;
            let with_tag = |attempt: u16, length: usize| {
                let ClientMessage::Trigger(plain) = bench.trigger(attempt, configured.config_id) else {
                    unreachable!("it is a trigger")
                };
                let tag = "t".repeat(length);
                ClientMessage::Trigger(Trigger { tag, ..plain })
            };
            let (fits, too_long) = (with_tag(0, 64), with_tag(1, 65));
            trigger_ok(&bench.ask(line, &fits)?)?;
            bench.follow(line, 0, &configured)?.is_complete()?;
            bench.refused(line, &too_long, 301).map(|_| ())
        },
    ),
    clause(
        Needs::Exposures,
        "4.13-counters",
        "STATUS counts triggers and frames",
        "GET_STATUS before and after one acquisition",
        |bench| {
            let (line, configured) = armed(bench)?;
            let before = status(bench, line)?;
            bench.acquire(line, 0, &configured)?;
            let after = status(bench, line)?;
            require(after == before.map(|count| count + 1), || {
                format!("triggers and frames were {before:?} and are {after:?}")
            })
        },
    ),
    clause(
        Needs::Exposures,
        "3.4-observer-frames",
        "an observer receives no frames",
        "one acquisition while an observer listens",
        |bench| {
            let observer = bench.observer()?;
            let (line, configured) = armed(bench)?;
            bench.acquire(line, 0, &configured)?;
            is_quiet(bench, observer)
        },
    ),
];

fn armed(bench: &mut Bench<'_, '_>) -> Result<(LineId, Configured), Miss> {
    let settings = bench.context.small;
    bench.armed(&settings)
}

/// Settings for quick frames in force on a connection, and armed.
pub(super) fn configure_and_arm(bench: &mut Bench<'_, '_>, line: LineId) -> Result<Configured, Miss> {
    let settings = bench.context.small;
    let configured = bench.configure(line, &settings)?;
    bench.arm(line, configured.config_id)?;
    Ok(configured)
}

fn is_repeated(
    bench: &mut Bench<'_, '_>,
    line: LineId,
    request_id: u32,
    message: &ClientMessage,
    expected: Repeated,
) -> Result<(), Miss> {
    let heard = bench.reply(line, request_id, message)?;
    let found = trigger_ok(&heard)?.repeated;
    require(found == expected, || {
        format!("`repeated` is {found:?} where {expected:?} belongs: {heard}")
    })
}

/// The first trigger of the clause, said again, must be known.
fn repeat_is(bench: &mut Bench<'_, '_>, line: LineId, config_id: u32, expected: Repeated) -> Result<(), Miss> {
    let message = bench.trigger(0, config_id);
    let request_id = bench.lines.say(line, &message);
    is_repeated(bench, line, request_id, &message, expected)
}

/// Nothing is left that nobody asked for.
pub(super) fn is_quiet(bench: &Bench<'_, '_>, line: LineId) -> Result<(), Miss> {
    let state = bench.lines.line(line);
    if let Some(odd) = state.broken() {
        return Err(Miss::failed(odd.to_owned()));
    }
    match state.untaken().next() {
        None => Ok(()),
        Some(heard) => Err(Miss::failed(format!("nobody asked for {heard}"))),
    }
}

fn times(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let (line, configured) = armed(bench)?;
    let asked_at = bench.lines.now();
    let message = bench.trigger(0, configured.config_id);
    let heard = bench.ask(line, &message)?;
    let accepted = trigger_ok(&heard)?;
    let accepted_at = heard.at;
    let course = bench.follow(line, 0, &configured)?;
    course.is_complete()?;
    let within = |what: &str, ms: u64, limit_ms: u64| {
        require(ms <= limit_ms, || {
            format!("{what} took {ms} ms where {limit_ms} ms are allowed")
        })
    };
    within("TRIGGER_OK", accepted_at.ms_since(asked_at), 500)?;
    let predicted_ms = |us: u32| u64::from(us) * 3 / 2000;
    let paused_ms = pause_ms(bench.lines, line, bench.trigger_id(0));
    let exposed_at = course.exposure_done.first().map_or(accepted_at, |(at, _)| *at);
    let limit_ms = predicted_ms(accepted.predicted_exposure_us) + 1000 + paused_ms;
    within("EXPOSURE_DONE", exposed_at.ms_since(accepted_at), limit_ms)?;
    let limit_ms = predicted_ms(accepted.predicted_total_us) + configured.frame_bytes / 20_000 + 2000 + paused_ms;
    within("FRAME_END", course.ends[0].0.ms_since(accepted_at), limit_ms)
}

fn deadline(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let mut settings = bench.context.small;
    settings.image_count = bench.context.caps.image_count_max;
    let (line, configured) = bench.armed(&settings)?;
    if configured.predicted_total_us < 3000 {
        let us = configured.predicted_total_us;
        return Err(Miss::Skipped(format!("a frame takes only {us} us here")));
    }
    let id = bench.trigger_id(0);
    let heard = bench.ask(line, &trigger(id, configured.config_id, 1))?;
    trigger_ok(&heard)?;
    let course = Course::follow(bench.lines, line, id, frame_ms(&configured) + REPLY_MS)?;
    let complete = course.ends.iter().find(|(_, end)| end.status == FrameStatus::Complete);
    if let Some(ms) = complete
        .map(|(at, _)| at.ms_since(heard.at))
        .filter(|ms| *ms <= QUICK_MS)
    {
        return Err(Miss::Skipped(format!(
            "the frame was there within {ms} ms, too quickly to tell"
        )));
    }
    match &course.error {
        Some(error) if error.code == 407 && error.trigger_id == id.0 => {}
        _ => {
            return Err(Miss::failed(format!(
                "ERROR 407 was expected; what came: {}",
                course.words()
            )));
        }
    }
    require(complete.is_none(), || "a complete frame came all the same".into())?;
    bench.is_in(line, CameraState::Armed)
}

/// The counts of triggers and frames.
fn status(bench: &mut Bench<'_, '_>, line: LineId) -> Result<[u32; 2], Miss> {
    let heard = bench.ask(line, &ClientMessage::GetStatus)?;
    match server_message(&heard)? {
        ServerMessage::Status(status) => Ok([status.trigger_count, status.frame_count]),
        _ => Err(unexpected("STATUS", &heard)),
    }
}

const QUIET_MS: u64 = 1500;
/// A frame that is whole within so long may have been in time.
const QUICK_MS: u64 = 50;
