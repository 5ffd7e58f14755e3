//! Which way a single view was looked at, when nobody says.
//!
//! A view hides nothing of itself from its own camera: along the line of sight it is one layer, and nowhere does its
//! surface turn its back. The directions from which that holds surround the camera's, so their middle tells on which
//! side of its surface each point was seen, but for one sign for the whole view. What is seen of a solid bulges towards
//! the camera, most of all where it turns away at its rims: that gives the sign, though not always the right one.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::geometry::nearest::NearestPoints;
use crate::geometry::normals::tangents;
use crate::geometry::sampling::even_indices;
use crate::geometry::statistics::median;

/// What is known of the side from which a cloud was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Orientation {
    /// Its normals came with it and face the sensor.
    Given,
    /// It is a single view; its normals face this camera.
    View(Camera),
    /// Every sign of its normals is arbitrary.
    Unknown,
}

impl Orientation {
    pub(super) fn sides(&self) -> Sides {
        match self {
            Self::Given => Sides::Known,
            Self::View(_) => Sides::OneOfTwo,
            Self::Unknown => Sides::Unknown,
        }
    }

    /// The camera that the normals face; `None` when the points are no single view.
    pub(super) fn camera(&self, points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Option<Camera> {
        match self {
            Self::Given => camera_of(points, normals).map(|camera| camera.faced_by(normals)),
            Self::View(camera) => Some(*camera),
            Self::Unknown => None,
        }
    }
}

/// What the signs of the normals of a cloud, or of two compared ones, mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sides {
    /// Every normal faces the sensor.
    Known,
    /// All normals face the sensor, or all of them face away.
    OneOfTwo,
    /// Every sign is arbitrary.
    Unknown,
}

impl Sides {
    /// What a comparison of the normals of two clouds can rely on.
    pub(super) fn with(self, other: Self) -> Self {
        match (self, other) {
            (Self::Known, Self::Known) => Self::Known,
            (Self::Unknown, _) | (_, Self::Unknown) => Self::Unknown,
            _ => Self::OneOfTwo,
        }
    }
}

/// Where a single view was seen from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Camera {
    /// The unit direction from the surface towards the camera. Its line is surer than its sign.
    pub(super) towards: Vector3<f64>,
    /// How sure the sign is: the surplus of bulges over hollows as a share of both, 0 to 1.
    pub(super) bulge: f64,
}

impl Camera {
    /// On the side that most normals face, which need not be the side that the cloud bulges to.
    fn faced_by(self, normals: &[Vector3<f64>]) -> Self {
        let facing: f64 = normals.iter().map(|normal| normal.dot(&self.towards).signum()).sum();
        Self {
            towards: if facing < 0.0 { -self.towards } else { self.towards },
            ..self
        }
    }
}

/// Where the points were seen from; `None` when they are not one layer from anywhere (a whole part, several views).
/// Normals may have any sign.
pub(super) fn camera_of(points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Option<Camera> {
    let sheet = Sheet::new(points, normals)?;
    let costs: Vec<([f64; 2], Vector3<f64>)> = half_sphere()
        .into_par_iter()
        .map(|direction| {
            let folded = sheet.folded_fraction(&direction);
            let hidden = hidden_fractions(&sheet.points, &direction, sheet.cell);
            (hidden.map(|hidden| hidden + folded), direction)
        })
        .collect();
    if costs.iter().all(|([near, _], _)| *near > HIDDEN_MAX) {
        return None;
    }
    let costs = costs.into_iter().map(|([_, clearly], direction)| (clearly, direction));
    let costs: Vec<(f64, Vector3<f64>)> = costs.collect();
    let (least, best) = costs.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let middle: Vector3<f64> = costs
        .iter()
        .filter(|(cost, _)| *cost <= least + HIDDEN_TIE)
        .map(|(_, direction)| signed(direction, &best))
        .sum();
    let axis = middle.try_normalize(0.0)?;
    let bulge = sheet.bulge(&axis);
    Some(Camera {
        towards: axis * bulge.signum(),
        bulge: bulge.abs(),
    })
}

/// A sample of a cloud, and which of its points lie next to each other.
struct Sheet {
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    /// Pairs of neighbours.
    pairs: Vec<(u32, u32)>,
    folds: Vec<Fold>,
    /// The median distance to the last of the neighbours.
    cell: f64,
}

/// Two neighbours whose normals are far from square to each other: they nearly oppose each other, or would if one of them
/// were reversed.
struct Fold {
    a: u32,
    b: u32,
    /// Whether the normals oppose each other as they are.
    opposed: bool,
}

impl Sheet {
    fn new(points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Option<Self> {
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
        let distances: Vec<f64> = neighbours
            .iter()
            .zip(&points)
            .filter_map(|(near, point)| near.last().map(|&last| (points[last] - point).norm()))
            .collect();
        let cell = median(distances)?;
        let pairs: Vec<(u32, u32)> = neighbours
            .iter()
            .enumerate()
            .flat_map(|(index, near)| near.iter().map(move |&other| (index as u32, other as u32)))
            .filter(|(a, b)| a != b)
            .collect();
        let folds = pairs
            .iter()
            .map(|&(a, b)| (a, b, normals[a as usize].dot(&normals[b as usize])))
            .filter(|(.., cosine)| cosine.abs() > -FOLD_COSINE)
            .map(|(a, b, cosine)| Fold {
                a,
                b,
                opposed: cosine < 0.0,
            })
            .collect();
        (cell > 0.0 && cell.is_finite()).then_some(Self {
            points,
            normals,
            pairs,
            folds,
            cell,
        })
    }

    /// The share of the pairs of neighbours whose normals nearly oppose each other once all of them face `direction`.
    fn folded_fraction(&self, direction: &Vector3<f64>) -> f64 {
        let averted: Vec<bool> = self.normals.iter().map(|normal| normal.dot(direction) < 0.0).collect();
        let is_folded = |fold: &Fold| averted[fold.a as usize] ^ averted[fold.b as usize] ^ fold.opposed;
        let folded = self.folds.iter().filter(|fold| is_folded(fold)).count();
        folded as f64 / self.pairs.len().max(1) as f64
    }

    /// The surplus of bulges over hollows, seen from `direction`, as a share of both: -1 to 1.
    fn bulge(&self, direction: &Vector3<f64>) -> f64 {
        let (mut bulge, mut bent) = (0.0, f64::MIN_POSITIVE);
        for (a, b) in &self.pairs {
            let (a, b) = (*a as usize, *b as usize);
            let (here, there) = (signed(&self.normals[a], direction), signed(&self.normals[b], direction));
            if here.dot(&there) > 0.0 {
                let turn = there - here;
                // Sharp edges of a solid are convex; what is hollow is wide.
                let weight = turn.norm_squared();
                bulge += weight * (self.points[b] - self.points[a]).dot(&turn).signum();
                bent += weight;
            }
        }
        bulge / bent
    }
}

/// `normal` or its opposite, whichever faces `direction`.
pub(super) fn signed(normal: &Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    if normal.dot(direction) < 0.0 { -normal } else { *normal }
}

/// The shares of the points that lie behind another one along `direction`, by as many cells as `HIDDEN_CELLS` has it.
fn hidden_fractions(points: &[Point3<f64>], direction: &Vector3<f64>, cell: f64) -> [f64; 2] {
    let [right, up] = tangents(direction);
    let along = |axis: &Vector3<f64>| -> Vec<f64> { points.iter().map(|point| point.coords.dot(axis)).collect() };
    let [across, upright, depths] = [right, up, *direction].map(|axis| along(&axis));
    let extremes = |values: &[f64]| {
        values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| {
                (low.min(value), high.max(value))
            })
    };
    let (left, width) = extremes(&across);
    let (bottom, height) = extremes(&upright);
    let (width, height) = (width - left, height - bottom);
    let cell = cell.max(width.max(height) / CELL_MAX_COUNT as f64);
    let columns = (width / cell) as usize + 1;
    let rows = (height / cell) as usize + 1;
    let places: Vec<usize> = across
        .iter()
        .zip(&upright)
        .map(|(u, v)| ((v - bottom) / cell) as usize * columns + ((u - left) / cell) as usize)
        .collect();
    let mut nearest = vec![f64::NEG_INFINITY; rows * columns];
    for (&place, &depth) in places.iter().zip(&depths) {
        nearest[place] = nearest[place].max(depth);
    }
    let mut hidden = [0.0; 2];
    for (&place, depth) in places.iter().zip(&depths) {
        let behind = nearest[place] - depth;
        for (count, cells) in hidden.iter_mut().zip(HIDDEN_CELLS) {
            *count += f64::from(u8::from(behind > cells * cell));
        }
    }
    hidden.map(|count| count / points.len().max(1) as f64)
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
const DIRECTION_COUNT: u32 = 300;
const GOLDEN_RAD: f64 = 2.399_963_229_728_653;
const CELL_MAX_COUNT: usize = 400;
/// A point this many cells behind another in its cell is hidden by it: by the first, two sides of a thin wall are told
/// from one; by the second, nothing that only slopes is hidden.
const HIDDEN_CELLS: [f64; 2] = [1.5, 4.0];
/// With a larger share of (barely) hidden and folded points the cloud is not one view. Views of blades have at most 0.22,
/// whole blades at least 0.27.
const HIDDEN_MAX: f64 = 0.245;
/// Shares nearer to each other than this are the same.
const HIDDEN_TIE: f64 = 0.002;
/// Neighbours whose normals have a smaller cosine than this lie on two sides.
const FOLD_COSINE: f64 = -0.3;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::extruded;

    #[test]
    fn one_side_of_a_bar_tells_its_camera_and_the_whole_does_not() {
        let whole = extruded(6000, 0.0);
        let normals = whole.normals().unwrap();
        assert_eq!(camera_of(whole.points(), normals), None);
        for sign in [1.0, -1.0] {
            let camera = Vector3::new(0.2, sign, 0.1).normalize();
            let seen: Vec<usize> = (0..whole.len()).filter(|&i| normals[i].dot(&camera) > 0.1).collect();
            let view = whole.select(&seen);
            let found = camera_of(view.points(), view.normals().unwrap());
            assert!(
                found.is_some_and(|found| found.towards.dot(&camera) > 0.5),
                "{sign}: {found:?}"
            );
        }
    }
}
