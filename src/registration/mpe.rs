//! Minimum Potential Energy: the template falls as a rigid body in the reference's field (the paper's section IV).
//!
//! | paper | here | unit |
//! |---|---|---|
//! | X, Y | template, reference samples | the clouds' unit |
//! | ε² | `softening` | the clouds' unit |
//! | θ_t, s_t | rotation and translation stride | rad, the clouds' unit |
//! | ε_R, ε_t | stop strides | rad, the clouds' unit |
//! | n_p, v_t | axis of rotation, direction of translation | – |
//! | F_R, F_t (eq. RR, tt) | dot products of successive directions | – |
//!
//! Where the printed formulas cannot be meant, `docs/paper.md` says what is done instead.

use std::borrow::Cow;

use nalgebra::{Isometry3, Point3, Vector3, Vector6};

use super::field::{Field, Pull, Summation};
use super::reference::rms_radius;
use super::stride::{Reach, line_search, momentum, quasi_newton};
use super::twist::moved;
use crate::geometry::statistics::mean;

/// How the template falls. Lengths are multiples of the reference's root-mean-square radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MpeSettings {
    /// How forces become a motion; only with [`Stride::Halving`].
    pub formulation: Formulation,
    /// ε² over the reference's radius, for each round in turn: a wide, smooth field first, a sharp one last.
    pub softening_factors: [f64; 2],
    /// Start stride θ_t in radians.
    pub start_rotation_rad: f64,
    /// Start stride s_t over the reference's radius.
    pub start_translation_factor: f64,
    /// Stop stride ε_R in radians.
    pub stop_rotation_rad: f64,
    /// Stop stride ε_t over the reference's radius.
    pub stop_translation_factor: f64,
    /// How far the template falls at once.
    pub stride: Stride,
    /// When the strides are halved; only with [`Stride::Halving`].
    pub halving: Halving,
    /// When the descent ends; only with [`Stride::Halving`].
    pub stop: Stop,
    /// The most iterations of a round.
    pub iteration_max_count: u32,
    /// How the field of the reference is summed.
    pub summation: Summation,
}

impl Default for MpeSettings {
    fn default() -> Self {
        Self {
            formulation: Formulation::RigidBody,
            softening_factors: [0.15, 0.03],
            start_rotation_rad: 0.15,
            start_translation_factor: 0.1,
            stop_rotation_rad: 2e-3,
            stop_translation_factor: 2e-3,
            stride: Stride::QuasiNewton,
            halving: Halving::Independent,
            stop: Stop::Both,
            iteration_max_count: 100,
            summation: Summation::Automatic,
        }
    }
}

/// How the forces on the points become a direction of motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Formulation {
    /// The total force moves, the torque about the template's centroid turns.
    RigidBody,
    /// As printed, but attracting: each force is split along its own point vector from the origin of the reference
    /// frame; the axial parts move, the rest turns, about the origin.
    Literal,
}

/// How far the template falls at once. All but the first follow the gradient of the NFI criterion as a rigid body
/// whatever the formulation, and end when their steps are shorter than the stop stride of the translation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stride {
    /// By the strides, along the unit directions of force and torque; they are halved when the directions reverse (the
    /// paper's rule).
    Halving,
    /// Along the gradient, longer after a gain and shorter after none.
    LineSearch,
    /// Along the gradient and the last step.
    Momentum,
    /// BFGS on SE(3).
    QuasiNewton,
}

/// When a stride is halved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halving {
    /// Each stride when its own direction reverses.
    Independent,
    /// As Algorithm 1 is printed: the translation stride only when both directions reverse.
    Nested,
}

/// When the descent ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stop {
    /// When both strides are small.
    Both,
    /// As Algorithm 1 is printed: when either stride is small.
    Either,
}

/// Where a descent ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Descent {
    /// The pose with the lowest energy met in the last round, `reference_from_template`.
    pub reference_from_template: Isometry3<f64>,
    /// The NFI criterion there (eq. 4 of the paper), over the samples, in 1/radius.
    pub energy: f64,
    /// Iterations of all rounds.
    pub iterations: u32,
}

/// Lets `template` fall from `start` in the field of `reference`.
///
/// Every pair of points counts. With [`Summation::Pairs`] the work is the product of the counts times the iterations, with
/// [`Summation::Tree`] it is nearly linear in the counts, so all points can take part. Empty samples stay at the start.
pub fn descend(
    template: &[Point3<f64>],
    reference: &[Point3<f64>],
    start: &Isometry3<f64>,
    settings: &MpeSettings,
) -> Descent {
    let mut descent = Descent {
        reference_from_template: *start,
        energy: 0.0,
        iterations: 0,
    };
    let Some(system) = System::summed(template, reference, settings.summation) else {
        return descent;
    };
    for (round, &softening) in settings.softening_factors.iter().enumerate() {
        let shrink = 0.25f64.powi(round as i32);
        let ended = system.round(&descent.reference_from_template, softening, shrink, settings);
        descent = Descent {
            iterations: descent.iterations + ended.iterations,
            ..ended
        };
    }
    descent
}

/// A template in the field of a reference. Inside, lengths are over the reference's radius and about its centroid.
pub(super) struct System<'a> {
    template: Cow<'a, [Point3<f64>]>,
    centre: Point3<f64>,
    radius: f64,
    field: Field,
}

/// What acts on a template in one pose.
pub(super) struct Loads {
    /// The total force, times the squared radius.
    pub(super) force: Vector3<f64>,
    /// The total torque about `pivot`, times the radius.
    pub(super) torque: Vector3<f64>,
    /// The template's centroid, in the reference frame.
    pub(super) pivot: Point3<f64>,
    /// The NFI criterion, times the radius.
    pub(super) energy: f64,
}

impl<'a> System<'a> {
    /// `None` without a template or when the reference has no extent.
    pub(super) fn new(template: &'a [Point3<f64>], reference: &[Point3<f64>]) -> Option<Self> {
        Self::summed(template, reference, Summation::Pairs)
    }

    fn summed(template: &'a [Point3<f64>], reference: &[Point3<f64>], summation: Summation) -> Option<Self> {
        let centre = mean(reference);
        let radius = rms_radius(reference, &centre);
        if template.is_empty() || radius <= 0.0 {
            return None;
        }
        let scaled = |point: &Point3<f64>| Point3::from((point - centre) / radius);
        let field = Field::summed(&reference.iter().map(scaled).collect::<Vec<_>>(), summation);
        // Neighbours stay neighbours in every pose, so one order serves all of them.
        let template = match field.best_order(template) {
            Some(order) => order.into_iter().map(|index| template[index]).collect(),
            None => Cow::Borrowed(template),
        };
        Some(Self {
            template,
            centre,
            radius,
            field,
        })
    }

    /// The reference's root-mean-square radius.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// The template's root-mean-square radius over the reference's.
    pub(super) fn gyration(&self) -> f64 {
        (rms_radius(&self.template, &mean(&self.template)) / self.radius).max(f64::MIN_POSITIVE)
    }

    /// Total force, torque about the centroid and energy at `pose`; `softening` is ε² over the radius.
    pub(super) fn loads(&self, pose: &Isometry3<f64>, softening: f64) -> Loads {
        let placed: Vec<Point3<f64>> = self.template.iter().map(|point| pose * point).collect();
        let pulls = self.pulls(&placed, softening);
        let mut loads = Loads {
            force: Vector3::zeros(),
            torque: Vector3::zeros(),
            pivot: mean(&placed),
            energy: 0.0,
        };
        for (point, pull) in placed.iter().zip(&pulls) {
            loads.energy += pull.energy;
            loads.force += pull.force;
            loads.torque += ((point - loads.pivot) / self.radius).cross(&pull.force);
        }
        loads
    }

    fn pulls(&self, placed: &[Point3<f64>], softening: f64) -> Vec<Pull> {
        let scaled: Vec<Point3<f64>> = placed
            .iter()
            .map(|point| Point3::from((point - self.centre) / self.radius))
            .collect();
        self.field.pulls(&scaled, softening)
    }

    fn round(&self, start: &Isometry3<f64>, softening: f64, shrink: f64, settings: &MpeSettings) -> Descent {
        let rule = match settings.stride {
            Stride::Halving => return self.halving_round(start, softening, shrink, settings),
            Stride::LineSearch => line_search,
            Stride::Momentum => momentum,
            Stride::QuasiNewton => quasi_newton,
        };
        let reach = Reach {
            first: settings.start_translation_factor * shrink,
            most: 2.0 * settings.start_translation_factor,
            least: settings.stop_translation_factor,
            evaluation_max_count: settings.iteration_max_count,
        };
        let bottom = rule(self, start, softening, &reach);
        Descent {
            reference_from_template: bottom.pose,
            energy: bottom.energy,
            iterations: bottom.evaluation_count,
        }
    }

    fn halving_round(&self, start: &Isometry3<f64>, softening: f64, shrink: f64, settings: &MpeSettings) -> Descent {
        let mut pose = *start;
        let mut best = Descent {
            reference_from_template: pose,
            energy: f64::INFINITY,
            iterations: 0,
        };
        let mut rotation = settings.start_rotation_rad * shrink;
        let mut translation = settings.start_translation_factor * shrink;
        let (mut last_axis, mut last_direction) = (Vector3::zeros(), Vector3::zeros());
        for _ in 0..settings.iteration_max_count {
            let drive = self.drive(&pose, softening, settings.formulation);
            best.iterations += 1;
            if drive.energy < best.energy {
                best.energy = drive.energy;
                best.reference_from_template = pose;
            }
            let turned_back = drive.axis.dot(&last_axis) < 0.0;
            let moved_back = drive.direction.dot(&last_direction) < 0.0;
            if turned_back {
                rotation /= 2.0;
            }
            if moved_back && (settings.halving == Halving::Independent || turned_back) {
                translation /= 2.0;
            }
            let (turned, shifted) = (
                rotation <= settings.stop_rotation_rad,
                translation <= settings.stop_translation_factor,
            );
            match settings.stop {
                Stop::Both if turned && shifted => break,
                Stop::Either if turned || shifted => break,
                _ => {}
            }
            (last_axis, last_direction) = (drive.axis, drive.direction);
            let turn = drive.axis * rotation;
            let shift = drive.direction * translation * self.radius;
            pose = moved(
                &pose,
                &drive.pivot,
                &Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z),
            );
        }
        best
    }

    /// The directions in which the template is driven at `pose`.
    fn drive(&self, pose: &Isometry3<f64>, softening: f64, formulation: Formulation) -> Drive {
        let loads = match formulation {
            Formulation::RigidBody => self.loads(pose, softening),
            Formulation::Literal => self.literal_loads(pose, softening),
        };
        Drive {
            axis: loads.torque.try_normalize(0.0).unwrap_or_default(),
            direction: loads.force.try_normalize(0.0).unwrap_or_default(),
            pivot: loads.pivot,
            energy: loads.energy,
        }
    }

    /// As printed: each force is split along its own point vector from the origin.
    fn literal_loads(&self, pose: &Isometry3<f64>, softening: f64) -> Loads {
        let placed: Vec<Point3<f64>> = self.template.iter().map(|point| pose * point).collect();
        let pulls = self.pulls(&placed, softening);
        let mut loads = Loads {
            force: Vector3::zeros(),
            torque: Vector3::zeros(),
            pivot: Point3::origin(),
            energy: 0.0,
        };
        for (point, pull) in placed.iter().zip(&pulls) {
            let outward = point.coords.try_normalize(0.0).unwrap_or_default();
            let axial = outward * pull.force.dot(&outward);
            loads.energy += pull.energy;
            loads.force += axial;
            loads.torque += (point.coords / self.radius).cross(&(pull.force - axial));
        }
        loads
    }
}

struct Drive {
    axis: Vector3<f64>,
    direction: Vector3<f64>,
    pivot: Point3<f64>,
    energy: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::blade;

    fn printed(formulation: Formulation, halving: Halving, stop: Stop) -> f64 {
        fall(MpeSettings {
            formulation,
            stride: Stride::Halving,
            halving,
            stop,
            ..MpeSettings::default()
        })
    }

    fn fall(settings: MpeSettings) -> f64 {
        let template = blade(400, 0.0);
        let truth = Isometry3::new(Vector3::new(0.1, -0.1, 0.05), Vector3::new(0.1, 0.2, 0.3));
        let reference: Vec<_> = blade(400, 0.5).points().iter().map(|point| truth * point).collect();
        let ended = descend(template.points(), &reference, &Isometry3::identity(), &settings);
        (truth.inverse() * ended.reference_from_template).rotation.angle()
    }

    #[test]
    fn a_blade_falls_into_place_by_every_rule() {
        for stride in [
            Stride::Halving,
            Stride::LineSearch,
            Stride::Momentum,
            Stride::QuasiNewton,
        ] {
            let error = fall(MpeSettings {
                stride,
                ..MpeSettings::default()
            });
            assert!(error < 0.06, "{stride:?} {error}");
        }
    }

    #[test]
    fn the_printed_halving_and_stop_stay_selectable() {
        let error = printed(Formulation::RigidBody, Halving::Nested, Stop::Either);
        assert!(error < 0.2, "{error}");
        assert!(printed(Formulation::Literal, Halving::Nested, Stop::Either).is_finite());
    }

    #[test]
    fn in_the_field_of_a_tree_the_template_falls_to_the_same_place() {
        let template = blade(3000, 0.0);
        let truth = Isometry3::new(Vector3::new(0.1, -0.1, 0.05), Vector3::new(0.1, 0.2, 0.3));
        let reference = blade(3000, 0.5).transformed(&truth);
        let fallen = |summation| {
            let settings = MpeSettings {
                summation,
                ..MpeSettings::default()
            };
            descend(template.points(), reference.points(), &Isometry3::identity(), &settings).reference_from_template
        };
        let between = fallen(Summation::Pairs).inverse() * fallen(Summation::Tree);
        assert!(between.rotation.angle() < 5e-3, "{}", between.rotation.angle());
        assert!(
            between.translation.vector.norm() < 5e-3,
            "{}",
            between.translation.vector.norm()
        );
    }

    #[test]
    fn nothing_moves_without_points() {
        let start = Isometry3::translation(1.0, 2.0, 3.0);
        let ended = descend(&[], blade(50, 0.0).points(), &start, &MpeSettings::default());
        assert_eq!((ended.reference_from_template, ended.iterations), (start, 0));
    }
}
