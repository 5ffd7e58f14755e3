//! MPE by itself, on blades that stand in for the paper's.

use std::error::Error;

use bladescan::geometry::PointCloud;
use bladescan::registration::Summation;
use hw_sim::blade::Builtin;
use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use crate::generate::Surface;
use crate::methods::product::mpe_on_samples;

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
    mpe_on_samples(source, target, &Isometry3::identity(), sample_count, summation, rng)
}
