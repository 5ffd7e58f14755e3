//! A cloud prepared to be registered to.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::facing::{Orientation, camera_of, signed};
use crate::geometry::PointCloud;
use crate::geometry::nearest::{NearestPoints, Neighbour};
use crate::geometry::normals::{Roughness, estimated_normals, normals_within, roughness};
use crate::geometry::sampling::even_indices;
use crate::geometry::statistics::median;

/// A fixed cloud with normals, a search tree and its scale, ready to be registered to (the paper's Y).
pub struct Reference {
    cloud: PointCloud,
    orientation: Orientation,
    tree: NearestPoints,
    spacing: f64,
    centroid: Point3<f64>,
    radius: f64,
    roughness: Roughness,
}

impl std::fmt::Debug for Reference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reference")
            .field("point_count", &self.cloud.len())
            .field("spacing", &self.spacing)
            .field("radius", &self.radius)
            .finish_non_exhaustive()
    }
}

/// Why clouds cannot be registered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RegisterError {
    /// There are not enough points to determine a motion.
    #[error("a cloud of {count} points cannot be registered; it needs at least {needed}")]
    TooFewPoints {
        /// How many points there are.
        count: usize,
        /// How many are needed.
        needed: usize,
    },
    /// All points coincide, as far as double precision can tell.
    #[error("a cloud of {count} points in one place cannot be registered")]
    NoExtent {
        /// How many points there are.
        count: usize,
    },
    /// A coordinate is larger than 1e50, or the extent is smaller than 1e-50: powers of lengths would not be numbers.
    #[error("a cloud of {count} points with coordinates beyond 1e50 or an extent below 1e-50 cannot be computed with")]
    OutOfRange {
        /// How many points there are.
        count: usize,
    },
}

/// The least number of points of a cloud that is registered.
pub const POINT_MIN_COUNT: usize = 10;

impl Reference {
    /// Prepares `cloud`: builds the tree, measures the spacing, and estimates normals if there are none.
    ///
    /// Normals that are given are taken to face the sensor. Estimated ones do if the cloud tells where it was seen from;
    /// otherwise only the angle between the two surfaces' tangent planes counts.
    ///
    /// # Errors
    /// When there are fewer than [`POINT_MIN_COUNT`] points, all of them coincide, or coordinates or extent are beyond
    /// what can be computed with.
    pub fn new(cloud: &PointCloud) -> Result<Self, RegisterError> {
        let (centroid, radius) = centroid_and_radius(cloud)?;
        let tree = NearestPoints::new(cloud.points());
        let spacing = median_spacing(cloud.points(), &tree, radius);
        let roughness = roughness_of(cloud.points(), &tree);
        let (cloud, orientation) = if cloud.normals().is_some() {
            (cloud.clone(), Orientation::Given)
        } else {
            estimated(cloud, &tree)
        };
        Ok(Self {
            cloud,
            orientation,
            tree,
            spacing,
            centroid,
            radius,
            roughness,
        })
    }

    /// The points.
    pub fn points(&self) -> &[Point3<f64>] {
        self.cloud.points()
    }

    /// The unit normals, one per point.
    pub fn normals(&self) -> &[Vector3<f64>] {
        self.cloud.normals().unwrap_or(&[])
    }

    /// Whether the signs of the normals belong together: they were given with the cloud, or the cloud is a single view.
    /// Then they tell the sides of a thin wall apart.
    pub fn is_oriented(&self) -> bool {
        self.orientation != Orientation::Unknown
    }

    pub(super) fn orientation(&self) -> &Orientation {
        &self.orientation
    }

    /// The median distance from a point to its nearest other point, in the cloud's unit; always positive.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// The mean of the points.
    pub fn centroid(&self) -> Point3<f64> {
        self.centroid
    }

    /// The root mean square distance of the points from their centroid; always positive.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// How far the cloud is from being a smooth surface.
    pub fn roughness(&self) -> Roughness {
        self.roughness
    }

    /// The overlap distance used when none is given: three times the spacing.
    pub fn default_overlap_distance(&self) -> f64 {
        3.0 * self.spacing
    }

    /// The nearest reference point to `query`; `None` for a query that is not finite.
    pub fn nearest(&self, query: &Point3<f64>) -> Option<Neighbour> {
        self.tree.nearest(query)
    }

    /// The search tree over the points.
    pub(super) fn tree(&self) -> &NearestPoints {
        &self.tree
    }

    /// The points and their normals.
    pub(super) fn cloud(&self) -> &PointCloud {
        &self.cloud
    }
}

/// The cloud with estimated normals, and what their signs mean.
pub(super) fn estimated(cloud: &PointCloud, tree: &NearestPoints) -> (PointCloud, Orientation) {
    // On thin clouds counting the neighbours exactly is worth its time.
    let mut normals = if cloud.len() < DENSE_MIN_COUNT {
        estimated_normals(cloud.points(), tree, NORMAL_NEIGHBOUR_COUNT, None)
    } else {
        normals_within(cloud.points(), tree, NORMAL_NEIGHBOUR_COUNT)
    };
    let camera = camera_of(cloud.points(), &normals);
    if let Some(camera) = &camera {
        for normal in &mut normals {
            *normal = signed(normal, &camera.towards);
        }
    }
    match cloud.clone().with_normals(normals) {
        Some(cloud) => (cloud, camera.map_or(Orientation::Unknown, Orientation::View)),
        None => (cloud.clone(), Orientation::Unknown),
    }
}

/// Centroid and radius of a cloud that can be registered.
pub(super) fn centroid_and_radius(cloud: &PointCloud) -> Result<(Point3<f64>, f64), RegisterError> {
    let count = cloud.len();
    if count < POINT_MIN_COUNT {
        return Err(RegisterError::TooFewPoints {
            count,
            needed: POINT_MIN_COUNT,
        });
    }
    let points = cloud.points();
    if points.iter().all(|point| *point == points[0]) {
        return Err(RegisterError::NoExtent { count });
    }
    let largest = points.iter().map(|point| point.coords.amax()).fold(0.0, f64::max);
    if largest > LENGTH_MAX {
        return Err(RegisterError::OutOfRange { count });
    }
    let centroid = cloud.centroid();
    let radius = rms_radius(points, &centroid);
    if radius < LENGTH_MIN {
        return Err(RegisterError::OutOfRange { count });
    }
    if radius <= ROUNDINGS * f64::EPSILON * largest {
        return Err(RegisterError::NoExtent { count });
    }
    Ok((centroid, radius))
}

/// The root mean square distance of `points` from `centre`.
pub(super) fn rms_radius(points: &[Point3<f64>], centre: &Point3<f64>) -> f64 {
    let sum: f64 = points.iter().map(|point| (point - centre).norm_squared()).sum();
    (sum / points.len().max(1) as f64).sqrt()
}

/// The roughness of a cloud, from a few hundred points spread over it.
pub(super) fn roughness_of(points: &[Point3<f64>], tree: &NearestPoints) -> Roughness {
    let indices = even_indices(points.len(), ROUGHNESS_SAMPLE_COUNT);
    roughness(points, tree, &indices, NORMAL_NEIGHBOUR_COUNT)
}

/// The median distance to the nearest other place, over at most a thousand points spread over the list.
pub(super) fn median_spacing(points: &[Point3<f64>], tree: &NearestPoints, radius: f64) -> f64 {
    let distances: Vec<f64> = even_indices(points.len(), SPACING_SAMPLE_COUNT)
        .par_iter()
        .filter_map(|&index| {
            tree.nearest_many(&points[index], 4)
                .into_iter()
                .map(|found| found.distance)
                .find(|&distance| distance > 0.0)
        })
        .collect();
    median(distances).unwrap_or(radius / (points.len() as f64).sqrt())
}

/// Beyond these the sixth power of a length leaves the range of double precision.
const LENGTH_MAX: f64 = 1e50;
const LENGTH_MIN: f64 = 1e-50;
/// A radius of this many roundings of the largest coordinate is none.
const ROUNDINGS: f64 = 16.0;
const SPACING_SAMPLE_COUNT: usize = 1000;
const ROUGHNESS_SAMPLE_COUNT: usize = 500;
/// Neighbours in a plane fit of an unorganised cloud.
const NORMAL_NEIGHBOUR_COUNT: usize = 20;
/// From this many points on a cloud counts as dense.
const DENSE_MIN_COUNT: usize = 10_000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn too_few_or_coinciding_points_are_refused() {
        let cloud = |n: usize, step: f64| {
            PointCloud::from_measured((0..n).map(|i| Point3::new(step * i as f64, 0.0, 0.0))).cloud
        };
        assert_eq!(
            Reference::new(&cloud(9, 1.0)).err(),
            Some(RegisterError::TooFewPoints { count: 9, needed: 10 })
        );
        assert_eq!(
            Reference::new(&cloud(12, 0.0)).err(),
            Some(RegisterError::NoExtent { count: 12 })
        );
        let reference = Reference::new(&cloud(12, 2.0)).unwrap();
        assert_eq!(reference.spacing(), 2.0);
        assert_eq!(reference.centroid(), Point3::new(11.0, 0.0, 0.0));
    }
}
