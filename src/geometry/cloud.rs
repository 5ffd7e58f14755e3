//! Point clouds that hold only finite points.

use nalgebra::{Isometry3, Point3, Vector3};

use super::statistics::mean;

/// A set of finite points, optionally with one unit normal each.
///
/// Units are the caller's (millimetres everywhere in bladescan except in viewer topics). Order is kept: algorithms
/// break ties by the lower index.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    points: Vec<Point3<f64>>,
    normals: Option<Vec<Vector3<f64>>>,
}

/// What [`PointCloud::from_measured`] kept and dropped.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// The finite points.
    pub cloud: PointCloud,
    /// How many points were dropped because a coordinate was NaN or infinite.
    pub dropped_count: usize,
}

impl PointCloud {
    /// Keeps the finite points of `points`, in order, and counts the others.
    pub fn from_measured(points: impl IntoIterator<Item = Point3<f64>>) -> Measured {
        let mut dropped_count = 0;
        let points = points
            .into_iter()
            .filter(|point| {
                let finite = point.coords.iter().all(|value| value.is_finite());
                dropped_count += usize::from(!finite);
                finite
            })
            .collect();
        Measured {
            cloud: Self { points, normals: None },
            dropped_count,
        }
    }

    /// Adds one normal per point; each is scaled to unit length.
    ///
    /// Returns `None` when the counts differ or a normal is zero or not finite.
    pub fn with_normals(self, normals: Vec<Vector3<f64>>) -> Option<Self> {
        if normals.len() != self.points.len() {
            return None;
        }
        let normals = normals
            .into_iter()
            .map(|normal| {
                normal
                    .try_normalize(0.0)
                    .filter(|unit| unit.iter().all(|v| v.is_finite()))
            })
            .collect::<Option<Vec<_>>>()?;
        Some(Self {
            points: self.points,
            normals: Some(normals),
        })
    }

    /// Points that are known to be finite with normals that are known to be unit vectors, one each.
    pub(crate) fn of_finite(points: Vec<Point3<f64>>, normals: Vec<Vector3<f64>>) -> Self {
        debug_assert_eq!(points.len(), normals.len());
        Self {
            points,
            normals: Some(normals),
        }
    }

    /// The points, `n × 3`.
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// The unit normals, one per point, if the cloud has them.
    pub fn normals(&self) -> Option<&[Vector3<f64>]> {
        self.normals.as_deref()
    }

    /// How many points there are.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The mean of the points; the origin for an empty cloud.
    pub fn centroid(&self) -> Point3<f64> {
        mean(&self.points)
    }

    /// The same cloud seen from another frame: points moved, normals turned.
    pub fn transformed(&self, target_from_source: &Isometry3<f64>) -> Self {
        Self {
            points: self.points.iter().map(|point| target_from_source * point).collect(),
            normals: self
                .normals
                .as_ref()
                .map(|normals| normals.iter().map(|normal| target_from_source * normal).collect()),
        }
    }

    /// The points (and normals) at `indices`, in that order. Indices out of range are a caller's bug and panic.
    pub fn select(&self, indices: &[usize]) -> Self {
        Self {
            points: indices.iter().map(|&index| self.points[index]).collect(),
            normals: self
                .normals
                .as_ref()
                .map(|normals| indices.iter().map(|&index| normals[index]).collect()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_that_are_not_finite_are_dropped_and_counted() {
        let measured = PointCloud::from_measured([
            Point3::new(1.0, 2.0, 3.0),
            Point3::new(f64::NAN, 0.0, 0.0),
            Point3::new(0.0, f64::INFINITY, 0.0),
        ]);
        assert_eq!(measured.cloud.points(), [Point3::new(1.0, 2.0, 3.0)]);
        assert_eq!(measured.dropped_count, 2);
    }

    #[test]
    fn normals_must_match_the_points_and_come_out_unit_long() {
        let cloud = PointCloud::from_measured([Point3::origin()]).cloud;
        assert!(cloud.clone().with_normals(vec![]).is_none());
        assert!(cloud.clone().with_normals(vec![Vector3::zeros()]).is_none());
        let cloud = cloud.with_normals(vec![Vector3::new(0.0, 0.0, 5.0)]).unwrap();
        assert_eq!(cloud.normals().unwrap(), [Vector3::z()]);
    }
}
