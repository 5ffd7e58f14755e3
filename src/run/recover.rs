//! The recording of a killed run made whole.

use super::recording_file::{PackError, RecordingFile, pack_open};
use crate::journal::Recording;
use std::path::Path;

/// What was recovered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recovered {
    /// The recording had its end: nothing was done.
    pub was_whole: bool,
    /// Records that are in it.
    pub record_count: u64,
    /// Size of the file before.
    pub bytes_before: u64,
    /// Size of the file now.
    pub bytes_after: u64,
}

/// Gives the recording of a killed run its end: all whole records, metadata and attachments are written anew, compressed and
/// with an index, beside it; then that takes its place. A recording that has its end is left alone.
///
/// # Errors
/// When another process has it, when it is no recording, or when it cannot be read or written; then it is untouched.
pub fn recover(path: &Path) -> Result<Recovered, PackError> {
    let mut file = RecordingFile::open(path)?;
    let bytes = file.read()?;
    let recording = Recording::open(&bytes)?;
    let mut record_count = 0;
    for record in recording.whole_records()? {
        record?;
        record_count += 1;
    }
    let was_whole = recording.is_closed();
    let bytes_before = bytes.len() as u64;
    let bytes_after = if was_whole {
        bytes_before
    } else {
        pack_open(&file, &recording)?
    };
    Ok(Recovered {
        was_whole,
        record_count,
        bytes_before,
        bytes_after,
    })
}
