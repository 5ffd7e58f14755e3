//! The results in a run's folder when the run goes on: nothing that is there is overwritten.

use super::recording_file::{FileError, io_error, sync_folder_of};
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Moves what an earlier part of the run has left as its results into `part-1`, `part-2` and so on, whichever is free; `None`
/// where there is nothing. Recording and truth stay: they go on.
///
/// # Errors
/// When a file cannot be moved; those moved before stay where they are then.
pub fn put_aside(dir: &Path) -> Result<Option<PathBuf>, FileError> {
    let there: Vec<&str> = RESULTS.into_iter().filter(|name| dir.join(name).exists()).collect();
    if there.is_empty() {
        return Ok(None);
    }
    let part = (1..=PARTS_MAX)
        .map(|number| dir.join(format!("part-{number}")))
        .find(|part| !part.exists())
        .unwrap_or_else(|| dir.join("part-more"));
    fs::create_dir(&part).map_err(|source| io_error(&part, source))?;
    for name in there {
        let from = dir.join(name);
        fs::rename(&from, part.join(name)).map_err(|source| io_error(&from, source))?;
    }
    sync_folder_of(&part).map_err(|source| io_error(dir, source))?;
    Ok(Some(part))
}

/// Writes the results of a run that had ended when its process was killed, as far as they are not there. A torn file is put
/// aside.
///
/// # Errors
/// When a file cannot be read, moved or written.
pub fn settle(dir: &Path, files: &BTreeMap<&'static str, Vec<u8>>) -> Result<(), FileError> {
    let is_there = |name: &str, bytes: &[u8]| fs::read(dir.join(name)).is_ok_and(|found| found == bytes);
    if files.iter().all(|(name, bytes)| is_there(name, bytes)) {
        return Ok(());
    }
    put_aside(dir)?;
    files
        .iter()
        .try_for_each(|(name, bytes)| write_new(&dir.join(name), bytes))
}

/// Writes a file that is not there yet; its name appears when it is whole.
///
/// # Errors
/// When there is one of that name, or it cannot be written.
pub(super) fn write_new(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".writing");
    let beside = PathBuf::from(beside);
    let write = || {
        if path.exists() {
            return Err(std::io::ErrorKind::AlreadyExists.into());
        }
        let mut file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(&beside)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&beside, path)?;
        sync_folder_of(path)
    };
    write().map_err(|source| io_error(path, source))
}

/// What a run leaves as its results.
const RESULTS: [&str; 5] = ["model.ply", "poses.json", "summary.json", "fault.json", "report.html"];
const PARTS_MAX: u32 = 1000;

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("bladescan-run-dir-{name}-{}", std::process::id()));
        fs::remove_dir_all(&folder).ok();
        fs::create_dir(&folder).unwrap();
        folder
    }

    #[test]
    fn results_of_each_part_are_kept_in_a_folder_of_their_own() {
        let dir = folder("parts");
        for part in ["part-1", "part-2"] {
            assert_eq!(put_aside(&dir).unwrap(), None);
            write_new(&dir.join("poses.json"), part.as_bytes()).unwrap();
            fs::write(dir.join("run.mcap"), part).unwrap();
            assert_eq!(put_aside(&dir).unwrap(), Some(dir.join(part)));
            assert_eq!(fs::read(dir.join(part).join("poses.json")).unwrap(), part.as_bytes());
        }
        assert!(dir.join("run.mcap").exists() && !dir.join("poses.json").exists());
        fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn a_file_that_is_there_is_never_written_over() {
        let dir = folder("new");
        let path = dir.join("poses.json");
        write_new(&path, b"first").unwrap();
        assert!(write_new(&path, b"second").is_err());
        assert_eq!(fs::read(&path).unwrap(), b"first");
        fs::remove_dir_all(dir).unwrap();
    }

    #[test]
    fn results_that_a_killed_process_left_torn_are_written_whole() {
        let dir = folder("torn");
        fs::write(dir.join("model.ply"), b"ply, but only hal").unwrap();
        let files = BTreeMap::from([("model.ply", b"whole".to_vec()), ("poses.json", b"{}".to_vec())]);
        settle(&dir, &files).unwrap();
        assert_eq!(fs::read(dir.join("model.ply")).unwrap(), b"whole");
        assert_eq!(fs::read(dir.join("part-1/model.ply")).unwrap(), b"ply, but only hal");
        settle(&dir, &files).unwrap();
        assert!(!dir.join("part-2").exists());
        fs::remove_dir_all(dir).unwrap();
    }
}
