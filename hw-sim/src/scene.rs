//! What a simulated cell is made of.

use nalgebra::Isometry3;

use crate::camera::optics::Optics;
use crate::camera::render::Surface;
use crate::fault::Fault;
use crate::robot::ports::LinkOptions;
use crate::robot::pose::{Pose, isometry_from_mm_deg};
use crate::robot::settings::Options;
use crate::truth::PoseErrorSize;

/// Everything that is fixed before a cell starts. The blade's mesh is not here: only the renderer needs it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the built-in blade, or the path of the mesh file; stated in the truth.
    pub blade: String,
    /// Lens set of the camera.
    pub optics: Optics,
    /// How the camera meets the blade's surface; stated in the truth.
    pub surface: Surface,
    /// Where the camera stands, as the station states it, mm.
    pub base_from_camera: Isometry3<f64>,
    /// How the tool holds the blade, as the station states it, mm.
    pub tool_from_blade: Isometry3<f64>,
    /// Where the robot stands at first.
    pub home: Pose,
    /// Lowest and highest x, y, z that the robot goes to, µm.
    pub workspace_um: [[i32; 3]; 2],
    /// Jobs in the robot's directory at first: name without extension, text of the file.
    pub jobs: Vec<(String, String)>,
    /// What the sources leave open about the robot controller.
    pub robot_options: Options,
    /// How the robot controller is reached.
    pub links: LinkOptions,
    /// Seeds everything drawn.
    pub seed: u64,
    /// Seconds of the cell in one second of the clock; positive.
    pub speed: f64,
    /// How far robot and calibration are off.
    pub pose_error: PoseErrorSize,
    /// What goes wrong.
    pub faults: Vec<Fault>,
    /// Tells one start of the camera from another.
    pub boot_id: u64,
}

impl Default for Scene {
    /// The blade hpt-a before fine optics, in real time, with the usual errors and no faults.
    fn default() -> Self {
        Self {
            blade: "hpt-a".to_owned(),
            optics: Optics::fine(),
            surface: Surface::matte(),
            base_from_camera: isometry_from_mm_deg([1000.0, -700.0, 1000.0], [-90.0, 0.0, 0.0]),
            tool_from_blade: isometry_from_mm_deg([0.0, 0.0, 400.0], [0.0; 3]),
            home: Pose::from_mm_deg([1000.0, -200.0, 1100.0], [0.0, 90.0, 0.0]),
            workspace_um: [[0, -1_500_000, 0], [2_000_000, 1_500_000, 2_000_000]],
            jobs: vec![("BLADESCAN".to_owned(), SCAN_JOB.to_owned())],
            robot_options: Options::default(),
            links: LinkOptions::default(),
            seed: 1,
            speed: 1.0,
            pose_error: PoseErrorSize {
                robot_mm: 0.05,
                robot_deg: 0.03,
                calibration_mm: 0.1,
                calibration_deg: 0.05,
            },
            faults: Vec::new(),
            boot_id: 1,
        }
    }
}

/// The job for orders of a controlling program, as it is put on a real controller.
const SCAN_JOB: &str = include_str!("../../docs/robot/BLADESCAN.JBI");
