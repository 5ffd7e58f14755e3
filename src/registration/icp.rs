//! Trimmed iterative closest point: the fine stage.
//!
//! Coarse to fine: each level takes more points and a shorter reach. A pair counts if it is within reach, its normals
//! agree, and it survives trimming: with automatic trimming the kept share minimises `e(ξ) / ξ³`, the mean squared
//! distance against the share (the trimmed ICP of the paper's reference). What is left is weighted by Tukey's function
//! of its residual, and one Gauss-Newton step on SE(3) is taken.

use nalgebra::{Isometry3, Point3, Vector3, Vector6};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::normal_matrix::NormalMatrix;
use super::prior::weighed;
use super::reference::Reference;
use super::tukey::Tukey;
use super::twist::{motion_between, moved, scaled, unscaled};
use super::{Determination, WeakDirections};
use crate::geometry::normals::agreement;
use crate::geometry::sampling::random_indices;
use crate::geometry::statistics::median;

/// How the fine stage works.
#[derive(Debug, Clone, PartialEq)]
pub struct IcpSettings {
    /// What distance is minimised.
    pub metric: Metric,
    /// Which pairs are kept.
    pub trimming: Trimming,
    /// The levels, coarse to fine; the last one is the `fine` stage, the others are `coarse`.
    pub levels: Vec<IcpLevel>,
}

impl Default for IcpSettings {
    fn default() -> Self {
        let level = |sample_count, reach_factor, iteration_max_count| IcpLevel {
            sample_count,
            reach_factor,
            iteration_max_count,
        };
        Self {
            metric: Metric::PointToPlane,
            trimming: Trimming::Automatic,
            levels: vec![level(1000, 0.3, 40), level(5000, 0.03, 20), level(60_000, 0.01, 40)],
        }
    }
}

/// One level of the fine stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IcpLevel {
    /// How many template points take part, drawn at random.
    pub sample_count: usize,
    /// The reach at the start of the level, over the template's root-mean-square radius. It shrinks to that of the next
    /// level, and never below a few spacings of the reference.
    pub reach_factor: f64,
    /// The most iterations.
    pub iteration_max_count: u32,
}

/// What distance is minimised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Metric {
    /// From the template point to the surface: along the mean of both points' normals.
    PointToPlane,
    /// Between the points (the classical form, the paper's eq. 2 and 3).
    PointToPoint,
}

/// Which pairs are kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trimming {
    /// The share is found from the distances.
    Automatic,
    /// The nearest share of the pairs within reach, 0 to 1.
    Fixed {
        /// The share.
        overlap_fraction: f64,
    },
}

/// The part of a template that takes part in a level.
pub(super) struct Sample {
    pub(super) points: Vec<Point3<f64>>,
    pub(super) normals: Vec<Vector3<f64>>,
}

impl Sample {
    /// At most `count` points, drawn at random, with their normals.
    pub(super) fn of(points: &[Point3<f64>], normals: &[Vector3<f64>], count: usize, rng: &mut ChaCha8Rng) -> Self {
        let indices = random_indices(points.len().min(normals.len()), count, rng);
        Self {
            points: indices.iter().map(|&index| points[index]).collect(),
            normals: indices.iter().map(|&index| normals[index]).collect(),
        }
    }

    /// The same points with every normal reversed.
    pub(super) fn reversed(&self) -> Self {
        Self {
            points: self.points.clone(),
            normals: self.normals.iter().map(|normal| -normal).collect(),
        }
    }
}

/// What all levels share.
pub(super) struct Problem<'a> {
    pub(super) reference: &'a Reference,
    /// The template's centroid.
    pub(super) centroid: Point3<f64>,
    /// The template's radius of gyration.
    pub(super) radius: f64,
    /// Whether the sign of the normals of both clouds means something.
    pub(super) oriented: bool,
    pub(super) metric: Metric,
    pub(super) trimming: Trimming,
}

/// What a level came to.
pub(super) struct Refined {
    pub(super) pose: Isometry3<f64>,
    pub(super) iterations: u32,
    pub(super) determination: Determination,
}

struct Pair {
    template: u32,
    reference: u32,
    distance: f64,
}

impl Problem<'_> {
    /// Runs one level from `start`; `end_reach` is where its reach shrinks to. `None` when nothing can be paired.
    pub(super) fn refine(
        &self,
        sample: &Sample,
        start: &Isometry3<f64>,
        level: &IcpLevel,
        end_reach: f64,
        held: &[Vector6<f64>],
    ) -> Option<Refined> {
        let spacing = self.reference.spacing();
        let mut pose = *start;
        let mut reach = (level.reach_factor * self.radius).max(REACH_SPACINGS * spacing);
        let end_reach = end_reach.max(REACH_SPACINGS * spacing).min(reach);
        let mut pairs = Vec::new();
        let (mut drift, mut settled) = (f64::INFINITY, false);
        let mut sums = NormalMatrix::zero();
        let mut iterations = 0;
        for _ in 0..level.iteration_max_count {
            iterations += 1;
            if drift > REMATCH_SPACINGS * spacing || !settled {
                pairs = self.pairs(sample, &pose, reach);
                self.trim(&mut pairs);
                drift = 0.0;
            }
            sums = self.equations(sample, &pairs, &pose)?;
            let step = sums.step(held)?;
            pose = self.stepped(&pose, &step);
            let length = step.norm();
            drift += length;
            // Noisy or thin clouds stay apart by more than the reach of a dense one: never cut into their distances.
            let narrowest =
                end_reach.max(REACH_MEDIANS * median(pairs.iter().map(|pair| pair.distance).collect()).unwrap_or(0.0));
            settled = reach <= narrowest * 1.001;
            if settled && length < STEP_SPACINGS * spacing {
                break;
            }
            reach = (reach * REACH_SHRINK).max(narrowest).min(reach);
        }
        Some(Refined {
            pose,
            iterations,
            determination: sums.determination(self.radius, sums.weight),
        })
    }

    /// What the pairs at `pose` determine, without moving it.
    pub(super) fn assess(&self, sample: &Sample, pose: &Isometry3<f64>, reach: f64) -> Option<Determination> {
        let mut pairs = self.pairs(sample, pose, reach);
        self.trim(&mut pairs);
        let sums = self.equations(sample, &pairs, pose)?;
        Some(sums.determination(self.radius, sums.weight))
    }

    /// Puts the components of the motion from `start` along the `held` directions back to nothing.
    pub(super) fn without(
        &self,
        start: &Isometry3<f64>,
        pose: &Isometry3<f64>,
        held: &[Vector6<f64>],
    ) -> Isometry3<f64> {
        let mut step = self.step_between(start, pose);
        for direction in held {
            step -= direction * direction.dot(&step);
        }
        self.stepped(start, &step)
    }

    /// The pose after a step `[L·rx L·ry L·rz tx ty tz]` about the centroid, with L the radius of gyration.
    pub(super) fn stepped(&self, pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
        moved(pose, &(pose * self.centroid), &unscaled(step, self.radius))
    }

    /// The step from one pose to another; the inverse of [`Self::stepped`].
    pub(super) fn step_between(&self, from: &Isometry3<f64>, to: &Isometry3<f64>) -> Vector6<f64> {
        scaled(&motion_between(from, to, &self.centroid), self.radius)
    }

    fn pairs(&self, sample: &Sample, pose: &Isometry3<f64>, reach: f64) -> Vec<Pair> {
        let normals = self.reference.normals();
        let least = if reach > AGREEMENT_REACH_FACTOR * self.radius {
            AGREEMENT_FAR
        } else {
            AGREEMENT_NEAR
        };
        let chunks: Vec<Vec<Pair>> = sample
            .points
            .par_chunks(CHUNK_COUNT)
            .enumerate()
            .map(|(chunk, points)| {
                let mut pairs = Vec::with_capacity(points.len());
                for (offset, point) in points.iter().enumerate() {
                    let index = chunk * CHUNK_COUNT + offset;
                    let Some(found) = self.reference.nearest(&(pose * point)) else {
                        continue;
                    };
                    if found.distance > reach {
                        continue;
                    }
                    let turned = pose * sample.normals[index];
                    if agreement(&turned, &normals[found.index], self.oriented) >= least {
                        pairs.push(Pair {
                            template: index as u32,
                            reference: found.index as u32,
                            distance: found.distance,
                        });
                    }
                }
                pairs
            })
            .collect();
        chunks.into_iter().flatten().collect()
    }

    fn trim(&self, pairs: &mut Vec<Pair>) {
        if pairs.is_empty() {
            return;
        }
        let mut squared: Vec<f64> = pairs.iter().map(|pair| pair.distance * pair.distance).collect();
        squared.sort_unstable_by(f64::total_cmp);
        let count = squared.len();
        let kept_count = match self.trimming {
            Trimming::Fixed { overlap_fraction } => (overlap_fraction.clamp(0.0, 1.0) * count as f64).ceil() as usize,
            Trimming::Automatic => automatic_count(&squared),
        };
        let largest = squared[kept_count.clamp(1, count) - 1].sqrt();
        pairs.retain(|pair| pair.distance <= largest);
    }

    /// The weighted equations over `pairs` at `pose`; their weight is how many pairs they stand for.
    fn equations(&self, sample: &Sample, pairs: &[Pair], pose: &Isometry3<f64>) -> Option<NormalMatrix> {
        if pairs.len() < PAIR_MIN_COUNT {
            return None;
        }
        let measured: Vec<Measured> = pairs
            .par_iter()
            .with_min_len(512)
            .map(|pair| self.measured(sample, pair, pose))
            .collect();
        let tukey = Tukey::of(measured.iter().map(|m| m.size).collect(), self.radius)?;
        let centre = pose * self.centroid;
        NormalMatrix::summed(&measured, |some| {
            let mut sums = NormalMatrix::zero();
            for m in some {
                let Some(weight) = tukey.weight(m.size) else { continue };
                let arm = (m.point - centre) / self.radius;
                match self.metric {
                    Metric::PointToPlane => sums.add(weight, &arm, &m.normal, m.normal.dot(&m.offset)),
                    Metric::PointToPoint => {
                        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                            sums.add(weight / 3.0, &arm, &axis, axis.dot(&m.offset));
                        }
                    }
                }
                sums.add_cross(weight, &arm, &m.first, &m.second);
            }
            sums
        })
    }

    fn measured(&self, sample: &Sample, pair: &Pair, pose: &Isometry3<f64>) -> Measured {
        let point = pose * sample.points[pair.template as usize];
        let offset = point - self.reference.points()[pair.reference as usize];
        let second = self.reference.normals()[pair.reference as usize];
        let turned = pose * sample.normals[pair.template as usize];
        let first = if turned.dot(&second) < 0.0 { -turned } else { turned };
        let normal = (first + second).try_normalize(0.0).unwrap_or(second);
        Measured {
            point,
            offset,
            first,
            second,
            normal,
            size: match self.metric {
                Metric::PointToPlane => normal.dot(&offset).abs(),
                Metric::PointToPoint => offset.norm(),
            },
        }
    }
}

struct Measured {
    point: Point3<f64>,
    offset: Vector3<f64>,
    first: Vector3<f64>,
    second: Vector3<f64>,
    normal: Vector3<f64>,
    size: f64,
}

/// How many of the ascending squared distances to keep: the minimum of `e(ξ) / ξ³` over the shares from a third on.
fn automatic_count(squared: &[f64]) -> usize {
    let count = squared.len();
    let (mut sum, mut best, mut best_value) = (0.0, count, f64::INFINITY);
    for (index, value) in squared.iter().enumerate() {
        sum += value;
        let kept = (index + 1) as f64;
        if 3 * (index + 1) < count {
            continue;
        }
        let share = kept / count as f64;
        let quality = sum / kept / (share * share * share);
        if quality < best_value {
            (best, best_value) = (index + 1, quality);
        }
    }
    best
}

/// The whole fine stage of one candidate: the last level, with weak directions held if so wished.
pub(super) fn finish(
    problem: &Problem<'_>,
    sample: &Sample,
    start: &Isometry3<f64>,
    prior: &Isometry3<f64>,
    level: &IcpLevel,
    weak_directions: WeakDirections,
) -> Option<Refined> {
    let free = problem.refine(sample, start, level, 0.0, &[])?;
    if weak_directions == WeakDirections::Report {
        return Some(free);
    }
    let free = free.weighed(problem, prior, weak_directions);
    if free.determination.weak.is_empty() {
        return Some(free);
    }
    // Along these the surfaces may differ a little from place to place: the others are refined where they are held.
    let held: Vec<Vector6<f64>> = free.determination.weak.iter().map(|(scaled, _)| *scaled).collect();
    let anchor = match weak_directions {
        WeakDirections::Weigh(_) => free.pose,
        WeakDirections::Hold | WeakDirections::Report => *prior,
    };
    let back = problem.without(&anchor, &free.pose, &held);
    let mut refined = problem.refine(sample, &back, level, 0.0, &held)?;
    refined.pose = problem.without(&anchor, &refined.pose, &held);
    refined.iterations += free.iterations;
    refined.determination = free.determination;
    Some(refined)
}

impl Refined {
    /// The mean with the start, if that is wished and something is known about both.
    pub(super) fn weighed(
        mut self,
        problem: &Problem<'_>,
        start: &Isometry3<f64>,
        weak_directions: WeakDirections,
    ) -> Self {
        let (WeakDirections::Weigh(sigma), Some(covariance)) = (weak_directions, &self.determination.covariance) else {
            return self;
        };
        let (centroid, radius) = (&problem.centroid, problem.radius);
        if let Some(mean) = weighed(start, &sigma, &self.pose, covariance, centroid, radius) {
            self.pose = mean.pose;
            self.determination.covariance = Some(mean.covariance);
        }
        self
    }
}

const CHUNK_COUNT: usize = 1024;
/// Fewer pairs do not determine six unknowns with any safety.
const PAIR_MIN_COUNT: usize = 8;
/// The reach never falls below this many spacings of the reference.
const REACH_SPACINGS: f64 = 2.5;
/// ... nor below this many median distances of the pairs.
const REACH_MEDIANS: f64 = 3.0;
const REACH_SHRINK: f64 = 0.8;
/// Pairs are kept while the pose has moved less than this.
const REMATCH_SPACINGS: f64 = 0.01;
/// A shorter step ends a level.
const STEP_SPACINGS: f64 = 2e-4;
const AGREEMENT_REACH_FACTOR: f64 = 0.05;
/// Least cosine between the normals of a pair, far from the solution and near it.
const AGREEMENT_FAR: f64 = 0.6;
const AGREEMENT_NEAR: f64 = 0.85;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn automatic_trimming_finds_the_share_that_overlaps() {
        let near = (0..700).map(|i| 1e-4 * (1.0 + f64::from(i) / 700.0));
        let far = (0..300).map(|i| 1.0 + f64::from(i));
        let squared: Vec<f64> = near.chain(far).collect();
        assert_eq!(automatic_count(&squared), 700);
        let even: Vec<f64> = (1..=1000).map(f64::from).collect();
        assert_eq!(automatic_count(&even), 1000);
    }
}
