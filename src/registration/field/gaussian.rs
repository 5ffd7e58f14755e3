//! The Gaussian affinity of a fixed cloud: how strongly each of its points claims a point of another cloud.
//!
//! `g_ij = m_i exp(−|x_i − y_j|² / 2σ²)`, summed over the fixed points `x_i` with its first moment and the second one's
//! trace: all that the likelihood of a mixture of Gaussians and its gradient need. Fixed points farther than
//! [`REACH_SIGMAS`] from a group of points that look at them are left out. The exponential is a fixed polynomial and
//! nothing is fused, so all kernels give the same bits.

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use super::kernel::{Block, Kernel, LANE_COUNT, Work, total};
use super::tree::{Ball, coherent_order};

/// Fixed points, each with a mass.
pub(crate) struct Gaussians {
    blocks: Vec<Block>,
    balls: Vec<Ball>,
    kernel: Kernel,
}

/// What the fixed points are to a point `y`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Affinity {
    /// `Σ g_i`.
    pub(crate) sum: f64,
    /// `Σ g_i (x_i − y)`.
    pub(crate) offset: Vector3<f64>,
    /// `Σ g_i |x_i − y|²`.
    pub(crate) squared: f64,
}

/// Points in an order in which neighbours are neighbours in space, in groups that look at the fixed points together.
pub(crate) struct Lookers {
    points: Vec<Point3<f64>>,
    balls: Vec<Ball>,
}

impl Gaussians {
    /// Coordinates are rounded to single precision: give them centred and of the order of one. Without masses all are 1.
    pub(crate) fn new(points: &[Point3<f64>], masses: Option<&[f64]>) -> Self {
        let order = coherent_order(points);
        let (mut blocks, mut balls) = (Vec::new(), Vec::new());
        for leaf in order.chunks(LANE_COUNT) {
            let mut block = Block::EMPTY;
            for (lane, &index) in leaf.iter().enumerate() {
                let mass = masses.map_or(1.0, |masses| masses[index]);
                block.put(lane, &points[index].cast::<f32>(), mass as f32);
            }
            blocks.push(block);
            balls.push(Ball::about(leaf.iter().map(|&index| &points[index])));
        }
        Self {
            blocks,
            balls,
            kernel: Kernel::fastest(),
        }
    }

    /// The affinity to each of the points as `pose` places them, in their order.
    pub(crate) fn affinities(&self, lookers: &Lookers, pose: &Isometry3<f64>, sigma: f64) -> Vec<Affinity> {
        lookers
            .points
            .par_chunks(GROUP_COUNT)
            .zip(&lookers.balls)
            .map_init(Vec::new, |list, (group, ball)| {
                let placed: Vec<Point3<f64>> = group.iter().map(|point| pose * point).collect();
                self.gather(&(pose * ball.centre), ball.radius + REACH_SIGMAS * sigma, list);
                self.kernel.run(Affinities {
                    blocks: list,
                    points: &placed,
                    sigma,
                })
            })
            .collect::<Vec<_>>()
            .concat()
    }

    /// Fills `list` with the blocks within `reach` of `centre`.
    fn gather(&self, centre: &Point3<f64>, reach: f64, list: &mut Vec<Block>) {
        list.clear();
        for (block, ball) in self.blocks.iter().zip(&self.balls) {
            if (ball.centre - centre).norm_squared() <= (reach + ball.radius).powi(2) {
                list.push(*block);
            }
        }
    }
}

impl Lookers {
    /// The same points, ordered.
    pub(crate) fn new(points: &[Point3<f64>]) -> Self {
        let points: Vec<Point3<f64>> = coherent_order(points).into_iter().map(|index| points[index]).collect();
        let balls = points.chunks(GROUP_COUNT).map(Ball::about).collect();
        Self { points, balls }
    }

    /// In the order in which the affinities come.
    pub(crate) fn points(&self) -> &[Point3<f64>] {
        &self.points
    }
}

struct Affinities<'a> {
    blocks: &'a [Block],
    points: &'a [Point3<f64>],
    sigma: f64,
}

impl Work for Affinities<'_> {
    type Output = Vec<Affinity>;

    #[inline(always)]
    fn run(self) -> Vec<Affinity> {
        let exponent = (-std::f64::consts::LOG2_E / (2.0 * self.sigma * self.sigma)) as f32;
        let mut affinities = Vec::with_capacity(self.points.len());
        for point in self.points {
            affinities.push(affinity(self.blocks, point, exponent));
        }
        affinities
    }
}

/// `exponent` times a squared distance is the power of two that the affinity is.
#[inline(always)]
fn affinity(blocks: &[Block], point: &Point3<f64>, exponent: f32) -> Affinity {
    let at = point.cast::<f32>();
    let mut sum = [0.0f32; LANE_COUNT];
    let mut x = [0.0f32; LANE_COUNT];
    let mut y = [0.0f32; LANE_COUNT];
    let mut z = [0.0f32; LANE_COUNT];
    let mut squared = [0.0f32; LANE_COUNT];
    for block in blocks {
        for lane in 0..LANE_COUNT {
            let dx = block.x[lane] - at.x;
            let dy = block.y[lane] - at.y;
            let dz = block.z[lane] - at.z;
            let distance2 = dx * dx + dy * dy + dz * dz;
            let g = block.mass[lane] * power_of_two(distance2 * exponent);
            sum[lane] += g;
            x[lane] += g * dx;
            y[lane] += g * dy;
            z[lane] += g * dz;
            squared[lane] += g * distance2;
        }
    }
    Affinity {
        sum: total(&sum),
        offset: Vector3::new(total(&x), total(&y), total(&z)),
        squared: total(&squared),
    }
}

/// `2^t` for `t <= 0`, with a relative error below 3e-7; 2^-100 below -100, so that nothing is ever quite without a claim.
#[inline(always)]
fn power_of_two(t: f32) -> f32 {
    let t = if t > POWER_MIN { t } else { POWER_MIN };
    // Adding this number rounds to the nearest integer and leaves it in the lowest bits.
    let shifted = t + ROUND;
    let f = t - (shifted - ROUND);
    let mut p = POWERS[5];
    p = p * f + POWERS[4];
    p = p * f + POWERS[3];
    p = p * f + POWERS[2];
    p = p * f + POWERS[1];
    p = p * f + POWERS[0];
    p = p * f + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// Farther fixed points than this many standard deviations are left out.
pub(crate) const REACH_SIGMAS: f64 = 5.0;

/// Points that look at the fixed ones together.
const GROUP_COUNT: usize = 16;
const POWER_MIN: f32 = -100.0;
/// 1.5 · 2^23.
const ROUND: f32 = 12_582_912.0;
/// `(ln 2)^k / k!`, k = 1 to 6.
const POWERS: [f32; 6] = [
    std::f32::consts::LN_2,
    0.240_226_5,
    0.055_504_11,
    0.009_618_129,
    0.001_333_355_8,
    0.000_154_035_3,
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::looped;

    #[test]
    fn affinities_are_the_sums_over_all_pairs() {
        let fixed = looped(333, 0.0);
        let masses: Vec<f64> = (0..333).map(|i| f64::from(i % 7) - 2.0).collect();
        let pose = Isometry3::new(Vector3::new(0.1, -0.05, 0.02), Vector3::new(0.1, 0.2, -0.3));
        let lookers = Lookers::new(&looped(71, 0.2));
        for sigma in [0.02, 0.2, 2.0] {
            let found = Gaussians::new(&fixed, Some(&masses)).affinities(&lookers, &pose, sigma);
            for (point, found) in lookers.points().iter().zip(found) {
                let (mut sum, mut offset, mut squared, mut size) = (0.0, Vector3::zeros(), 0.0, 0.0);
                for (fixed, mass) in fixed.iter().zip(&masses) {
                    let away = fixed - pose * point;
                    let g = mass * (-away.norm_squared() / (2.0 * sigma * sigma)).exp();
                    sum += g;
                    offset += away * g;
                    squared += away.norm_squared() * g;
                    size += g.abs();
                }
                // What lies beyond the reach is less than e^(-12.5) of a mass each.
                let slack = 1e-5 * size + 333.0 * 4.0 * 4e-6;
                assert!((found.sum - sum).abs() < slack, "{sigma}: {found:?} {sum}");
                assert!((found.offset - offset).norm() < slack, "{sigma}: {found:?} {offset}");
                assert!((found.squared - squared).abs() < slack, "{sigma}: {found:?} {squared}");
            }
        }
    }

    #[test]
    fn every_kernel_gives_the_same_bits() {
        let lookers = Lookers::new(&looped(71, 0.2));
        let with = |kernel| {
            let gaussians = Gaussians {
                kernel,
                ..Gaussians::new(&looped(333, 0.0), None)
            };
            gaussians.affinities(&lookers, &Isometry3::identity(), 0.1)
        };
        for kernel in Kernel::available() {
            assert_eq!(with(kernel), with(Kernel::fastest()), "{}", kernel.name());
        }
    }

    #[test]
    fn powers_of_two_are_as_exact_as_single_precision() {
        for i in 0..100_000 {
            let t = -f64::from(i) * 1e-3;
            let error = f64::from(power_of_two(t as f32)) / f64::from(t as f32).exp2() - 1.0;
            assert!(error.abs() < 4e-7, "{t} {error}");
        }
        assert_eq!(power_of_two(0.0), 1.0);
        for far in [-1e3, f32::NEG_INFINITY, f32::NAN] {
            assert_eq!(power_of_two(far), power_of_two(-100.0));
        }
    }

    #[test]
    fn nobody_claims_where_there_is_nobody() {
        let lookers = Lookers::new(&looped(3, 0.0));
        let found = Gaussians::new(&[], None).affinities(&lookers, &Isometry3::identity(), 0.1);
        assert!(found.iter().all(|affinity| affinity.sum == 0.0));
        let nobody = Lookers::new(&[]);
        assert!(
            Gaussians::new(&looped(3, 0.0), None)
                .affinities(&nobody, &Isometry3::identity(), 0.1)
                .is_empty()
        );
    }
}
