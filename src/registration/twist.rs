//! Small motions about a point.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3, Vector6};

/// The pose after a small motion `[rx ry rz tx ty tz]` about `centre`: a turn by the rotation vector about `centre`,
/// then a shift. `centre` and the motion are in the target frame.
pub(super) fn moved(pose: &Isometry3<f64>, centre: &Point3<f64>, motion: &Vector6<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(motion[0], motion[1], motion[2]));
    let shift = Vector3::new(motion[3], motion[4], motion[5]);
    let back = Translation3::from(centre.coords + shift);
    let mut pose = back * turn * Translation3::from(-centre.coords) * pose;
    pose.rotation.renormalize();
    pose
}

/// The motion about the image of `source_centre` under `from` that takes pose `from` to pose `to`; the inverse of
/// [`moved`].
pub(super) fn motion_between(from: &Isometry3<f64>, to: &Isometry3<f64>, source_centre: &Point3<f64>) -> Vector6<f64> {
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
    let shift = to * source_centre - from * source_centre;
    Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z)
}

/// A motion with its turns as the lengths they make at `radius`, so that all six are lengths.
pub(super) fn scaled(motion: &Vector6<f64>, radius: f64) -> Vector6<f64> {
    let mut scaled = *motion;
    for axis in 0..3 {
        scaled[axis] *= radius;
    }
    scaled
}

/// A motion with its turns in radians; the inverse of [`scaled`].
pub(super) fn unscaled(scaled: &Vector6<f64>, radius: f64) -> Vector6<f64> {
    let mut motion = *scaled;
    for axis in 0..3 {
        motion[axis] /= radius;
    }
    motion
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_scaled_is_the_arc_at_the_radius_and_a_shift_stays() {
        let motion = Vector6::new(0.1, -0.2, 0.3, 4.0, 5.0, 6.0);
        let lengths = scaled(&motion, 2.0);
        assert_eq!(lengths, Vector6::new(0.2, -0.4, 0.6, 4.0, 5.0, 6.0));
        assert_eq!(unscaled(&lengths, 2.0), motion);
    }

    #[test]
    fn the_motion_between_two_poses_leads_from_one_to_the_other() {
        let from = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.3, -0.2, 1.0));
        let to = Isometry3::new(Vector3::new(1.1, 1.8, 3.3), Vector3::new(0.2, -0.1, 1.2));
        let centre = Point3::new(5.0, -3.0, 0.5);
        let motion = motion_between(&from, &to, &centre);
        let there = moved(&from, &(from * centre), &motion);
        let error = to.inverse() * there;
        assert!(error.rotation.angle() < 1e-12 && error.translation.vector.norm() < 1e-12);
    }
}
