//! What ends a registration: surfaces are laid on each other, and points where there are no surfaces or where they repeat.

use std::borrow::Cow;

use nalgebra::Isometry3;
use rand_chacha::ChaCha8Rng;

use super::super::coarse::{Coarse, choose, distinct, rivals};
use super::super::icp::{Refined, finish};
use super::super::noisy::Noisy;
use super::super::uncertainty::{Tolerance, determination};
use super::super::{Determination, FineStage, Search, WeakDirections, surface};
use super::{Sample, Solved, Work};
use crate::geometry::PointCloud;

impl Work<'_> {
    /// Whether the fine stage is pointwise whatever comes.
    pub(super) fn is_noisy(&self) -> bool {
        match self.settings.fine {
            FineStage::Automatic => self.roughness.fuzziness > NOISY_FUZZINESS,
            FineStage::TrimmedIcp | FineStage::SurfaceToSurface => false,
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
            return Some(solved.weighed(self, start));
        }
        let mut sample = self.sample(self.fine_count(level.sample_count), rng);
        if best.score.reversed {
            sample = sample.reversed();
        }
        let weak_directions = self.settings.weak_directions;
        let weighed_last = self.ends_surface_to_surface() && matches!(weak_directions, WeakDirections::Weigh(_));
        let first = if weighed_last {
            WeakDirections::Report
        } else {
            weak_directions
        };
        let fine = finish(&self.problem, &sample, &best.pose, start, level, first)?;
        let mut fine = self.surface_refined(fine, best.score.reversed);
        if weighed_last {
            fine = fine.weighed(&self.problem, start, weak_directions);
        }
        let ambiguous = self.is_ambiguous(&rivals, &fine) || coarse.is_contradicted(&fine.pose);
        Some(Solved { fine, ambiguous })
    }

    /// What trimmed ICP came to, refined surface to surface if so wished and possible.
    fn surface_refined(&self, fine: Refined, reversed: bool) -> Refined {
        if !self.ends_surface_to_surface() {
            return fine;
        }
        let held: Vec<_> = match self.settings.weak_directions {
            WeakDirections::Hold => fine.determination.weak.iter().map(|(scaled, _)| *scaled).collect(),
            WeakDirections::Report | WeakDirections::Weigh(_) => Vec::new(),
        };
        let template = if reversed {
            Cow::Owned(with_reversed_normals(&self.template))
        } else {
            Cow::Borrowed(self.template.as_ref())
        };
        match surface::refined(&self.problem, &template, &self.tree, &fine, &held) {
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
            FineStage::TrimmedIcp | FineStage::Pointwise => false,
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
        if matches!(self.settings.fine, FineStage::TrimmedIcp | FineStage::SurfaceToSurface)
            || longest > REPEATED_MAX_COUNT
        {
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

    pub(super) fn is_distinct(&self, a: &Isometry3<f64>, b: &Isometry3<f64>) -> bool {
        distinct(a, b, &self.problem.centroid, self.problem.radius)
    }
}

fn with_reversed_normals(cloud: &PointCloud) -> PointCloud {
    let reversed = cloud.normals().unwrap_or(&[]).iter().map(|normal| -normal).collect();
    cloud.clone().with_normals(reversed).unwrap_or_else(|| cloud.clone())
}

/// From this fuzziness on there is no surface to register to, only points.
const NOISY_FUZZINESS: f64 = 0.58;
/// Among noise a motion with a larger standard deviation than this is weak: a degree, three hundredths of the radius.
const TOLERANCE: Tolerance = Tolerance {
    turn_rad: 0.0175,
    shift_factor: 0.03,
};
/// More points do not bring trimmed ICP nearer to where the stage after it begins.
const BEFORE_SURFACE_COUNT: usize = 20_000;
/// How many points of each cloud are compared point by point among noise.
const POINT_COUNT: usize = 4000;
/// With more points a cloud is compared by its surface: samples of it repeat nothing.
const REPEATED_MAX_COUNT: usize = 10_000;
