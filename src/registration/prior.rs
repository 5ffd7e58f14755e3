//! The start as a measurement: its mean with what the surfaces say, each weighed by its certainty.
//!
//! Near the solution the fine stage's sum of squares is quadratic, and to add the start's information to its normal
//! equations is the same as to take the mean of both motions weighed by the inverses of their covariances. Done so, it
//! is the same for trimmed ICP and for full-sample NFI, and it takes the surfaces' own word on how little they know:
//! noise in the normals does not feign information against the start.

use nalgebra::{Isometry3, Matrix6, Point3, Vector6};

use super::StartSigma;
use super::twist::{motion_between, moved};

/// The weighted mean of two poses and its covariance.
pub(super) struct Weighed {
    pub(super) pose: Isometry3<f64>,
    pub(super) covariance: Matrix6<f64>,
}

/// The mean of `start`, known to `sigma`, and of `found` with its `covariance` of `[rx ry rz tx ty tz]` about the image
/// of `centroid`; `gyration` is the template's radius of gyration. `None` when nothing finite comes out.
pub(super) fn weighed(
    start: &Isometry3<f64>,
    sigma: &StartSigma,
    found: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
    centroid: &Point3<f64>,
    gyration: f64,
) -> Option<Weighed> {
    // Turns times the radius of gyration, so that all six are lengths.
    let unit = Vector6::new(gyration, gyration, gyration, 1.0, 1.0, 1.0);
    let over = unit.map(f64::recip);
    let of_found = Matrix6::from_diagonal(&unit) * covariance * Matrix6::from_diagonal(&unit);
    let (turn, shift) = ((sigma.turn_rad * gyration).powi(2), sigma.shift.powi(2));
    let of_start = Matrix6::from_diagonal(&Vector6::new(turn, turn, turn, shift, shift, shift));
    let inverse = (of_start + of_found).cholesky()?.inverse();
    let motion = motion_between(start, found, centroid).component_mul(&unit);
    let motion = (of_start * (inverse * motion)).component_mul(&over);
    // Symmetric but for rounding.
    let together = of_start * inverse * of_found;
    let together = (together + together.transpose()) / 2.0;
    let covariance = Matrix6::from_diagonal(&over) * together * Matrix6::from_diagonal(&over);
    let finite = motion.iter().chain(covariance.iter()).all(|value| value.is_finite());
    finite.then(|| Weighed {
        pose: moved(start, &(start * centroid), &motion),
        covariance,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
        let error = a.inverse() * b;
        error.rotation.angle() + error.translation.vector.norm()
    }

    #[test]
    fn the_more_certain_of_both_has_the_say_and_equals_meet_in_the_middle() {
        let start = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.1, 0.2, 0.3));
        let found = Isometry3::new(Vector3::new(1.01, 1.98, 3.03), Vector3::new(0.11, 0.2, 0.28));
        let centroid = Point3::new(0.3, -0.2, 0.1);
        let (gyration, turn_rad, shift) = (2.0, 0.01, 0.02);
        let covariance = Matrix6::from_diagonal(&Vector6::new(1e-4, 1e-4, 1e-4, 4e-4, 4e-4, 4e-4));
        let with = |factor: f64| {
            let sigma = StartSigma {
                turn_rad: factor * turn_rad,
                shift: factor * shift,
            };
            weighed(&start, &sigma, &found, &covariance, &centroid, gyration).unwrap()
        };
        assert!(apart(&with(1e-6).pose, &start) < 1e-9);
        assert!(apart(&with(1e6).pose, &found) < 1e-9);
        assert!((with(1e6).covariance - covariance).amax() < 1e-9);
        let middle = with(1.0);
        let motion = motion_between(&start, &found, &centroid);
        let half = motion_between(&start, &middle.pose, &centroid);
        assert!((motion / 2.0 - half).amax() < 1e-12, "{motion} {half}");
        assert!((middle.covariance - covariance / 2.0).amax() < 1e-12);
    }
}
