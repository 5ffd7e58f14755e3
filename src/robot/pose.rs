//! Poses as the controller counts them: whole micrometres and ten-thousandths of a degree.

use crate::geometry::{fixed_xyz_from_rotation, rotation_from_fixed_xyz};
use nalgebra::{Isometry3, Translation3, UnitQuaternion};

/// A cartesian pose on the wire: X, Y, Z in 0.001 mm, Rx, Ry, Rz in 0.0001 degrees about fixed axes, in that order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct WirePose {
    /// X, Y, Z in micrometres.
    pub position_um: [i32; 3],
    /// Rx, Ry, Rz in 0.0001 degrees.
    pub rotation_e4_deg: [i32; 3],
}

impl WirePose {
    /// The nearest pose that the wire can carry. Positions beyond ±2,147 m saturate (workspaces are checked before).
    pub fn from_isometry(base_from_tool: &Isometry3<f64>) -> Self {
        let [rx, ry, rz] = fixed_xyz_from_rotation(&base_from_tool.rotation);
        let position = base_from_tool.translation.vector;
        Self {
            position_um: [position.x, position.y, position.z].map(|mm| (mm * 1e3).round() as i32),
            rotation_e4_deg: [rx, ry, rz].map(|rad| (rad.to_degrees() * 1e4).round() as i32),
        }
    }

    /// The rigid motion `base_from_tool` in millimetres.
    pub fn to_isometry(self) -> Isometry3<f64> {
        let [x, y, z] = self.position_um.map(|um| f64::from(um) * 1e-3);
        let [rx, ry, rz] = self.rotation_e4_deg.map(|e4| (f64::from(e4) * 1e-4).to_radians());
        let rotation: UnitQuaternion<f64> = rotation_from_fixed_xyz(rx, ry, rz);
        Isometry3::from_parts(Translation3::new(x, y, z), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_pose_survives_the_wire_to_its_resolution_also_at_the_gimbal() {
        for (ry_deg, rz_deg) in [
            (0.0, 12.3456),
            (37.5, -170.0),
            (90.0, 33.0),
            (-90.0, 5.0),
            (89.99999, 60.0),
        ] {
            let pose = Isometry3::from_parts(
                Translation3::new(1000.0004, -200.5, 750.25),
                rotation_from_fixed_xyz(0.3, f64::to_radians(ry_deg), f64::to_radians(rz_deg)),
            );
            let back = WirePose::from_isometry(&pose).to_isometry();
            assert!((back.translation.vector - pose.translation.vector).norm() < 1e-3);
            assert!(
                back.rotation.angle_to(&pose.rotation).to_degrees() < 2e-4,
                "Ry {ry_deg}"
            );
        }
    }

    #[test]
    fn rx_ry_rz_turn_about_fixed_axes_in_that_order() {
        let pose = WirePose {
            position_um: [0; 3],
            rotation_e4_deg: [900_000, 0, 900_000],
        };
        // y -> z by Rx, z stays under Rz.
        let turned = pose.to_isometry() * Vector3::y();
        assert!((turned - Vector3::z()).norm() < 1e-9);
    }
}
