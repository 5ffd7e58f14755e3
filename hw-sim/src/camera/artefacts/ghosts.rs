//! Ghosts: patches that light of a second bounce shifts along the ray (camera sheet 4.2 step 9). The phenomenon is *sourced*, its numbers
//! are *assumed*.
//!
//! A ghost grows where a mirrored ray meets the blade again close by: in fillets, between platform and airfoil.

use super::super::frame::TOUCHED_GHOST;
use super::super::site::Site;
use super::{Picture, Touch};
use crate::draws::{Purpose, generator, uniform};
use std::collections::VecDeque;

pub(super) fn touches(picture: &Picture<'_>) -> Vec<Touch> {
    let draws = picture.shot.draws;
    let is_concave = |site: &Site| site.is_valid() && site.mirrored_mm < CLOSE_MM;
    let mut free: Vec<bool> = picture.sites.iter().map(is_concave).collect();
    let candidates: Vec<usize> = (0..free.len()).filter(|&index| free[index]).collect();
    if candidates.is_empty() {
        return Vec::new();
    }
    let mut rng = generator(draws.seed, Purpose::Ghosts, draws.trigger_id, 0);
    let count = (uniform(&mut rng) * (COUNT_MAX + 1.0)).floor() as usize;
    let mut touches = Vec::new();
    for _ in 0..count {
        let [place, size, depth, side] = [(); 4].map(|()| uniform(&mut rng));
        let seed = candidates[(place * candidates.len() as f64) as usize];
        let size_px = SIZE_PX[0] * (SIZE_PX[1] / SIZE_PX[0]).powf(size);
        let size_mm = SHIFT_MM[0] + (SHIFT_MM[1] - SHIFT_MM[0]) * depth;
        let displacement_mm = if side < 0.5 { -size_mm } else { size_mm };
        let patch = patch(picture, &mut free, seed, size_px as usize);
        touches.extend(patch.into_iter().map(|index| Touch {
            index,
            displacement_mm,
            is_lost: false,
            bit: TOUCHED_GHOST,
        }));
    }
    touches
}

/// Up to `size_px` free pixels around `seed`, nearest steps first, which are free no more; none if they are fewer than a ghost has.
fn patch(picture: &Picture<'_>, free: &mut [bool], seed: usize, size_px: usize) -> Vec<usize> {
    let (mut patch, mut waiting) = (Vec::new(), VecDeque::new());
    if free[seed] {
        free[seed] = false;
        waiting.push_back(seed);
    }
    while let Some(index) = waiting.pop_front() {
        if patch.len() == size_px {
            // Left for another ghost.
            free[index] = true;
            continue;
        }
        patch.push(index);
        let (x, y) = (index % picture.width_px, index / picture.width_px);
        let neighbours = [
            (x > 0).then(|| index - 1),
            (x + 1 < picture.width_px).then(|| index + 1),
            (y > 0).then(|| index - picture.width_px),
            (y + 1 < picture.height_px).then(|| index + picture.width_px),
        ];
        for neighbour in neighbours.into_iter().flatten() {
            if free[neighbour] {
                free[neighbour] = false;
                waiting.push_back(neighbour);
            }
        }
    }
    if patch.len() < SIZE_PX[0] as usize {
        patch.clear();
    }
    patch
}

/// Most ghosts in a frame.
const COUNT_MAX: f64 = 3.0;
/// Least and greatest size.
const SIZE_PX: [f64; 2] = [20.0, 300.0];
/// Least and greatest displacement along the ray.
const SHIFT_MM: [f64; 2] = [0.5, 5.0];
/// A mirrored ray that meets the blade nearer than this is one of a concave place, mm.
const CLOSE_MM: f64 = 6.0;
