//! Ripple beside steps of the brightness: the contrast distortion of real cameras (camera sheet 4.2 step 7).
//!
//! A step is where the pass changes that is used, or saturation begins, or the brightness jumps. The bias follows the
//! baseline (rows), has the sign of the step there, and changes sign across it: *sourced*; its size is *assumed*.

use super::super::frame::TOUCHED_RIPPLE;
use super::super::noise::{share_below, unit_field};
use super::super::site::{Site, UNSEEN};
use super::{Picture, Touch};
use rayon::prelude::*;

pub(super) fn touches(picture: &Picture<'_>) -> Vec<Touch> {
    let field = unit_field(picture.shot.window, AMPLITUDE_PX, picture.shot.draws, PART_RIPPLE);
    let rows: Vec<Vec<Touch>> = (0..picture.height_px)
        .into_par_iter()
        .map(|y| row(picture, y, &field[y]))
        .collect();
    rows.concat()
}

fn row(picture: &Picture<'_>, y: usize, field: &[f64]) -> Vec<Touch> {
    let sites = &picture.sites[picture.index(0, y)..][..picture.width_px];
    let mut nearest: Vec<Option<(usize, f64)>> = vec![None; sites.len()];
    for x in 1..sites.len() {
        let Some(sign) = step(picture, &sites[x - 1], &sites[x]) else {
            continue;
        };
        for distance in 0..REACH_PX {
            // Behind the step, then ahead of it; of two equally near steps the first counts.
            let both = [(x.checked_sub(1 + distance), -sign), (Some(x + distance), sign)];
            for (place, sign) in both {
                let Some(entry) = place.and_then(|place| nearest.get_mut(place)) else {
                    continue;
                };
                if entry.is_none_or(|(other, _)| distance < other) {
                    *entry = Some((distance, sign));
                }
            }
        }
    }
    let touch = |(x, nearest): (usize, Option<(usize, f64)>)| {
        let (distance, sign) = nearest?;
        let site = &sites[x];
        let amplitude = SIGMAS[0] + (SIGMAS[1] - SIGMAS[0]) * share_below(field[x]);
        let decay = (-(distance as f64) / DECAY_PX).exp();
        site.is_valid().then(|| Touch {
            index: picture.index(x, y),
            displacement_mm: sign * amplitude * decay * site.sigma_mm,
            is_lost: false,
            bit: TOUCHED_RIPPLE,
        })
    };
    nearest.into_iter().enumerate().filter_map(touch).collect()
}

/// Whether two neighbours of one surface are parted by a step of the brightness: 1 where it rises along the row, -1 where it falls.
fn step(picture: &Picture<'_>, left: &Site, right: &Site) -> Option<f64> {
    let is_one_surface = (left.depth_mm - right.depth_mm).abs() <= picture.jump_mm(left.depth_mm);
    let are_exposed = left.pass != UNSEEN && right.pass != UNSEEN;
    let ratio = right.brightness / left.brightness;
    let is_step = left.pass != right.pass || !(1.0 / STEP_RATIO..=STEP_RATIO).contains(&ratio);
    (is_one_surface && are_exposed && is_step).then_some(if ratio >= 1.0 { 1.0 } else { -1.0 })
}

/// How far a step reaches (sheet: 3 to 5 px). *Assumed*.
const REACH_PX: usize = 4;
/// Over which distance the bias falls to 1/e. *Assumed*.
const DECAY_PX: f64 = 2.0;
/// Least and greatest bias beside the step, in standard deviations of the noise. *Assumed*.
const SIGMAS: [f64; 2] = [1.0, 3.0];
/// Ratio of neighbours' brightness that makes a step. *Assumed*.
const STEP_RATIO: f64 = 1.5;
/// How far the size of the bias stays alike along a step. *Assumed*.
const AMPLITUDE_PX: f64 = 3.0;
/// Which field of normal numbers it is.
const PART_RIPPLE: u64 = 2;
