//! Poses as the robot controller holds them: whole micrometres and whole 0.0001 degrees.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

/// Pose in the robot's base, quantised as HSES carries it.
///
/// The angles turn about the **fixed** axes x, y, z in that order: R = Rz · Ry · Rx.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pose {
    /// x, y, z in µm.
    pub position_um: [i32; 3],
    /// Rx, Ry, Rz in 0.0001 degrees, each in (-180, 180] degrees.
    pub turn_e4_deg: [i32; 3],
}

impl Pose {
    /// Nearest quantised pose. At the gimbal poses (Ry = ±90 degrees) Rx is 0.
    pub fn from_isometry(base_from_tool: &Isometry3<f64>) -> Self {
        let rotation = base_from_tool.rotation.to_rotation_matrix();
        let angles_rad = fixed_angles_rad(rotation.matrix());
        Self {
            position_um: core::array::from_fn(|axis| {
                (base_from_tool.translation.vector[axis] * UM_PER_MM).round() as i32
            }),
            turn_e4_deg: core::array::from_fn(|axis| {
                let turn_e4_deg = (angles_rad[axis].to_degrees() * E4).round() as i32;
                if turn_e4_deg <= -HALF_TURN_E4_DEG {
                    turn_e4_deg + 2 * HALF_TURN_E4_DEG
                } else {
                    turn_e4_deg
                }
            }),
        }
    }

    /// The same pose from millimetres and degrees, fixed axes.
    pub fn from_mm_deg(position_mm: [f64; 3], turn_deg: [f64; 3]) -> Self {
        Self::from_isometry(&isometry_from_mm_deg(position_mm, turn_deg))
    }

    /// `base_from_tool` in mm.
    pub fn to_isometry(self) -> Isometry3<f64> {
        isometry_from_mm_deg(
            self.position_um.map(|um| f64::from(um) / UM_PER_MM),
            self.turn_e4_deg.map(|turn| f64::from(turn) / E4),
        )
    }
}

/// Rigid transform of a position in mm and turns in degrees about the fixed axes x, y, z in that order.
pub fn isometry_from_mm_deg(position_mm: [f64; 3], turn_deg: [f64; 3]) -> Isometry3<f64> {
    let [x_rad, y_rad, z_rad] = turn_deg.map(f64::to_radians);
    let turn = |axis, angle_rad| UnitQuaternion::from_axis_angle(&axis, angle_rad);
    let rotation = turn(Vector3::z_axis(), z_rad) * turn(Vector3::y_axis(), y_rad) * turn(Vector3::x_axis(), x_rad);
    Isometry3::from_parts(Translation3::from(Vector3::from(position_mm)), rotation)
}

/// Position on the straight line and turn on the shortest way, `share` 0 to 1. At half a turn the way is one of the two.
pub fn interpolate(start: &Isometry3<f64>, end: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let position = start.translation.vector.lerp(&end.translation.vector, share);
    let turn = (start.rotation.inverse() * end.rotation).scaled_axis() * share;
    Isometry3::from_parts(
        Translation3::from(position),
        start.rotation * UnitQuaternion::from_scaled_axis(turn),
    )
}

/// Rx, Ry, Rz in rad of R = Rz · Ry · Rx.
fn fixed_angles_rad(rotation: &Matrix3<f64>) -> [f64; 3] {
    let cos_y = rotation[(0, 0)].hypot(rotation[(1, 0)]);
    let y_rad = (-rotation[(2, 0)]).atan2(cos_y);
    if cos_y > GIMBAL_COS {
        [
            rotation[(2, 1)].atan2(rotation[(2, 2)]),
            y_rad,
            rotation[(1, 0)].atan2(rotation[(0, 0)]),
        ]
    } else {
        [0.0, y_rad, (-rotation[(0, 1)]).atan2(rotation[(1, 1)])]
    }
}

const UM_PER_MM: f64 = 1000.0;
const E4: f64 = 10_000.0;
const HALF_TURN_E4_DEG: i32 = 1_800_000;
/// Below this cosine of Ry only the sum or the difference of Rx and Rz is determined.
const GIMBAL_COS: f64 = 1e-7;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quantised_pose_survives_the_way_through_a_rotation() {
        for turn_e4_deg in [
            [0, 0, 0],
            [1_800_000, 0, -900_000],
            [1, -2, 3],
            [-1_234_567, 890_000, 1_799_999],
            [450_000, 450_000, 450_000],
        ] {
            let pose = Pose {
                position_um: [500_000, -250_001, 750_000],
                turn_e4_deg,
            };
            assert_eq!(Pose::from_isometry(&pose.to_isometry()), pose);
        }
    }

    #[test]
    fn the_turns_are_about_fixed_axes_x_first() {
        let base_from_tool = isometry_from_mm_deg([0.0; 3], [90.0, 0.0, 90.0]);
        // y goes to z by the turn about x, and z stays by the turn about z.
        assert!((base_from_tool * Vector3::y() - Vector3::z()).norm() < 1e-12);
        assert!((base_from_tool * Vector3::x() - Vector3::y()).norm() < 1e-12);
    }

    #[test]
    fn the_gimbal_pose_keeps_its_rotation_within_the_quantum() {
        for y_deg in [90.0, -90.0, 89.99999, -89.99999] {
            let wanted = isometry_from_mm_deg([1.0, 2.0, 3.0], [33.0, y_deg, -71.0]);
            let kept = Pose::from_isometry(&wanted).to_isometry();
            assert!(wanted.rotation.angle_to(&kept.rotation).to_degrees() < 2e-4, "{y_deg}");
        }
    }

    #[test]
    fn minus_half_a_turn_is_written_as_half_a_turn() {
        let pose = Pose::from_mm_deg([0.0; 3], [0.0, 0.0, -180.0]);
        assert_eq!(pose.turn_e4_deg, [0, 0, HALF_TURN_E4_DEG]);
    }

    #[test]
    fn the_shortest_turn_passes_the_half_way() {
        let start = isometry_from_mm_deg([0.0; 3], [0.0, 0.0, 170.0]);
        let end = isometry_from_mm_deg([10.0, 0.0, 0.0], [0.0, 0.0, -170.0]);
        let middle = Pose::from_isometry(&interpolate(&start, &end, 0.5));
        assert_eq!(
            middle,
            Pose {
                position_um: [5_000, 0, 0],
                turn_e4_deg: [0, 0, HALF_TURN_E4_DEG]
            }
        );
    }
}
