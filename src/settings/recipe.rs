//! Recipes: what is measured, and how.

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;
use std::path::PathBuf;

use nalgebra::Isometry3;
use serde::Deserialize;
use toml::Spanned;

use super::error::SettingsError;
use super::keys::RECIPE_KEYS;
use super::retakes::Retakes;
use super::source::Source;
use super::station::name_is_plain;
use super::written::{CameraFile, ExposureFile, MergeFile, RecipeFile, RegistrationFile, ViewsFile};
use crate::cleaning;
use crate::reconstruction::OverlapMin;

/// What is measured, and how: one file per blade type.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    /// 1 to 64 letters, digits, dots, hyphens and underscores; names the run's folder.
    pub name: String,
    /// For people; may be empty.
    pub description: String,
    /// The nominal shape of the blade.
    pub cad: Cad,
    /// Which views are taken.
    pub views: Views,
    /// Where the fixture that carries the blade stands before the camera, in mm; the blade turns about its z axis.
    ///
    /// Camera frame: x right, y down, z away from the camera.
    pub camera_from_fixture: Isometry3<f64>,
    /// How each view is taken.
    pub camera: CameraSettings,
    /// What is taken out of each view before it is registered.
    pub cleaning: cleaning::Settings,
    /// How each view is registered.
    pub registration: Registration,
    /// When and how a view joins the model.
    pub merge: Merge,
    /// How far the blade may have moved when a run is resumed.
    pub check: Check,
    /// Which views are taken again.
    pub retakes: Retakes,
}

/// How far a view, taken again when a run is resumed, may lie from where it lay.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Check {
    /// Largest turn, 0.01 to 45 degrees, in rad.
    pub rotation_max_rad: f64,
    /// Largest shift of the middle of its points, 0.01 to 100 mm.
    pub translation_max_mm: f64,
}

/// The nominal shape of a blade.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cad {
    /// A generated blade, by its name after `builtin:`; whether it exists is for the generator to say.
    Builtin(String),
    /// A mesh file, as written: relative to the folder of the recipe.
    File(PathBuf),
}

/// The views of one full turn.
#[derive(Debug, Clone, PartialEq)]
pub struct Views {
    /// How many, 2 to 720; they divide the turn evenly.
    pub count: u32,
    /// The largest tilt about each of x and y, 0 to π/4 rad; 0 = no tilts.
    pub tilt_max_rad: f64,
    /// Those that are left out; never all.
    pub skipped: BTreeSet<usize>,
    /// How many must be merged for a run to count as done, 1 to those that are taken.
    pub merged_min_count: u32,
}

impl Views {
    /// The turn about the blade's z axis from one view to the next, in rad.
    pub fn step_rad(&self) -> f64 {
        TAU / f64::from(self.count)
    }
}

/// The settings of the camera for every view, in the camera's own terms (`docs/protocols/camera.md`, 4.4).
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSettings {
    /// The lens set that the camera must have.
    pub optics: Optics,
    /// Which part of the sensor is read.
    pub roi: Roi,
    /// Exposures of the views that have none of their own.
    pub exposure: Exposure,
    /// Views with exposures of their own.
    pub view_exposures: BTreeMap<usize, Exposure>,
    /// Pattern images for one frame, 12 to 60.
    pub image_count: u16,
    /// LED brightness, 1 to 100 %; above 25 % the camera inserts thermal pauses.
    pub led_percent: u8,
    /// Gradation compression.
    pub compression: Compression,
    /// Frame time over exposure time, 1 to 4; low is fast and noisier.
    pub frame_time_ratio: f32,
    /// Least matching score of a point, 0 to 1.
    pub score_threshold: f32,
    /// How eagerly lone points are dropped.
    pub outlier_filter: OutlierFilter,
    /// 0 (fast) to 9 (careful).
    pub reconstruction_quality: u8,
    /// Smoothing of the raw images, 0 (none) to 9.
    pub pre_filtering: u8,
    /// Where points are looked for.
    pub working_volume: WorkingVolume,
    /// A frame with fewer valid points is taken again; 1 to 1,555,200.
    pub points_min: u32,
    /// What a camera that is not warm yet means.
    pub warm_up: WarmUp,
}

impl CameraSettings {
    /// The exposures of one view.
    pub fn exposure_of(&self, view_index: usize) -> Exposure {
        self.view_exposures.get(&view_index).copied().unwrap_or(self.exposure)
    }
}

/// How long the sensor sees each pattern, pass by pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposure {
    /// Exposure of one image in µs, 10 to 50,000.
    pub exposure_us: u32,
    /// Exposure of an additional dark pass in µs, 10 to 50,000.
    pub hdr_low_us: Option<u32>,
    /// Exposure of an additional bright pass in µs, 10 to 50,000.
    pub hdr_high_us: Option<u32>,
}

/// What a camera that is not warm yet means: its frames drift.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WarmUp {
    /// It is said once.
    Note,
    /// Nothing is triggered before it is warm.
    Wait,
    /// The run ends.
    Refuse,
}

/// Which part of the sensor is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Roi {
    /// The whole sensor, two by two pixels joined.
    Binned,
    /// A rectangle in full resolution, the same in both cameras of the device: inside 1440 × 1080 px, at least 80 × 4 px,
    /// width and x in steps of 8 px, height and y in steps of 4 px.
    Rectangle {
        /// Width in px.
        width_px: u16,
        /// Height in px.
        height_px: u16,
        /// Left edge in px.
        x_px: u16,
        /// Top edge in px.
        y_px: u16,
    },
}

/// The lens set of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optics {
    /// Small field, dense points.
    Fine,
    /// Between the two.
    Medium,
    /// Large field, sparse points.
    Wide,
}

impl Optics {
    /// The name that recipes and the camera use.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Medium => "medium",
            Self::Wide => "wide",
        }
    }

    /// Neighbours nearer than this overlap, in mm: three times the point spacing at the nominal distance, unbinned.
    fn overlap_distance_mm(self) -> f64 {
        match self {
            Self::Fine => 0.12,
            Self::Medium => 0.6,
            Self::Wide => 1.35,
        }
    }
}

/// Gradation compression of the raw images: `Medium` and `High` carry 12 bits and are slower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the device's own words")]
pub enum Compression {
    None,
    Low,
    Medium,
    High,
}

/// How eagerly lone points are dropped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the device's own words")]
pub enum OutlierFilter {
    Disabled,
    Permissive,
    Balanced,
    Strict,
}

/// Where points are looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum WorkingVolume {
    /// What both cameras and the projector see.
    Standard,
    /// What any two of the three see.
    Extended,
}

/// How each view is registered.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration {
    /// Where the registration starts.
    pub start: Start,
    /// Points drawn from each cloud for the coarse stage, 50 to 20,000.
    pub sample_count: usize,
    /// A point with a reference neighbour within this distance overlaps, 0.001 to 10 mm.
    pub overlap_distance_mm: f64,
    /// A view registered farther than this from the robot's pose is discarded, 0.01° to 45° in rad.
    pub prior_rotation_max_rad: f64,
    /// A view registered farther than this from the robot's pose is discarded, 0.01 to 100 mm.
    pub prior_translation_max_mm: f64,
}

/// Where the registration of a view starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Start {
    /// At the pose that the robot reports.
    Robot,
    /// At the pose of the last view before it that was merged, without help from the robot.
    Previous,
}

/// When and how a view joins the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Merge {
    /// The least overlap with the model, the paper's tau_0: a share of 0.01 to 1 or 1 to 1,555,200 points.
    pub overlap_min: OverlapMin,
    /// Points nearer than this become one, 0.001 to 10 mm.
    pub coincident_distance_mm: f64,
}

impl Recipe {
    /// Reads a recipe from its text. `file_name` is only for errors; nothing is opened.
    ///
    /// # Errors
    ///
    /// One mistake in the text: broken TOML, an unknown or missing key, a wrong type, a value out of its range, or
    /// two keys that contradict each other.
    pub fn parse(file_name: &str, text: &str) -> Result<Self, SettingsError> {
        let source = Source::new(file_name, text, RECIPE_KEYS);
        let written: RecipeFile = source.written()?;
        let views = views(&source, &written.views)?;
        let camera = camera_settings(&source, written.camera, views.count)?;
        let registration = registration(&written.registration, &camera);
        Ok(Self {
            name: name_is_plain(&source, "name", written.name)?,
            description: written.description,
            cad: cad(&source, &written.blade.cad)?,
            views,
            camera_from_fixture: written.presentation.isometry(),
            merge: merge(&source, &written.merge, &registration)?,
            camera,
            cleaning: cleaning::Settings {
                outlier_sigma: written.cleaning.outlier_sigma,
                patch_max_count: written.cleaning.patch_max_px as usize,
                incidence_max_rad: written.cleaning.incidence_max_deg.to_radians(),
            },
            registration,
            check: Check {
                rotation_max_rad: written.run.check_rotation_max_deg.to_radians(),
                translation_max_mm: written.run.check_translation_max_mm,
            },
            retakes: Retakes {
                max_count: written.run.retakes_max,
                reasons: written.run.retake_on,
                exposure_factor: written.run.retake_exposure_factor,
                saturated_max_fraction: written.run.saturated_max_fraction,
            },
        })
    }

    /// How many views a full turn has.
    pub fn view_count(&self) -> usize {
        self.views.count as usize
    }
}

fn views(source: &Source, written: &ViewsFile) -> Result<Views, SettingsError> {
    let step_deg = *written.step_deg.get_ref();
    let count = (360.0 / step_deg).round();
    if (360.0 / count - step_deg).abs() > STEP_TOLERANCE_DEG {
        let fewer = (360.0 / step_deg).floor();
        let [below, above] = [fewer + 1.0, fewer].map(|count| format!("{:.6}", 360.0 / count));
        let [below, above] = [&below, &above].map(|step| step.trim_end_matches('0').trim_end_matches('.'));
        let message = format!("`views.step_deg` is {step_deg} deg, which does not divide 360 deg");
        let help = format!("the nearest that do are {below} and {above} deg; allowed: 0.5 to 180 deg");
        return Err(source.error(written.step_deg.span(), message, Some(help)));
    }
    let count = count as u32;
    let skipped = skipped_views(source, &written.skip, count)?;
    let taken_count = count - skipped.len() as u32;
    let merged_min_count = match &written.views_min {
        None => (taken_count - 1).max(1),
        Some(least) if *least.get_ref() <= taken_count => *least.get_ref(),
        Some(least) => {
            let left_out = match skipped.len() {
                0 => String::new(),
                skipped_count => format!(", {skipped_count} of them left out"),
            };
            let message = format!(
                "`views.views_min` is {}, but there are {count} views{left_out}",
                least.get_ref()
            );
            return Err(source.error_in_value("views.views_min", least.span(), message));
        }
    };
    Ok(Views {
        count,
        tilt_max_rad: written.tilt_max_deg.to_radians(),
        skipped,
        merged_min_count,
    })
}

fn skipped_views(source: &Source, written: &[Spanned<u32>], count: u32) -> Result<BTreeSet<usize>, SettingsError> {
    let mut skipped = BTreeSet::new();
    for view in written {
        let view_index = *view.get_ref();
        let wrong = if view_index >= count {
            format!("names view {view_index}, but there are {count} views, from 0")
        } else if !skipped.insert(view_index as usize) {
            format!("names view {view_index} a second time")
        } else if skipped.len() == count as usize {
            "leaves no view".to_owned()
        } else {
            continue;
        };
        return Err(source.error(view.span(), format!("`views.skip` {wrong}"), None));
    }
    Ok(skipped)
}

fn cad(source: &Source, written: &Spanned<String>) -> Result<Cad, SettingsError> {
    let text = written.get_ref();
    match text.strip_prefix("builtin:") {
        Some("") => Err("`blade.cad` names no built-in blade"),
        None if text.is_empty() => Err("`blade.cad` is empty"),
        Some(name) => Ok(Cad::Builtin(name.to_owned())),
        None => Ok(Cad::File(PathBuf::from(text))),
    }
    .map_err(|message| source.error_in_value("blade.cad", written.span(), message.to_owned()))
}

fn camera_settings(source: &Source, written: CameraFile, view_count: u32) -> Result<CameraSettings, SettingsError> {
    Ok(CameraSettings {
        optics: written.optics,
        roi: roi(source, written.binning, written.roi_px.as_ref())?,
        exposure: Exposure {
            exposure_us: written.exposure_us,
            hdr_low_us: written.hdr_low_us,
            hdr_high_us: written.hdr_high_us,
        },
        view_exposures: view_exposures(source, &written.exposure, view_count)?,
        image_count: written.image_count,
        led_percent: written.led_percent,
        compression: written.compression,
        frame_time_ratio: written.frame_time_ratio,
        score_threshold: written.score_threshold,
        outlier_filter: written.outlier_filter,
        reconstruction_quality: written.reconstruction_quality,
        pre_filtering: written.pre_filtering,
        working_volume: written.working_volume,
        points_min: written.points_min,
        warm_up: written.warm_up,
    })
}

fn view_exposures(
    source: &Source,
    written: &[ExposureFile],
    view_count: u32,
) -> Result<BTreeMap<usize, Exposure>, SettingsError> {
    let mut exposures = BTreeMap::new();
    for entry in written {
        let exposure = Exposure {
            exposure_us: entry.exposure_us,
            hdr_low_us: entry.hdr_low_us,
            hdr_high_us: entry.hdr_high_us,
        };
        for view in &entry.views {
            let view_index = *view.get_ref();
            let wrong = if view_index >= view_count {
                Some(format!(
                    "names view {view_index}, but there are {view_count} views, from 0"
                ))
            } else if exposures.insert(view_index as usize, exposure).is_some() {
                Some(format!("names view {view_index} a second time"))
            } else {
                None
            };
            if let Some(wrong) = wrong {
                let message = format!("`camera.exposure[].views` {wrong}");
                return Err(source.error(view.span(), message, None));
            }
        }
    }
    Ok(exposures)
}

fn roi(source: &Source, binning: bool, written: Option<&Spanned<[u16; 4]>>) -> Result<Roi, SettingsError> {
    let refused = |span, message: String| {
        let help = "[width, height, x, y]: inside 1440 x 1080 px, at least 80 x 4 px, width and x in steps of 8 px, \
                    height and y in steps of 4 px, without binning";
        Err(source.error(span, message, Some(help.to_owned())))
    };
    let [width_px, height_px, x_px, y_px] = match written {
        Some(roi) if binning => {
            let message = "`camera.roi_px` has no effect while `camera.binning` is on";
            return refused(roi.span(), message.to_owned());
        }
        Some(roi) => *roi.get_ref(),
        None if binning => return Ok(Roi::Binned),
        None => [SENSOR_WIDTH_PX, SENSOR_HEIGHT_PX, 0, 0],
    };
    let fits =
        width_px >= 80 && height_px >= 4 && width_px + x_px <= SENSOR_WIDTH_PX && height_px + y_px <= SENSOR_HEIGHT_PX;
    let on_grid = width_px % 8 == 0 && x_px % 8 == 0 && height_px % 4 == 0 && y_px % 4 == 0;
    match written {
        Some(roi) if !(fits && on_grid) => {
            let wrong = if fits {
                "is off the sensor's steps"
            } else {
                "does not fit the sensor"
            };
            let message = format!("`camera.roi_px` {wrong}: {width_px} x {height_px} px at {x_px}, {y_px}");
            refused(roi.span(), message)
        }
        _ => Ok(Roi::Rectangle {
            width_px,
            height_px,
            x_px,
            y_px,
        }),
    }
}

fn registration(written: &RegistrationFile, camera: &CameraSettings) -> Registration {
    let spacing_factor = if camera.roi == Roi::Binned { 2.0 } else { 1.0 };
    let from_optics_mm = camera.optics.overlap_distance_mm() * spacing_factor;
    Registration {
        start: written.start,
        sample_count: written.sample_count,
        overlap_distance_mm: written.overlap_distance_mm.unwrap_or(from_optics_mm),
        prior_rotation_max_rad: written.prior_rotation_max_deg.to_radians(),
        prior_translation_max_mm: written.prior_translation_max_mm,
    }
}

fn merge(source: &Source, written: &MergeFile, registration: &Registration) -> Result<Merge, SettingsError> {
    let help = || Some("give either `overlap_min_fraction` (0.01 to 1) or `overlap_min_count` (points)".to_owned());
    let overlap_min = match (&written.overlap_min_fraction, &written.overlap_min_count) {
        (Some(fraction), None) => OverlapMin::Fraction(*fraction.get_ref()),
        (None, Some(count)) => OverlapMin::Count(*count.get_ref() as usize),
        (Some(fraction), Some(count)) => {
            let second = if fraction.span().start < count.span().start {
                count.span()
            } else {
                fraction.span()
            };
            let message = "the least overlap is given twice, as a fraction and as a count".to_owned();
            return Err(source.error(second, message, help()));
        }
        (None, None) => {
            let message = "the least overlap is missing".to_owned();
            return Err(source.error_at_key("merge.overlap_min_fraction", message, help()));
        }
    };
    let coincident_distance_mm = written
        .coincident_distance_mm
        .unwrap_or(registration.overlap_distance_mm / 3.0);
    Ok(Merge {
        overlap_min,
        coincident_distance_mm,
    })
}

/// Room for a step written with six decimals.
const STEP_TOLERANCE_DEG: f64 = 1e-6;

const SENSOR_WIDTH_PX: u16 = 1440;
const SENSOR_HEIGHT_PX: u16 = 1080;
