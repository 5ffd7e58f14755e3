//! Artefacts that depend on a pixel's neighbours or on the whole frame (camera sheet 4.2 steps 7 to 10).

mod ghosts;
mod outliers;
mod ripple;
mod silhouettes;
mod systematic;

use super::capture::OutlierFilter;
use super::site::{Shot, Site};
use super::surface::Term;
pub(super) use systematic::Systematic;

/// What an artefact does to one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Touch {
    /// Index in the window, row by row.
    index: usize,
    /// Displacement along the ray, away from camera 1, mm.
    displacement_mm: f64,
    /// Whether the pixel is lost.
    is_lost: bool,
    /// Bit of the truth.
    bit: u8,
}

/// What all artefacts together do to one pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Change {
    pub(super) displacement_mm: f64,
    pub(super) is_lost: bool,
    pub(super) touched: u8,
}

/// The pixels of a window, with where they lie.
struct Picture<'a> {
    shot: &'a Shot<'a>,
    sites: &'a [Site],
    width_px: usize,
    height_px: usize,
}

/// One entry for each pixel of the window; empty when no artefact is on.
pub(super) fn changes(shot: &Shot<'_>, sites: &[Site], filter: OutlierFilter) -> Vec<Change> {
    let has = |term| shot.surface.terms.has(term);
    let picture = Picture {
        shot,
        sites,
        width_px: shot.window.width_px(),
        height_px: shot.window.y_px[1] - shot.window.y_px[0],
    };
    let mut touches = Vec::new();
    if has(Term::Ripple) {
        touches.extend(ripple::touches(&picture));
    }
    if has(Term::Silhouettes) {
        touches.extend(silhouettes::touches(&picture));
    }
    if has(Term::Ghosts) && shot.surface.finish.specular_ratio > GHOSTS_FROM_RATIO {
        touches.extend(ghosts::touches(&picture));
    }
    if has(Term::Outliers) {
        touches.extend(outliers::touches(&picture, filter));
    }
    if touches.is_empty() {
        return Vec::new();
    }
    let mut changes = vec![Change::default(); sites.len()];
    for touch in touches {
        let change = &mut changes[touch.index];
        change.displacement_mm += touch.displacement_mm;
        change.is_lost |= touch.is_lost;
        change.touched |= touch.bit;
    }
    changes
}

/// What the ray of a pixel meets.
enum Place {
    /// It is no pixel of the grid.
    Unknown,
    Empty,
    /// At this depth, mm.
    Surface(f64),
}

impl Picture<'_> {
    fn index(&self, x: usize, y: usize) -> usize {
        y * self.width_px + x
    }

    /// What is at a place that may lie beside the window, and even beside the grid.
    fn place(&self, x: isize, y: isize) -> Place {
        let window = self.shot.window;
        let column = window.x_px[0] as isize + x;
        let row = window.y_px[0] as isize + y;
        let grid = &self.shot.grid;
        if !(0..grid.width_px as isize).contains(&column) || !(0..grid.height_px as isize).contains(&row) {
            return Place::Unknown;
        }
        if !(0..self.width_px as isize).contains(&x) || !(0..self.height_px as isize).contains(&y) {
            return Place::Empty;
        }
        let depth_mm = self.sites[self.index(x as usize, y as usize)].depth_mm;
        if depth_mm.is_nan() {
            Place::Empty
        } else {
            Place::Surface(depth_mm)
        }
    }

    /// The least jump in depth that makes a silhouette: 3 mm, and ten times the spacing (sheet, *assumed*).
    fn jump_mm(&self, depth_mm: f64) -> f64 {
        (10.0 * self.shot.pixel_mm(depth_mm)).max(3.0)
    }

    /// Length of the ray for each millimetre of depth.
    fn slant(&self, x: usize, y: usize) -> f64 {
        let [first_x, first_y] = [self.shot.window.x_px[0], self.shot.window.y_px[0]];
        self.shot.ray(first_x + x, first_y + y).norm()
    }
}

/// k_s / k_d from which inter-reflections make ghosts (sheet, *assumed*).
const GHOSTS_FROM_RATIO: f64 = 2.0;
