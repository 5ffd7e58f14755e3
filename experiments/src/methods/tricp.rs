//! Trimmed ICP: D. Chetverikov, D. Svirko, D. Stepanov, P. Krsek, "The trimmed iterative closest point algorithm", ICPR 2002;
//! D. Chetverikov, D. Stepanov, P. Krsek, "Robust Euclidean alignment of 3D point sets", IVC 23(3), 2005.
//!
//! | paper | here | unit |
//! |---|---|---|
//! | ξ | `overlap_fraction` | – |
//! | e(ξ) | `Trimmed::mean_square` | the clouds', squared |
//! | ψ(ξ) = e(ξ) / ξ^(1+λ) | `objective` | the clouds', squared |
//! | λ | `preference` | – |
//!
//! Of the closest pairs only the share ξ of least distance is kept. ξ is that of least ψ, found by golden section, each
//! value by a whole run from the start. Nothing is simplified but the search structure (a kd-tree instead of boxes).

use bladescan::geometry::PointCloud;
use nalgebra::{Isometry3, Point3};

use super::closest::{Closest, Pair, mean_square, motion_of};

/// How pairs are trimmed and when to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TrimmedSettings {
    /// The shares among which the overlap is sought.
    pub(crate) overlap_fractions: [f64; 2],
    /// λ: how much larger shares are preferred.
    pub(crate) preference: f64,
    /// The overlap is known when the search is down to this width.
    pub(crate) overlap_tolerance: f64,
    /// The most iterations of one run.
    pub(crate) iteration_max_count: u32,
    /// A run ends when the trimmed mean squared distance changes by less than this share of itself.
    pub(crate) stop_fraction: f64,
}

impl Default for TrimmedSettings {
    fn default() -> Self {
        Self {
            overlap_fractions: OVERLAP_FRACTIONS,
            preference: PREFERENCE,
            overlap_tolerance: OVERLAP_TOLERANCE,
            iteration_max_count: ITERATION_MAX_COUNT,
            stop_fraction: STOP_FRACTION,
        }
    }
}

/// Registers from `start` (target_from_source).
pub(crate) fn register(
    source: &PointCloud,
    target: &PointCloud,
    start: &Isometry3<f64>,
    settings: &TrimmedSettings,
) -> Isometry3<f64> {
    let closest = Closest::new(target.points());
    let run = |overlap: f64| trimmed(source.points(), &closest, start, overlap, settings);
    let [mut low, mut high] = settings.overlap_fractions;
    let inner = |low: f64, high: f64| [high - GOLDEN * (high - low), low + GOLDEN * (high - low)];
    let [first, second] = inner(low, high);
    // The ends are looked at too: a full overlap is the commonest.
    let mut best = run(high);
    let (mut left, mut right) = (run(first), run(second));
    while high - low > settings.overlap_tolerance {
        for found in [&left, &right] {
            if found.objective < best.objective {
                best = found.clone();
            }
        }
        if left.objective < right.objective {
            high = right.overlap;
            right = left;
            left = run(inner(low, high)[0]);
        } else {
            low = left.overlap;
            left = right;
            right = run(inner(low, high)[1]);
        }
    }
    [left, right]
        .into_iter()
        .fold(
            best,
            |best, found| if found.objective < best.objective { found } else { best },
        )
        .pose
}

#[derive(Clone)]
struct Trimmed {
    pose: Isometry3<f64>,
    overlap: f64,
    objective: f64,
}

/// One run with a fixed overlap.
fn trimmed(
    source: &[Point3<f64>],
    closest: &Closest,
    start: &Isometry3<f64>,
    overlap: f64,
    settings: &TrimmedSettings,
) -> Trimmed {
    let kept_count = ((overlap * source.len() as f64).round() as usize).max(3);
    let mut pose = *start;
    let mut last = f64::INFINITY;
    for _ in 0..settings.iteration_max_count {
        let pairs = nearest_of(closest.pairs(source, &pose), kept_count);
        let mean_square = mean_square(&pairs);
        if (last - mean_square).abs() <= settings.stop_fraction * mean_square {
            break;
        }
        last = mean_square;
        pose = motion_of(&pairs);
    }
    Trimmed {
        pose,
        overlap,
        objective: last / overlap.powf(1.0 + settings.preference),
    }
}

/// The `count` pairs of least distance, ties by lower index.
fn nearest_of(pairs: Vec<Pair>, count: usize) -> Vec<Pair> {
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by(|&a, &b| pairs[a].squared.total_cmp(&pairs[b].squared).then(a.cmp(&b)));
    order.truncate(count);
    order.into_iter().map(|index| pairs[index]).collect()
}

/// Chetverikov et al. (2005): from 40 % to all.
const OVERLAP_FRACTIONS: [f64; 2] = [0.4, 1.0];

/// λ of the same.
const PREFERENCE: f64 = 2.0;

/// Two per cent of the points more or less hardly move the pose.
const OVERLAP_TOLERANCE: f64 = 0.02;

/// Of the same.
const ITERATION_MAX_COUNT: u32 = 100;

/// Of the same.
const STOP_FRACTION: f64 = 1e-4;

/// The golden section of 1.
const GOLDEN: f64 = 0.618_033_988_749_894_8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::icp::{self, IcpSettings};
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn permuted_points_are_laid_on_each_other() {
        let pair = testing::permuted(400, 10.0, [0.03, -0.02, 0.02]);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }

    #[test]
    fn of_a_full_overlap_it_is_icp() {
        let pair = testing::noisy(600, 15.0, 0.02);
        let start = Isometry3::identity();
        let full = TrimmedSettings {
            overlap_fractions: [1.0, 1.0],
            stop_fraction: 1e-12,
            ..TrimmedSettings::default()
        };
        let trimmed = register(&pair.source, &pair.target, &start, &full);
        let to_the_end = IcpSettings {
            stop_fraction: 1e-12,
            ..IcpSettings::default()
        };
        let plain = icp::register(&pair.source, &pair.target, &start, &to_the_end);
        assert_near(&trimmed, &plain, 1e-9);
        assert!((pair.truth.inverse() * plain).translation.vector.norm() > 1e-5);
    }

    #[test]
    fn outliers_on_one_side_mislead_icp_and_not_trimmed_icp() {
        let pair = testing::with_one_sided_outliers(300, 0.3);
        let start = Isometry3::identity();
        let plain = icp::register(&pair.source, &pair.target, &start, &IcpSettings::default());
        let error = pair.truth.inverse() * plain;
        assert!(error.translation.vector.norm() > 0.05, "{error}");
        let found = register(&pair.source, &pair.target, &start, &TrimmedSettings::default());
        assert_near(&found, &pair.truth, 1e-6);
    }
}
