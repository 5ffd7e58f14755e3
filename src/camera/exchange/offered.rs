//! What the run asks for, held against what the camera offers.

use crate::camera::message::Caps;
use crate::camera::settings::CameraSettings;

/// The first thing that this camera cannot do: key, asked, allowed.
pub(super) fn unmet(caps: &Caps, wanted: &CameraSettings) -> Option<String> {
    let [low_us, high_us] = wanted.hdr_us;
    for (key, asked, min, max, unit) in [
        (
            "exposure_us",
            wanted.exposure_us,
            caps.exposure_min_us,
            caps.exposure_max_us,
            " us",
        ),
        ("hdr_low_us", low_us, caps.exposure_min_us, caps.exposure_max_us, " us"),
        (
            "hdr_high_us",
            high_us,
            caps.exposure_min_us,
            caps.exposure_max_us,
            " us",
        ),
        (
            "image_count",
            u32::from(wanted.image_count),
            u32::from(caps.image_count_min),
            u32::from(caps.image_count_max),
            "",
        ),
        (
            "led_percent",
            u32::from(wanted.led_percent),
            1,
            u32::from(caps.led_max_percent),
            " %",
        ),
    ] {
        let off = key.starts_with("hdr") && asked == 0;
        if !off && !(min..=max).contains(&asked) {
            return Some(format!(
                "camera.{key} is {asked}{unit}, but this camera allows {min} to {max}{unit}"
            ));
        }
    }
    let pass_count = wanted.hdr_us.iter().filter(|&&pass_us| pass_us > 0).count();
    if pass_count > usize::from(caps.hdr_slot_count) {
        let slot_count = caps.hdr_slot_count;
        return Some(format!(
            "camera.hdr_low_us and hdr_high_us ask for {pass_count} more passes, but this camera has {slot_count}"
        ));
    }
    for (key, asked, offered) in [
        ("compression", wanted.compression, caps.compressions),
        ("outlier_filter", wanted.outlier_filter, caps.outlier_filters),
        ("working_volume", wanted.working_volume, caps.working_volumes),
    ] {
        if offered.checked_shr(u32::from(asked)).unwrap_or(0) & 1 == 0 {
            let allowed = values(offered);
            return Some(format!(
                "camera.{key} is number {asked}, but this camera allows {allowed}"
            ));
        }
    }
    if wanted.components & !caps.components != 0 {
        let (asked, offered) = (values(wanted.components), values(caps.components));
        return Some(format!(
            "components {asked} are needed, but this camera offers {offered}"
        ));
    }
    if wanted.binning {
        None
    } else {
        unmet_roi(caps, wanted.roi_px)
    }
}

fn unmet_roi(caps: &Caps, roi_px: [u16; 6]) -> Option<String> {
    let [width_px, height_px, ..] = roi_px;
    let [sensor_width_px, sensor_height_px] = caps.sensor_px;
    let inside = |place: usize, length_px: u16, sensor_px: u16| {
        u32::from(roi_px[place]) + u32::from(length_px) <= u32::from(sensor_px)
    };
    let fits = [2, 4].into_iter().all(|x| inside(x, width_px, sensor_width_px))
        && [3, 5].into_iter().all(|y| inside(y, height_px, sensor_height_px))
        && width_px >= caps.roi_min_px[0]
        && height_px >= caps.roi_min_px[1];
    let on_step = |length_px: u16, axis: usize| length_px.is_multiple_of(caps.roi_step_px[axis].max(1));
    let on_steps =
        [0, 2, 4].into_iter().all(|x| on_step(roi_px[x], 0)) && [1, 3, 5].into_iter().all(|y| on_step(roi_px[y], 1));
    let [min_width_px, min_height_px] = caps.roi_min_px;
    let [x_step_px, y_step_px] = caps.roi_step_px;
    (!(fits && on_steps)).then(|| {
        format!(
            "camera.roi_px is {width_px} x {height_px} px at {}, {}, but this camera allows {min_width_px} x {min_height_px} \
             to {sensor_width_px} x {sensor_height_px} px in steps of {x_step_px} x {y_step_px} px",
            roi_px[2], roi_px[3]
        )
    })
}

/// The numbers of the bits that are set.
fn values(bits: u32) -> String {
    let set: Vec<String> = (0..32)
        .filter(|bit| bits >> bit & 1 == 1)
        .map(|bit| bit.to_string())
        .collect();
    set.join(", ")
}
