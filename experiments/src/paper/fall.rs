//! The paper's two stages by themselves, on blades that stand in for the paper's.

use std::error::Error;

use bladescan::geometry::PointCloud;
use bladescan::geometry::sampling::random_indices;
use bladescan::registration::mpe::descend;
use bladescan::registration::{MpeSettings, Stride, Summation};
use hw_sim::blade::Builtin;
use nalgebra::{Isometry3, Point3};
use rand_chacha::ChaCha8Rng;

use crate::generate::Surface;
use crate::methods::Method;

/// The four blades with their names, a longest half side of 1 each.
pub(crate) fn blades() -> Result<Vec<(&'static str, Surface)>, Box<dyn Error>> {
    Builtin::ALL
        .into_iter()
        .map(|blade| Ok((blade.name(), Surface::of_builtin(blade)?.normalised())))
        .collect()
}

/// MPE as the paper has it, with halved strides, from the identity, on samples of both clouds.
pub(crate) fn fall(
    source: &PointCloud,
    target: &PointCloud,
    sample_count: usize,
    summation: Summation,
    rng: &mut ChaCha8Rng,
) -> Isometry3<f64> {
    let settings = MpeSettings {
        stride: Stride::Halving,
        summation,
        ..MpeSettings::default()
    };
    let template = sample(source, sample_count, rng);
    let reference = sample(target, sample_count, rng);
    descend(&template, &reference, &Isometry3::identity(), &settings).reference_from_template
}

/// Trimmed ICP from `near`.
pub(crate) fn refined(source: &PointCloud, target: &PointCloud, near: &Isometry3<f64>) -> Isometry3<f64> {
    let moved = source.points().iter().map(|point| near * point);
    Method::Tricp.estimate(&PointCloud::from_measured(moved).cloud, target) * near
}

/// Points of a cloud drawn at random, in their order.
pub(crate) fn sample(cloud: &PointCloud, count: usize, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let indices = random_indices(cloud.len(), count, rng);
    indices.into_iter().map(|index| cloud.points()[index]).collect()
}
