//! After a restart: the last view, taken again, against itself. Has the blade moved in its grip?

use super::Output;
use super::backlog::view_settings;
use crate::cleaning;
use crate::event::Event;
use crate::fault::{Fault, FaultCode};
use crate::geometry::PointCloud;
use crate::job::{CompareJob, FinishedJob, Job, JobOutput};
use crate::plan::camera_relative;
use crate::reconstruction::{Decision, OverlapMin, PriorLimits, ViewRegistration, ViewSettings};
use crate::registration::{self, StartSigma, WeakDirections};
use crate::seed::Seed;
use crate::session::Captured;
use crate::settings::{Recipe, Station};
use nalgebra::Isometry3;
use std::sync::Arc;

/// The last view, and how far its comparison has come.
#[derive(Debug)]
pub(super) struct GripCheck {
    cleaning: cleaning::Settings,
    settings: ViewSettings,
    base_from_camera: Isometry3<f64>,
    seed: Seed,
    /// The last view that was taken.
    last: Option<Taken>,
    open: Option<Open>,
    job_id: Option<u32>,
}

/// A view with its cloud, once that is prepared.
#[derive(Debug, Clone)]
struct Taken {
    view_index: usize,
    base_from_tool: Isometry3<f64>,
    cloud: Option<Arc<PointCloud>>,
}

/// The view as it was and as it is.
#[derive(Debug)]
struct Open {
    before: Taken,
    now: Option<Taken>,
}

/// What came of a check.
#[derive(Debug)]
pub(super) enum Verdict {
    /// The blade sits where it sat, as far as this goes.
    Passed(Event),
    /// It does not.
    Moved(Event, Fault),
    /// A bug of ours.
    Panicked(String),
}

impl GripCheck {
    pub(super) fn new(recipe: &Recipe, station: &Station, seed: Seed) -> Self {
        let limits = recipe.check;
        let by_view = view_settings(recipe);
        // What the surface leaves open is no sign of a move: there the frames' own answer counts for less than that the
        // blade sits within the limits.
        let within_limits = StartSigma {
            turn_rad: limits.rotation_max_rad,
            shift: limits.translation_max_mm,
        };
        Self {
            cleaning: recipe.cleaning,
            settings: ViewSettings {
                registration: registration::Settings {
                    weak_directions: WeakDirections::Weigh(within_limits),
                    ..by_view.registration
                },
                overlap_min: OverlapMin::Fraction(OVERLAP_MIN_FRACTION),
                prior_limits: Some(PriorLimits {
                    rotation_max_rad: limits.rotation_max_rad,
                    translation_max_distance: limits.translation_max_mm,
                }),
            },
            base_from_camera: station.base_from_camera,
            seed,
            last: None,
            open: None,
            job_id: None,
        }
    }

    /// A view was taken; its cloud follows.
    pub(super) fn remember(&mut self, view: &Captured) {
        self.last = Some(Taken::of(view));
    }

    /// The cloud of a view is prepared.
    pub(super) fn remember_cloud(&mut self, view_index: usize, cloud: &Arc<PointCloud>) {
        let before = self.open.as_mut().map(|open| &mut open.before);
        for taken in self.last.as_mut().into_iter().chain(before) {
            if taken.view_index == view_index {
                taken.cloud = Some(Arc::clone(cloud));
            }
        }
    }

    /// Another process goes on: which view is taken again; `None` when there is none yet.
    pub(super) fn restart(&mut self) -> Option<usize> {
        self.job_id = None;
        self.open = self.last.clone().map(|before| Open { before, now: None });
        self.last.as_ref().map(|last| last.view_index)
    }

    /// The view was taken again: the job that prepares its frame.
    pub(super) fn begin(&mut self, job_id: u32, view: &Captured) -> Output {
        if let Some(open) = &mut self.open {
            open.now = Some(Taken::of(view));
        }
        self.start(
            job_id,
            Job::Prepare {
                view_index: view.view_index,
                capture: view.capture.clone(),
                cleaning: self.cleaning,
            },
        )
    }

    /// Whether this job is one of a check.
    pub(super) fn owns(&self, job_id: u32) -> bool {
        self.job_id == Some(job_id)
    }

    /// A job of the check has ended. Gives a verdict, or `None` if there is more to do.
    pub(super) fn handle_done(&mut self, done: FinishedJob) -> Option<Verdict> {
        self.job_id = None;
        match done.output {
            JobOutput::Prepared { cloud, .. } => {
                let now = self.open.as_mut().and_then(|open| open.now.as_mut());
                now?.cloud = Some(cloud);
                None
            }
            JobOutput::Compared { registration } => {
                let view_index = self.open.take()?.before.view_index;
                Some(judge(view_index, &registration))
            }
            JobOutput::Panicked { text } => Some(Verdict::Panicked(text)),
            JobOutput::Registered { .. } => None,
        }
    }

    /// The comparison, once both clouds are there; `next_job_id` is taken only then.
    pub(super) fn compare(&mut self, next_job_id: impl FnOnce() -> u32) -> Option<Output> {
        if self.job_id.is_some() {
            return None;
        }
        let Open { before, now } = self.open.as_ref()?;
        let now = now.as_ref()?;
        let job = CompareJob {
            view_index: before.view_index,
            before: before.cloud.clone()?,
            now: now.cloud.clone()?,
            start: camera_relative(&self.base_from_camera, &before.base_from_tool, &now.base_from_tool),
            settings: self.settings.clone(),
            seed: self.seed,
        };
        Some(self.start(next_job_id(), Job::Compare(Box::new(job))))
    }

    /// Whether the view of before has no cloud, and the check waits for nothing else.
    pub(super) fn is_without_before(&self) -> bool {
        self.job_id.is_none()
            && self.open.as_ref().is_some_and(|open| {
                let now_is_there = open.now.as_ref().is_some_and(|now| now.cloud.is_some());
                now_is_there && open.before.cloud.is_none()
            })
    }

    /// There will be no verdict.
    pub(super) fn give_up(&mut self) {
        self.open = None;
    }

    fn start(&mut self, job_id: u32, job: Job) -> Output {
        self.job_id = Some(job_id);
        Output::Job {
            job_id,
            job: Arc::new(job),
        }
    }
}

impl Taken {
    fn of(view: &Captured) -> Self {
        Self {
            view_index: view.view_index,
            base_from_tool: view.base_from_tool,
            cloud: None,
        }
    }
}

fn judge(view_index: usize, found: &ViewRegistration) -> Verdict {
    let (rotation_deg, distance_mm) = (found.prior_rotation_rad.to_degrees(), found.prior_distance);
    let moved = found.decision != Decision::Merge;
    let event = Event::GripChecked {
        view_index,
        rotation_deg,
        distance_mm,
        moved,
    };
    match found.decision {
        Decision::Merge => Verdict::Passed(event),
        Decision::Discard(reason) => {
            let seen = format!(
                "view {view_index}, taken again, does not lie where it lay: {rotation_deg:.3}° and {distance_mm:.3} mm away ({reason})"
            );
            Verdict::Moved(event, Fault::new(FaultCode::BladeMoved, seen))
        }
    }
}

/// Two frames of one view show nearly the same surface.
const OVERLAP_MIN_FRACTION: f64 = 0.5;
