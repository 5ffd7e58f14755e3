//! `bladescan camera watch`.

use super::super::{Exit, Failure, print};
use super::{Place, error_name, temperatures};
use crate::camera::CameraStatus;
use std::num::NonZeroU32;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    place: Place,
    /// End after so many lines.
    #[arg(long, value_name = "N")]
    count: Option<NonZeroU32>,
}

pub(super) fn main(args: &Args, json: bool) -> Result<Exit, Failure> {
    let mut visit = args.place.observe()?;
    let mut left = args.count.map(NonZeroU32::get);
    while left != Some(0) {
        let seen = visit.next_status()?;
        if json {
            let mut document = serde_json::json!(seen.status);
            document["seconds"] = serde_json::json!(seen.at.seconds());
            print(&document.to_string())?;
        } else {
            print(&format!("{:9.3} s  {}", seen.at.seconds(), one_line(&seen.status)))?;
        }
        left = left.map(|left| left - 1);
    }
    visit.leave();
    Ok(Exit::Done)
}

fn one_line(status: &CameraStatus) -> String {
    let warm = match status.warm_up_done_s >= status.warm_up_required_s {
        true => "warm".to_owned(),
        false => format!(
            "warming up: {} of {} s",
            status.warm_up_done_s, status.warm_up_required_s
        ),
    };
    format!(
        "{:?}; {}; {warm}; {} triggers, {} frames, {} missed, {} time-outs, {} packets lost; last error {}",
        status.state,
        temperatures(&status.temperature_c),
        status.trigger_count,
        status.frame_count,
        status.missed_count,
        status.vendor_timeout_count,
        status.lost_packet_count,
        error_name(status.last_error)
    )
}
