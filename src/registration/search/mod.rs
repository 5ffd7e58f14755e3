//! The course of one registration: candidates ([`starts`]), their refinement, and the choice ([`fine`]).

mod fine;
mod starts;

use std::borrow::Cow;

use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use super::coarse::Coarse;
use super::consistency::{Judge, Views, residuals};
use super::facing::{Orientation, Sides};
use super::icp::{Problem, Refined, Sample};
use super::pointwise::Roles;
use super::reference::{centroid_and_radius, estimated, median_spacing, roughness_of};
use super::sight::Sight;
use super::{Reference, Registration, Search, Settings, Stage, Status};
use crate::geometry::PointCloud;
use crate::geometry::nearest::NearestPoints;
use crate::geometry::normals::Roughness;

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
    let finite = start.to_homogeneous().iter().all(|value| value.is_finite());
    let work = Work::new(template, reference, settings).filter(|_| finite);
    let solved = work.as_ref().and_then(|work| work.solve(start, &mut rng, &mut stages));
    let overlap_distance = overlap_distance(settings, reference);
    let solved = solved.map(|solved| {
        let (overlap, rmse) = residuals(template.points(), reference, &solved.fine.pose, overlap_distance);
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
    let (overlap, rmse) = residuals(template.points(), reference, start, overlap_distance);
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

impl Solved {
    /// Points know no weak directions to hold: what the settings say of the start is settled at the end.
    fn weighed(self, work: &Work<'_>, start: &Isometry3<f64>) -> Self {
        Self {
            fine: self.fine.weighed(&work.problem, start, work.settings.weak_directions),
            ..self
        }
    }
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
    /// Whose points are taken for the truth where points are compared.
    roles: Roles,
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
            roles: Roles::of(moving.scatter, fixed.scatter),
        })
    }

    /// Looks for the solution from `start` and refines it; `None` when nothing fits, or nothing better than the start.
    fn solve(&self, start: &Isometry3<f64>, rng: &mut ChaCha8Rng, stages: &mut Stages<'_>) -> Option<Solved> {
        stages.end("prepare", 0);
        let mut candidates = vec![*start];
        let mut iterations = self.add_near_candidate(start, &mut candidates, rng);
        let found = if self.is_noisy() {
            if matches!(self.settings.search, Search::Automatic | Search::Everywhere) {
                iterations += self.add_global_candidates(&mut candidates, rng);
            }
            stages.end("mpe", iterations);
            // Trimmed ICP leads away there.
            stages.end("coarse", 0);
            self.fine_of_noisy(&candidates, rng)
                .map(|solved| solved.weighed(self, start))
        } else {
            stages.end("mpe", iterations);
            let mut coarse = self.coarse(rng);
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

    fn coarse(&self, rng: &mut ChaCha8Rng) -> Coarse<'_> {
        let judge = self.judge(rng);
        Coarse::new(&self.problem, self.settings, judge, self.coarse_samples(rng))
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
}

/// How many points of each cloud are looked at in a glance.
const GLANCE_COUNT: usize = 400;
/// How many template points judge a candidate.
const JUDGE_COUNT: usize = 2000;
/// How near a judging point must lie, in spacings of the reference.
const JUDGE_SPACINGS: f64 = 4.0;
/// A residual that halves a judging point's weight: the larger of these multiples of scatter and spacing.
const JUDGE_SCATTERS: f64 = 3.0;
const JUDGE_SCALE_SPACINGS: f64 = 0.1;
