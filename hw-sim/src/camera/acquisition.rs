//! One acquisition: from the accepted trigger to its frame.

use crate::camera::fields::Zero;
use crate::camera::identity::CALIBRATION_ID;
use crate::camera::message::{ExposureDone, FrameHead, Message};
use crate::camera::render::{Capture, Compression, Frame, OutlierFilter, Roi, WorkingVolume};
use crate::camera::script::{Script, is_incident};
use crate::camera::settings::Settings;
use crate::camera::thermal::Thermal;
use crate::camera::trouble::Phase;

/// Settings in force. Times are real ones.
#[derive(Clone, Debug)]
pub(super) struct Config {
    pub(super) id: u32,
    pub(super) settings: Settings,
    pub(super) exposure_us: u32,
    pub(super) total_us: u32,
    /// Pause of the projector in mid-exposure.
    pub(super) pause_us: u32,
}

/// An accepted trigger that has not ended.
#[derive(Clone, Debug)]
pub(super) struct Acquisition {
    pub(super) job: u64,
    pub(super) trigger_id: u64,
    pub(super) view_id: u32,
    pub(super) config: Config,
    pub(super) begin_ns: u64,
    pub(super) exposure_mid_ns: u64,
    pub(super) exposure_end_ns: u64,
    pub(super) reconstruction_end_ns: u64,
    pub(super) deadline_ns: Option<u64>,
    /// Pause for the projector that is still to be made.
    pub(super) pause_us: u32,
    pub(super) frame: Option<Frame>,
    pub(super) stage: Stage,
    /// Connection that its messages go to.
    pub(super) receiver: Option<u64>,
    /// Connection that EXPOSURE_DONE went to.
    pub(super) told: Option<u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Exposing,
    Reconstructing,
    Sending,
}

impl Acquisition {
    /// When the stage ends, or something happens in the middle of it; none while it waits for the frame or is sent.
    pub(super) fn due_ns(&self, script: &Script) -> Option<u64> {
        let has_incident = |phase| script.has(self.trigger_id, phase, is_incident);
        match self.stage {
            Stage::Exposing if self.pause_us > 0 || has_incident(Phase::Exposure) => Some(self.exposure_mid_ns),
            Stage::Exposing => Some(self.exposure_end_ns),
            Stage::Reconstructing if has_incident(Phase::Reconstruction) => Some(self.reconstruction_mid_ns()),
            Stage::Reconstructing => self.frame.as_ref().map(|_| self.reconstruction_end_ns),
            Stage::Sending => None,
        }
    }

    fn reconstruction_mid_ns(&self) -> u64 {
        self.exposure_end_ns.midpoint(self.reconstruction_end_ns)
    }

    /// Phase of the protocol page.
    pub(super) fn phase(&self) -> u8 {
        match self.stage {
            Stage::Exposing => 2,
            Stage::Reconstructing => 3,
            Stage::Sending => 4,
        }
    }

    /// Everything that is still to come does so later.
    pub(super) fn put_off(&mut self, span_ns: u64) {
        self.exposure_end_ns += span_ns;
        self.reconstruction_end_ns += span_ns;
    }

    pub(super) fn exposure_done(&self) -> Message {
        Message::ExposureDone(ExposureDone {
            trigger_id: self.trigger_id,
            exposure_begin_ns: self.begin_ns,
            exposure_end_ns: self.exposure_end_ns,
        })
    }

    /// Predicted time to FRAME_BEGIN, µs.
    pub(super) fn remaining_us(&self, now_ns: u64) -> u32 {
        let remaining_ns = match self.stage {
            Stage::Sending => 0,
            _ => self.reconstruction_end_ns.saturating_sub(now_ns) + u64::from(self.pause_us) * 1000,
        };
        u32::try_from(remaining_ns.div_ceil(1000)).unwrap_or(u32::MAX)
    }

    pub(super) fn head(&self, now_ns: u64, frame_id: u64, thermal: &Thermal) -> FrameHead {
        let settings = &self.config.settings;
        let is_binned = settings.binning == 1;
        let first_px = |camera_px: [u16; 2]| if is_binned { [0, 0] } else { camera_px };
        let flags = [
            (is_binned, FLAG_BINNED),
            (!thermal.is_warm(), FLAG_WARM_UP_INCOMPLETE),
            (true, FLAG_SIMULATED),
        ];
        let set = flags.iter().filter(|(is_set, _)| *is_set).map(|(_, flag)| flag);
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
            frame_flags: settings.pass_count() | set.sum::<u32>(),
            width_px: 0,
            height_px: 0,
            camera_1_px: first_px(settings.roi.camera_1_px),
            camera_2_px: first_px(settings.roi.camera_2_px),
            calibration_id: CALIBRATION_ID,
            scale: [1.0; 3],
            offset: [0.0; 3],
            valid_count: 0,
            saturated_count: 0,
            temperature_c: thermal.temperature_c(),
            component_count: 0,
            entry_len: 0,
            reserved_2: Zero,
        }
    }
}

impl Config {
    /// Settings that come into force, at so many camera seconds in one of the clock.
    pub(super) fn new(id: u32, settings: Settings, speed: f64) -> Self {
        let image_us = (f64::from(settings.exposure_us) * f64::from(settings.frame_time_ratio)).max(IMAGE_MIN_US);
        let exposure_us = f64::from(settings.pass_count()) * f64::from(settings.image_count) * image_us;
        let reconstruction_us =
            RECONSTRUCTION_MIN_US + RECONSTRUCTION_STEP_US * f64::from(settings.reconstruction_quality);
        let too_bright = (f64::from(settings.led_percent) / LED_FREE_PERCENT - 1.0).max(0.0);
        let real_us = |camera_us: f64| (camera_us / speed).ceil().min(f64::from(u32::MAX)) as u32;
        Self {
            id,
            exposure_us: real_us(exposure_us),
            total_us: real_us(exposure_us + reconstruction_us),
            pause_us: real_us(exposure_us * too_bright).min(PAUSE_MAX_US),
            settings,
        }
    }
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

/// Frame flag: half the columns and rows.
const FLAG_BINNED: u32 = 1 << 8;
/// Frame flag: computed from less than was asked for.
pub(super) const FLAG_DEGRADED: u32 = 1 << 9;
const FLAG_WARM_UP_INCOMPLETE: u32 = 1 << 10;
const FLAG_SIMULATED: u32 = 1 << 11;
/// Shortest time of an image: the projector's (*assumed*).
const IMAGE_MIN_US: f64 = 4500.0;
/// Reconstruction takes 40 to 148 ms by its quality (*assumed*, 0 to 9).
const RECONSTRUCTION_MIN_US: f64 = 40_000.0;
const RECONSTRUCTION_STEP_US: f64 = 12_000.0;
/// Light above this makes the device pause (*sourced*). The pause is as long as makes the mean light of exposure and pause
/// this much again (*assumed*), and at most as long as the protocol lets a client wait.
const LED_FREE_PERCENT: f64 = 25.0;
const PAUSE_MAX_US: u32 = 60_000_000;
