//! Nearest-neighbour queries on a fixed set of points.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::Point3;

/// A search tree over a fixed list of points; distances are in the points' unit, never squared.
///
/// Queries that are not finite and queries on an empty list find nothing. Of several points at the very same distance
/// the same one is found every time, whatever the number of threads.
pub struct NearestPoints {
    tree: Option<ImmutableKdTree<f64, 3>>,
}

/// A point found by a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Its index in the list that the tree was built from.
    pub index: usize,
    /// Its distance from the query, in the points' unit.
    pub distance: f64,
}

impl NearestPoints {
    /// Builds the tree. `points` must be finite, as those of a [`PointCloud`](super::PointCloud) are.
    ///
    /// More than `u32::MAX` points cannot be indexed: the tree is then empty.
    pub fn new(points: &[Point3<f64>]) -> Self {
        let entries: Vec<[f64; 3]> = points.iter().map(|point| [point.x, point.y, point.z]).collect();
        let tree = if entries.is_empty() {
            None
        } else {
            ImmutableKdTree::new_from_slice(&entries).ok()
        };
        Self { tree }
    }

    /// The nearest point to `query`; `None` when there are no points or `query` is not finite.
    pub fn nearest(&self, query: &Point3<f64>) -> Option<Neighbour> {
        let query = finite(query)?;
        let found = self
            .tree
            .as_ref()?
            .query(&query)
            .nearest_one::<SquaredEuclidean<f64>>()
            .execute();
        neighbour(found.item, found.distance)
    }

    /// The nearest point to `query` that is at most `reach` away.
    pub fn nearest_within(&self, query: &Point3<f64>, reach: f64) -> Option<Neighbour> {
        self.nearest(query).filter(|found| found.distance <= reach)
    }

    /// The `count` nearest points to `query`, nearest first (fewer when there are not as many).
    pub fn nearest_many(&self, query: &Point3<f64>, count: usize) -> Vec<Neighbour> {
        let (Some(tree), Some(query), Some(count)) = (self.tree.as_ref(), finite(query), NonZero::new(count)) else {
            return Vec::new();
        };
        let mut found: Vec<Neighbour> = tree
            .query(&query)
            .nearest_n::<SquaredEuclidean<f64>>(count)
            .execute()
            .into_iter()
            .filter_map(|found| neighbour(found.item, found.distance))
            .collect();
        sort(&mut found);
        found
    }

    /// Every point at most `reach` from `query`, nearest first; ties by lower index.
    pub fn all_within(&self, query: &Point3<f64>, reach: f64) -> Vec<Neighbour> {
        let (Some(tree), Some(query), true) = (self.tree.as_ref(), finite(query), reach >= 0.0) else {
            return Vec::new();
        };
        let mut found: Vec<Neighbour> = tree
            .query(&query)
            .within::<SquaredEuclidean<f64>>(reach * reach)
            .execute()
            .into_iter()
            .filter_map(|found| neighbour(found.item, found.distance))
            .collect();
        sort(&mut found);
        found
    }
}

fn sort(found: &mut [Neighbour]) {
    found.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.index.cmp(&b.index)));
}

/// The library answers an empty tree and a NaN query with item 0 at an infinite distance: such answers are no neighbours.
fn neighbour(item: u32, squared_distance: f64) -> Option<Neighbour> {
    squared_distance.is_finite().then(|| Neighbour {
        index: item as usize,
        distance: squared_distance.sqrt(),
    })
}

fn finite(query: &Point3<f64>) -> Option<[f64; 3]> {
    let query = [query.x, query.y, query.z];
    query.iter().all(|value| value.is_finite()).then_some(query)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Vec<Point3<f64>> {
        (0..1000)
            .map(|i| Point3::new(f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100)))
            .collect()
    }

    #[test]
    fn neighbours_agree_with_brute_force() {
        let points = grid();
        let tree = NearestPoints::new(&points);
        let query = Point3::new(3.2, 4.1, 8.6);
        let best = points.iter().map(|p| (p - query).norm()).fold(f64::INFINITY, f64::min);
        let found = tree.nearest(&query).unwrap();
        assert!((found.distance - best).abs() < 1e-12);
        assert!(((points[found.index] - query).norm() - best).abs() < 1e-12);
        let within = points.iter().filter(|p| (*p - query).norm() <= 1.5).count();
        assert_eq!(tree.all_within(&query, 1.5).len(), within);
        let many = tree.nearest_many(&query, 7);
        assert_eq!(many.len(), 7);
        assert!(many.windows(2).all(|pair| pair[0].distance <= pair[1].distance));
        assert_eq!(tree.nearest_within(&Point3::new(30.0, 0.0, 0.0), 2.0), None);
    }

    #[test]
    fn nothing_is_found_among_no_points_or_for_a_query_that_is_not_finite() {
        let empty = NearestPoints::new(&[]);
        assert_eq!(empty.nearest(&Point3::origin()), None);
        assert!(empty.nearest_many(&Point3::origin(), 3).is_empty());
        assert!(empty.all_within(&Point3::origin(), 3.0).is_empty());
        let tree = NearestPoints::new(&grid());
        assert_eq!(tree.nearest(&Point3::new(f64::NAN, 0.0, 0.0)), None);
        assert!(tree.nearest_many(&Point3::new(0.0, f64::NAN, 0.0), 3).is_empty());
    }
}
