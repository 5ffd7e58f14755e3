//! How well a pose explains two clouds: overlap, residual and the score that chooses between candidates.

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;

use super::Overlap;
use super::facing::Sides;
use super::icp::Sample;
use super::reference::Reference;
use super::sight::Sight;
use crate::geometry::PointCloud;
use crate::geometry::nearest::{NearestPoints, Neighbour};

/// The overlap, and the root mean square distance of the overlapping points from the reference's surface.
pub(super) fn residuals(
    template: &[Point3<f64>],
    reference: &Reference,
    pose: &Isometry3<f64>,
    overlap_distance: f64,
) -> (Overlap, f64) {
    let sums: Vec<(usize, f64)> = template
        .par_chunks(CHUNK_COUNT)
        .map(|points| {
            let (mut count, mut squared) = (0, 0.0);
            for point in points {
                let placed = pose * point;
                if let Some(found) = reference.nearest(&placed)
                    && found.distance <= overlap_distance
                {
                    count += 1;
                    let offset = placed - reference.points()[found.index];
                    squared += reference.normals()[found.index].dot(&offset).powi(2);
                }
            }
            (count, squared)
        })
        .collect();
    let (mut count, mut squared) = (0, 0.0);
    for (part_count, part_squared) in sums {
        count += part_count;
        squared += part_squared;
    }
    let overlap = Overlap {
        count,
        fraction: count as f64 / template.len().max(1) as f64,
    };
    (overlap, (squared / count.max(1) as f64).sqrt())
}

/// What judges poses.
pub(super) struct Judge<'a> {
    pub(super) reference: &'a Reference,
    /// A sample of the template.
    pub(super) sample: Sample,
    /// A point farther than this from any point of the other cloud does not overlap.
    pub(super) reach: f64,
    /// A residual of this size halves a point's weight.
    pub(super) residual_scale: f64,
    /// What the signs of the normals mean.
    pub(super) sides: Sides,
    /// For two single views.
    pub(super) views: Option<Views<'a>>,
}

/// What two single views say of one another.
pub(super) struct Views<'a> {
    pub(super) template: &'a PointCloud,
    /// Over the template's points.
    pub(super) tree: &'a NearestPoints,
    /// A sample of the reference.
    pub(super) sample: Sample,
    /// Smaller samples of template and reference, for a first glance.
    pub(super) glances: [Sample; 2],
    pub(super) template_sight: Sight,
    pub(super) reference_sight: Sight,
}

/// What a pose is worth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Score {
    /// The share of the template that lies on the reference's surface with agreeing normals, each point weighed by how
    /// near: 0 (nothing fits) to 1 (every point on the surface).
    pub(super) share: f64,
    /// The share; for two views the mean of both clouds' shares, less that of the points that contradict the other view:
    /// -1 to 1.
    pub(super) value: f64,
    /// The mean share of both clouds that contradicts the other view; 0 unless both are views.
    pub(super) contradiction: f64,
    /// Whether the normals agree when all those of the template are reversed.
    pub(super) reversed: bool,
}

impl Judge<'_> {
    /// Scores a pose, `reference_from_template`.
    pub(super) fn score(&self, pose: &Isometry3<f64>) -> Score {
        self.score_over(
            &self.sample,
            self.views.as_ref().map(|views| (views, &views.sample)),
            pose,
        )
    }

    /// A rough score at a fraction of the cost.
    pub(super) fn glance(&self, pose: &Isometry3<f64>) -> Score {
        match &self.views {
            Some(views) => self.score_over(&views.glances[0], Some((views, &views.glances[1])), pose),
            None => self.score(pose),
        }
    }

    fn score_over(&self, sample: &Sample, views: Option<(&Views<'_>, &Sample)>, pose: &Isometry3<f64>) -> Score {
        let reference = self.reference;
        let shares = self.shares(sample, pose, reference.points(), reference.normals(), |point| {
            reference.nearest(point)
        });
        let Some((views, other)) = views else {
            let [same, opposite] = shares;
            let (share, reversed) = match self.sides {
                Sides::Known => (same, false),
                Sides::OneOfTwo => (same.max(opposite), opposite > same),
                Sides::Unknown => (same + opposite, false),
            };
            return Score {
                share,
                value: share,
                contradiction: 0.0,
                reversed,
            };
        };
        let back = pose.inverse();
        let normals = views.template.normals().unwrap_or(&[]);
        let others = self.shares(other, &back, views.template.points(), normals, |point| {
            views.tree.nearest(point)
        });
        let here = views.reference_sight.contradiction(&sample.points, pose);
        let there = views.template_sight.contradiction(&other.points, &back);
        let beside = BESIDE_WEIGHT * (here.beside + there.beside);
        let score = |reversed: bool, contradiction: f64, cost: f64| {
            let index = usize::from(reversed);
            let shares = [shares[index], others[index]];
            Score {
                share: shares[0],
                value: (shares[0] + shares[1] - CONTRADICTION_WEIGHT * contradiction - beside) / 2.0 - cost,
                contradiction: contradiction / 2.0,
                reversed,
            }
        };
        let same = score(false, here.facing + there.facing, 0.0);
        if self.sides != Sides::OneOfTwo {
            return same;
        }
        // Where the normals of one cloud must be reversed, that is the one whose side was less sure.
        let apart = if views.reference_sight.camera().bulge >= views.template_sight.camera().bulge {
            here.facing + there.averted
        } else {
            here.averted + there.facing
        };
        let least = views
            .reference_sight
            .camera()
            .bulge
            .min(views.template_sight.camera().bulge);
        let opposite = score(true, apart, REVERSED_COST * least);
        if opposite.value > same.value { opposite } else { same }
    }

    /// The shares of the sample that lie on a surface with normals that agree, and with normals that oppose it.
    fn shares(
        &self,
        sample: &Sample,
        pose: &Isometry3<f64>,
        points: &[Point3<f64>],
        normals: &[Vector3<f64>],
        nearest: impl Fn(&Point3<f64>) -> Option<Neighbour> + Sync,
    ) -> [f64; 2] {
        let parts: Vec<[f64; 2]> = sample
            .points
            .par_chunks(JUDGE_CHUNK_COUNT)
            .zip(sample.normals.par_chunks(JUDGE_CHUNK_COUNT))
            .map(|(chunk, chunk_normals)| {
                let mut sums = [0.0; 2];
                for (point, normal) in chunk.iter().zip(chunk_normals) {
                    let placed = pose * point;
                    let Some(found) = nearest(&placed) else { continue };
                    let surface = &normals[found.index];
                    let cosine = (pose * normal).dot(surface);
                    if found.distance <= self.reach && cosine.abs() > AGREEMENT {
                        let residual = surface.dot(&(placed - points[found.index])) / self.residual_scale;
                        sums[usize::from(cosine < 0.0)] += 1.0 / (1.0 + residual * residual);
                    }
                }
                sums
            })
            .collect();
        let sums = parts
            .iter()
            .fold([0.0; 2], |sums, part| [sums[0] + part[0], sums[1] + part[1]]);
        sums.map(|sum| sum / sample.points.len().max(1) as f64)
    }
}

const CHUNK_COUNT: usize = 1024;
const JUDGE_CHUNK_COUNT: usize = 256;
/// Least cosine between the normals of a point and the surface that it is said to lie on.
const AGREEMENT: f64 = 0.85;
/// A point that contradicts a view weighs as much as this many points that fit: the right pose has hardly any, a wrong one
/// can well fit in places. From 3 to 8 the choice is the same.
const CONTRADICTION_WEIGHT: f64 = 3.0;
/// What a point beyond the edge of a view's image weighs: most likely nothing is there, but the camera may not have looked.
const BESIDE_WEIGHT: f64 = 0.75;
/// What it costs to take both clouds' sides for opposite ones, for sides that are quite sure.
const REVERSED_COST: f64 = 0.3;
