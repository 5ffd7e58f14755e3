//! What recipe and station files say, defaults filled in, in the units of their keys.
//!
//! The key tables vouch for types and ranges; what the values mean together is for [`Recipe`](super::Recipe) and
//! [`Station`](super::Station).

use nalgebra::{Isometry3, Translation3};
use serde::Deserialize;
use toml::Spanned;

use super::recipe::{Compression, Optics, OutlierFilter, Start, WarmUp, WorkingVolume};
use super::retakes::RetakeReason;
use crate::geometry::rotation_from_fixed_xyz;

/// A recipe file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RecipeFile {
    pub(super) name: Spanned<String>,
    pub(super) description: String,
    pub(super) blade: BladeFile,
    pub(super) views: ViewsFile,
    pub(super) presentation: PoseFile,
    pub(super) camera: CameraFile,
    pub(super) cleaning: CleaningFile,
    pub(super) registration: RegistrationFile,
    #[serde(default)]
    pub(super) merge: MergeFile,
    pub(super) run: RunFile,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BladeFile {
    pub(super) cad: Spanned<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ViewsFile {
    pub(super) step_deg: Spanned<f64>,
    pub(super) tilt_max_deg: f64,
    #[serde(default)]
    pub(super) skip: Vec<Spanned<u32>>,
    pub(super) views_min: Option<Spanned<u32>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraFile {
    pub(super) optics: Optics,
    pub(super) binning: bool,
    pub(super) roi_px: Option<Spanned<[u16; 4]>>,
    pub(super) exposure_us: u32,
    pub(super) hdr_low_us: Option<u32>,
    pub(super) hdr_high_us: Option<u32>,
    pub(super) image_count: u16,
    pub(super) led_percent: u8,
    pub(super) compression: Compression,
    pub(super) frame_time_ratio: f32,
    pub(super) score_threshold: f32,
    pub(super) outlier_filter: OutlierFilter,
    pub(super) reconstruction_quality: u8,
    pub(super) pre_filtering: u8,
    pub(super) working_volume: WorkingVolume,
    pub(super) points_min: u32,
    pub(super) warm_up: WarmUp,
    #[serde(default)]
    pub(super) exposure: Vec<ExposureFile>,
}

/// Other exposures for some views.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ExposureFile {
    pub(super) views: Vec<Spanned<u32>>,
    pub(super) exposure_us: u32,
    pub(super) hdr_low_us: Option<u32>,
    pub(super) hdr_high_us: Option<u32>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CleaningFile {
    pub(super) outlier_sigma: f64,
    pub(super) patch_max_px: u32,
    pub(super) incidence_max_deg: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RegistrationFile {
    pub(super) start: Start,
    pub(super) sample_count: usize,
    pub(super) overlap_distance_mm: Option<f64>,
    pub(super) prior_rotation_max_deg: f64,
    pub(super) prior_translation_max_mm: f64,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MergeFile {
    pub(super) overlap_min_fraction: Option<Spanned<f64>>,
    pub(super) overlap_min_count: Option<Spanned<u32>>,
    pub(super) coincident_distance_mm: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RunFile {
    pub(super) retakes_max: u16,
    pub(super) retake_on: Vec<RetakeReason>,
    pub(super) retake_exposure_factor: f64,
    pub(super) saturated_max_fraction: f64,
    pub(super) check_rotation_max_deg: f64,
    pub(super) check_translation_max_mm: f64,
}

/// A station file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StationFile {
    pub(super) name: Spanned<String>,
    pub(super) kind: KindFile,
    pub(super) robot: RobotFile,
    pub(super) camera: CameraLinkFile,
    pub(super) calibration: CalibrationFile,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum KindFile {
    Simulated,
    Cell,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RobotFile {
    pub(super) link: LinkFile,
    pub(super) address: Option<Spanned<String>>,
    pub(super) serial_device: Option<Spanned<String>>,
    pub(super) serial_baud: u32,
    pub(super) motion: MotionFile,
    pub(super) job: JobFile,
    pub(super) tool: u8,
    pub(super) speed_mm_s: f64,
    pub(super) rotation_speed_deg_s: f64,
    pub(super) answer_timeout_ms: u64,
    pub(super) ask_attempts: u32,
    pub(super) poll_interval_ms: u64,
    pub(super) start_grace_ms: u64,
    pub(super) move_timeout_ms: u64,
    pub(super) settle_ms: u64,
    pub(super) servo_timeout_ms: u64,
    pub(super) hold_repeat_ms: u64,
    pub(super) hold_timeout_ms: u64,
    pub(super) position_tolerance_mm: f64,
    pub(super) rotation_tolerance_deg: f64,
    pub(super) step_angle_max_deg: f64,
    pub(super) workspace: WorkspaceFile,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum LinkFile {
    Hses,
    HostControl,
    Serial,
}

#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum MotionFile {
    Direct,
    Job,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JobFile {
    pub(super) name: Spanned<String>,
    pub(super) position_first: u16,
    pub(super) position_last: Spanned<u16>,
    pub(super) variable_first: u16,
    pub(super) patience_ms: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WorkspaceFile {
    pub(super) min_mm: [f64; 3],
    pub(super) max_mm: Spanned<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraLinkFile {
    pub(super) address: Option<Spanned<String>>,
    pub(super) connect_timeout_ms: u64,
    pub(super) reply_timeout_ms: u64,
    pub(super) frame_timeout_extra_ms: u64,
    pub(super) ping_interval_ms: u64,
    pub(super) dead_after_ms: Spanned<u64>,
    pub(super) reconnect_timeout_ms: u64,
    pub(super) device_timeout_ms: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CalibrationFile {
    pub(super) id: Spanned<String>,
    pub(super) base_from_camera: PoseFile,
    pub(super) tool_from_blade: PoseFile,
}

/// A position and fixed-axis angles (x, then y, then z), as both kinds of file write a pose.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PoseFile {
    position_mm: [f64; 3],
    rotation_deg: [f64; 3],
}

impl PoseFile {
    pub(super) fn isometry(&self) -> Isometry3<f64> {
        let [rx_rad, ry_rad, rz_rad] = self.rotation_deg.map(f64::to_radians);
        Isometry3::from_parts(
            Translation3::from(self.position_mm),
            rotation_from_fixed_xyz(rx_rad, ry_rad, rz_rad),
        )
    }
}
