//! A test of any server of A3DP/1, clause by clause: what the author of a bridge runs against it.
//!
//! Each clause of [`clauses`] is a sentence of `docs/protocols/camera.md` that a server can be seen to break. It is tried
//! on connections of its own and in a run of its own, so that what one clause breaks does not fail the others. Nothing
//! here does I/O: [`Lines`] is handed in.

mod abort;
mod bench;
mod content;
mod course;
mod fetch;
mod framing;
mod resets;
mod session;
mod settings;
mod signs;
mod states;
mod triggers;

use super::lines::{LineError, Lines, server_message};
use super::message::{CameraState, Caps, ClientMessage, ComponentKind, Greeting, Hello, ServerMessage};
use super::settings::CameraSettings;
use bench::{Bench, NAME};
use serde::Serialize;

/// One thing that the page asks of a server.
#[derive(Debug, Clone, Copy)]
pub struct Clause {
    /// Section of the page and a word: names it.
    pub id: &'static str,
    /// What the page says, in plain words.
    pub says: &'static str,
    /// What is done to see whether it holds.
    pub does: &'static str,
    needs: Needs,
    check: fn(&mut Bench<'_, '_>) -> Result<(), Miss>,
}

/// What must be allowed for a clause to be tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Needs {
    /// Nothing: the camera stays dark.
    Nothing,
    /// A device that is there; it stays dark.
    Device,
    /// That the camera flashes.
    Exposures,
}

/// What `id` names, `says` and `does` as [`Clause`] has them.
const fn clause(
    needs: Needs,
    id: &'static str,
    says: &'static str,
    does: &'static str,
    check: fn(&mut Bench<'_, '_>) -> Result<(), Miss>,
) -> Clause {
    Clause {
        id,
        says,
        does,
        needs,
        check,
    }
}

/// Why a clause was not seen to hold.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Miss {
    Failed(String),
    Skipped(String),
}

impl Miss {
    fn failed(words: String) -> Self {
        Self::Failed(words)
    }
}

/// What became of one clause.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// It holds, as far as was tried.
    Passed,
    /// The server breaks it.
    Failed {
        /// What was seen, with the bytes.
        reason: String,
    },
    /// It could not be tried.
    Skipped {
        /// Why not.
        reason: String,
    },
}

/// One line of the report.
#[derive(Debug, Clone, Serialize)]
pub struct Told {
    /// The clause's name.
    pub id: &'static str,
    /// What the page says.
    pub says: &'static str,
    /// What was done.
    pub does: &'static str,
    /// What became of it.
    pub verdict: Verdict,
    /// How long it took, s.
    pub seconds: f64,
}

/// What may be done to the camera, and who asks.
#[derive(Debug, Clone, Copy)]
pub struct Permission {
    /// The camera may flash.
    pub exposures: bool,
    /// Run ids from here on are the suite's; not the same in two sessions with one server.
    pub first_run: u64,
}

/// What the clauses know of the server.
struct Context {
    permission: Permission,
    greeting: Greeting,
    caps: Caps,
    state: CameraState,
    next_run: u64,
    /// Request ids of frames that the suite writes itself, above those that count by themselves.
    next_raw_id: u32,
    /// A part of the sensor, for quick frames of a few chunks.
    small: CameraSettings,
    /// The whole sensor, binned where that is possible: a frame that takes a while to send.
    large: CameraSettings,
}

/// Every clause, in the order of the page.
pub fn clauses() -> Vec<Clause> {
    [
        framing::CLAUSES,
        session::CLAUSES,
        states::CLAUSES,
        settings::CLAUSES,
        triggers::CLAUSES,
        content::CLAUSES,
        abort::CLAUSES,
        fetch::CLAUSES,
        resets::CLAUSES,
        signs::CLAUSES,
    ]
    .concat()
}

/// The view number in the trigger ids of a clause, so that what is done to a trigger on purpose can be aimed.
pub fn view_of(id: &str) -> Option<u32> {
    let place = clauses().iter().position(|clause| clause.id == id)?;
    Some(place as u32 + FIRST_VIEW)
}

/// Tries the clauses whose ids begin with one of `wanted` (all when it is empty) and tells each as it ends.
///
/// # Errors
///
/// There is no server at all, or what greets cannot be talked with even once.
pub fn run(
    lines: &mut Lines<'_>,
    permission: Permission,
    wanted: &[String],
    mut tell: impl FnMut(&Told),
) -> Result<Vec<Told>, LineError> {
    let mut context = Context::ask(lines, permission)?;
    let mut report = Vec::new();
    for (place, clause) in clauses().into_iter().enumerate() {
        if !wanted.is_empty() && !wanted.iter().any(|start| clause.id.starts_with(start.as_str())) {
            continue;
        }
        let began = lines.now();
        let verdict = judge(lines, &mut context, &clause, place as u32 + FIRST_VIEW);
        let told = Told {
            id: clause.id,
            says: clause.says,
            does: clause.does,
            verdict,
            seconds: lines.now().seconds() - began.seconds(),
        };
        tell(&told);
        report.push(told);
    }
    Ok(report)
}

fn judge(lines: &mut Lines<'_>, context: &mut Context, clause: &Clause, view: u32) -> Verdict {
    let device_is_there = matches!(
        context.state,
        CameraState::Idle
            | CameraState::Armed
            | CameraState::Exposing
            | CameraState::Reconstructing
            | CameraState::Sending
    );
    let obstacle = match clause.needs {
        Needs::Exposures if !context.permission.exposures => Some("exposures are not allowed".to_owned()),
        Needs::Exposures | Needs::Device if !device_is_there => Some(format!("the device is {:?}", context.state)),
        _ => None,
    };
    if let Some(reason) = obstacle {
        return Verdict::Skipped { reason };
    }
    let mut bench = Bench::new(lines, context, view);
    let result = (clause.check)(&mut bench);
    bench.leave();
    match result {
        Ok(()) => Verdict::Passed,
        Err(Miss::Failed(reason)) => Verdict::Failed { reason },
        Err(Miss::Skipped(reason)) => Verdict::Skipped { reason },
    }
}

impl Context {
    /// Greets as an observer and asks who is there, what it can do and how it is.
    fn ask(lines: &mut Lines<'_>, permission: Permission) -> Result<Self, LineError> {
        let line = lines.connect()?;
        let ask = |lines: &mut Lines<'_>, message: &ClientMessage, what: &str| {
            let request_id = lines.say(line, message);
            lines.reply(line, request_id, what, bench::REPLY_MS)
        };
        let unfit = |heard: &super::lines::Heard| Err(LineError::Protocol(format!("not the reply to that: {heard}")));
        let heard = ask(
            lines,
            &ClientMessage::Hello(Hello::observer(NAME)),
            "reply to an observer's HELLO",
        )?;
        let ServerMessage::HelloOk(greeting) = server_message(&heard)? else {
            return unfit(&heard);
        };
        let heard = ask(lines, &ClientMessage::GetCaps, "reply to GET_CAPS")?;
        let ServerMessage::Caps(caps) = server_message(&heard)? else {
            return unfit(&heard);
        };
        let heard = ask(lines, &ClientMessage::GetStatus, "reply to GET_STATUS")?;
        let ServerMessage::Status(status) = server_message(&heard)? else {
            return unfit(&heard);
        };
        lines.say(line, &bench::bye());
        lines.is_closed_within(line, bench::REPLY_MS);
        lines.close(line);
        let (small, large) = quick_settings(&caps);
        Ok(Self {
            permission,
            greeting,
            state: status.state,
            next_run: permission.first_run,
            next_raw_id: 1000,
            caps,
            small,
            large,
        })
    }
}

/// Settings that any camera with these capabilities must take: a part of the sensor, and the whole of it binned.
fn quick_settings(caps: &Caps) -> (CameraSettings, CameraSettings) {
    let lowest = |mask: u32| mask.trailing_zeros().min(31) as u8;
    let span = |axis: usize, wanted: u16| {
        let (sensor, step) = (caps.sensor_px[axis], caps.roi_step_px[axis].max(1));
        let size = wanted.max(caps.roi_min_px[axis]).min(sensor) / step * step;
        let place = (sensor - size) / 2 / step * step;
        (size, place)
    };
    let ((width, x), (height, y)) = (span(0, SMALL_PX[0]), span(1, SMALL_PX[1]));
    let points = match caps.components & ComponentKind::Xyz.bit() {
        0 => ComponentKind::Range,
        _ => ComponentKind::Xyz,
    };
    let others = ComponentKind::Intensity.bit() | ComponentKind::Confidence.bit();
    let small = CameraSettings {
        binning: false,
        roi_px: [width, height, x, y, x, y],
        exposure_us: caps.exposure_default_us,
        image_count: caps.image_count_min,
        hdr_us: [0; 2],
        compression: lowest(caps.compressions),
        led_percent: caps.led_recommended_percent.max(1),
        frame_time_ratio: 1.0,
        score_threshold: 0.5,
        outlier_filter: lowest(caps.outlier_filters),
        reconstruction_quality: 5,
        pre_filtering: 3,
        working_volume: lowest(caps.working_volumes),
        volume_of_interest: None,
        components: points.bit() | ComponentKind::Mask.bit() | caps.components & others,
    };
    let large = CameraSettings {
        binning: true,
        roi_px: [caps.sensor_px[0], caps.sensor_px[1], 0, 0, 0, 0],
        ..small
    };
    (small, large)
}

/// The counts of a report: passed, failed, skipped.
pub fn counts(report: &[Told]) -> [usize; 3] {
    let count = |fits: fn(&Verdict) -> bool| report.iter().filter(|told| fits(&told.verdict)).count();
    [
        count(|verdict| *verdict == Verdict::Passed),
        count(|verdict| matches!(verdict, Verdict::Failed { .. })),
        count(|verdict| matches!(verdict, Verdict::Skipped { .. })),
    ]
}

const FIRST_VIEW: u32 = 1000;
const SMALL_PX: [u16; 2] = [240, 160];
