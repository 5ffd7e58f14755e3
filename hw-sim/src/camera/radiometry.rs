//! Brightness of a pixel in each pass of an exposure, and the score of its match (camera sheet 4.2 steps 3, 4 and 11).

use super::capture::{Capture, Compression};
use super::optics::Optics;
use super::surface::Finish;
use nalgebra::Vector3;

/// Directions at a surface point, each away from it; of unit length but for `projector_mm`.
pub(super) struct Directions {
    pub(super) normal: Vector3<f64>,
    /// To the projector, mm.
    pub(super) projector_mm: Vector3<f64>,
    pub(super) camera_1: Vector3<f64>,
    /// `None` where camera 2 takes no part.
    pub(super) camera_2: Option<Vector3<f64>>,
}

/// What all pixels of one frame share.
#[derive(Debug, Clone)]
pub(super) struct Exposure {
    /// Exposure times brightness of the LED, in those of the reference; the main pass first.
    gains: Vec<f64>,
    image_count: u32,
    full_scale: f64,
    curve: f64,
    nominal_mm: f64,
    finish: Finish,
    has_highlights: bool,
}

/// How well one pixel is exposed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Exposed {
    /// Brightness in the best pass, as a share of the full scale of 10 bits: the lesser of the two cameras'.
    pub(super) brightness: f64,
    /// That pass; the darkest where all are saturated.
    pub(super) pass: u8,
    /// Brightness in that pass over full scale, the greater of the two cameras': above 1 the pixel is saturated.
    pub(super) saturation: f64,
    /// Brightness of camera 1 in the main pass.
    pub(super) seen: f64,
    /// Images of the pattern sequence, 12 to 60.
    pub(super) image_count: u32,
}

impl Exposure {
    pub(super) fn new(capture: &Capture, optics: &Optics, finish: Finish, has_highlights: bool) -> Exposure {
        let (full_scale, curve) = match capture.compression {
            Compression::None | Compression::Low => (1.0, 0.0),
            Compression::Medium => (RANGE_OF_12_BITS, CURVE_MEDIUM),
            Compression::High => (RANGE_OF_12_BITS, CURVE_HIGH),
        };
        let led = f64::from(capture.led_percent) / LED_REFERENCE_PERCENT;
        Exposure {
            gains: capture
                .passes_us()
                .map(|exposure_us| exposure_us / EXPOSURE_REFERENCE_US * led)
                .collect(),
            image_count: capture.image_count,
            full_scale,
            curve,
            nominal_mm: optics.nominal_mm,
            finish,
            has_highlights,
        }
    }

    /// The best pass of a lit pixel: the brightest in which neither camera is saturated.
    pub(super) fn of(&self, at: &Directions) -> Exposed {
        let distance_mm = at.projector_mm.norm();
        let falloff = (self.nominal_mm / distance_mm).powi(2);
        let cosine = at.normal.dot(&at.projector_mm) / distance_mm;
        let projector = at.projector_mm / distance_mm;
        let thrown_back = |camera: &Vector3<f64>| self.thrown_back(cosine, at.normal.angle(&(projector + camera)));
        let camera_1 = thrown_back(&at.camera_1);
        let camera_2 = at.camera_2.as_ref().map_or(camera_1, thrown_back);
        let brightness = |gain: f64, thrown_back: f64| BRIGHTNESS_REFERENCE * gain * falloff * thrown_back;
        let in_pass = |pass: usize| {
            let gain = self.gains[pass];
            Exposed {
                brightness: brightness(gain, camera_1.min(camera_2)),
                pass: pass as u8,
                saturation: brightness(gain, camera_1.max(camera_2)) / self.full_scale,
                seen: brightness(self.gains[0], camera_1),
                image_count: self.image_count,
            }
        };
        let better = |best: Exposed, other: Exposed| {
            let is_better = match (best.saturation > 1.0, other.saturation > 1.0) {
                (true, false) => true,
                (false, true) => false,
                (false, false) => other.brightness > best.brightness,
                (true, true) => other.brightness < best.brightness,
            };
            if is_better { other } else { best }
        };
        (1..self.gains.len()).map(in_pass).fold(in_pass(0), better)
    }

    /// Grey value of a brightness: the compression curve from 0 to full scale, 255 beyond.
    pub(super) fn grey(&self, brightness: f64) -> u8 {
        let share = brightness / self.full_scale;
        let curved = if self.curve > 0.0 {
            (self.curve * share).ln_1p() / self.curve.ln_1p()
        } else {
            share
        };
        (255.0 * curved).round().clamp(0.0, 255.0) as u8
    }

    /// Share of the light that goes to one camera: 1 for the matte reference that faces the projector. `offset_rad` lies
    /// between the normal and the middle of the rays to projector and camera.
    fn thrown_back(&self, cosine: f64, offset_rad: f64) -> f64 {
        let lobe = if self.has_highlights {
            (-(offset_rad / self.finish.lobe_rad).powi(2)).exp2()
        } else {
            0.0
        };
        self.finish.diffuse * (cosine + self.finish.specular_ratio * lobe)
    }
}

impl Exposed {
    /// Matching score, 0 to 1: `1 / (1 + (sigma / modulation)^2)` (sheet 4.2 step 4), 0.85 at 3 % of full scale.
    /// `bounced` is the brightness of other light in that pass, which no pattern of this place modulates.
    pub(super) fn score(&self, bounced: f64) -> f64 {
        let sigma = BRIGHTNESS_SIGMA * (IMAGE_COUNT_REFERENCE / f64::from(self.image_count)).sqrt();
        1.0 / (1.0 + (sigma.hypot(bounced) / self.brightness).powi(2))
    }

    /// The score as it is delivered: where full scale cuts the pattern, the rest of the modulation counts.
    pub(super) fn confidence(&self, score: f64) -> u8 {
        let left = self.saturation.max(1.0).powi(-2);
        (255.0 * score * left).round() as u8
    }
}

/// Images per frame for which noise and score are stated, *sourced* (the device's default).
pub(super) const IMAGE_COUNT_REFERENCE: f64 = 24.0;
/// Exposure (the device's default, *sourced*) at which a matte surface at the nominal distance, facing the projector,
/// has the reference brightness (*assumed*).
const EXPOSURE_REFERENCE_US: f64 = 1000.0;
/// Share of full scale, *assumed*.
pub(super) const BRIGHTNESS_REFERENCE: f64 = 0.6;
/// Brightness of the LED for which this holds: the most that needs no pauses (*sourced*; that it is the reference is *assumed*).
const LED_REFERENCE_PERCENT: f64 = 25.0;
/// Noise of the brightness, share of full scale: gives a score of 0.85 at 3 % of full scale. *Assumed*.
const BRIGHTNESS_SIGMA: f64 = 0.0126;
/// 12 bits over 10: the medium and high compression need about four times the exposure to use the range, *sourced*.
const RANGE_OF_12_BITS: f64 = 4.0;
/// k of the grey value's curve `ln(1 + k x) / ln(1 + k)`. *Assumed*.
const CURVE_MEDIUM: f64 = 3.0;
/// The same for high. *Assumed*.
const CURVE_HIGH: f64 = 15.0;

#[cfg(test)]
mod tests {
    use super::super::surface::Surface;
    use super::*;

    fn facing(offset_rad: f64) -> Directions {
        let z = Vector3::z();
        Directions {
            normal: nalgebra::Rotation3::new(Vector3::x() * offset_rad) * z,
            projector_mm: z * 280.0,
            camera_1: z,
            camera_2: Some(z),
        }
    }

    fn exposure(capture: &Capture) -> Exposure {
        Exposure::new(capture, &Optics::fine(), Surface::polished().finish, true)
    }

    #[test]
    fn the_highlight_is_half_gone_at_the_half_width_and_the_diffuse_part_stays() {
        let finish = Surface::polished().finish;
        let at = |offset_rad: f64| exposure(&Capture::default()).of(&facing(offset_rad)).seen / BRIGHTNESS_REFERENCE;
        let specular = finish.diffuse * finish.specular_ratio;
        assert!((at(0.0) - finish.diffuse - specular).abs() < 1e-12);
        let half = at(finish.lobe_rad) - finish.diffuse * finish.lobe_rad.cos();
        assert!((half / specular - 0.5).abs() < 1e-9, "{half}");
        assert!((at(1.0) - finish.diffuse * 1_f64.cos()).abs() < 1e-6);
    }

    #[test]
    fn the_brightest_unsaturated_pass_is_taken() {
        let capture = Capture {
            hdr_us: [200, 2500],
            ..Capture::default()
        };
        let exposed = |offset_rad: f64| exposure(&capture).of(&facing(offset_rad));
        // On the highlight only the dark pass stays below full scale, far from it the bright one is best.
        let (bright, dark) = (exposed(0.0), exposed(1.0));
        assert_eq!((bright.pass, dark.pass), (1, 2));
        assert!(bright.saturation < 1.0 && bright.seen > 1.0, "{bright:?}");
        assert!((dark.brightness / dark.seen - 2.5).abs() < 1e-9);
        let single = exposure(&Capture::default()).of(&facing(0.0));
        assert!(single.saturation > 1.0 && single.pass == 0);
    }

    #[test]
    fn twelve_bits_reach_four_times_as_far_and_the_curve_spreads_the_dark_end() {
        let with = |compression| {
            exposure(&Capture {
                compression,
                ..Capture::default()
            })
        };
        let (low, high) = (with(Compression::Low), with(Compression::High));
        assert!((low.of(&facing(0.0)).saturation / high.of(&facing(0.0)).saturation - 4.0).abs() < 1e-12);
        assert_eq!((low.grey(0.5), low.grey(1.01), high.grey(4.01)), (128, 255, 255));
        assert!(high.grey(0.5) > 90, "{}", high.grey(0.5));
    }

    #[test]
    fn the_score_meets_its_default_threshold_at_three_percent_of_full_scale() {
        let score = |brightness, bounced| {
            Exposed {
                brightness,
                pass: 0,
                saturation: brightness,
                seen: brightness,
                image_count: 24,
            }
            .score(bounced)
        };
        assert!((score(0.03, 0.0) - 0.85).abs() < 0.001, "{}", score(0.03, 0.0));
        assert!(score(0.6, 0.0) > 0.999 && score(0.0, 0.0) == 0.0);
        assert!(
            (score(0.6, 0.6 * 0.42) - 0.85).abs() < 0.001,
            "{}",
            score(0.6, 0.6 * 0.42)
        );
    }

    #[test]
    fn camera_2_alone_can_saturate_a_pixel() {
        let mut at = facing(0.5);
        at.camera_2 = Some(nalgebra::Rotation3::new(Vector3::x()) * Vector3::z());
        let exposed = exposure(&Capture::default()).of(&at);
        assert!(exposed.seen < 1.0 && exposed.saturation > 1.0, "{exposed:?}");
    }
}
