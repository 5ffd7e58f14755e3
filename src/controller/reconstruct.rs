//! The views of a recorded run registered anew, under another recipe and without devices.

use super::Output;
use super::backlog::{Backlog, ViewRecord};
use super::files::Decided;
use super::header::Header;
use super::provenance::{Provenance, Source};
use crate::event::{CHECK_ATTEMPT_FIRST, Ending, Event};
use crate::fault::{Fault, FaultCode};
use crate::job::{FinishedJob, Job};
use crate::plan::Plan;
use crate::session::Captured;
use crate::settings::{Recipe, Station};
use crate::stamp::Stamp;
use nalgebra::Isometry3;

/// Follows a recorded run: each frame that went to its reconstruction goes to this one, with the pose at which it was
/// taken.
#[derive(Debug)]
pub struct Reconstruction {
    provenance: Provenance,
    backlog: Backlog,
    merged_min_count: usize,
    /// The frame that has come last: view, attempt, and where the arm stood.
    arrived: Option<(usize, u16, Isometry3<f64>)>,
    ending: Ending,
}

/// What a reconstruction has from outside.
pub struct Outside<'a> {
    /// Runs a job.
    pub run: &'a mut dyn FnMut(&Job) -> FinishedJob,
    /// The time since it began.
    pub now: &'a mut dyn FnMut() -> Stamp,
    /// Sees what happens.
    pub on_event: &'a mut dyn FnMut(&Event),
}

/// What came of a reconstruction.
#[derive(Debug)]
pub struct Reconstructed {
    /// By a fault if a job panicked.
    pub ending: Ending,
    /// What became of each planned view.
    pub views: Vec<ViewRecord>,
    /// How many views must be merged for it to count as done.
    pub merged_min_count: usize,
    /// Its files, in the order in which they are written.
    pub files: Vec<(&'static str, Vec<u8>)>,
}

impl Reconstruction {
    /// One that has no view yet. `plan` is that of the recorded run.
    pub fn new(header: Header, source: Source, recipe: &Recipe, station: &Station, plan: &Plan) -> Self {
        Self {
            backlog: Backlog::new(recipe, station, plan.views(), header.seed),
            provenance: Provenance::reconstructed_from(header, station, source),
            merged_min_count: (recipe.views.merged_min_count as usize).min(plan.views().len()),
            arrived: None,
            ending: Ending::Finished,
        }
    }

    /// The recorded run has put this out.
    pub fn handle_output(&mut self, output: &Output, outside: &mut Outside<'_>) {
        match output {
            Output::Event(event) => self.handle_event(event, outside),
            Output::Job { job, .. } => self.handle_job(job, outside),
            _ => {}
        }
    }

    /// Nothing more comes.
    pub fn finish(self, now: Stamp) -> Reconstructed {
        let decided = Decided {
            provenance: &self.provenance,
            backlog: &self.backlog,
            ending: &self.ending,
            merged_min_count: self.merged_min_count,
        };
        Reconstructed {
            files: decided.files(now),
            views: self.backlog.views().to_vec(),
            merged_min_count: self.merged_min_count,
            ending: self.ending,
        }
    }

    fn handle_event(&mut self, event: &Event, outside: &mut Outside<'_>) {
        self.provenance.note(event);
        match event {
            Event::FrameArrived {
                view_index,
                attempt,
                base_from_tool,
                ..
            } => self.arrived = Some((*view_index, *attempt, *base_from_tool)),
            Event::ViewMissing { view_index, reason } => {
                self.backlog.give_up(*view_index, reason);
                (outside.on_event)(event);
            }
            _ => {}
        }
    }

    /// A frame is prepared: that of the run's own reconstruction. A second look at a view after a restart joins no model.
    fn handle_job(&mut self, job: &Job, outside: &mut Outside<'_>) {
        let Job::Prepare {
            view_index, capture, ..
        } = job
        else {
            return;
        };
        let view = (*view_index, capture.trigger_id.attempt());
        let Some((_, attempt, base_from_tool)) = self.arrived.filter(|(index, attempt, _)| (*index, *attempt) == view)
        else {
            return;
        };
        if attempt >= CHECK_ATTEMPT_FIRST || self.ending != Ending::Finished {
            return;
        }
        let view = Captured {
            view_index: *view_index,
            attempt,
            base_from_tool,
            capture: capture.clone(),
        };
        self.backlog.add((outside.now)(), view);
        self.work(outside);
    }

    /// Runs jobs until there are none.
    fn work(&mut self, outside: &mut Outside<'_>) {
        while let Some(output) = self.backlog.poll_output() {
            match output {
                Output::Job { job_id, job } => {
                    let done = (outside.run)(&job);
                    if let Some(text) = self.backlog.handle_done((outside.now)(), job_id, done) {
                        let fault = Fault::new(FaultCode::JobPanicked, text);
                        (outside.on_event)(&Event::Faulted { fault: fault.clone() });
                        self.ending = Ending::Faulted { fault };
                    }
                }
                Output::Event(event) => (outside.on_event)(&event),
                _ => {}
            }
        }
    }
}
