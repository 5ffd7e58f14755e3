//! The most likely pose when one cloud is another one with noise on every point and some points from nowhere.
//!
//! Each *looker* `y_j` is taken to be drawn from one of the *centres* `x_i`, displaced by noise of standard deviation σ a
//! coordinate, or with probability `w` from anywhere in the volume `V`:
//!
//! `ℓ = Σ_j ln( w / V + (1 − w) / N (2πσ²)^(−3/2) Σ_i exp(−|x_i − T y_j|² / 2σ²) )`
//!
//! Pose, σ and `w` are found together by a quasi-Newton method (BFGS) that starts from the information which known pairs
//! would have. Lengths inside are over the centres' radius, points are counted from their cloud's centroid.

use nalgebra::{Isometry3, Point3, SMatrix, SVector, Vector3, Vector6};

use super::field::{Affinity, Gaussians, Lookers};
use super::reference::rms_radius;
use super::twist::moved;
use crate::geometry::sampling::even_indices;
use crate::geometry::statistics::mean;

/// Two clouds, one of which says where the points of the other come from.
pub(super) struct Mixture {
    centres: Vec<Point3<f64>>,
    gaussians: Gaussians,
    lookers: Lookers,
    /// Over the centres' radius: the lookers' root-mean-square radius, and the volume that outliers may come from.
    gyration: f64,
    volume: f64,
    /// The centroids of both clouds.
    centre_origin: Point3<f64>,
    looker_origin: Point3<f64>,
    /// The centres' root-mean-square radius.
    radius: f64,
}

/// What is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    /// `centres_from_lookers`.
    pub(super) pose: Isometry3<f64>,
    /// The noise in the clouds' unit.
    pub(super) sigma: f64,
    /// The share of the lookers that come from nowhere, between 0 and 1.
    pub(super) outlier_fraction: f64,
}

/// The most likely model near a start.
#[derive(Debug, Clone, Copy)]
pub(super) struct Likeliest {
    pub(super) model: Model,
    /// ℓ over the lookers, in nats; comparable between models of one mixture.
    pub(super) log_likelihood: f64,
    /// How often the likelihood was computed.
    pub(super) evaluation_count: u32,
}

/// A turn times the lookers' gyration, a shift, ln σ, ln (w / (1 − w)).
pub(super) type Unknowns = SVector<f64, UNKNOWN_COUNT>;
/// Products of unknowns.
pub(super) type Products = SMatrix<f64, UNKNOWN_COUNT, UNKNOWN_COUNT>;
/// Six of a motion, the noise and the share of outliers.
pub(super) const UNKNOWN_COUNT: usize = 8;

/// What one looker says of a model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Word {
    /// The sum of its affinities, and what stands for the outliers.
    pub(super) total: f64,
    pub(super) log_likelihood: f64,
    /// The gradient of the log likelihood.
    pub(super) score: Unknowns,
}

struct Place {
    model: Model,
    log_likelihood: f64,
    score: Unknowns,
}

impl Mixture {
    /// `None` without points or when either cloud has no extent.
    pub(super) fn new(centres: &[Point3<f64>], lookers: &[Point3<f64>]) -> Option<Self> {
        let (centre_origin, looker_origin) = (mean(centres), mean(lookers));
        let radius = rms_radius(centres, &centre_origin);
        let gyration = rms_radius(lookers, &looker_origin) / radius;
        if !(radius > 0.0 && gyration > 0.0 && gyration.is_finite()) {
            return None;
        }
        let scaled = |points: &[Point3<f64>], zero: &Point3<f64>| -> Vec<Point3<f64>> {
            let over_radius = |point: &Point3<f64>| Point3::from((point - zero) / radius);
            points.iter().map(over_radius).collect()
        };
        let (centres, lookers) = (scaled(centres, &centre_origin), scaled(lookers, &looker_origin));
        let farthest = lookers.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
        Some(Self {
            gaussians: Gaussians::new(&centres, None),
            centres,
            lookers: Lookers::new(&lookers),
            gyration,
            volume: 4.0 / 3.0 * std::f64::consts::PI * farthest.powi(3),
            centre_origin,
            looker_origin,
            radius,
        })
    }

    /// Climbs from `start` to the most likely model near it. `None` when nothing is finite there.
    pub(super) fn likeliest(&self, start: &Model) -> Option<Likeliest> {
        let mut here = self.place(self.inner(start));
        let mut inverse = self.inverse_information_of_pairs(&here)?;
        let mut untried = true;
        let mut evaluation_count = 1;
        while evaluation_count < EVALUATION_MAX_COUNT {
            let step = inverse * here.score;
            let gain = step.dot(&here.score);
            if gain.is_nan() || gain < GAIN_MIN {
                break;
            }
            let mut share = share_within_reach(&step, &here.model);
            let mut taken = None;
            while taken.is_none() && share * gain >= GAIN_MIN && evaluation_count < EVALUATION_MAX_COUNT {
                let there = self.place(self.stepped(&here.model, &(step * share)));
                evaluation_count += 1;
                if there.log_likelihood >= here.log_likelihood + GAIN_FRACTION_MIN * share * gain {
                    taken = Some(there);
                } else {
                    share *= BACKTRACK;
                }
            }
            let Some(there) = taken else {
                if untried {
                    break;
                }
                inverse = self.inverse_information_of_pairs(&here)?;
                untried = true;
                continue;
            };
            let (step, change) = (step * share, here.score - there.score);
            let curvature = step.dot(&change);
            if curvature > CURVATURE_MIN * step.norm() * change.norm() {
                let left = Products::identity() - step * change.transpose() / curvature;
                inverse = left * inverse * left.transpose() + step * step.transpose() / curvature;
                untried = false;
            }
            here = there;
        }
        here.log_likelihood.is_finite().then(|| Likeliest {
            model: self.outer(&here.model),
            log_likelihood: here.log_likelihood,
            evaluation_count,
        })
    }

    /// What each looker says of a model in the clouds' frames and unit; the order is the same for all models.
    pub(super) fn words(&self, model: &Model) -> Vec<Word> {
        self.inner_words(&self.inner(model))
    }

    /// What each looker says of an inner model.
    pub(super) fn inner_words(&self, model: &Model) -> Vec<Word> {
        let (sigma2, w) = (model.sigma * model.sigma, model.outlier_fraction);
        let (peak, nowhere) = (self.peak(model), self.nowhere(model));
        let word = |(affinity, point): (&Affinity, &Point3<f64>)| {
            let total = affinity.sum + nowhere;
            let claimed = affinity.sum / total;
            let force = affinity.offset / (total * sigma2);
            let turn = (model.pose.rotation * point.coords).cross(&force) / self.gyration;
            let spread = affinity.squared / (total * sigma2) - 3.0 * claimed;
            Word {
                total,
                log_likelihood: (total * peak).ln(),
                score: stacked(&turn, &force, spread, 1.0 - claimed - w),
            }
        };
        let affinities = self.gaussians.affinities(&self.lookers, &model.pose, model.sigma);
        affinities.iter().zip(self.lookers.points()).map(word).collect()
    }

    /// The root mean square residual across the centres' surface and along it (one direction of two), in radii, each
    /// looker's residual spread over the centres that claim it, outliers counting for little. `normals` are those of the centres.
    pub(super) fn spread(&self, model: &Model, normals: &[Vector3<f64>]) -> (f64, f64) {
        let model = self.inner(model);
        let scale = -0.5 / (model.sigma * model.sigma);
        let nowhere = self.nowhere(&model);
        let (mut across, mut along) = (0.0, 0.0);
        for index in even_indices(self.lookers.points().len(), SPREAD_SAMPLE_COUNT) {
            let at = model.pose * self.lookers.points()[index];
            let (mut claimed, mut squared, mut squared_across) = (0.0, 0.0, 0.0);
            for (centre, normal) in self.centres.iter().zip(normals) {
                let offset = centre - at;
                let distance2 = offset.norm_squared();
                if distance2 * scale > SPREAD_EXPONENT_MIN {
                    let g = (distance2 * scale).exp();
                    claimed += g;
                    squared += g * distance2;
                    squared_across += g * offset.dot(normal).powi(2);
                }
            }
            across += squared_across / (claimed + nowhere);
            along += (squared - squared_across) / (claimed + nowhere) / 2.0;
        }
        (across.sqrt(), along.sqrt())
    }

    /// The density that one centre makes at its own place.
    fn peak(&self, model: &Model) -> f64 {
        let normal = (std::f64::consts::TAU * model.sigma * model.sigma).powf(-1.5);
        (1.0 - model.outlier_fraction) / self.centres.len() as f64 * normal
    }

    /// The density of the outliers, in peaks.
    fn nowhere(&self, model: &Model) -> f64 {
        model.outlier_fraction / self.volume / self.peak(model)
    }

    fn place(&self, model: Model) -> Place {
        let prior = self.prior_count();
        let w = model.outlier_fraction;
        let mut place = Place {
            model,
            log_likelihood: prior * (w.ln() + (1.0 - w).ln()),
            score: Unknowns::zeros(),
        };
        place.score[7] = prior * (1.0 - 2.0 * w);
        for word in self.inner_words(&model) {
            place.log_likelihood += word.log_likelihood;
            place.score += word.score;
        }
        place
    }

    /// As if each looker knew whether and from which centre it comes: the inverse, roughly, of more than there is.
    fn inverse_information_of_pairs(&self, place: &Place) -> Option<Products> {
        let (count, w) = (self.lookers.points().len() as f64, place.model.outlier_fraction);
        let claimed = (1.0 - w) * count;
        let shift = claimed / (place.model.sigma * place.model.sigma);
        // A turn about an axis moves two of three coordinates.
        let turn = shift * 2.0 / 3.0;
        let share = (count + 2.0 * self.prior_count()) * w * (1.0 - w);
        let information = Unknowns::from([turn, turn, turn, shift, shift, shift, 6.0 * claimed, share]);
        let inverse = information.map(f64::recip);
        inverse
            .iter()
            .all(|value| value.is_finite())
            .then(|| Products::from_diagonal(&inverse))
    }

    fn prior_count(&self) -> f64 {
        PRIOR_FRACTION * self.lookers.points().len() as f64
    }

    /// An inner model after a small step.
    pub(super) fn stepped(&self, model: &Model, step: &Unknowns) -> Model {
        let turn = step.fixed_rows::<3>(0) / self.gyration;
        let motion = Vector6::new(turn.x, turn.y, turn.z, step[3], step[4], step[5]);
        let odds = model.outlier_fraction / (1.0 - model.outlier_fraction) * step[7].exp();
        Model {
            pose: moved(&model.pose, &Point3::from(model.pose.translation.vector), &motion),
            sigma: (model.sigma * step[6].exp()).max(SIGMA_MIN),
            outlier_fraction: odds / (1.0 + odds),
        }
    }

    /// About the centroids and over the radius.
    pub(super) fn inner(&self, model: &Model) -> Model {
        let shift = (model.pose * self.looker_origin - self.centre_origin) / self.radius;
        Model {
            pose: Isometry3::from_parts(shift.into(), model.pose.rotation),
            sigma: model.sigma / self.radius,
            outlier_fraction: model.outlier_fraction,
        }
    }

    /// Back to the clouds' frames and unit.
    fn outer(&self, model: &Model) -> Model {
        let rotation = model.pose.rotation;
        let shift = model.pose.translation.vector * self.radius - rotation * self.looker_origin.coords;
        Model {
            pose: Isometry3::from_parts((self.centre_origin.coords + shift).into(), rotation),
            sigma: model.sigma * self.radius,
            outlier_fraction: model.outlier_fraction,
        }
    }

    /// The centres, inside.
    pub(super) fn centres(&self) -> &[Point3<f64>] {
        &self.centres
    }

    /// The lookers, inside.
    pub(super) fn lookers(&self) -> &Lookers {
        &self.lookers
    }

    /// The lookers' radius over that of the centres.
    pub(super) fn gyration(&self) -> f64 {
        self.gyration
    }

    /// The centres' radius in the clouds' unit.
    pub(super) fn radius(&self) -> f64 {
        self.radius
    }

    /// The lookers' centroid in their frame.
    pub(super) fn looker_origin(&self) -> Point3<f64> {
        self.looker_origin
    }
}

/// Motion, noise and share as one vector.
pub(super) fn stacked(turn: &Vector3<f64>, shift: &Vector3<f64>, noise: f64, share: f64) -> Unknowns {
    Unknowns::from([turn.x, turn.y, turn.z, shift.x, shift.y, shift.z, noise, share])
}

/// How much of a step may be taken at once.
fn share_within_reach(step: &Unknowns, model: &Model) -> f64 {
    let reach = STEP_MAX_SIGMAS * model.sigma;
    let lengths = [
        step.fixed_rows::<3>(0).norm() / reach,
        step.fixed_rows::<3>(3).norm() / reach,
        step[6].abs() / LOG_SIGMA_STEP_MAX,
        step[7].abs() / LOGIT_STEP_MAX,
    ];
    1.0 / lengths.into_iter().fold(1.0, f64::max)
}

/// Over the radius: single precision tells no points apart that are nearer.
const SIGMA_MIN: f64 = 1e-5;
const SPREAD_SAMPLE_COUNT: usize = 500;
/// Of a centre four σ away.
const SPREAD_EXPONENT_MIN: f64 = -8.0;
const EVALUATION_MAX_COUNT: u32 = 60;
/// A step that promises a smaller gain in likelihood is a hundredth of a standard deviation.
const GAIN_MIN: f64 = 1e-4;
/// The least share of the promised gain that a step must bring.
const GAIN_FRACTION_MIN: f64 = 1e-4;
const BACKTRACK: f64 = 0.4;
const CURVATURE_MIN: f64 = 1e-9;
const STEP_MAX_SIGMAS: f64 = 2.0;
const LOG_SIGMA_STEP_MAX: f64 = 0.7;
const LOGIT_STEP_MAX: f64 = 2.0;
/// As if so many more lookers (over their count) were known to come from nowhere, and as many not.
const PRIOR_FRACTION: f64 = 0.01;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::testing::{blade, noisy};

    fn start(sigma: f64) -> Model {
        Model {
            pose: Isometry3::new(Vector3::new(0.01, -0.01, 0.01), Vector3::new(0.02, 0.01, -0.02)),
            sigma,
            outlier_fraction: 0.1,
        }
    }

    #[test]
    fn the_score_is_the_gradient_of_the_likelihood() {
        let centres = blade(400, 0.0);
        let lookers = noisy(&centres, 0.05, 2);
        let mixture = Mixture::new(centres.points(), lookers.points()).unwrap();
        for sigma in [0.04, 0.1, 0.4] {
            let model = mixture.inner(&start(sigma));
            let score = mixture.place(model).score;
            for axis in 0..UNKNOWN_COUNT {
                let mut step = Unknowns::zeros();
                step[axis] = 1e-3;
                let height = |step: Unknowns| mixture.place(mixture.stepped(&model, &step)).log_likelihood;
                let slope = (height(step) - height(-step)) / 2e-3;
                let error = (slope - score[axis]).abs();
                assert!(
                    error < 0.01 * score.norm() + 0.1,
                    "{sigma} {axis}: {slope} {}",
                    score[axis]
                );
            }
        }
    }

    #[test]
    fn noise_and_outliers_are_measured() {
        let centres = blade(1500, 0.0);
        let truth = Isometry3::new(Vector3::new(0.4, -0.3, 0.1), Vector3::new(0.3, 0.2, -0.5));
        let repeated = noisy(&centres.transformed(&truth.inverse()), 0.03, 4);
        // A third again as many points, spread over a box.
        let spread = blade(500, 0.3);
        let anywhere = noisy(&spread, 0.7, 5);
        let lookers: Vec<_> = repeated.points().iter().chain(anywhere.points()).copied().collect();
        let mixture = Mixture::new(centres.points(), &lookers).unwrap();
        let begin = Model {
            pose: truth * start(0.1).pose,
            ..start(0.1)
        };
        let found = mixture.likeliest(&begin).unwrap().model;
        assert!((found.sigma / 0.03 - 1.0).abs() < 0.1, "{found:?}");
        assert!((found.outlier_fraction - 0.25).abs() < 0.06, "{found:?}");
        let error = truth.inverse() * found.pose;
        assert!(
            error.rotation.angle() < 0.01 && error.translation.vector.norm() < 0.01,
            "{error:?}"
        );
    }

    #[test]
    fn points_that_repeat_are_laid_on_each_other() {
        let centres = blade(800, 0.0);
        let truth = Isometry3::new(Vector3::new(5.0, -3.0, 2.0), Vector3::new(0.3, 0.2, -0.5));
        let lookers = noisy(&centres.transformed(&truth.inverse()), 0.002, 4);
        let mixture = Mixture::new(centres.points(), lookers.points()).unwrap();
        let begin = Model {
            pose: truth * start(0.05).pose,
            ..start(0.05)
        };
        let found = mixture.likeliest(&begin).unwrap().model.pose;
        let bound = 0.002 * (6.0f64 / 800.0).sqrt();
        let squared: f64 = lookers
            .points()
            .iter()
            .map(|point| (found * point - truth * point).norm_squared())
            .sum();
        let rmse = (squared / 800.0).sqrt();
        assert!(rmse < 2.0 * bound, "{rmse} against {bound}");
    }

    #[test]
    fn clouds_without_extent_make_no_mixture() {
        let cloud = blade(50, 0.0);
        assert!(Mixture::new(&[], cloud.points()).is_none());
        assert!(Mixture::new(cloud.points(), &[]).is_none());
        assert!(Mixture::new(&[Point3::origin(); 9], cloud.points()).is_none());
    }
}
