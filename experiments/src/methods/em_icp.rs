//! EM-ICP: S. Granger, X. Pennec, "Multi-scale EM-ICP: a fast and robust approach for surface registration", ECCV 2002.
//!
//! Every source point is paired with all target points, weighed by `exp(−d² / 2σ²)` and normalised over the target; the motion
//! of least weighted squares is taken; σ falls by a fixed ratio an iteration (annealing), and the coarser σ, the fewer source
//! points take part. Simplified: the noise is isotropic; points are thinned evenly instead of being averaged in balls; and
//! where theirs ends at the noise that is known of the sensor, this one ends where the residuals are as large as σ (a smaller
//! one would not be supported by the data), or at a share of the target's spacing.

use bladescan::geometry::PointCloud;
use nalgebra::Isometry3;

use super::affinity::{Centres, Gaussian, Lookers};
use super::closest::Closest;
use super::expectation::{Expectation, mean_and_scatter};

/// The annealing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EmIcpSettings {
    /// The first σ over the target's root mean square radius.
    pub(crate) start_factor: f64,
    /// σ of one iteration over that of the last.
    pub(crate) ratio: f64,
    /// The least σ over the target's spacing.
    pub(crate) end_factor: f64,
    /// The source points that take part are about σ over this number apart.
    pub(crate) thinning: f64,
}

impl Default for EmIcpSettings {
    fn default() -> Self {
        Self {
            start_factor: START_FACTOR,
            ratio: RATIO,
            end_factor: END_FACTOR,
            thinning: THINNING,
        }
    }
}

/// Registers from `start` (target_from_source).
pub(crate) fn register(
    source: &PointCloud,
    target: &PointCloud,
    start: &Isometry3<f64>,
    settings: &EmIcpSettings,
) -> Isometry3<f64> {
    let centres = Centres::new(target.points());
    let all = Lookers::new(source.points());
    let source_spacing = Closest::new(source.points()).spacing();
    let end = settings.end_factor * Closest::new(target.points()).spacing();
    let mut sigma = settings.start_factor * mean_and_scatter(target.points()).1.sqrt();
    let mut pose = *start;
    let mut last_count = 0;
    while sigma > end {
        // The points of a surface: their count falls with the square of the distance between them.
        let step = (sigma / (settings.thinning * source_spacing)).powi(2);
        let lookers = all.thinned(step.clamp(1.0, (source.len() / COUNT_MIN).max(1) as f64) as usize);
        let claims = centres.claims(&lookers, &pose, Gaussian { sigma });
        let expectation = Expectation::new(&lookers, pose, claims, 0.0);
        pose = expectation.best_pose();
        let residual = expectation.squared_at(&pose) / (3.0 * expectation.mass().max(1.0));
        let is_supported = residual <= sigma * sigma || lookers.points().len() < source.len();
        if !is_supported || last_count > 0 {
            last_count += 1;
        }
        if last_count == LAST_COUNT {
            break;
        }
        if last_count == 0 {
            sigma *= settings.ratio;
        }
    }
    pose
}

/// Half of the radius: the clouds' axes of inertia are then laid on each other, as the paper has it.
const START_FACTOR: f64 = 0.5;

/// Slow enough that a slower one changes nothing on blades.
const RATIO: f64 = 0.95;

/// Below it a point's nearest partner has practically all of the weight.
const END_FACTOR: f64 = 0.1;

/// Several points in each ball of σ.
const THINNING: f64 = 3.0;

/// Fewer source points are never taken.
const COUNT_MIN: usize = 200;

/// Iterations at the last σ.
const LAST_COUNT: u32 = 20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::icp::{self, IcpSettings};
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn permuted_points_are_laid_on_each_other() {
        let pair = testing::permuted(400, 30.0, [0.2, -0.1, 0.1]);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }

    #[test]
    fn noise_ends_the_annealing_before_single_partners() {
        let pair = testing::noisy(600, 10.0, 0.05);
        let start = Isometry3::identity();
        let found = register(&pair.source, &pair.target, &start, &EmIcpSettings::default());
        let single = icp::register(&pair.source, &pair.target, &start, &IcpSettings::default());
        let turn = |found: &Isometry3<f64>| (pair.truth.inverse() * found).rotation.angle();
        assert!(
            turn(&found) < 0.05 && turn(&found) < 0.8 * turn(&single),
            "{} and {}",
            turn(&found),
            turn(&single)
        );
    }
}
