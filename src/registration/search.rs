//! The course of one registration: candidates, their refinement, and the choice.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::coarse::{Coarse, choose, rivals};
use super::consistency::{Judge, residuals};
use super::icp::{Problem, Refined, Sample, finish};
use super::mpe::{Descent, descend};
use super::nfi::minimum;
use super::reference::{estimated, rms_radius, roughness_of};
use super::uncertainty::{Tolerance, covariance_of_minimum, determination, may_be_preferred};
use super::{
    Determination, FineStage, Overlap, POINT_MIN_COUNT, Reference, Registration, Search, Settings, Stage, Status,
    WeakDirections, surface,
};
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
    let overlap_distance = settings
        .overlap_distance
        .unwrap_or(reference.default_overlap_distance());
    let centroid = template.centroid();
    let radius = rms_radius(template.points(), &centroid);
    let last_level = settings.icp.levels.last();
    let (Some(last_level), true) = (last_level, template.len() >= POINT_MIN_COUNT && radius > 0.0) else {
        let (overlap, rmse) = residuals(template, reference, start, overlap_distance);
        return Registration::failed(start, overlap, rmse);
    };
    let mut stages = Stages {
        ended: Vec::new(),
        on_stage,
    };
    let tree = NearestPoints::new(template.points());
    let (fixed, moving) = (reference.roughness(), roughness_of(template.points(), &tree));
    let roughness = Roughness {
        scatter: fixed.scatter.hypot(moving.scatter),
        fuzziness: fixed.fuzziness.max(moving.fuzziness),
    };
    let (prepared, oriented) = if template.normals().is_some() {
        (template.clone(), true)
    } else {
        estimated(template, &tree)
    };
    let work = Work {
        template: prepared,
        roughness,
        reference,
        problem: Problem {
            reference,
            centroid,
            radius,
            oriented: oriented && reference.is_oriented(),
            metric: settings.icp.metric,
            trimming: settings.icp.trimming,
        },
        settings,
    };
    let judge = Judge {
        sample: work.sample(JUDGE_COUNT, &mut rng),
        reach: (JUDGE_SPACINGS * reference.spacing()).max(overlap_distance),
        residual_scale: (JUDGE_SCATTERS * roughness.scatter).max(JUDGE_SCALE_SPACINGS * reference.spacing()),
        oriented: work.problem.oriented,
    };
    stages.end("prepare", 0);

    let noisy = work.is_noisy();
    let mut candidates = vec![*start];
    let mut mpe_iterations = work.add_near_candidate(start, &mut candidates, &mut rng);
    if settings.search == Search::Everywhere || (settings.search == Search::Automatic && noisy) {
        mpe_iterations += work.add_global_candidates(&mut candidates, &mut rng);
    }
    stages.end("mpe", mpe_iterations);

    let samples = work.coarse_samples(&mut rng);
    let mut coarse = Coarse::new(&work.problem, settings, &judge, samples);
    for candidate in &candidates {
        coarse.add(candidate);
    }
    let explained = |coarse: &Coarse<'_>| noisy || coarse.is_explained(overlap_distance, roughness.scatter);
    let mut global_iterations = 0;
    if settings.search == Search::Automatic && !noisy && !(coarse.is_consistent() && explained(&coarse)) {
        let near_count = candidates.len();
        global_iterations = work.add_global_candidates(&mut candidates, &mut rng);
        for candidate in &candidates[near_count..] {
            coarse.add(candidate);
        }
    }
    let wide = matches!(settings.search, Search::Near | Search::Automatic | Search::Everywhere);
    if wide && !explained(&coarse) {
        coarse.add_turned_starts(start);
    }
    let coarse_iterations = coarse.iterations + global_iterations;
    let refined = coarse.refined;
    let chosen = choose(&refined);
    let rivals = rivals(&refined, chosen);
    stages.end("coarse", coarse_iterations);

    let fine_sample = work.sample(work.fine_count(last_level.sample_count), &mut rng);
    let start_score = judge.score(reference, start);
    let fine = if noisy {
        candidates.extend(refined.iter().map(|candidate| candidate.pose));
        work.fine_of_noisy(&fine_sample, &candidates, &mut rng)
    } else {
        let pose = &refined[chosen].pose;
        finish(
            &work.problem,
            &fine_sample,
            pose,
            start,
            last_level,
            settings.weak_directions,
        )
        .map(|fine| {
            let fine = work.surface_refined(&tree, fine);
            let ambiguous = work.is_ambiguous(&rivals, &fine);
            (fine, ambiguous)
        })
    };
    // The score needs surfaces; among noise the energy has chosen.
    let no_worse = |pose| noisy || judge.score(reference, pose) >= start_score - WORSE;
    let mut outcome = match fine {
        Some((fine, ambiguous)) if no_worse(&fine.pose) => {
            let (overlap, rmse) = residuals(template, reference, &fine.pose, overlap_distance);
            stages.end("fine", fine.iterations);
            let status = if overlap.fraction < settings.overlap_min_fraction {
                Status::Failed
            } else if ambiguous || rmse > settings.residual_max_factor * work.roughness.scatter {
                Status::Ambiguous
            } else if fine.determination.weak.is_empty() {
                Status::Converged
            } else {
                Status::Weak
            };
            Registration {
                reference_from_template: if status == Status::Failed { *start } else { fine.pose },
                status,
                overlap,
                rmse,
                covariance: fine.determination.covariance,
                weak_directions: fine.determination.weak.into_iter().map(|(_, weak)| weak).collect(),
                stages: Vec::new(),
            }
        }
        _ => {
            stages.end("fine", 0);
            Registration::failed(
                start,
                Overlap {
                    count: 0,
                    fraction: 0.0,
                },
                0.0,
            )
        }
    };
    if outcome.status == Status::Failed {
        (outcome.overlap, outcome.rmse) = residuals(template, reference, start, overlap_distance);
        outcome.covariance = None;
        outcome.weak_directions.clear();
    }
    outcome.stages = stages.ended;
    outcome
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

struct Work<'a> {
    template: PointCloud,
    reference: &'a Reference,
    problem: Problem<'a>,
    settings: &'a Settings,
    /// Of both clouds together.
    roughness: Roughness,
}

impl Work<'_> {
    fn sample(&self, count: usize, rng: &mut ChaCha8Rng) -> Sample {
        let picked = self.template.select(&random_indices(self.template.len(), count, rng));
        Sample {
            points: picked.points().to_vec(),
            normals: picked.normals().map(<[_]>::to_vec).unwrap_or_default(),
        }
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

    /// What trimmed ICP came to, refined surface to surface if so wished and possible.
    fn surface_refined(&self, tree: &NearestPoints, fine: Refined) -> Refined {
        if !self.ends_surface_to_surface() {
            return fine;
        }
        let held: Vec<_> = match self.settings.weak_directions {
            WeakDirections::Hold => fine.determination.weak.iter().map(|(scaled, _)| *scaled).collect(),
            WeakDirections::Report => Vec::new(),
        };
        match surface::refined(&self.problem, &self.template, tree, &fine, &held) {
            // What is held stays what trimmed ICP has found to be weak.
            Some(refined) if held.is_empty() => refined,
            Some(refined) => Refined {
                determination: fine.determination,
                ..refined
            },
            None => fine,
        }
    }

    /// Whether trimmed ICP is not the end.
    fn ends_surface_to_surface(&self) -> bool {
        let in_a_model = matches!(self.settings.search, Search::NearPart { .. });
        match self.settings.fine {
            FineStage::Automatic => !in_a_model && !self.is_noisy(),
            FineStage::SurfaceToSurface => true,
            FineStage::TrimmedIcp | FineStage::FullSampleNfi => false,
        }
    }

    /// How many points the last level of trimmed ICP takes.
    fn fine_count(&self, sample_count: usize) -> usize {
        if self.ends_surface_to_surface() {
            sample_count.min(BEFORE_SURFACE_COUNT)
        } else {
            sample_count
        }
    }

    /// Whether the fine stage is full-sample NFI.
    fn is_noisy(&self) -> bool {
        match self.settings.fine {
            FineStage::Automatic => self.roughness.fuzziness > NOISY_FUZZINESS,
            FineStage::TrimmedIcp | FineStage::SurfaceToSurface => false,
            FineStage::FullSampleNfi => true,
        }
    }

    /// The solution among noise, and whether it is ambiguous.
    fn fine_of_noisy(
        &self,
        fine_sample: &Sample,
        candidates: &[Isometry3<f64>],
        rng: &mut ChaCha8Rng,
    ) -> Option<(Refined, bool)> {
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
                ..self.problem.assess(fine_sample, &found.pose, reach)?
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
        Some((fine, ambiguous))
    }
}

fn distinct(a: &Isometry3<f64>, b: &Isometry3<f64>, centroid: &Point3<f64>, radius: f64) -> bool {
    let turn = (a.rotation.inverse() * b.rotation).angle();
    let shift = (a * centroid - b * centroid).norm();
    turn > DISTINCT_RAD || shift > DISTINCT_FACTOR * radius
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

/// How many template points judge a candidate.
const JUDGE_COUNT: usize = 2000;
/// How near a judging point must lie, in spacings of the reference.
const JUDGE_SPACINGS: f64 = 4.0;
/// A residual that halves a judging point's weight: the larger of these multiples of scatter and spacing.
const JUDGE_SCATTERS: f64 = 3.0;
const JUDGE_SCALE_SPACINGS: f64 = 0.1;
/// The fine stage may lose this much of the start's score to chance.
const WORSE: f64 = 0.01;
const DISTINCT_RAD: f64 = 0.09;
const DISTINCT_FACTOR: f64 = 0.1;
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
/// More points do not bring trimmed ICP nearer to where the stage after it begins.
const BEFORE_SURFACE_COUNT: usize = 20_000;
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
