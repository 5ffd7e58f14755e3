//! Points sorted into cubes, for sums over all points within a radius of each.

use nalgebra::Point3;
use rayon::prelude::*;

/// The indices of the points, cube by cube of this positive, finite width: what is near is soon to follow, which spares
/// memory the work where every point is looked up in another cloud.
pub(crate) fn cube_order(points: &[Point3<f64>], width: f64) -> Vec<usize> {
    Cells::new(points, width).order
}

/// Cubes as wide as the radius: what is within it of a point lies in the point's cube and the 26 around it.
pub(super) struct Cells {
    radius: f64,
    /// The points' indices, cube by cube.
    order: Vec<usize>,
    /// The points in that order.
    points: Vec<Point3<f64>>,
    /// The cubes that hold points, ascending by [`key`].
    keys: Vec<u64>,
    /// Where in `order` each cube starts, and the end.
    starts: Vec<usize>,
}

impl Cells {
    /// `radius` must be positive and finite.
    pub(super) fn new(points: &[Point3<f64>], radius: f64) -> Self {
        let low = points
            .iter()
            .fold(Point3::from([f64::MAX; 3]), |low, point| low.inf(point));
        let mut keyed: Vec<(u64, usize)> = points
            .iter()
            .enumerate()
            .map(|(index, point)| {
                let cube = ((point - low) / radius).map(|value| (value as u64).min(CUBE_MAX) + 1);
                (key(cube.x, cube.y, cube.z), index)
            })
            .collect();
        keyed.par_sort_unstable();
        let (mut keys, mut starts) = (Vec::new(), Vec::new());
        for (at, (key, _)) in keyed.iter().enumerate() {
            if keys.last() != Some(key) {
                keys.push(*key);
                starts.push(at);
            }
        }
        starts.push(keyed.len());
        let order: Vec<usize> = keyed.into_iter().map(|(_, index)| index).collect();
        Self {
            radius,
            points: order.iter().map(|&index| points[index]).collect(),
            order,
            keys,
            starts,
        }
    }

    /// The points' indices, cube by cube.
    pub(super) fn order(&self) -> &[usize] {
        &self.order
    }

    /// The points in that order.
    pub(super) fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Applies `work` to every point, cube by cube: to its place in `order` and to what is around it. The results are in
    /// the order in which the points were given.
    pub(super) fn map<T: Copy + Send>(&self, work: impl Fn(usize, &Around) -> T + Sync) -> Vec<T> {
        let chunks: Vec<Vec<T>> = (0..self.keys.len().div_ceil(CHUNK_COUNT))
            .into_par_iter()
            .map(|chunk| {
                let first = chunk * CHUNK_COUNT;
                let mut around = Around::default();
                let mut results = Vec::new();
                for cube in first..(first + CHUNK_COUNT).min(self.keys.len()) {
                    self.gather(self.keys[cube], &mut around);
                    for place in self.starts[cube]..self.starts[cube + 1] {
                        around.measure(&self.points[place], self.radius);
                        results.push(work(place, &around));
                    }
                }
                results
            })
            .collect();
        let sorted = chunks.concat();
        let mut place_of = vec![0; self.order.len()];
        for (place, &index) in self.order.iter().enumerate() {
            place_of[index] = place;
        }
        place_of.into_iter().map(|place| sorted[place]).collect()
    }

    /// The points in a cube and in those around it: three cubes along the last axis are one range.
    fn gather(&self, middle: u64, around: &mut Around) {
        let mut ranges = [const { 0..0 }; 9];
        let mut count = 0;
        for (range, column) in ranges.iter_mut().zip(0..9) {
            let first = middle + key(column / 3, column % 3, 0) - key(1, 1, 1);
            let begin = self.keys.partition_point(|key| *key < first);
            let cubes = self.keys[begin..].iter().take_while(|key| **key <= first + 2).count();
            *range = self.starts[begin]..self.starts[begin + cubes];
            count += range.len();
        }
        let step = count.div_ceil(AROUND_MAX_COUNT).max(1);
        around.places.clear();
        if step == 1 {
            ranges.into_iter().for_each(|range| around.places.extend(range));
        } else {
            around.places.extend(ranges.into_iter().flatten().step_by(step));
        }
        for axis in 0..3 {
            let values = around.places.iter().map(|&place| self.points[place][axis]);
            around.coordinates[axis].clear();
            around.coordinates[axis].extend(values);
        }
    }
}

/// The number of a cube, ascending along the last axis first. No coordinate is 0 or the largest of 21 bits, so that those
/// around it have numbers too.
fn key(x: u64, y: u64, z: u64) -> u64 {
    (x << 42) + (y << 21) + z
}

/// The points in a point's cube and those around it, an even choice of them where they are very many.
#[derive(Default)]
pub(super) struct Around {
    places: Vec<usize>,
    coordinates: [Vec<f64>; 3],
    /// The squared distance of each from the point.
    squared: Vec<f64>,
    near: Vec<usize>,
}

impl Around {
    /// The places of those within the radius of the point, itself among them.
    pub(super) fn near(&self) -> &[usize] {
        &self.near
    }

    /// The places of the `count` nearest of those around and the distance of the farthest of these; `None` when there are
    /// not as many. Beyond the radius nearer ones may lie farther than around.
    pub(super) fn nearest(&self, count: usize) -> Option<(Vec<usize>, f64)> {
        if count == 0 || self.places.len() < count {
            return None;
        }
        let mut all: Vec<(f64, usize)> = self.squared.iter().copied().zip(self.places.iter().copied()).collect();
        let by_distance = |a: &(f64, usize), b: &(f64, usize)| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1));
        let (_, &mut (farthest, _), _) = all.select_nth_unstable_by(count - 1, by_distance);
        all.truncate(count);
        all.sort_unstable_by(by_distance);
        Some((all.into_iter().map(|(_, place)| place).collect(), farthest.sqrt()))
    }

    fn measure(&mut self, middle: &Point3<f64>, radius: f64) {
        let [xs, ys, zs] = &self.coordinates;
        self.squared.clear();
        let squared = xs.iter().zip(ys).zip(zs).map(|((x, y), z)| {
            let (x, y, z) = (x - middle.x, y - middle.y, z - middle.z);
            x * x + y * y + z * z
        });
        self.squared.extend(squared);
        // Without a branch: every third point is near, in no order that could be foretold.
        self.near.resize(self.places.len(), 0);
        let mut count = 0;
        for (place, squared) in self.places.iter().zip(&self.squared) {
            self.near[count] = *place;
            count += usize::from(*squared <= radius * radius);
        }
        self.near.truncate(count);
    }
}

/// Cubes that are one piece of work.
const CHUNK_COUNT: usize = 64;
/// Farther cubes along an axis are one.
const CUBE_MAX: u64 = (1 << 21) - 3;
/// Bounds the work where points heap up in one place.
const AROUND_MAX_COUNT: usize = 2000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_in_cube_order_are_next_to_each_other_and_all_there() {
        let points: Vec<Point3<f64>> = (0..600)
            .map(|i| Point3::new(f64::from(i * 7 % 600), 0.0, 0.0))
            .collect();
        let order = cube_order(&points, 10.0);
        assert!(
            order
                .windows(2)
                .all(|pair| (points[pair[0]] - points[pair[1]]).norm() < 20.0)
        );
        let mut all = order;
        all.sort_unstable();
        assert_eq!(all, (0..600).collect::<Vec<_>>());
        assert!(cube_order(&[], 1.0).is_empty());
    }

    #[test]
    fn the_nearest_of_those_around_reach_beyond_the_radius() {
        let points: Vec<Point3<f64>> = (0..40).map(|i| Point3::new(f64::from(i) * 0.9, 0.0, 0.0)).collect();
        let cells = Cells::new(&points, 1.0);
        let found = cells.map(|_, around| {
            let near = around.near().len();
            let farthest = around.nearest(4).map_or(0.0, |(_, distance)| distance);
            (near, farthest, around.nearest(40).is_none())
        });
        // Itself and its neighbours; the fourth is two steps away.
        assert_eq!(found[20].0, 3);
        assert!((found[20].1 - 1.8).abs() < 1e-9 && found[20].2, "{:?}", found[20]);
    }

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
        let counts = cells.map(|_, around| around.near().len());
        for (point, count) in points.iter().zip(counts) {
            let expected = points.iter().filter(|other| (*other - point).norm() <= 0.2).count();
            assert_eq!(count, expected);
        }
    }
}
