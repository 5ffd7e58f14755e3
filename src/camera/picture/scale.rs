//! From depth to colour: even steps of depth are even steps of lightness.

use super::canvas::Rgb;

/// The depths between which colours run; what lies beyond has the colour of the end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DepthScale {
    near_mm: f64,
    far_mm: f64,
}

impl DepthScale {
    /// From the 0.5 % nearest to the 0.5 % farthest point, so that a few stray points do not flatten the picture.
    /// NaN is left out; 0 to 1 mm when nothing is left.
    pub(super) fn of(depths_mm: &[f32]) -> Self {
        let mut depths_mm: Vec<f32> = depths_mm.iter().copied().filter(|depth| !depth.is_nan()).collect();
        depths_mm.sort_by(f32::total_cmp);
        let Some(last) = depths_mm.len().checked_sub(1) else {
            return Self {
                near_mm: 0.0,
                far_mm: 1.0,
            };
        };
        let stray = depths_mm.len() / 200;
        let (near_mm, far_mm) = (f64::from(depths_mm[stray]), f64::from(depths_mm[last - stray]));
        Self {
            near_mm,
            far_mm: far_mm.max(near_mm + LEAST_SPAN_MM),
        }
    }

    /// 0 at the near end, 1 at the far end.
    pub(super) fn share(&self, depth_mm: f64) -> f64 {
        ((depth_mm - self.near_mm) / (self.far_mm - self.near_mm)).clamp(0.0, 1.0)
    }

    /// The depth at a share of the scale, in mm, with as many decimals as the span deserves.
    pub(super) fn label(&self, share: f64) -> String {
        let span_mm = self.far_mm - self.near_mm;
        let decimals = (2.0 - span_mm.log10().floor()).clamp(0.0, 3.0) as usize;
        format!("{:.decimals$}", self.near_mm + share * span_mm)
    }
}

/// A colour of even lightness steps, from a dark blue at 0 over green to a light yellow at 1.
///
/// A line in Oklab (B. Ottosson, "A perceptual color space for image processing", 2020): lightness rises with the share,
/// the hue turns along.
pub(super) fn depth_colour(share: f64) -> Rgb {
    let lightness = 0.28 + 0.66 * share;
    let hue_rad = (285.0 - 185.0 * share).to_radians();
    let chroma = 0.13;
    let (a, b) = (chroma * hue_rad.cos(), chroma * hue_rad.sin());
    let cube = |value: f64| value * value * value;
    let long = cube(lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b);
    let middle = cube(lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b);
    let short = cube(lightness - 0.089_484_177_5 * a - 1.291_485_548 * b);
    [
        4.076_741_662_1 * long - 3.307_711_591_3 * middle + 0.230_969_929_2 * short,
        -1.268_438_004_6 * long + 2.609_757_401_1 * middle - 0.341_319_396_5 * short,
        -0.004_196_086_3 * long - 0.703_418_614_7 * middle + 1.707_614_701 * short,
    ]
    .map(|linear| {
        let linear = linear.clamp(0.0, 1.0);
        let encoded = match linear <= 0.003_130_8 {
            true => 12.92 * linear,
            false => 1.055 * linear.powf(1.0 / 2.4) - 0.055,
        };
        (255.0 * encoded).round() as u8
    })
}

const LEAST_SPAN_MM: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lightness_rises_along_the_scale() {
        let luma = |share: f64| {
            let [red, green, blue] = depth_colour(share).map(f64::from);
            0.2126 * red + 0.7152 * green + 0.0722 * blue
        };
        for step in 0..50 {
            assert!(
                luma(f64::from(step + 1) / 50.0) > luma(f64::from(step) / 50.0),
                "step {step}"
            );
        }
    }

    #[test]
    fn a_stray_point_does_not_widen_the_scale() {
        let mut depths_mm = vec![300.0f32; 500];
        depths_mm.extend([310.0; 500]);
        depths_mm.extend([9000.0, f32::NAN]);
        let scale = DepthScale::of(&depths_mm);
        assert_eq!(
            (scale.share(300.0), scale.share(310.0), scale.share(9000.0)),
            (0.0, 1.0, 1.0)
        );
        assert_eq!([0.0, 0.5].map(|share| scale.label(share)), ["300.0", "305.0"]);
    }
}
