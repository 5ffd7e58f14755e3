//! A model of a file: what the process has written, what the operating system has, what is on the platter.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::{self, Seek, SeekFrom, Write};
use std::rc::Rc;

use bladescan::journal::{Record, Topic, Writer};
use bladescan::run::{Journal, JournalError, JournalFile, Progress};

/// One file on one disk. Clones are the same file.
#[derive(Debug, Clone, Default)]
pub(super) struct Disk(Rc<RefCell<State>>);

#[derive(Debug, Default)]
struct State {
    now_ns: u64,
    /// All that the process has written.
    image: Vec<u8>,
    position: usize,
    /// How many bytes of it the operating system has.
    left: usize,
    /// How many of those are on the platter.
    kept: usize,
    /// Where each record ends.
    record_ends: Vec<usize>,
    flushing: Option<Going>,
    syncing: Option<Going>,
    /// How much must be on the platter.
    sync_wanted: usize,
    times: Times,
    /// No byte after this one fits.
    full_at: Option<usize>,
    is_read_only: bool,
    failure: Option<&'static str>,
    /// What was recorded as sent: record and bytes, the latest last.
    sent: VecDeque<(usize, Vec<u8>)>,
}

/// Bytes on their way until then.
#[derive(Debug, Clone, Copy)]
struct Going {
    done_ns: u64,
    bytes: usize,
}

/// How long the disk takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Times {
    pub(super) flush_ns: u64,
    pub(super) sync_ns: u64,
}

impl Default for Times {
    fn default() -> Self {
        Self {
            flush_ns: 50_000,
            sync_ns: 4_000_000,
        }
    }
}

/// How much of a file is still there after an end without warning.
#[derive(Debug, Clone, Copy)]
pub(super) enum Cut {
    /// What the operating system has.
    Kill,
    /// What is on the platter.
    Power,
}

impl Disk {
    /// It is this late; what is done by now is done.
    pub(super) fn advance(&self, now_ns: u64) {
        self.0.borrow_mut().advance(now_ns);
    }

    /// When [`Self::advance`] has something to do.
    pub(super) fn wake_at(&self) -> Option<u64> {
        let state = self.0.borrow();
        let times = [state.flushing, state.syncing].into_iter().flatten();
        times.map(|going| going.done_ns).min()
    }

    pub(super) fn set_times(&self, times: Times) {
        self.0.borrow_mut().times = times;
    }

    /// No more than so many further bytes fit.
    pub(super) fn fill(&self, further_bytes: usize) {
        let mut state = self.0.borrow_mut();
        state.full_at = Some(state.left + further_bytes);
    }

    pub(super) fn protect(&self) {
        self.0.borrow_mut().is_read_only = true;
    }

    pub(super) fn has_failed(&self) -> bool {
        self.0.borrow().failure.is_some()
    }

    /// Everything written so far is on the platter: that of a file that was made and put in its place.
    pub(super) fn keep_all(&self, record_count: u64) {
        let mut state = self.0.borrow_mut();
        let end = state.image.len();
        (state.left, state.kept) = (end, end);
        state.record_ends = vec![end; record_count as usize];
    }

    /// Whether these bytes, about to be sent, are in a record that the operating system has.
    pub(super) fn has_left(&self, bytes: &[u8]) -> bool {
        let state = self.0.borrow();
        let record = state.sent.iter().rev().find(|(_, sent)| sent == bytes);
        record.is_some_and(|(index, _)| state.record_ends[*index] <= state.left)
    }

    /// What is left of the file; `torn_fraction` of what is neither safe nor lost is there as well.
    pub(super) fn cut(&self, cut: Cut, torn_fraction: f64) -> Vec<u8> {
        let state = self.0.borrow();
        let (safe, at_most) = match cut {
            Cut::Kill => (state.left, state.image.len()),
            Cut::Power => (state.kept, state.left),
        };
        let at_most = at_most.min(state.full_at.unwrap_or(usize::MAX)).max(safe);
        let more = ((at_most - safe) as f64 * torn_fraction) as usize;
        let more = if state.failure.is_some() { 0 } else { more };
        state.image[..safe + more].to_vec()
    }

    /// What the file has in the end, when its writer had the time to write everything.
    pub(super) fn whole(&self) -> Vec<u8> {
        let mut state = self.0.borrow_mut();
        if state.failure.is_none() {
            let fits = state.image.len().min(state.full_at.unwrap_or(usize::MAX));
            state.left = if state.is_read_only { state.left } else { fits };
            state.kept = state.left;
        }
        state.image[..state.left].to_vec()
    }
}

impl State {
    fn advance(&mut self, now_ns: u64) {
        self.now_ns = self.now_ns.max(now_ns);
        loop {
            let (flushed, synced) = (self.take_flushed(), self.take_synced());
            self.begin();
            if !flushed && !synced {
                return;
            }
        }
    }

    fn take_flushed(&mut self) -> bool {
        let now_ns = self.now_ns;
        let Some(going) = self.flushing.take_if(|going| going.done_ns <= now_ns) else {
            return false;
        };
        if self.is_read_only {
            self.fail("Read-only file system (os error 30)");
            return true;
        }
        let fits = self.full_at.unwrap_or(usize::MAX);
        self.left = going.bytes.min(fits);
        if going.bytes > fits {
            self.fail("No space left on device (os error 28)");
        }
        true
    }

    fn take_synced(&mut self) -> bool {
        let now_ns = self.now_ns;
        let Some(going) = self.syncing.take_if(|going| going.done_ns <= now_ns) else {
            return false;
        };
        self.kept = self.kept.max(going.bytes);
        true
    }

    fn begin(&mut self) {
        if self.failure.is_some() {
            return;
        }
        if self.flushing.is_none() && self.left < self.image.len() {
            self.flushing = Some(Going {
                done_ns: self.now_ns + self.times.flush_ns,
                bytes: self.image.len(),
            });
        }
        let is_due = self.sync_wanted > self.kept && self.left >= self.sync_wanted;
        if self.syncing.is_none() && is_due {
            self.syncing = Some(Going {
                done_ns: self.now_ns + self.times.sync_ns,
                bytes: self.left,
            });
        }
    }

    fn fail(&mut self, words: &'static str) {
        self.failure.get_or_insert(words);
        (self.flushing, self.syncing) = (None, None);
    }

    fn count_within(&self, bytes: usize) -> u64 {
        self.record_ends.partition_point(|end| *end <= bytes) as u64
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut state = self.0.borrow_mut();
        let (begin, end) = (state.position, state.position + bytes.len());
        if begin < state.left {
            return Err(io::Error::other("what has left is written again"));
        }
        if state.image.len() < end {
            state.image.resize(end, 0);
        }
        state.image[begin..end].copy_from_slice(bytes);
        state.position = end;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let mut state = self.0.borrow_mut();
        let (from, by) = match to {
            SeekFrom::Start(at) => (0, at as i64),
            SeekFrom::Current(by) => (state.position as i64, by),
            SeekFrom::End(by) => (state.image.len() as i64, by),
        };
        state.position = usize::try_from(from + by).map_err(io::Error::other)?;
        Ok(state.position as u64)
    }
}

/// A recording on a [`Disk`], with two threads' worth of patience, as the real one has.
pub(super) struct DiskJournal {
    writer: Writer<Disk>,
    disk: Disk,
}

impl DiskJournal {
    /// What `writer` has written is on the platter already: `record_count` records.
    pub(super) fn new(writer: Writer<Disk>, disk: Disk, record_count: u64) -> Self {
        disk.keep_all(record_count);
        Self { writer, disk }
    }

    /// Ends the recording, if it has not failed, and gives the file.
    pub(super) fn finish(self) -> Vec<u8> {
        if self.disk.has_failed() {
            self.writer.abandon();
        } else if self.writer.finish().is_err() {
            return Vec::new();
        }
        self.disk.whole()
    }
}

impl Journal for DiskJournal {
    fn record(&mut self, record: Record) -> Result<(), JournalError> {
        let written = self.writer.write(&record);
        written.map_err(|error| JournalError::Write(error.to_string()))?;
        let mut state = self.disk.0.borrow_mut();
        let (index, end) = (state.record_ends.len(), state.image.len());
        state.record_ends.push(end);
        if matches!(record.topic, Topic::RobotSent | Topic::CameraSent) {
            state.sent.push_back((index, record.payload));
            if state.sent.len() > SENT_COUNT_MAX {
                state.sent.pop_front();
            }
        }
        let waiting = index as u64 - state.count_within(state.left);
        if waiting > QUEUE_RECORDS_MAX {
            return Err(JournalError::Slow);
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), JournalError> {
        let mut state = self.disk.0.borrow_mut();
        let now_ns = state.now_ns;
        state.advance(now_ns);
        Ok(())
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        let mut state = self.disk.0.borrow_mut();
        state.sync_wanted = state.image.len();
        let now_ns = state.now_ns;
        state.advance(now_ns);
        Ok(())
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        let state = self.disk.0.borrow();
        match state.failure {
            Some(words) => Err(JournalError::Write(words.into())),
            None => Ok(Progress {
                flushed_count: state.count_within(state.left),
                synced_count: state.count_within(state.kept),
            }),
        }
    }
}

/// A recording of a run: on a disk that is a model, or in a real file.
pub(super) enum RunJournal {
    Model(Box<DiskJournal>),
    File(JournalFile),
}

impl Journal for RunJournal {
    fn record(&mut self, record: Record) -> Result<(), JournalError> {
        match self {
            Self::Model(journal) => journal.record(record),
            Self::File(journal) => journal.record(record),
        }
    }

    fn flush(&mut self) -> Result<(), JournalError> {
        match self {
            Self::Model(journal) => journal.flush(),
            Self::File(journal) => journal.flush(),
        }
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        match self {
            Self::Model(journal) => journal.sync(),
            Self::File(journal) => journal.sync(),
        }
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        match self {
            Self::Model(journal) => journal.progress(),
            Self::File(journal) => journal.progress(),
        }
    }
}

const QUEUE_RECORDS_MAX: u64 = 4096;
/// Things that are sent within the longest wait of an act.
const SENT_COUNT_MAX: usize = 512;
