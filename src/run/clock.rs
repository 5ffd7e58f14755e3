//! The clock of one run or conversation.

use crate::stamp::Stamp;
use std::time::Duration;
use tokio::time::Instant;

/// Stamps counted from its start.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    began: Instant,
}

impl Clock {
    pub(super) fn start() -> Self {
        Self { began: Instant::now() }
    }

    pub(super) fn now(self) -> Stamp {
        Stamp {
            ns: self.began.elapsed().as_nanos() as u64,
        }
    }

    /// Ends at that stamp; without one never.
    pub(super) async fn sleep_until(self, wake: Option<Stamp>) {
        match wake {
            Some(stamp) => tokio::time::sleep_until(self.began + Duration::from_nanos(stamp.ns)).await,
            None => std::future::pending().await,
        }
    }
}
