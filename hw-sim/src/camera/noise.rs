//! What a measured point differs by from the true one, and which points are missing (camera sheet 4.2).

use super::optics::Optics;
use super::radiometry::{BRIGHTNESS_REFERENCE, Exposed, IMAGE_COUNT_REFERENCE};
use crate::draws::{Draws, Purpose, generator, normal_pair, uniform};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the surface answers to the projected light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceNoise {
    /// Depth noise at nominal distance as a share of the point spacing; 0 for none. Sheet: 0.19 to 0.36, *sourced*.
    pub depth_fraction: f64,
    /// Least depth noise, mm; only where `depth_fraction` is not 0. *Assumed*.
    pub depth_floor_mm: f64,
    /// Noise across the ray, standard deviation per axis, as a share of the point spacing. *Assumed*.
    pub lateral_fraction: f64,
    /// Standard deviation of the Gaussian that correlates the depth noise of neighbouring pixels at pre-filtering 3; 0 for
    /// white noise at any. Sheet: 0.5 to 1.0. *Assumed*.
    pub correlation_px: f64,
    /// Angle between normal and camera ray up to which every pixel is valid. *Assumed*.
    pub incidence_full_rad: f64,
    /// Angle from which no pixel is valid; linear in between. *Assumed* (75° in other simulators).
    pub incidence_none_rad: f64,
    /// Share of the pixels lost in compact holes of 1 to 4 pixels radius, 0 to 0.5. *Assumed*.
    pub dropout_fraction: f64,
    /// How far, as a standard deviation, the fate of pixels at a grazing angle stays alike; 0 for each by itself. *Assumed*.
    #[serde(default)]
    pub roll_off_px: f64,
}

impl SurfaceNoise {
    /// A sprayed or blasted surface: 99 % or more of the pixels in view are valid.
    pub fn matte() -> SurfaceNoise {
        SurfaceNoise {
            depth_fraction: 0.25,
            depth_floor_mm: 0.005,
            lateral_fraction: 0.1,
            correlation_px: 0.6,
            incidence_full_rad: 60_f64.to_radians(),
            incidence_none_rad: 78_f64.to_radians(),
            dropout_fraction: 0.004,
            roll_off_px: 0.0,
        }
    }

    /// No noise and no holes; only geometry and the range limit what is seen.
    pub fn none() -> SurfaceNoise {
        SurfaceNoise {
            depth_fraction: 0.0,
            depth_floor_mm: 0.0,
            lateral_fraction: 0.0,
            correlation_px: 0.0,
            incidence_full_rad: 90_f64.to_radians(),
            incidence_none_rad: 90_f64.to_radians(),
            dropout_fraction: 0.0,
            roll_off_px: 0.0,
        }
    }

    /// Standard deviation of the noise along the ray, mm (sheet 4.2 step 6).
    ///
    /// `fraction * p * (Z / Z0) * sqrt(24 / N) * sqrt(I_ref / max(I, I_min)) / cos(min(theta, 75°))`, with p the spacing
    /// of the *full* grid at Z: a binned pixel is twice as wide (p doubles) but averages four (the noise halves).
    pub(super) fn depth_sigma_mm(&self, optics: &Optics, depth_mm: f64, incidence_rad: f64, exposed: &Exposed) -> f64 {
        if self.depth_fraction == 0.0 {
            return 0.0;
        }
        let sigma_mm = self.depth_fraction
            * optics.spacing_mm(depth_mm)
            * (depth_mm / optics.nominal_mm)
            * (IMAGE_COUNT_REFERENCE / f64::from(exposed.image_count)).sqrt()
            * (BRIGHTNESS_REFERENCE / exposed.brightness.max(BRIGHTNESS_LEAST)).sqrt()
            / incidence_rad.min(INCIDENCE_CAP_RAD).cos();
        sigma_mm.max(self.depth_floor_mm)
    }

    /// Standard deviation of the Gaussian that correlates the depth noise: a tenth of a pixel more for each step of pre-filtering.
    pub(super) fn correlation_px(&self, pre_filtering: u8) -> f64 {
        if self.correlation_px == 0.0 {
            return 0.0;
        }
        let steps = f64::from(pre_filtering) - f64::from(PRE_FILTERING_REFERENCE);
        (self.correlation_px + CORRELATION_STEP_PX * steps).max(0.0)
    }

    /// Probability that a pixel at this incidence is valid (sheet 4.2 step 5).
    pub(super) fn valid_probability(&self, incidence_rad: f64) -> f64 {
        if incidence_rad <= self.incidence_full_rad {
            return 1.0;
        }
        let span_rad = self.incidence_none_rad - self.incidence_full_rad;
        (1.0 - (incidence_rad - self.incidence_full_rad) / span_rad).max(0.0)
    }
}

/// A rectangle of pixels of the delivered grid: first included, end excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) x_px: [usize; 2],
    pub(super) y_px: [usize; 2],
}

impl Window {
    pub(super) fn width_px(self) -> usize {
        self.x_px[1] - self.x_px[0]
    }
}

/// Normal noise of unit variance over a window, one vector a row, correlated by a Gaussian of `sigma_px`; 0 is white.
/// `part` 0 is the depth noise, others are for other terms.
pub(super) fn unit_field(window: Window, sigma_px: f64, draws: Draws, part: u64) -> Vec<Vec<f64>> {
    let reach = ((3.0 * sigma_px).ceil() as usize).max(KERNEL_REACH_LEAST);
    let kernel = kernel(sigma_px, reach);
    let width_px = window.width_px();
    // Row r of the field needs the white rows r to r + 2 * reach, counted with a margin of `reach` on every side.
    let smoothed_rows: Vec<Vec<f64>> = (window.y_px[0]..window.y_px[1] + 2 * reach)
        .into_par_iter()
        .map(|row| {
            let white = white_row(row, window.x_px[1] + 2 * reach, draws, part);
            let from = |x: usize| &white[window.x_px[0] + x..];
            (0..width_px)
                .map(|x| kernel.iter().zip(from(x)).map(|(weight, value)| weight * value).sum())
                .collect()
        })
        .collect();
    (0..window.y_px[1] - window.y_px[0])
        .into_par_iter()
        .map(|row| {
            let rows = &smoothed_rows[row..];
            (0..width_px)
                .map(|x| {
                    kernel
                        .iter()
                        .zip(rows)
                        .map(|(weight, smoothed)| weight * smoothed[x])
                        .sum()
                })
                .collect()
        })
        .collect()
}

/// Share of the normal distribution below a value, to within 0.0004 (Page, 1977).
pub(super) fn share_below(value: f64) -> f64 {
    0.5 * (1.0 + (0.797_885 * (value + 0.044_715 * value.powi(3))).tanh())
}

/// Pixels lost in compact holes: row-major flags over the window.
pub(super) fn holes(window: Window, dropout_fraction: f64, draws: Draws) -> Vec<bool> {
    let (width_px, height_px) = (window.width_px(), window.y_px[1] - window.y_px[0]);
    let mut lost = vec![false; width_px * height_px];
    // Holes overlap: a density d of hole area leaves exp(-d) of the pixels.
    let hole_area_fraction = -(1.0 - dropout_fraction.min(0.5)).ln();
    let mean_count = hole_area_fraction * (CELL_PX * CELL_PX) as f64 / HOLE_AREA_PX;
    let cells = |[first, end]: [usize; 2]| first / CELL_PX..(end + CELL_PX) / CELL_PX + 1;
    // Cells are numbered from one beyond the window's upper left, whence holes may reach in.
    for cell_y in cells(window.y_px) {
        for cell_x in cells(window.x_px) {
            let mut rng = generator(
                draws.seed,
                Purpose::Holes,
                draws.trigger_id,
                (cell_y as u64) << 32 | cell_x as u64,
            );
            let count = (mean_count + uniform(&mut rng)).floor() as usize;
            for _ in 0..count {
                let [x_px, y_px] =
                    [cell_x, cell_y].map(|cell| (cell as f64 - 1.0 + uniform(&mut rng)) * CELL_PX as f64);
                let radius_px = HOLE_RADIUS_PX[0] + (HOLE_RADIUS_PX[1] - HOLE_RADIUS_PX[0]) * uniform(&mut rng);
                punch(&mut lost, window, [x_px, y_px], radius_px);
            }
        }
    }
    lost
}

fn punch(lost: &mut [bool], window: Window, [x_px, y_px]: [f64; 2], radius_px: f64) {
    let span = |centre_px: f64, [first, end]: [usize; 2]| {
        let low = (centre_px - radius_px).ceil().max(first as f64) as usize;
        let high = (centre_px + radius_px).floor().max(-1.0) + 1.0;
        low..(high as usize).min(end)
    };
    for y in span(y_px, window.y_px) {
        for x in span(x_px, window.x_px) {
            if (x as f64 - x_px).powi(2) + (y as f64 - y_px).powi(2) <= radius_px * radius_px {
                lost[(y - window.y_px[0]) * window.width_px() + x - window.x_px[0]] = true;
            }
        }
    }
}

fn white_row(row: usize, width_px: usize, draws: Draws, part: u64) -> Vec<f64> {
    let mut rng = generator(draws.seed, Purpose::Depth, draws.trigger_id, part << 32 | row as u64);
    (0..width_px.div_ceil(2))
        .flat_map(|_| normal_pair(uniform(&mut rng), uniform(&mut rng)))
        .collect()
}

/// Gaussian weights whose squares sum to one, so that the variance of white noise is kept.
fn kernel(sigma_px: f64, reach: usize) -> Vec<f64> {
    let weight = |i: usize| {
        let offset_px = i as f64 - reach as f64;
        if sigma_px > 0.0 {
            (-0.5 * (offset_px / sigma_px).powi(2)).exp()
        } else if offset_px == 0.0 {
            1.0
        } else {
            0.0
        }
    };
    let weights: Vec<f64> = (0..=2 * reach).map(weight).collect();
    let norm = weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt();
    weights.into_iter().map(|weight| weight / norm).collect()
}

/// Brightness below which the noise grows no further; 3 % of full scale is where the score meets its default threshold. *Assumed*.
const BRIGHTNESS_LEAST: f64 = 0.03;
/// Incidence from which the noise grows no further, 75°. *Assumed*.
const INCIDENCE_CAP_RAD: f64 = 75.0 * std::f64::consts::PI / 180.0;
/// Least count of pixels on each side that the correlation of the noise reaches.
const KERNEL_REACH_LEAST: usize = 2;
/// Pre-filtering for which the correlation is stated, *sourced* (the device's default).
const PRE_FILTERING_REFERENCE: u8 = 3;
/// Correlation that a step of pre-filtering adds (sheet). *Assumed*.
const CORRELATION_STEP_PX: f64 = 0.1;
/// Side of the image cells that draw holes; larger than the greatest radius.
const CELL_PX: usize = 32;
/// Least and greatest radius of a hole, and the mean area: π (a² + ab + b²) / 3. *Assumed*.
const HOLE_RADIUS_PX: [f64; 2] = [1.0, 4.0];
const HOLE_AREA_PX: f64 = std::f64::consts::PI * 7.0;

#[cfg(test)]
mod tests {
    use super::*;

    const DRAWS: Draws = Draws {
        seed: 3,
        trigger_id: 17,
    };
    const WINDOW: Window = Window {
        x_px: [40, 640],
        y_px: [10, 410],
    };

    #[test]
    fn the_correlated_field_has_unit_variance_and_the_correlation_of_its_kernel() {
        let field = unit_field(WINDOW, 0.6, DRAWS, 0);
        let mean_product = |shift: usize| {
            let products = field
                .iter()
                .flat_map(|row| row.iter().zip(&row[shift..]).map(|(a, b)| a * b));
            products.sum::<f64>() / (field.len() * (WINDOW.width_px() - shift)) as f64
        };
        assert!((mean_product(0) - 1.0).abs() < 0.02, "{}", mean_product(0));
        // Weights 1, 0.2494, 0.0039 of a Gaussian of 0.6 px: (2 * 0.2494 + 2 * 0.2494 * 0.0039) / (1 + 2 * 0.2494^2).
        assert!((mean_product(1) - 0.445).abs() < 0.01, "{}", mean_product(1));
    }

    #[test]
    fn the_share_below_is_that_of_the_tables() {
        for (value, share) in [(0.0, 0.5), (1.0, 0.841_345), (-1.96, 0.024_998), (3.0, 0.998_65)] {
            assert!((share_below(value) - share).abs() < 4e-4, "{value}");
        }
    }

    #[test]
    fn the_field_does_not_depend_on_the_window() {
        let whole = unit_field(WINDOW, 0.6, DRAWS, 0);
        let part = unit_field(
            Window {
                x_px: [140, 150],
                y_px: [30, 33],
            },
            0.6,
            DRAWS,
            0,
        );
        assert_eq!(part[2][..], whole[22][100..110]);
    }

    #[test]
    fn holes_take_the_stated_share_of_the_pixels() {
        for fraction in [0.004, 0.05, 0.3] {
            let lost = holes(WINDOW, fraction, DRAWS);
            let share = lost.iter().filter(|&&lost| lost).count() as f64 / lost.len() as f64;
            assert!((share / fraction - 1.0).abs() < 0.15, "{share} of {fraction}");
        }
        assert!(!holes(WINDOW, 0.0, DRAWS).contains(&true));
    }

    #[test]
    fn the_sigma_is_the_sheets_example_at_nominal_distance() {
        let exposed = Exposed {
            brightness: 0.6,
            pass: 0,
            saturation: 0.6,
            seen: 0.6,
            image_count: 24,
        };
        for (optics, sigma_mm) in [
            (Optics::fine(), 0.010),
            (Optics::medium(), 0.050),
            (Optics::wide(), 0.1125),
        ] {
            let modelled = SurfaceNoise::matte().depth_sigma_mm(&optics, optics.nominal_mm, 0.0, &exposed);
            assert!((modelled - sigma_mm).abs() < 1e-9, "{modelled}");
        }
    }

    #[test]
    fn pre_filtering_correlates_further_and_keeps_the_variance() {
        let noise = SurfaceNoise::matte();
        assert_eq!(noise.correlation_px(3), 0.6);
        assert!((noise.correlation_px(9) - 1.2).abs() < 1e-12);
        assert_eq!(SurfaceNoise::none().correlation_px(9), 0.0);
        let field = unit_field(WINDOW, 1.2, DRAWS, 0);
        let values = field.iter().flatten();
        let variance = values.map(|value| value * value).sum::<f64>() / (600.0 * 400.0);
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
    }
}
