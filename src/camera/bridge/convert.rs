//! The files of one frame to a picture, with the reading left to the shell.

use super::picture::{Beside, ConvertError, Picture, VendorFile, Wanted};
use super::range_image::{RangeImage, from_range_image};
use super::vendor::FrameFiles;
use super::{esm, from_esm};
use thiserror::Error;

/// Work for the shell: read these files, convert them.
#[derive(Debug, Clone, PartialEq)]
pub struct Conversion {
    /// Where they are.
    pub files: FrameFiles,
    /// What must come of them.
    pub wanted: Wanted,
}

/// Why no picture came of the files.
#[derive(Debug, Error)]
pub enum FrameError {
    /// A file cannot be read.
    #[error("{file}: {reason}")]
    Read {
        /// Which, as the vendor's side named it.
        file: String,
        /// Why not.
        reason: String,
    },
    /// Neither or both of the layouts are named.
    #[error("a frame has either an ESM block or a range image")]
    Layout,
    /// They do not hold what they should.
    #[error(transparent)]
    Convert(#[from] ConvertError),
}

impl Conversion {
    /// The most bytes that any of its files can have.
    pub fn file_bytes_max(&self) -> u64 {
        let [width, height] = self.wanted.size_px.map(u64::from);
        esm::block_bytes_max(width, height)
    }

    /// Converts what `read` gives for the names.
    ///
    /// # Errors
    ///
    /// A file cannot be read or does not fit.
    pub fn run(&self, mut read: impl FnMut(&str) -> Result<Vec<u8>, FrameError>) -> Result<Picture, FrameError> {
        let mut read_some = |name: &Option<String>| name.as_deref().map(&mut read).transpose();
        let (intensity, confidence) = (read_some(&self.files.intensity)?, read_some(&self.files.confidence)?);
        let beside = Beside {
            intensity: file(&self.files.intensity, &intensity),
            confidence: file(&self.files.confidence, &confidence),
        };
        match (&self.files.esm, &self.files.range) {
            (Some(name), None) => {
                let bytes = read(name)?;
                let block = VendorFile { name, bytes: &bytes };
                Ok(from_esm(block, &beside, &self.wanted)?)
            }
            (None, Some(range)) => {
                let (values, mask) = (read(&range.values)?, read(&range.mask)?);
                let image = RangeImage {
                    range: VendorFile {
                        name: &range.values,
                        bytes: &values,
                    },
                    mask: VendorFile {
                        name: &range.mask,
                        bytes: &mask,
                    },
                    size_px: range.size_px,
                    vendor_from_pixel: range.vendor_from_pixel,
                };
                Ok(from_range_image(&image, &beside, &self.wanted)?)
            }
            _ => Err(FrameError::Layout),
        }
    }
}

fn file<'a>(name: &'a Option<String>, bytes: &'a Option<Vec<u8>>) -> Option<VendorFile<'a>> {
    let (name, bytes) = (name.as_deref()?, bytes.as_deref()?);
    Some(VendorFile { name, bytes })
}
