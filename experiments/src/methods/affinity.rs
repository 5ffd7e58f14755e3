//! The expectation step of every mixture: how strongly fixed *centres* claim the points of another cloud, the *lookers*.
//!
//! For each looker x the sums `Σ_j w_j g(x, y_j)` of mass, offset `y_j − x` and squared distance over the centres, all
//! that a rigid maximisation step needs: O(1) memory a looker, no matrix of pairs. Centres lie in blocks of neighbours (the
//! leaves of a kd-tree); blocks farther than [`REACH_SIGMAS`] from a group of lookers are left out, so that the sum is
//! exact while σ is large and short when it is small. Results come in the lookers' order, whatever the number of threads.

use bladescan::geometry::simd::{Kernel, LANE_COUNT, Work};
use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use super::exponential::exp;

/// How strongly a centre claims a point.
pub(crate) trait Attraction: Copy + Sync {
    /// Whether the normals count.
    const IS_ORIENTED: bool;

    /// Standard deviation of the position.
    fn sigma(&self) -> f64;

    /// The claims of a centre with its normal as it is and reversed, for a squared distance and the cosine between the
    /// normals.
    fn claims(&self, squared: f64, cosine: f64) -> (f64, f64);
}

/// An isotropic Gaussian `exp(−d² / 2σ²)`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gaussian {
    /// Standard deviation on each axis.
    pub(crate) sigma: f64,
}

impl Attraction for Gaussian {
    const IS_ORIENTED: bool = false;

    fn sigma(&self) -> f64 {
        self.sigma
    }

    #[inline(always)]
    fn claims(&self, squared: f64, _cosine: f64) -> (f64, f64) {
        (exp(squared * (-0.5 / (self.sigma * self.sigma))), 0.0)
    }
}

/// What all centres are to one looker.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Claim {
    /// `Σ w g`.
    pub(crate) mass: f64,
    /// `Σ w g (y − x)`, in the centres' frame.
    pub(crate) offset: Vector3<f64>,
    /// `Σ w g |y − x|²`.
    pub(crate) squared: f64,
    /// `Σ w (g⁺ − g⁻) n`, in the centres' frame; zero unless the attraction is oriented.
    pub(crate) normal: Vector3<f64>,
}

impl Claim {
    /// All sums times `factor`.
    pub(crate) fn scaled(&self, factor: f64) -> Self {
        Self {
            mass: self.mass * factor,
            offset: self.offset * factor,
            squared: self.squared * factor,
            normal: self.normal * factor,
        }
    }
}

/// Fixed points that claim others.
pub(crate) struct Centres {
    order: Vec<usize>,
    blocks: Vec<Block>,
    balls: Vec<Ball>,
}

impl Centres {
    /// Centres of weight 1 without normals.
    pub(crate) fn new(points: &[Point3<f64>]) -> Self {
        Self::with_normals(points, &[])
    }

    /// Centres of weight 1; `normals` are as many as the points, or none.
    pub(crate) fn with_normals(points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Self {
        let order = coherent_order(points);
        let (mut blocks, mut balls) = (Vec::new(), Vec::new());
        for leaf in order.chunks(LANE_COUNT) {
            let mut block = Block::EMPTY;
            for (lane, &index) in leaf.iter().enumerate() {
                for axis in 0..3 {
                    block.place[axis][lane] = points[index][axis];
                    block.normal[axis][lane] = normals.get(index).map_or(0.0, |normal| normal[axis]);
                }
                block.weight[lane] = 1.0;
            }
            blocks.push(block);
            balls.push(Ball::about(leaf.iter().map(|&index| &points[index])));
        }
        Self { order, blocks, balls }
    }

    /// Gives each centre its weight, in the order in which the points were given.
    pub(crate) fn weigh(&mut self, weights: &[f64]) {
        for (block, leaf) in self.blocks.iter_mut().zip(self.order.chunks(LANE_COUNT)) {
            for (lane, &index) in leaf.iter().enumerate() {
                block.weight[lane] = weights[index];
            }
        }
    }

    /// The claims on each looker as `pose` (centres_from_lookers) places it, in the lookers' order.
    pub(crate) fn claims<A: Attraction>(&self, lookers: &Lookers, pose: &Isometry3<f64>, attraction: A) -> Vec<Claim> {
        let reach = REACH_SIGMAS * attraction.sigma();
        let kernel = Kernel::fastest();
        lookers
            .groups
            .par_iter()
            .map(|group| {
                let range = group.first..group.end;
                let placed: Vec<Point3<f64>> = lookers.points[range.clone()].iter().map(|x| pose * x).collect();
                let normals: Vec<Vector3<f64>> = match lookers.normals.get(range) {
                    Some(normals) => normals.iter().map(|normal| pose * normal).collect(),
                    None => vec![Vector3::zeros(); placed.len()],
                };
                let middle = pose * group.ball.centre;
                let near = |ball: &Ball| (ball.centre - middle).norm() <= reach + ball.radius + group.ball.radius;
                let (blocks, balls) = (self.blocks.iter(), self.balls.iter());
                let list: Vec<&Block> = blocks
                    .zip(balls)
                    .filter(|pair| near(pair.1))
                    .map(|pair| pair.0)
                    .collect();
                kernel.run(Claims {
                    blocks: &list,
                    points: &placed,
                    normals: &normals,
                    attraction,
                })
            })
            .collect::<Vec<_>>()
            .concat()
    }
}

/// Points that look at centres, in groups of neighbours.
pub(crate) struct Lookers {
    points: Vec<Point3<f64>>,
    normals: Vec<Vector3<f64>>,
    order: Vec<usize>,
    groups: Vec<Group>,
}

impl Lookers {
    /// Lookers without normals.
    pub(crate) fn new(points: &[Point3<f64>]) -> Self {
        Self::with_normals(points, &[])
    }

    /// Lookers; `normals` are as many as the points, or none.
    pub(crate) fn with_normals(points: &[Point3<f64>], normals: &[Vector3<f64>]) -> Self {
        let order = coherent_order(points);
        Self::ordered(points, normals, order)
    }

    /// Every `step`-th point: neighbours follow each other, so what is left is spread as the whole is.
    pub(crate) fn thinned(&self, step: usize) -> Self {
        Self::ordered(
            &self.points,
            &self.normals,
            (0..self.points.len()).step_by(step.max(1)).collect(),
        )
    }

    fn ordered(points: &[Point3<f64>], normals: &[Vector3<f64>], order: Vec<usize>) -> Self {
        let points: Vec<Point3<f64>> = order.iter().map(|&index| points[index]).collect();
        let normals = order.iter().filter_map(|&index| normals.get(index).copied()).collect();
        let groups = points
            .chunks(GROUP_COUNT)
            .enumerate()
            .map(|(number, group)| Group {
                first: number * GROUP_COUNT,
                end: number * GROUP_COUNT + group.len(),
                ball: Ball::about(group.iter()),
            })
            .collect();
        Self {
            points,
            normals,
            order,
            groups,
        }
    }

    /// The points, in the order in which the claims come.
    pub(crate) fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Their normals, in the same order.
    pub(crate) fn normals(&self) -> &[Vector3<f64>] {
        &self.normals
    }

    /// The place of each of them among the points that were given.
    pub(crate) fn order(&self) -> &[usize] {
        &self.order
    }
}

struct Group {
    first: usize,
    end: usize,
    ball: Ball,
}

/// Centres side by side; unused lanes weigh nothing.
struct Block {
    place: [[f64; LANE_COUNT]; 3],
    normal: [[f64; LANE_COUNT]; 3],
    weight: [f64; LANE_COUNT],
}

impl Block {
    const EMPTY: Self = Self {
        place: [[0.0; LANE_COUNT]; 3],
        normal: [[0.0; LANE_COUNT]; 3],
        weight: [0.0; LANE_COUNT],
    };
}

struct Ball {
    centre: Point3<f64>,
    radius: f64,
}

impl Ball {
    fn about<'a>(points: impl Iterator<Item = &'a Point3<f64>> + Clone) -> Self {
        let count = points.clone().count().max(1) as f64;
        let centre = Point3::from(points.clone().map(|point| point.coords).sum::<Vector3<f64>>() / count);
        let radius = points.map(|point| (point - centre).norm()).fold(0.0, f64::max);
        Self { centre, radius }
    }
}

struct Claims<'a, A> {
    blocks: &'a [&'a Block],
    points: &'a [Point3<f64>],
    normals: &'a [Vector3<f64>],
    attraction: A,
}

impl<A: Attraction> Work for Claims<'_, A> {
    type Output = Vec<Claim>;

    #[inline(always)]
    fn run(self) -> Vec<Claim> {
        let mut found = Vec::with_capacity(self.points.len());
        for (point, normal) in self.points.iter().zip(self.normals) {
            found.push(claim(self.blocks, point, normal, self.attraction));
        }
        found
    }
}

#[inline(always)]
fn claim<A: Attraction>(blocks: &[&Block], point: &Point3<f64>, normal: &Vector3<f64>, attraction: A) -> Claim {
    let mut sums = [[0.0; LANE_COUNT]; 8];
    for block in blocks {
        #[expect(clippy::needless_range_loop, reason = "one lane of eight sums and seven columns")]
        for lane in 0..LANE_COUNT {
            let x = block.place[0][lane] - point.x;
            let y = block.place[1][lane] - point.y;
            let z = block.place[2][lane] - point.z;
            let squared = x * x + y * y + z * z;
            let mut cosine = 0.0;
            if A::IS_ORIENTED {
                cosine = block.normal[0][lane] * normal.x
                    + block.normal[1][lane] * normal.y
                    + block.normal[2][lane] * normal.z;
            }
            let (ahead, reversed) = attraction.claims(squared, cosine);
            let mass = (ahead + reversed) * block.weight[lane];
            sums[0][lane] += mass;
            sums[1][lane] += mass * x;
            sums[2][lane] += mass * y;
            sums[3][lane] += mass * z;
            sums[4][lane] += mass * squared;
            if A::IS_ORIENTED {
                let signed = (ahead - reversed) * block.weight[lane];
                sums[5][lane] += signed * block.normal[0][lane];
                sums[6][lane] += signed * block.normal[1][lane];
                sums[7][lane] += signed * block.normal[2][lane];
            }
        }
    }
    let total = |index: usize| sums[index].iter().sum::<f64>();
    Claim {
        mass: total(0),
        offset: Vector3::new(total(1), total(2), total(3)),
        squared: total(4),
        normal: Vector3::new(total(5), total(6), total(7)),
    }
}

/// An order in which points that follow each other are neighbours: that of the leaves of a kd-tree, all but the last full.
fn coherent_order(points: &[Point3<f64>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    split(points, &mut order);
    order
}

fn split(points: &[Point3<f64>], order: &mut [usize]) {
    if order.len() <= LANE_COUNT {
        return;
    }
    let extent = |axis: usize| {
        let values = order.iter().map(|&index| points[index][axis]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        high - low
    };
    let axis = (1..3).fold(0, |best, axis| if extent(axis) > extent(best) { axis } else { best });
    let middle = (order.len() / 2).next_multiple_of(LANE_COUNT);
    if middle < order.len() {
        order.select_nth_unstable_by(middle, |&a, &b| {
            points[a][axis].total_cmp(&points[b][axis]).then(a.cmp(&b))
        });
    }
    let (low, high) = order.split_at_mut(middle.min(order.len()));
    split(points, low);
    split(points, high);
}

/// Beyond it a claim is below 2e-16 of that of a centre in the same place.
const REACH_SIGMAS: f64 = 8.5;

/// Lookers that share one list of blocks.
const GROUP_COUNT: usize = 16;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::testing;

    #[test]
    fn claims_are_those_of_all_pairs_for_wide_and_narrow_gaussians() {
        let (points, others) = (testing::wedge(300, 1), testing::wedge(250, 2));
        let pose = testing::motion(20.0, [0.1, 0.0, -0.1]);
        let (centres, lookers) = (Centres::new(&points), Lookers::new(&others));
        for sigma in [1.0, 0.1, 0.01] {
            let claims = centres.claims(&lookers, &pose, Gaussian { sigma });
            for (claim, looker) in claims.iter().zip(lookers.points()) {
                let looker = pose * looker;
                let (mut mass, mut offset) = (0.0, Vector3::zeros());
                for point in &points {
                    let apart = point - looker;
                    let g = (-apart.norm_squared() / (2.0 * sigma * sigma)).exp();
                    mass += g;
                    offset += apart * g;
                }
                assert!((claim.mass - mass).abs() < 1e-10 * mass + 1e-13, "{sigma}");
                assert!((claim.offset - offset).norm() < 1e-10 * mass + 1e-13, "{sigma}");
            }
        }
    }

    #[test]
    fn weights_and_places_follow_the_order_in_which_the_points_were_given() {
        let points = testing::wedge(100, 3);
        let mut centres = Centres::new(&points);
        let weights: Vec<f64> = (0..100).map(f64::from).collect();
        centres.weigh(&weights);
        let lookers = Lookers::new(&points);
        let claims = centres.claims(&lookers, &Isometry3::identity(), Gaussian { sigma: 1e-4 });
        for (claim, &index) in claims.iter().zip(lookers.order()) {
            assert!((claim.mass - weights[index]).abs() < 1e-9);
        }
    }
}
