//! Closest points of a fixed cloud, for the methods that pair each point with one other.

use bladescan::geometry::nearest::NearestPoints;
use nalgebra::{Isometry3, Point3};
use rayon::prelude::*;

use crate::kabsch::motion_between;

/// A fixed cloud that can be asked for the point closest to another.
pub(crate) struct Closest<'a> {
    points: &'a [Point3<f64>],
    tree: NearestPoints,
}

/// A point and its partner in the fixed cloud.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pair {
    /// In the moving cloud's own frame.
    pub(crate) from: Point3<f64>,
    /// Its partner.
    pub(crate) to: Point3<f64>,
    /// The squared distance between them in the pose that they were paired in.
    pub(crate) squared: f64,
}

/// The mean squared distance of pairs.
pub(crate) fn mean_square(pairs: &[Pair]) -> f64 {
    pairs.iter().map(|pair| pair.squared).sum::<f64>() / pairs.len().max(1) as f64
}

/// The motion of least squares that lays the moving points on their partners.
pub(crate) fn motion_of(pairs: &[Pair]) -> Isometry3<f64> {
    let (from, to): (Vec<Point3<f64>>, Vec<Point3<f64>>) = pairs.iter().map(|pair| (pair.from, pair.to)).unzip();
    motion_between(&from, &to)
}

impl<'a> Closest<'a> {
    pub(crate) fn new(points: &'a [Point3<f64>]) -> Self {
        Self {
            points,
            tree: NearestPoints::new(points),
        }
    }

    /// The partner of each point as `pose` places it, in their order; a point that is not finite has none.
    pub(crate) fn pairs(&self, moving: &[Point3<f64>], pose: &Isometry3<f64>) -> Vec<Pair> {
        moving
            .par_iter()
            .with_min_len(PART_MIN_COUNT)
            .filter_map(|from| {
                let found = self.tree.nearest(&(pose * from))?;
                Some(Pair {
                    from: *from,
                    to: self.points[found.index],
                    squared: found.distance * found.distance,
                })
            })
            .collect()
    }

    /// The median over the points of the distance to the nearest other one.
    pub(crate) fn spacing(&self) -> f64 {
        let apart = |point: &Point3<f64>| {
            self.tree
                .nearest_many(point, 2)
                .last()
                .map_or(0.0, |found| found.distance)
        };
        let distances = self.points.par_iter().with_min_len(PART_MIN_COUNT).map(apart).collect();
        crate::cases::median(distances)
    }
}

/// Fewer queries are not worth a thread.
const PART_MIN_COUNT: usize = 128;
