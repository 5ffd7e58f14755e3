//! The maximisation step that all rigid mixtures share: from what the centres claim to the pose that suits them best.

use bladescan::geometry::PointCloud;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::affinity::{Claim, Lookers};
use crate::generate::extents;
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

    /// The moments of the normals.
    pub(crate) fn normal_moments(&self) -> Matrix3<f64> {
        let normals = self.claims.iter().zip(self.lookers.normals());
        normals.map(|(claim, normal)| claim.normal * normal.transpose()).sum()
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

    /// The mean of these over lookers and axes: the mixture's variance in that pose.
    pub(crate) fn variance_at(&self, pose: &Isometry3<f64>) -> f64 {
        self.squared_at(pose) / (3.0 * self.mass().max(MASS_MIN))
    }

    /// Where the centres want the looker, times its mass.
    fn partner(&self, claim: &Claim, point: &Point3<f64>) -> Vector3<f64> {
        (self.centres_from_lookers * point).coords * claim.mass + claim.offset
    }
}

/// The mean over all pairs and axes of the squared distance, the source placed by `start`: the first variance of the mixtures.
pub(crate) fn first_variance(source: &PointCloud, target: &PointCloud, start: &Isometry3<f64>) -> f64 {
    let placed: Vec<Point3<f64>> = source.points().iter().map(|point| start * point).collect();
    let (mean, scatter) = mean_and_scatter(&placed);
    let (other_mean, other_scatter) = mean_and_scatter(target.points());
    ((mean - other_mean).norm_squared() + scatter + other_scatter) / 3.0
}

/// The mean, and the mean squared distance from it.
pub(crate) fn mean_and_scatter(points: &[Point3<f64>]) -> (Point3<f64>, f64) {
    let mean = bladescan::geometry::statistics::mean(points);
    let squared: f64 = points.iter().map(|point| (point - mean).norm_squared()).sum();
    (mean, squared / points.len().max(1) as f64)
}

/// What a Gaussian of this variance on each axis integrates to, 1 at its middle.
pub(crate) fn gaussian_volume(variance: f64) -> f64 {
    (std::f64::consts::TAU * variance).powf(1.5)
}

/// The volume of the box that holds the points.
pub(crate) fn box_volume(points: &[Point3<f64>]) -> f64 {
    let (low, high) = extents(points);
    (high - low).iter().map(|side| side.max(f64::MIN_POSITIVE)).product()
}

/// Less mass than this is none.
pub(crate) const MASS_MIN: f64 = 1e-280;
