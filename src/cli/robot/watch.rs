//! `bladescan robot watch`.

use super::super::{Exit, Failure, print};
use super::{position, status};
use crate::run::Conversation;
use std::num::NonZeroU32;
use std::time::Duration;
use tokio::time::Instant;

#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Time between two looks, ms.
    #[arg(long, default_value_t = 500, value_name = "MS", value_parser = clap::value_parser!(u64).range(10..=3_600_000))]
    every_ms: u64,
    /// End after so many looks.
    #[arg(long, value_name = "N")]
    count: Option<NonZeroU32>,
}

pub(super) async fn main(robot: &mut Conversation, args: &Args, json: bool) -> Result<Exit, Failure> {
    let began = Instant::now();
    let mut ticks = tokio::time::interval(Duration::from_millis(args.every_ms));
    let mut before = None;
    let mut left = args.count.map(NonZeroU32::get);
    while left != Some(0) {
        ticks.tick().await;
        let seen = (status::read(robot).await?, position::read(robot).await?);
        let (state, pose) = &seen;
        let seconds = began.elapsed().as_secs_f64();
        if json {
            let mut document = status::state_json(*state);
            document["seconds"] = serde_json::json!(seconds);
            document["position"] = position::as_json(pose);
            print(&document.to_string())?;
        } else if before != Some(seen) {
            print(&format!(
                "{seconds:9.3} s  {}\n             {}",
                status::one_line(*state),
                position::one_line(pose)
            ))?;
            before = Some(seen);
        }
        left = left.map(|left| left - 1);
    }
    Ok(Exit::Done)
}
