//! What ends a registration: surfaces are laid on each other, and points where there are no surfaces or where they repeat.

use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use super::super::coarse::{Coarse, choose, distinct, rivals};
use super::super::icp::{Refined, finish};
use super::super::noisy::Noisy;
use super::super::uncertainty::{Tolerance, determination};
use super::super::{Determination, FineStage};
use super::{Sample, Solved, Work};

impl Work<'_> {
    /// Whether the fine stage is pointwise whatever comes.
    pub(super) fn is_noisy(&self) -> bool {
        match self.settings.fine {
            FineStage::Automatic => self.roughness.fuzziness > NOISY_FUZZINESS,
            FineStage::TrimmedIcp => false,
            FineStage::Pointwise => true,
        }
    }

    /// The last level of trimmed ICP from the best candidate.
    pub(super) fn fine_of_surfaces(
        &self,
        coarse: &Coarse<'_>,
        start: &Isometry3<f64>,
        rng: &mut ChaCha8Rng,
    ) -> Option<Solved> {
        let level = self.settings.icp.levels.last()?;
        let best = coarse.best();
        let rivals = rivals(&coarse.refined, choose(&coarse.refined));
        // Of two views the cameras tell flips apart.
        let consistent = coarse.is_consistent() || coarse.judges_views();
        if let Some(solved) = self.fine_of_repeated(&best.pose, consistent, &rivals, rng) {
            return Some(solved);
        }
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
        let ambiguous = self.is_ambiguous(&rivals, &fine) || coarse.is_contradicted(&fine.pose);
        Some(Solved { fine, ambiguous })
    }

    /// The solution among noise, and whether it is ambiguous.
    pub(super) fn fine_of_noisy(&self, candidates: &[Isometry3<f64>], rng: &mut ChaCha8Rng) -> Option<Solved> {
        let found = self
            .noisy(POINT_COUNT, rng)
            .best_of(candidates, &|a, b| self.is_distinct(a, b))?;
        let determination = match found.covariance {
            Some(covariance) => determination(&covariance, self.problem.radius, &TOLERANCE),
            None => {
                let level = self.settings.icp.levels.last()?;
                let fine_sample = self.sample(level.sample_count, rng);
                let reach = (3.0 * self.roughness.scatter).max(self.reference.default_overlap_distance());
                Determination {
                    covariance: None,
                    ..self.problem.assess(&fine_sample, &found.pose, reach)?
                }
            }
        };
        let fine = Refined {
            pose: found.pose,
            iterations: found.iterations,
            determination,
        };
        let ambiguous = found.covariance.is_none() || self.is_ambiguous(&found.rivals, &fine);
        Some(Solved { fine, ambiguous })
    }

    /// The solution near `pose`, or near the best flip of it when it is not consistent, if the reference repeats the template's
    /// points but for noise and outliers, and whether a rival might be it; `None` when their surfaces say more.
    fn fine_of_repeated(
        &self,
        pose: &Isometry3<f64>,
        consistent: bool,
        rivals: &[Isometry3<f64>],
        rng: &mut ChaCha8Rng,
    ) -> Option<Solved> {
        let longest = self.template.len().max(self.reference.points().len());
        if self.settings.fine == FineStage::TrimmedIcp || longest > REPEATED_MAX_COUNT {
            return None;
        }
        let noisy = self.noisy(REPEATED_MAX_COUNT, rng);
        let distinct = |a: &Isometry3<f64>, b: &Isometry3<f64>| self.is_distinct(a, b);
        let found = match noisy.repeated(pose, rivals, &distinct) {
            None if !consistent => noisy.repeated(&noisy.flipped(pose)?, rivals, &distinct)?,
            found => found?,
        };
        let fine = Refined {
            pose: found.pose,
            iterations: found.iterations,
            determination: determination(&found.covariance?, self.problem.radius, &TOLERANCE),
        };
        let ambiguous = self.is_ambiguous(&found.rivals, &fine);
        Some(Solved { fine, ambiguous })
    }

    fn noisy(&self, count: usize, rng: &mut ChaCha8Rng) -> Noisy {
        Noisy {
            template: self.sample(count, rng),
            reference: Sample::of(self.reference.points(), self.reference.normals(), count, rng),
            roles: self.roles,
            scatter: self.roughness.scatter,
        }
    }

    /// Whether a rival differs clearly from the solution, other than along a direction that is known to be weak.
    fn is_ambiguous(&self, rivals: &[Isometry3<f64>], fine: &Refined) -> bool {
        let weak: Vec<_> = fine.determination.weak.iter().map(|(scaled, _)| *scaled).collect();
        rivals.iter().any(|rival| {
            let rival = self.problem.without(&fine.pose, rival, &weak);
            self.is_distinct(&rival, &fine.pose)
        })
    }

    fn is_distinct(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        distinct(a, b, &self.problem.centroid, self.problem.radius)
    }
}

/// From this fuzziness on there is no surface to register to, only points.
const NOISY_FUZZINESS: f64 = 0.58;
/// Among noise a motion with a larger standard deviation than this is weak: a degree, three hundredths of the radius.
const TOLERANCE: Tolerance = Tolerance {
    turn_rad: 0.0175,
    shift_factor: 0.03,
};
/// How many points of each cloud are compared point by point among noise.
const POINT_COUNT: usize = 4000;
/// With more points a cloud is compared by its surface: samples of it repeat nothing.
const REPEATED_MAX_COUNT: usize = 10_000;
