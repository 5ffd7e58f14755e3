//! The recording's file: written by a thread of its own, flushed before an act leaves.

use crate::controller::Header;
use crate::journal::{ReadError, Record, Recording, Topic, Writer, pack};
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, SyncSender, TrySendError};
use std::thread::JoinHandle;
use std::time::Duration;
use thiserror::Error;

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
    /// Writing failed.
    #[error("cannot write the recording: {0}")]
    Write(String),
    /// The disk is too slow: the queue of records is full, or a flush took too long.
    #[error("the disk is too slow for the recording")]
    Slow,
}

/// An open recording.
pub struct JournalFile {
    path: PathBuf,
    orders: Option<SyncSender<Order>>,
    thread: Option<JoinHandle<Result<(), JournalError>>>,
}

enum Order {
    Record(Record),
    Flush(SyncSender<()>),
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
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)
            .map_err(|source| JournalError::Create {
                path: path.clone(),
                source,
            })?;
        let mut writer = Writer::begin(BufWriter::new(file), header, start_unix_ns, recipe_text, station_text)
            .map_err(|error| JournalError::Write(error.to_string()))?;
        writer.flush().map_err(|error| JournalError::Write(error.to_string()))?;
        let (orders, queue) = mpsc::sync_channel(QUEUE_RECORDS_MAX);
        let sync_file = File::open(&path).map_err(|source| JournalError::Create {
            path: path.clone(),
            source,
        })?;
        let thread = std::thread::Builder::new()
            .name("journal".into())
            .spawn(move || write_all(writer, &sync_file, &queue))
            .map_err(|error| JournalError::Write(error.to_string()))?;
        Ok(Self {
            path,
            orders: Some(orders),
            thread: Some(thread),
        })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Queues a record. Never waits.
    pub fn record(&mut self, record: Record) -> Result<(), JournalError> {
        let Some(orders) = &self.orders else {
            return Err(JournalError::Write("the recording is closed".into()));
        };
        match orders.try_send(Order::Record(record)) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(_)) => Err(JournalError::Slow),
            Err(TrySendError::Disconnected(_)) => Err(self.cause()),
        }
    }

    /// Waits until everything queued has left the process.
    pub fn flush(&mut self) -> Result<(), JournalError> {
        let Some(orders) = &self.orders else {
            return Err(JournalError::Write("the recording is closed".into()));
        };
        let (done, flushed) = mpsc::sync_channel(1);
        if orders.try_send(Order::Flush(done)).is_err() {
            return Err(JournalError::Slow);
        }
        match flushed.recv_timeout(FLUSH_TIMEOUT) {
            Ok(()) => Ok(()),
            Err(mpsc::RecvTimeoutError::Timeout) => Err(JournalError::Slow),
            Err(mpsc::RecvTimeoutError::Disconnected) => Err(self.cause()),
        }
    }

    /// Ends the recording: index and summary are written, then the file is on the disk.
    pub fn finish(mut self) -> Result<PathBuf, JournalError> {
        self.orders = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result.map(|()| self.path.clone()),
            Some(Err(_)) => Err(JournalError::Write("the writing thread panicked".into())),
            None => Err(JournalError::Write("the recording had failed before".into())),
        }
    }

    /// Why the thread has ended early.
    fn cause(&mut self) -> JournalError {
        self.orders = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Err(error))) => error,
            _ => JournalError::Write("the writing thread is gone".into()),
        }
    }
}

fn write_all(mut writer: FileWriter, file: &File, queue: &Receiver<Order>) -> Result<(), JournalError> {
    let failed = |error: mcap::McapError| JournalError::Write(error.to_string());
    while let Ok(first) = queue.recv() {
        let mut next = Some(first);
        let mut checkpoint = false;
        let mut waiting = Vec::new();
        while let Some(order) = next {
            match order {
                Order::Record(record) => {
                    checkpoint |= record.topic == Topic::Transform;
                    writer.write(&record).map_err(failed)?;
                }
                Order::Flush(done) => waiting.push(done),
            }
            next = queue.try_recv().ok();
        }
        writer.flush().map_err(failed)?;
        for done in waiting {
            // Whoever waited may have given up.
            done.send(()).ok();
        }
        if checkpoint {
            file.sync_data()
                .map_err(|error| JournalError::Write(error.to_string()))?;
        }
    }
    let out = writer.finish().map_err(failed)?;
    let file = out
        .into_inner()
        .map_err(|error| JournalError::Write(error.to_string()))?;
    file.sync_all().map_err(|error| JournalError::Write(error.to_string()))
}

/// Packs a finished recording: written beside, then renamed over it. The one way a file of a run ever changes.
pub fn pack_file(path: &Path) -> Result<(), PackError> {
    let io_error = |source| PackError::Io {
        path: path.to_owned(),
        source,
    };
    let bytes = std::fs::read(path).map_err(io_error)?;
    let beside = path.with_extension("mcap.packing");
    let file = OpenOptions::new()
        .write(true)
        .create_new(true)
        .open(&beside)
        .map_err(io_error)?;
    let packed = pack(&Recording::open(&bytes)?, BufWriter::new(file))?;
    let file = packed.into_inner().map_err(|error| io_error(error.into_error()))?;
    file.sync_all().map_err(io_error)?;
    std::fs::rename(&beside, path).map_err(io_error)
}

/// Why packing failed; the unpacked recording is untouched.
#[derive(Debug, Error)]
pub enum PackError {
    /// Reading or writing a file.
    #[error("cannot pack {path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// The recording itself.
    #[error(transparent)]
    Recording(#[from] ReadError),
}

const QUEUE_RECORDS_MAX: usize = 4096;
const FLUSH_TIMEOUT: Duration = Duration::from_secs(1);
