//! The network between controller and robot, when it is bad.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::draw::{Happening, Kind};

/// What is wrong at the moment, and what came of it.
#[derive(Debug)]
pub(super) struct Network {
    chance: ChaCha8Rng,
    /// With the time at which it is over.
    troubles: Vec<(Happening, u64)>,
    /// Kinds that something has befallen a datagram of.
    met: Vec<Kind>,
}

impl Network {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            chance: ChaCha8Rng::seed_from_u64(seed),
            troubles: Vec::new(),
            met: Vec::new(),
        }
    }

    pub(super) fn begin(&mut self, now_ns: u64, happening: Happening) {
        self.troubles.push((happening, now_ns + happening.span_ns));
    }

    /// How late a datagram comes, each time that it does.
    pub(super) fn carry(&mut self, now_ns: u64) -> Vec<u64> {
        self.troubles.retain(|(_, until_ns)| *until_ns > now_ns);
        let mut late_ns = vec![LATENCY_NS];
        for (happening, _) in &self.troubles {
            let is_hit = self.chance.random::<f64>() < SHARE_MIN + happening.size * (SHARE_MAX - SHARE_MIN);
            let by_ns = self.chance.random_range(0..LATE_NS_MAX);
            let befalls = match happening.kind {
                Kind::NetworkDelay => {
                    late_ns
                        .iter_mut()
                        .for_each(|late_ns| *late_ns += (happening.size * DELAY_NS_MAX) as u64);
                    true
                }
                Kind::RobotSilent => {
                    late_ns.clear();
                    true
                }
                Kind::NetworkLoss if is_hit => {
                    late_ns.clear();
                    true
                }
                Kind::NetworkDouble if is_hit => {
                    late_ns.push(LATENCY_NS + by_ns);
                    true
                }
                Kind::NetworkOvertaking if is_hit => {
                    late_ns.iter_mut().for_each(|late_ns| *late_ns += by_ns);
                    true
                }
                _ => false,
            };
            if befalls && !self.met.contains(&happening.kind) {
                self.met.push(happening.kind);
            }
        }
        late_ns
    }

    /// What has been met since this was asked last.
    pub(super) fn take_met(&mut self) -> Vec<Kind> {
        core::mem::take(&mut self.met)
    }
}

pub(super) const LATENCY_NS: u64 = 200_000;
/// Share of datagrams that is hit.
const SHARE_MIN: f64 = 0.02;
const SHARE_MAX: f64 = 0.25;
const LATE_NS_MAX: u64 = 60_000_000;
const DELAY_NS_MAX: f64 = 120e6;
