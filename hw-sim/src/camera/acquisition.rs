//! One acquisition: from the accepted trigger to the last chunk.

use crate::camera::fields::Zero;
use crate::camera::identity::{CALIBRATION_ID, TEMPERATURE_C};
use crate::camera::message::{ExposureDone, FrameHead, Message};
use crate::camera::render::{Capture, Compression, Frame, OutlierFilter, Roi, WorkingVolume};
use crate::camera::settings::Settings;
use crate::camera::transfer::Transfer;
use crate::fault::Fault;

/// Settings in force.
#[derive(Clone, Debug)]
pub(super) struct Config {
    pub(super) id: u32,
    pub(super) settings: Settings,
    pub(super) exposure_us: u32,
    pub(super) total_us: u32,
}

/// An accepted trigger that has not ended.
#[derive(Clone, Debug)]
pub(super) struct Acquisition {
    pub(super) job: u64,
    pub(super) trigger_id: u64,
    pub(super) view_id: u32,
    pub(super) config: Config,
    pub(super) begin_ns: u64,
    pub(super) exposure_end_ns: u64,
    pub(super) reconstruction_end_ns: u64,
    pub(super) deadline_ns: Option<u64>,
    pub(super) frame: Option<Frame>,
    pub(super) stage: Stage,
    pub(super) fault: Option<Fault>,
}

#[derive(Clone, Debug)]
pub(super) enum Stage {
    Exposing,
    Reconstructing,
    Sending { transfer: Box<Transfer>, next_ns: u64 },
}

impl Acquisition {
    /// When the stage ends; none while it waits for the frame.
    pub(super) fn due_ns(&self) -> Option<u64> {
        match &self.stage {
            Stage::Exposing => Some(self.exposure_end_ns),
            Stage::Reconstructing => {
                let needs_no_frame = matches!(self.fault, Some(Fault::CameraError { .. }));
                (self.frame.is_some() || needs_no_frame).then_some(self.reconstruction_end_ns)
            }
            Stage::Sending { next_ns, .. } => Some(*next_ns),
        }
    }

    pub(super) fn phase(&self) -> u8 {
        match self.stage {
            Stage::Exposing => 2,
            Stage::Reconstructing => 3,
            Stage::Sending { .. } => 4,
        }
    }

    pub(super) fn exposure_done(&self) -> Message {
        Message::ExposureDone(ExposureDone {
            trigger_id: self.trigger_id,
            exposure_begin_ns: self.begin_ns,
            exposure_end_ns: self.exposure_end_ns,
        })
    }

    pub(super) fn head(&self, now_ns: u64, frame_id: u64) -> FrameHead {
        let settings = &self.config.settings;
        let is_binned = settings.binning == 1;
        let first_px = |camera_px: [u16; 2]| if is_binned { [0, 0] } else { camera_px };
        FrameHead {
            frame_id,
            trigger_id: self.trigger_id,
            view_id: self.view_id,
            config_id: self.config.id,
            exposure_begin_ns: self.begin_ns,
            exposure_end_ns: self.exposure_end_ns,
            reconstruction_end_ns: now_ns,
            clock_id: 0,
            unit: 1,
            axes: 1,
            reserved_1: Zero,
            frame_flags: settings.pass_count() | u32::from(is_binned) << 8 | FLAG_SIMULATED,
            width_px: 0,
            height_px: 0,
            camera_1_px: first_px(settings.roi.camera_1_px),
            camera_2_px: first_px(settings.roi.camera_2_px),
            calibration_id: CALIBRATION_ID,
            scale: [1.0; 3],
            offset: [0.0; 3],
            valid_count: 0,
            saturated_count: 0,
            temperature_c: TEMPERATURE_C,
            component_count: 0,
            entry_len: 0,
            reserved_2: Zero,
        }
    }
}

/// Exposure phase, and exposure and reconstruction, in real time.
pub(super) fn predicted_us(settings: &Settings, speed: f64) -> (u32, u32) {
    let image_us = (f64::from(settings.exposure_us) * f64::from(settings.frame_time_ratio)).max(IMAGE_MIN_US);
    let exposure_us = f64::from(settings.pass_count()) * f64::from(settings.image_count) * image_us;
    let real_us = |camera_us: f64| (camera_us / speed).ceil().min(f64::from(u32::MAX)) as u32;
    (real_us(exposure_us), real_us(exposure_us + RECONSTRUCTION_US))
}

/// What the settings ask of the frame. The enumerations are checked before: a greater number is none that comes here.
pub(super) fn capture(settings: &Settings) -> Capture {
    Capture {
        binning: settings.binning == 1,
        roi: Roi {
            width_px: u32::from(settings.roi.width_px),
            height_px: u32::from(settings.roi.height_px),
            offset_x_px: u32::from(settings.roi.camera_1_px[0]),
            offset_y_px: u32::from(settings.roi.camera_1_px[1]),
        },
        exposure_us: f64::from(settings.exposure_us),
        hdr_us: settings.hdr_us,
        image_count: u32::from(settings.image_count),
        compression: match settings.compression {
            0 => Compression::None,
            1 => Compression::Low,
            2 => Compression::Medium,
            _ => Compression::High,
        },
        led_percent: settings.led_percent,
        score_threshold: settings.score_threshold,
        outlier_filter: match settings.outlier_filter {
            0 => OutlierFilter::Disabled,
            1 => OutlierFilter::Permissive,
            2 => OutlierFilter::Balanced,
            _ => OutlierFilter::Strict,
        },
        pre_filtering: settings.pre_filtering,
        working_volume: match settings.working_volume {
            0 => WorkingVolume::Standard,
            _ => WorkingVolume::Extended,
        },
    }
}

const FLAG_SIMULATED: u32 = 1 << 11;
/// Shortest time of an image: the projector's.
const IMAGE_MIN_US: f64 = 4500.0;
const RECONSTRUCTION_US: f64 = 100_000.0;
