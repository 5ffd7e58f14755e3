//! Frames that fail their own check, and the exposures with which their views are taken again.

use super::Session;
use crate::camera::{CameraSettings, Capture, code};
use crate::settings::RetakeReason;

impl Session {
    /// What is wrong with a frame that has come. A saturated one is only a reason to take its view again: the last is used
    /// if it has points enough.
    pub(super) fn shortcoming(&self, capture: &Capture) -> Option<(RetakeReason, String)> {
        let attempt = self.awaited.map_or(0, |standing| standing.target.attempt);
        let retakes = &self.wanted.retakes;
        let saturated = saturated_fraction(capture.valid_count, capture.saturated_count);
        if saturated > retakes.saturated_max_fraction && retakes.wants(RetakeReason::Saturated, attempt) {
            let seen = format!(
                "{saturated:.3} of its lit pixels are saturated, at most {:.3} wanted",
                retakes.saturated_max_fraction
            );
            return Some((RetakeReason::Saturated, seen));
        }
        let (found, wanted) = (capture.valid_count, self.wanted.points_min);
        (found < wanted).then(|| {
            let seen = format!("{found} valid points, at least {wanted} wanted");
            (RetakeReason::FewPoints, seen)
        })
    }

    /// What a failed acquisition means for the recipe. A camera that looks at its frames itself may say what is wrong with
    /// one; without a word of the recipe about that, it gave no frame.
    pub(super) fn why(&self, code: Option<u16>) -> RetakeReason {
        let said = match code {
            Some(code::TOO_FEW_POINTS) => RetakeReason::FewPoints,
            Some(code::SATURATED) => RetakeReason::Saturated,
            _ => RetakeReason::NoFrame,
        };
        if self.wanted.retakes.reasons.contains(&said) {
            said
        } else {
            RetakeReason::NoFrame
        }
    }

    /// The exposures of a view that is taken again, if why it is asks for others.
    pub(super) fn change_exposures(&mut self, view_index: usize, why: RetakeReason) {
        let factor = match why {
            RetakeReason::FewPoints => self.wanted.retakes.exposure_factor,
            RetakeReason::Saturated => 1.0 / self.wanted.retakes.exposure_factor,
            _ => return,
        };
        let before = self.view_settings[view_index];
        let after = exposed(before, factor, self.exposure_range_us);
        self.view_settings[view_index] = after;
        if after != before {
            let (before_us, after_us) = (before.exposure_us, after.exposure_us);
            self.note(format!(
                "view {view_index}: exposure {after_us} us instead of {before_us} us"
            ));
        }
    }
}

/// The saturated among the lit pixels, 0 to 1; 0 when none is lit.
fn saturated_fraction(valid_count: u32, saturated_count: u32) -> f64 {
    match u64::from(valid_count) + u64::from(saturated_count) {
        0 => 0.0,
        lit_count => f64::from(saturated_count) / lit_count as f64,
    }
}

/// The settings with the exposures of all passes times `factor`, within the range; a pass that is off stays off.
fn exposed(settings: CameraSettings, factor: f64, [min_us, max_us]: [u32; 2]) -> CameraSettings {
    let times = |us: u32| ((f64::from(us) * factor).round() as u32).max(min_us).min(max_us);
    CameraSettings {
        exposure_us: times(settings.exposure_us),
        hdr_us: settings.hdr_us.map(|us| if us == 0 { 0 } else { times(us) }),
        ..settings
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::camera_settings;
    use crate::settings::Recipe;

    #[test]
    fn every_pass_that_is_on_is_exposed_longer_or_shorter_within_the_range() {
        let text = "name = \"probe\"\nblade.cad = \"builtin:lpt\"\nmerge.overlap_min_fraction = 0.5\n\
                    presentation = { position_mm = [10, -5, 600], rotation_deg = [0, 90, 0] }\n\
                    [camera]\nexposure_us = 1000\nhdr_high_us = 4000\n";
        let settings = camera_settings(&Recipe::parse("probe.toml", text).unwrap(), 0);
        let passes = |factor| {
            let changed = exposed(settings, factor, [10, 6000]);
            [changed.exposure_us, changed.hdr_us[0], changed.hdr_us[1]]
        };
        assert_eq!(passes(1.5), [1500, 0, 6000]);
        assert_eq!(passes(4.0), [4000, 0, 6000]);
        assert_eq!(passes(0.5), [500, 0, 2000]);
        assert_eq!(passes(0.001), [10, 0, 10]);
    }

    #[test]
    fn the_share_of_saturated_pixels_is_of_the_lit_ones() {
        assert_eq!(saturated_fraction(300, 100), 0.25);
        assert_eq!((saturated_fraction(0, 5), saturated_fraction(0, 0)), (1.0, 0.0));
    }
}
