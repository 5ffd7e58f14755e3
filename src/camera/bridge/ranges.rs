//! What the settings may be, how large their frames are and how long they take.

use crate::camera::code;
use crate::camera::message::{Caps, ComponentKind};
use crate::camera::settings::CameraSettings;

/// Why settings are refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Refusal {
    /// Code of the page.
    pub(super) code: u16,
    /// In words.
    pub(super) text: String,
}

/// Checks every setting against what the camera can do.
pub(super) fn check(settings: &CameraSettings, caps: &Caps) -> Result<(), Refusal> {
    let exposure = f64::from(caps.exposure_min_us)..=f64::from(caps.exposure_max_us);
    let pass = |exposure_us: u32| exposure_us == 0 || exposure.contains(&f64::from(exposure_us));
    let bit = |mask: u32, value: u8| value < 32 && mask >> value & 1 == 1;
    let count = caps.image_count_min..=caps.image_count_max;
    let volume = settings.volume_of_interest.is_none_or(|volume| {
        let ends = volume.min_mm.iter().zip(&volume.max_mm);
        let mut all = ends.map(|(min, max)| min.is_finite() && max.is_finite() && min < max);
        all.all(|ascending| ascending)
    });
    for (name, fits) in [
        ("exposure_us", exposure.contains(&f64::from(settings.exposure_us))),
        ("image_count", count.contains(&settings.image_count)),
        ("hdr", settings.hdr_us.into_iter().all(pass)),
        ("compression", bit(caps.compressions, settings.compression)),
        (
            "led_percent",
            (1..=caps.led_max_percent).contains(&settings.led_percent),
        ),
        ("frame_time_ratio", (1.0..=4.0).contains(&settings.frame_time_ratio)),
        ("score_threshold", (0.0..=1.0).contains(&settings.score_threshold)),
        ("outlier_filter", bit(caps.outlier_filters, settings.outlier_filter)),
        ("reconstruction_quality", settings.reconstruction_quality <= 9),
        ("pre_filtering", settings.pre_filtering <= 9),
        ("working_volume", bit(caps.working_volumes, settings.working_volume)),
        ("volume_of_interest", volume),
    ] {
        if !fits {
            return Err(refusal(code::OUT_OF_RANGE, name));
        }
    }
    if !settings.binning {
        check_roi(settings.roi_px, caps)?;
    }
    check_components(settings.components, caps)
}

fn check_roi([width, height, x_1, y_1, x_2, y_2]: [u16; 6], caps: &Caps) -> Result<(), Refusal> {
    let steps = |value: u16, axis: usize| value.is_multiple_of(caps.roi_step_px[axis].max(1));
    let inside = |start: u16, length: u16, axis: usize| {
        u32::from(start) + u32::from(length) <= u32::from(caps.sensor_px[axis]) && length >= caps.roi_min_px[axis]
    };
    if ![x_1, x_2].into_iter().all(|x| inside(x, width, 0)) || ![y_1, y_2].into_iter().all(|y| inside(y, height, 1)) {
        return Err(refusal(code::OUT_OF_RANGE, "roi"));
    }
    if ![width, x_1, x_2].into_iter().all(|x| steps(x, 0)) || ![height, y_1, y_2].into_iter().all(|y| steps(y, 1)) {
        return Err(refusal(code::NOT_ON_STEP, "roi"));
    }
    Ok(())
}

fn check_components(components: u32, caps: &Caps) -> Result<(), Refusal> {
    let points = ComponentKind::Xyz.bit() | ComponentKind::Range.bit();
    if components & ComponentKind::Mask.bit() == 0 || components & points == 0 {
        return Err(refusal(code::OUT_OF_RANGE, "components"));
    }
    if components & !caps.components != 0 {
        return Err(refusal(code::COMPONENT_NOT_OFFERED, "components"));
    }
    Ok(())
}

fn refusal(code: u16, name: &str) -> Refusal {
    let reason = code::name(code).unwrap_or_default().replace('_', " ");
    Refusal {
        code,
        text: format!("{name}: {reason}"),
    }
}

/// Width and height of the frames.
pub(super) fn size_px(settings: &CameraSettings, caps: &Caps) -> [u32; 2] {
    let [width, height] = match settings.binning {
        true => caps.sensor_px.map(|length| length / 2),
        false => [settings.roi_px[0], settings.roi_px[1]],
    };
    [u32::from(width), u32::from(height)]
}

/// The kinds of components asked for, ascending.
pub(super) fn kinds(settings: &CameraSettings) -> impl Iterator<Item = ComponentKind> {
    let components = settings.components;
    ComponentKind::ALL
        .into_iter()
        .filter(move |kind| components & kind.bit() != 0)
}

/// Bytes of one frame.
pub(super) fn frame_bytes(settings: &CameraSettings, caps: &Caps) -> u64 {
    let [width, height] = size_px(settings, caps).map(u64::from);
    width * height * kinds(settings).map(ComponentKind::pixel_bytes).sum::<u64>()
}

/// Exposure passes of a frame.
pub(super) fn pass_count(settings: &CameraSettings) -> u8 {
    1 + settings.hdr_us.iter().filter(|&&exposure_us| exposure_us > 0).count() as u8
}

/// How long the exposures of a frame take, µs.
pub(super) fn exposure_us(settings: &CameraSettings) -> u32 {
    let passes = std::iter::once(settings.exposure_us).chain(settings.hdr_us.into_iter().filter(|&pass| pass > 0));
    let images = f64::from(settings.image_count);
    let ratio = f64::from(settings.frame_time_ratio);
    let total: f64 = passes
        .map(|exposure_us| images * (f64::from(exposure_us) * ratio).max(READ_OUT_US))
        .sum();
    START_US + total as u32
}

/// Reading out one image takes so long (assumed, as the sheet's model does).
const READ_OUT_US: f64 = 4500.0;
/// From the order to the first image (assumed).
const START_US: u32 = 50_000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::settings::VolumeOfInterest;
    use crate::camera::settings::tests::PAGE_SETTINGS;

    fn caps() -> Caps {
        let text = include_str!("../../../config/bridges/a5000.toml");
        super::super::BridgeConfig::parse(text).unwrap().caps()
    }

    fn refused(change: impl FnOnce(&mut CameraSettings)) -> Option<u16> {
        let mut settings = CameraSettings {
            binning: false,
            ..PAGE_SETTINGS
        };
        change(&mut settings);
        check(&settings, &caps()).err().map(|refusal| refusal.code)
    }

    #[test]
    fn settings_at_the_ends_of_their_ranges_pass() {
        assert_eq!(refused(|_| {}), None);
        assert_eq!(refused(|settings| settings.roi_px = [80, 4, 1360, 1076, 0, 0]), None);
        assert_eq!(refused(|settings| settings.hdr_us = [10, 50_000]), None);
    }

    #[test]
    fn each_setting_out_of_range_has_its_code() {
        assert_eq!(refused(|settings| settings.exposure_us = 9), Some(301));
        assert_eq!(refused(|settings| settings.image_count = 61), Some(301));
        assert_eq!(refused(|settings| settings.hdr_us[1] = 50_001), Some(301));
        assert_eq!(refused(|settings| settings.compression = 4), Some(301));
        assert_eq!(refused(|settings| settings.led_percent = 0), Some(301));
        assert_eq!(refused(|settings| settings.frame_time_ratio = f32::NAN), Some(301));
        assert_eq!(refused(|settings| settings.score_threshold = 1.1), Some(301));
        assert_eq!(refused(|settings| settings.outlier_filter = 200), Some(301));
        assert_eq!(refused(|settings| settings.pre_filtering = 10), Some(301));
        assert_eq!(refused(|settings| settings.working_volume = 2), Some(301));
        assert_eq!(refused(|settings| settings.roi_px[0] = 1448), Some(301));
        assert_eq!(refused(|settings| settings.roi_px = [84, 4, 0, 0, 0, 0]), Some(302));
        assert_eq!(refused(|settings| settings.components = 0b00101), Some(301));
        assert_eq!(refused(|settings| settings.components = 0b10100), Some(301));
        assert_eq!(refused(|settings| settings.components = 0b10111), Some(307));
        let flat = VolumeOfInterest {
            min_mm: [0.0; 3],
            max_mm: [1.0, 1.0, 0.0],
        };
        assert_eq!(refused(|settings| settings.volume_of_interest = Some(flat)), Some(301));
    }

    #[test]
    fn size_and_time_follow_the_settings() {
        let caps = caps();
        assert_eq!(size_px(&PAGE_SETTINGS, &caps), [720, 540]);
        assert_eq!(frame_bytes(&PAGE_SETTINGS, &caps), 5_443_200);
        assert_eq!(exposure_us(&PAGE_SETTINGS), 158_000);
        let slow = CameraSettings {
            exposure_us: 50_000,
            image_count: 60,
            frame_time_ratio: 4.0,
            hdr_us: [50_000, 50_000],
            ..PAGE_SETTINGS
        };
        assert_eq!((pass_count(&slow), exposure_us(&slow)), (3, 36_050_000));
    }
}
