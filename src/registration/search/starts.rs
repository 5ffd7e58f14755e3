//! Where a registration may begin: what MPE comes to, votes of point pairs, a swarm of falls.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::super::Search;
use super::super::distinct::add_distinct;
use super::super::facing::Sides;
use super::super::icp::Sample;
use super::super::mpe::{Descent, descend};
use super::super::point_pairs::voted_poses;
use super::super::swarm::{Faller, Swarm};
use super::Work;
use crate::geometry::nearest::NearestPoints;
use crate::geometry::sampling::random_indices;

impl Work<'_> {
    /// Adds what MPE comes to from the start.
    pub(super) fn add_near_candidate(
        &self,
        start: &Isometry3<f64>,
        candidates: &mut Vec<Isometry3<f64>>,
        rng: &mut ChaCha8Rng,
    ) -> u32 {
        let settings = self.settings;
        let count = settings.sample_count;
        let sample = self.sample(count, rng).points;
        let near = match settings.search {
            Search::StartOnly => return 0,
            Search::NearPart { reach_factor } => self.reference_near(start, reach_factor, count, rng),
            Search::Near | Search::Automatic | Search::Everywhere => self.reference_sample(count, rng),
        };
        let descent = descend(&sample, &near, start, &settings.mpe);
        candidates.push(descent.reference_from_template);
        descent.iterations
    }

    /// Adds the best few of what MPE comes to from rotations all over SO(3).
    pub(super) fn add_global_candidates(&self, candidates: &mut Vec<Isometry3<f64>>, rng: &mut ChaCha8Rng) -> u32 {
        let few = self.sample(GLOBAL_COUNT, rng).points;
        let whole = self.reference_sample(GLOBAL_COUNT, rng);
        let mut descents: Vec<Descent> = cube_rotations()
            .into_par_iter()
            .map(|turn| {
                let pose = Translation3::from(self.reference.centroid().coords)
                    * turn
                    * Translation3::from(-self.problem.centroid.coords);
                descend(&few, &whole, &pose, &self.settings.mpe)
            })
            .collect();
        descents.sort_by(|a, b| a.energy.total_cmp(&b.energy));
        let poses = descents.iter().map(|descent| descent.reference_from_template);
        let max_count = candidates.len() + GLOBAL_KEPT_COUNT;
        add_distinct(candidates, poses, max_count, |a, b| self.is_distinct(a, b));
        descents.iter().map(|descent| descent.iterations).sum()
    }

    fn reference_sample(&self, count: usize, rng: &mut ChaCha8Rng) -> Vec<Point3<f64>> {
        let points = self.reference.points();
        random_indices(points.len(), count, rng)
            .into_iter()
            .map(|index| points[index])
            .collect()
    }

    /// A sample of the reference near the template at the start; of all of it if hardly any is near.
    fn reference_near(
        &self,
        start: &Isometry3<f64>,
        reach_factor: f64,
        count: usize,
        rng: &mut ChaCha8Rng,
    ) -> Vec<Point3<f64>> {
        let placed: Vec<Point3<f64>> = self
            .sample(NEAR_TEMPLATE_COUNT, rng)
            .points
            .iter()
            .map(|point| start * point)
            .collect();
        let tree = NearestPoints::new(&placed);
        let reach = reach_factor * self.problem.radius;
        let near: Vec<Point3<f64>> = self
            .reference_sample(NEAR_REFERENCE_FACTOR * count, rng)
            .into_iter()
            .filter(|point| tree.nearest_within(point, reach).is_some())
            .collect();
        if near.len() < count / 4 {
            return self.reference_sample(count, rng);
        }
        random_indices(near.len(), count, rng)
            .into_iter()
            .map(|index| near[index])
            .collect()
    }

    /// What pairs of oriented points vote for.
    pub(super) fn voted_poses(&self, rng: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
        let template = self.sample(VOTER_COUNT, rng);
        let reference = Sample::of(self.reference.points(), self.reference.normals(), VOTER_COUNT, rng);
        let radius = self.problem.radius;
        let mut voted = voted_poses(&template, &reference, radius, VOTED_COUNT);
        if self.sides == Sides::OneOfTwo {
            voted.extend(voted_poses(&template.reversed(), &reference, radius, VOTED_COUNT));
        }
        voted
    }

    /// What a swarm of falls comes to.
    pub(super) fn swarm_poses(&self, rng: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
        let faller = Faller {
            sample: self.sample(FALL_COUNT, rng),
            centroid: self.problem.centroid,
            radius: self.problem.radius,
        };
        Swarm::new(self.reference, self.sides != Sides::Unknown).best_poses(&faller, &self.reference.centroid())
    }
}

/// The 24 rotations of a cube: no rotation is more than 63 degrees from one of them.
fn cube_rotations() -> Vec<UnitQuaternion<f64>> {
    let quarter = std::f64::consts::FRAC_PI_2;
    let faces = [
        UnitQuaternion::identity(),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), quarter),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 2.0 * quarter),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3.0 * quarter),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), quarter),
        UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3.0 * quarter),
    ];
    (0..24)
        .map(|i| {
            let spin = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), quarter * f64::from(i % 4));
            faces[i as usize / 4] * spin
        })
        .collect()
}

/// How many template points fall in the swarm.
const FALL_COUNT: usize = 200;
/// How many points of each cloud vote for poses, and how many poses come of it.
const VOTER_COUNT: usize = 500;
const VOTED_COUNT: usize = 60;
/// How many points of each cloud fall from everywhere, and how many of the poses are kept.
const GLOBAL_COUNT: usize = 300;
const GLOBAL_KEPT_COUNT: usize = 6;
const NEAR_TEMPLATE_COUNT: usize = 2000;
const NEAR_REFERENCE_FACTOR: usize = 8;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rotations_of_a_cube_are_24_different_ones() {
        let all = cube_rotations();
        assert_eq!(all.len(), 24);
        for (index, a) in all.iter().enumerate() {
            assert!(all[..index].iter().all(|b| (a.inverse() * b).angle() > 1.0));
        }
    }
}
