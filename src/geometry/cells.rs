//! Points sorted into cubes, for sums over all points within a radius of each.

use std::ops::Range;

use nalgebra::Point3;
use rayon::prelude::*;

/// Cubes as wide as the radius: what is within it of a point lies in the point's cube and the 26 around it.
pub(super) struct Cells {
    /// The cube of each point, ascending.
    keys: Vec<[i32; 3]>,
    /// The points' indices, cube by cube.
    order: Vec<usize>,
    /// Where in `order` each cube starts, and the end.
    starts: Vec<usize>,
}

impl Cells {
    /// `width` must be positive and finite.
    pub(super) fn new(points: &[Point3<f64>], width: f64) -> Self {
        let low = points
            .iter()
            .fold(Point3::from([f64::MAX; 3]), |low, point| low.inf(point));
        let mut keyed: Vec<([i32; 3], usize)> = points
            .iter()
            .enumerate()
            .map(|(index, point)| (((point - low) / width).map(|value| value as i32).into(), index))
            .collect();
        keyed.par_sort_unstable();
        let mut starts: Vec<usize> = (0..keyed.len())
            .filter(|&at| at == 0 || keyed[at].0 != keyed[at - 1].0)
            .collect();
        starts.push(keyed.len());
        Self {
            keys: keyed.iter().map(|(key, _)| *key).collect(),
            order: keyed.iter().map(|(_, index)| *index).collect(),
            starts,
        }
    }

    /// The points' indices, cube by cube.
    pub(super) fn order(&self) -> &[usize] {
        &self.order
    }

    /// Applies `work` to every point, cube by cube: to its place in `order` and to the places of the points around it,
    /// an even choice of them where they are very many. The results are in the order in which the points were given.
    pub(super) fn map<T: Send>(&self, work: impl Fn(usize, &Around) -> T + Sync) -> Vec<T> {
        let sorted: Vec<Vec<T>> = self
            .starts
            .par_windows(2)
            .with_min_len(64)
            .map(|cube| {
                let around = self.around(cube[0]);
                (cube[0]..cube[1]).map(|place| work(place, &around)).collect()
            })
            .collect();
        let mut placed: Vec<(usize, T)> = self.order.iter().copied().zip(sorted.into_iter().flatten()).collect();
        placed.par_sort_unstable_by_key(|(index, _)| *index);
        placed.into_iter().map(|(_, result)| result).collect()
    }

    fn around(&self, start: usize) -> Around {
        let [x, y, z] = self.keys[start];
        let mut ranges = Vec::with_capacity(9);
        for column in [x.saturating_sub(1), x, x.saturating_add(1)] {
            for row in [y.saturating_sub(1), y, y.saturating_add(1)] {
                let first = self
                    .keys
                    .partition_point(|key| *key < [column, row, z.saturating_sub(1)]);
                let last = [column, row, z.saturating_add(1)];
                let count = self.keys[first..].iter().take_while(|key| **key <= last).count();
                if count > 0 {
                    ranges.push(first..first + count);
                }
            }
        }
        let count: usize = ranges.iter().map(Range::len).sum();
        Around {
            ranges,
            step: count.div_ceil(AROUND_MAX_COUNT).max(1),
        }
    }
}

/// The places of the points around a point.
pub(super) struct Around {
    ranges: Vec<Range<usize>>,
    step: usize,
}

impl Around {
    pub(super) fn places(&self) -> impl Iterator<Item = usize> {
        self.ranges.iter().cloned().flatten().step_by(self.step)
    }
}

/// Bounds the work where points heap up in one place.
const AROUND_MAX_COUNT: usize = 2000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_points_within_the_width_are_around() {
        let golden = 0.618_033_988_749_895;
        let points: Vec<Point3<f64>> = (0..500)
            .map(|i| {
                let i = f64::from(i);
                Point3::new(
                    (i * golden).fract(),
                    (i * 0.414_213_56).fract(),
                    (i * 0.732_050_8).fract(),
                )
            })
            .collect();
        let cells = Cells::new(&points, 0.2);
        let counts = cells.map(|place, around| {
            let middle = points[cells.order()[place]];
            let near = around.places().map(|place| points[cells.order()[place]]);
            near.filter(|point| (point - middle).norm() <= 0.2).count()
        });
        for (point, count) in points.iter().zip(counts) {
            let expected = points.iter().filter(|other| (*other - point).norm() <= 0.2).count();
            assert_eq!(count, expected);
        }
    }
}
