//! Time as an argument.

use serde::{Deserialize, Serialize};

/// A moment of a run: nanoseconds since the run began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
pub struct Stamp {
    /// Nanoseconds since the run began.
    pub ns: u64,
}

impl Stamp {
    /// The beginning of the run.
    pub const START: Self = Self { ns: 0 };

    /// The moment `ms` milliseconds later.
    pub fn plus_ms(self, ms: u64) -> Self {
        Self {
            ns: self.ns.saturating_add(ms.saturating_mul(1_000_000)),
        }
    }

    /// Milliseconds from `earlier` to this moment; 0 if it is later.
    pub fn ms_since(self, earlier: Self) -> u64 {
        self.ns.saturating_sub(earlier.ns) / 1_000_000
    }

    /// Seconds since the run began.
    pub fn seconds(self) -> f64 {
        self.ns as f64 * 1e-9
    }
}

/// The earlier of two optional moments; `None` means never.
pub fn earlier(a: Option<Stamp>, b: Option<Stamp>) -> Option<Stamp> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}
