//! Files of the controller, and what can be asked about them, whatever the link.

use super::command::Kind;
use std::fmt;
use thiserror::Error;

/// Something to ask about files. The words are the controller's own: it saves to us and loads from us.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum FileCommand {
    /// List the files of one ending.
    List(FileEnding),
    /// Fetch a file from the controller.
    Save(FileName),
    /// Bring a file to the controller.
    Load {
        /// Under which name.
        name: FileName,
        /// What it says.
        content: FileContent,
    },
    /// Delete a file of the controller.
    Delete(FileName),
}

/// What a file is, by its ending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileEnding {
    /// A job.
    Jbi,
    /// Variables, tables and other general data.
    Dat,
    /// Condition data, such as tools and user frames.
    Cnd,
    /// Parameters.
    Prm,
    /// System data, such as the alarm history.
    Sys,
    /// Listings, such as the ladder program.
    Lst,
}

/// The name of a file: 1 to 32 letters, digits, hyphens and underscores, a dot, and an ending of [`FileEnding`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileName(String);

/// A text that cannot name a file.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0:?} cannot name a file: a job's name and one of .JBI .DAT .CND .PRM .SYS .LST")]
pub struct FileNameError(pub String);

/// The bytes of a file: 1 to [`FILE_BYTES_MAX`], with lines ended by CR LF as the controller writes them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FileContent(Vec<u8>);

/// A content that no file has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("a file has 1 to {FILE_BYTES_MAX} bytes, not {0}")]
pub struct FileContentError(pub usize);

/// The largest file that is sent or taken, bytes. A job of 10,000 positions has about a tenth of it.
pub const FILE_BYTES_MAX: usize = 4 << 20;

impl FileCommand {
    /// How it may be repeated. Nothing moves by a file; but one that was brought or deleted changes what a start runs,
    /// so the record of what caused it comes first. A deletion is not repeated: the second would be refused.
    pub fn kind(&self) -> Kind {
        match self {
            Self::List(_) | Self::Save(_) => Kind::Ask,
            Self::Load { .. } => Kind::Order,
            Self::Delete(_) => Kind::Act,
        }
    }

    /// Its name for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::List(_) => "list of files",
            Self::Save(_) => "file from the controller",
            Self::Load { .. } => "file to the controller",
            Self::Delete(_) => "deletion of a file",
        }
    }
}

impl FileEnding {
    /// The three letters.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Jbi => "JBI",
            Self::Dat => "DAT",
            Self::Cnd => "CND",
            Self::Prm => "PRM",
            Self::Sys => "SYS",
            Self::Lst => "LST",
        }
    }

    const ALL: [Self; 6] = [Self::Jbi, Self::Dat, Self::Cnd, Self::Prm, Self::Sys, Self::Lst];
}

impl FileName {
    /// Reads a name.
    ///
    /// # Errors
    ///
    /// The text has another form.
    pub fn parse(text: &str) -> Result<Self, FileNameError> {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_');
        let fits = text.split_once('.').is_some_and(|(stem, ending)| {
            (1..=32).contains(&stem.len())
                && stem.bytes().all(plain)
                && FileEnding::ALL.iter().any(|known| known.as_str() == ending)
        });
        if fits {
            Ok(Self(text.to_owned()))
        } else {
            Err(FileNameError(text.to_owned()))
        }
    }

    /// The name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for FileName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FileContent {
    /// Takes the bytes of a file.
    ///
    /// # Errors
    ///
    /// There are none, or more than [`FILE_BYTES_MAX`].
    pub fn new(bytes: Vec<u8>) -> Result<Self, FileContentError> {
        if (1..=FILE_BYTES_MAX).contains(&bytes.len()) {
            Ok(Self(bytes))
        } else {
            Err(FileContentError(bytes.len()))
        }
    }

    /// The bytes.
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_have_a_known_ending_and_no_path() {
        assert_eq!(FileName::parse("SCAN-1_A.JBI").unwrap().as_str(), "SCAN-1_A.JBI");
        let long = format!("{}.JBI", "X".repeat(33));
        for text in [
            "",
            "SCAN",
            ".JBI",
            "SCAN.JBI.DAT",
            "/SPDRV/CMOSBK.BIN",
            "A B.JBI",
            "SCAN.EXE",
            &long,
        ] {
            assert!(FileName::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_file_has_at_least_one_byte_and_at_most_the_bound() {
        assert_eq!(FileContent::new(vec![]), Err(FileContentError(0)));
        assert!(FileContent::new(vec![b' '; FILE_BYTES_MAX]).is_ok());
        assert!(FileContent::new(vec![b' '; FILE_BYTES_MAX + 1]).is_err());
    }
}
