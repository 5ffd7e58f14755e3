//! Surface normals from the neighbours of each point. Those of a view on its grid are the cleaning's.

use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

use super::PointCloud;
use super::cells::Cells;
use super::nearest::NearestPoints;
use super::sampling::even_indices;
use super::statistics::median;

/// Estimates one unit normal per point from its `neighbour_count` nearest points (the point itself among them).
///
/// The sign is arbitrary unless `viewpoint` is given: then the normals face it. A point whose neighbours lie on a line
/// or in one place gets the direction to `viewpoint`, or z. Empty clouds stay empty.
pub fn with_estimated_normals(
    cloud: &PointCloud,
    tree: &NearestPoints,
    neighbour_count: usize,
    viewpoint: Option<&Point3<f64>>,
) -> PointCloud {
    let normals = estimated_normals(cloud.points(), tree, neighbour_count, viewpoint);
    cloud.clone().with_normals(normals).unwrap_or_else(|| cloud.clone())
}

/// The normals of [`with_estimated_normals`], unit vectors in the order of `points`.
pub fn estimated_normals(
    points: &[Point3<f64>],
    tree: &NearestPoints,
    neighbour_count: usize,
    viewpoint: Option<&Point3<f64>>,
) -> Vec<Vector3<f64>> {
    points
        .par_iter()
        .with_min_len(256)
        .map(|point| {
            let mut moments = Moments::default();
            for found in tree.nearest_many(point, neighbour_count.max(3)) {
                moments.add(&(points[found.index] - point));
            }
            let towards = viewpoint.map(|viewpoint| viewpoint - point);
            let fallback = towards.and_then(|v| v.try_normalize(0.0)).unwrap_or(Vector3::z());
            let normal = moments.plane_normal().unwrap_or(fallback);
            match towards {
                Some(towards) if normal.dot(&towards) < 0.0 => -normal,
                _ => normal,
            }
        })
        .collect()
}

/// Estimates one unit normal of arbitrary sign per point from the points within the radius that holds `neighbour_count`
/// points in the median, or from the `neighbour_count` nearest points where that holds far fewer.
///
/// As [`estimated_normals`], several times as fast, for clouds of even density.
pub fn normals_within(points: &[Point3<f64>], tree: &NearestPoints, neighbour_count: usize) -> Vec<Vector3<f64>> {
    let Some(radius) = neighbourhood_radius(points, tree, neighbour_count) else {
        return estimated_normals(points, tree, neighbour_count, None);
    };
    let cells = Cells::new(points, radius);
    let sorted = cells.points();
    cells.map(|place, around| {
        let middle = sorted[place];
        let mut moments = Moments::default();
        for &near in around.near() {
            moments.add(&(sorted[near] - middle));
        }
        if 2 * moments.count < neighbour_count {
            moments = Moments::default();
            if let Some((nearest, _)) = around.nearest(neighbour_count.max(3)) {
                for near in nearest {
                    moments.add(&(sorted[near] - middle));
                }
            } else {
                for found in tree.nearest_many(&middle, neighbour_count.max(3)) {
                    moments.add(&(points[found.index] - middle));
                }
            }
        }
        moments.plane_normal().unwrap_or(Vector3::z())
    })
}

/// The median over a few hundred points of the distance to the `neighbour_count`-th nearest point, the point itself the
/// first; `None` unless it is positive.
pub fn neighbourhood_radius(points: &[Point3<f64>], tree: &NearestPoints, neighbour_count: usize) -> Option<f64> {
    let radii: Vec<f64> = even_indices(points.len(), RADIUS_SAMPLE_COUNT)
        .par_iter()
        .with_min_len(64)
        .filter_map(|&index| {
            tree.nearest_many(&points[index], neighbour_count)
                .last()
                .map(|found| found.distance)
        })
        .collect();
    median(radii).filter(|radius| *radius > 0.0)
}

/// Two unit vectors that are square to the unit vector `direction` and to each other.
pub(crate) fn tangents(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let aside = if direction.x.abs() < 0.7 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let right = direction.cross(&aside).normalize();
    [right, direction.cross(&right)]
}

/// The cosine between two normals; without its sign unless they are `oriented`.
pub(crate) fn agreement(first: &Vector3<f64>, second: &Vector3<f64>, oriented: bool) -> f64 {
    let cosine = first.dot(second);
    if oriented { cosine } else { cosine.abs() }
}

/// How far a cloud is from being a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Roughness {
    /// Median standard deviation of a point's neighbours from their own plane, in the points' unit. Noise and curvature
    /// both count.
    pub scatter: f64,
    /// Scatter across over scatter along the surface, 0 (a smooth sheet) to 1 (no sheet at all). The lower quartile, so
    /// that up to half of the points may be outliers.
    pub fuzziness: f64,
}

/// Measures roughness at the points of `indices`, over the `neighbour_count` nearest points of each; zeros without
/// points.
pub fn roughness(points: &[Point3<f64>], tree: &NearestPoints, indices: &[usize], neighbour_count: usize) -> Roughness {
    let spreads: Vec<(f64, f64)> = indices
        .par_iter()
        .with_min_len(64)
        .map(|&index| {
            let mut moments = Moments::default();
            for place in nearest_places(points, tree, index, neighbour_count.max(4)) {
                moments.add(&(place - points[index]));
            }
            let mut values: [f64; 3] = moments.covariance().symmetric_eigenvalues().into();
            values.sort_by(f64::total_cmp);
            let [across, along, _] = values.map(|value| value.max(0.0).sqrt());
            (across, if along > 0.0 { across / along } else { 0.0 })
        })
        .collect();
    let quantile = |mut values: Vec<f64>, share: f64| {
        values.sort_by(f64::total_cmp);
        let index = (share * values.len() as f64) as usize;
        values.get(index).copied().unwrap_or(0.0)
    };
    Roughness {
        scatter: quantile(spreads.iter().map(|spread| spread.0).collect(), 0.5),
        fuzziness: quantile(spreads.iter().map(|spread| spread.1).collect(), 0.25),
    }
}

/// The `count` nearest places to a point, itself among them: points that coincide are one place, so that a list given
/// twice is as rough as once. Fewer where more than four lie in one.
fn nearest_places(points: &[Point3<f64>], tree: &NearestPoints, index: usize, count: usize) -> Vec<Point3<f64>> {
    let mut places = Vec::new();
    for repeated in [1, 2, 4] {
        let found = tree.nearest_many(&points[index], repeated * count);
        let is_all = found.len() < repeated * count;
        places = found.into_iter().map(|found| points[found.index]).collect();
        places.dedup();
        if places.len() >= count || is_all {
            break;
        }
    }
    places.truncate(count);
    places
}

/// First and second moments of offsets.
#[derive(Default)]
struct Moments {
    count: usize,
    sum: Vector3<f64>,
    xx: f64,
    xy: f64,
    xz: f64,
    yy: f64,
    yz: f64,
    zz: f64,
}

impl Moments {
    #[inline]
    fn add(&mut self, v: &Vector3<f64>) {
        self.count += 1;
        self.sum += v;
        self.xx += v.x * v.x;
        self.xy += v.x * v.y;
        self.xz += v.x * v.z;
        self.yy += v.y * v.y;
        self.yz += v.y * v.z;
        self.zz += v.z * v.z;
    }

    /// The direction of least spread; `None` if the offsets span no plane.
    fn plane_normal(&self) -> Option<Vector3<f64>> {
        if self.count < 3 {
            return None;
        }
        smallest_direction(&self.covariance())
    }

    fn covariance(&self) -> Matrix3<f64> {
        let n = self.count.max(1) as f64;
        let m = self.sum / n;
        Matrix3::new(
            self.xx / n - m.x * m.x,
            self.xy / n - m.x * m.y,
            self.xz / n - m.x * m.z,
            self.xy / n - m.x * m.y,
            self.yy / n - m.y * m.y,
            self.yz / n - m.y * m.z,
            self.xz / n - m.x * m.z,
            self.yz / n - m.y * m.z,
            self.zz / n - m.z * m.z,
        )
    }
}

/// The unit eigenvector of the smallest eigenvalue of a covariance; `None` if the two smallest are nearly equal.
///
/// Closed form (trigonometric roots of the characteristic cubic, then the null space by cross products): a plane fit at
/// every pixel is what normals cost.
fn smallest_direction(covariance: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let scale = covariance.trace();
    if scale <= 0.0 || !scale.is_finite() {
        return None;
    }
    let a = covariance / scale;
    let mean = 1.0 / 3.0;
    let shifted = a - Matrix3::identity() * mean;
    let p = (shifted.norm_squared() / 6.0).sqrt();
    if p < 1e-9 {
        return None;
    }
    let r = (shifted.determinant() / (2.0 * p * p * p)).clamp(-1.0, 1.0);
    let phi = r.acos() / 3.0;
    let largest = mean + 2.0 * p * phi.cos();
    let smallest = mean + 2.0 * p * (phi + 2.0 * std::f64::consts::FRAC_PI_3).cos();
    let middle = 1.0 - largest - smallest;
    if middle - smallest < MIDDLE_MIN_FRACTION * largest {
        return None;
    }
    let m = a - Matrix3::identity() * smallest;
    let (r0, r1, r2) = (m.column(0), m.column(1), m.column(2));
    let candidates = [r0.cross(&r1), r0.cross(&r2), r1.cross(&r2)];
    let mut best = candidates[0];
    for candidate in &candidates[1..] {
        if candidate.norm_squared() > best.norm_squared() {
            best = *candidate;
        }
    }
    best.try_normalize(1e-14)
}

const RADIUS_SAMPLE_COUNT: usize = 500;
/// Below this ratio of middle to largest spread the neighbours lie on a line and span no plane.
const MIDDLE_MIN_FRACTION: f64 = 1e-3;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_on_a_sphere_give_radial_normals() {
        let points = (0..4000).map(|i| {
            let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0;
            let (sin, cos) = (f64::from(i) * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            Point3::new(r * cos, r * sin, z)
        });
        let cloud = PointCloud::from_measured(points).cloud;
        let tree = NearestPoints::new(cloud.points());
        let with = with_estimated_normals(&cloud, &tree, 12, Some(&Point3::origin()));
        for (point, normal) in with.points().iter().zip(with.normals().unwrap()) {
            assert!(normal.dot(&point.coords) < -0.995);
        }
        let within = normals_within(cloud.points(), &tree, 12);
        for (point, normal) in cloud.points().iter().zip(&within) {
            assert!(normal.dot(&point.coords).abs() > 0.995);
        }
    }

    #[test]
    fn the_smallest_direction_agrees_with_the_eigen_decomposition() {
        let m = Matrix3::new(2.0, 0.3, 0.1, 0.3, 1.0, 0.05, 0.1, 0.05, 0.02);
        let eigen = m.symmetric_eigen();
        let smallest = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        let found = smallest_direction(&m).unwrap();
        assert!((found.dot(&smallest).abs() - 1.0).abs() < 1e-12);
        assert_eq!(smallest_direction(&Matrix3::identity()), None);
        assert_eq!(smallest_direction(&Matrix3::zeros()), None);
        assert_eq!(smallest_direction(&(m * 1e308)), None);
    }
}
