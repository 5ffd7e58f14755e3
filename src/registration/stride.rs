//! Rules for how far the template falls at once, other than halving: they go down in the NFI criterion itself.
//!
//! Unknowns are a turn about the template's centroid times its radius of gyration and a shift, both over the reference's
//! radius; the gradient of the criterion is minus the torque (over the gyration) and the force.

use nalgebra::{Isometry3, Matrix6, Vector6};

use super::mpe::System;
use super::twist::moved;

/// How long steps may be, over the reference's radius, and how many evaluations are made.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    /// Of the first step.
    pub(super) first: f64,
    /// Of every step.
    pub(super) most: f64,
    /// A shorter step ends the descent.
    pub(super) least: f64,
    pub(super) evaluation_max_count: u32,
}

/// Where a descent ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bottom {
    pub(super) pose: Isometry3<f64>,
    /// The NFI criterion there, times the reference's radius.
    pub(super) energy: f64,
    pub(super) evaluation_count: u32,
}

/// The slope of the criterion at one softening.
struct Slope<'a> {
    system: &'a System<'a>,
    softening: f64,
    gyration: f64,
    evaluation_count: u32,
}

#[derive(Clone, Copy)]
struct Place {
    pose: Isometry3<f64>,
    pivot: nalgebra::Point3<f64>,
    energy: f64,
    gradient: Vector6<f64>,
}

/// Steepest descent: a step that gains makes the next one longer, one that does not is taken back and shortened.
pub(super) fn line_search(system: &System<'_>, start: &Isometry3<f64>, softening: f64, reach: &Reach) -> Bottom {
    let mut slope = Slope::new(system, softening);
    let mut here = slope.place(start);
    let mut length = reach.first;
    while slope.evaluation_count < reach.evaluation_max_count && length >= reach.least {
        let step = -here.gradient * (length / here.gradient.norm().max(f64::MIN_POSITIVE));
        let there = slope.stepped(&here, &step);
        if there.energy <= here.energy + GAIN_FRACTION_MIN * step.dot(&here.gradient) {
            here = there;
            length = (length * LONGER).min(reach.most);
        } else {
            length *= SHORTER;
        }
    }
    slope.bottom(&here)
}

/// Steepest descent with a share of the last step added; when that does not gain, it rests and starts again with half
/// the length.
pub(super) fn momentum(system: &System<'_>, start: &Isometry3<f64>, softening: f64, reach: &Reach) -> Bottom {
    let mut slope = Slope::new(system, softening);
    let mut here = slope.place(start);
    let mut length = reach.first;
    let mut last = Vector6::zeros();
    while slope.evaluation_count < reach.evaluation_max_count && length >= reach.least {
        let push = -here.gradient * ((1.0 - MOMENTUM) * length / here.gradient.norm().max(f64::MIN_POSITIVE));
        let step = last * MOMENTUM + push;
        let there = slope.stepped(&here, &step);
        if there.energy < here.energy {
            (here, last) = (there, step);
        } else {
            last = Vector6::zeros();
            length *= SHORTER;
        }
    }
    slope.bottom(&here)
}

/// BFGS with backtracking.
pub(super) fn quasi_newton(system: &System<'_>, start: &Isometry3<f64>, softening: f64, reach: &Reach) -> Bottom {
    let mut slope = Slope::new(system, softening);
    let mut here = slope.place(start);
    let mut inverse_hessian: Option<Matrix6<f64>> = None;
    while slope.evaluation_count < reach.evaluation_max_count {
        let steepest = || -here.gradient * (reach.first / here.gradient.norm().max(f64::MIN_POSITIVE));
        let mut step = inverse_hessian.map_or_else(steepest, |inverse| -(inverse * here.gradient));
        if step.dot(&here.gradient) >= 0.0 {
            inverse_hessian = None;
            step = steepest();
        }
        let length = step.norm();
        if length > reach.most {
            step *= reach.most / length;
        }
        let mut taken = None;
        for _ in 0..BACKTRACK_MAX_COUNT {
            let there = slope.stepped(&here, &step);
            if there.energy <= here.energy + GAIN_FRACTION_MIN * step.dot(&here.gradient) {
                taken = Some(there);
                break;
            }
            step *= BACKTRACK;
        }
        let Some(there) = taken else {
            break;
        };
        let change = there.gradient - here.gradient;
        let curvature = change.dot(&step);
        if curvature > CURVATURE_MIN * change.norm() * step.norm() {
            let inverse = inverse_hessian.unwrap_or_else(|| Matrix6::identity() * (curvature / change.norm_squared()));
            let left = Matrix6::identity() - step * change.transpose() / curvature;
            inverse_hessian = Some(left * inverse * left.transpose() + step * step.transpose() / curvature);
        }
        let gained = here.energy - there.energy;
        here = there;
        if step.norm() < reach.least || gained < ENERGY_FRACTION_MIN * here.energy.abs() {
            break;
        }
    }
    slope.bottom(&here)
}

impl<'a> Slope<'a> {
    fn new(system: &'a System<'a>, softening: f64) -> Self {
        Self {
            system,
            softening,
            gyration: system.gyration(),
            evaluation_count: 0,
        }
    }

    fn place(&mut self, pose: &Isometry3<f64>) -> Place {
        self.evaluation_count += 1;
        let loads = self.system.loads(pose, self.softening);
        let (turn, shift) = (-loads.torque / self.gyration, -loads.force);
        Place {
            pose: *pose,
            pivot: loads.pivot,
            energy: loads.energy,
            gradient: Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z),
        }
    }

    fn stepped(&mut self, from: &Place, step: &Vector6<f64>) -> Place {
        let turn = step.fixed_rows::<3>(0) / self.gyration;
        let shift = step.fixed_rows::<3>(3) * self.system.radius();
        let motion = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
        self.place(&moved(&from.pose, &from.pivot, &motion))
    }

    fn bottom(&self, place: &Place) -> Bottom {
        Bottom {
            pose: place.pose,
            energy: place.energy,
            evaluation_count: self.evaluation_count,
        }
    }
}

/// The least share of the gain that the slope promises.
const GAIN_FRACTION_MIN: f64 = 1e-4;
const LONGER: f64 = 1.6;
const SHORTER: f64 = 0.5;
const MOMENTUM: f64 = 0.6;
const BACKTRACK: f64 = 0.35;
const BACKTRACK_MAX_COUNT: u32 = 12;
const CURVATURE_MIN: f64 = 1e-12;
/// A smaller relative gain is rounding in single precision.
const ENERGY_FRACTION_MIN: f64 = 1e-9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::blade;
    use nalgebra::Vector3;

    #[test]
    fn the_slope_of_a_rigid_body_is_its_force_and_torque() {
        let (template, reference) = (blade(300, 0.0), blade(300, 0.5));
        let system = System::new(template.points(), reference.points()).unwrap();
        let pose = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.4, -0.3, 0.6));
        for softening in [0.1, 0.3] {
            let mut slope = Slope::new(&system, softening);
            let here = slope.place(&pose);
            for axis in 0..6 {
                let mut step = Vector6::zeros();
                step[axis] = 2e-3;
                let rise = slope.stepped(&here, &step).energy - slope.stepped(&here, &-step).energy;
                let error = (rise / 4e-3 - here.gradient[axis]).abs();
                assert!(error < 0.01 * here.gradient.norm(), "{softening} {axis}: {error}");
            }
        }
    }

    #[test]
    fn every_rule_ends_lower_than_it_began() {
        let (template, reference) = (blade(300, 0.0), blade(300, 0.5));
        let system = System::new(template.points(), reference.points()).unwrap();
        let start = Isometry3::new(Vector3::new(0.1, -0.1, 0.1), Vector3::new(0.1, -0.2, 0.3));
        let reach = Reach {
            first: 0.05,
            most: 0.1,
            least: 1e-4,
            evaluation_max_count: 100,
        };
        for rule in [line_search, momentum, quasi_newton] {
            let bottom = rule(&system, &start, 0.1, &reach);
            assert!(bottom.energy < system.loads(&start, 0.1).energy);
            assert!(bottom.pose.rotation.angle() < 0.05, "{bottom:?}");
            assert!(bottom.evaluation_count <= 112);
        }
    }
}
