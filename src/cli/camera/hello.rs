//! `bladescan camera hello`.

use super::super::{Exit, Failure, print};
use super::{Place, error_name, row, temperatures};
use crate::camera::{CameraStatus, Caps, Clock, ComponentKind, Greeting};
use serde_json::json;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: Place,
}

pub(super) fn main(args: &Args, json: bool) -> Result<Exit, Failure> {
    let mut visit = args.place.observe()?;
    let caps = visit.caps()?;
    let status = visit.status()?;
    let clock = visit.clock()?;
    let greeting = visit.greeting().clone();
    visit.leave();
    if json {
        let clock = json!({ "offset_ns": clock.offset_ns, "round_trip_ns": clock.round_trip_ns });
        let document = json!({ "greeting": greeting, "caps": caps, "status": status, "clock": clock });
        print(&document.to_string())?;
    } else {
        print(&as_table(&greeting, &caps, &status, clock))?;
    }
    Ok(Exit::Done)
}

fn as_table(greeting: &Greeting, caps: &Caps, status: &CameraStatus, clock: Clock) -> String {
    let [width, height] = caps.sensor_px;
    let [least_width, least_height] = caps.roi_min_px;
    let [step_x, step_y] = caps.roi_step_px;
    let [near, nominal, far] = caps.working_distance_mm;
    let measured = match greeting.simulated {
        true => "SIMULATED: nothing it sends was measured",
        false => "a real device",
    };
    let warm = match status.warm_up_done_s >= status.warm_up_required_s {
        true => "done".to_owned(),
        false => format!("{} of {} s", status.warm_up_done_s, status.warm_up_required_s),
    };
    [
        row("camera", format!("{} {}, serial {}", greeting.vendor, greeting.model, greeting.serial)),
        row("", measured),
        row(
            "versions",
            format!(
                "A3DP {}.{}, firmware {}, SDK {}",
                greeting.version[0], greeting.version[1], greeting.firmware, greeting.sdk_version
            ),
        ),
        row("boot", format!("{:#018x}, session {}", greeting.boot_id, greeting.session_id)),
        row("calibration", calibration(greeting)),
        row("optics", format!("{}, {near} to {far} mm, nominal {nominal} mm, {} mm between points there", caps.optics, caps.spacing_mm)),
        row(
            "sensor",
            format!("{width} x {height} px; regions from {least_width} x {least_height} px in steps of {step_x} x {step_y} px"),
        ),
        row(
            "exposure",
            format!("{} to {} us, usually {} us", caps.exposure_min_us, caps.exposure_max_us, caps.exposure_default_us),
        ),
        row(
            "images",
            format!("{} to {}, usually {}", caps.image_count_min, caps.image_count_max, caps.image_count_default),
        ),
        row("HDR", format!("{} passes beside the main one", caps.hdr_slot_count)),
        row("LED", format!("up to {} %, without pauses up to {} %", caps.led_max_percent, caps.led_recommended_percent)),
        row("components", names(caps.components, &COMPONENTS)),
        row("compression", names(caps.compressions, &["none", "low", "medium", "high"])),
        row("filters", names(caps.outlier_filters, &["disabled", "permissive", "balanced", "strict"])),
        row("volumes", names(caps.working_volumes, &["standard", "extended"])),
        row("frames", format!("up to {:.1} MiB", greeting.frame_bytes_max as f64 / f64::from(1 << 20))),
        row("state", format!("{:?}, last error {}", status.state, error_name(status.last_error))),
        row("temperature", temperatures(&status.temperature_c)),
        row("warm-up", warm),
        row(
            "clock",
            format!(
                "round trip {:.3} ms; its clock is {:.6} s ahead of this program's",
                clock.round_trip_ns as f64 * 1e-6,
                clock.offset_ns as f64 * 1e-9
            ),
        ),
    ]
    .join("\n")
}

fn calibration(greeting: &Greeting) -> String {
    let date = greeting.calibration_date;
    let when = match date {
        0 => "date unknown".to_owned(),
        _ => format!("{:04}-{:02}-{:02}", date / 10_000, date / 100 % 100, date % 100),
    };
    format!("{} ({when})", greeting.calibration_id)
}

/// The names of the bits that are set.
fn names(mask: u32, names: &[&str]) -> String {
    let known = names.iter().enumerate();
    let set: Vec<&str> = known
        .filter(|(bit, _)| mask >> bit & 1 == 1)
        .map(|(_, name)| *name)
        .collect();
    match set.is_empty() {
        true => "none".into(),
        false => set.join(", "),
    }
}

/// By the number of their kind.
const COMPONENTS: [&str; ComponentKind::ALL.len()] = ["XYZ", "RANGE", "INTENSITY", "CONFIDENCE", "MASK"];
