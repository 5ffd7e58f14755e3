//! Iterative closest point, point to point: P. J. Besl, N. D. McKay, "A method for registration of 3-D shapes", PAMI 14(2), 1992.
//!
//! Each source point is paired with the closest target point, the motion of least squares is taken, until the mean squared
//! distance hardly falls. Simplified: without the acceleration of their section IV-C; the rotation by singular values
//! instead of the quaternion's eigenvector (the same motion).

use bladescan::geometry::PointCloud;
use nalgebra::Isometry3;

use super::closest::{Closest, mean_square, motion_of};

/// When to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IcpSettings {
    /// The most iterations.
    pub(crate) iteration_max_count: u32,
    /// Stops when the mean squared distance falls by less than this share of itself.
    pub(crate) stop_fraction: f64,
}

impl Default for IcpSettings {
    fn default() -> Self {
        Self {
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
    settings: &IcpSettings,
) -> Isometry3<f64> {
    let closest = Closest::new(target.points());
    let mut pose = *start;
    let mut last = f64::INFINITY;
    for _ in 0..settings.iteration_max_count {
        let pairs = closest.pairs(source.points(), &pose);
        let mean_square = mean_square(&pairs);
        if last - mean_square <= settings.stop_fraction * mean_square {
            break;
        }
        last = mean_square;
        pose = motion_of(&pairs);
    }
    pose
}

/// Besl and McKay's runs end within 50; slow slides along a surface take more.
const ITERATION_MAX_COUNT: u32 = 200;

/// Their threshold is a share of the model's size, which they leave open.
const STOP_FRACTION: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn permuted_points_are_laid_on_each_other() {
        let pair = testing::permuted(400, 10.0, [0.03, -0.02, 0.02]);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }
}
