//! Pixels that mix what lies on both sides of a silhouette (camera sheet 4.2 step 8; all numbers *assumed*).

use super::super::frame::TOUCHED_SILHOUETTE;
use super::{Picture, Place, Touch};
use crate::draws::{Purpose, generator, uniform};
use rayon::prelude::*;

pub(super) fn touches(picture: &Picture<'_>) -> Vec<Touch> {
    let rows: Vec<Vec<Touch>> = (0..picture.height_px)
        .into_par_iter()
        .map(|y| row(picture, y))
        .collect();
    rows.concat()
}

fn row(picture: &Picture<'_>, y: usize) -> Vec<Touch> {
    let (draws, window) = (picture.shot.draws, picture.shot.window);
    let sensor_row = (window.y_px[0] + y) as u64;
    let mut rng = generator(draws.seed, Purpose::Silhouettes, draws.trigger_id, sensor_row);
    let mut found = Vec::new();
    for column in 0..window.x_px[1] {
        let drawn = [(); 3].map(|()| uniform(&mut rng));
        let touch = column
            .checked_sub(window.x_px[0])
            .and_then(|x| touch(picture, x, y, drawn));
        found.extend(touch);
    }
    found
}

fn touch(picture: &Picture<'_>, x: usize, y: usize, [fate, far, share]: [f64; 3]) -> Option<Touch> {
    let site = &picture.sites[picture.index(x, y)];
    if !site.is_valid() {
        return None;
    }
    let edges =
        [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|step| edge(picture, site.depth_mm, [x as isize, y as isize], step));
    let nearest = edges.iter().flatten().min_by_key(|edge| edge.distance_px)?;
    let spans = [[edges[0], edges[1]], [edges[2], edges[3]]];
    let is_thin = spans.iter().any(|span| match span {
        [Some(a), Some(b)] => a.distance_px + b.distance_px - 1 <= THIN_PX,
        _ => false,
    });
    let displaced = |depth_mm: f64| Touch {
        index: picture.index(x, y),
        displacement_mm: depth_mm * picture.slant(x, y),
        is_lost: false,
        bit: TOUCHED_SILHOUETTE,
    };
    let lost = Touch {
        is_lost: true,
        ..displaced(0.0)
    };
    if is_thin {
        let rounded = displaced(share * picture.shot.pixel_mm(site.depth_mm));
        return Some(if fate < THIN_LOST { lost } else { rounded });
    }
    if nearest.distance_px == REACH_PX && far >= FAR_SHARE {
        return None;
    }
    // Against empty space the pixel drifts back, up to what just counts as another surface.
    let behind_mm = picture.jump_mm(site.depth_mm);
    let apart_mm = nearest.beyond_mm.map_or(behind_mm, |depth_mm| depth_mm - site.depth_mm);
    if fate < FLYING {
        Some(displaced(share * apart_mm))
    } else {
        (fate < FLYING + LOST).then_some(lost)
    }
}

/// Where the surface of a pixel ends.
#[derive(Debug, Clone, Copy)]
struct Edge {
    /// 1 if the neighbour is already another surface.
    distance_px: isize,
    /// Depth of that surface; none where there is nothing.
    beyond_mm: Option<f64>,
}

/// The end of the surface of depth `depth_mm` in one direction; none within reach, or before the grid ends.
fn edge(
    picture: &Picture<'_>,
    mut depth_mm: f64,
    [x, y]: [isize; 2],
    (step_x, step_y): (isize, isize),
) -> Option<Edge> {
    let jump_mm = picture.jump_mm(depth_mm);
    for distance_px in 1..=REACH_PX {
        let beyond_mm = match picture.place(x + step_x * distance_px, y + step_y * distance_px) {
            Place::Unknown => return None,
            Place::Surface(next_mm) if (next_mm - depth_mm).abs() <= jump_mm => {
                depth_mm = next_mm;
                continue;
            }
            Place::Surface(beyond_mm) => Some(beyond_mm),
            Place::Empty => None,
        };
        return Some(Edge { distance_px, beyond_mm });
    }
    None
}

/// How far a silhouette reaches.
const REACH_PX: isize = 2;
/// Share of the pixels at that distance that it touches.
const FAR_SHARE: f64 = 0.5;
/// Share of the touched pixels that fly between the surfaces.
const FLYING: f64 = 0.3;
/// Share of the touched pixels that are lost; the rest stay.
const LOST: f64 = 0.5;
/// What is no wider is mostly lost, and else rounded by up to the spacing.
const THIN_PX: isize = 2;
/// Share of the pixels of something thin that are lost.
const THIN_LOST: f64 = 0.8;
