//! The maximisation step that all rigid mixtures share: from what the centres claim to the pose that suits them best.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::affinity::{Claim, Lookers};
use crate::kabsch::motion_from_moments;

/// What each looker's share in the centres is, in one pose: claims that are divided by their total.
pub(crate) struct Expectation<'a> {
    lookers: &'a Lookers,
    centres_from_lookers: Isometry3<f64>,
    claims: Vec<Claim>,
}

impl<'a> Expectation<'a> {
    /// Divides each claim by its mass and `outlier_mass`: what is left of a looker belongs to no centre.
    pub(crate) fn new(
        lookers: &'a Lookers,
        centres_from_lookers: Isometry3<f64>,
        claims: Vec<Claim>,
        outlier_mass: f64,
    ) -> Self {
        // A looker that nothing claims must not make 0/0.
        let share = |claim: Claim| claim.scaled(1.0 / (claim.mass + outlier_mass).max(MASS_MIN));
        Self {
            lookers,
            centres_from_lookers,
            claims: claims.into_iter().map(share).collect(),
        }
    }

    /// How many lookers belong to centres, in the mean.
    pub(crate) fn mass(&self) -> f64 {
        self.claims.iter().map(|claim| claim.mass).sum()
    }

    /// The pose of least expected squared distance.
    pub(crate) fn best_pose(&self) -> Isometry3<f64> {
        self.best_pose_with(1.0, &Matrix3::zeros())
    }

    /// As `best_pose`, with the moments of the places times `factor` and `moments` added to them.
    pub(crate) fn best_pose_with(&self, factor: f64, moments: &Matrix3<f64>) -> Isometry3<f64> {
        let mass = self.mass();
        if mass < MASS_MIN {
            return self.centres_from_lookers;
        }
        let (mut here, mut there) = (Vector3::zeros(), Vector3::zeros());
        for (claim, point) in self.claims.iter().zip(self.lookers.points()) {
            here += point.coords * claim.mass;
            there += self.partner(claim, point);
        }
        here /= mass;
        there /= mass;
        let mut sum = Matrix3::zeros();
        for (claim, point) in self.claims.iter().zip(self.lookers.points()) {
            sum += (self.partner(claim, point) - there * claim.mass) * (point.coords - here).transpose();
        }
        motion_from_moments(&(sum * factor + moments), &here, &there)
    }

    /// The moments of the normals and the mean of their cosines in the pose.
    pub(crate) fn normals(&self) -> (Matrix3<f64>, f64) {
        let (mut moments, mut cosines) = (Matrix3::zeros(), 0.0);
        for (claim, normal) in self.claims.iter().zip(self.lookers.normals()) {
            moments += claim.normal * normal.transpose();
            cosines += claim.normal.dot(&(self.centres_from_lookers * normal));
        }
        (moments, cosines / self.mass().max(MASS_MIN))
    }

    /// The expected squared distances, summed, once the lookers are moved to `pose`.
    pub(crate) fn squared_at(&self, pose: &Isometry3<f64>) -> f64 {
        let mut sum = 0.0;
        for (claim, point) in self.claims.iter().zip(self.lookers.points()) {
            let step = pose * point - self.centres_from_lookers * point;
            sum += claim.squared - 2.0 * step.dot(&claim.offset) + step.norm_squared() * claim.mass;
        }
        sum.max(0.0)
    }

    /// Where the centres want the looker, times its mass.
    fn partner(&self, claim: &Claim, point: &Point3<f64>) -> Vector3<f64> {
        (self.centres_from_lookers * point).coords * claim.mass + claim.offset
    }
}

/// The mean over all pairs and axes of the squared distance: the first variance of most mixtures.
pub(crate) fn mean_square_of_all_pairs(points: &[Point3<f64>], others: &[Point3<f64>]) -> f64 {
    let (mean, scatter) = mean_and_scatter(points);
    let (other_mean, other_scatter) = mean_and_scatter(others);
    ((mean - other_mean).norm_squared() + scatter + other_scatter) / 3.0
}

/// The mean, and the mean squared distance from it.
pub(crate) fn mean_and_scatter(points: &[Point3<f64>]) -> (Point3<f64>, f64) {
    let mean = bladescan::geometry::statistics::mean(points);
    let squared: f64 = points.iter().map(|point| (point - mean).norm_squared()).sum();
    (mean, squared / points.len().max(1) as f64)
}

/// The volume of the box that holds the points.
pub(crate) fn box_volume(points: &[Point3<f64>]) -> f64 {
    (0..3)
        .map(|axis| {
            let values = points.iter().map(|point| point[axis]);
            let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                (low.min(value), high.max(value))
            });
            (high - low).max(f64::MIN_POSITIVE)
        })
        .product()
}

/// Less mass than this is none.
const MASS_MIN: f64 = 1e-280;
