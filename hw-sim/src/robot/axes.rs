//! The arm's joints. The simulator's own: not a model of any Motoman.
//!
//! Three slides along the base's x, y, z (called S, L, U) and three turns about its fixed x, y, z (R, B, T). A pulse is 1 µm or
//! 0.0001 degrees, so that a pose and its pulses are the same numbers and neither view of a position loses anything.

use crate::robot::pose::Pose;

impl Pose {
    /// The pose at which the axes stand at these pulses.
    pub fn from_pulses(pulses: [i32; AXIS_COUNT]) -> Self {
        let [x, y, z, rx, ry, rz] = pulses;
        Self {
            position_um: [x, y, z],
            turn_e4_deg: [rx, ry, rz],
        }
    }

    /// Pulses of S, L, U, R, B, T.
    pub fn to_pulses(self) -> [i32; AXIS_COUNT] {
        let ([x, y, z], [rx, ry, rz]) = (self.position_um, self.turn_e4_deg);
        [x, y, z, rx, ry, rz]
    }

    /// Whether the slides are within `min_um` to `max_um` and the turns within half a turn either way.
    pub fn is_within(&self, min_um: &[i32; 3], max_um: &[i32; 3]) -> bool {
        let is_inside = (0..3).all(|axis| (min_um[axis]..=max_um[axis]).contains(&self.position_um[axis]));
        is_inside
            && self
                .turn_e4_deg
                .iter()
                .all(|turn| (-TURN_MAX_E4_DEG..=TURN_MAX_E4_DEG).contains(turn))
    }
}

/// Axes of the arm.
pub const AXIS_COUNT: usize = 6;
/// Names of the axes as pulses.
pub const AXIS_NAMES: [&str; AXIS_COUNT] = ["S", "L", "U", "R", "B", "T"];
/// Names of the coordinates.
pub const COORDINATE_NAMES: [&str; AXIS_COUNT] = ["X", "Y", "Z", "Rx", "Ry", "Rz"];
/// How far an axis turns either way.
pub const TURN_MAX_E4_DEG: i32 = 1_800_000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulses_and_pose_are_two_views_of_one_position() {
        let pulses = [1000, -2000, 3000, 4000, 1_200_000, -1_800_000];
        assert_eq!(Pose::from_pulses(pulses).to_pulses(), pulses);
    }

    #[test]
    fn each_axis_has_its_limits() {
        let (min_um, max_um) = ([-5; 3], [5; 3]);
        for axis in 0..AXIS_COUNT {
            let limit = if axis < 3 { 5 } else { TURN_MAX_E4_DEG };
            for (pulse, is_within) in [(limit, true), (-limit, true), (limit + 1, false), (-limit - 1, false)] {
                let mut pulses = [0; AXIS_COUNT];
                pulses[axis] = pulse;
                let pose = Pose::from_pulses(pulses);
                assert_eq!(pose.is_within(&min_um, &max_um), is_within, "axis {axis} at {pulse}");
            }
        }
    }
}
