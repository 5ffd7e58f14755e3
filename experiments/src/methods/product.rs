//! bladescan's own registration, and the two stages of the paper by themselves.

use bladescan::geometry::PointCloud;
use bladescan::geometry::sampling::random_indices;
use bladescan::registration::mpe::descend;
use bladescan::registration::{MpeSettings, Settings, Stride, Summation};
use nalgebra::{Isometry3, Point3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

/// The product as a user calls it; the start where it refuses the clouds.
pub(crate) fn register(source: &PointCloud, target: &PointCloud) -> Isometry3<f64> {
    bladescan::registration::register(source, target, &Settings::default())
        .map_or_else(|_| Isometry3::identity(), |found| found.reference_from_template)
}

/// MPE alone, as the paper has it: random samples of both clouds, strides that are halved when a direction reverses. The
/// sign, the centre of the torque and the rule of halving are those that `docs/paper.md` gives reasons for.
pub(crate) fn mpe(source: &PointCloud, target: &PointCloud, start: &Isometry3<f64>) -> Isometry3<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(SAMPLE_SEED);
    mpe_on_samples(source, target, start, SAMPLE_COUNT, Summation::Automatic, &mut rng)
}

/// As [`mpe`], on samples of so many points, their forces summed in this way.
pub(crate) fn mpe_on_samples(
    source: &PointCloud,
    target: &PointCloud,
    start: &Isometry3<f64>,
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
    descend(&template, &reference, start, &settings).reference_from_template
}

/// Points of a cloud drawn at random, in their order.
pub(crate) fn sample(cloud: &PointCloud, count: usize, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
    let indices = random_indices(cloud.len(), count, rng);
    indices.into_iter().map(|index| cloud.points()[index]).collect()
}

/// The paper's sample of each cloud.
const SAMPLE_COUNT: usize = 500;

const SAMPLE_SEED: u64 = 1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn mpe_comes_near_and_the_product_nearer() {
        let pair = testing::permuted(600, 40.0, [0.2, -0.1, 0.1]);
        assert_near(
            &mpe(&pair.source, &pair.target, &Isometry3::identity()),
            &pair.truth,
            0.05,
        );
        assert_near(&register(&pair.source, &pair.target), &pair.truth, 1e-3);
    }
}
