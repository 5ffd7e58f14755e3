//! The plan of a run: which poses the robot takes, checked against the station before anything moves.

use std::num::NonZeroUsize;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use rand::RngExt;

use crate::geometry::rotation_angle_between;
use crate::seed::{Seed, Stream};
use crate::settings::{Motion, Recipe, RobotLink, Station, Workspace};

/// The views of a run in the order in which they are taken; at least one, though it may be skipped.
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
    /// Whether the recipe leaves it out: the robot does not go there.
    pub skipped: bool,
}

/// The way from the view taken before to the view `to_index`.
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
    /// Two poses one after the other are too far apart.
    #[error(
        "view {view_index}: the tool would turn by {angle_deg:.3}° from the view before, the station allows {max_deg}°"
    )]
    StepTooLarge {
        /// The view at the end of the step.
        view_index: usize,
        /// The angle between the two poses, in degrees.
        angle_deg: f64,
        /// The largest allowed, in degrees.
        max_deg: f64,
    },
    /// The scan job has fewer position variables than the plan has views.
    #[error(
        "{view_count} views need as many position variables of the robot, the station's scan job has {position_count} \
         (`robot.job.position_first` to `position_last`)"
    )]
    TooManyViews {
        /// Views of the plan.
        view_count: usize,
        /// Position variables of the station.
        position_count: usize,
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
    /// The first pose whose tool position lies outside the workspace, a step beyond the station's largest angle, or more views than the scan job has positions. Reach, joint limits and collisions are not checked.
    pub fn new(recipe: &Recipe, station: &Station, seed: Seed) -> Result<Self, PlanError> {
        let mut generator = seed.stream(Stream::Tilt);
        let mut tilt_rad = || recipe.views.tilt_max_rad * (2.0 * generator.random::<f64>() - 1.0);
        let views: Vec<_> = (0..recipe.view_count())
            .map(|index| planned_view(recipe, station, index, [tilt_rad(), tilt_rad()]))
            .collect();
        for view in views.iter().filter(|view| !view.skipped) {
            check_workspace(view, &station.robot.workspace)?;
        }
        if let Motion::Job(job) = &station.robot.motion
            && job.position_count() < views.len()
        {
            return Err(PlanError::TooManyViews {
                view_count: views.len(),
                position_count: job.position_count(),
            });
        }
        let taken: Vec<&PlannedView> = views.iter().filter(|view| !view.skipped).collect();
        let moves: Vec<PlannedMove> = taken
            .windows(2)
            .map(|pair| planned_move(pair[0], pair[1], &station.robot))
            .collect();
        check_steps(&moves, station.robot.step_angle_max_rad)?;
        Ok(Self {
            views,
            moves,
            merged_min_count: recipe.views.merged_min_count as usize,
        })
    }

    /// The first `view_count` views; all of them when there are no more. The poses stay what they were.
    pub fn truncated(mut self, view_count: NonZeroUsize) -> Self {
        self.views.truncate(view_count.get());
        self.moves.retain(|planned| planned.to_index < view_count.get());
        let taken_count = self.views.iter().filter(|view| !view.skipped).count();
        self.merged_min_count = self.merged_min_count.min(taken_count);
        self
    }

    /// The views in order; at least one.
    pub fn views(&self) -> &[PlannedView] {
        &self.views
    }

    /// The ways between successive views, one fewer than views that are taken. The way to the first view is not known beforehand.
    pub fn moves(&self) -> &[PlannedMove] {
        &self.moves
    }

    /// How many views must be merged for the run to count as done, at most those that are taken.
    pub fn merged_min_count(&self) -> usize {
        self.merged_min_count
    }

    /// Estimated time for all [`moves`](Self::moves), without exposures.
    pub fn moves_duration_ns(&self) -> u64 {
        self.moves.iter().map(|planned| planned.duration_ns).sum()
    }
}

fn check_steps(moves: &[PlannedMove], max_rad: f64) -> Result<(), PlanError> {
    match moves.iter().find(|planned| planned.angle_rad > max_rad + ROUNDING_RAD) {
        None => Ok(()),
        Some(planned) => Err(PlanError::StepTooLarge {
            view_index: planned.to_index,
            angle_deg: planned.angle_rad.to_degrees(),
            max_deg: max_rad.to_degrees(),
        }),
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
        skipped: recipe.views.skipped.contains(&index),
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

/// A step that is exactly the largest allowed may be wider by the rounding of its poses.
const ROUNDING_RAD: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use nalgebra::{Point3, Translation3};

    use super::*;
    use crate::geometry::rotation_from_fixed_xyz;

    fn recipe(views: &str) -> Recipe {
        let text = format!(
            "name = \"probe\"\nblade.cad = \"builtin:lpt\"\nmerge.overlap_min_fraction = 0.5\n\
             presentation = {{ position_mm = [10, -5, 600], rotation_deg = [0, 90, 0] }}\n[views]\n{views}"
        );
        Recipe::parse("probe.toml", &text).unwrap()
    }

    fn assert_same(a: &Isometry3<f64>, b: &Isometry3<f64>, what: &str) {
        let distance_mm = (a.translation.vector - b.translation.vector).norm();
        let angle_rad = rotation_angle_between(&a.rotation, &b.rotation);
        assert!(
            distance_mm < 1e-9 && angle_rad < 1e-13,
            "{what}: {distance_mm} mm, {angle_rad} rad"
        );
    }

    #[test]
    fn the_robot_brings_the_blade_where_the_view_wants_it() {
        let station = Station::builtin_simulated();
        let plan = Plan::new(&recipe("tilt_max_deg = 10"), &station, Seed(3)).unwrap();
        assert_eq!(plan.views().len(), 36);
        for view in plan.views() {
            let by_camera = station.base_from_camera * view.camera_from_blade;
            let by_robot = view.base_from_tool * station.tool_from_blade;
            assert_same(&by_camera, &by_robot, &format!("view {}", view.index));
        }
    }

    #[test]
    fn without_tilts_the_blade_turns_about_its_own_axis() {
        let recipe = recipe("step_deg = 90");
        let plan = Plan::new(&recipe, &Station::builtin_simulated(), Seed(1)).unwrap();
        assert_same(
            &plan.views()[0].camera_from_blade,
            &recipe.camera_from_fixture,
            "view 0",
        );
        for view in plan.views() {
            assert_eq!(view.turn_rad, view.index as f64 * TAU / 4.0);
            // A point of the axis stays; z of the blade is x of the camera.
            let on_axis_mm = view.camera_from_blade * Point3::new(0.0, 0.0, 100.0);
            assert!((on_axis_mm - Point3::new(110.0, -5.0, 600.0)).norm() < 1e-9);
        }
        // A quarter turn about blade z = camera x takes the blade's x axis from -z of the camera to its y.
        let blade_x = plan.views()[1].camera_from_blade * Vector3::x();
        assert!((blade_x - Vector3::y()).norm() < 1e-12, "{blade_x}");
    }

    #[test]
    fn a_view_tilts_about_x_then_y_after_its_turn() {
        let recipe = recipe("tilt_max_deg = 20");
        let plan = Plan::new(&recipe, &Station::builtin_simulated(), Seed(5)).unwrap();
        for view in plan.views() {
            let tilt = rotation_from_fixed_xyz(view.tilt_x_rad, view.tilt_y_rad, 0.0);
            let turn = rotation_from_fixed_xyz(0.0, 0.0, view.turn_rad);
            let expected = recipe.camera_from_fixture * tilt * turn;
            assert_same(&view.camera_from_blade, &expected, &format!("view {}", view.index));
        }
    }

    #[test]
    fn tilts_are_drawn_for_every_view_from_the_seed() {
        let recipe = recipe("tilt_max_deg = 20");
        let station = Station::builtin_simulated();
        let plan = |seed| Plan::new(&recipe, &station, Seed(seed)).unwrap();
        assert_eq!(plan(1), plan(1));
        assert_ne!(plan(1), plan(2));
        let largest_rad = recipe.views.tilt_max_rad;
        for view in plan(1).views() {
            for tilt_rad in [view.tilt_x_rad, view.tilt_y_rad] {
                assert!(tilt_rad != 0.0 && tilt_rad.abs() <= largest_rad, "view {}", view.index);
            }
        }
    }

    #[test]
    fn the_first_views_of_a_plan_keep_their_poses() {
        let whole = Plan::new(&recipe("tilt_max_deg = 5"), &Station::builtin_simulated(), Seed(1)).unwrap();
        let first = whole.clone().truncated(NonZeroUsize::new(4).unwrap());
        assert_eq!(first.views(), &whole.views()[..4]);
        assert_eq!(first.moves(), &whole.moves()[..3]);
        assert_eq!((whole.merged_min_count(), first.merged_min_count()), (35, 4));
        assert_eq!(whole.clone().truncated(NonZeroUsize::new(99).unwrap()), whole);
        assert_eq!(whole.clone().truncated(NonZeroUsize::MIN).moves(), []);
    }

    #[test]
    fn a_view_that_is_left_out_keeps_its_number_and_is_not_on_the_way() {
        let station = Station::builtin_simulated();
        let whole = Plan::new(&recipe("step_deg = 60"), &station, Seed(1)).unwrap();
        let plan = Plan::new(&recipe("step_deg = 60\nskip = [2, 5]"), &station, Seed(1)).unwrap();
        let skipped: Vec<bool> = plan.views().iter().map(|view| view.skipped).collect();
        assert_eq!(skipped, [false, false, true, false, false, true]);
        for (view, before) in plan.views().iter().zip(whole.views()) {
            assert_eq!((view.index, view.base_from_tool), (before.index, before.base_from_tool));
        }
        let ways: Vec<usize> = plan.moves().iter().map(|planned| planned.to_index).collect();
        assert_eq!(ways, [1, 3, 4]);
        assert!((plan.moves()[1].angle_rad - TAU / 3.0).abs() < 1e-9);
        assert_eq!(plan.merged_min_count(), 3);
        let first = plan.truncated(NonZeroUsize::new(3).unwrap());
        assert_eq!((first.moves().len(), first.merged_min_count()), (1, 2));
        // A step past a view that is left out may be too wide.
        let mut narrow = station;
        narrow.robot.step_angle_max_rad = 100_f64.to_radians();
        let error = Plan::new(&recipe("step_deg = 60\nskip = [2]"), &narrow, Seed(1)).unwrap_err();
        assert!(
            matches!(error, PlanError::StepTooLarge { view_index: 3, .. }),
            "{error}"
        );
    }

    #[test]
    fn the_slower_of_turn_and_travel_sets_the_time_of_a_move() {
        let station = Station::builtin_simulated();
        let plan = Plan::new(&recipe(""), &station, Seed(1)).unwrap();
        assert_eq!(plan.moves().len(), 35);
        for planned in plan.moves() {
            // Here the tool turns about its own axis: 10 deg at 60 deg/s, and 20 ms of rest.
            assert!(planned.distance_mm < 1e-9 && (planned.angle_rad - PI / 18.0).abs() < 1e-12);
            assert_eq!(planned.duration_ns, 166_666_667 + 20_000_000);
        }
        assert_eq!(plan.moves_duration_ns(), 35 * 186_666_667);

        let mut sideways = station.clone();
        sideways.tool_from_blade = Translation3::new(300.0, 0.0, 0.0).into();
        let plan = Plan::new(&recipe(""), &sideways, Seed(1)).unwrap();
        let chord_mm = 2.0 * 300.0 * (PI / 36.0).sin();
        assert!((plan.moves()[0].distance_mm - chord_mm).abs() < 1e-9);
        let travel_ns = (chord_mm / 200.0 * 1e9) as u64 + 20_000_000;
        assert!(plan.moves()[0].duration_ns.abs_diff(travel_ns) < 10);
    }

    #[test]
    fn a_pose_outside_the_workspace_is_named() {
        let mut station = Station::builtin_simulated();
        station.robot.workspace.max_mm.y = -150.0;
        let error = Plan::new(&recipe(""), &station, Seed(1)).unwrap_err();
        let expected = "view 0: the tool would be at y = -100.000 mm in the robot's base frame, \
                        the workspace allows -1000 to -150 mm";
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn the_relative_motion_seen_by_the_camera_does_not_depend_on_the_grip() {
        for seed in 0..20 {
            let mut generator = Seed(seed).stream(Stream::Tilt);
            let mut draw = || 2.0 * generator.random::<f64>() - 1.0;
            let mut station = Station::builtin_simulated();
            station.tool_from_blade = Isometry3::from_parts(
                Translation3::new(100.0 * draw(), 100.0 * draw(), 300.0 * draw()),
                rotation_from_fixed_xyz(draw(), draw(), draw()),
            );
            let plan = Plan::new(&recipe("tilt_max_deg = 20"), &station, Seed(seed)).unwrap();
            let [a, b] = [plan.views()[0], plan.views()[7]];
            let a_from_b = camera_relative(&station.base_from_camera, &a.base_from_tool, &b.base_from_tool);
            let expected = a.camera_from_blade * b.camera_from_blade.inverse();
            assert_same(&a_from_b, &expected, &format!("seed {seed}"));
        }
    }
}
