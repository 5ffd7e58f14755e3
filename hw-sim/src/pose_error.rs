//! Small rigid motions by which the world differs from what the controller believes.

use crate::draws::{Purpose, generator, normal_pair, uniform};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Where the robot really stands at one acquisition, relative to where it says it stands.
///
/// Rotation vector and translation are independent normal numbers per axis, of standard deviation `sigma_rad` and
/// `sigma_mm`; a zero gives none. Equal arguments give equal bits.
pub fn pose_error(seed: u64, trigger_id: u64, sigma_mm: f64, sigma_rad: f64) -> Isometry3<f64> {
    small_motion(seed, Purpose::PoseError, trigger_id, sigma_mm, sigma_rad)
}

/// How far one calibrated transform of the station is off, the same for the whole run.
///
/// `which` tells the transforms apart (hand-eye, grip). Distribution as in [`pose_error`].
pub fn calibration_error(seed: u64, which: u64, sigma_mm: f64, sigma_rad: f64) -> Isometry3<f64> {
    small_motion(seed, Purpose::CalibrationError, which, sigma_mm, sigma_rad)
}

fn small_motion(seed: u64, purpose: Purpose, which: u64, sigma_mm: f64, sigma_rad: f64) -> Isometry3<f64> {
    let mut rng = generator(seed, purpose, which, 0);
    let [a, b, c] = [(); 3].map(|()| normal_pair(uniform(&mut rng), uniform(&mut rng)));
    Isometry3::from_parts(
        Translation3::from(Vector3::new(a[0], a[1], b[0]) * sigma_mm),
        UnitQuaternion::from_scaled_axis(Vector3::new(b[1], c[0], c[1]) * sigma_rad),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_over_many_acquisitions_is_as_asked() {
        let (mut shift_mm2, mut turn_rad2) = (0.0, 0.0);
        for trigger_id in 0..4000 {
            let error = pose_error(5, trigger_id, 0.05, 0.001);
            shift_mm2 += error.translation.vector.norm_squared() / (3.0 * 4000.0);
            turn_rad2 += error.rotation.scaled_axis().norm_squared() / (3.0 * 4000.0);
        }
        assert!((shift_mm2.sqrt() / 0.05 - 1.0).abs() < 0.03, "{}", shift_mm2.sqrt());
        assert!((turn_rad2.sqrt() / 0.001 - 1.0).abs() < 0.03, "{}", turn_rad2.sqrt());
    }

    #[test]
    fn a_retake_draws_another_error_and_the_calibration_none_of_them() {
        assert_eq!(pose_error(5, 7, 1.0, 1.0), pose_error(5, 7, 1.0, 1.0));
        assert_ne!(pose_error(5, 7, 1.0, 1.0), pose_error(5, 8, 1.0, 1.0));
        assert_ne!(pose_error(5, 7, 1.0, 1.0), calibration_error(5, 7, 1.0, 1.0));
        assert_eq!(pose_error(5, 7, 0.0, 0.0), Isometry3::identity());
    }
}
