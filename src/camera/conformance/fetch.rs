//! Lost connections and FETCH (section 3.3).

use super::bench::{Bench, frame_ms, hello, require, unexpected};
use super::course::Course;
use super::triggers::configure_and_arm;
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::{LineId, server_message};
use crate::camera::message::{Bye, CameraState, ClientMessage, Configured, FetchOk, FetchState, ServerMessage};

pub(super) const CLAUSES: &[Clause] = &[
    clause(
        Needs::Nothing,
        "3.3-fetch-miss",
        "FETCH of what was never triggered in this run: ERROR 602, retryable 0",
        "FETCH in IDLE",
        |bench| {
            let line = bench.controller()?;
            let trigger_id = bench.trigger_id(0);
            let error = bench.refused(line, &ClientMessage::Fetch { trigger_id }, 602)?;
            require(!error.retryable, || {
                "the refusal says that trying again may help".into()
            })
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-fetch-stored",
        "a frame that was sent whole is stored: FETCH_OK state 2, then the same bytes with the same frame id",
        "one acquisition, then FETCH",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            let first = bench.acquire(line, 0, &configured)?;
            let (found, again) = fetch(bench, line, 0, &configured)?;
            is_stored(&found)?;
            first.is_same_frame_as(&again)?;
            require(again.exposure_done.is_empty(), || {
                format!("what came: {}", again.words())
            })?;
            bench.is_in(line, CameraState::Armed)
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-fetch-idle",
        "FETCH is served in IDLE",
        "one acquisition, DISARM, FETCH",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            let first = bench.acquire(line, 0, &configured)?;
            bench.ask(line, &ClientMessage::Disarm)?;
            let (_, again) = fetch(bench, line, 0, &configured)?;
            first.is_same_frame_as(&again)?;
            bench.is_in(line, CameraState::Idle)
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-fetch-in-flight",
        "an acquisition lives on when its connection ends; FETCH from the next one brings it, then the state is IDLE",
        "TRIGGER, the connection closed, HELLO of the same run, FETCH",
        |bench| {
            let (run_id, line, configured) = own_run(bench, false)?;
            bench.start(line, 0, configured.config_id)?;
            bench.lines.close(line);
            let (line, _) = bench.greet(&hello(run_id))?;
            let (_, course) = fetch(bench, line, 0, &configured)?;
            course.is_complete()?;
            bench.is_in(line, CameraState::Idle)
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-fetch-torn",
        "a frame whose connection was lost in the middle is fetched with the same bytes and frame id, exposed once",
        "a large frame, the connection closed after FRAME_BEGIN and a chunk, HELLO of the same run, FETCH",
        torn,
    ),
    clause(
        Needs::Exposures,
        "3.3-fetch-half-open",
        "with the old connection still open, HELLO of the same run takes its place (BYE 6) and FETCH brings the frame",
        "TRIGGER on one connection, HELLO of the same run and FETCH on another",
        |bench| {
            let (run_id, older, configured) = own_run(bench, false)?;
            bench.start(older, 0, configured.config_id)?;
            let (newer, _) = bench.greet(&hello(run_id))?;
            super::framing::ends_with_bye(bench, older, Bye::REPLACED)?;
            let (_, course) = fetch(bench, newer, 0, &configured)?;
            course.is_complete()
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-store",
        "the store keeps the last four complete frames of the run: the fifth before is gone",
        "five acquisitions, then FETCH of each",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            let mut frames = Vec::new();
            for attempt in 0..5 {
                frames.push(bench.acquire(line, attempt, &configured)?);
            }
            let trigger_id = bench.trigger_id(0);
            bench.refused(line, &ClientMessage::Fetch { trigger_id }, 602)?;
            for attempt in 1..5 {
                let (found, again) = fetch(bench, line, attempt, &configured)?;
                is_stored(&found)?;
                frames[usize::from(attempt)].is_same_frame_as(&again)?;
            }
            Ok(())
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-fetch-other-run",
        "a controller of another run finds no frame of the run before: ERROR 602",
        "one acquisition, then FETCH by a controller of another run",
        |bench| {
            let settings = bench.context.small;
            let (line, configured) = bench.armed(&settings)?;
            bench.acquire(line, 0, &configured)?;
            bench.leave();
            let line = bench.controller()?;
            let trigger_id = bench.trigger_id(0);
            bench
                .refused(line, &ClientMessage::Fetch { trigger_id }, 602)
                .map(|_| ())
        },
    ),
    clause(
        Needs::Exposures,
        "3.2-new-run-aborts",
        "a controller of another run aborts what is in flight",
        "TRIGGER, the connection closed, HELLO of another run, FETCH",
        |bench| {
            let (_, line, configured) = own_run(bench, false)?;
            bench.start(line, 0, configured.config_id)?;
            bench.lines.close(line);
            let line = bench.controller()?;
            let trigger_id = bench.trigger_id(0);
            bench.refused(line, &ClientMessage::Fetch { trigger_id }, 602)?;
            let configured = configure_and_arm(bench, line)?;
            bench.acquire(line, 0, &configured).map(|_| ())
        },
    ),
    clause(
        Needs::Exposures,
        "3.3-boot-id",
        "the boot id stays the same while the server runs, whatever becomes of connections",
        "a connection lost during an acquisition, its frame fetched, the place taken again; boot ids compared",
        |bench| {
            let (run_id, line, configured) = own_run(bench, false)?;
            bench.start(line, 0, configured.config_id)?;
            bench.lines.close(line);
            let (line, greeting) = bench.greet(&hello(run_id))?;
            fetch(bench, line, 0, &configured)?;
            let (_, later) = bench.greet(&hello(run_id))?;
            let boots = [bench.context.greeting.boot_id, greeting.boot_id, later.boot_id];
            require(boots == [boots[0]; 3], || format!("boot ids {boots:x?}"))
        },
    ),
];

/// A controller, armed, whose run id is known.
fn own_run(bench: &mut Bench<'_, '_>, large: bool) -> Result<(u64, LineId, Configured), Miss> {
    let run_id = bench.new_run();
    let (line, _) = bench.greet(&hello(run_id))?;
    let settings = match large {
        true => bench.context.large,
        false => bench.context.small,
    };
    let configured = bench.configure(line, &settings)?;
    bench.arm(line, configured.config_id)?;
    Ok((run_id, line, configured))
}

/// FETCH that must be served, and the frame that comes of it.
fn fetch(
    bench: &mut Bench<'_, '_>,
    line: LineId,
    attempt: u16,
    configured: &Configured,
) -> Result<(FetchOk, Course), Miss> {
    let trigger_id = bench.trigger_id(attempt);
    let heard = bench.ask(line, &ClientMessage::Fetch { trigger_id })?;
    let ServerMessage::FetchOk(found) = server_message(&heard)? else {
        return Err(unexpected("FETCH_OK", &heard));
    };
    require(found.trigger_id == trigger_id, || {
        format!("of another trigger: {heard}")
    })?;
    let limit_ms = match found.state {
        FetchState::InFlight => u64::from(found.remaining_us) * 3 / 2000 + configured.frame_bytes / 20_000 + 3000,
        FetchState::Stored => configured.frame_bytes / 20_000 + 3000,
    };
    let course = Course::follow(bench.lines, line, trigger_id, limit_ms)?;
    course.is_complete()?;
    Ok((found, course))
}

fn is_stored(found: &FetchOk) -> Result<(), Miss> {
    require(found.state == FetchState::Stored && found.remaining_us == 0, || {
        format!("state 2 and 0 us belong in FETCH_OK, there is {found:?}")
    })
}

fn torn(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let (run_id, line, configured) = own_run(bench, true)?;
    bench.start(line, 0, configured.config_id)?;
    let (id, limit_ms) = (bench.trigger_id(0), frame_ms(&configured));
    let mut part = Course::default();
    while part.steps.last() != Some(&"FRAME_CHUNK ...") {
        part.step(bench.lines, line, id, limit_ms)?;
    }
    bench.lines.close(line);
    let (line, _) = bench.greet(&hello(run_id))?;
    let (_, whole) = fetch(bench, line, 0, &configured)?;
    let ids = [&part, &whole].map(|course| course.begin.as_ref().map(|begin| begin.frame_id));
    require(ids[0] == ids[1], || format!("the frame ids are {ids:?}"))?;
    let agrees = part
        .components
        .iter()
        .zip(&whole.components)
        .all(|(part, whole)| whole.starts_with(part));
    require(agrees, || {
        "the data differ from those that came before the connection was lost".into()
    })?;
    require(whole.exposure_done.is_empty(), || {
        format!("exposed again: {}", whole.words())
    })?;
    bench.is_in(line, CameraState::Idle)
}
