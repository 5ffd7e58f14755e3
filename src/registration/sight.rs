//! What a single view saw: along its lines of sight nothing stands before the surface that was measured, and nothing
//! stands where nothing was measured.
//!
//! Points of another view that are laid before the measured surface, or beside it, contradict what was seen. Points behind
//! it do not: they were hidden. The line of sight is the one along which the view is one layer, from a camera far away.

use nalgebra::{Isometry3, Point3, Vector3};

use super::facing::Camera;
use crate::geometry::normals::tangents;
use crate::geometry::sampling::even_indices;

/// A depth image of a single view.
pub(super) struct Sight {
    camera: Camera,
    right: Vector3<f64>,
    up: Vector3<f64>,
    low: [f64; 2],
    cell: f64,
    columns: usize,
    rows: usize,
    /// The greatest and the least depth towards the camera in each cell and those next to it; infinite where nothing is.
    nearest: Vec<f64>,
    farthest: Vec<f64>,
}

/// The shares of some points that contradict a view, if its normals face the camera and if they face away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contradiction {
    pub(super) facing: f64,
    pub(super) averted: f64,
    /// The share beyond the edge of the image: no contradiction if the camera did not look there.
    pub(super) beside: f64,
}

impl Sight {
    /// The camera, if the normals face it.
    pub(super) fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The image that `camera` took of the points; `spacing` is theirs.
    pub(super) fn new(points: &[Point3<f64>], camera: &Camera, spacing: f64) -> Self {
        let indices = even_indices(points.len(), IMAGE_COUNT);
        let thinned = (points.len() as f64 / indices.len().max(1) as f64).sqrt();
        let seen: Vec<Point3<f64>> = indices.into_iter().map(|index| points[index]).collect();
        Self::along(&seen, camera, CELL_SPACINGS * thinned * spacing)
    }

    fn along(points: &[Point3<f64>], camera: &Camera, cell: f64) -> Self {
        let towards = &camera.towards;
        let [right, up] = tangents(towards);
        let flat = |point: &Point3<f64>| [point.coords.dot(&right), point.coords.dot(&up)];
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for place in points.iter().map(flat) {
            for axis in 0..2 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
        }
        let extent = (high[0] - low[0]).max(high[1] - low[1]);
        let cell = cell.max(extent / CELL_MAX_COUNT as f64);
        // A margin all around, so that every point has cells next to its own.
        let low = low.map(|value| value - 1.5 * cell);
        let count = |axis: usize| ((high[axis] - low[axis]) / cell) as usize + 2;
        let (columns, rows) = (count(0), count(1));
        let mut sight = Self {
            camera: *camera,
            right,
            up,
            low,
            cell,
            columns,
            rows,
            nearest: vec![f64::NEG_INFINITY; columns * rows],
            farthest: vec![f64::INFINITY; columns * rows],
        };
        for point in points {
            let Some(place) = sight.place(point) else { continue };
            let depth = point.coords.dot(towards);
            for row in [place - columns, place, place + columns] {
                for near in row - 1..=row + 1 {
                    sight.nearest[near] = sight.nearest[near].max(depth);
                    sight.farthest[near] = sight.farthest[near].min(depth);
                }
            }
        }
        sight
    }

    fn place(&self, point: &Point3<f64>) -> Option<usize> {
        let column = (point.coords.dot(&self.right) - self.low[0]) / self.cell;
        let row = (point.coords.dot(&self.up) - self.low[1]) / self.cell;
        let inside = column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64;
        inside.then(|| row as usize * self.columns + column as usize)
    }

    /// How much of `points`, laid into this view's frame by `pose`, contradicts it.
    pub(super) fn contradiction(&self, points: &[Point3<f64>], pose: &Isometry3<f64>) -> Contradiction {
        let tolerance = DEPTH_CELLS * self.cell;
        let (mut facing, mut averted, mut beside) = (0, 0, 0);
        for point in points {
            let placed = pose * point;
            // Beyond the edge of the image the camera may not have looked.
            let Some(place) = self.place(&placed) else {
                beside += 1;
                continue;
            };
            if !self.nearest[place].is_finite() {
                facing += 1;
                averted += 1;
                continue;
            }
            let depth = placed.coords.dot(&self.camera.towards);
            facing += usize::from(depth > self.nearest[place] + tolerance);
            averted += usize::from(depth < self.farthest[place] - tolerance);
        }
        let share = |count: usize| count as f64 / points.len().max(1) as f64;
        Contradiction {
            facing: share(facing),
            averted: share(averted),
            beside: share(beside),
        }
    }
}

/// How many points make the image, and how many spacings of theirs a cell is wide.
const IMAGE_COUNT: usize = 3000;
const CELL_SPACINGS: f64 = 2.5;
const CELL_MAX_COUNT: usize = 400;
/// A point less than this many cells before the surface does not contradict it: surfaces slope and cameras are not far.
const DEPTH_CELLS: f64 = 2.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::facing::camera_of;
    use crate::registration::testing::extruded;

    #[test]
    fn what_stands_before_a_view_or_beside_it_contradicts_it_and_what_stands_behind_does_not() {
        let whole = extruded(9000, 0.0);
        let normals = whole.normals().unwrap();
        let seen: Vec<usize> = (0..whole.len()).filter(|&i| normals[i].y > 0.1).collect();
        let view = whole.select(&seen);
        let spacing = 0.02;
        let camera = camera_of(view.points(), view.normals().unwrap()).unwrap();
        assert!(camera.towards.y > 0.9, "{camera:?}");
        let sight = Sight::new(view.points(), &camera, spacing);
        let at = |y: f64| sight.contradiction(view.points(), &Isometry3::translation(0.0, y, 0.0));
        assert_eq!((at(0.0).facing, at(0.0).averted), (0.0, 0.0));
        assert!(at(0.5).facing > 0.8 && at(0.5).averted < 0.1);
        assert!(at(-0.5).facing < 0.1 && at(-0.5).averted > 0.8);
        let beside = sight.contradiction(view.points(), &Isometry3::translation(0.0, 0.0, 1.0));
        assert!((0.4..0.6).contains(&beside.beside), "{beside:?}");
        assert_eq!((beside.facing, beside.averted), (0.0, 0.0));
    }
}
