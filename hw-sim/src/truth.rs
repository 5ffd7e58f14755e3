//! `truth.json`: what only the simulator knows about a run.

use crate::camera::render::Surface;
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A rigid motion as the rows of its 4 × 4 matrix, translation in mm: the form in which files carry it.
pub type Rows = [[f64; 4]; 4];

/// The true state of the simulated cell over one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Always true: nothing here was measured on a machine.
    pub simulated: bool,
    /// Name of the built-in blade, or the path of the mesh file.
    pub blade: String,
    /// Seed of the run.
    pub seed: u64,
    /// Name of the optics preset.
    pub optics: String,
    /// How the camera met the surface: preset, numbers, and the terms that were on.
    #[serde(default = "Surface::matte")]
    pub surface: Surface,
    /// How far the world may differ from what the controller believes.
    pub pose_error: PoseErrorSize,
    /// Faults injected, in the order of injection, as the operator wrote them.
    pub faults: Vec<String>,
    /// One entry for each acquisition, in the order of acquisition.
    pub views: Vec<ViewTruth>,
}

/// Standard deviations per axis of the errors of the robot's pose (each view) and of the calibration (each run).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseErrorSize {
    /// Robot, mm.
    pub robot_mm: f64,
    /// Robot, degrees.
    pub robot_deg: f64,
    /// Calibration, mm.
    #[serde(default)]
    pub calibration_mm: f64,
    /// Calibration, degrees.
    #[serde(default)]
    pub calibration_deg: f64,
}

/// One acquisition as it really was.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewTruth {
    /// Index of the view in the plan.
    pub view_index: u32,
    /// 0 for the first acquisition of the view, counting retakes.
    pub attempt: u32,
    /// view << 16 | attempt.
    pub trigger_id: u64,
    /// The blade's pose in the camera frame during the exposure.
    pub camera_from_blade: Rows,
    /// From this camera view into that of the captured view of lowest index (its first entry).
    pub model_from_view: Rows,
    /// True points of the surface that the camera saw, in the camera frame, mm.
    pub surface_points_mm: Vec<[f64; 3]>,
    /// Whether the robot still moved while the camera exposed; `camera_from_blade` is then that at its begin.
    pub moved_during_exposure: bool,
}

impl Truth {
    /// A run of which nothing has been captured yet.
    pub fn new(blade: &str, seed: u64, optics: &str, surface: Surface, pose_error: PoseErrorSize) -> Truth {
        Truth {
            simulated: true,
            blade: blade.to_owned(),
            seed,
            optics: optics.to_owned(),
            surface,
            pose_error,
            faults: Vec::new(),
            views: Vec::new(),
        }
    }

    /// Adds one acquisition. View and attempt follow from the trigger id; `model_from_view` is set for all entries anew.
    pub fn record(
        &mut self,
        trigger_id: u64,
        camera_from_blade: &Isometry3<f64>,
        surface_points_mm: Vec<[f64; 3]>,
        moved_during_exposure: bool,
    ) {
        self.views.push(ViewTruth {
            view_index: (trigger_id >> 16) as u32,
            attempt: (trigger_id & 0xffff) as u32,
            trigger_id,
            camera_from_blade: rows_from_motion(camera_from_blade),
            model_from_view: rows_from_motion(&Isometry3::identity()),
            surface_points_mm,
            moved_during_exposure,
        });
        let Some(model) = self.views.iter().min_by_key(|view| view.view_index) else {
            return;
        };
        let model_from_blade = motion_unchecked(&model.camera_from_blade);
        for view in &mut self.views {
            let blade_from_camera = motion_unchecked(&view.camera_from_blade).inverse();
            view.model_from_view = rows_from_motion(&(model_from_blade * blade_from_camera));
        }
    }

    /// Writes the file so that a reader sees the old one or the new one, never a part: beside it, then renamed.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let mut text = serde_json::to_vec(self)?;
        text.push(b'\n');
        let mut beside = path.as_os_str().to_owned();
        beside.push(".part");
        let beside = PathBuf::from(beside);
        let mut file = File::create(&beside)?;
        file.write_all(&text)?;
        file.sync_data()?;
        fs::rename(&beside, path)
    }
}

/// The rows of a rigid motion's matrix.
pub fn rows_from_motion(motion: &Isometry3<f64>) -> Rows {
    let matrix = motion.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}

/// The motion of a matrix; `None` when a value is not finite, the last row is not 0 0 0 1, or the rest is no rotation
/// to within 1e-6.
pub fn motion_from_rows(rows: &Rows) -> Option<Isometry3<f64>> {
    let rotation = Matrix3::from_fn(|row, column| rows[row][column]);
    let finite = rows.iter().flatten().all(|value| value.is_finite());
    let orthogonal = (rotation * rotation.transpose() - Matrix3::identity()).norm() < RIGID_TOLERANCE;
    (finite && rows[3] == [0.0, 0.0, 0.0, 1.0] && orthogonal && rotation.determinant() > 0.0)
        .then(|| motion_unchecked(rows))
}

fn motion_unchecked(rows: &Rows) -> Isometry3<f64> {
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|row, column| rows[row][column]));
    let translation = Vector3::from_fn(|row, _| rows[row][3]);
    Isometry3::from_parts(
        Translation3::from(translation),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// Greatest departure of R Rᵀ from the identity that still counts as a rotation.
const RIGID_TOLERANCE: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;

    fn empty() -> Truth {
        Truth::new("hpt-a", 1, "fine", Surface::matte(), PoseErrorSize::default())
    }

    fn pose(k: f64) -> Isometry3<f64> {
        Isometry3::new(
            Vector3::new(k, 2.0 * k, 300.0 + k),
            Vector3::new(0.1 * k, -0.2, 0.3 * k),
        )
    }

    #[test]
    fn the_model_frame_is_the_captured_view_of_lowest_index() {
        let mut truth = empty();
        for view in [3_u64, 2, 4] {
            truth.record(view << 16 | 1, &pose(view as f64), vec![], false);
        }
        let model_from_view = motion_from_rows(&truth.views[2].model_from_view).unwrap();
        let expected = pose(2.0) * pose(4.0).inverse();
        assert!((model_from_view.to_homogeneous() - expected.to_homogeneous()).norm() < 1e-9);
        assert_eq!((truth.views[2].view_index, truth.views[2].attempt), (4, 1));
        let own = motion_from_rows(&truth.views[1].model_from_view).unwrap();
        assert!((own.to_homogeneous() - nalgebra::Matrix4::identity()).norm() < 1e-9);
    }

    #[test]
    fn the_file_says_simulated_and_reads_back_as_it_was_written() {
        let path = std::env::temp_dir().join(format!("hw-sim-truth-{}.json", std::process::id()));
        let mut truth = empty();
        truth.faults.push("drop=0.1".to_owned());
        truth.record(0, &pose(0.7), vec![[0.1, 0.2, 0.3]], true);
        truth.write(&path).unwrap();
        let text = fs::read_to_string(&path).unwrap();
        fs::remove_file(&path).unwrap();
        assert!(
            text.starts_with("{\"simulated\":true,\"blade\":\"hpt-a\",\"seed\":1,"),
            "{text}"
        );
        let read_back: Truth = serde_json::from_str(&text).unwrap();
        assert_eq!(read_back.views[0].surface_points_mm, truth.views[0].surface_points_mm);
        let difference = |row: usize, column: usize| {
            read_back.views[0].camera_from_blade[row][column] - truth.views[0].camera_from_blade[row][column]
        };
        assert!((0..16).all(|i| difference(i / 4, i % 4).abs() < 1e-12));
    }

    #[test]
    fn a_matrix_that_is_no_rigid_motion_is_refused() {
        let rows = rows_from_motion(&pose(0.5));
        assert!(motion_from_rows(&rows).is_some());
        let mut scaled = rows;
        scaled[0][0] += 1e-3;
        let mut mirrored = rows;
        mirrored[2] = mirrored[2].map(|value| -value);
        let mut projective = rows;
        projective[3][0] = 0.1;
        let mut not_a_number = rows;
        not_a_number[1][3] = f64::NAN;
        for broken in [scaled, mirrored, projective, not_a_number] {
            assert!(motion_from_rows(&broken).is_none(), "{broken:?}");
        }
    }
}
