//! What all runs share: the recipe, rendered frames, and what unbroken runs give.

use std::collections::BTreeMap;
use std::error::Error;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use bladescan::camera::CapturedPoints;
use bladescan::controller::{Controller, Header};
use bladescan::geometry::PointCloud;
use bladescan::job::{FinishedJob, Job, sha256};
use bladescan::journal::Writer;
use bladescan::plan::Plan;
use bladescan::run::{JournalFile, Pool};
use bladescan::seed::Seed;
use bladescan::settings::{Recipe, Station};
use hw_sim::blade::Builtin;
use hw_sim::camera::render::{Frame, Renderer, Surface};
use hw_sim::cell::RenderJob;
use hw_sim::fault::Fault;
use hw_sim::scene::Scene;

use super::disk::{Disk, DiskJournal, RunJournal};
use super::draw::{Setup, UNBROKEN_SEED, VIEW_COUNT_MAX};
use super::world;
use crate::camera_faults::run::Darkroom;

/// The results of a run that are compared.
pub(super) type Files = BTreeMap<&'static str, Vec<u8>>;

pub(super) struct Studio {
    darkroom: Darkroom,
    recipe: Recipe,
    station: Station,
    /// By the attempts whose frames are used.
    unbroken: Mutex<BTreeMap<Vec<u16>, Arc<Files>>>,
    clean_ns: Vec<u64>,
    /// Jobs by the hash of what goes in. Only the run itself is spared them: whoever goes through its recording does them all.
    finished: Mutex<BTreeMap<String, FinishedJob>>,
    /// Nothing more is remembered.
    is_complete: AtomicBool,
}

impl Studio {
    pub(super) fn new(pool: &Pool) -> Result<Self, Box<dyn Error>> {
        let renderer = Renderer::new(&Builtin::HptA.mesh(), Surface::matte())?;
        let mut studio = Self {
            darkroom: Darkroom::new(renderer),
            recipe: Recipe::parse("chaos.toml", RECIPE)?,
            station: Station::builtin_simulated(),
            unbroken: Mutex::default(),
            clean_ns: Vec::new(),
            finished: Mutex::default(),
            is_complete: AtomicBool::new(false),
        };
        for view_count in 0..=VIEW_COUNT_MAX {
            let took_ns = match view_count {
                0 => 0,
                _ => world::drive(&unbroken_setup(&vec![0; view_count]), &studio, pool, None)?.end_ns,
            };
            studio.clean_ns.push(took_ns);
        }
        Ok(studio)
    }

    /// How long a run takes in which nothing happens.
    pub(super) fn clean_ns(&self, view_count: usize) -> u64 {
        self.clean_ns[view_count]
    }

    pub(super) fn controller(&self, setup: &Setup) -> Result<Controller, String> {
        let views = NonZeroUsize::new(setup.view_count).ok_or("no views")?;
        let plan = Plan::new(&self.recipe, &self.station, SEED).map_err(|error| error.to_string())?;
        Ok(Controller::new(
            self.header(setup),
            &self.recipe,
            &self.station,
            plan.truncated(views),
        ))
    }

    /// A new recording of this run, on a disk of its own or in a folder.
    pub(super) fn journal(&self, setup: &Setup, folder: Option<&Path>) -> Result<(RunJournal, Disk), String> {
        let disk = Disk::default();
        let (header, station_text) = (self.header(setup), Station::BUILTIN_SIMULATED_TEXT);
        let journal = match folder {
            None => {
                let writer = Writer::begin(disk.clone(), &header, START_UNIX_NS, RECIPE, station_text);
                let writer = writer.map_err(|error| error.to_string())?;
                RunJournal::Model(Box::new(DiskJournal::new(writer, disk.clone(), 0)))
            }
            Some(folder) => {
                let journal = JournalFile::create(folder, &header, START_UNIX_NS, RECIPE, station_text);
                RunJournal::File(journal.map_err(|error| error.to_string())?)
            }
        };
        Ok((journal, disk))
    }

    pub(super) fn scene(&self, faults: Vec<Fault>, boot_id: u64) -> Scene {
        Scene {
            seed: SEED.0,
            boot_id,
            base_from_camera: self.station.base_from_camera,
            tool_from_blade: self.station.tool_from_blade,
            faults,
            ..Scene::default()
        }
    }

    /// The results of a run that uses the frames of these attempts and that nothing interrupts.
    pub(super) fn unbroken(&self, attempts: &[u16], pool: &Pool) -> Result<Arc<Files>, String> {
        let known = self.unbroken.lock().map_err(|error| error.to_string())?;
        if let Some(files) = known.get(attempts) {
            return Ok(Arc::clone(files));
        }
        drop(known);
        let outcome = world::drive(&unbroken_setup(attempts), self, pool, None)?;
        let files = Arc::new(outcome.files);
        if !self.is_complete.load(Ordering::Relaxed) {
            let mut known = self.unbroken.lock().map_err(|error| error.to_string())?;
            known.insert(attempts.to_vec(), Arc::clone(&files));
        }
        Ok(files)
    }

    /// From now on nothing more is remembered, so that memory grows by nothing of ours.
    pub(super) fn complete(&self) {
        self.is_complete.store(true, Ordering::Relaxed);
    }

    /// What the camera sees.
    pub(super) fn frame(&self, job: &RenderJob) -> Frame {
        match self.is_complete.load(Ordering::Relaxed) {
            true => self.darkroom.known_or_new(job),
            false => self.darkroom.frame(job),
        }
    }

    /// What comes of a job, which is a pure function: one that has been done before is not done again.
    pub(super) fn finished(&self, job: &Job, pool: &Pool) -> FinishedJob {
        let key = key(job);
        let known = self.finished.lock().ok().and_then(|known| known.get(&key).cloned());
        known.unwrap_or_else(|| {
            let done = FinishedJob {
                times: Vec::new(),
                ..pool.run(job)
            };
            if let Ok(mut known) = self.finished.lock()
                && known.len() < FINISHED_COUNT_MAX
                && !self.is_complete.load(Ordering::Relaxed)
            {
                known.insert(key, done.clone());
            }
            done
        })
    }

    fn header(&self, setup: &Setup) -> Header {
        Header {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            seed: SEED,
            run_id: setup.seed.max(1),
            recipe: self.recipe.name.clone(),
            station: self.station.name.clone(),
            view_count: Some(setup.view_count),
            simulated: true,
            ..Header::default()
        }
    }
}

/// All that goes into a job but the settings, which are the same in every run.
fn key(job: &Job) -> String {
    let mut bytes = Vec::new();
    let mut put = |numbers: &mut dyn Iterator<Item = f64>| bytes.extend(numbers.flat_map(f64::to_le_bytes));
    match job {
        Job::Prepare { capture, .. } => {
            if let CapturedPoints::Xyz(points) = &capture.points {
                bytes.extend(points);
            }
            bytes.extend(&capture.mask);
        }
        Job::Register(job) => {
            let mut of_model = job.model.points().iter().flat_map(|point| {
                let weight = [f64::from(point.weight)];
                [point.position.coords.as_slice(), point.normal.as_slice(), &weight].concat()
            });
            put(&mut job.start.to_homogeneous().iter().copied());
            put(&mut coordinates(&job.cloud));
            put(&mut of_model);
        }
        Job::Compare(job) => {
            put(&mut job.start.to_homogeneous().iter().copied());
            put(&mut coordinates(&job.before));
            put(&mut [f64::NAN].into_iter());
            put(&mut coordinates(&job.now));
        }
    }
    format!("{} {} {}", job.name(), job.view_index(), sha256(&bytes))
}

fn coordinates(cloud: &PointCloud) -> impl Iterator<Item = f64> + '_ {
    cloud.points().iter().flat_map(|point| point.coords.iter().copied())
}

/// A run in which nothing happens but that the camera misses the triggers before these attempts.
pub(super) fn unbroken_setup(attempts: &[u16]) -> Setup {
    let missed =
        |(view, count): (usize, &u16)| (0..*count).map(move |attempt| format!("missed-trigger@{view}.{attempt}"));
    let faults = attempts.iter().enumerate().flat_map(missed);
    Setup {
        seed: UNBROKEN_SEED,
        view_count: attempts.len(),
        happenings: Vec::new(),
        camera_faults: faults
            .map(|fault| fault.parse().expect("a missed trigger is a fault"))
            .collect(),
        piece_bytes_max: usize::MAX,
        job_ns: 50_000_000,
        ends_abruptly: false,
        is_replayed: false,
    }
}

const FINISHED_COUNT_MAX: usize = 4000;
/// All runs are of the same blade, plan and frames: what differs is what happens to them.
const SEED: Seed = Seed(1);
pub(super) const START_UNIX_NS: u64 = 1_767_225_600_000_000_000;
/// The limits of the check after a restart are wide: 80 x 60 pixels show a patch of a few millimetres, which comes out
/// turned by up to 3 degrees though nothing has moved.
const RECIPE: &str = r#"
name = "chaos"
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
[registration]
sample_count = 50
start = "previous"
[merge]
overlap_min_fraction = 0.3
[run]
retakes_max = 3
check_rotation_max_deg = 10.0
check_translation_max_mm = 5.0
"#;
