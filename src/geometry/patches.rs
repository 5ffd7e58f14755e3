//! Smooth patches: the surface at each point of a cloud, free of most of its noise.

use nalgebra::{Point3, Vector3};

use super::PointCloud;
use super::cells::Cells;
use super::nearest::NearestPoints;
use super::normals::{agreement, tangents};

/// The surface near one point, from a second-order fit to the points around it.
///
/// A plane would pull a curved surface inwards, by an amount that depends on the density of the points; a second-order
/// surface does so only where the surface bends a lot within the radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Patch {
    /// The point moved along its normal onto the fitted surface; the point itself where no surface could be fitted.
    pub position: Point3<f64>,
    /// The surface's unit normal there, on the side of the cloud's own normal; that one where no surface could be fitted.
    pub normal: Vector3<f64>,
    /// How far the normal turns within the radius, rad: the product of radius and curvature. Infinite without a fit.
    pub bend_rad: f64,
    /// Variance of the position along the normal over that of the measured points; infinite without a fit.
    pub variance_share: f64,
}

/// Fits a patch at each of the points `indices` of `cloud` to the points of `indices` that lie within `radius` on the
/// same side of the same sheet, in the order of `indices`.
///
/// Where fewer than twelve lie within `radius`, the nearest twelve of those around take part, or of all points in `tree`,
/// which holds the cloud's. `cloud` needs normals (without them there are no patches at all); their sign counts if
/// `oriented`. The work grows with the number of points within the radius.
pub fn patches(cloud: &PointCloud, tree: &NearestPoints, indices: &[usize], radius: f64, oriented: bool) -> Vec<Patch> {
    let Some(normals) = cloud.normals() else {
        return Vec::new();
    };
    let points = cloud.points();
    let member = |index: usize| Member {
        position: points[index],
        normal: normals[index],
    };
    if indices.is_empty() || radius <= 0.0 || !radius.is_finite() {
        return indices.iter().map(|&index| member(index).alone()).collect();
    }
    let at: Vec<Point3<f64>> = indices.iter().map(|&index| points[index]).collect();
    let cells = Cells::new(&at, radius);
    let members: Vec<Member> = cells.order().iter().map(|&place| member(indices[place])).collect();
    cells.map(|place, around| {
        let middle = &members[place];
        let mut fit = Fit::new(middle, oriented, radius);
        if around.near().len() >= NEIGHBOUR_MIN_COUNT {
            around.near().iter().for_each(|&place| fit.add(&members[place]));
        } else if let Some((nearest, radius)) = around.nearest(NEIGHBOUR_MIN_COUNT) {
            fit = Fit::new(middle, oriented, radius);
            nearest.iter().for_each(|&place| fit.add(&members[place]));
        } else {
            let nearest = tree.nearest_many(&middle.position, NEIGHBOUR_MIN_COUNT);
            let radius = nearest.last().map_or(radius, |last| last.distance);
            fit = Fit::new(middle, oriented, radius);
            nearest.iter().for_each(|found| fit.add(&member(found.index)));
        }
        fit.patch().unwrap_or_else(|| middle.alone())
    })
}

#[derive(Clone, Copy)]
struct Member {
    position: Point3<f64>,
    normal: Vector3<f64>,
}

impl Member {
    fn alone(&self) -> Patch {
        Patch {
            position: self.position,
            normal: self.normal,
            bend_rad: f64::INFINITY,
            variance_share: f64::INFINITY,
        }
    }
}

/// A patch in the making, of points within the radius.
struct Fit<'a> {
    middle: &'a Member,
    oriented: bool,
    radius: f64,
    /// The tangents, and the normal, over the radius.
    axes: [Vector3<f64>; 3],
    moments: Moments,
}

impl<'a> Fit<'a> {
    fn new(middle: &'a Member, oriented: bool, radius: f64) -> Self {
        let [right, ahead] = tangents(&middle.normal);
        Self {
            middle,
            oriented,
            radius,
            axes: [right, ahead, middle.normal].map(|axis| axis / radius),
            moments: Moments::default(),
        }
    }

    /// Adds a point if it is of the same sheet.
    #[inline]
    fn add(&mut self, other: &Member) {
        let offset = other.position - self.middle.position;
        let [u, v, height] = self.axes.map(|axis| axis.dot(&offset));
        let cosine = agreement(&self.middle.normal, &other.normal, self.oriented);
        if cosine >= SAME_SHEET_COSINE && height.abs() <= HEIGHT_MAX {
            self.moments.add(u, v, height);
        }
    }

    fn patch(&self) -> Option<Patch> {
        if self.moments.count < NEIGHBOUR_MIN_COUNT {
            return None;
        }
        let factors = Factors::of(self.moments.matrix())?;
        let [height, slope_u, slope_v, uu, uv, vv] = factors.solve(&self.moments.heights);
        let [right, ahead, up] = self.axes.map(|axis| axis * self.radius);
        let patch = Patch {
            position: self.middle.position + up * (height * self.radius),
            normal: (up - right * slope_u - ahead * slope_v).try_normalize(0.0)?,
            bend_rad: 2.0 * (uu * uu + vv * vv + 0.5 * uv * uv).sqrt(),
            variance_share: factors.first_variance(),
        };
        (height.abs() < HEIGHT_MAX && patch.bend_rad.is_finite()).then_some(patch)
    }
}

/// The Cholesky factor of a symmetric matrix of six unknowns, the inverse of its diagonal in place of the diagonal.
struct Factors([[f64; 6]; 6]);

impl Factors {
    /// `None` unless the matrix, of which the lower triangle is read, is positive definite.
    fn of(mut rows: [[f64; 6]; 6]) -> Option<Self> {
        for row in 0..6 {
            for column in 0..=row {
                let products = rows[row][..column].iter().zip(&rows[column]).map(|(a, b)| a * b);
                let sum = rows[row][column] - products.sum::<f64>();
                rows[row][column] = if column < row {
                    sum * rows[column][column]
                } else if sum > 0.0 {
                    1.0 / sum.sqrt()
                } else {
                    return None;
                };
            }
        }
        Some(Self(rows))
    }

    fn solve(&self, right_side: &[f64; 6]) -> [f64; 6] {
        let Self(rows) = self;
        let mut solution = self.forward(right_side);
        for row in (0..6).rev() {
            for below in row + 1..6 {
                solution[row] -= rows[below][row] * solution[below];
            }
            solution[row] *= rows[row][row];
        }
        solution
    }

    fn forward(&self, right_side: &[f64; 6]) -> [f64; 6] {
        let Self(rows) = self;
        let mut solution = *right_side;
        for row in 0..6 {
            for before in 0..row {
                solution[row] -= rows[row][before] * solution[before];
            }
            solution[row] *= rows[row][row];
        }
        solution
    }

    /// The first element of the inverse matrix.
    fn first_variance(&self) -> f64 {
        let first = self.forward(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        first.iter().map(|value| value * value).sum()
    }
}

/// Sums of the products that a second-order fit needs: of `u^a v^b` up to the fourth power, and of these with the height.
#[derive(Default)]
struct Moments {
    count: usize,
    first: [f64; 2],
    second: [f64; 3],
    third: [f64; 4],
    fourth: [f64; 5],
    heights: [f64; 6],
}

impl Moments {
    #[inline]
    fn add(&mut self, u: f64, v: f64, height: f64) {
        let (uu, uv, vv) = (u * u, u * v, v * v);
        self.count += 1;
        for (sum, value) in self.first.iter_mut().zip([u, v]) {
            *sum += value;
        }
        for (sum, value) in self.second.iter_mut().zip([uu, uv, vv]) {
            *sum += value;
        }
        for (sum, value) in self.third.iter_mut().zip([uu * u, uu * v, u * vv, vv * v]) {
            *sum += value;
        }
        let fourth = [uu * uu, uu * uv, uu * vv, uv * vv, vv * vv];
        for (sum, value) in self.fourth.iter_mut().zip(fourth) {
            *sum += value;
        }
        for (sum, value) in self.heights.iter_mut().zip([1.0, u, v, uu, uv, vv]) {
            *sum += value * height;
        }
    }

    /// The normal matrix of the unknowns `1 u v u² uv v²`.
    fn matrix(&self) -> [[f64; 6]; 6] {
        let n = self.count as f64;
        let [u, v] = self.first;
        let [uu, uv, vv] = self.second;
        let [u3, uuv, uvv, v3] = self.third;
        let [u4, u3v, u2v2, uv3, v4] = self.fourth;
        [
            [n, u, v, uu, uv, vv],
            [u, uu, uv, u3, uuv, uvv],
            [v, uv, vv, uuv, uvv, v3],
            [uu, u3, uuv, u4, u3v, u2v2],
            [uv, uuv, uvv, u3v, u2v2, uv3],
            [vv, uvv, v3, u2v2, uv3, v4],
        ]
    }
}

/// Least cosine between the normals of one sheet: the sides of a thin wall are two.
const SAME_SHEET_COSINE: f64 = 0.5;
/// A point farther off the tangent plane than this, over the radius, is an outlier or of another sheet.
const HEIGHT_MAX: f64 = 0.5;
/// Six unknowns, and some points to spare.
const NEIGHBOUR_MIN_COUNT: usize = 12;

#[cfg(test)]
mod tests {
    use super::*;

    /// A paraboloid of curvatures 0.5 and -0.2, about 10,000 points, 0.02 apart, `noise` up and down.
    fn saddle(noise: f64) -> PointCloud {
        let golden = 0.618_033_988_749_895;
        let points = (0..10_000).map(|i| {
            let (u, v) = (f64::from(i % 100) / 50.0 - 1.0, f64::from(i / 100) / 50.0 - 1.0);
            let up = noise * (2.0 * (f64::from(i) * golden).fract() - 1.0);
            Point3::new(u, v, height(u, v) + up)
        });
        let cloud = PointCloud::from_measured(points).cloud;
        let up = vec![Vector3::z(); cloud.len()];
        cloud.with_normals(up).unwrap()
    }

    fn fitted(cloud: &PointCloud, radius: f64, oriented: bool) -> Vec<Patch> {
        let all: Vec<usize> = (0..cloud.len()).collect();
        patches(cloud, &NearestPoints::new(cloud.points()), &all, radius, oriented)
    }

    fn height(u: f64, v: f64) -> f64 {
        0.25 * u * u - 0.1 * v * v
    }

    #[test]
    fn patches_of_a_noisy_saddle_lie_on_it() {
        let cloud = saddle(0.01);
        let fitted = fitted(&cloud, 0.06, true);
        let (mut before, mut after, mut count) = (0.0, 0.0, 0);
        for (point, patch) in cloud.points().iter().zip(&fitted) {
            if point.x.abs() > 0.9 || point.y.abs() > 0.9 {
                continue;
            }
            before += (point.z - height(point.x, point.y)).powi(2);
            after += (patch.position.z - height(patch.position.x, patch.position.y)).powi(2);
            let normal = Vector3::new(-0.5 * point.x, 0.2 * point.y, 1.0).normalize();
            assert!(normal.dot(&patch.normal) > 0.97, "{patch:?}");
            count += 1;
        }
        assert!(count > 8000 && after < 0.4 * before, "{count} {before} {after}");
    }

    #[test]
    fn the_bend_is_the_turn_of_the_normal_within_the_radius() {
        let cloud = saddle(0.0);
        let middle = 50 * 100 + 50;
        let patch = fitted(&cloud, 0.1, true)[middle];
        assert!((patch.position - cloud.points()[middle]).norm() < 1e-9);
        // Curvatures 0.5 and -0.2 over a radius of 0.1.
        assert!((patch.bend_rad - 0.1 * 0.5f64.hypot(0.2)).abs() < 1e-6, "{patch:?}");
    }

    #[test]
    fn on_a_line_the_points_stay_where_they_are() {
        let line = PointCloud::from_measured((0..100).map(|i| Point3::new(f64::from(i), 0.0, 0.0))).cloud;
        assert!(fitted(&line, 20.0, false).is_empty());
        let line = line.with_normals(vec![Vector3::z(); 100]).unwrap();
        for (point, patch) in line.points().iter().zip(fitted(&line, 20.0, false)) {
            assert_eq!((patch.position, patch.normal), (*point, Vector3::z()));
            assert!(patch.variance_share.is_infinite());
        }
    }

    #[test]
    fn where_points_are_few_the_nearest_ones_are_taken() {
        let cloud = saddle(0.0);
        let patch = fitted(&cloud, 0.021, true)[5050];
        assert!(
            (patch.position - cloud.points()[5050]).norm() < 1e-9 && patch.variance_share < 0.7,
            "{patch:?}"
        );
    }

    #[test]
    fn a_wall_near_by_does_not_bend_a_patch() {
        let sheet = saddle(0.0);
        let behind = sheet.points().iter().map(|point| point - Vector3::z() * 0.03);
        let both = PointCloud::from_measured(sheet.points().iter().copied().chain(behind)).cloud;
        let normals = (0..both.len()).map(|i| Vector3::z() * if i < sheet.len() { 1.0 } else { -1.0 });
        let both = both.clone().with_normals(normals.collect()).unwrap();
        let (alone, beside) = (fitted(&sheet, 0.1, true), fitted(&both, 0.1, true));
        assert!((alone[5050].position - beside[5050].position).norm() < 1e-12);
        assert!((alone[5050].normal - beside[5050].normal).norm() < 1e-12);
    }
}
