//! Rigid Bayesian coherent point drift: O. Hirose, "A Bayesian formulation of coherent point drift", PAMI 43(7), 2021, in the
//! limit λ → ∞, where the displacement field v and its covariance vanish; the scale is fixed to 1.
//!
//! | paper | here | unit |
//! |---|---|---|
//! | x_n, N; y_m, M | target; source | the clouds' |
//! | ω | `outlier_fraction` | – |
//! | γ | `sigma_factor` | – |
//! | κ | `concentration`, `None` for ∞ | – |
//! | ⟨α_m⟩ | `weights` | – |
//! | σ | `sigma` | the clouds' |
//!
//! Differs from CPD in the uniform part (the density of a box about the target, as in the authors' program), in the share ⟨α_m⟩ of
//! each centre where κ is finite, and in the end: at least a number of iterations, then as soon as σ hardly changes. The sums
//! over pairs are exact: neither Nyström's method nor a switch to a tree.

use bladescan::geometry::PointCloud;
use nalgebra::Isometry3;

use super::affinity::{Centres, Claim, Gaussian, Lookers};
use super::expectation::{Expectation, MASS_MIN, box_volume, first_variance, gaussian_volume, mean_and_scatter};

/// The mixture and when to stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BcpdSettings {
    /// ω: the share of the target that is expected to be outliers.
    pub(crate) outlier_fraction: f64,
    /// γ: the first σ over the root mean square distance of all pairs on an axis.
    pub(crate) sigma_factor: f64,
    /// κ: how alike the shares of the centres are; `None`: all the same.
    pub(crate) concentration: Option<f64>,
    /// The least and the most iterations.
    pub(crate) iteration_counts: [u32; 2],
    /// Stops when σ changes by less than this multiple of the source's root mean square extent on an axis.
    pub(crate) stop_factor: f64,
}

impl Default for BcpdSettings {
    fn default() -> Self {
        Self {
            outlier_fraction: OUTLIER_FRACTION,
            sigma_factor: SIGMA_FACTOR,
            concentration: None,
            iteration_counts: ITERATION_COUNTS,
            stop_factor: STOP_FACTOR,
        }
    }
}

/// Registers from `start` (target_from_source).
pub(crate) fn register(
    source: &PointCloud,
    target: &PointCloud,
    start: &Isometry3<f64>,
    settings: &BcpdSettings,
) -> Isometry3<f64> {
    let (mut centres, lookers) = (Centres::new(source.points()), Lookers::new(target.points()));
    let mut shares = settings.concentration.map(|kappa| Shares::new(source, target, kappa));
    let mut sigma = settings.sigma_factor * first_variance(source, target, start).sqrt();
    let stop = settings.stop_factor * (mean_and_scatter(source.points()).1 / 3.0).sqrt();
    let count = source.len() as f64;
    // The centres weigh 1 in the mean, and not 1/M, so the uniform part weighs M times as much.
    let odds = count * settings.outlier_fraction / (1.0 - settings.outlier_fraction);
    // As in the authors' program, whose box is a little wider than the points'.
    let widened = (1.0 + 1.0 / target.len().max(1) as f64).powi(3);
    let density = odds / (box_volume(target.points()) * widened);
    let [least_count, most_count] = settings.iteration_counts;
    let mut source_from_target = start.inverse();
    for iteration in 0..most_count {
        let outlier_mass = gaussian_volume(sigma * sigma) * density;
        let claims = centres.claims(&lookers, &source_from_target, Gaussian { sigma });
        if let Some(shares) = &mut shares {
            shares.update(&claims, &lookers, &source_from_target, sigma, outlier_mass);
        }
        let expectation = Expectation::new(&lookers, source_from_target, claims, outlier_mass);
        source_from_target = expectation.best_pose();
        let last = sigma;
        sigma = expectation.variance_at(&source_from_target).sqrt();
        if let Some(shares) = &shares {
            centres.weigh(&shares.weights);
        }
        if sigma <= f64::MIN_POSITIVE || iteration > least_count && (sigma < stop || (sigma - last).abs() < stop) {
            break;
        }
    }
    source_from_target.inverse()
}

/// The shares ⟨α_m⟩ of the centres, times M.
struct Shares {
    kappa: f64,
    /// The target as centres, for the sums over it at each source point.
    target: Centres,
    source: Lookers,
    weights: Vec<f64>,
}

impl Shares {
    fn new(source: &PointCloud, target: &PointCloud, kappa: f64) -> Self {
        Self {
            kappa,
            target: Centres::new(target.points()),
            source: Lookers::new(source.points()),
            weights: vec![1.0; source.len()],
        }
    }

    /// `⟨α_m⟩ = exp(ψ(κ + ν_m) − ψ(κ M + N̂))` with ν_m the mass that the centre m has got.
    fn update(
        &mut self,
        claims: &[Claim],
        lookers: &Lookers,
        source_from_target: &Isometry3<f64>,
        sigma: f64,
        outlier_mass: f64,
    ) {
        let mut inverses = vec![0.0; claims.len()];
        for (claim, &index) in claims.iter().zip(lookers.order()) {
            inverses[index] = 1.0 / (claim.mass + outlier_mass).max(MASS_MIN);
        }
        self.target.weigh(&inverses);
        let got = self
            .target
            .claims(&self.source, &source_from_target.inverse(), Gaussian { sigma });
        let mut masses = vec![0.0; got.len()];
        for (claim, &index) in got.iter().zip(self.source.order()) {
            masses[index] = claim.mass * self.weights[index];
        }
        let count = masses.len() as f64;
        let all = digamma(self.kappa * count + masses.iter().sum::<f64>());
        for (weight, mass) in self.weights.iter_mut().zip(masses) {
            *weight = count * (digamma(self.kappa + mass) - all).exp();
        }
    }
}

/// ψ(x) for positive x: by its recurrence up to 6, then its asymptotic series; error below 1e-10.
fn digamma(mut x: f64) -> f64 {
    let mut sum = 0.0;
    while x < 6.0 {
        sum -= 1.0 / x;
        x += 1.0;
    }
    let square = 1.0 / (x * x);
    let series = square * (1.0 / 12.0 - square * (1.0 / 120.0 - square * (1.0 / 252.0 - square / 240.0)));
    sum + x.ln() - 0.5 / x - series
}

/// What the authors' program is called with in their examples; its own default is 0.
const OUTLIER_FRACTION: f64 = 0.1;

/// The default of the authors' program.
const SIGMA_FACTOR: f64 = 1.0;

/// The defaults of the authors' program.
const ITERATION_COUNTS: [u32; 2] = [30, 500];

/// The default of the authors' program, which brings the source to unit extent.
const STOP_FACTOR: f64 = 1e-4;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::methods::testing::{self, assert_near};

    #[test]
    fn permuted_points_are_laid_on_each_other() {
        let pair = testing::permuted(300, 40.0, [0.3, -0.2, 0.1]);
        assert_near(&testing::found(&pair, register), &pair.truth, 1e-6);
    }

    #[test]
    fn outliers_go_to_the_uniform_part_whatever_the_shares_of_the_centres() {
        let pair = testing::with_scattered_outliers(300, 150);
        for concentration in [None, Some(1.0), Some(100.0)] {
            let settings = BcpdSettings {
                concentration,
                ..BcpdSettings::default()
            };
            let found = register(&pair.source, &pair.target, &Isometry3::identity(), &settings);
            assert_near(&found, &pair.truth, 1e-6);
        }
    }

    #[test]
    fn digamma_has_its_known_values_and_its_recurrence() {
        assert!((digamma(1.0) + 0.577_215_664_901_532_9).abs() < 1e-9);
        assert!((digamma(0.5) + 1.963_510_026_021_423_5).abs() < 1e-9);
        for x in [0.1, 1.7, 30.0, 4e5] {
            assert!((digamma(x + 1.0) - digamma(x) - 1.0 / x).abs() < 1e-9, "{x}");
        }
    }
}
