//! How far the most likely pose may be from the true one, and from what it would be with other samples of the surfaces.
//!
//! The solution of a mixture is a zero of a sum over the lookers that also depends on which centres there happen to be:
//! its covariance is `H⁻¹ (J + K) H⁻¹`, with the curvature `H` of the likelihood (central differences of the score), the
//! scatter `J` of the single lookers' scores, and the scatter `K` of what each centre's presence does to the score. A
//! turn that hardly changes the likelihood, such as that of a slender blade about its span, has a large one.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector6};

use super::field::{Gaussians, Lookers};
use super::mixture::{Mixture, Model, Products, UNKNOWN_COUNT, Unknowns, Word, stacked};
use super::twist::{scaled, unscaled};
use super::{Determination, WeakDirection};

/// Which motions count as not determined: those whose standard deviation is larger.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tolerance {
    /// Of a turn, in radians.
    pub(super) turn_rad: f64,
    /// Of a shift, over the template's radius of gyration.
    pub(super) shift_factor: f64,
}

/// The covariance of `[rx ry rz tx ty tz]` about the image of the lookers' centroid, in the centres' frame and the
/// clouds' unit, at a model that is the most likely one near it; `None` when it is none or nothing is finite.
pub(super) fn covariance_of(mixture: &Mixture, model: &Model) -> Option<Matrix6<f64>> {
    let model = mixture.inner(model);
    let curvature = curvature_of(mixture, &model);
    let inverse = match curvature.cholesky() {
        Some(factored) => factored.inverse(),
        // Points that repeat exactly have no noise to be known: the pose is all.
        None => {
            let of_pose: Matrix6<f64> = curvature.fixed_view::<6, 6>(0, 0).into_owned();
            let mut inverse = Products::zeros();
            inverse
                .fixed_view_mut::<6, 6>(0, 0)
                .copy_from(&of_pose.cholesky()?.inverse());
            inverse
        }
    };
    let words = mixture.inner_words(&model);
    let scatter = scatter_of(words.iter().map(|word| word.score)) + centre_scatter(mixture, &model, &words);
    let product = inverse * scatter * inverse;
    let mut covariance: Matrix6<f64> = product.fixed_view::<6, 6>(0, 0).into_owned();
    let unit = |axis: usize| {
        if axis < 3 {
            1.0 / mixture.gyration()
        } else {
            mixture.radius()
        }
    };
    for row in 0..6 {
        for column in 0..6 {
            covariance[(row, column)] *= unit(row) * unit(column);
        }
    }
    covariance.iter().all(|value| value.is_finite()).then_some(covariance)
}

fn curvature_of(mixture: &Mixture, model: &Model) -> Products {
    let score = |step: &Unknowns| -> Unknowns {
        let words = mixture.inner_words(&mixture.stepped(model, step));
        words.iter().map(|word| word.score).sum()
    };
    let mut curvature = Products::zeros();
    for axis in 0..UNKNOWN_COUNT {
        let length = if axis < 6 {
            MOTION_STEP_SIGMAS * model.sigma
        } else {
            LOG_STEP
        };
        let mut step = Unknowns::zeros();
        step[axis] = length;
        curvature.set_column(axis, &((score(&-step) - score(&step)) / (2.0 * length)));
    }
    (curvature + curvature.transpose()) / 2.0
}

/// The scatter of what a little more mass of each centre would do to the score.
///
/// The score of looker `j` is `Σ_i m_i g_ij u_ij / (Σ_i m_i g_ij + c)`; its derivative by `m_i` is `g_ij (u_ij − s_j) / total_j`:
/// sums over the lookers with the masses `1 / total` and `s / total`.
fn centre_scatter(mixture: &Mixture, model: &Model, words: &[Word]) -> Products {
    let placed: Vec<Point3<f64>> = mixture
        .lookers()
        .points()
        .iter()
        .map(|point| model.pose * point)
        .collect();
    let centres = Lookers::new(mixture.centres());
    let summed = |mass: &dyn Fn(&Word) -> f64| {
        let masses: Vec<f64> = words.iter().map(|word| mass(word) / word.total).collect();
        Gaussians::new(&placed, Some(&masses)).affinities(&centres, &Isometry3::identity(), model.sigma)
    };
    let sigma2 = model.sigma * model.sigma;
    let pivot = model.pose.translation.vector;
    let mut pushes: Vec<Unknowns> = summed(&|_| 1.0)
        .iter()
        .zip(centres.points())
        .map(|(affinity, point)| {
            let force = -affinity.offset / sigma2;
            let turn = (point.coords - pivot).cross(&force) / mixture.gyration();
            let spread = affinity.squared / sigma2 - 3.0 * affinity.sum;
            stacked(&turn, &force, spread, -affinity.sum)
        })
        .collect();
    for axis in 0..UNKNOWN_COUNT {
        // The last score counts what no centre claims, too, and every word adds w to it.
        let constant = if axis == UNKNOWN_COUNT - 1 {
            1.0 - model.outlier_fraction
        } else {
            0.0
        };
        for (push, sum) in pushes.iter_mut().zip(summed(&|word| word.score[axis] - constant)) {
            push[axis] -= sum.sum;
        }
    }
    scatter_of(pushes.into_iter())
}

/// The sum of the outer products about their mean.
fn scatter_of(scores: impl ExactSizeIterator<Item = Unknowns> + Clone) -> Products {
    let mean = scores.clone().sum::<Unknowns>() / scores.len().max(1) as f64;
    scores.map(|score| (score - mean) * (score - mean).transpose()).sum()
}

/// What a covariance says: the motions of one standard deviation along the largest turn and the largest shift, where
/// they exceed `tolerance`; weakest first.
pub(super) fn determination(covariance: &Matrix6<f64>, gyration: f64, tolerance: &Tolerance) -> Determination {
    let limits = [tolerance.turn_rad, tolerance.shift_factor * gyration];
    let mut weak: Vec<(f64, Vector6<f64>, WeakDirection)> = Vec::new();
    for (block, limit) in [0, 3].into_iter().zip(limits) {
        let part: Matrix3<f64> = covariance.fixed_view::<3, 3>(block, block).into_owned();
        let eigen = part.symmetric_eigen();
        let largest = eigen.eigenvalues.imax();
        let excess = eigen.eigenvalues[largest].max(0.0).sqrt() / limit;
        if excess <= 1.0 {
            continue;
        }
        let mut axis = Vector6::zeros();
        axis.fixed_rows_mut::<3>(block)
            .copy_from(&eigen.eigenvectors.column(largest));
        let motion = scaled(&(covariance * axis / (excess * limit)), gyration);
        let sigma = motion.norm();
        let Some(unit) = motion.try_normalize(0.0) else {
            continue;
        };
        // The largest turn and the largest shift may be the same motion.
        if weak.iter().any(|(_, other, _)| other.dot(&unit).abs() > SAME_COSINE) {
            continue;
        }
        let direction = unscaled(&unit, gyration).into();
        weak.push((excess, unit, WeakDirection { direction, sigma }));
    }
    weak.sort_by(|a, b| b.0.total_cmp(&a.0));
    Determination {
        covariance: Some(*covariance),
        weak: weak.into_iter().map(|(_, scaled, weak)| (scaled, weak)).collect(),
    }
}

/// Whether other samples of the same surfaces might have preferred the rival to the best model: the likelihood there is
/// lower by no more than three standard deviations of the difference, the single lookers' differences taken as independent
/// and the centres' part taken to be as large.
pub(super) fn may_be_preferred(best: &[Word], rival: &[Word]) -> bool {
    let differences = || {
        best.iter()
            .zip(rival)
            .map(|(here, there)| here.log_likelihood - there.log_likelihood)
    };
    let gap: f64 = differences().sum();
    let mean = gap / best.len().max(1) as f64;
    let variance: f64 = differences().map(|difference| (difference - mean).powi(2)).sum();
    gap <= PREFERENCE_SIGMAS * (2.0 * variance).sqrt()
}

/// Steps of the central differences: of a motion in σ, of the logarithms.
const MOTION_STEP_SIGMAS: f64 = 0.1;
const LOG_STEP: f64 = 0.05;
const PREFERENCE_SIGMAS: f64 = 3.0;
/// Directions nearer to each other than this are one.
const SAME_COSINE: f64 = 0.9;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PointCloud;
    use crate::registration::testing::{blade, extruded, noisy};
    use nalgebra::Vector3;

    const TOLERANCE: Tolerance = Tolerance {
        turn_rad: 0.0175,
        shift_factor: 0.03,
    };

    fn model(sigma: f64) -> Model {
        Model {
            pose: Isometry3::identity(),
            sigma,
            outlier_fraction: 0.01,
        }
    }

    fn determined(centres: &PointCloud, sigma: f64) -> Determination {
        let lookers = noisy(centres, sigma, 3);
        let mixture = Mixture::new(centres.points(), lookers.points()).unwrap();
        let found = mixture.likeliest(&model(sigma)).unwrap().model;
        let covariance = covariance_of(&mixture, &found).unwrap();
        determination(&covariance, mixture.radius(), &TOLERANCE)
    }

    #[test]
    fn a_blade_with_a_platform_is_determined_among_little_noise() {
        let found = determined(&blade(2000, 0.0), 0.02);
        assert!(found.weak.is_empty(), "{found:?}");
    }

    #[test]
    fn a_nearly_round_bar_may_turn_about_its_axis() {
        let squeezed = extruded(2000, 0.3);
        let points = squeezed.points().iter().map(|p| Point3::new(0.3 * p.x, p.y, p.z));
        let found = determined(&PointCloud::from_measured(points).cloud, 0.1);
        assert!(!found.weak.is_empty(), "{found:?}");
        let direction = found.weak[0].1.direction;
        assert!(direction[2].abs() > 0.9, "{direction:?}");
    }

    #[test]
    fn the_error_of_independent_samples_is_what_the_covariance_says() {
        let mut squares = 0.0;
        let count = 12u8;
        for seed in 0..count {
            // The same surface in other places, with noise.
            let phase = f64::from(seed) / f64::from(count);
            let lookers = noisy(&blade(900, phase), 0.04, u64::from(seed));
            let centres = noisy(&blade(900, 0.5), 0.0, 1);
            let mixture = Mixture::new(centres.points(), lookers.points()).unwrap();
            let found = mixture.likeliest(&model(0.05)).unwrap().model;
            let covariance = covariance_of(&mixture, &found).unwrap();
            let turn = found.pose.rotation.scaled_axis();
            let shift = found.pose * mixture.looker_origin() - mixture.looker_origin();
            let error = Vector6::new(turn.x, turn.y, turn.z, shift.x, shift.y, shift.z);
            squares += (error.transpose() * covariance.try_inverse().unwrap() * error)[0];
        }
        let mean = squares / f64::from(count);
        assert!((1.0..12.0).contains(&mean), "{mean}");
    }

    #[test]
    fn a_flip_of_a_bar_may_be_preferred_and_that_of_a_blade_not() {
        let flip = Isometry3::rotation(Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        let preferred = |centres: &PointCloud| {
            let lookers = noisy(centres, 0.05, 3);
            let mixture = Mixture::new(centres.points(), lookers.points()).unwrap();
            let flipped = Model {
                pose: flip,
                ..model(0.05)
            };
            let flipped = mixture.likeliest(&flipped).unwrap().model;
            may_be_preferred(&mixture.words(&model(0.05)), &mixture.words(&flipped))
        };
        let bar = extruded(2000, 0.3);
        let points = bar.points().iter().map(|p| Point3::new(p.x, 0.02 * p.y, p.z));
        assert!(preferred(&PointCloud::from_measured(points).cloud));
        assert!(!preferred(&blade(2000, 0.0)));
    }
}
