//! The views between the camera and the model: prepared as they come, registered and merged in index order; then those that
//! were discarded and taken again, in index order.

use super::Output;
use crate::cleaning;
use crate::event::{Event, RemovedCounts, ViewFigures};
use crate::geometry::PointCloud;
use crate::job::{FinishedJob, Job, JobOutput, RegisterJob, StageTime};
use crate::plan::{PlannedView, camera_relative};
use crate::reconstruction::{Decision, DiscardReason, Model, OverlapMin, PriorLimits, ViewRegistration, ViewSettings};
use crate::registration::{self, Search};
use crate::seed::Seed;
use crate::session::{Captured, Target};
use crate::settings::{Recipe, RetakeReason, Retakes, Start, Station};
use crate::stamp::Stamp;
use nalgebra::Isometry3;
use std::collections::VecDeque;
use std::sync::Arc;

/// What became of a planned view.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewRecord {
    /// Merged, discarded, or missing (so far).
    pub outcome: ViewOutcome,
    /// The attempt whose frame was used, from 0.
    pub attempt: u16,
    /// How many attempts there were.
    pub attempt_count: usize,
    /// Those before the last, in order.
    pub not_used: Vec<UnusedAttempt>,
    /// Points of its cloud.
    pub point_count: usize,
    /// What was taken out of its frame before.
    pub removed: RemovedCounts,
    /// Figures of its registration.
    pub figures: ViewFigures,
    /// How long the stages of its jobs took.
    pub times: Vec<StageTime>,
    /// From the end of the frame to the decision, ms.
    pub latency_ms: u64,
}

/// An attempt at a view that gave nothing usable.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnusedAttempt {
    /// Which one, from 0.
    pub attempt: u16,
    /// Why.
    pub reason: String,
}

/// Merged, discarded or missing.
#[derive(Debug, Clone, PartialEq)]
pub enum ViewOutcome {
    /// It is part of the model.
    Merged {
        /// Where it lies there, mm.
        model_from_view: Isometry3<f64>,
    },
    /// It was registered but is not part of the model.
    Discarded {
        /// Why.
        reason: String,
    },
    /// There is no frame of it.
    Missing {
        /// Why.
        reason: String,
    },
}

/// The views between the camera and the model.
#[derive(Debug)]
pub(super) struct Backlog {
    cleaning: cleaning::Settings,
    settings: ViewSettings,
    start: Start,
    coincident_distance_mm: f64,
    base_from_camera: Isometry3<f64>,
    retakes: Retakes,
    /// The arm's pose at view 0: as reported, or as planned while it has not been taken.
    base_from_tool_0: Isometry3<f64>,
    seed: Seed,
    model: Arc<Model>,
    views: Vec<ViewRecord>,
    /// Why each view is discarded, while it is.
    discarded: Vec<Option<RetakeReason>>,
    waiting: VecDeque<Waiting>,
    registering: bool,
    next_job_id: u32,
    jobs: Vec<(u32, usize)>,
    outputs: VecDeque<Output>,
}

#[derive(Debug)]
struct Waiting {
    view_index: usize,
    base_from_tool: Isometry3<f64>,
    came: Stamp,
    cloud: Option<Arc<PointCloud>>,
}

impl ViewRecord {
    /// Where the view lies in the model; `None` unless merged.
    pub fn model_from_view(&self) -> Option<&Isometry3<f64>> {
        match &self.outcome {
            ViewOutcome::Merged { model_from_view } => Some(model_from_view),
            ViewOutcome::Discarded { .. } | ViewOutcome::Missing { .. } => None,
        }
    }
}

impl Backlog {
    pub(super) fn new(recipe: &Recipe, station: &Station, plan: &[PlannedView], seed: Seed) -> Self {
        let untaken = ViewRecord {
            outcome: ViewOutcome::Missing {
                reason: "not taken".into(),
            },
            attempt: 0,
            attempt_count: 0,
            not_used: Vec::new(),
            point_count: 0,
            removed: RemovedCounts::default(),
            figures: ViewFigures::default(),
            times: Vec::new(),
            latency_ms: 0,
        };
        let views = plan.iter().map(|view| {
            let mut record = untaken.clone();
            if view.skipped {
                let reason = "skipped by the recipe".into();
                record.outcome = ViewOutcome::Missing { reason };
            }
            record
        });
        Self {
            cleaning: recipe.cleaning,
            settings: view_settings(recipe),
            start: recipe.registration.start,
            coincident_distance_mm: recipe.merge.coincident_distance_mm,
            base_from_camera: station.base_from_camera,
            base_from_tool_0: plan
                .first()
                .map_or_else(Isometry3::identity, |view| view.base_from_tool),
            seed,
            model: Arc::new(Model::default()),
            views: views.collect(),
            discarded: vec![None; plan.len()],
            retakes: recipe.retakes.clone(),
            waiting: VecDeque::new(),
            registering: false,
            next_job_id: 1,
            jobs: Vec::new(),
            outputs: VecDeque::new(),
        }
    }

    /// A frame has come.
    pub(super) fn add(&mut self, now: Stamp, view: Captured) {
        let Captured {
            view_index,
            attempt,
            base_from_tool,
            capture,
        } = view;
        // What is in the model stays where it is, also when view 0 is taken again.
        if view_index == 0 && self.model.is_empty() {
            self.base_from_tool_0 = base_from_tool;
        }
        self.begin_attempt(view_index);
        self.views[view_index].attempt = attempt;
        self.waiting.push_back(Waiting {
            view_index,
            base_from_tool,
            came: now,
            cloud: None,
        });
        self.start_job(Job::Prepare {
            view_index,
            capture,
            cleaning: self.cleaning,
        });
    }

    /// No frame will come of a view.
    pub(super) fn give_up(&mut self, view_index: usize, reason: &str) {
        self.begin_attempt(view_index);
        self.views[view_index].outcome = ViewOutcome::Missing { reason: reason.into() };
    }

    /// An attempt at a view gave nothing usable; another follows.
    pub(super) fn note_failed(&mut self, view_index: usize, attempt: u16, reason: String) {
        self.begin_attempt(view_index);
        self.views[view_index].not_used.push(UnusedAttempt { attempt, reason });
    }

    /// Whether it is still open which views are to be taken again.
    pub(super) fn may_want_more(&self) -> bool {
        self.retakes.wants_any_registered() && !self.is_idle()
    }

    /// The discarded views that the recipe wants taken again, in index order. Only when all views are decided: so which are
    /// taken, and when they are merged, does not depend on how long anything took.
    pub(super) fn take_again(&mut self) -> Vec<Target> {
        let mut targets = Vec::new();
        for (view_index, view) in self.views.iter().enumerate() {
            let ViewOutcome::Discarded { reason } = &view.outcome else {
                continue;
            };
            if self.discarded[view_index].is_some_and(|why| self.retakes.wants(why, view.attempt)) {
                let attempt = view.attempt + 1;
                targets.push(Target { view_index, attempt });
                self.outputs.push_back(Output::Event(Event::ViewTakenAgain {
                    view_index,
                    attempt,
                    reason: reason.clone(),
                }));
            }
        }
        targets
    }

    /// A job has ended. Returns what a panic said.
    pub(super) fn handle_done(&mut self, now: Stamp, job_id: u32, done: FinishedJob) -> Option<String> {
        let place = self.jobs.iter().position(|(open, _)| *open == job_id)?;
        let (_, view_index) = self.jobs.remove(place);
        self.views[view_index].times.extend(done.times);
        let mut panicked = None;
        match done.output {
            JobOutput::Prepared { cloud, removed } => {
                self.views[view_index].point_count = cloud.len();
                self.views[view_index].removed = removed;
                self.outputs.push_back(Output::Event(Event::ViewPrepared {
                    view_index,
                    point_count: cloud.len(),
                    removed,
                }));
                self.outputs.push_back(Output::ViewCloud {
                    view_index,
                    cloud: cloud.clone(),
                });
                if let Some(waiting) = self.waiting.iter_mut().find(|waiting| waiting.view_index == view_index) {
                    waiting.cloud = Some(cloud);
                }
            }
            JobOutput::Registered { registration, model } => {
                self.registering = false;
                let waiting = self.waiting.pop_front().expect("the front view was being registered");
                self.views[view_index].latency_ms = now.ms_since(waiting.came);
                self.decide(view_index, &registration, model);
            }
            JobOutput::Compared { .. } => unreachable!("no job of the backlog compares"),
            JobOutput::Panicked { text } => {
                self.give_up_panicked(view_index, &text);
                panicked = Some(text);
            }
        }
        self.register_next();
        panicked
    }

    /// A number that no other job has.
    pub(super) fn take_job_id(&mut self) -> u32 {
        let job_id = self.next_job_id;
        self.next_job_id += 1;
        job_id
    }

    /// How many frames have come that are not decided yet.
    pub(super) fn waiting_count(&self) -> usize {
        self.waiting.len()
    }

    /// How many views have a frame, whatever became of it.
    pub(super) fn taken_count(&self) -> usize {
        let has_frame = |view: &&ViewRecord| view.point_count > 0;
        self.views.iter().filter(has_frame).count()
            + self.waiting.iter().filter(|waiting| waiting.cloud.is_none()).count()
    }

    /// Whether nothing is under way.
    pub(super) fn is_idle(&self) -> bool {
        self.waiting.is_empty() && self.jobs.is_empty()
    }

    /// The model so far.
    pub(super) fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// What became of each planned view.
    pub(super) fn views(&self) -> &[ViewRecord] {
        &self.views
    }

    pub(super) fn poll_output(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// A view that was discarded before is taken again: that frame is not used.
    fn begin_attempt(&mut self, view_index: usize) {
        let view = &mut self.views[view_index];
        view.attempt_count += 1;
        if self.discarded[view_index].take().is_some()
            && let ViewOutcome::Discarded { reason } = &view.outcome
        {
            view.not_used.push(UnusedAttempt {
                attempt: view.attempt,
                reason: reason.clone(),
            });
            view.point_count = 0;
            view.removed = RemovedCounts::default();
            view.figures = ViewFigures::default();
            view.outcome = ViewOutcome::Missing {
                reason: "taken again, and not registered".into(),
            };
        }
    }

    /// A job is pure, so its panic leaves nothing behind: only its own view is lost, the others are registered.
    fn give_up_panicked(&mut self, view_index: usize, text: &str) {
        if self.registering
            && self
                .waiting
                .front()
                .is_some_and(|waiting| waiting.view_index == view_index)
        {
            self.registering = false;
        }
        self.waiting.retain(|waiting| waiting.view_index != view_index);
        let reason = format!("a job panicked: {text}");
        self.views[view_index].outcome = ViewOutcome::Discarded { reason: reason.clone() };
        self.outputs.push_back(Output::Event(Event::ViewDiscarded {
            view_index,
            figures: ViewFigures::default(),
            reason,
        }));
    }

    /// Starts the registration of the front view once it is prepared: one at a time, in index order.
    fn register_next(&mut self) {
        if self.registering {
            return;
        }
        let Some(waiting) = self.waiting.front() else { return };
        let Some(cloud) = waiting.cloud.clone() else { return };
        let job = RegisterJob {
            view_index: waiting.view_index,
            cloud,
            model: self.model.clone(),
            start: self.start_of(waiting),
            settings: self.settings.clone(),
            coincident_distance_mm: self.coincident_distance_mm,
            seed: self.seed,
        };
        self.registering = true;
        self.start_job(Job::Register(Box::new(job)));
    }

    /// `model_from_view` as predicted: the model's frame is the camera frame at view 0.
    fn start_of(&self, waiting: &Waiting) -> Isometry3<f64> {
        let by_robot = camera_relative(&self.base_from_camera, &self.base_from_tool_0, &waiting.base_from_tool);
        // In index order, not in time: a view that is taken again lies where its neighbours do.
        let (before, after) = self.views.split_at(waiting.view_index);
        let previous = before.iter().rev().find_map(ViewRecord::model_from_view);
        let neighbour = previous.or_else(|| after.iter().find_map(ViewRecord::model_from_view));
        match (self.start, neighbour) {
            (Start::Previous, Some(previous)) => *previous,
            (Start::Previous | Start::Robot, _) => by_robot,
        }
    }

    fn decide(&mut self, view_index: usize, found: &ViewRegistration, model: Option<Arc<Model>>) {
        let figures = figures(found);
        let view = &mut self.views[view_index];
        view.figures = figures;
        match found.decision {
            Decision::Merge => {
                self.model = model.expect("a merged view comes with its model");
                let model_from_view = found.model_from_view;
                view.outcome = ViewOutcome::Merged { model_from_view };
                self.outputs.push_back(Output::ViewPose {
                    view_index,
                    model_from_view,
                });
                self.outputs.push_back(Output::Event(Event::ViewMerged {
                    view_index,
                    figures,
                    model_point_count: self.model.len(),
                }));
            }
            Decision::Discard(reason) => {
                self.discarded[view_index] = Some(retake_reason(reason));
                let reason = discard_words(reason, &self.settings);
                view.outcome = ViewOutcome::Discarded { reason: reason.clone() };
                self.outputs.push_back(Output::Event(Event::ViewDiscarded {
                    view_index,
                    figures,
                    reason,
                }));
            }
        }
    }

    fn start_job(&mut self, job: Job) {
        let job_id = self.take_job_id();
        self.jobs.push((job_id, job.view_index()));
        self.outputs.push_back(Output::Job {
            job_id,
            job: Arc::new(job),
        });
    }
}

fn figures(found: &ViewRegistration) -> ViewFigures {
    let registration = found.registration.as_ref();
    ViewFigures {
        overlap_count: registration.map(|registration| registration.overlap.count),
        overlap_fraction: registration.map(|registration| registration.overlap.fraction),
        rmse_mm: registration.map(|registration| registration.rmse),
        from_prior_deg: found.prior_rotation_rad.to_degrees(),
        from_prior_mm: found.prior_distance,
        weak_direction_count: registration.map_or(0, |registration| registration.weak_directions.len()),
    }
}

fn retake_reason(reason: DiscardReason) -> RetakeReason {
    match reason {
        DiscardReason::TooFewPoints { .. } | DiscardReason::Failed | DiscardReason::Ambiguous { .. } => {
            RetakeReason::Ambiguous
        }
        DiscardReason::TooLittleOverlap { .. } => RetakeReason::LittleOverlap,
        DiscardReason::FarFromPrior { .. } => RetakeReason::Disagrees,
    }
}

/// Why a view was discarded, with what was required.
fn discard_words(reason: DiscardReason, settings: &ViewSettings) -> String {
    match (reason, settings.overlap_min, settings.prior_limits) {
        (DiscardReason::TooLittleOverlap { fraction, .. }, OverlapMin::Fraction(least), _) => {
            format!("overlap {fraction:.3}, at least {least:.3} wanted")
        }
        (DiscardReason::TooLittleOverlap { count, .. }, OverlapMin::Count(least), _) => {
            format!("{count} overlapping points, at least {least} wanted")
        }
        (DiscardReason::FarFromPrior { rotation_rad, distance }, _, Some(limits)) => format!(
            "{:.3}° and {distance:.3} mm from the robot's pose, at most {:.3}° and {:.3} mm wanted",
            rotation_rad.to_degrees(),
            limits.rotation_max_rad.to_degrees(),
            limits.translation_max_distance
        ),
        (reason, _, _) => reason.to_string(),
    }
}

pub(super) fn view_settings(recipe: &Recipe) -> ViewSettings {
    let wanted = &recipe.registration;
    let by_robot = wanted.start == Start::Robot;
    ViewSettings {
        registration: registration::Settings {
            sample_count: wanted.sample_count,
            overlap_distance: Some(wanted.overlap_distance_mm),
            search: if by_robot {
                Search::NearPart { reach_factor: 0.2 }
            } else {
                Search::Near
            },
            // The decision to merge judges the recipe's own minimum, and says what it found.
            overlap_min_fraction: 0.0,
            ..registration::Settings::default()
        },
        overlap_min: recipe.merge.overlap_min,
        prior_limits: by_robot.then_some(PriorLimits {
            rotation_max_rad: wanted.prior_rotation_max_rad,
            translation_max_distance: wanted.prior_translation_max_mm,
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_recipe_alone_says_how_much_overlap_is_enough() {
        let text = "name = \"probe\"\nblade.cad = \"builtin:lpt\"\nmerge.overlap_min_fraction = 0.03\n\
                    presentation = { position_mm = [10, -5, 600], rotation_deg = [0, 90, 0] }\n[views]\n";
        let settings = view_settings(&Recipe::parse("probe.toml", text).unwrap());
        assert_eq!(settings.overlap_min, OverlapMin::Fraction(0.03));
        assert_eq!(settings.registration.overlap_min_fraction, 0.0);
    }
}
