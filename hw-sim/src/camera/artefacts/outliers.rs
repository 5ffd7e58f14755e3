//! Isolated gross mismatches (camera sheet 4.2 step 9; all numbers *assumed*).

use super::super::capture::OutlierFilter;
use super::super::frame::TOUCHED_OUTLIER;
use super::{Picture, Touch};
use crate::draws::{Purpose, generator, uniform};
use rayon::prelude::*;

pub(super) fn touches(picture: &Picture<'_>, filter: OutlierFilter) -> Vec<Touch> {
    let rows: Vec<Vec<Touch>> = (0..picture.height_px)
        .into_par_iter()
        .map(|y| row(picture, y, share(filter)))
        .collect();
    rows.concat()
}

fn row(picture: &Picture<'_>, y: usize, share: f64) -> Vec<Touch> {
    let (draws, window) = (picture.shot.draws, picture.shot.window);
    let sensor_row = (window.y_px[0] + y) as u64;
    let mut rng = generator(draws.seed, Purpose::Outliers, draws.trigger_id, sensor_row);
    let mut found = Vec::new();
    for column in 0..window.x_px[1] {
        if uniform(&mut rng) >= share {
            continue;
        }
        let [size, side] = [(); 2].map(|()| uniform(&mut rng));
        let Some(x) = column.checked_sub(window.x_px[0]) else {
            continue;
        };
        let site = &picture.sites[picture.index(x, y)];
        let size_mm = site.sigma_mm * SIGMAS[0] * (SIGMAS[1] / SIGMAS[0]).powf(size);
        if site.is_valid() {
            found.push(Touch {
                index: picture.index(x, y),
                displacement_mm: if side < 0.5 { -size_mm } else { size_mm },
                is_lost: false,
                bit: TOUCHED_OUTLIER,
            });
        }
    }
    found
}

/// Share of the pixels that the filter leaves wrong.
fn share(filter: OutlierFilter) -> f64 {
    match filter {
        OutlierFilter::Disabled => 0.002,
        OutlierFilter::Permissive => 0.0005,
        OutlierFilter::Balanced => 0.0002,
        OutlierFilter::Strict => 0.0001,
    }
}

/// Least and greatest displacement in standard deviations of the noise, even on a logarithmic scale.
const SIGMAS: [f64; 2] = [15.0, 500.0];
