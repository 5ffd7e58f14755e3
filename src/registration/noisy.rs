//! The course of the fine stage where points are compared: from candidates to the one solution and its rivals.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Translation3, UnitQuaternion};

use super::distinct::add_distinct;
use super::icp::Sample;
use super::nfi::minima;
use super::pointwise::{Pointwise, Roles, Solution};
use crate::geometry::sampling::even_indices;
use crate::geometry::statistics::mean;

/// Two clouds, or some of their points, to be compared point by point.
pub(super) struct Noisy {
    pub(super) template: Sample,
    pub(super) reference: Sample,
    pub(super) roles: Roles,
    /// The scatter of both clouds together, in their unit.
    pub(super) scatter: f64,
}

/// The most likely pose.
#[derive(Debug, Clone)]
pub(super) struct Found {
    pub(super) pose: Isometry3<f64>,
    pub(super) iterations: u32,
    /// As in [`Registration::covariance`](super::Registration::covariance); `None` when the pose is not determined.
    pub(super) covariance: Option<Matrix6<f64>>,
    /// Other poses that other samples of the same surfaces might have preferred.
    pub(super) rivals: Vec<Isometry3<f64>>,
}

impl Noisy {
    /// The best of what the candidates and the flips of the best of them come to. `distinct` tells poses apart.
    pub(super) fn best_of(
        &self,
        candidates: &[Isometry3<f64>],
        distinct: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> bool,
    ) -> Option<Found> {
        let descents = |candidates: &[Isometry3<f64>]| {
            minima(&self.template.points, &self.reference.points, candidates, self.scatter)
        };
        let mut minima = descents(candidates);
        minima.extend(descents(&flips(&self.template.points, &minima.first()?.pose)));
        minima.sort_by(|a, b| a.energy.total_cmp(&b.energy));
        let mut starts: Vec<Isometry3<f64>> = Vec::new();
        add_distinct(
            &mut starts,
            minima.iter().map(|minimum| minimum.pose),
            START_MAX_COUNT,
            distinct,
        );
        // A third of the points tells most of them apart, in a tenth of the time.
        let thin = Pointwise::new(&thinned(&self.template), &thinned(&self.reference), self.roles)?;
        let noise = START_NOISE_FACTOR * self.scatter;
        let tried: Vec<Solution> = starts.iter().filter_map(|start| thin.solve(start, noise)).collect();
        let first = most_likely(&tried)?;
        let left: Vec<&Solution> = tried
            .iter()
            .filter(|other| thin.may_be_preferred(&first, other))
            .collect();
        let all = Pointwise::new(&self.template, &self.reference, self.roles)?;
        let solved: Vec<Solution> = left
            .iter()
            .filter_map(|solution| all.solve(&solution.reference_from_template, solution.noise()))
            .collect();
        let best = most_likely(&solved)?;
        let descended: u32 = minima.iter().map(|minimum| minimum.iterations).sum();
        let climbed: u32 = tried.iter().chain(&solved).map(Solution::iterations).sum();
        Some(found(&all, &best, &solved, descended + climbed, distinct))
    }

    /// Where the best of the flips of a pose descends to.
    pub(super) fn flipped(&self, pose: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        let flips = flips(&self.template.points, pose);
        let minima = minima(&self.template.points, &self.reference.points, &flips, self.scatter);
        minima.first().map(|minimum| minimum.pose)
    }

    /// The solution near `start`, if there one cloud repeats the other's points but for noise and outliers; `None` when
    /// their surfaces say more. `rivals` are other poses that might do as well.
    pub(super) fn repeated(
        &self,
        start: &Isometry3<f64>,
        rivals: &[Isometry3<f64>],
        distinct: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> bool,
    ) -> Option<Found> {
        let all = Pointwise::new(&self.template, &self.reference, self.roles)?;
        let noise = START_NOISE_FACTOR * self.scatter;
        let best = all.solve(start, noise)?;
        if best.noise() > NOISE_MAX_FACTOR * self.scatter || !all.is_noise(&best) {
            return None;
        }
        let others: Vec<Solution> = rivals
            .iter()
            .filter(|rival| distinct(rival, &best.reference_from_template))
            .filter_map(|rival| all.solve(rival, noise))
            .collect();
        let found = found(&all, &best, &others, best.iterations(), distinct);
        found.covariance.is_some().then_some(found)
    }
}

fn found(
    pointwise: &Pointwise,
    best: &Solution,
    others: &[Solution],
    iterations: u32,
    distinct: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> bool,
) -> Found {
    let pose = best.reference_from_template;
    let rivals = others
        .iter()
        .filter(|other| distinct(&other.reference_from_template, &pose) && pointwise.may_be_preferred(best, other))
        .map(|other| other.reference_from_template)
        .collect();
    Found {
        pose,
        iterations,
        covariance: pointwise.covariance(best),
        rivals,
    }
}

/// Ties go to the earlier one.
fn most_likely(solutions: &[Solution]) -> Option<Solution> {
    let mut best = *solutions.first()?;
    for solution in solutions {
        if solution.log_likelihood() > best.log_likelihood() {
            best = *solution;
        }
    }
    Some(best)
}

fn thinned(sample: &Sample) -> Sample {
    let indices = even_indices(sample.points.len(), THIN_COUNT);
    Sample {
        points: indices.iter().map(|&index| sample.points[index]).collect(),
        normals: indices.iter().map(|&index| sample.normals[index]).collect(),
    }
}

/// A pose after half a turn about each of the principal axes of the points: what a slender or flat part is most easily
/// mistaken for.
fn flips(points: &[Point3<f64>], pose: &Isometry3<f64>) -> Vec<Isometry3<f64>> {
    let centroid = mean(points).coords;
    let moments: Matrix3<f64> = points
        .iter()
        .map(|point| (point.coords - centroid) * (point.coords - centroid).transpose())
        .sum();
    let axes = moments.symmetric_eigen().eigenvectors;
    (0..3)
        .map(|axis| {
            let turn = UnitQuaternion::from_scaled_axis(axes.column(axis) * std::f64::consts::PI);
            pose * Translation3::from(centroid) * turn * Translation3::from(-centroid)
        })
        .collect()
}

/// How many distinct poses are tried.
const START_MAX_COUNT: usize = 4;
const THIN_COUNT: usize = 1000;
/// The noise at the start, in scatters: a basin somewhat wider than that of the solution.
const START_NOISE_FACTOR: f64 = 1.5;
/// More noise than this, in scatters, is not what the clouds have themselves: the pose is wrong.
const NOISE_MAX_FACTOR: f64 = 1.5;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PointCloud;
    use crate::registration::testing::{blade, noisy};
    use nalgebra::Vector3;

    fn sample(cloud: &PointCloud) -> Sample {
        Sample {
            points: cloud.points().to_vec(),
            normals: vec![Vector3::z(); cloud.len()],
        }
    }

    fn distinct(a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        (a.rotation.inverse() * b.rotation).angle() > 0.1
    }

    #[test]
    fn a_start_that_is_flipped_is_turned_back() {
        let template = blade(1200, 0.0);
        let truth = Isometry3::new(Vector3::new(0.05, 0.02, -0.03), Vector3::new(0.05, 0.1, -0.05));
        let reference = noisy(&template.transformed(&truth), 0.05, 9);
        for roles in [Roles::TemplateIsCentres, Roles::ReferenceIsCentres] {
            let noisy = Noisy {
                template: sample(&template),
                reference: sample(&reference),
                roles,
                scatter: 0.04,
            };
            for flipped in flips(template.points(), &truth) {
                let found = noisy.best_of(&[flipped], &distinct).unwrap();
                let error = truth.inverse() * found.pose;
                assert!(error.rotation.angle() < 0.05, "{roles:?} {error:?}");
                assert!(
                    found.rivals.is_empty() && found.covariance.is_some(),
                    "{roles:?} {found:?}"
                );
            }
        }
    }

    #[test]
    fn the_covariance_is_the_same_whoever_looks() {
        // Both clouds equally noisy, so that both roles have about the same solution and the same doubt.
        let whole = blade(1500, 0.0);
        let truth = Isometry3::new(Vector3::new(3.0, -2.0, 1.0), Vector3::new(0.5, 0.4, -0.9));
        let template = noisy(&whole, 0.03, 1);
        let reference = noisy(&blade(1500, 0.5).transformed(&truth), 0.03, 2);
        let [one, other] = [Roles::TemplateIsCentres, Roles::ReferenceIsCentres].map(|roles| {
            let noisy = Noisy {
                template: sample(&template),
                reference: sample(&reference),
                roles,
                scatter: 0.04,
            };
            noisy.best_of(&[truth], &distinct).unwrap().covariance.unwrap()
        });
        for axis in 0..6 {
            let ratio = one[(axis, axis)] / other[(axis, axis)];
            assert!((0.5..2.0).contains(&ratio), "{axis}: {ratio}");
        }
    }
}
