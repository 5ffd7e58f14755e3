//! The file of a recording that no longer grows: opened and locked, packed.

use crate::journal::{ReadError, Recording, pack};
use std::fs::{File, TryLockError};
use std::io::{self, BufWriter, Read as _, Seek as _};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A recording that nobody else writes on, resumes, recovers or packs as long as this lives.
#[derive(Debug)]
pub struct RecordingFile {
    path: PathBuf,
    file: File,
}

/// Why a recording's file cannot be had.
#[derive(Debug, Error)]
pub enum FileError {
    /// Another process has it.
    #[error("another bladescan is writing {0}: wait until its run is over")]
    InUse(PathBuf),
    /// Reading, writing or locking.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
}

impl RecordingFile {
    /// Opens and locks it.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let file = File::open(path).map_err(|source| io_error(path, source))?;
        lock(&file, path)?;
        let path = path.to_owned();
        Ok(Self { path, file })
    }

    /// All of its bytes.
    pub fn read(&mut self) -> Result<Vec<u8>, FileError> {
        let mut bytes = Vec::new();
        self.file
            .rewind()
            .and_then(|()| self.file.read_to_end(&mut bytes))
            .map_err(|source| io_error(&self.path, source))?;
        Ok(bytes)
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Locks `file`, which lies at `path`, until it is closed.
pub(super) fn lock(file: &File, path: &Path) -> Result<(), FileError> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        Err(TryLockError::WouldBlock) => Err(FileError::InUse(path.to_owned())),
        // A file system without locks: there nothing is known of another process.
        Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => Ok(()),
        Err(TryLockError::Error(source)) => Err(io_error(path, source)),
    }
}

/// Puts the name of a new or renamed file on the disk. Only Unix has a way to say that.
pub(super) fn sync_folder_of(path: &Path) -> io::Result<()> {
    match path.parent() {
        Some(folder) if cfg!(unix) => {
            let here = Path::new(".");
            let folder = if folder.as_os_str().is_empty() { here } else { folder };
            File::open(folder)?.sync_all()
        }
        _ => Ok(()),
    }
}

/// Packs a finished recording: written beside, then renamed over it. The one way a file of a run ever changes.
/// What an earlier attempt left beside it is replaced.
pub fn pack_file(path: &Path) -> Result<(), PackError> {
    let mut file = RecordingFile::open(path)?;
    let bytes = file.read()?;
    pack_open(&file, &Recording::open(&bytes)?).map(|_| ())
}

/// Packs `recording`, which was read from `file`. Returns its new size in bytes.
pub(super) fn pack_open(file: &RecordingFile, recording: &Recording<'_>) -> Result<u64, PackError> {
    let path = file.path();
    let beside = path.with_extension("mcap.packing");
    let file = File::create(&beside).map_err(|source| io_error(&beside, source))?;
    let packed = pack(recording, BufWriter::new(file))?;
    let file = packed
        .into_inner()
        .map_err(|error| io_error(&beside, error.into_error()))?;
    file.sync_all().map_err(|source| io_error(&beside, source))?;
    let bytes = file.metadata().map_err(|source| io_error(&beside, source))?.len();
    std::fs::rename(&beside, path).map_err(|source| io_error(path, source))?;
    sync_folder_of(path).map_err(|source| io_error(path, source))?;
    Ok(bytes)
}

/// Why packing failed; the unpacked recording is untouched.
#[derive(Debug, Error)]
pub enum PackError {
    /// Reading, writing or locking a file.
    #[error("cannot pack: {0}")]
    File(#[from] FileError),
    /// The recording itself.
    #[error(transparent)]
    Recording(#[from] ReadError),
}

pub(super) fn io_error(path: &Path, source: io::Error) -> FileError {
    FileError::Io {
        path: path.to_owned(),
        source,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::Header;
    use crate::journal::{Record, Topic};
    use crate::run::{Journal as _, JournalFile};
    use crate::seed::Seed;
    use crate::stamp::Stamp;

    /// An empty folder of this process and test.
    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("bladescan-{name}-{}", std::process::id()));
        std::fs::remove_dir_all(&folder).ok();
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn begun(dir: &Path) -> JournalFile {
        let header = Header {
            version: "0".into(),
            target: "t".into(),
            seed: Seed(7),
            run_id: 11,
            recipe: "r".into(),
            station: "s".into(),
            simulated: true,
            part: None,
            started_utc: "2026-01-01T00:00:00Z".into(),
            view_count: Some(3),
            ..Header::default()
        };
        let mut journal = JournalFile::create(dir, &header, 1_000, "recipe", "station").unwrap();
        for index in 0..200 {
            journal.record(record(index)).unwrap();
        }
        journal
    }

    fn record(index: u8) -> Record {
        Record {
            topic: Topic::RobotReceived,
            stamp: Stamp {
                ns: u64::from(index) * 1000,
            },
            payload: vec![index; 10 * usize::from(index)],
        }
    }

    fn records(bytes: &[u8]) -> Vec<Record> {
        let recording = Recording::open(bytes).unwrap();
        recording.records().unwrap().collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn a_recording_that_is_written_is_neither_opened_nor_packed_by_another() {
        let dir = folder("locked");
        let journal = begun(&dir);
        let path = journal.path().to_owned();
        let refused = RecordingFile::open(&path).unwrap_err();
        assert!(matches!(refused, FileError::InUse(_)), "{refused}");
        let refused = pack_file(&path).unwrap_err().to_string();
        assert!(refused.contains("another bladescan is writing"), "{refused}");
        journal.finish().unwrap();
        RecordingFile::open(&path).unwrap();
        pack_file(&path).unwrap();
        std::fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn what_an_earlier_packing_left_behind_is_replaced_and_no_record_changes() {
        let dir = folder("packing");
        let path = begun(&dir).finish().unwrap();
        let plain = std::fs::read(&path).unwrap();
        std::fs::write(dir.join("run.mcap.packing"), "half a file").unwrap();
        pack_file(&path).unwrap();
        let packed = std::fs::read(&path).unwrap();
        assert!(packed.len() < plain.len());
        assert_eq!(records(&packed), records(&plain));
        assert_eq!(records(&packed), (0..200).map(record).collect::<Vec<_>>());
        let names: Vec<_> = std::fs::read_dir(&dir)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        assert_eq!(names, ["run.mcap"]);
        std::fs::remove_dir_all(dir).unwrap();
    }

    #[tokio::test]
    async fn records_leave_the_process_and_come_on_the_disk_without_anybody_waiting() {
        let dir = folder("progress");
        let mut journal = begun(&dir);
        let mut news = journal.news();
        journal.sync().unwrap();
        let until = std::time::Duration::from_secs(60);
        while journal.progress().unwrap().synced_count < 200 {
            tokio::time::timeout(until, news.recv()).await.unwrap();
        }
        assert_eq!(journal.progress().unwrap().flushed_count, 200);
        assert_eq!(
            records(&std::fs::read(journal.path()).unwrap()),
            (0..200).map(record).collect::<Vec<_>>()
        );
        journal.finish().unwrap();
        std::fs::remove_dir_all(dir).unwrap();
    }
}
