//! The coarse levels of trimmed ICP over several candidates, and the choice between them.

use nalgebra::{Isometry3, Point3};

use super::consistency::{Judge, Score, Views, residuals};
use super::distinct::add_distinct;
use super::facing::Sides;
use super::icp::{IcpLevel, Problem, Sample};
use super::{IcpSettings, Settings};

/// The coarse levels of trimmed ICP, and what they have come to so far.
pub(super) struct Coarse<'a> {
    problem: &'a Problem<'a>,
    settings: &'a Settings,
    judge: Judge<'a>,
    /// One for each level but the last, and the same with reversed normals.
    samples: [Vec<Sample>; 2],
    /// Where the first level of each of those that were added ended.
    firsts: Vec<Isometry3<f64>>,
    /// In the order in which they were added.
    pub(super) refined: Vec<Candidate>,
    pub(super) iterations: u32,
}

/// A pose and what it is worth.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    pub(super) pose: Isometry3<f64>,
    pub(super) score: Score,
}

impl<'a> Coarse<'a> {
    /// `samples` holds one sample for each level but the last.
    pub(super) fn new(
        problem: &'a Problem<'a>,
        settings: &'a Settings,
        judge: Judge<'a>,
        samples: Vec<Sample>,
    ) -> Self {
        let reversed = match judge.sides {
            Sides::OneOfTwo => samples.iter().map(Sample::reversed).collect(),
            Sides::Known | Sides::Unknown => Vec::new(),
        };
        Self {
            problem,
            settings,
            judge,
            samples: [samples, reversed],
            firsts: Vec::new(),
            refined: Vec::new(),
            iterations: 0,
        }
    }

    /// Refines `pose` over all coarse levels and judges it, unless its first level ends where that of another one did.
    pub(super) fn add(&mut self, pose: &Isometry3<f64>) {
        let candidate = self.judged(*pose);
        let levels = self.level_count();
        let first = self.refined_over(0..levels.min(1), &candidate);
        if self.firsts.iter().any(|other| self.are_same(other, &first.pose)) {
            return;
        }
        self.firsts.push(first.pose);
        let refined = if levels > 1 {
            self.refined_over(1..levels, &first)
        } else {
            first
        };
        self.refined.push(refined);
    }

    /// Refines the best few of `poses` that may be near the solution, from a narrow reach on.
    ///
    /// Views far apart share little of their surfaces: a wide reach would pull what they do not share together.
    pub(super) fn add_near_poses(&mut self, poses: &[Isometry3<f64>]) {
        let glanced = |pose: &Isometry3<f64>| Candidate {
            pose: *pose,
            score: self.judge.glance(pose),
        };
        let seen: Vec<Candidate> = poses.iter().map(glanced).collect();
        let mut narrow: Vec<Candidate> = Vec::new();
        for candidate in best_of(seen, NARROW_COUNT) {
            narrow.push(self.narrowed(&candidate));
        }
        let mut kept: Vec<Candidate> = Vec::new();
        add_distinct(&mut kept, best_of(narrow, NARROW_COUNT), NEAR_KEPT_COUNT, |a, b| {
            self.are_distinct(&a.pose, &b.pose)
        });
        let levels = self.level_count();
        for candidate in kept {
            let refined = self.refined_over(levels.min(1)..levels, &candidate);
            self.refined.push(refined);
        }
    }

    /// Judges by what two single views say of one another from now on.
    pub(super) fn judge_views(&mut self, views: Views<'a>) {
        self.judge.views = Some(views);
        for index in 0..self.refined.len() {
            self.refined[index] = self.judged(self.refined[index].pose);
        }
    }

    /// Whether two single views are judged by one another.
    pub(super) fn judges_views(&self) -> bool {
        self.judge.views.is_some()
    }

    /// Whether `pose` is worth no less than `start`, but for chance.
    pub(super) fn is_no_worse(&self, pose: &Isometry3<f64>, start: &Isometry3<f64>) -> bool {
        self.judge.score(pose).value >= self.judge.score(start).value - WORSE
    }

    /// Whether more of the clouds contradicts the other view at `pose` than the camera's place, known but roughly, excuses.
    pub(super) fn is_contradicted(&self, pose: &Isometry3<f64>) -> bool {
        self.judge.score(pose).contradiction > CONTRADICTED
    }

    /// The best candidate.
    pub(super) fn best(&self) -> &Candidate {
        &self.refined[choose(&self.refined)]
    }

    /// Whether the best candidate's residuals are those of the clouds' own roughness.
    pub(super) fn is_explained(&self, overlap_distance: f64, scatter: f64) -> bool {
        let sample = &self.judge.sample.points;
        let (overlap, rmse) = residuals(sample, self.problem.reference, &self.best().pose, overlap_distance);
        overlap.fraction > self.settings.overlap_min_fraction && rmse <= self.settings.residual_max_factor * scatter
    }

    /// Whether most of the template lies on the reference in the best candidate.
    pub(super) fn is_consistent(&self) -> bool {
        self.best().score.share > CONSISTENT
    }

    fn are_distinct(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        distinct(a, b, &self.problem.centroid, self.problem.radius)
    }

    /// Whether further levels lead two poses to one place.
    fn are_same(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        let turn = (a.rotation.inverse() * b.rotation).angle();
        let shift = (a * self.problem.centroid - b * self.problem.centroid).norm() / self.problem.radius;
        turn + shift < SAME_FACTOR
    }

    fn level_count(&self) -> usize {
        self.samples[0].len()
    }

    fn judged(&self, pose: Isometry3<f64>) -> Candidate {
        let score = self.judge.score(&pose);
        Candidate { pose, score }
    }

    /// What the coarse `levels` make of a candidate; it keeps its side.
    fn refined_over(&mut self, levels: std::ops::Range<usize>, candidate: &Candidate) -> Candidate {
        let IcpSettings { levels: all, .. } = &self.settings.icp;
        let mut pose = candidate.pose;
        for index in levels {
            let end_reach = all[index + 1].reach_factor * self.problem.radius;
            let sample = &self.samples[usize::from(candidate.score.reversed)][index];
            let found = self.problem.refine(sample, &pose, &all[index], end_reach, &[]);
            if let Some(found) = found {
                pose = found.pose;
                self.iterations += found.iterations;
            }
        }
        self.judged(pose)
    }

    fn narrowed(&mut self, candidate: &Candidate) -> Candidate {
        let Some(sample) = self.samples[usize::from(candidate.score.reversed)].first() else {
            return *candidate;
        };
        let end_reach = NARROW_LEVEL.reach_factor * NARROW_SHRINK * self.problem.radius;
        let found = self
            .problem
            .refine(sample, &candidate.pose, &NARROW_LEVEL, end_reach, &[]);
        self.iterations += found.as_ref().map_or(0, |found| found.iterations);
        self.judged(found.map_or(candidate.pose, |found| found.pose))
    }
}

/// The candidate with the best score; an earlier one unless a later one is clearly better, so the start has precedence.
pub(super) fn choose(candidates: &[Candidate]) -> usize {
    let mut best = 0;
    for (index, candidate) in candidates.iter().enumerate() {
        if candidate.score.value > candidates[best].score.value + CLEARLY {
            best = index;
        }
    }
    best
}

/// The other poses that score about as well as the chosen one.
pub(super) fn rivals(candidates: &[Candidate], chosen: usize) -> Vec<Isometry3<f64>> {
    let Score { value, share, .. } = candidates[chosen].score;
    let enough = value - AMBIGUOUS_FRACTION * share;
    candidates
        .iter()
        .filter(|other| other.score.value >= enough)
        .map(|other| other.pose)
        .collect()
}

/// The `count` best candidates, best first; ties in their order.
fn best_of(mut candidates: Vec<Candidate>, count: usize) -> Vec<Candidate> {
    candidates.sort_by(|a, b| b.score.value.total_cmp(&a.score.value));
    candidates.truncate(count);
    candidates
}

/// Whether two poses clearly differ: by more than 5 degrees or a tenth of the radius.
pub(super) fn distinct(a: &Isometry3<f64>, b: &Isometry3<f64>, centroid: &Point3<f64>, radius: f64) -> bool {
    let turn = (a.rotation.inverse() * b.rotation).angle();
    let shift = (a * centroid - b * centroid).norm();
    turn > DISTINCT_RAD || shift > DISTINCT_FACTOR * radius
}

/// How many poses are refined on the narrow level, and how many of these further.
const NARROW_COUNT: usize = 24;
const NEAR_KEPT_COUNT: usize = 6;
const NARROW_LEVEL: IcpLevel = IcpLevel {
    sample_count: 1000,
    reach_factor: 0.12,
    iteration_max_count: 15,
};
const NARROW_SHRINK: f64 = 0.25;
/// Right poses have a contradiction of at most 0.02, of blades too thin to tell the camera's place 0.1; wrong ones that
/// fit best of all 0.1 to 0.3.
const CONTRADICTED: f64 = 0.08;
/// A better score than this is that of views that share most of their surface; a flipped blade can reach 0.5.
const CONSISTENT: f64 = 0.8;
/// The fine stage may lose this much of the start's score to chance.
const WORSE: f64 = 0.01;
/// Poses this near to each other, over the radius, lie within a third of the second level's default reach.
const SAME_FACTOR: f64 = 0.008;
const DISTINCT_RAD: f64 = 0.09;
const DISTINCT_FACTOR: f64 = 0.1;
/// Scores this much apart are different.
const CLEARLY: f64 = 0.01;
/// Values that differ by less than this multiple of the better one's share are about the same.
const AMBIGUOUS_FRACTION: f64 = 0.03;
