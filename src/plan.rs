//! The plan of a run: which poses the robot takes, checked against the station before anything moves.

use std::num::NonZeroUsize;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand::RngExt;

use crate::geometry::rotation_angle_between;
use crate::seed::{Seed, Stream};
use crate::settings::{Recipe, RobotLink, Station, Workspace};

/// The views of a run in the order in which they are taken; at least one.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    views: Vec<PlannedView>,
    moves: Vec<PlannedMove>,
    merged_min_count: usize,
}

/// One view: how the blade stands before the camera, and the robot's pose that brings it there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannedView {
    /// Position in the plan, from 0.
    pub index: usize,
    /// Turn about the blade's z axis, 0 to below 2π rad.
    pub turn_rad: f64,
    /// Tilt about the fixture's x axis after the turn, in rad.
    pub tilt_x_rad: f64,
    /// Tilt about the fixture's y axis after the tilt about x, in rad.
    pub tilt_y_rad: f64,
    /// The blade before the camera, in mm.
    pub camera_from_blade: Isometry3<f64>,
    /// The robot's pose, in mm.
    pub base_from_tool: Isometry3<f64>,
}

/// The way from the view before to the view `to_index`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlannedMove {
    /// The view at its end, from 1.
    pub to_index: usize,
    /// Straight distance of the tool, in mm.
    pub distance_mm: f64,
    /// Angle by which the tool turns, 0 to π rad.
    pub angle_rad: f64,
    /// Estimate: the longer of distance and angle at the station's speeds, plus the rest before the trigger.
    pub duration_ns: u64,
}

/// Why a recipe cannot be run at a station.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// A pose of the plan lies outside the station's workspace.
    #[error(
        "view {view_index}: the tool would be at {axis} = {value_mm:.3} mm in the robot's base frame, \
         the workspace allows {min_mm} to {max_mm} mm"
    )]
    OutsideWorkspace {
        /// Which view.
        view_index: usize,
        /// Which coordinate: `x`, `y` or `z`.
        axis: char,
        /// Its value in mm.
        value_mm: f64,
        /// The least allowed, in mm.
        min_mm: f64,
        /// The greatest allowed, in mm.
        max_mm: f64,
    },
}

impl Plan {
    /// Lays out every view of the recipe at the station.
    ///
    /// `camera_from_blade(i) = camera_from_fixture · Ry(tilt_y) · Rx(tilt_x) · Rz(i · step)`. The tilts are drawn uniformly
    /// within ± the recipe's largest tilt for every view, the first included, from the seed's [`Stream::Tilt`].
    ///
    /// # Errors
    ///
    /// The first pose whose tool position lies outside the workspace. Reach, joint limits and collisions are not checked.
    pub fn new(recipe: &Recipe, station: &Station, seed: Seed) -> Result<Self, PlanError> {
        let mut generator = seed.stream(Stream::Tilt);
        let mut tilt_rad = || recipe.views.tilt_max_rad * (2.0 * generator.random::<f64>() - 1.0);
        let views: Vec<_> = (0..recipe.view_count())
            .map(|index| planned_view(recipe, station, index, [tilt_rad(), tilt_rad()]))
            .collect();
        for view in &views {
            check_workspace(view, &station.robot.workspace)?;
        }
        let moves = views
            .windows(2)
            .map(|pair| planned_move(&pair[0], &pair[1], &station.robot))
            .collect();
        Ok(Self {
            views,
            moves,
            merged_min_count: recipe.views.merged_min_count as usize,
        })
    }

    /// The first `view_count` views; all of them when there are no more. The poses stay what they were.
    pub fn truncated(mut self, view_count: NonZeroUsize) -> Self {
        self.views.truncate(view_count.get());
        self.moves.truncate(view_count.get() - 1);
        self.merged_min_count = self.merged_min_count.min(self.views.len());
        self
    }

    /// The views in order; at least one.
    pub fn views(&self) -> &[PlannedView] {
        &self.views
    }

    /// The ways between successive views, one fewer than views. The way to the first view is not known beforehand.
    pub fn moves(&self) -> &[PlannedMove] {
        &self.moves
    }

    /// How many views must be merged for the run to count as done, 1 to the number of views.
    pub fn merged_min_count(&self) -> usize {
        self.merged_min_count
    }

    /// Estimated time for all [`moves`](Self::moves), without exposures.
    pub fn moves_duration_ns(&self) -> u64 {
        self.moves.iter().map(|planned| planned.duration_ns).sum()
    }
}

/// The motion of the blade before the camera between two robot poses: maps camera coordinates of the blade at pose `b` to
/// those at pose `a`. How the blade is gripped cancels out; lengths in mm.
pub fn camera_relative(
    base_from_camera: &Isometry3<f64>,
    base_from_tool_a: &Isometry3<f64>,
    base_from_tool_b: &Isometry3<f64>,
) -> Isometry3<f64> {
    let camera_from_base = base_from_camera.inverse();
    camera_from_base * base_from_tool_a * base_from_tool_b.inverse() * base_from_camera
}

fn planned_view(recipe: &Recipe, station: &Station, index: usize, [tilt_x_rad, tilt_y_rad]: [f64; 2]) -> PlannedView {
    let turn_rad = index as f64 * recipe.views.step_rad();
    let about = |axis, angle_rad| UnitQuaternion::from_axis_angle(&axis, angle_rad);
    let tilt = about(Vector3::y_axis(), tilt_y_rad) * about(Vector3::x_axis(), tilt_x_rad);
    let fixture_from_blade = tilt * about(Vector3::z_axis(), turn_rad);
    let camera_from_blade = recipe.camera_from_fixture * fixture_from_blade;
    let blade_from_tool = station.tool_from_blade.inverse();
    PlannedView {
        index,
        turn_rad,
        tilt_x_rad,
        tilt_y_rad,
        camera_from_blade,
        base_from_tool: station.base_from_camera * camera_from_blade * blade_from_tool,
    }
}

fn check_workspace(view: &PlannedView, workspace: &Workspace) -> Result<(), PlanError> {
    let tool_mm = view.base_from_tool.translation.vector;
    for (number, axis) in ['x', 'y', 'z'].into_iter().enumerate() {
        let (min_mm, max_mm) = (workspace.min_mm[number], workspace.max_mm[number]);
        if !(min_mm..=max_mm).contains(&tool_mm[number]) {
            return Err(PlanError::OutsideWorkspace {
                view_index: view.index,
                axis,
                value_mm: tool_mm[number],
                min_mm,
                max_mm,
            });
        }
    }
    Ok(())
}

fn planned_move(from: &PlannedView, to: &PlannedView, robot: &RobotLink) -> PlannedMove {
    let (from, to_index, to) = (from.base_from_tool, to.index, to.base_from_tool);
    let distance_mm = (to.translation.vector - from.translation.vector).norm();
    let angle_rad = rotation_angle_between(&from.rotation, &to.rotation);
    let moving_s = (distance_mm / robot.speed_mm_s).max(angle_rad / robot.rotation_speed_rad_s);
    PlannedMove {
        to_index,
        distance_mm,
        angle_rad,
        duration_ns: (moving_s * 1e9).round() as u64 + robot.settle_ns,
    }
}
