//! A disk that goes wrong, and a journal on it, on virtual time.

use std::cell::Cell;
use std::collections::VecDeque;
use std::io::{self, Cursor, ErrorKind, Seek, SeekFrom, Write};

use bladescan::journal::{Record, Writer};
use bladescan::run::{Journal, JournalError, Progress};

use crate::camera_faults::virtual_time::TimedJournal;

/// What the disk does wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trouble {
    /// Nothing.
    None,
    /// No byte more than these fits on it.
    Full { byte_count: u64 },
    /// As many bytes are taken, then it is read-only.
    ReadOnly { byte_count: u64 },
    /// From this record on, what is written leaves the process so much later.
    SlowFlush { record: u64, delay_ns: u64 },
    /// From this record on, what is written comes on the disk so much later.
    SlowSync { record: u64, delay_ns: u64 },
}

/// A disk in memory.
#[derive(Debug)]
pub(super) struct Disk {
    bytes: Cursor<Vec<u8>>,
    trouble: Trouble,
}

impl Disk {
    pub(super) fn new(trouble: Trouble) -> Self {
        Self {
            bytes: Cursor::new(Vec::new()),
            trouble,
        }
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.bytes.into_inner()
    }
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let (room, kind) = match self.trouble {
            Trouble::Full { byte_count } => (byte_count, ErrorKind::StorageFull),
            Trouble::ReadOnly { byte_count } => (byte_count, ErrorKind::ReadOnlyFilesystem),
            _ => return self.bytes.write(bytes),
        };
        let room = room.saturating_sub(self.bytes.position()) as usize;
        if room == 0 && !bytes.is_empty() {
            return Err(kind.into());
        }
        self.bytes.write(&bytes[..bytes.len().min(room)])
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.bytes.seek(to)
    }
}

/// A journal on such a disk.
pub(super) struct DiskJournal {
    writer: Writer<Disk>,
    trouble: Trouble,
    record_count: u64,
    /// How many bytes stood there before each record, and after the last.
    pub(super) offsets: Vec<u64>,
    now_ns: Cell<u64>,
    /// When each record that has been flushed leaves the process.
    leaving: VecDeque<(u64, u64)>,
    /// When everything up to a record is on the disk.
    syncing: VecDeque<(u64, u64)>,
}

impl DiskJournal {
    pub(super) fn new(writer: Writer<Disk>, trouble: Trouble, begun_bytes: u64) -> Self {
        Self {
            writer,
            trouble,
            record_count: 0,
            offsets: vec![begun_bytes],
            now_ns: Cell::new(0),
            leaving: VecDeque::new(),
            syncing: VecDeque::new(),
        }
    }

    /// What is on the disk if the process ends here.
    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.writer.abandon().into_bytes()
    }

    /// The last count whose time has come.
    fn reached(&self, steps: &VecDeque<(u64, u64)>) -> u64 {
        let come = steps.iter().take_while(|(at_ns, _)| *at_ns <= self.now_ns.get());
        come.last().map_or(0, |(_, count)| *count)
    }
}

impl Journal for DiskJournal {
    fn record(&mut self, record: Record) -> Result<(), JournalError> {
        let byte_count = record.payload.len() as u64 + RECORD_BYTES;
        Journal::record(&mut self.writer, record)?;
        self.record_count += 1;
        let before = self.offsets.last().copied().unwrap_or(0);
        self.offsets.push(before + byte_count);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), JournalError> {
        Journal::flush(&mut self.writer)?;
        if self.leaving.back().is_none_or(|(_, count)| *count < self.record_count) {
            let delay_ns = match self.trouble {
                Trouble::SlowFlush { record, delay_ns } if self.record_count > record => delay_ns,
                _ => 0,
            };
            self.leaving
                .push_back((self.now_ns.get() + delay_ns, self.record_count));
        }
        Ok(())
    }

    fn sync(&mut self) -> Result<(), JournalError> {
        let delay_ns = match self.trouble {
            Trouble::SlowSync { record, delay_ns } if self.record_count > record => delay_ns,
            _ => 0,
        };
        self.syncing
            .push_back((self.now_ns.get() + delay_ns, self.record_count));
        Ok(())
    }

    fn progress(&self) -> Result<Progress, JournalError> {
        Ok(Progress {
            flushed_count: self.reached(&self.leaving),
            synced_count: self.reached(&self.syncing),
        })
    }
}

impl TimedJournal for DiskJournal {
    fn handle_time(&self, now_ns: u64) {
        self.now_ns.set(now_ns);
    }

    fn wake_at(&self) -> Option<u64> {
        let steps = self.leaving.iter().chain(&self.syncing);
        let ahead = steps
            .map(|(at_ns, _)| *at_ns)
            .filter(|at_ns| *at_ns > self.now_ns.get());
        ahead.min()
    }
}

/// Bytes of a message record of MCAP around its payload: opcode, length, channel, sequence and two times.
const RECORD_BYTES: u64 = 1 + 8 + 2 + 4 + 8 + 8;
