//! The frames' files: read only inside their folder, removed after.

use crate::camera::bridge::{Conversion, FrameError, Picture};
use std::fs::File;
use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

/// Reads and converts the files of a frame; removes them unless they are to stay.
pub(super) fn convert(conversion: &Conversion, folder: &Path, keep: bool) -> Result<Picture, FrameError> {
    let max = conversion.file_bytes_max();
    let picture = conversion.run(|name| read(folder, name, max));
    if !keep {
        for path in conversion.files.names().filter_map(|name| inside(folder, name)) {
            // One that cannot be removed is in nobody's way but the disk's.
            std::fs::remove_file(path).ok();
        }
    }
    picture
}

fn read(folder: &Path, name: &str, max: u64) -> Result<Vec<u8>, FrameError> {
    let wrong = |reason: String| FrameError::Read {
        file: name.to_owned(),
        reason,
    };
    let path = inside(folder, name).ok_or_else(|| wrong(format!("not a file in {}", folder.display())))?;
    let file = File::open(path).map_err(|error| wrong(error.to_string()))?;
    let mut bytes = Vec::new();
    let taken = file.take(max + 1).read_to_end(&mut bytes);
    taken.map_err(|error| wrong(error.to_string()))?;
    if bytes.len() as u64 > max {
        return Err(wrong(format!("longer than {max} bytes")));
    }
    Ok(bytes)
}

/// The path of a file that the vendor's side names, if it lies in the folder.
fn inside(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name);
    let rest = path.strip_prefix(folder).ok()?;
    let plain = rest.components().all(|part| matches!(part, Component::Normal(_)));
    (plain && rest.components().next().is_some()).then_some(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_lies_in_the_folder_is_taken_for_a_frame() {
        let folder = Path::new("/frames");
        for name in ["1.esm", "/frames/1.esm", "today/1.esm"] {
            assert!(inside(folder, name).is_some(), "{name}");
        }
        for name in [
            "",
            "/frames",
            "../1.esm",
            "/etc/passwd",
            "today/../../1.esm",
            "/frames/../1.esm",
        ] {
            assert!(inside(folder, name).is_none(), "{name}");
        }
    }
}
