//! The coarse levels of trimmed ICP over several candidates, and the choice between them.

use nalgebra::{Isometry3, Vector3, Vector6};

use super::Settings;
use super::consistency::{Judge, residuals};
use super::icp::{Problem, Sample};
use super::twist::moved;
use crate::geometry::PointCloud;

/// The coarse levels of trimmed ICP, and what they have come to so far.
pub(super) struct Coarse<'a> {
    problem: &'a Problem<'a>,
    settings: &'a Settings,
    judge: &'a Judge,
    /// One for each level but the last.
    samples: Vec<Sample>,
    /// In the order in which they were added.
    pub(super) refined: Vec<Candidate>,
    pub(super) iterations: u32,
}

impl<'a> Coarse<'a> {
    /// `samples` holds one sample for each level but the last.
    pub(super) fn new(
        problem: &'a Problem<'a>,
        settings: &'a Settings,
        judge: &'a Judge,
        samples: Vec<Sample>,
    ) -> Self {
        Self {
            problem,
            settings,
            judge,
            samples,
            refined: Vec::new(),
            iterations: 0,
        }
    }

    /// Refines `pose` over all coarse levels and judges it.
    pub(super) fn add(&mut self, pose: &Isometry3<f64>) {
        let pose = self.refined_over(0..self.samples.len(), *pose);
        self.push(pose);
    }

    /// Refines turned starts on the first level, and the most consistent few of them on the others.
    ///
    /// For views far apart: there neither the start nor the fall from it is in the basin of the solution.
    pub(super) fn add_turned_starts(&mut self, start: &Isometry3<f64>) {
        let levels = self.samples.len();
        let pivot = start * self.problem.centroid;
        let mut first: Vec<Candidate> = Vec::new();
        for turn in turns() {
            let turned = moved(start, &pivot, &turn);
            let pose = self.refined_over(0..levels.min(1), turned);
            let score = self.judge.score(self.problem.reference, &pose);
            first.push(Candidate { pose, score });
        }
        first.sort_by(|a, b| b.score.total_cmp(&a.score));
        for candidate in first.iter().take(TURNED_KEPT_COUNT) {
            let pose = self.refined_over(levels.min(1)..levels, candidate.pose);
            self.push(pose);
        }
    }

    /// Whether the best candidate's residuals are those of the clouds' own roughness.
    pub(super) fn is_explained(&self, overlap_distance: f64, scatter: f64) -> bool {
        let best = &self.refined[choose(&self.refined)].pose;
        let sample = PointCloud::from_measured(self.judge.sample.points.iter().copied()).cloud;
        let (overlap, rmse) = residuals(&sample, self.problem.reference, best, overlap_distance);
        overlap.fraction > self.settings.overlap_min_fraction && rmse <= self.settings.residual_max_factor * scatter
    }

    /// Whether most of the template lies on the reference in the best candidate.
    pub(super) fn is_consistent(&self) -> bool {
        self.refined[choose(&self.refined)].score > CONSISTENT
    }

    fn refined_over(&mut self, levels: std::ops::Range<usize>, mut pose: Isometry3<f64>) -> Isometry3<f64> {
        let all = &self.settings.icp.levels;
        for index in levels {
            let end_reach = all[index + 1].reach_factor * self.problem.radius;
            let found = self
                .problem
                .refine(&self.samples[index], &pose, &all[index], end_reach, &[]);
            if let Some(found) = found {
                pose = found.pose;
                self.iterations += found.iterations;
            }
        }
        pose
    }

    fn push(&mut self, pose: Isometry3<f64>) {
        let score = self.judge.score(self.problem.reference, &pose);
        self.refined.push(Candidate { pose, score });
    }
}

/// A pose and how consistent it is.
pub(super) struct Candidate {
    pub(super) pose: Isometry3<f64>,
    pub(super) score: f64,
}

/// The candidate with the best score; an earlier one unless a later one is clearly better, so the start has precedence.
pub(super) fn choose(candidates: &[Candidate]) -> usize {
    let mut best = 0;
    for (index, candidate) in candidates.iter().enumerate() {
        if candidate.score > candidates[best].score + CLEARLY {
            best = index;
        }
    }
    best
}

/// The other poses that score about as well as the chosen one.
pub(super) fn rivals(candidates: &[Candidate], chosen: usize) -> Vec<Isometry3<f64>> {
    let enough = AMBIGUOUS_FRACTION * candidates[chosen].score;
    candidates
        .iter()
        .filter(|other| other.score >= enough)
        .map(|other| other.pose)
        .collect()
}

/// Turns both ways about the axes and the diagonals of a cube.
fn turns() -> Vec<Vector6<f64>> {
    let axes = [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
        [-1.0, 1.0, 1.0],
        [1.0, -1.0, 1.0],
        [1.0, 1.0, -1.0],
        [0.0, 1.0, 1.0],
        [0.0, 1.0, -1.0],
        [1.0, 0.0, 1.0],
        [1.0, 0.0, -1.0],
        [1.0, 1.0, 0.0],
        [1.0, -1.0, 0.0],
    ];
    let mut turns = Vec::new();
    for angle in TURNS_RAD {
        for axis in axes {
            let turn = Vector3::from(axis).normalize() * angle;
            turns.push(Vector6::new(turn.x, turn.y, turn.z, 0.0, 0.0, 0.0));
        }
    }
    turns
}

/// How far turned starts are turned.
const TURNS_RAD: [f64; 2] = [0.75, -0.75];
/// How many of the turned starts are refined further.
const TURNED_KEPT_COUNT: usize = 4;
/// A better score than this is that of views that share most of their surface; a flipped blade can reach 0.5.
const CONSISTENT: f64 = 0.8;
/// Scores this much apart are different.
const CLEARLY: f64 = 0.01;
/// Scores within this share of each other are about the same.
const AMBIGUOUS_FRACTION: f64 = 0.97;
