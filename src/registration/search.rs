//! The course of one registration: candidates, their refinement, and the choice.

use std::borrow::Cow;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::coarse::{Coarse, choose, distinct, rivals};
use super::consistency::{Judge, Views, residuals};
use super::facing::{Orientation, Sides};
use super::icp::{Problem, Refined, Sample, finish};
use super::mpe::{Descent, descend};
use super::nfi::minimum;
use super::point_pairs::voted_poses;
use super::reference::{centroid_and_radius, estimated, median_spacing, roughness_of};
use super::sight::Sight;
use super::swarm::{Faller, Swarm};
use super::uncertainty::{Tolerance, covariance_of_minimum, determination, may_be_preferred};
use super::{Determination, FineStage, Reference, Registration, Search, Settings, Stage, Status};
use crate::geometry::PointCloud;
use crate::geometry::nearest::NearestPoints;
use crate::geometry::normals::Roughness;
use crate::geometry::sampling::random_indices;

pub(super) fn run(
    template: &PointCloud,
    reference: &Reference,
    start: &Isometry3<f64>,
    settings: &Settings,
    mut rng: ChaCha8Rng,
    on_stage: &mut dyn FnMut(&Stage),
) -> Registration {
    let mut stages = Stages {
        ended: Vec::new(),
        on_stage,
    };
    let work = Work::new(template, reference, settings);
    let solved = work.as_ref().and_then(|work| work.solve(start, &mut rng, &mut stages));
    let overlap_distance = overlap_distance(settings, reference);
    let solved = solved.map(|solved| {
        let (overlap, rmse) = residuals(template, reference, &solved.fine.pose, overlap_distance);
        (solved, overlap, rmse)
    });
    if let (Some(work), Some((solved, overlap, rmse))) = (&work, solved)
        && overlap.fraction >= settings.overlap_min_fraction
    {
        let Refined {
            pose, determination, ..
        } = solved.fine;
        let unexplained = rmse > settings.residual_max_factor * work.roughness.scatter;
        return Registration {
            reference_from_template: pose,
            status: if solved.ambiguous || unexplained {
                Status::Ambiguous
            } else if determination.weak.is_empty() {
                Status::Converged
            } else {
                Status::Weak
            },
            overlap,
            rmse,
            covariance: determination.covariance,
            weak_directions: determination.weak.into_iter().map(|(_, weak)| weak).collect(),
            stages: stages.ended,
        };
    }
    let (overlap, rmse) = residuals(template, reference, start, overlap_distance);
    Registration {
        reference_from_template: *start,
        status: Status::Failed,
        overlap,
        rmse,
        covariance: None,
        weak_directions: Vec::new(),
        stages: stages.ended,
    }
}

fn overlap_distance(settings: &Settings, reference: &Reference) -> f64 {
    let default = reference.default_overlap_distance();
    settings.overlap_distance.unwrap_or(default)
}

struct Stages<'a> {
    ended: Vec<Stage>,
    on_stage: &'a mut dyn FnMut(&Stage),
}

impl Stages<'_> {
    fn end(&mut self, name: &'static str, iterations: u32) {
        let stage = Stage { name, iterations };
        (self.on_stage)(&stage);
        self.ended.push(stage);
    }
}

/// What the fine stage came to.
struct Solved {
    fine: Refined,
    ambiguous: bool,
}

struct Work<'a> {
    template: Cow<'a, PointCloud>,
    tree: NearestPoints,
    reference: &'a Reference,
    problem: Problem<'a>,
    settings: &'a Settings,
    /// The template's.
    orientation: Orientation,
    /// Of both clouds compared.
    sides: Sides,
    /// Of both clouds together.
    roughness: Roughness,
}

impl<'a> Work<'a> {
    /// `None` when the template or the settings leave nothing to be registered.
    fn new(template: &'a PointCloud, reference: &'a Reference, settings: &'a Settings) -> Option<Self> {
        let (centroid, radius) = centroid_and_radius(template).ok()?;
        if settings.icp.levels.is_empty() {
            return None;
        }
        let tree = NearestPoints::new(template.points());
        let (fixed, moving) = (reference.roughness(), roughness_of(template.points(), &tree));
        let (template, orientation) = if template.normals().is_some() {
            (Cow::Borrowed(template), Orientation::Given)
        } else {
            let (estimated, orientation) = estimated(template, &tree);
            (Cow::Owned(estimated), orientation)
        };
        let sides = orientation.sides().with(reference.orientation().sides());
        Some(Self {
            tree,
            template,
            reference,
            problem: Problem {
                reference,
                centroid,
                radius,
                oriented: sides != Sides::Unknown,
                metric: settings.icp.metric,
                trimming: settings.icp.trimming,
            },
            settings,
            orientation,
            sides,
            roughness: Roughness {
                scatter: fixed.scatter.hypot(moving.scatter),
                fuzziness: fixed.fuzziness.max(moving.fuzziness),
            },
        })
    }

    /// Looks for the solution from `start` and refines it; `None` when nothing fits, or nothing better than the start.
    fn solve(&self, start: &Isometry3<f64>, rng: &mut ChaCha8Rng, stages: &mut Stages<'_>) -> Option<Solved> {
        let judge = self.judge(rng);
        stages.end("prepare", 0);
        let mut candidates = vec![*start];
        let mut iterations = self.add_near_candidate(start, &mut candidates, rng);
        let found = if self.is_noisy() {
            if matches!(self.settings.search, Search::Automatic | Search::Everywhere) {
                iterations += self.add_global_candidates(&mut candidates, rng);
            }
            stages.end("mpe", iterations);
            let mut coarse = self.coarse(judge, rng);
            candidates.iter().for_each(|candidate| coarse.add(candidate));
            candidates.extend(coarse.refined.iter().map(|candidate| candidate.pose));
            stages.end("coarse", coarse.iterations);
            self.fine_of_noisy(&candidates, rng).map(|solved| Solved {
                fine: solved.fine.weighed(&self.problem, start, self.settings.weak_directions),
                ..solved
            })
        } else {
            stages.end("mpe", iterations);
            let mut coarse = self.coarse(judge, rng);
            candidates.iter().for_each(|candidate| coarse.add(candidate));
            self.widen(&mut coarse, rng);
            stages.end("coarse", coarse.iterations);
            self.fine_of_surfaces(&coarse, start, rng)
                .filter(|solved| coarse.is_no_worse(&solved.fine.pose, start))
        };
        stages.end("fine", found.as_ref().map_or(0, |solved| solved.fine.iterations));
        found
    }

    /// Looks everywhere when what is found does not explain the clouds, or if everywhere is where to look.
    fn widen<'b>(&'b self, coarse: &mut Coarse<'b>, rng: &mut ChaCha8Rng) {
        let anywhere = match self.settings.search {
            Search::StartOnly | Search::NearPart { .. } => return,
            Search::Near => false,
            Search::Automatic => !coarse.is_consistent(),
            Search::Everywhere => true,
        };
        let overlap_distance = overlap_distance(self.settings, self.reference);
        if !anywhere && coarse.is_explained(overlap_distance, self.roughness.scatter) {
            return;
        }
        let views = self.views(rng);
        let poses = if let Some(views) = views {
            coarse.judge_views(views);
            self.voted_poses(rng)
        } else {
            self.swarm_poses(rng)
        };
        coarse.add_near_poses(&poses);
    }

    /// What is needed to judge two single views by one another; `None` when one of the clouds is no single view.
    fn views(&self, rng: &mut ChaCha8Rng) -> Option<Views<'_>> {
        let (points, normals) = (self.reference.points(), self.reference.normals());
        let of_reference = self.reference.orientation().camera(points, normals)?;
        let template_normals = self.template.normals().unwrap_or(&[]);
        let of_template = self.orientation.camera(self.template.points(), template_normals)?;
        let spacing = median_spacing(self.template.points(), &self.tree, self.problem.radius);
        Some(Views {
            template: &self.template,
            tree: &self.tree,
            reference_sight: Sight::new(points, &of_reference, self.reference.spacing()),
            template_sight: Sight::new(self.template.points(), &of_template, spacing),
            sample: Sample::of(points, normals, JUDGE_COUNT, rng),
            glances: [
                self.sample(GLANCE_COUNT, rng),
                Sample::of(points, normals, GLANCE_COUNT, rng),
            ],
        })
    }

    /// What pairs of oriented points vote for.
    fn voted_poses(&self, rng: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
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
    fn swarm_poses(&self, rng: &mut ChaCha8Rng) -> Vec<Isometry3<f64>> {
        let faller = Faller {
            sample: self.sample(FALL_COUNT, rng),
            centroid: self.problem.centroid,
            radius: self.problem.radius,
        };
        Swarm::new(self.reference, self.sides != Sides::Unknown).best_poses(&faller, &self.reference.centroid())
    }

    fn judge(&self, rng: &mut ChaCha8Rng) -> Judge<'_> {
        let spacing = self.reference.spacing();
        Judge {
            reference: self.reference,
            sample: self.sample(JUDGE_COUNT, rng),
            reach: (JUDGE_SPACINGS * spacing).max(overlap_distance(self.settings, self.reference)),
            residual_scale: (JUDGE_SCATTERS * self.roughness.scatter).max(JUDGE_SCALE_SPACINGS * spacing),
            sides: self.sides,
            views: None,
        }
    }

    fn coarse<'b>(&'b self, judge: Judge<'b>, rng: &mut ChaCha8Rng) -> Coarse<'b> {
        Coarse::new(&self.problem, self.settings, judge, self.coarse_samples(rng))
    }

    /// The last level of trimmed ICP from the best candidate.
    fn fine_of_surfaces(&self, coarse: &Coarse<'_>, start: &Isometry3<f64>, rng: &mut ChaCha8Rng) -> Option<Solved> {
        let level = self.settings.icp.levels.last()?;
        let best = coarse.best();
        let mut sample = self.sample(level.sample_count, rng);
        if best.score.reversed {
            sample = sample.reversed();
        }
        let fine = finish(
            &self.problem,
            &sample,
            &best.pose,
            start,
            level,
            self.settings.weak_directions,
        )?;
        let rivals = rivals(&coarse.refined, choose(&coarse.refined));
        let ambiguous = self.is_ambiguous(&rivals, &fine) || coarse.is_contradicted(&fine.pose);
        Some(Solved { fine, ambiguous })
    }

    fn sample(&self, count: usize, rng: &mut ChaCha8Rng) -> Sample {
        let normals = self.template.normals().unwrap_or(&[]);
        Sample::of(self.template.points(), normals, count, rng)
    }

    /// One sample for each level of trimmed ICP but the last.
    fn coarse_samples(&self, rng: &mut ChaCha8Rng) -> Vec<Sample> {
        let levels = &self.settings.icp.levels;
        levels[..levels.len() - 1]
            .iter()
            .map(|level| self.sample(level.sample_count, rng))
            .collect()
    }

    /// Adds what MPE comes to from the start.
    fn add_near_candidate(
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
    fn add_global_candidates(&self, candidates: &mut Vec<Isometry3<f64>>, rng: &mut ChaCha8Rng) -> u32 {
        let few = self.sample(GLOBAL_COUNT, rng).points;
        let whole = self.reference_sample(GLOBAL_COUNT, rng);
        let mut descents: Vec<Descent> = spread_rotations()
            .into_par_iter()
            .map(|turn| {
                let pose = Translation3::from(self.reference.centroid().coords)
                    * turn
                    * Translation3::from(-self.problem.centroid.coords);
                descend(&few, &whole, &pose, &self.settings.mpe)
            })
            .collect();
        descents.sort_by(|a, b| a.energy.total_cmp(&b.energy));
        let limit = candidates.len() + GLOBAL_KEPT_COUNT;
        for descent in &descents {
            let pose = descent.reference_from_template;
            let known = candidates
                .iter()
                .any(|other| !distinct(other, &pose, &self.problem.centroid, self.problem.radius));
            if !known && candidates.len() < limit {
                candidates.push(pose);
            }
        }
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

    /// Whether a rival differs clearly from the solution, other than along a direction that is known to be weak.
    fn is_ambiguous(&self, rivals: &[Isometry3<f64>], fine: &Refined) -> bool {
        let weak: Vec<_> = fine.determination.weak.iter().map(|(scaled, _)| *scaled).collect();
        rivals.iter().any(|rival| {
            let rival = self.problem.without(&fine.pose, rival, &weak);
            distinct(&rival, &fine.pose, &self.problem.centroid, self.problem.radius)
        })
    }

    /// Whether the fine stage is full-sample NFI.
    fn is_noisy(&self) -> bool {
        match self.settings.fine {
            FineStage::Automatic => self.roughness.fuzziness > NOISY_FUZZINESS,
            FineStage::TrimmedIcp => false,
            FineStage::FullSampleNfi => true,
        }
    }

    /// The NFI criterion over many points, from all candidates.
    fn fine_of_noisy(&self, candidates: &[Isometry3<f64>], rng: &mut ChaCha8Rng) -> Option<Solved> {
        let level = self.settings.icp.levels.last()?;
        let fine_sample = self.sample(level.sample_count, rng);
        let sample = self.sample(NFI_COUNT, rng).points;
        let reference = self.reference_sample(NFI_COUNT, rng);
        let noise = self.roughness.scatter;
        let (found, refined) = minimum(&sample, &reference, candidates, noise)?;
        let reach = (3.0 * self.roughness.scatter).max(self.reference.default_overlap_distance());
        let covariance = covariance_of_minimum(&sample, &reference, &found.pose, noise);
        let determination = match covariance {
            Some(covariance) => determination(&covariance, self.problem.radius, &TOLERANCE),
            None => Determination {
                covariance,
                ..self.problem.assess(&fine_sample, &found.pose, reach)?
            },
        };
        let fine = Refined {
            pose: found.pose,
            iterations: found.iterations,
            determination,
        };
        let ambiguous = covariance.is_none()
            || refined.iter().any(|rival| {
                self.is_ambiguous(&[*rival], &fine) && may_be_preferred(&sample, &reference, &fine.pose, rival, noise)
            });
        Some(Solved { fine, ambiguous })
    }
}

/// The 24 rotations of a cube: no rotation is more than 63 degrees from one of them.
fn spread_rotations() -> Vec<UnitQuaternion<f64>> {
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
/// How many points of each cloud are looked at in a glance.
const GLANCE_COUNT: usize = 400;
/// How many points of each cloud vote for poses, and how many poses come of it.
const VOTER_COUNT: usize = 500;
const VOTED_COUNT: usize = 60;
/// How many template points judge a candidate.
const JUDGE_COUNT: usize = 2000;
/// How near a judging point must lie, in spacings of the reference.
const JUDGE_SPACINGS: f64 = 4.0;
/// A residual that halves a judging point's weight: the larger of these multiples of scatter and spacing.
const JUDGE_SCATTERS: f64 = 3.0;
const JUDGE_SCALE_SPACINGS: f64 = 0.1;
const GLOBAL_COUNT: usize = 300;
const GLOBAL_KEPT_COUNT: usize = 6;
const NEAR_TEMPLATE_COUNT: usize = 2000;
const NEAR_REFERENCE_FACTOR: usize = 8;
/// From this fuzziness on there is no surface to register to, only points.
const NOISY_FUZZINESS: f64 = 0.58;
/// Among noise a motion with a larger standard deviation than this is weak: a degree, three hundredths of the radius.
const TOLERANCE: Tolerance = Tolerance {
    turn_rad: 0.0175,
    shift_factor: 0.03,
};
/// How many points of each cloud take part in full-sample NFI.
const NFI_COUNT: usize = 4000;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_rotations_are_24_different_ones() {
        let all = spread_rotations();
        assert_eq!(all.len(), 24);
        for (index, a) in all.iter().enumerate() {
            assert!(all[..index].iter().all(|b| (a.inverse() * b).angle() > 1.0));
        }
    }
}
