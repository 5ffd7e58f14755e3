//! The hybrid mixture model: Z. Min, J. Wang, M. Q.-H. Meng, "Robust generalized point cloud registration with orientational
//! data based on expectation maximization", IEEE T-ASE 17(1), 2020; and the same authors on hybrid mixture models, 2019.
//!
//! | paper | here | unit |
//! |---|---|---|
//! | x_n, x̂_n; y_m, ŷ_m | points and normals of the target; of the source | the clouds'; – |
//! | w | `outlier_fraction` | – |
//! | σ² | `variance` | the clouds', squared |
//! | κ | `concentration` | – |
//!
//! A target point comes from a source point by a Gaussian in its place and a von Mises-Fisher distribution of its normal, or
//! from a uniform part over the target's box and all directions. The rotation maximises both terms together in closed form;
//! σ² and κ are found on the way (κ by Banerjee's approximation). Simplified: one isotropic σ and one κ for all; and since
//! estimated normals have no sign, each is taken either way with the same probability, so that the density is that of
//! `cosh(κ x̂ᵀ R ŷ)` and each pair of normals counts `tanh(κ x̂ᵀ R ŷ)`.

use bladescan::geometry::PointCloud;
use bladescan::geometry::nearest::NearestPoints;
use bladescan::geometry::normals::estimated_normals;
use nalgebra::{Isometry3, Vector3};

use super::affinity::{Attraction, Centres, Lookers};
use super::expectation::{Expectation, MASS_MIN, box_volume, first_variance, gaussian_volume, mean_and_scatter};
use super::exponential::exp;

/// The mixture and when to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HmmSettings {
    /// w: the share of the target that is expected to be outliers.
    pub(crate) outlier_fraction: f64,
    /// The first κ.
    pub(crate) start_concentration: f64,
    /// The most iterations.
    pub(crate) iteration_max_count: u32,
    /// Stops when σ² changes by less than this share of itself.
    pub(crate) stop_fraction: f64,
    /// Neighbours in the plane fit of a normal, for clouds that have none.
    pub(crate) neighbour_count: usize,
}

impl Default for HmmSettings {
    fn default() -> Self {
        Self {
            outlier_fraction: OUTLIER_FRACTION,
            start_concentration: START_CONCENTRATION,
            iteration_max_count: ITERATION_MAX_COUNT,
            stop_fraction: STOP_FRACTION,
            neighbour_count: NEIGHBOUR_COUNT,
        }
    }
}

/// Registers from `start` (target_from_source).
pub(crate) fn register(
    source: &PointCloud,
    target: &PointCloud,
    start: &Isometry3<f64>,
    settings: &HmmSettings,
) -> Isometry3<f64> {
    let centres = Centres::with_normals(source.points(), &normals(source, settings.neighbour_count));
    let lookers = Lookers::with_normals(target.points(), &normals(target, settings.neighbour_count));
    let mut variance = first_variance(source, target, start);
    let least = VARIANCE_MIN_FACTOR * mean_and_scatter(target.points()).1;
    let mut concentration = settings.start_concentration;
    let odds = settings.outlier_fraction / (1.0 - settings.outlier_fraction);
    let density = odds * source.len() as f64 / box_volume(target.points());
    let mut source_from_target = start.inverse();
    for _ in 0..settings.iteration_max_count {
        let attraction = Oriented {
            sigma: variance.sqrt(),
            concentration,
        };
        // The quotient of the constants of the uniform and of the hybrid density.
        let directions = (1.0 - (-2.0 * concentration).exp()) / concentration;
        let outlier_mass = gaussian_volume(variance) * density * directions;
        let claims = centres.claims(&lookers, &source_from_target, attraction);
        let expectation = Expectation::new(&lookers, source_from_target, claims, outlier_mass);
        let moments = expectation.normal_moments();
        source_from_target = expectation.best_pose_with(1.0 / variance, &(moments * concentration));
        let last = variance;
        variance = expectation.variance_at(&source_from_target);
        let cosines = moments.dot(&source_from_target.rotation.to_rotation_matrix().into_inner());
        concentration = concentration_of(cosines / expectation.mass().max(MASS_MIN));
        if variance <= least || (last - variance).abs() <= settings.stop_fraction * variance {
            break;
        }
    }
    source_from_target.inverse()
}

/// A Gaussian in place and two von Mises-Fisher distributions of the direction, along a normal and against it.
#[derive(Debug, Clone, Copy)]
struct Oriented {
    sigma: f64,
    concentration: f64,
}

impl Attraction for Oriented {
    const IS_ORIENTED: bool = true;

    fn sigma(&self) -> f64 {
        self.sigma
    }

    #[inline(always)]
    fn claims(&self, squared: f64, cosine: f64) -> (f64, f64) {
        let place = squared * (-0.5 / (self.sigma * self.sigma));
        let along = exp(place + self.concentration * (cosine - 1.0));
        let against = exp(place - self.concentration * (cosine + 1.0));
        (along, against)
    }
}

/// κ of a mean cosine (Banerjee et al. 2005).
fn concentration_of(mean_cosine: f64) -> f64 {
    let r = mean_cosine.clamp(0.0, 1.0);
    (r * (3.0 - r * r) / (1.0 - r * r).max(f64::MIN_POSITIVE)).clamp(CONCENTRATIONS[0], CONCENTRATIONS[1])
}

/// The cloud's own normals, or estimated ones.
fn normals(cloud: &PointCloud, neighbour_count: usize) -> Vec<Vector3<f64>> {
    cloud.normals().map_or_else(
        || {
            estimated_normals(
                cloud.points(),
                &NearestPoints::new(cloud.points()),
                neighbour_count,
                None,
            )
        },
        <[_]>::to_vec,
    )
}

/// As in CPD.
const OUTLIER_FRACTION: f64 = 0.1;

/// Normals within about 20 degrees of each other.
const START_CONCENTRATION: f64 = 10.0;

/// As in CPD.
const ITERATION_MAX_COUNT: u32 = 150;

/// σ stands still.
const STOP_FRACTION: f64 = 1e-5;

/// As in the product's registration of views.
const NEIGHBOUR_COUNT: usize = 10;

/// Ten times the rounding of a double, as in CPD.
const VARIANCE_MIN_FACTOR: f64 = 2.2e-15;

/// Least and largest κ: no preference, and half a degree.
const CONCENTRATIONS: [f64; 2] = [1e-3, 1e4];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::cpd::{self, CpdSettings};
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn permuted_points_are_laid_on_each_other() {
        let pair = testing::permuted(300, 30.0, [0.3, -0.2, 0.1]);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }

    #[test]
    fn outliers_go_to_the_uniform_part() {
        let pair = testing::with_scattered_outliers(300, 100);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }

    #[test]
    fn normals_decide_where_the_points_cannot() {
        let pair = testing::ball_with_a_field_of_normals(400, 25.0);
        let start = Isometry3::identity();
        let by_points = cpd::register(&pair.source, &pair.target, &start, &CpdSettings::default());
        let turn = |found: &Isometry3<f64>| (pair.truth.rotation.inverse() * found.rotation).angle().to_degrees();
        assert!(turn(&by_points) > 10.0, "{}", turn(&by_points));
        let found = register(&pair.source, &pair.target, &start, &HmmSettings::default());
        assert!(turn(&found) < 2.0, "{}", turn(&found));
    }

    #[test]
    fn the_concentration_of_a_mean_cosine_gives_it_back() {
        for cosine in [0.3, 0.7, 0.95, 0.999] {
            let kappa = concentration_of(cosine);
            assert!((1.0 / kappa.tanh() - 1.0 / kappa - cosine).abs() < 0.02, "{cosine}");
        }
    }
}
