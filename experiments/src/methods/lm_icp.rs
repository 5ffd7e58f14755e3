//! LM-ICP: A. W. Fitzgibbon, "Robust registration of 2D and 3D point sets", Image and Vision Computing 21, 2003.
//!
//! The robust error `Σ ε²(D(T s_i))` over the distances D to the target is minimised by Levenberg and Marquardt's method over
//! the six parameters at once, with Huber's kernel `ε² = r²` up to its width and `2 width r − width²` beyond. Simplified: D
//! and its gradient come from a kd-tree at each point instead of a distance transform on a grid, and are therefore exact.

use bladescan::geometry::PointCloud;
use nalgebra::{Isometry3, Matrix6, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

use super::closest::{Closest, Pair};
use super::expectation::mean_and_scatter;

/// The kernel and when to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LmSettings {
    /// Where Huber's kernel turns from square to linear, over the target's root mean square radius.
    pub(crate) huber_factor: f64,
    /// Marquardt's damping at the start, over the diagonal.
    pub(crate) start_damping: f64,
    /// The most evaluations of the distances.
    pub(crate) evaluation_max_count: u32,
    /// Stops when a step lowers the error by less than this share.
    pub(crate) stop_fraction: f64,
}

impl Default for LmSettings {
    fn default() -> Self {
        Self {
            huber_factor: HUBER_FACTOR,
            start_damping: START_DAMPING,
            evaluation_max_count: EVALUATION_MAX_COUNT,
            stop_fraction: STOP_FRACTION,
        }
    }
}

/// Registers from `start` (target_from_source).
pub(crate) fn register(
    source: &PointCloud,
    target: &PointCloud,
    start: &Isometry3<f64>,
    settings: &LmSettings,
) -> Isometry3<f64> {
    let closest = Closest::new(target.points());
    let width = settings.huber_factor * mean_and_scatter(target.points()).1.sqrt();
    let centroid = source.centroid();
    let (mut pose, mut damping) = (*start, settings.start_damping);
    let mut pairs = closest.pairs(source.points(), &pose);
    let mut error = robust_error(&pairs, width);
    for _ in 0..settings.evaluation_max_count {
        let Some(step) = step(&pairs, &pose, &(pose * centroid), width, damping) else {
            break;
        };
        let tried = step * pose;
        let tried_pairs = closest.pairs(source.points(), &tried);
        let tried_error = robust_error(&tried_pairs, width);
        if tried_error < error {
            let is_last = error - tried_error <= settings.stop_fraction * error;
            (pose, pairs, error, damping) = (tried, tried_pairs, tried_error, damping / DAMPING_RATIO);
            if is_last {
                break;
            }
        } else {
            damping *= DAMPING_RATIO;
            if damping > DAMPING_MAX {
                break;
            }
        }
    }
    pose
}

fn robust_error(pairs: &[Pair], width: f64) -> f64 {
    pairs.iter().map(|pair| huber(pair.squared.sqrt(), width).0).sum()
}

/// Huber's kernel ε² of a distance, and the slope of its square root ε.
fn huber(distance: f64, width: f64) -> (f64, f64) {
    if distance <= width {
        return (distance * distance, 1.0);
    }
    let squared = 2.0 * width * distance - width * width;
    (squared, width / squared.sqrt())
}

/// The damped step on SE(3), a turn about `pivot` and a shift; `None` where the damped normal equations are singular.
fn step(
    pairs: &[Pair],
    pose: &Isometry3<f64>,
    pivot: &Point3<f64>,
    width: f64,
    damping: f64,
) -> Option<Isometry3<f64>> {
    let (mut matrix, mut vector) = (Matrix6::zeros(), Vector6::zeros());
    for pair in pairs {
        let place = pose * pair.from;
        let distance = pair.squared.sqrt();
        if distance <= 0.0 {
            continue;
        }
        let away = (place - pair.to) / distance;
        let (squared, slope) = huber(distance, width);
        let turn = (place - pivot).cross(&away);
        let row = Vector6::new(turn.x, turn.y, turn.z, away.x, away.y, away.z) * slope;
        matrix += row * row.transpose();
        vector += row * squared.sqrt();
    }
    let damped = matrix + Matrix6::from_diagonal(&(matrix.diagonal() * damping));
    let solved = damped.cholesky()?.solve(&-vector);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(solved[0], solved[1], solved[2]));
    let shift = Vector3::new(solved[3], solved[4], solved[5]);
    Some(Translation3::from(pivot.coords + shift) * turn * Translation3::from(-pivot.coords))
}

/// Fitzgibbon leaves the width open; about the distance up to which two blades' surfaces are near each other.
const HUBER_FACTOR: f64 = 0.05;

/// Marquardt's usual beginning.
const START_DAMPING: f64 = 1e-3;

/// Marquardt's usual ratio.
const DAMPING_RATIO: f64 = 10.0;

/// A step so damped moves nothing.
const DAMPING_MAX: f64 = 1e10;

/// Several times what the paper's runs take.
const EVALUATION_MAX_COUNT: u32 = 200;

/// The error is flat.
const STOP_FRACTION: f64 = 1e-8;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn permuted_points_are_laid_on_each_other() {
        let pair = testing::permuted(400, 10.0, [0.03, -0.02, 0.02]);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }

    #[test]
    fn the_kernel_and_its_slope_go_on_smoothly_at_the_width() {
        let (inside, outside) = (huber(0.5 - 1e-9, 0.5), huber(0.5 + 1e-9, 0.5));
        assert!((inside.0 - outside.0).abs() < 1e-8 && (inside.1 - outside.1).abs() < 1e-8);
        let ahead = huber(0.8 + 1e-6, 0.5).0.sqrt() - huber(0.8 - 1e-6, 0.5).0.sqrt();
        assert!((ahead / 2e-6 - huber(0.8, 0.5).1).abs() < 1e-6);
    }
}
