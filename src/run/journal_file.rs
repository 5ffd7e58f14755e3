//! The recording's file: locked while it is written, by a thread of its own; another puts it on the disk.

use super::journalled::{Journal, Progress};
use super::recording_file::{self, FileError, RecordingFile};
use crate::controller::Header;
use crate::journal::{Record, Recording, Writer};
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender, SyncSender, TrySendError};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use thiserror::Error;
use tokio::sync::watch;

/// Why the recording cannot be written.
#[derive(Debug, Error)]
pub enum JournalError {
    /// The file cannot be made.
    #[error("cannot create {path}: {source}")]
    Create {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// The file belongs to another process.
    #[error(transparent)]
    File(#[from] FileError),
    /// Writing failed.
    #[error("cannot write the recording: {0}")]
    Write(String),
    /// The disk is too slow: the queue of records is full, or something waited too long for it.
    #[error("the disk is too slow for the recording")]
    Slow,
}

/// An open recording.
#[derive(Debug)]
pub struct JournalFile {
    path: PathBuf,
    orders: Option<SyncSender<Order>>,
    state: watch::Receiver<State>,
    ended: Receiver<Result<(), JournalError>>,
}

/// How far the threads have come, and what stopped them.
#[derive(Debug, Clone, Default)]
struct State {
    progress: Progress,
    failure: Option<String>,
}

#[derive(Debug)]
enum Order {
    Record(Record),
    Sync,
}

type FileWriter = Writer<BufWriter<File>>;

impl JournalFile {
    /// Creates `run.mcap` in `dir`; an existing file is never touched.
    pub fn create(
        dir: &Path,
        header: &Header,
        start_unix_ns: u64,
        recipe_text: &str,
        station_text: &str,
    ) -> Result<Self, JournalError> {
        let path = dir.join("run.mcap");
        let created = |source| JournalError::Create {
            path: path.clone(),
            source,
        };
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(created)?;
        recording_file::lock(&file, &path)?;
        let again = file.try_clone().map_err(created)?;
        let mut writer = Writer::begin(BufWriter::new(file), header, start_unix_ns, recipe_text, station_text)
            .map_err(|error| JournalError::Write(error.to_string()))?;
        writer.flush().map_err(|error| JournalError::Write(error.to_string()))?;
        again.sync_all().map_err(created)?;
        recording_file::sync_folder_of(&path).map_err(created)?;
        Self::go_on(path.clone(), writer, again)
    }

    /// Goes on with a recording that was read from `file`. Its history is written word for word into a new file beside it, without
    /// chunks, and `unwritten` behind it; then that takes its place, and what is recorded from here on follows.
    ///
    /// # Errors
    /// When the new file cannot be written; the old one is untouched then.
    pub fn resume(file: RecordingFile, recording: &Recording<'_>, unwritten: &[Record]) -> Result<Self, JournalError> {
        let path = file.path().to_owned();
        let beside = path.with_extension("mcap.resuming");
        let created = |source| JournalError::Create {
            path: beside.clone(),
            source,
        };
        let new = File::create(&beside).map_err(created)?;
        recording_file::lock(&new, &beside)?;
        let again = new.try_clone().map_err(created)?;
        let history = recording
            .copied(BufWriter::new(new), unwritten)
            .map_err(|error| JournalError::Write(error.to_string()))?;
        again.sync_all().map_err(created)?;
        std::fs::rename(&beside, &path).map_err(created)?;
        recording_file::sync_folder_of(&path).map_err(created)?;
        drop(file);
        Self::go_on(path, history, again)
    }

    /// Goes on writing a recording. `file` is the locked file that `writer` writes on.
    pub fn go_on(path: PathBuf, writer: FileWriter, file: File) -> Result<Self, JournalError> {
        let there = writer.flushed_count();
        let progress = Progress {
            flushed_count: there,
            synced_count: there,
        };
        let (state_sender, state) = watch::channel(State {
            progress,
            failure: None,
        });
        let (syncs, wanted) = mpsc::channel();
        let syncing = {
            let state = state_sender.clone();
            spawn("journal-sync", move || sync_all(&file, &wanted, &state))?
        };
        let (orders, queue) = mpsc::sync_channel(QUEUE_RECORDS_MAX);
        let (end, ended) = mpsc::channel();
        spawn("journal", move || {
            let written = write_all(writer, &queue, &state_sender, &syncs);
            drop(syncs);
            // Its file is closed with it, and then the lock is gone.
            syncing.join().ok();
            if let Err(error) = &written {
                fail(&state_sender, error);
            }
            // Nobody may wait for it any more.
            end.send(written).ok();
        })?;
        Ok(Self {
            path,
            orders: Some(orders),
            state,
            ended,
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Ends when the journal comes further than it was when one of these was last asked for it.
    pub(super) fn news(&self) -> JournalNews {
        JournalNews(self.state.clone())
    }

    /// Ends the recording: index and summary are written, then the file is on the disk.
    pub fn finish(mut self) -> Result<PathBuf, JournalError> {
        self.orders = None;
        match self.ended.recv_timeout(FINISH_TIMEOUT) {
            Ok(written) => written.map(|()| self.path.clone()),
            Err(mpsc::RecvTimeoutError::Timeout) => Err(JournalError::Slow),
            Err(mpsc::RecvTimeoutError::Disconnected) => {
                Err(JournalError::Write("the recording had failed before".into()))
            }
        }
    }

    fn send(&mut self, order: Order) -> Result<(), JournalError> {
        let sent = match &self.orders {
            Some(orders) => orders.try_send(order),
            None => return Err(JournalError::Write("the recording is closed".into())),
        };
        match sent {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => Err(JournalError::Slow),
            Err(TrySendError::Disconnected(_)) => {
                let failure = self.state.borrow().failure.clone();
                Err(JournalError::Write(
                    failure.unwrap_or_else(|| "the writing thread is gone".into()),
                ))
            }
        }
    }
}

impl Journal for JournalFile {
    fn record(&mut self, record: Record) -> Result<(), JournalError> {
        self.send(Order::Record(record))
    }

    /// The thread does that by itself whenever it has nothing more to write.
    fn flush(&mut self) -> Result<(), JournalError> {
        Ok(())
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        self.send(Order::Sync)
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        let state = self.state.borrow();
        match &state.failure {
            Some(failure) => Err(JournalError::Write(failure.clone())),
            None => Ok(state.progress),
        }
    }
}

/// Tells that a [`JournalFile`] has come further.
pub(super) struct JournalNews(watch::Receiver<State>);

impl JournalNews {
    /// Ends with the next step; never once the threads are gone.
    pub(super) async fn recv(&mut self) {
        if self.0.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

/// Writes until the queue is closed. What is written is flushed when nothing more waits, and after some records at the latest.
fn write_all(
    mut writer: FileWriter,
    queue: &Receiver<Order>,
    state: &watch::Sender<State>,
    syncs: &Sender<u64>,
) -> Result<(), JournalError> {
    while let Ok(first) = queue.recv() {
        let mut next = Some(first);
        let mut taken_count = 0;
        let mut sync_is_wanted = false;
        let mut written = Ok(());
        while let Some(order) = next {
            match order {
                Order::Record(record) => written = writer.write(&record),
                Order::Sync => sync_is_wanted = true,
            }
            taken_count += 1;
            let goes_on = written.is_ok() && taken_count < FLUSH_RECORDS_MAX;
            next = if goes_on { queue.try_recv().ok() } else { None };
        }
        if let Err(error) = written.and_then(|()| writer.flush()) {
            let error = JournalError::Write(error.to_string());
            fail(state, &error);
            // Not one byte more: what comes after a torn record cannot be read.
            drop(writer.abandon().into_parts());
            return Err(error);
        }
        let flushed_count = writer.flushed_count();
        state.send_modify(|state| state.progress.flushed_count = flushed_count);
        if sync_is_wanted {
            // Where that thread is gone, it has told why.
            syncs.send(flushed_count).ok();
        }
    }
    let out = writer
        .finish()
        .map_err(|error| JournalError::Write(error.to_string()))?;
    let file = out
        .into_inner()
        .map_err(|error| JournalError::Write(error.to_string()))?;
    file.sync_all().map_err(|error| JournalError::Write(error.to_string()))
}

/// Puts the file on the disk whenever that is wanted, while writing goes on.
fn sync_all(file: &File, wanted: &Receiver<u64>, state: &watch::Sender<State>) {
    while let Ok(first) = wanted.recv() {
        let count = wanted.try_iter().last().unwrap_or(first);
        match file.sync_data() {
            Ok(()) => state.send_modify(|state| state.progress.synced_count = count),
            Err(error) => return fail(state, &JournalError::Write(error.to_string())),
        }
    }
}

/// The first failure counts.
fn fail(state: &watch::Sender<State>, error: &JournalError) {
    state.send_modify(|state| {
        state.failure.get_or_insert(match error {
            JournalError::Write(reason) => reason.clone(),
            other => other.to_string(),
        });
    });
}

fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, JournalError> {
    thread::Builder::new()
        .name(name.into())
        .spawn(work)
        .map_err(|error| JournalError::Write(error.to_string()))
}

const QUEUE_RECORDS_MAX: usize = 4096;
const FLUSH_RECORDS_MAX: usize = 64;
/// How long the end of a run waits for the end of its recording.
const FINISH_TIMEOUT: Duration = Duration::from_secs(60);
