//! Full-sample NFI: the fine stage for clouds whose noise is of the order of their spacing.
//!
//! There no point has a nearest partner worth the name, and trimmed ICP makes a coarse result worse. The paper's own
//! criterion over *all* pairs, with ε² of the order of the noise, stays close to the best that is possible; it is
//! minimised by a quasi-Newton method (BFGS), the exact gradient being minus the total force and torque.

use nalgebra::{Isometry3, Matrix6, Point3, Vector6};

use super::mpe::System;
use super::twist::moved;

/// Where a minimisation ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    pub(super) pose: Isometry3<f64>,
    pub(super) energy: f64,
    pub(super) iterations: u32,
}

/// Refines every candidate on thinned clouds, keeps the one with the lowest energy over all points, and refines that.
///
/// Also returns what every candidate came to on the thinned clouds, in order.
///
/// `noise` is the clouds' scatter in their unit. `candidates` must not be empty; ties go to the earlier one.
pub(super) fn minimum(
    template: &[Point3<f64>],
    reference: &[Point3<f64>],
    candidates: &[Isometry3<f64>],
    noise: f64,
) -> Option<(Minimum, Vec<Isometry3<f64>>)> {
    let full = System::new(template, reference)?;
    let softening = noise / full.radius();
    let (thin_template, thin_reference) = (thinned(template), thinned(reference));
    let thin = System::new(&thin_template, &thin_reference)?;
    let mut best: Option<Minimum> = None;
    let mut iterations = 0;
    let mut refined = Vec::with_capacity(candidates.len());
    for candidate in candidates {
        let mut pose = *candidate;
        for factor in [4.0, 1.5] {
            let found = minimise(&thin, &pose, factor * softening);
            pose = found.pose;
            iterations += found.iterations;
        }
        refined.push(pose);
        let energy = full.loads(&pose, softening).energy;
        if best.as_ref().is_none_or(|best| energy < best.energy) {
            best = Some(Minimum {
                pose,
                energy,
                iterations: 0,
            });
        }
    }
    let mut found = minimise(&full, &best?.pose, softening);
    found.iterations += iterations;
    Some((found, refined))
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
    fn heavy_noise_costs_little_more_than_with_known_correspondences() {
        let template = blade(1500, 0.0);
        let truth = Isometry3::new(Vector3::new(0.05, 0.02, -0.03), Vector3::new(0.05, 0.1, -0.05));
        let sigma = 0.05;
        let reference = noisy(&template.transformed(&truth), sigma, 9);
        let (found, _) = minimum(template.points(), reference.points(), &[Isometry3::identity()], sigma).unwrap();
        let squared: f64 = template
            .points()
            .iter()
            .map(|point| (truth * point - found.pose * point).norm_squared())
            .sum();
        let rmse = (squared / template.len() as f64).sqrt();
        let bound = sigma * (6.0 / template.len() as f64).sqrt();
        assert!(rmse < 3.0 * bound, "{rmse} against {bound}");
    }
}
