//! The pool that runs jobs, and the watch that times them.

use crate::job::{FinishedJob, Job, JobOutput, StageTime};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Instant;

/// Threads for the numeric work. `RAYON_NUM_THREADS` sets their number.
pub struct Pool {
    threads: rayon::ThreadPool,
}

impl Pool {
    /// A pool of as many threads as the machine has cores, or as `RAYON_NUM_THREADS` says.
    pub fn new() -> Result<Self, rayon::ThreadPoolBuildError> {
        Self::built(rayon::ThreadPoolBuilder::new())
    }

    /// A pool of so many threads.
    pub fn with_threads(thread_count: usize) -> Result<Self, rayon::ThreadPoolBuildError> {
        Self::built(rayon::ThreadPoolBuilder::new().num_threads(thread_count))
    }

    fn built(builder: rayon::ThreadPoolBuilder) -> Result<Self, rayon::ThreadPoolBuildError> {
        let threads = builder
            .thread_name(|index| format!("job-{index}"))
            .start_handler(|_| give_way())
            .build()?;
        Ok(Self { threads })
    }

    /// How many threads there are.
    pub fn thread_count(&self) -> usize {
        self.threads.current_num_threads()
    }

    /// Starts a job and calls `done` with what came of it, on a thread of the pool.
    pub fn start(&self, job: Arc<Job>, done: impl FnOnce(FinishedJob) + Send + 'static) {
        self.threads.spawn(move || done(finish(&job)));
    }

    /// Runs a job and waits for it.
    pub fn run(&self, job: &Job) -> FinishedJob {
        self.threads.install(|| finish(job))
    }
}

/// Whatever the jobs take, the loop that talks to the robot comes first: a hold must not wait for a core. On Linux each
/// thread has a nice value of its own; elsewhere nothing is done.
fn give_way() {
    #[cfg(target_os = "linux")]
    rustix::process::nice(JOB_NICE).ok();
}

/// Runs a job, times its stages and turns a panic into an output.
fn finish(job: &Job) -> FinishedJob {
    let mut times = Vec::new();
    let mut last = Instant::now();
    let mut on_stage = |name: &str| {
        let now = Instant::now();
        times.push(StageTime {
            name: name.to_owned(),
            ns: (now - last).as_nanos() as u64,
        });
        last = now;
    };
    let result = catch_unwind(AssertUnwindSafe(|| job.run(&mut on_stage)));
    let output = result.unwrap_or_else(|panic| {
        let text = panic
            .downcast_ref::<String>()
            .map(String::as_str)
            .or_else(|| panic.downcast_ref::<&str>().copied())
            .unwrap_or("no words");
        JobOutput::Panicked {
            text: format!("{} of view {}: {text}", job.name(), job.view_index()),
        }
    });
    FinishedJob {
        digest: output.digest(),
        output,
        times,
    }
}

#[cfg(target_os = "linux")]
const JOB_NICE: i32 = 10;
