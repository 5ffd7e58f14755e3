//! Surface to surface: what ends the work where both clouds are dense.
//!
//! Trimmed ICP compares each template point with one reference point, so the noise of the reference points that happen
//! to be many points' nearest counts several times: on dense views that costs 1.5 to 2 times the Cramer-Rao bound. Here
//! both clouds are replaced by their [`patches`] first, with one radius for both, so that what the fits smooth away of
//! the shape is the same in both; pairs are taken both ways; and where a surface bends too much for its patch, the
//! measured points are compared. The pairs hold still: trimmed ICP has ended far below a spacing from the solution.

use nalgebra::{Isometry3, Point3, Vector3, Vector6};
use rayon::prelude::*;

use super::icp::{Problem, Refined};
use super::normal_matrix::NormalMatrix;
use super::tukey::Tukey;
use crate::geometry::PointCloud;
use crate::geometry::cells::cube_order;
use crate::geometry::nearest::NearestPoints;
use crate::geometry::normals::{agreement, neighbourhood_radius};
use crate::geometry::patches::{Patch, patches};
use crate::geometry::sampling::even_indices;

/// The pose after trimmed ICP has come to `fine`, made more accurate; without motion along the `held` directions.
///
/// `template` has normals, `tree` holds its points. `None` where the clouds are too different in density for one
/// radius, where too little of them is smooth, where they are more than [`POINTS_MAX`], or where the result is not close to `fine`.
pub(super) fn refined(
    problem: &Problem<'_>,
    template: &PointCloud,
    tree: &NearestPoints,
    fine: &Refined,
    held: &[Vector6<f64>],
) -> Option<Refined> {
    let reference = problem.reference;
    let own = neighbourhood_radius(template.points(), tree, NEIGHBOUR_COUNT)?;
    let other = neighbourhood_radius(reference.points(), reference.tree(), NEIGHBOUR_COUNT)?;
    let radius = own.max(other);
    if radius > DENSITY_MAX_RATIO * own.min(other) {
        return None;
    }
    let near = near(reference.cloud(), template, &fine.pose, radius);
    if template.len() + near.len() > POINTS_MAX {
        return None;
    }
    let all: Vec<usize> = (0..template.len()).collect();
    let fixed = Surface::new(reference.cloud(), reference.tree(), near, radius, problem.oriented);
    let moving = Surface::new(template, tree, all, radius, problem.oriented);
    let pairs = Pairing {
        problem,
        moving: &moving,
        fixed: &fixed,
        reach: REACH_RADII * radius,
        pose: fine.pose,
    }
    .pairs();
    if pairs.len() < PAIR_MIN_COUNT {
        return None;
    }
    let mut pose = fine.pose;
    let mut sums = NormalMatrix::zero();
    for _ in 0..ITERATION_COUNT {
        sums = equations(problem, &moving, &fixed, &pairs, &pose)?;
        let step = sums.step(held)?;
        pose = problem.stepped(&pose, &step);
    }
    let step = problem.step_between(&fine.pose, &pose);
    (step.norm() <= REACH_RADII * radius).then(|| Refined {
        pose,
        iterations: fine.iterations + ITERATION_COUNT,
        // Every measured distance counts twice, once each way.
        determination: sums.determination(problem.radius, sums.weight / 2.0),
    })
}

/// The indices, ascending, of the reference points that a patch near the template may need.
fn near(reference: &PointCloud, template: &PointCloud, pose: &Isometry3<f64>, radius: f64) -> Vec<usize> {
    let placed: Vec<Point3<f64>> = template.points().iter().map(|point| pose * point).collect();
    let low = placed
        .iter()
        .fold(Point3::from([f64::MAX; 3]), |low, point| low.inf(point));
    let high = placed
        .iter()
        .fold(Point3::from([f64::MIN; 3]), |high, point| high.sup(point));
    let width = (2.0 * radius).max((high - low).amax() / BOX_MAX_COUNT as f64);
    // A margin all around.
    let low = low - Vector3::repeat(2.0 * width);
    let counts = (high - low).map(|extent| (extent / width) as usize + 3);
    let at = |cube: [usize; 3]| (cube[0] * counts.y + cube[1]) * counts.z + cube[2];
    let cube = |point: &Point3<f64>| {
        let [x, y, z]: [f64; 3] = ((point - low) / width).into();
        let inside = x >= 0.0 && y >= 0.0 && z >= 0.0;
        let cube = [x as usize, y as usize, z as usize];
        (inside && cube[0] < counts.x && cube[1] < counts.y && cube[2] < counts.z).then_some(cube)
    };
    let mut occupied = vec![false; counts.product()];
    let mut wanted = occupied.clone();
    for [x, y, z] in placed.iter().filter_map(cube) {
        let here = at([x, y, z]);
        if occupied[here] {
            continue;
        }
        occupied[here] = true;
        for x in x - 1..=x + 1 {
            for y in y - 1..=y + 1 {
                let row = at([x, y, z]);
                wanted[row - 1..=row + 1].fill(true);
            }
        }
    }
    let points = reference.points();
    let is_wanted = |index: &usize| cube(&points[*index]).is_some_and(|cube| wanted[at(cube)]);
    (0..points.len()).filter(is_wanted).collect()
}

/// Some points of a cloud and their patches, neighbours next to each other.
struct Surface<'a> {
    /// Over all points of the cloud.
    tree: &'a NearestPoints,
    /// Where each point of the cloud is, `None` if it is none of these.
    places: Vec<Option<u32>>,
    points: Vec<Point3<f64>>,
    patches: Vec<Patch>,
}

impl<'a> Surface<'a> {
    fn new(cloud: &PointCloud, tree: &'a NearestPoints, indices: Vec<usize>, radius: f64, oriented: bool) -> Self {
        let points: Vec<Point3<f64>> = indices.iter().map(|&index| cloud.points()[index]).collect();
        let order = cube_order(&points, radius);
        let indices: Vec<usize> = order.iter().map(|&at| indices[at]).collect();
        let mut places = vec![None; cloud.len()];
        for (place, &index) in indices.iter().enumerate() {
            places[index] = Some(place as u32);
        }
        Self {
            tree,
            places,
            points: order.iter().map(|&at| points[at]).collect(),
            patches: patches(cloud, tree, &indices, radius, oriented),
        }
    }

    /// The place of the cloud's nearest point to `query`, if that is within `reach` and one of these.
    fn nearest_within(&self, query: &Point3<f64>, reach: f64) -> Option<usize> {
        let found = self.tree.nearest_within(query, reach)?;
        self.places[found.index].map(|place| place as usize)
    }
}

/// A template point and a reference point, by their places in their surfaces.
#[derive(Clone, Copy)]
struct Pair {
    template: usize,
    reference: usize,
}

struct Pairing<'a> {
    problem: &'a Problem<'a>,
    moving: &'a Surface<'a>,
    fixed: &'a Surface<'a>,
    reach: f64,
    pose: Isometry3<f64>,
}

impl Pairing<'_> {
    /// Each template point with its nearest reference point, then each of these with its nearest template point.
    fn pairs(&self) -> Vec<Pair> {
        let template_from_reference = self.pose.inverse();
        let there = self.moving.points.par_iter().enumerate().with_min_len(512);
        let there = there.filter_map(|(template, point)| {
            let reference = self.fixed.nearest_within(&(self.pose * point), self.reach)?;
            self.agreed(Pair { template, reference })
        });
        let back = self.fixed.points.par_iter().enumerate().with_min_len(512);
        let back = back.filter_map(|(reference, point)| {
            let template = self
                .moving
                .nearest_within(&(template_from_reference * point), self.reach)?;
            self.agreed(Pair { template, reference })
        });
        there.chain(back).collect()
    }

    fn agreed(&self, pair: Pair) -> Option<Pair> {
        let (first, second) = (&self.moving.patches[pair.template], &self.fixed.patches[pair.reference]);
        let cosine = agreement(&(self.pose * first.normal), &second.normal, self.problem.oriented);
        (cosine >= AGREEMENT).then_some(pair)
    }
}

/// Whether a patch follows its surface more closely than its point does.
fn is_smooth(patch: &Patch) -> bool {
    patch.bend_rad <= BEND_MAX_RAD && patch.variance_share <= VARIANCE_MAX_SHARE
}

/// One pair in one pose.
struct Measured {
    point: Point3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    normal: Vector3<f64>,
    /// Distance of the patches, or of the points where a patch is not smooth.
    residual: f64,
    /// Distance of the points as measured.
    raw: f64,
}

fn measured(moving: &Surface<'_>, fixed: &Surface<'_>, pair: Pair, pose: &Isometry3<f64>) -> Option<Measured> {
    let (there, here) = (&moving.patches[pair.template], &fixed.patches[pair.reference]);
    let turned = pose * there.normal;
    let first = if turned.dot(&here.normal) < 0.0 {
        -turned
    } else {
        turned
    };
    let normal = (first + here.normal).try_normalize(0.0)?;
    let point = pose * moving.points[pair.template];
    let raw = normal.dot(&(point - fixed.points[pair.reference]));
    let residual = if is_smooth(there) && is_smooth(here) {
        normal.dot(&(pose * there.position - here.position))
    } else {
        raw
    };
    Some(Measured {
        point,
        first,
        second: here.normal,
        normal,
        residual,
        raw,
    })
}

/// The equations at `pose`, weighted by Tukey's function; their squared residual is that of the measured points.
fn equations(
    problem: &Problem<'_>,
    moving: &Surface<'_>,
    fixed: &Surface<'_>,
    pairs: &[Pair],
    pose: &Isometry3<f64>,
) -> Option<NormalMatrix> {
    let residuals: Vec<f64> = even_indices(pairs.len(), MEDIAN_COUNT)
        .into_par_iter()
        .with_min_len(CHUNK_COUNT)
        .map(|index| pairs[index])
        .filter_map(|pair| Some(measured(moving, fixed, pair, pose)?.residual.abs()))
        .collect();
    let tukey = Tukey::of(residuals, problem.radius)?;
    let centre = pose * problem.centroid;
    NormalMatrix::summed(pairs, |some| {
        let mut sums = NormalMatrix::zero();
        let mut squared = 0.0;
        for m in some.iter().filter_map(|&pair| measured(moving, fixed, pair, pose)) {
            let Some(weight) = tukey.weight(m.residual) else {
                continue;
            };
            let arm = (m.point - centre) / problem.radius;
            sums.add(weight, &arm, &m.normal, m.residual);
            sums.add_cross(weight, &arm, &m.first, &m.second);
            squared += weight * m.raw * m.raw;
        }
        sums.squared_residual = squared;
        sums
    })
}

/// About how many points a patch is fitted to: fewer leave noise, more smooth edges away.
const NEIGHBOUR_COUNT: usize = 16;
/// With a larger ratio of the two neighbourhoods' radii one cloud is too thin for the other's.
const DENSITY_MAX_RATIO: f64 = 2.5;
/// Paired points are nearer than this, over the patches' radius: about two spacings. Neither may the pose move further.
const REACH_RADII: f64 = 0.75;
/// A patch that bends more does not follow its surface.
const BEND_MAX_RAD: f64 = 0.25;
/// At a rim the fit is an extrapolation; with a larger share of the points' variance it is not worth it.
const VARIANCE_MAX_SHARE: f64 = 0.5;
/// Least cosine between the normals of a pair.
const AGREEMENT: f64 = 0.85;
/// Fewer pairs are not worth it.
const PAIR_MIN_COUNT: usize = 1000;
const ITERATION_COUNT: u32 = 2;
/// More points than any view or model has; patches for as many would take gigabytes, and the points alone say where they lie.
const POINTS_MAX: usize = 4_000_000;
/// The most cubes along an axis in which points near the template are looked for.
const BOX_MAX_COUNT: usize = 200;
/// Points of one parallel piece.
const CHUNK_COUNT: usize = 1024;
/// How many pairs tell the median of the residuals.
const MEDIAN_COUNT: usize = 10_000;
