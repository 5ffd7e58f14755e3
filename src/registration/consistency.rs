//! How well a pose explains two clouds: overlap, residual and the score that chooses between candidates.

use nalgebra::Isometry3;
use rayon::prelude::*;

use super::icp::Sample;
use super::reference::Reference;
use super::{Overlap, Registration};
use crate::geometry::PointCloud;

/// The overlap of `template`, laid on `reference` by `reference_from_template`: its points that have a reference point
/// at most `overlap_distance` away. An empty template overlaps nowhere.
pub fn overlap(
    template: &PointCloud,
    reference: &Reference,
    reference_from_template: &Isometry3<f64>,
    overlap_distance: f64,
) -> Overlap {
    residuals(template, reference, reference_from_template, overlap_distance).0
}

/// The overlap, and the root mean square distance of the overlapping points from the reference's surface.
pub(super) fn residuals(
    template: &PointCloud,
    reference: &Reference,
    pose: &Isometry3<f64>,
    overlap_distance: f64,
) -> (Overlap, f64) {
    let sums: Vec<(usize, f64)> = template
        .points()
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

/// What judges poses: a sample of the template and how near its points must come.
pub(super) struct Judge {
    pub(super) sample: Sample,
    /// A point farther than this from any reference point does not overlap.
    pub(super) reach: f64,
    /// A residual of this size halves a point's weight.
    pub(super) residual_scale: f64,
    /// Whether the sign of the normals means something.
    pub(super) oriented: bool,
}

impl Judge {
    /// The share of the sample that lies on the reference's surface with agreeing normals, each point weighed by how
    /// near: 0 (nothing fits) to 1 (every point on the surface).
    pub(super) fn score(&self, reference: &Reference, pose: &Isometry3<f64>) -> f64 {
        let parts: Vec<f64> = self
            .sample
            .points
            .par_chunks(JUDGE_CHUNK_COUNT)
            .zip(self.sample.normals.par_chunks(JUDGE_CHUNK_COUNT))
            .map(|(points, normals)| {
                let mut sum = 0.0;
                for (point, normal) in points.iter().zip(normals) {
                    let placed = pose * point;
                    let Some(found) = reference.nearest(&placed) else {
                        continue;
                    };
                    let surface = &reference.normals()[found.index];
                    let cosine = (pose * normal).dot(surface);
                    let cosine = if self.oriented { cosine } else { cosine.abs() };
                    if found.distance <= self.reach && cosine > AGREEMENT {
                        let residual = surface.dot(&(placed - reference.points()[found.index])) / self.residual_scale;
                        sum += 1.0 / (1.0 + residual * residual);
                    }
                }
                sum
            })
            .collect();
        parts.iter().sum::<f64>() / self.sample.points.len().max(1) as f64
    }
}

impl Registration {
    /// The outcome that changes nothing: `start`, failed.
    pub(super) fn failed(start: &Isometry3<f64>, overlap: Overlap, rmse: f64) -> Self {
        Self {
            reference_from_template: *start,
            status: super::Status::Failed,
            overlap,
            rmse,
            covariance: None,
            weak_directions: Vec::new(),
            stages: Vec::new(),
        }
    }
}

const CHUNK_COUNT: usize = 1024;
const JUDGE_CHUNK_COUNT: usize = 256;
/// Least cosine between the normals of a point and the surface that it is said to lie on.
const AGREEMENT: f64 = 0.85;
