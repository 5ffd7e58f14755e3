//! What is asked of the camera for one frame.

use super::optics::{SENSOR_HEIGHT_PX, SENSOR_WIDTH_PX};

/// Camera settings that shape a frame. Values are taken as they are: who owns the limits checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capture {
    /// Half the columns and rows, four pixels averaged; the region of interest is ignored.
    pub binning: bool,
    /// The delivered part of the sensor.
    pub roi: Roi,
    /// Exposure of each image, µs.
    pub exposure_us: f64,
    /// Exposures of the additional dark and bright pass, µs; 0 is off.
    pub hdr_us: [u32; 2],
    /// Images of the pattern sequence.
    pub image_count: u32,
    /// How the raw images' brightness is compressed.
    pub compression: Compression,
    /// Brightness of the LED, percent.
    pub led_percent: u8,
    /// Pixels with a lower score are invalid, 0 to 1.
    pub score_threshold: f32,
    /// How eagerly lone points are dropped.
    pub outlier_filter: OutlierFilter,
    /// Smoothing of the raw images, 0 to 9.
    pub pre_filtering: u8,
    /// Which devices must see a point.
    pub working_volume: WorkingVolume,
}

/// Gradation compression. None and low carry 10 bits, medium and high 12 (sheet 1.2, *sourced*).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// 10 bits as they are.
    None,
    /// 10 bits.
    Low,
    /// 12 bits.
    Medium,
    /// 12 bits, with the dark end spread most.
    High,
}

/// Outlier filter of the reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutlierFilter {
    /// Keeps all.
    Disabled,
    /// The device's default.
    Permissive,
    /// Between the two.
    Balanced,
    /// Drops most.
    Strict,
}

/// Which devices must see a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorkingVolume {
    /// Both cameras, and the projector must light it.
    Standard,
    /// Camera 1 and one more: where camera 2 does not see, the projector takes its place.
    Extended,
}

impl Capture {
    /// Exposures of the passes, µs: the main one, then the dark and the bright one where they are on.
    pub fn passes_us(&self) -> impl Iterator<Item = f64> {
        let further_us = self.hdr_us.into_iter().filter(|&pass_us| pass_us > 0);
        std::iter::once(self.exposure_us).chain(further_us.map(f64::from))
    }
}

impl Default for Capture {
    /// The device's defaults (sheet 1.2): full grid, 1000 µs, one pass, 24 images, score 0.85; but the standard volume and
    /// the 25 % of the LED that need no pauses.
    fn default() -> Capture {
        Capture {
            binning: false,
            roi: Roi::FULL,
            exposure_us: 1000.0,
            hdr_us: [0; 2],
            image_count: 24,
            compression: Compression::Low,
            led_percent: 25,
            score_threshold: 0.85,
            outlier_filter: OutlierFilter::Permissive,
            pre_filtering: 3,
            working_volume: WorkingVolume::Standard,
        }
    }
}

/// A rectangle of the sensor, in pixels of the full grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Roi {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// First column.
    pub offset_x_px: u32,
    /// First row.
    pub offset_y_px: u32,
}

impl Roi {
    /// The whole sensor.
    pub const FULL: Roi = Roi {
        width_px: SENSOR_WIDTH_PX,
        height_px: SENSOR_HEIGHT_PX,
        offset_x_px: 0,
        offset_y_px: 0,
    };
}
