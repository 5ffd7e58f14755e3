//! The clock of one run or conversation.

use crate::stamp::Stamp;
use std::time::Duration;
use tokio::time::Instant;

/// Stamps counted from its start.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock {
    began: Instant,
    /// What it showed then.
    shown: u64,
}

impl Clock {
    pub(super) fn start() -> Self {
        Self::start_at(Stamp::START)
    }

    /// A clock that shows `now` now.
    pub(super) fn start_at(now: Stamp) -> Self {
        Self {
            began: Instant::now(),
            shown: now.ns,
        }
    }

    pub(super) fn now(self) -> Stamp {
        Stamp {
            ns: self.shown + self.began.elapsed().as_nanos() as u64,
        }
    }

    /// Ends at that stamp; without one never.
    pub(super) async fn sleep_until(self, wake: Option<Stamp>) {
        match wake {
            Some(stamp) => {
                let later = stamp.ns.saturating_sub(self.shown);
                tokio::time::sleep_until(self.began + Duration::from_nanos(later)).await;
            }
            None => std::future::pending().await,
        }
    }
}
