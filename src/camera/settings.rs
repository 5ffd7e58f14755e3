//! The complete settings of the camera, as CONFIGURE sends and CONFIGURED echoes them (sections 4.4 and 4.5 of the page).

use super::payload::{PayloadError, PayloadReader};
use serde::{Deserialize, Serialize};

/// Everything that CONFIGURE fixes. Ranges are the camera's (CAPS); the recipe's are within the A5000's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Halve width and height; the region of interest is then ignored.
    pub binning: bool,
    /// Region of interest: width, height, camera 1 x, y, camera 2 x, y, in pixels.
    pub roi_px: [u16; 6],
    /// Exposure of one image, µs.
    pub exposure_us: u32,
    /// Images in one 3D frame.
    pub image_count: u16,
    /// Exposure of the low and the high HDR pass, µs; 0 = pass off.
    pub hdr_us: [u32; 2],
    /// Gradation compression: 0 none, 1 low, 2 medium, 3 high.
    pub compression: u8,
    /// LED brightness, percent.
    pub led_percent: u8,
    /// Frame time over exposure, 1 to 4.
    pub frame_time_ratio: f32,
    /// Least correlation score, 0 to 1.
    pub score_threshold: f32,
    /// 0 disabled, 1 permissive, 2 balanced, 3 strict.
    pub outlier_filter: u8,
    /// 0 to 9.
    pub reconstruction_quality: u8,
    /// 0 to 9.
    pub pre_filtering: u8,
    /// 0 standard, 1 extended.
    pub working_volume: u8,
    /// Components wanted: bit n = kind n.
    pub components: u32,
}

impl CameraSettings {
    /// The tag-length-value list, ascending. The volume of interest is always off.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut put = |tag: u16, value: &[u8]| {
            bytes.extend_from_slice(&tag.to_le_bytes());
            bytes.extend_from_slice(&(value.len() as u16).to_le_bytes());
            bytes.extend_from_slice(value);
        };
        put(tag::BINNING, &[u8::from(self.binning)]);
        put(tag::ROI, &self.roi_px.map(u16::to_le_bytes).concat());
        put(tag::EXPOSURE_US, &self.exposure_us.to_le_bytes());
        put(tag::IMAGE_COUNT, &self.image_count.to_le_bytes());
        put(tag::HDR, &self.hdr_us.map(u32::to_le_bytes).concat());
        put(tag::COMPRESSION, &[self.compression]);
        put(tag::LED_PERCENT, &[self.led_percent]);
        put(tag::FRAME_TIME_RATIO, &self.frame_time_ratio.to_le_bytes());
        put(tag::SCORE_THRESHOLD, &self.score_threshold.to_le_bytes());
        put(tag::OUTLIER_FILTER, &[self.outlier_filter]);
        put(tag::RECONSTRUCTION_QUALITY, &[self.reconstruction_quality]);
        put(tag::PRE_FILTERING, &[self.pre_filtering]);
        put(tag::WORKING_VOLUME, &[self.working_volume]);
        put(tag::VOLUME_OF_INTEREST, &[0; 28]);
        put(tag::COMPONENTS, &self.components.to_le_bytes());
        bytes
    }

    /// Reads an echo. Tags must ascend and all be there; the volume of interest must be off.
    pub fn decode(bytes: &[u8]) -> Result<Self, PayloadError> {
        let mut list = PayloadReader::new(bytes);
        let mut value = |wanted: u16, length: u16| {
            let found = list.u16()?;
            if found != wanted {
                return Err(PayloadError::Value {
                    field: "a settings tag",
                    value: u64::from(found),
                });
            }
            let found = list.u16()?;
            if found != length {
                return Err(PayloadError::Value {
                    field: "the length of a settings value",
                    value: u64::from(found),
                });
            }
            Ok(PayloadReader::new(list.bytes(usize::from(length))?))
        };
        let binning = value(tag::BINNING, 1)?.u8()? != 0;
        let mut roi = value(tag::ROI, 12)?;
        let mut roi_px = [0; 6];
        for field in &mut roi_px {
            *field = roi.u16()?;
        }
        let exposure_us = value(tag::EXPOSURE_US, 4)?.u32()?;
        let image_count = value(tag::IMAGE_COUNT, 2)?.u16()?;
        let mut hdr = value(tag::HDR, 8)?;
        let hdr_us = [hdr.u32()?, hdr.u32()?];
        let compression = value(tag::COMPRESSION, 1)?.u8()?;
        let led_percent = value(tag::LED_PERCENT, 1)?.u8()?;
        let frame_time_ratio = value(tag::FRAME_TIME_RATIO, 4)?.f32()?;
        let score_threshold = value(tag::SCORE_THRESHOLD, 4)?.f32()?;
        let outlier_filter = value(tag::OUTLIER_FILTER, 1)?.u8()?;
        let reconstruction_quality = value(tag::RECONSTRUCTION_QUALITY, 1)?.u8()?;
        let pre_filtering = value(tag::PRE_FILTERING, 1)?.u8()?;
        let working_volume = value(tag::WORKING_VOLUME, 1)?.u8()?;
        let volume_of_interest = value(tag::VOLUME_OF_INTEREST, 28)?.u8()?;
        if volume_of_interest != 0 {
            return Err(PayloadError::Value {
                field: "volume_of_interest",
                value: u64::from(volume_of_interest),
            });
        }
        let components = value(tag::COMPONENTS, 4)?.u32()?;
        list.end()?;
        Ok(Self {
            binning,
            roi_px,
            exposure_us,
            image_count,
            hdr_us,
            compression,
            led_percent,
            frame_time_ratio,
            score_threshold,
            outlier_filter,
            reconstruction_quality,
            pre_filtering,
            working_volume,
            components,
        })
    }
}

/// The first setting whose echo differs, in words.
pub(super) fn difference(wanted: &CameraSettings, found: &CameraSettings) -> Option<String> {
    let list = |settings: &CameraSettings| {
        [
            ("binning", f64::from(u8::from(settings.binning))),
            ("exposure_us", f64::from(settings.exposure_us)),
            ("image_count", f64::from(settings.image_count)),
            ("hdr_low_us", f64::from(settings.hdr_us[0])),
            ("hdr_high_us", f64::from(settings.hdr_us[1])),
            ("compression", f64::from(settings.compression)),
            ("led_percent", f64::from(settings.led_percent)),
            ("frame_time_ratio", f64::from(settings.frame_time_ratio)),
            ("score_threshold", f64::from(settings.score_threshold)),
            ("outlier_filter", f64::from(settings.outlier_filter)),
            ("reconstruction_quality", f64::from(settings.reconstruction_quality)),
            ("pre_filtering", f64::from(settings.pre_filtering)),
            ("working_volume", f64::from(settings.working_volume)),
            ("components", f64::from(settings.components)),
        ]
    };
    if wanted.roi_px != found.roi_px {
        return Some(format!(
            "roi: asked for {:?}, in force {:?}",
            wanted.roi_px, found.roi_px
        ));
    }
    list(wanted)
        .iter()
        .zip(list(found))
        .find(|((_, wanted), (_, found))| wanted != found)
        .map(|((name, wanted), (_, found))| format!("{name}: asked for {wanted}, in force {found}"))
}

mod tag {
    pub(super) const BINNING: u16 = 0x8001;
    pub(super) const ROI: u16 = 0x8002;
    pub(super) const EXPOSURE_US: u16 = 0x8003;
    pub(super) const IMAGE_COUNT: u16 = 0x8004;
    pub(super) const HDR: u16 = 0x8005;
    pub(super) const COMPRESSION: u16 = 0x8006;
    pub(super) const LED_PERCENT: u16 = 0x8007;
    pub(super) const FRAME_TIME_RATIO: u16 = 0x8008;
    pub(super) const SCORE_THRESHOLD: u16 = 0x8009;
    pub(super) const OUTLIER_FILTER: u16 = 0x800A;
    pub(super) const RECONSTRUCTION_QUALITY: u16 = 0x800B;
    pub(super) const PRE_FILTERING: u16 = 0x800C;
    pub(super) const WORKING_VOLUME: u16 = 0x800D;
    pub(super) const VOLUME_OF_INTEREST: u16 = 0x800E;
    pub(super) const COMPONENTS: u16 = 0x800F;
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::camera) const PAGE_SETTINGS: CameraSettings = CameraSettings {
        binning: true,
        roi_px: [1440, 1080, 0, 0, 0, 0],
        exposure_us: 1000,
        image_count: 24,
        hdr_us: [0, 0],
        compression: 1,
        led_percent: 25,
        frame_time_ratio: 2.0,
        score_threshold: 0.85,
        outlier_filter: 1,
        reconstruction_quality: 5,
        pre_filtering: 3,
        working_volume: 1,
        components: 0b10101,
    };

    #[test]
    fn settings_read_back_and_no_cut_list_is_believed() {
        let bytes = PAGE_SETTINGS.encode();
        assert_eq!(CameraSettings::decode(&bytes), Ok(PAGE_SETTINGS));
        for length in 0..bytes.len() {
            assert!(CameraSettings::decode(&bytes[..length]).is_err(), "cut to {length}");
        }
    }
}
