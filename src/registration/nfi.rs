//! Descents of the NFI criterion among noise: into the basin of the most likely pose.
//!
//! There no point has a nearest partner worth the name, and trimmed ICP makes a coarse result worse. The paper's own
//! criterion, with ε² of the order of the noise, has a wide basin; it is minimised by a quasi-Newton method (BFGS), the
//! exact gradient being minus the total force and torque. How well it explains all points tells the minima apart.

use nalgebra::{Isometry3, Point3};

use super::mpe::System;
use super::stride::{Reach, quasi_newton};

/// Where a descent ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    pub(super) pose: Isometry3<f64>,
    /// Over all points.
    pub(super) energy: f64,
    pub(super) iterations: u32,
}

/// Where the descents from all candidates end on thinned clouds, the lowest over all points first.
///
/// `noise` is the clouds' scatter in their unit. Ties go to the earlier candidate; empty when a cloud has no extent.
pub(super) fn minima(
    template: &[Point3<f64>],
    reference: &[Point3<f64>],
    candidates: &[Isometry3<f64>],
    noise: f64,
) -> Vec<Minimum> {
    let (thin_template, thin_reference) = (thinned(template), thinned(reference));
    let systems = System::new(template, reference).zip(System::new(&thin_template, &thin_reference));
    let Some((full, thin)) = systems else {
        return Vec::new();
    };
    let softening = noise / full.radius();
    let descended = |candidate: &Isometry3<f64>| {
        let (mut pose, mut iterations) = (*candidate, 0);
        for factor in SOFTENING_FACTORS {
            let found = quasi_newton(&thin, &pose, factor * softening, &REACH);
            pose = found.pose;
            iterations += found.evaluation_count;
        }
        Minimum {
            pose,
            energy: full.loads(&pose, softening).energy,
            iterations,
        }
    };
    let mut minima: Vec<Minimum> = candidates.iter().map(descended).collect();
    minima.sort_by(|a, b| a.energy.total_cmp(&b.energy));
    minima
}

fn thinned(points: &[Point3<f64>]) -> Vec<Point3<f64>> {
    crate::geometry::sampling::even_indices(points.len(), THIN_COUNT)
        .into_iter()
        .map(|index| points[index])
        .collect()
}

const THIN_COUNT: usize = 1000;
/// ε² of the descents one after the other, in multiples of the noise.
const SOFTENING_FACTORS: [f64; 2] = [4.0, 1.5];
/// Of the descents.
const REACH: Reach = Reach {
    first: 0.02,
    most: 0.1,
    least: 1e-6,
    evaluation_max_count: 80,
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::{blade, noisy};
    use nalgebra::Vector3;

    #[test]
    fn among_heavy_noise_the_lowest_minimum_is_near_the_truth() {
        let template = blade(1500, 0.0);
        let truth = Isometry3::new(Vector3::new(0.05, 0.02, -0.03), Vector3::new(0.05, 0.1, -0.05));
        let sigma = 0.05;
        let reference = noisy(&template.transformed(&truth), sigma, 9);
        let flipped = Isometry3::rotation(Vector3::new(0.0, 0.0, 3.0));
        let starts = [flipped, Isometry3::identity()];
        let found = minima(template.points(), reference.points(), &starts, sigma);
        let error = truth.inverse() * found[0].pose;
        assert!(
            error.rotation.angle() < 0.05 && error.translation.vector.norm() < 0.02,
            "{error:?}"
        );
        assert!(found[0].energy < found[1].energy);
        assert!(minima(&[], reference.points(), &starts, sigma).is_empty());
    }
}
