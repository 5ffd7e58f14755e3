//! The controller's files: jobs as `.JBI`, and whatever text of other kinds a client puts there.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::checks::refuse_first;
use crate::robot::controller::Controller;
use crate::robot::job::{Job, JobError};
use crate::robot::refused::{Answer, Refused};
use crate::robot::variables::Value;

/// Files by name.
#[derive(Clone, Debug, Default)]
pub struct Files {
    jobs: BTreeMap<String, StoredJob>,
    others: BTreeMap<String, Vec<u8>>,
}

#[derive(Clone, Debug)]
struct StoredJob {
    text: Vec<u8>,
    job: Arc<Job>,
}

impl Files {
    /// A job by its name without extension.
    pub fn job(&self, name: &str) -> Option<Arc<Job>> {
        self.jobs.get(name).map(|stored| Arc::clone(&stored.job))
    }

    fn byte_count(&self) -> usize {
        let jobs = self.jobs.values().map(|stored| stored.text.len());
        jobs.chain(self.others.values().map(Vec::len)).sum()
    }

    fn put_job(&mut self, name: &str, text: &[u8]) -> Result<Arc<Job>, JobError> {
        let job = Job::parse(text)?;
        if job.name != name {
            return Err(JobError {
                refused: RECORD_JOB,
                line: 2,
                what: "the name in the file is not the file's name",
            });
        }
        let job = Arc::new(job);
        let stored = StoredJob {
            text: text.to_vec(),
            job: Arc::clone(&job),
        };
        self.jobs.insert(name.to_owned(), stored);
        Ok(job)
    }
}

impl Controller {
    /// Names of the files of a kind, "*.JBI" for example, in order; E2A0 for a kind that does not exist.
    pub fn file_names(&mut self, now_ns: u64, pattern: &str) -> Answer<Vec<String>> {
        self.advance(now_ns);
        let extension = pattern.strip_prefix("*.").filter(|kind| EXTENSIONS.contains(kind));
        let extension = extension.ok_or(Refused::FILE_PATH)?;
        if extension == JOB_EXTENSION {
            return Ok(self.job_names().into_iter().map(|name| format!("{name}.JBI")).collect());
        }
        let others = self
            .files
            .others
            .keys()
            .filter(|name| extension_of(name) == Some(extension));
        Ok(others.cloned().collect())
    }

    /// Names of all jobs without extension, in order. One of them is called SIMULATED.
    pub fn job_names(&self) -> Vec<String> {
        self.files.jobs.keys().cloned().collect()
    }

    /// Text of a file.
    pub fn file(&mut self, now_ns: u64, name: &str) -> Answer<Vec<u8>> {
        self.advance(now_ns);
        self.check_can_transfer()?;
        check_name(name)?;
        let found = match job_name(name) {
            Some(job) => self.files.jobs.get(job).map(|stored| stored.text.clone()),
            None => self.files.others.get(name).cloned(),
        };
        found.ok_or(Refused::FILE_NOT_FOUND)
    }

    /// Puts a file; one of the same name is replaced. A job is read first and refused if it is none; while anything runs
    /// no job is replaced.
    pub fn put_file(&mut self, now_ns: u64, name: &str, text: &[u8]) -> Result<(), JobError> {
        self.advance(now_ns);
        let whole_file = |refused| JobError {
            refused,
            line: 0,
            what: "the file is not taken",
        };
        self.check_can_put(name).map_err(whole_file)?;
        let replaced = match job_name(name) {
            Some(job) => self.files.jobs.get(job).map_or(0, |stored| stored.text.len()),
            None => self.files.others.get(name).map_or(0, Vec::len),
        };
        let is_full = self.files.byte_count() - replaced + text.len() > MEMORY_BYTES_MAX;
        let count = self.files.jobs.len() + self.files.others.len();
        refuse_first([
            (text.is_empty(), whole_file(Refused::FILE_EMPTY)),
            (text.len() > FILE_BYTES_MAX || is_full, whole_file(Refused::JOB_MEMORY)),
            (
                replaced == 0 && count >= FILE_COUNT_MAX,
                whole_file(Refused::JOB_MEMORY),
            ),
        ])?;
        match job_name(name) {
            Some(job) => self.install_job(job, text),
            None => {
                self.files.others.insert(name.to_owned(), text.to_vec());
                Ok(())
            }
        }
    }

    /// Whether a file of this name may be put now; its text is looked at when it has come.
    pub(super) fn check_can_put(&self, name: &str) -> Answer<()> {
        self.check_can_transfer()?;
        check_name(name)?;
        let job = job_name(name);
        refuse_first([
            (job.is_some() && self.is_running(), Refused::MOVING),
            (job == Some(SIMULATED), Refused::FILE_NOT_OVERWRITTEN),
        ])
    }

    /// Deletes a file; a job not while anything runs.
    pub fn delete_file(&mut self, now_ns: u64, name: &str) -> Answer<()> {
        self.advance(now_ns);
        self.check_can_transfer()?;
        check_name(name)?;
        let Some(job) = job_name(name) else {
            return self
                .files
                .others
                .remove(name)
                .map(|_| ())
                .ok_or(Refused::FILE_NOT_FOUND);
        };
        refuse_first([
            (!self.files.jobs.contains_key(job), Refused::FILE_NOT_FOUND),
            (job == SIMULATED, Refused::FILE_KEPT),
            (self.is_running(), Refused::MOVING),
        ])?;
        self.files.jobs.remove(job);
        self.job_changed(job);
        Ok(())
    }

    /// Stores a job and the P variables that its file sets.
    pub(super) fn install_job(&mut self, name: &str, text: &[u8]) -> Result<(), JobError> {
        let job = self.files.put_job(name, text)?;
        for (number, position) in &job.variables {
            let set = self.variables.write(*number, Value::P(*position));
            set.map_err(|refused| JobError {
                refused,
                line: 0,
                what: "a P variable of the file cannot be set",
            })?;
        }
        self.job_changed(name);
        Ok(())
    }

    fn check_can_transfer(&self) -> Answer<()> {
        let is_barred = self.settings.options.files_need_remote && !self.switches.is_command_remote();
        refuse_first([(is_barred, Refused::FILE_NOT_REMOTE)])
    }
}

/// Name of the job that a file is, or none.
fn job_name(name: &str) -> Option<&str> {
    name.strip_suffix(".JBI")
}

fn extension_of(name: &str) -> Option<&str> {
    name.rsplit_once('.').map(|(_, extension)| extension)
}

/// A name and a known extension; no folders.
fn check_name(name: &str) -> Answer<()> {
    let extension = extension_of(name).filter(|extension| EXTENSIONS.contains(extension));
    let stem = name.rsplit_once('.').map_or("", |(stem, _)| stem);
    refuse_first([
        (name.len() > NAME_BYTES_MAX, Refused::FILE_PATH_LONG),
        (extension.is_none(), Refused::FILE_PATH),
        (!crate::robot::job::is_job_name(stem), Refused::FILE_PATH),
    ])
}

/// The job that says that this controller is simulated, where a protocol has no other room.
pub const SIMULATED: &str = "SIMULATED";
/// Its text.
pub const SIMULATED_TEXT: &str = "/JOB\r\n//NAME SIMULATED\r\n//POS\r\n///NPOS 0,0,0,0,0,0\r\n//INST\r\n///DATE 2026/01/02 03:04\r\n\
     ///ATTR SC,RW\r\n///GROUP1 RB1\r\nNOP\r\n'THIS CONTROLLER IS SIMULATED\r\nEND\r\n";
/// Largest file.
pub const FILE_BYTES_MAX: usize = 512 * 1024;
/// Kinds of files.
pub const EXTENSIONS: [&str; 6] = [JOB_EXTENSION, "DAT", "CND", "PRM", "SYS", "LST"];
const JOB_EXTENSION: &str = "JBI";
const FILE_COUNT_MAX: usize = 1000;
const MEMORY_BYTES_MAX: usize = 8 * 1024 * 1024;
const NAME_BYTES_MAX: usize = 36;
/// The record of the job is wrong.
const RECORD_JOB: Refused = Refused(0x5390);
