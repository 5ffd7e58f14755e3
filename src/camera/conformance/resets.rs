//! A device that is lost or starts anew (section 3.5). Nobody can bring that about from here: it is watched for.

use super::bench::{Bench, require, unexpected};
use super::states::gets_what_the_table_says;
use super::{Clause, Miss, Needs, clause};
use crate::camera::lines::{LineId, server_message};
use crate::camera::message::{CameraError, CameraState, DeviceEvent, ServerMessage};

pub(super) const CLAUSES: &[Clause] = &[clause(
    Needs::Exposures,
    "3.5-device-lost",
    "a device that is lost or reset: EVENT 3, ERROR 501 or 504 (retryable) that names the trigger, the table's answers \
           while it is away, EVENT 4 when it is back, IDLE without settings; one that is broken: ERROR 500, state FAULT",
    "one acquisition; tried only when the device is lost during it: cut its power then",
    device_lost,
)];

fn device_lost(bench: &mut Bench<'_, '_>) -> Result<(), Miss> {
    let settings = bench.context.small;
    let (line, configured) = bench.armed(&settings)?;
    bench.start(line, 0, configured.config_id)?;
    let course = bench.follow(line, 0, &configured)?;
    let Some(error) = course.error else {
        return Err(Miss::Skipped("the device was not lost meanwhile".into()));
    };
    require(error.trigger_id == bench.trigger_id(0).0, || {
        format!("it names another trigger: {error:?}")
    })?;
    let state = match error.code {
        500 => CameraState::Fault,
        501 => CameraState::Offline,
        504 => CameraState::Resetting,
        code => return Err(Miss::Skipped(format!("the acquisition ended otherwise: ERROR {code}"))),
    };
    bench.is_in(line, state)?;
    gets_what_the_table_says(bench, line, state, error.code)?;
    if state == CameraState::Fault {
        return require(!error.retryable, || "trying again cannot help a broken device".into());
    }
    let lost = event(bench, line, DeviceEvent::DEVICE_LOST)?;
    is_retryable(&error)?;
    comes_back(bench, line, lost.duration_ms)?;
    bench.is_in(line, CameraState::Idle)?;
    bench.refused(line, &super::bench::arm(configured.config_id), 206)?;
    let configured = super::triggers::configure_and_arm(bench, line)?;
    bench.acquire(line, 1, &configured).map(|_| ())
}

fn is_retryable(error: &CameraError) -> Result<(), Miss> {
    require(error.retryable, || {
        format!("ERROR {} says that trying again cannot help", error.code)
    })
}

fn event(bench: &Bench<'_, '_>, line: LineId, code: u16) -> Result<DeviceEvent, Miss> {
    let found = bench.lines.line(line).events().iter().find(|event| event.code == code);
    found
        .cloned()
        .ok_or_else(|| Miss::failed(format!("no EVENT {code} came")))
}

/// EVENT 4 within the time of section 3.7.
fn comes_back(bench: &mut Bench<'_, '_>, line: LineId, duration_ms: u32) -> Result<(), Miss> {
    let limit_ms = match duration_ms {
        0 => 45_000,
        _ => u64::from(duration_ms) + 10_000,
    };
    let began = bench.lines.now();
    while event(bench, line, DeviceEvent::DEVICE_BACK).is_err() {
        let waited_ms = bench.lines.now().ms_since(began);
        require(waited_ms < limit_ms, || format!("no EVENT 4 came within {limit_ms} ms"))?;
        bench.lines.pass(200);
        let heard = bench.ask(line, &crate::camera::message::ClientMessage::GetStatus)?;
        if !matches!(server_message(&heard)?, ServerMessage::Status(_)) {
            return Err(unexpected("STATUS", &heard));
        }
    }
    Ok(())
}
