//! The fine stage point by point, for clouds without surfaces to speak of: noise of the order of the spacing, or the same
//! points once more.
//!
//! There the cloud that is the less rough is taken for the centres of a mixture and the other one for its lookers. Whether
//! that is right the residuals say: noise is as large along the surface as across it, while points of the same surface in
//! other places are apart along the surface only. Then the surfaces say more than the points.

use nalgebra::{Isometry3, Matrix6, Vector3};

use super::icp::Sample;
use super::mixture::{Likeliest, Mixture, Model};
use super::uncertainty::{covariance_of, may_be_preferred};
use crate::geometry::statistics::mean;

/// Two samples and which of them looks at which.
pub(super) struct Pointwise {
    mixture: Mixture,
    roles: Roles,
    /// Of the centres, in their order.
    normals: Vec<Vector3<f64>>,
    /// The centroid of the template's sample.
    centroid: nalgebra::Point3<f64>,
}

/// Whose points are the centres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Roles {
    /// The reference's points are drawn from the template's.
    TemplateIsCentres,
    /// The template's points are drawn from the reference's.
    ReferenceIsCentres,
}

/// What a start comes to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Solution {
    pub(super) reference_from_template: Isometry3<f64>,
    likeliest: Likeliest,
}

impl Pointwise {
    /// `None` when either sample has no extent.
    pub(super) fn new(template: &Sample, reference: &Sample, roles: Roles) -> Option<Self> {
        let (centres, lookers) = match roles {
            Roles::TemplateIsCentres => (template, reference),
            Roles::ReferenceIsCentres => (reference, template),
        };
        Some(Self {
            mixture: Mixture::new(&centres.points, &lookers.points)?,
            roles,
            normals: centres.normals.clone(),
            centroid: mean(&template.points),
        })
    }

    /// The most likely pose near `start`, which is off by about `noise` or less, in the clouds' unit.
    pub(super) fn solve(&self, start: &Isometry3<f64>, noise: f64) -> Option<Solution> {
        let likeliest = self.mixture.likeliest(&Model {
            pose: self.swapped(start),
            sigma: noise,
            outlier_fraction: START_OUTLIER_FRACTION,
        })?;
        Some(Solution {
            reference_from_template: self.swapped(&likeliest.model.pose),
            likeliest,
        })
    }

    /// Whether the residuals are those of noise: about as large across the surface as along it.
    pub(super) fn is_noise(&self, solution: &Solution) -> bool {
        let model = &solution.likeliest.model;
        let (across, along) = self.mixture.spread(model, &self.normals);
        across > ISOTROPIC_MIN * along
    }

    /// The covariance of `[rx ry rz tx ty tz]` about the template's centroid, in the reference frame.
    pub(super) fn covariance(&self, solution: &Solution) -> Option<Matrix6<f64>> {
        let covariance = covariance_of(&self.mixture, &solution.likeliest.model)?;
        match self.roles {
            Roles::ReferenceIsCentres => Some(covariance),
            Roles::TemplateIsCentres => {
                // A small motion of the reference in the template's frame is the opposite motion of the template, seen
                // from the reference, at another point.
                let pose = solution.likeliest.model.pose;
                let back = pose.rotation.inverse().to_rotation_matrix().into_inner();
                let arm = self.centroid - pose * self.mixture.looker_origin();
                let mut change = Matrix6::zeros();
                change.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
                change.fixed_view_mut::<3, 3>(3, 3).copy_from(&-back);
                change
                    .fixed_view_mut::<3, 3>(3, 0)
                    .copy_from(&(back * arm.cross_matrix()));
                Some(change * covariance * change.transpose())
            }
        }
    }

    /// Whether other samples of the same surfaces might have preferred `rival` to `best`.
    pub(super) fn may_be_preferred(&self, best: &Solution, rival: &Solution) -> bool {
        let words = |solution: &Solution| self.mixture.words(&solution.likeliest.model);
        may_be_preferred(&words(best), &words(rival))
    }

    fn swapped(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        match self.roles {
            Roles::TemplateIsCentres => pose.inverse(),
            Roles::ReferenceIsCentres => *pose,
        }
    }
}

impl Roles {
    /// The less rough cloud says where the other's points come from; the template when they are alike.
    pub(super) fn of(template_scatter: f64, reference_scatter: f64) -> Self {
        if reference_scatter < template_scatter {
            Self::ReferenceIsCentres
        } else {
            Self::TemplateIsCentres
        }
    }
}

impl Solution {
    pub(super) fn log_likelihood(&self) -> f64 {
        self.likeliest.log_likelihood
    }

    pub(super) fn iterations(&self) -> u32 {
        self.likeliest.evaluation_count
    }

    /// The noise that explains the residuals, in the clouds' unit.
    pub(super) fn noise(&self) -> f64 {
        self.likeliest.model.sigma
    }
}

const START_OUTLIER_FRACTION: f64 = 0.1;
/// Residuals across the surface over those along it, from which on they are noise. Measured: 0.99 to 1.01 where points
/// repeat; independent samples 0.60 (noise a tenth of the spacing) to 0.92 (as large as the spacing), and where the ratio
/// is 0.83 to 0.9 points and surfaces are as good.
const ISOTROPIC_MIN: f64 = 0.85;
