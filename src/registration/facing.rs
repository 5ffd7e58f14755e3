//! Which side of its surface a single view was seen from, when nobody says.
//!
//! A view hides nothing of itself from its own camera: along the line of sight it is one layer. That gives the direction
//! but for its sign; and what is seen of a solid bulges towards the camera, most of all where it turns away at its rims,
//! which gives the sign. With it the two faces of a thin wall, which fit each other but for the sign of their normals,
//! cannot be taken for one another.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::geometry::nearest::NearestPoints;
use crate::geometry::sampling::even_indices;

/// The unit direction from the surface towards the camera; `None` when the points are not one layer from anywhere (a
/// whole part, several views) or do not tell the near side from the far one. Normals may have any sign.
pub(super) fn towards_camera(points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let indices = even_indices(points.len().min(normals.len()), SAMPLE_COUNT);
    let points: Vec<Point3<f64>> = indices.iter().map(|&index| points[index]).collect();
    let normals: Vec<Vector3<f64>> = indices.iter().map(|&index| normals[index]).collect();
    let tree = NearestPoints::new(&points);
    let neighbours: Vec<Vec<usize>> = points
        .par_iter()
        .map(|point| {
            let found = tree.nearest_many(point, NEIGHBOUR_COUNT + 1);
            found.into_iter().map(|found| found.index).collect()
        })
        .collect();
    let mut distances: Vec<f64> = neighbours
        .iter()
        .zip(&points)
        .filter_map(|(near, point)| near.last().map(|&last| (points[last] - point).norm()))
        .collect();
    distances.sort_by(f64::total_cmp);
    let cell = *distances.get(distances.len() / 2)?;
    if cell <= 0.0 {
        return None;
    }

    let layered: Vec<(f64, Vector3<f64>)> = half_sphere()
        .into_par_iter()
        .map(|direction| (hidden_fraction(&points, &direction, cell), direction))
        .collect();
    let least = layered.iter().map(|(hidden, _)| *hidden).fold(f64::INFINITY, f64::min);
    if least > HIDDEN_MAX {
        return None;
    }
    let facing = |direction: &Vector3<f64>| normals.iter().map(|normal| normal.dot(direction).abs()).sum::<f64>();
    let (_, axis) = layered
        .iter()
        .filter(|(hidden, _)| *hidden <= least + HIDDEN_TIE)
        .map(|(_, direction)| (facing(direction), *direction))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;

    let (mut bulge, mut bent) = (0.0, 0.0);
    for (index, near) in neighbours.iter().enumerate() {
        for &other in near {
            let (here, there) = (signed(&normals[index], &axis), signed(&normals[other], &axis));
            if here.dot(&there) > 0.0 {
                let share = (points[other] - points[index]).dot(&(there - here));
                bulge += share;
                bent += share.abs();
            }
        }
    }
    (bulge.abs() > BULGE_MIN_FRACTION * bent).then(|| axis * bulge.signum())
}

/// `normal` or its opposite, whichever faces `direction`.
pub(super) fn signed(normal: &Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    if normal.dot(direction) < 0.0 { -normal } else { *normal }
}

/// The share of the points that lie clearly behind another one along `direction`.
fn hidden_fraction(points: &[Point3<f64>], direction: &Vector3<f64>, cell: f64) -> f64 {
    let helper = if direction.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let right = direction.cross(&helper).normalize();
    let up = direction.cross(&right);
    let project = |point: &Point3<f64>| (point.coords.dot(&right), point.coords.dot(&up));
    let (mut low, mut high) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
    for (u, v) in points.iter().map(project) {
        low = (low.0.min(u), low.1.min(v));
        high = (high.0.max(u), high.1.max(v));
    }
    let cell = cell.max((high.0 - low.0).max(high.1 - low.1) / CELL_MAX_COUNT as f64);
    let columns = ((high.0 - low.0) / cell) as usize + 1;
    let rows = ((high.1 - low.1) / cell) as usize + 1;
    let place = |point: &Point3<f64>| {
        let (u, v) = project(point);
        ((v - low.1) / cell) as usize * columns + ((u - low.0) / cell) as usize
    };
    let mut nearest = vec![f64::NEG_INFINITY; rows * columns];
    for point in points {
        let slot = &mut nearest[place(point)];
        *slot = slot.max(point.coords.dot(direction));
    }
    let hidden = points
        .iter()
        .filter(|point| nearest[place(point)] - point.coords.dot(direction) > HIDDEN_CELLS * cell)
        .count();
    hidden as f64 / points.len().max(1) as f64
}

/// Directions spread over a half sphere.
fn half_sphere() -> Vec<Vector3<f64>> {
    (0..DIRECTION_COUNT)
        .map(|index| {
            let z = (f64::from(index) + 0.5) / f64::from(DIRECTION_COUNT);
            let around = GOLDEN_RAD * f64::from(index);
            let radius = (1.0 - z * z).sqrt();
            Vector3::new(radius * around.cos(), radius * around.sin(), z)
        })
        .collect()
}

const SAMPLE_COUNT: usize = 3000;
const NEIGHBOUR_COUNT: usize = 8;
const DIRECTION_COUNT: u32 = 120;
const GOLDEN_RAD: f64 = 2.399_963_229_728_653;
const CELL_MAX_COUNT: usize = 400;
/// A point this many cells behind another in its cell is hidden by it.
const HIDDEN_CELLS: f64 = 4.0;
/// With a larger share of hidden points the cloud is not one view.
const HIDDEN_MAX: f64 = 0.02;
/// Shares nearer to each other than this are the same.
const HIDDEN_TIE: f64 = 0.005;
/// The least surplus of bulges over hollows that tells the near side.
const BULGE_MIN_FRACTION: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::extruded;

    #[test]
    fn one_side_of_a_bar_tells_its_camera_and_the_whole_does_not() {
        let whole = extruded(6000, 0.0);
        let normals = whole.normals().unwrap();
        assert_eq!(towards_camera(whole.points(), normals), None);
        for sign in [1.0, -1.0] {
            let camera = Vector3::new(0.2, sign, 0.1).normalize();
            let seen: Vec<usize> = (0..whole.len()).filter(|&i| normals[i].dot(&camera) > 0.1).collect();
            let view = whole.select(&seen);
            let found = towards_camera(view.points(), view.normals().unwrap());
            assert!(found.is_some_and(|found| found.dot(&camera) > 0.5), "{sign}: {found:?}");
        }
    }
}
