//! What both kinds of runs share: the controller, its jobs, and what is seen of it.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex};

use bladescan::controller::{Controller, Header, Input, Output};
use bladescan::event::{Ending, Event};
use bladescan::job::{FinishedJob, Job, JobOutput};
use bladescan::plan::Plan;
use bladescan::reconstruction::{Decision, ViewRegistration};
use bladescan::seed::Seed;
use bladescan::settings::{Recipe, Station};
use hw_sim::camera::render::{Frame, Renderer};
use hw_sim::camera::trouble::CameraFault;
use hw_sim::cell::RenderJob;
use hw_sim::scene::Scene;

use super::judge::Judge;
use super::setup::{Setup, VIEW_COUNT};

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Ended {
    Finished,
    Fault(&'static str),
    Hung,
}

/// What is seen of a run.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) ended: Ended,
    pub(crate) end_ns: u64,
    /// Connections to the camera.
    pub(crate) connect_count: u64,
    /// Triggers of a second or later attempt.
    pub(crate) retake_count: u64,
    pub(crate) fetch_count: u64,
    /// Views without a frame.
    pub(crate) missing_count: u64,
    /// Faults of triggers that happened; where that is not known, all that were drawn.
    pub(crate) met: Vec<CameraFault>,
    pub(crate) met_is_known: bool,
    pub(crate) judge: Judge,
    pub(crate) violations: Vec<String>,
    pub(crate) events: Vec<(u64, Event)>,
}

/// Renders each acquisition once, however many runs see it.
#[derive(Debug)]
pub(crate) struct Darkroom {
    renderer: Renderer,
    frames: Mutex<BTreeMap<u64, (RenderJob, Arc<Frame>)>>,
}

impl Darkroom {
    pub(crate) fn new(renderer: Renderer) -> Self {
        Self {
            renderer,
            frames: Mutex::default(),
        }
    }

    pub(crate) fn frame(&self, job: &RenderJob) -> Frame {
        if let Some(known) = self.known(job) {
            return known;
        }
        let frame = job.run(&self.renderer);
        if let Ok(mut frames) = self.frames.lock() {
            frames.insert(job.draws.trigger_id, (*job, Arc::new(frame.clone())));
        }
        frame
    }

    /// The same, but what is rendered is not remembered.
    pub(crate) fn known_or_new(&self, job: &RenderJob) -> Frame {
        self.known(job).unwrap_or_else(|| job.run(&self.renderer))
    }

    fn known(&self, job: &RenderJob) -> Option<Frame> {
        let frames = self.frames.lock().ok()?;
        let (before, frame) = frames.get(&job.draws.trigger_id)?;
        let is_known = RenderJob {
            job: job.job,
            ..*before
        } == *job;
        is_known.then(|| (**frame).clone())
    }
}

/// Controller of a small run of this setup.
pub(crate) fn controller(setup: &Setup) -> Result<Controller, String> {
    let recipe = Recipe::parse("camera-faults.toml", RECIPE).map_err(|error| error.to_string())?;
    let station = Station::builtin_simulated();
    let views = NonZeroUsize::new(VIEW_COUNT).ok_or("no views")?;
    let plan = Plan::new(&recipe, &station, Seed(setup.seed)).map_err(|error| error.to_string())?;
    Ok(Controller::new(header(setup), &recipe, &station, plan.truncated(views)))
}

/// What names that run.
pub(crate) fn header(setup: &Setup) -> Header {
    Header {
        seed: Seed(setup.seed),
        run_id: setup.seed.max(1),
        recipe: "camera-faults".into(),
        station: Station::builtin_simulated().name,
        view_count: Some(VIEW_COUNT),
        ..Header::default()
    }
}

/// The scene of every run: frames depend on their trigger alone.
pub(crate) fn scene(setup: &Setup, speed: f64) -> Scene {
    let station = Station::builtin_simulated();
    Scene {
        seed: 1,
        speed,
        base_from_camera: station.base_from_camera,
        tool_from_blade: station.tool_from_blade,
        faults: setup.faults.clone(),
        ..Scene::default()
    }
}

/// Does a job as far as it matters here: a frame is prepared, its registration is taken as found.
pub(crate) fn finish_job(job_id: u32, job: &Job) -> Input {
    let output = match job {
        Job::Prepare { .. } | Job::Compare(_) => job.run(&mut |_| ()),
        Job::Register(job) => JobOutput::Registered {
            registration: Box::new(ViewRegistration {
                registration: None,
                model_from_view: job.start,
                prior_rotation_rad: 0.0,
                prior_distance: 0.0,
                decision: Decision::Merge,
            }),
            model: Some(Arc::clone(&job.model)),
        },
    };
    let done = FinishedJob {
        output,
        digest: String::new(),
        times: Vec::new(),
    };
    Input::JobDone { job_id, done }
}

/// Faults of triggers that a run met.
#[derive(Debug)]
pub(crate) enum Met {
    /// These happened.
    Happened(Vec<CameraFault>),
    /// These may have happened.
    Drawn(Vec<CameraFault>),
}

/// Counts what leaves the controller.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    pub(crate) judge: Judge,
    pub(crate) connect_count: u64,
    pub(crate) fetch_count: u64,
    pub(crate) events: Vec<(u64, Event)>,
}

impl Watch {
    /// Sees an output before it is carried out.
    pub(crate) fn see(&mut self, now_ns: u64, output: &Output) {
        match output {
            Output::Camera(bladescan::camera::CameraOutput::Connect) => self.connect_count += 1,
            Output::Camera(bladescan::camera::CameraOutput::Bytes { bytes, .. }) => {
                self.fetch_count += u64::from(bytes.get(6..8) == Some(&KIND_FETCH));
            }
            Output::Job { job, .. } => {
                if let Job::Prepare {
                    view_index, capture, ..
                } = &**job
                {
                    self.judge.handle_accepted(*view_index, capture);
                }
            }
            Output::Event(event) => self.events.push((now_ns, event.clone())),
            _ => (),
        }
    }

    /// What came of the run.
    pub(crate) fn outcome(self, ending: Option<&Ending>, end_ns: u64, met: Met, violations: Vec<String>) -> Outcome {
        let count =
            |is_counted: fn(&Event) -> bool| self.events.iter().filter(|(_, event)| is_counted(event)).count() as u64;
        Outcome {
            ended: match ending {
                Some(Ending::Finished) => Ended::Finished,
                Some(Ending::Faulted { fault }) => Ended::Fault(fault.code.name()),
                Some(Ending::Aborted) => Ended::Fault("aborted"),
                None => Ended::Hung,
            },
            end_ns,
            connect_count: self.connect_count,
            fetch_count: self.fetch_count,
            retake_count: count(|event| matches!(event, Event::Triggered { attempt: 1.., .. })),
            missing_count: count(|event| matches!(event, Event::ViewMissing { .. })),
            met_is_known: matches!(met, Met::Happened(_)),
            met: match met {
                Met::Happened(faults) | Met::Drawn(faults) => faults,
            },
            violations,
            judge: self.judge,
            events: self.events,
        }
    }
}

impl Outcome {
    /// Everything that was told, and when: the same for every run of the same setup.
    pub(crate) fn told(&self) -> String {
        format!("{:?} {} {:?}", self.ended, self.end_ns, self.events)
    }

    /// Everything that must not be.
    pub(crate) fn wrongs(&self) -> Vec<String> {
        let mut wrongs = self.judge.faults();
        if self.ended == Ended::Hung {
            wrongs.push("hung".to_owned());
        }
        wrongs.extend(self.violations.iter().map(|text| format!("violation: {text}")));
        wrongs
    }
}

/// The recipe of every run.
pub(crate) const RECIPE: &str = r#"
name = "camera-faults"
[blade]
cad = "builtin:hpt-a"
[views]
step_deg = 10.0
[presentation]
position_mm = [0.0, 0.0, 280.0]
rotation_deg = [0.0, 90.0, 0.0]
[camera]
optics = "fine"
roi_px = [80, 60, 680, 512]
points_min = 100
[merge]
overlap_min_fraction = 0.3
[run]
retakes_max = 3
"#;
const KIND_FETCH: [u8; 2] = [0x33, 0];
