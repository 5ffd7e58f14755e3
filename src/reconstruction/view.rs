//! One view against the model: registration and the decision to merge.

use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use super::model::{Model, with_normals};
use crate::geometry::PointCloud;
use crate::registration::{Overlap, Registration, Search, Settings, Stage, Status, register_from};

/// How views are registered and when they are merged.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewSettings {
    /// The registration. `Search::NearPart` suits a start from a robot's pose.
    pub registration: Settings,
    /// The paper's τ₀.
    pub overlap_min: OverlapMin,
    /// How far the result may lie from the start; `None` where the start is only a guess.
    pub prior_limits: Option<PriorLimits>,
}

impl Default for ViewSettings {
    /// A tenth of the view must overlap, the start is a robot's pose, and nothing limits the distance from it.
    fn default() -> Self {
        Self {
            registration: Settings {
                search: Search::NearPart { reach_factor: 0.2 },
                ..Settings::default()
            },
            overlap_min: OverlapMin::Fraction(0.1),
            prior_limits: None,
        }
    }
}

/// The least overlap of a view that is merged, τ₀.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OverlapMin {
    /// As a share of the view's points, 0 to 1.
    Fraction(f64),
    /// As a number of points.
    Count(usize),
}

/// How far a result may lie from the predicted pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PriorLimits {
    /// Largest angle between predicted and found orientation, rad.
    pub rotation_max_rad: f64,
    /// Largest distance between the predicted and found place of the view's centroid, in the clouds' unit.
    pub translation_max_distance: f64,
}

/// A view's registration and what follows from it.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewRegistration {
    /// The registration to the model; its `reference_from_template` is `model_from_view`. `None` for the first view,
    /// which defines the model's frame by its start.
    pub registration: Option<Registration>,
    /// The pose to merge the view at: the registered one, or the start for the first view and for discarded views.
    pub model_from_view: Isometry3<f64>,
    /// Angle between the start and the registered pose, rad.
    pub prior_rotation_rad: f64,
    /// Distance between the start's and the registered place of the view's centroid, in the clouds' unit.
    pub prior_distance: f64,
    /// Whether to merge.
    pub decision: Decision,
}

/// Whether a view is merged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// It is.
    Merge,
    /// It is not.
    Discard(DiscardReason),
}

/// Why a view is not merged.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum DiscardReason {
    /// The view has too few points.
    #[error("the view has only {point_count} points")]
    TooFewPoints {
        /// How many.
        point_count: usize,
    },
    /// No pose was found.
    #[error("the registration failed")]
    Failed,
    /// Another pose explains the view as well, or this one leaves residuals that noise does not explain. Merging a wrong
    /// pose would spoil every later view.
    #[error("the registration is ambiguous (residual {rmse:.4})")]
    Ambiguous {
        /// The registration's residual, in the clouds' unit.
        rmse: f64,
    },
    /// Less than τ₀.
    #[error("the overlap of {count} points ({fraction:.3} of the view) is less than required")]
    TooLittleOverlap {
        /// Overlapping points.
        count: usize,
        /// Their share of the view.
        fraction: f64,
    },
    /// The result contradicts the predicted pose.
    #[error("the result lies {rotation_rad:.4} rad and a distance of {distance:.3} from the predicted pose")]
    FarFromPrior {
        /// The angle.
        rotation_rad: f64,
        /// The distance of the centroids, in the clouds' unit.
        distance: f64,
    },
}

/// Registers `view` (camera frame, normals facing the camera or none) to `model` from `start` (`model_from_view` as
/// predicted) and decides whether to merge it.
///
/// The first view is merged at `start` without registration if it has enough points to be registered to. Pure: merging
/// itself is [`Model::merged_with`].
pub fn register_view(
    view: &PointCloud,
    model: &Model,
    start: &Isometry3<f64>,
    settings: &ViewSettings,
    seed_stream: ChaCha8Rng,
    on_stage: &mut dyn FnMut(&Stage),
) -> ViewRegistration {
    let mut out = ViewRegistration {
        registration: None,
        model_from_view: *start,
        prior_rotation_rad: 0.0,
        prior_distance: 0.0,
        decision: Decision::Merge,
    };
    if view.len() < crate::registration::POINT_MIN_COUNT {
        out.decision = Decision::Discard(DiscardReason::TooFewPoints {
            point_count: view.len(),
        });
        return out;
    }
    if model.is_empty() {
        return out;
    }
    let Ok(reference) = model.reference() else {
        out.decision = Decision::Discard(DiscardReason::Failed);
        return out;
    };
    let view = with_normals(view);
    let registration = register_from(&view, reference, start, &settings.registration, seed_stream, on_stage);
    let found = registration.reference_from_template;
    let centroid = view.centroid();
    out.prior_rotation_rad = (start.rotation.inverse() * found.rotation).angle();
    out.prior_distance = (start * centroid - found * centroid).norm();
    out.decision = decide(&registration, out.prior_rotation_rad, out.prior_distance, settings);
    if out.decision == Decision::Merge {
        out.model_from_view = found;
    }
    out.registration = Some(registration);
    out
}

fn decide(registration: &Registration, rotation_rad: f64, distance: f64, settings: &ViewSettings) -> Decision {
    if registration.status == Status::Failed {
        return Decision::Discard(DiscardReason::Failed);
    }
    if registration.status == Status::Ambiguous {
        return Decision::Discard(DiscardReason::Ambiguous {
            rmse: registration.rmse,
        });
    }
    let Overlap { count, fraction } = registration.overlap;
    let enough = match settings.overlap_min {
        OverlapMin::Fraction(minimum) => fraction >= minimum,
        OverlapMin::Count(minimum) => count >= minimum,
    };
    if !enough {
        return Decision::Discard(DiscardReason::TooLittleOverlap { count, fraction });
    }
    if let Some(limits) = settings.prior_limits
        && (rotation_rad > limits.rotation_max_rad || distance > limits.translation_max_distance)
    {
        return Decision::Discard(DiscardReason::FarFromPrior { rotation_rad, distance });
    }
    Decision::Merge
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::blade;
    use nalgebra::Vector3;
    use rand_chacha::rand_core::SeedableRng;

    fn model() -> Model {
        Model::default().merged_with(&with_normals(&blade(6000, 0.0)), &Isometry3::identity(), 0.01)
    }

    fn against_model(settings: &ViewSettings) -> ViewRegistration {
        let truth = Isometry3::new(Vector3::new(0.02, 0.01, 0.0), Vector3::new(0.0, 0.0, 0.17));
        let view = with_normals(&blade(5000, 0.5)).transformed(&truth.inverse());
        let start = Isometry3::translation(0.005, 0.005, 0.0) * truth;
        register_view(
            &view,
            &model(),
            &start,
            settings,
            ChaCha8Rng::seed_from_u64(1),
            &mut |_| {},
        )
    }

    #[test]
    fn the_first_view_is_merged_at_its_start() {
        let start = Isometry3::translation(1.0, 0.0, 0.0);
        let rng = ChaCha8Rng::seed_from_u64(1);
        let first = register_view(
            &blade(500, 0.0),
            &Model::default(),
            &start,
            &ViewSettings::default(),
            rng,
            &mut |_| {},
        );
        assert_eq!((first.decision, first.model_from_view), (Decision::Merge, start));
        assert_eq!(first.registration, None);
    }

    #[test]
    fn a_view_that_overlaps_is_merged_at_the_registered_pose() {
        let out = against_model(&ViewSettings::default());
        assert_eq!(out.decision, Decision::Merge, "{out:?}");
        assert!(out.prior_distance > 0.003 && out.prior_distance < 0.02, "{out:?}");
    }

    #[test]
    fn less_overlap_than_required_discards_the_view() {
        let out = against_model(&ViewSettings {
            overlap_min: OverlapMin::Count(5001),
            ..ViewSettings::default()
        });
        assert!(
            matches!(out.decision, Decision::Discard(DiscardReason::TooLittleOverlap { .. })),
            "{out:?}"
        );
    }

    #[test]
    fn a_result_far_from_the_prior_discards_the_view() {
        let out = against_model(&ViewSettings {
            prior_limits: Some(PriorLimits {
                rotation_max_rad: 1.0,
                translation_max_distance: 1e-4,
            }),
            ..ViewSettings::default()
        });
        assert!(
            matches!(out.decision, Decision::Discard(DiscardReason::FarFromPrior { .. })),
            "{out:?}"
        );
    }

    #[test]
    fn a_view_of_a_few_points_is_discarded() {
        let rng = ChaCha8Rng::seed_from_u64(1);
        let view = blade(6, 0.0);
        let out = register_view(
            &view,
            &model(),
            &Isometry3::identity(),
            &ViewSettings::default(),
            rng,
            &mut |_| {},
        );
        assert_eq!(
            out.decision,
            Decision::Discard(DiscardReason::TooFewPoints { point_count: 6 })
        );
    }
}
