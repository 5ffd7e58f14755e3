//! Jobs: the numeric work of a run, as pure functions of their input. The pool runs them; replay runs them again.

use crate::camera::Capture;
use crate::cleaning;
use crate::event::RemovedCounts;
use crate::geometry::{PointCloud, matrix_rows};
use crate::reconstruction::{Decision, Model, ViewRegistration, ViewSettings, register_view};
use crate::registration::{Search, Stage};
use crate::seed::{Seed, Stream};
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};
use std::sync::Arc;

/// Something to compute.
#[derive(Debug, Clone)]
pub enum Job {
    /// A frame becomes a clean cloud with normals.
    Prepare {
        /// Which view.
        view_index: usize,
        /// The frame.
        capture: Arc<Capture>,
        /// What is taken for a wrong point.
        cleaning: cleaning::Settings,
    },
    /// A view is registered to the model and merged if it may be.
    Register(Box<RegisterJob>),
    /// A view is compared with itself, taken again.
    Compare(Box<CompareJob>),
}

/// The input of [`Job::Register`].
#[derive(Debug, Clone)]
pub struct RegisterJob {
    /// Which view.
    pub view_index: usize,
    /// Its cloud, camera frame, mm, with normals.
    pub cloud: Arc<PointCloud>,
    /// The model so far.
    pub model: Arc<Model>,
    /// `model_from_view` as predicted.
    pub start: Isometry3<f64>,
    /// How to register and when to merge.
    pub settings: ViewSettings,
    /// Points nearer than this become one, mm.
    pub coincident_distance_mm: f64,
    /// The run's seed.
    pub seed: Seed,
}

/// The input of [`Job::Compare`].
#[derive(Debug, Clone)]
pub struct CompareJob {
    /// Which view.
    pub view_index: usize,
    /// Its cloud as it was, camera frame, mm, with normals.
    pub before: Arc<PointCloud>,
    /// Its cloud as it is now.
    pub now: Arc<PointCloud>,
    /// `before_from_now` by the robot's poses.
    pub start: Isometry3<f64>,
    /// How to register, and how far from the start is too far.
    pub settings: ViewSettings,
    /// The run's seed.
    pub seed: Seed,
}

/// What came of a job.
#[derive(Debug, Clone)]
pub enum JobOutput {
    /// Of [`Job::Prepare`].
    Prepared {
        /// The cloud, camera frame, mm, with normals.
        cloud: Arc<PointCloud>,
        /// What was taken out.
        removed: RemovedCounts,
    },
    /// Of [`Job::Register`].
    Registered {
        /// The registration and the decision.
        registration: Box<ViewRegistration>,
        /// The model with the view in it, if it was merged.
        model: Option<Arc<Model>>,
    },
    /// Of [`Job::Compare`].
    Compared {
        /// Where the view of now lies in that of before; the decision to merge means that it has not moved.
        registration: Box<ViewRegistration>,
    },
    /// A bug of ours.
    Panicked {
        /// What the panic said.
        text: String,
    },
}

/// How long a stage of a job took. Measured by whoever ran the job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StageTime {
    /// Which stage.
    pub name: String,
    /// How long.
    pub ns: u64,
}

/// A job that has ended, as whoever ran it hands it back.
#[derive(Debug, Clone)]
pub struct FinishedJob {
    /// What came of it.
    pub output: JobOutput,
    /// [`JobOutput::digest`] of that.
    pub digest: String,
    /// How long its stages took.
    pub times: Vec<StageTime>,
}

impl Job {
    /// What it does, for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Prepare { .. } => "prepare",
            Self::Register(_) => "register",
            Self::Compare(_) => "compare",
        }
    }

    /// Which view it is about.
    pub fn view_index(&self) -> usize {
        match self {
            Self::Prepare { view_index, .. } => *view_index,
            Self::Register(job) => job.view_index,
            Self::Compare(job) => job.view_index,
        }
    }

    /// Does it. `on_stage` is called with the stage's name when one ends, so that the caller can take the time.
    pub fn run(&self, on_stage: &mut dyn FnMut(&str)) -> JobOutput {
        match self {
            Self::Prepare { capture, cleaning, .. } => {
                let grid = capture.grid();
                on_stage("decode");
                let (cloud, removed) = cleaning::clean(grid, cleaning);
                on_stage("clean");
                JobOutput::Prepared {
                    cloud: Arc::new(cloud),
                    removed,
                }
            }
            Self::Register(job) => job.run(on_stage),
            Self::Compare(job) => job.run(on_stage),
        }
    }
}

impl RegisterJob {
    fn run(&self, on_stage: &mut dyn FnMut(&str)) -> JobOutput {
        let stream = self.seed.stream(Stream::Sampling {
            view_index: self.view_index as u32,
        });
        let registration = register_view(
            &self.cloud,
            &self.model,
            &self.start,
            &self.settings,
            stream,
            &mut |stage: &Stage| on_stage(stage.name),
        );
        let model = (registration.decision == Decision::Merge).then(|| {
            let model_from_view = &registration.model_from_view;
            let model = self
                .model
                .merged_with(&self.cloud, model_from_view, self.coincident_distance_mm);
            Arc::new(model)
        });
        on_stage("merge");
        JobOutput::Registered {
            registration: Box::new(registration),
            model,
        }
    }
}

impl CompareJob {
    /// First what the fine stage makes of the robot's word: a view that lies where it lay has no rivals elsewhere. Where it
    /// does not lie there, the search says where it is.
    fn run(&self, on_stage: &mut dyn FnMut(&str)) -> JobOutput {
        let before = Model::default().merged_with(&self.before, &Isometry3::identity(), 0.0);
        let mut registered = |search: Search| {
            let mut settings = self.settings.clone();
            settings.registration.search = search;
            let stream = self.seed.stream(Stream::Sampling {
                view_index: self.view_index as u32,
            });
            let on_stage = &mut |stage: &Stage| on_stage(stage.name);
            register_view(&self.now, &before, &self.start, &settings, stream, on_stage)
        };
        let registration = match registered(Search::StartOnly) {
            unmoved if unmoved.decision == Decision::Merge => unmoved,
            _ => registered(self.settings.registration.search),
        };
        JobOutput::Compared {
            registration: Box::new(registration),
        }
    }
}

impl JobOutput {
    /// A fingerprint of every bit that follows from the job, for the journal. Reads all of a model: not for the loop
    /// that talks to the devices.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        match self {
            Self::Prepared { cloud, removed } => {
                hash.update(b"prepared");
                for (_, count) in removed.by_reason() {
                    hash.update((count as u64).to_le_bytes());
                }
                update_numbers(&mut hash, cloud.points().iter().flat_map(|point| point.coords.iter()));
                update_numbers(&mut hash, cloud.normals().unwrap_or_default().iter().flatten());
            }
            Self::Registered { registration, model } => {
                hash.update(b"registered");
                update_registration(&mut hash, registration);
                for point in model.iter().flat_map(|model| model.points()) {
                    update_numbers(&mut hash, point.position.coords.iter().chain(&point.normal));
                    hash.update(point.weight.to_le_bytes());
                }
            }
            Self::Compared { registration } => {
                hash.update(b"compared");
                update_registration(&mut hash, registration);
            }
            Self::Panicked { text } => {
                hash.update(b"panicked");
                hash.update(text);
            }
        }
        hex(&hash.finalize())
    }
}

fn update_registration(hash: &mut Sha256, registration: &ViewRegistration) {
    hash.update(format!("{:?}", registration.decision));
    update_numbers(hash, matrix_rows(&registration.model_from_view).as_flattened());
    if let Some(found) = &registration.registration {
        update_numbers(hash, [&found.rmse]);
        hash.update((found.overlap.count as u64).to_le_bytes());
        update_numbers(hash, found.covariance.iter().flatten());
    }
}

/// Hashes the bits of numbers, a few hundred at a time.
fn update_numbers<'a>(hash: &mut Sha256, numbers: impl IntoIterator<Item = &'a f64>) {
    let mut bytes = Vec::with_capacity(NUMBER_BYTES_MAX);
    for number in numbers {
        bytes.extend_from_slice(&number.to_bits().to_le_bytes());
        if bytes.len() == NUMBER_BYTES_MAX {
            hash.update(&bytes);
            bytes.clear();
        }
    }
    hash.update(&bytes);
}

/// Bytes as lower-case hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The SHA-256 of some bytes, in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

const NUMBER_BYTES_MAX: usize = 4096;
