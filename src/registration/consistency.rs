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

/// The share of the sample that lies on the reference's surface with agreeing normals, each point weighed by how near:
/// 0 (nothing fits) to 1 (every point on the surface).
pub(super) fn score(sample: &Sample, reference: &Reference, pose: &Isometry3<f64>, reach: f64, oriented: bool) -> f64 {
    let parts: Vec<f64> = sample
        .points
        .par_chunks(CHUNK_COUNT)
        .zip(sample.normals.par_chunks(CHUNK_COUNT))
        .map(|(points, normals)| {
            let mut sum = 0.0;
            for (point, normal) in points.iter().zip(normals) {
                let placed = pose * point;
                let Some(found) = reference.nearest(&placed) else {
                    continue;
                };
                if found.distance > reach {
                    continue;
                }
                let surface = &reference.normals()[found.index];
                let cosine = (pose * normal).dot(surface);
                let cosine = if oriented { cosine } else { cosine.abs() };
                if cosine > AGREEMENT {
                    let residual = surface.dot(&(placed - reference.points()[found.index])) / reach;
                    sum += (1.0 - residual * residual).powi(2);
                }
            }
            sum
        })
        .collect();
    parts.iter().sum::<f64>() / sample.points.len().max(1) as f64
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
/// Least cosine between the normals of a point and the surface that it is said to lie on.
const AGREEMENT: f64 = 0.85;
