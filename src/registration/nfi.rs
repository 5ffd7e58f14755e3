//! Descents of the NFI criterion among noise: into the basin of the most likely pose.
//!
//! There no point has a nearest partner worth the name, and trimmed ICP makes a coarse result worse. The paper's own
//! criterion, with ε² of the order of the noise, has a wide basin; it is minimised by a quasi-Newton method (BFGS), the
//! exact gradient being minus the total force and torque. How well it explains all points tells the minima apart.

use nalgebra::{Isometry3, Matrix6, Point3, Vector6};

use super::mpe::System;
use super::twist::moved;

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
            let found = minimise(&thin, &pose, factor * softening);
            pose = found.pose;
            iterations += found.iterations;
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

/// Goes downhill in energy from `start`. Unknowns are a turn about the template's centroid times its radius of gyration
/// and a shift, both over the reference's radius.
fn minimise(system: &System<'_>, start: &Isometry3<f64>, softening: f64) -> Minimum {
    let gyration = system.gyration();
    let evaluate = |pose: &Isometry3<f64>| {
        let loads = system.loads(pose, softening);
        let (turn, shift) = (-loads.torque / gyration, -loads.force);
        let gradient = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        (loads.energy, gradient, loads.pivot)
    };
    let mut pose = *start;
    let (mut energy, mut gradient, mut pivot) = evaluate(&pose);
    let mut inverse_hessian: Option<Matrix6<f64>> = None;
    let mut iterations = 0;
    while iterations < ITERATION_MAX_COUNT {
        iterations += 1;
        let mut step = match &inverse_hessian {
            Some(inverse) => -(inverse * gradient),
            None => -gradient * (FIRST_STEP / gradient.norm().max(f64::MIN_POSITIVE)),
        };
        if step.dot(&gradient) >= 0.0 {
            inverse_hessian = None;
            step = -gradient * (FIRST_STEP / gradient.norm().max(f64::MIN_POSITIVE));
        }
        let length = step.norm();
        if length > STEP_MAX {
            step *= STEP_MAX / length;
        }
        let slope = step.dot(&gradient);
        let mut taken = None;
        for _ in 0..BACKTRACK_MAX_COUNT {
            let turned = step.fixed_rows::<3>(0) / gyration;
            let shifted = step.fixed_rows::<3>(3) * system.radius();
            let motion = Vector6::new(turned.x, turned.y, turned.z, shifted.x, shifted.y, shifted.z);
            let next = moved(&pose, &pivot, &motion);
            let (next_energy, next_gradient, next_pivot) = evaluate(&next);
            let share = step.dot(&gradient) / slope;
            if next_energy <= energy + 1e-4 * share * slope {
                taken = Some((next, next_energy, next_gradient, next_pivot));
                break;
            }
            step *= 0.35;
        }
        let Some((next, next_energy, next_gradient, next_pivot)) = taken else {
            break;
        };
        let change = next_gradient - gradient;
        let curvature = change.dot(&step);
        if curvature > 1e-12 * change.norm() * step.norm() {
            let inverse = inverse_hessian.unwrap_or_else(|| Matrix6::identity() * (curvature / change.norm_squared()));
            let left = Matrix6::identity() - step * change.transpose() / curvature;
            inverse_hessian = Some(left * inverse * left.transpose() + step * step.transpose() / curvature);
        }
        let gained = energy - next_energy;
        (pose, energy, gradient, pivot) = (next, next_energy, next_gradient, next_pivot);
        if step.norm() < STEP_MIN || gained < ENERGY_FRACTION_MIN * energy.abs() {
            break;
        }
    }
    Minimum {
        pose,
        energy,
        iterations,
    }
}

const THIN_COUNT: usize = 1000;
/// ε² of the descents one after the other, in multiples of the noise.
const SOFTENING_FACTORS: [f64; 2] = [4.0, 1.5];
const ITERATION_MAX_COUNT: u32 = 60;
const BACKTRACK_MAX_COUNT: u32 = 12;
/// Lengths of steps over the reference's radius.
const FIRST_STEP: f64 = 0.02;
const STEP_MAX: f64 = 0.1;
const STEP_MIN: f64 = 1e-6;
/// A smaller relative gain is rounding in single precision.
const ENERGY_FRACTION_MIN: f64 = 1e-9;

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
