//! One move of the arm, with a ramp at either end: a straight line and the shortest turn, or all axes together.

use nalgebra::Isometry3;

use crate::robot::axes::AXIS_COUNT;
use crate::robot::pose::{Pose, interpolate};

/// A move under way. Times are in ns of the cell's clock; `speed` of them pass on the controller for each.
#[derive(Clone, Debug)]
pub struct Motion {
    way: Way,
    target: Pose,
    begin_ns: u64,
    speed: f64,
    pieces: Vec<Piece>,
}

/// How fast a move is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rate {
    /// Of the tool point, in mm/s.
    ToolPoint(f64),
    /// Of the turn, in rad/s.
    Turn(f64),
    /// Share of the fastest move, 0 to 1.
    Share(f64),
}

/// What lies between start and target.
#[derive(Clone, Copy, Debug)]
enum Way {
    /// Position on a line, orientation by the shortest turn.
    Straight { start: Isometry3<f64>, end: Isometry3<f64> },
    /// Each axis in proportion, in pulses.
    Link {
        start: [i32; AXIS_COUNT],
        end: [i32; AXIS_COUNT],
    },
}

/// Stretch of constant acceleration of the share of the way gone, in seconds of the controller.
#[derive(Clone, Copy, Debug)]
struct Piece {
    begin_s: f64,
    duration_s: f64,
    share: f64,
    share_per_s: f64,
    share_per_s2: f64,
}

impl Motion {
    /// Straight move from a standing arm to `target`, begun at `begin_ns`. Line and turn end together; neither is faster
    /// than [`LINE_MAX_MM_S`] or [`TURN_MAX_RAD_S`]. A move to where the arm stands, written as it may be, takes no time.
    pub fn new(begin_ns: u64, start: Pose, target: Pose, rate: Rate, speed: f64) -> Self {
        let (from, to) = (start.to_isometry(), target.to_isometry());
        let way = Way::Straight { start: from, end: to };
        let distance_mm = (to.translation.vector - from.translation.vector).norm();
        let angle_rad = from.rotation.angle_to(&to.rotation);
        let shortest_s = (distance_mm / LINE_MAX_MM_S).max(angle_rad / TURN_MAX_RAD_S);
        let duration_s = rate.duration_s(distance_mm, angle_rad, shortest_s);
        Self::along(way, target, begin_ns, duration_s, speed)
    }

    /// Move of all axes together, which end together; no axis is faster than [`LINE_MAX_MM_S`] or [`TURN_MAX_RAD_S`].
    pub fn link(begin_ns: u64, start: Pose, target: Pose, rate: Rate, speed: f64) -> Self {
        let (from, to) = (start.to_pulses(), target.to_pulses());
        let gap = |axis: usize| f64::from(to[axis]) - f64::from(from[axis]);
        let longest = |axes: core::ops::Range<usize>| axes.map(|axis| gap(axis).abs()).fold(0.0, f64::max);
        let distance_mm = longest(0..3) / 1000.0;
        let angle_rad = (longest(3..AXIS_COUNT) / 10_000.0).to_radians();
        let shortest_s = (distance_mm / LINE_MAX_MM_S).max(angle_rad / TURN_MAX_RAD_S);
        let duration_s = rate.duration_s(distance_mm, angle_rad, shortest_s);
        let way = Way::Link { start: from, end: to };
        Self::along(way, target, begin_ns, duration_s, speed)
    }

    fn along(way: Way, target: Pose, begin_ns: u64, duration_s: f64, speed: f64) -> Self {
        let pieces = if duration_s < SHORTEST_S {
            Vec::new()
        } else {
            trapezoid(duration_s)
        };
        Self {
            way,
            target,
            begin_ns,
            speed,
            pieces,
        }
    }

    /// Whether it leads anywhere.
    pub fn leads_away(&self) -> bool {
        !self.pieces.is_empty()
    }

    /// When the arm stands.
    pub fn end_ns(&self) -> u64 {
        self.pieces
            .last()
            .map_or(self.begin_ns, |piece| self.at_ns(piece.begin_s + piece.duration_s))
    }

    /// When half of the time of the move has passed.
    pub fn middle_ns(&self) -> u64 {
        self.begin_ns + (self.end_ns() - self.begin_ns) / 2
    }

    /// Where the arm is; the target exactly once the whole way is gone.
    pub fn pose(&self, now_ns: u64) -> Pose {
        let (share, _) = self.state(self.controller_s(now_ns));
        if share >= 1.0 - WHOLE_TOLERANCE {
            return self.target;
        }
        match self.way {
            Way::Straight { start, end } => Pose::from_isometry(&interpolate(&start, &end, share)),
            Way::Link { start, end } => Pose::from_pulses(core::array::from_fn(|axis| {
                (f64::from(start[axis]) + share * (f64::from(end[axis]) - f64::from(start[axis]))).round() as i32
            })),
        }
    }

    /// Slows down as the end of the move would, from now on.
    pub fn stop(&mut self, now_ns: u64) {
        let now_s = self.controller_s(now_ns);
        let (share, share_per_s) = self.state(now_s);
        let Some(first) = self.pieces.first() else { return };
        let share_per_s2 = -first.share_per_s2;
        let slows_down = |piece: &Piece| piece.begin_s <= now_s && piece.share_per_s2 < 0.0;
        if self.pieces.last().is_some_and(slows_down) {
            return;
        }
        self.pieces.retain(|piece| piece.begin_s < now_s);
        if let Some(last) = self.pieces.last_mut() {
            last.duration_s = now_s - last.begin_s;
        }
        let duration_s = share_per_s / -share_per_s2;
        self.pieces.push(Piece {
            begin_s: now_s,
            duration_s,
            share,
            share_per_s,
            share_per_s2,
        });
    }

    /// Share of the way and its rate.
    fn state(&self, now_s: f64) -> (f64, f64) {
        // The first piece begins at 0: there is one unless there is no move.
        let Some(piece) = self.pieces.iter().rev().find(|piece| piece.begin_s <= now_s) else {
            return (1.0, 0.0);
        };
        let in_piece_s = (now_s - piece.begin_s).clamp(0.0, piece.duration_s);
        (
            piece.share + piece.share_per_s * in_piece_s + 0.5 * piece.share_per_s2 * in_piece_s * in_piece_s,
            piece.share_per_s + piece.share_per_s2 * in_piece_s,
        )
    }

    fn controller_s(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.begin_ns) as f64 * 1e-9 * self.speed
    }

    fn at_ns(&self, controller_s: f64) -> u64 {
        self.begin_ns + (controller_s / self.speed * 1e9).round() as u64
    }
}

impl Rate {
    fn duration_s(self, distance_mm: f64, angle_rad: f64, shortest_s: f64) -> f64 {
        match self {
            Self::ToolPoint(mm_s) => (distance_mm / mm_s).max(shortest_s),
            Self::Turn(rad_s) => (angle_rad / rad_s).max(shortest_s),
            Self::Share(share) => shortest_s / share,
        }
    }

    /// The same, no faster than this tool point speed; a share of the fastest move counts as that share of
    /// [`LINE_MAX_MM_S`].
    #[must_use]
    pub fn restricted(self, mm_s_max: f64) -> Self {
        match self {
            Self::ToolPoint(mm_s) => Self::ToolPoint(mm_s.min(mm_s_max)),
            Self::Turn(rad_s) => Self::Turn(rad_s),
            Self::Share(share) => Self::Share(share.min(mm_s_max / LINE_MAX_MM_S)),
        }
    }
}

/// Ramp up, cruise at `1 / duration_s`, ramp down: the whole takes `duration_s` and one ramp.
fn trapezoid(duration_s: f64) -> Vec<Piece> {
    let ramp_s = RAMP_S.min(duration_s);
    let cruise = 1.0 / duration_s;
    let ramp_share = 0.5 * cruise * ramp_s;
    let share_per_s2 = cruise / ramp_s;
    vec![
        Piece {
            begin_s: 0.0,
            duration_s: ramp_s,
            share: 0.0,
            share_per_s: 0.0,
            share_per_s2,
        },
        Piece {
            begin_s: ramp_s,
            duration_s: duration_s - ramp_s,
            share: ramp_share,
            share_per_s: cruise,
            share_per_s2: 0.0,
        },
        Piece {
            begin_s: duration_s,
            duration_s: ramp_s,
            share: 1.0 - ramp_share,
            share_per_s: cruise,
            share_per_s2: -share_per_s2,
        },
    ]
}

/// Fastest tool point.
pub const LINE_MAX_MM_S: f64 = 1500.0;
/// Fastest turn.
pub const TURN_MAX_RAD_S: f64 = core::f64::consts::PI;
/// Time from standing to cruising, and back.
pub const RAMP_S: f64 = 0.2;
/// A move that would take less than this is none: the angle between equal orientations is known to no more.
const SHORTEST_S: f64 = 1e-7;
const WHOLE_TOLERANCE: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    fn at(x_mm: f64, z_deg: f64) -> Pose {
        Pose::from_mm_deg([x_mm, 0.0, 0.0], [0.0, 0.0, z_deg])
    }

    #[test]
    fn a_straight_move_takes_its_way_over_its_speed_and_one_ramp() {
        let motion = Motion::new(5, at(0.0, 0.0), at(100.0, 30.0), Rate::ToolPoint(50.0), 1.0);
        assert_eq!(motion.end_ns(), 5 + 2_200_000_000);
        assert_eq!(motion.pose(5 + 1_100_000_000), at(50.0, 15.0));
        assert_eq!(motion.pose(motion.end_ns()), at(100.0, 30.0));
    }

    #[test]
    fn a_link_move_turns_each_axis_in_proportion() {
        let target = Pose::from_pulses([150_000, 0, 0, 1_800_000, 0, 900_000]);
        let motion = Motion::link(0, at(0.0, 0.0), target, Rate::Share(0.5), 1.0);
        // Half a turn at half of half a turn a second, and a ramp.
        assert_eq!(motion.end_ns(), 2_200_000_000);
        assert_eq!(
            motion.pose(1_100_000_000).to_pulses(),
            [75_000, 0, 0, 900_000, 0, 450_000]
        );
        assert_eq!(motion.pose(motion.end_ns()), target);
    }

    #[test]
    fn the_speed_of_the_simulation_divides_the_time() {
        let motion = Motion::new(0, at(0.0, 0.0), at(0.0, 40.0), Rate::Turn(20.0_f64.to_radians()), 20.0);
        assert_eq!(motion.end_ns(), 110_000_000);
    }

    #[test]
    fn a_turn_on_the_spot_at_a_tool_speed_is_bounded_by_the_fastest_turn() {
        let motion = Motion::new(0, at(0.0, 0.0), at(0.0, 90.0), Rate::ToolPoint(50.0), 1.0);
        assert_eq!(motion.end_ns(), 700_000_000);
    }

    #[test]
    fn a_move_to_where_the_arm_stands_takes_no_time() {
        let motion = Motion::new(7, at(1.0, 2.0), at(1.0, 2.0), Rate::ToolPoint(50.0), 1.0);
        assert_eq!(motion.end_ns(), 7);
        assert_eq!(motion.pose(7), at(1.0, 2.0));
    }

    #[test]
    fn a_move_to_the_same_orientation_written_otherwise_takes_no_time() {
        let written = |turn_deg: [i32; 3]| Pose {
            position_um: [1000, 2000, 3000],
            turn_e4_deg: turn_deg.map(|deg| 10_000 * deg),
        };
        // At 90 degrees about y, turns about x and z are the same.
        let (start, target) = (written([0, 90, 0]), written([48, 90, 48]));
        let mut motion = Motion::new(7, start, target, Rate::Turn(1.0), 1.0);
        assert_eq!(motion.end_ns(), 7);
        assert_eq!(motion.pose(7), target);
        motion.stop(8);
        assert_eq!(motion.pose(SECOND_NS), target);
    }

    #[test]
    fn a_stop_ends_short_of_the_target_within_one_ramp() {
        let mut motion = Motion::new(0, at(0.0, 0.0), at(100.0, 0.0), Rate::ToolPoint(50.0), 1.0);
        motion.stop(SECOND_NS);
        assert_eq!(motion.end_ns(), 1_200_000_000);
        // 0.9 s of cruising and a half ramp before, a half ramp after.
        assert_eq!(motion.pose(motion.end_ns()).position_um[0], 50_000);
        let mut twice = motion.clone();
        twice.stop(1_100_000_000);
        assert_eq!(twice.end_ns(), motion.end_ns());
    }

    #[test]
    fn a_stop_in_the_last_ramp_reaches_the_target() {
        let mut motion = Motion::new(0, at(0.0, 0.0), at(100.0, 0.0), Rate::ToolPoint(50.0), 1.0);
        motion.stop(2_100_000_000);
        assert_eq!(motion.pose(motion.end_ns()), at(100.0, 0.0));
    }
}
