//! How the device's clock stands to the run's: offset and drift, from the answers to our pings.

use crate::stamp::Stamp;
use std::collections::VecDeque;

/// What is known of the device's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockEstimate {
    /// Device time less run time, ns, right to half the round trip.
    pub offset_ns: i64,
    /// From our ping to its answer, ns: the shortest of the last eight answers.
    pub round_trip_ns: u64,
    /// How much faster the device's clock runs, parts in a million; `None` until there are ten seconds to tell it from.
    pub skew_ppm: Option<f64>,
}

/// One answered ping.
#[derive(Debug, Clone, Copy)]
struct Answer {
    /// Half way between ping and answer, run time.
    at_ns: u64,
    offset_ns: i64,
    round_trip_ns: u64,
}

/// The answers so far. Delays only ever lengthen the round trip, so the quickest answer is the best one.
#[derive(Debug, Default)]
pub(super) struct Clock {
    recent: VecDeque<Answer>,
    /// The best of the first window.
    anchor: Option<Answer>,
    answer_count: u64,
}

impl Clock {
    /// A ping that left at `sent_ns` was answered with the device's time.
    pub(super) fn handle_answer(&mut self, now: Stamp, sent_ns: u64, device_ns: u64) {
        let round_trip_ns = now.ns.saturating_sub(sent_ns);
        let at_ns = sent_ns + round_trip_ns / 2;
        let answer = Answer {
            at_ns,
            offset_ns: device_ns.wrapping_sub(at_ns) as i64,
            round_trip_ns,
        };
        if self.recent.len() == WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back(answer);
        self.answer_count += 1;
        if self.answer_count <= WINDOW as u64 {
            self.anchor = self.best();
        }
    }

    /// What is known, `None` before the first answer.
    pub(super) fn estimate(&self) -> Option<ClockEstimate> {
        let (best, anchor) = (self.best()?, self.anchor?);
        let between_ns = best.at_ns.saturating_sub(anchor.at_ns);
        let drift_ns = best.offset_ns.wrapping_sub(anchor.offset_ns);
        Some(ClockEstimate {
            offset_ns: best.offset_ns,
            round_trip_ns: best.round_trip_ns,
            skew_ppm: (between_ns >= SKEW_AFTER_NS).then(|| drift_ns as f64 / between_ns as f64 * 1e6),
        })
    }

    /// A moment of the device's clock in the run's time.
    pub(super) fn run_time(&self, device_ns: u64) -> Option<Stamp> {
        let ns = device_ns.wrapping_sub(self.best()?.offset_ns as u64);
        // A moment before the run began shows as a huge one.
        Some(Stamp {
            ns: if ns > i64::MAX as u64 { 0 } else { ns },
        })
    }

    /// Whether the estimate is due to be told: after the first answer and about once a minute.
    pub(super) fn is_telling(&self) -> bool {
        self.answer_count % TELL_EVERY == 1
    }

    fn best(&self) -> Option<Answer> {
        self.recent
            .iter()
            .rev()
            .copied()
            .min_by_key(|answer| answer.round_trip_ns)
    }
}

/// Answers that are compared.
const WINDOW: usize = 8;
/// Ten seconds: drift of 100 ppm is then 1 ms, well above half a round trip.
const SKEW_AFTER_NS: u64 = 10_000_000_000;
const TELL_EVERY: u64 = 60;

#[cfg(test)]
mod tests {
    use super::*;

    /// A device whose clock is 5 s ahead and gains 100 µs a second, with an answer that takes `back_ns` on its way.
    fn device_ns(run_ns: u64) -> u64 {
        5_000_000_000 + run_ns + run_ns / 10_000
    }

    fn heard(answers: impl Iterator<Item = (u64, u64, u64)>) -> Clock {
        let mut clock = Clock::default();
        for (sent_ns, there_ns, back_ns) in answers {
            let now = Stamp {
                ns: sent_ns + there_ns + back_ns,
            };
            clock.handle_answer(now, sent_ns, device_ns(sent_ns + there_ns));
        }
        clock
    }

    #[test]
    fn the_quickest_answer_gives_the_offset_however_slow_the_others_are() {
        let slow = (0..6).map(|second| (second * 1_000_000_000, 300_000, 9_000_000));
        let quick = std::iter::once((6_000_000_000, 100_000, 100_000));
        let estimate = heard(slow.chain(quick)).estimate().unwrap();
        assert_eq!(estimate.round_trip_ns, 200_000);
        let error_ns = estimate.offset_ns - (5_000_000_000 + 600_010);
        assert!(error_ns.abs() <= 100_000, "{error_ns}");
        assert_eq!(estimate.skew_ppm, None);
    }

    #[test]
    fn drift_is_found_and_device_times_become_run_times() {
        let clock = heard((0..60).map(|second| (second * 1_000_000_000, 100_000, 120_000)));
        let skew_ppm = clock.estimate().unwrap().skew_ppm.unwrap();
        assert!((skew_ppm - 100.0).abs() < 1.0, "{skew_ppm}");
        let run_ns = 59_500_000_000;
        let found = clock.run_time(device_ns(run_ns)).unwrap();
        // Half the asymmetry of the path, and the drift since the best answer.
        assert!(found.ns.abs_diff(run_ns) < 1_000_000, "{found:?}");
    }

    #[test]
    fn a_moment_before_the_run_is_its_beginning_and_nothing_is_known_before_the_first_answer() {
        assert_eq!(Clock::default().run_time(7), None);
        assert_eq!(Clock::default().estimate(), None);
        let clock = heard(std::iter::once((1_000_000, 0, 0)));
        assert_eq!(clock.run_time(17), Some(Stamp::START));
    }
}
