//! A frame as the vendor's side gives it, brought into the camera frame: the organised grid of A3DP/1.

use crate::camera::settings::VolumeOfInterest;
use thiserror::Error;

/// One converted frame: every component row-major, `width_px × height_px`.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// f32 x, y, z per pixel, little-endian, mm in the camera frame; NaN in all three where invalid.
    pub xyz: Vec<u8>,
    /// Camera 1's picture; 0 everywhere when the vendor's side gives none.
    pub intensity: Vec<u8>,
    /// Score × 255, where the vendor's side gives it.
    pub confidence: Option<Vec<u8>>,
    /// Bit 0 set = invalid.
    pub mask: Vec<u8>,
    /// Pixels with 3D.
    pub valid_count: u32,
}

/// A file of the vendor's side: what it is called, for messages, and what is in it.
#[derive(Debug, Clone, Copy)]
pub struct VendorFile<'a> {
    /// Its path.
    pub name: &'a str,
    /// Its content.
    pub bytes: &'a [u8],
}

/// Why a vendor's frame cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ConvertError {
    /// A file is shorter or longer than its pixels need.
    #[error("{file}: {found} bytes where {needed} are needed for {field}")]
    Length {
        /// Which file.
        file: String,
        /// What they are needed for.
        field: &'static str,
        /// How many are needed.
        needed: u64,
        /// How many there are.
        found: u64,
    },
    /// A field holds what it must not.
    #[error("{file}: {field} is {value}, where {allowed} belongs")]
    Field {
        /// Which file.
        file: String,
        /// Which field.
        field: &'static str,
        /// What it holds.
        value: u64,
        /// What would do.
        allowed: &'static str,
    },
    /// The frame is not of the size that the settings give.
    #[error("{file}: {found_px:?} pixels where the settings give {expected_px:?}")]
    Size {
        /// Which file.
        file: String,
        /// Width and height found.
        found_px: [u32; 2],
        /// Width and height in force.
        expected_px: [u32; 2],
    },
}

/// From the vendor's coordinates to millimetres in the camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axes {
    /// One unit of the vendor's, mm.
    pub unit_mm: f64,
    /// Rows of the 3 × 4 motion (or mirrored motion), mm.
    pub camera_from_vendor: [[f64; 4]; 3],
}

impl Axes {
    /// The vendor's axes are the camera's, in mm.
    pub const SAME: Self = Self {
        unit_mm: 1.0,
        camera_from_vendor: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
    };

    /// A point in the camera frame, mm.
    pub fn apply(&self, vendor: [f64; 3]) -> [f32; 3] {
        let [x, y, z] = vendor.map(|value| value * self.unit_mm);
        self.camera_from_vendor
            .map(|[a, b, c, offset]| (a * x + b * y + c * z + offset) as f32)
    }

    /// Whether it neither stretches nor shears: rows of length 1 at right angles, and a positive unit.
    pub fn is_rigid(&self) -> bool {
        let rows = self.camera_from_vendor;
        let dot = |a: [f64; 4], b: [f64; 4]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let near = |value: f64, wanted: f64| (value - wanted).abs() < RIGID_TOLERANCE;
        let finite = rows.iter().flatten().all(|value| value.is_finite()) && self.unit_mm.is_finite();
        finite
            && self.unit_mm > 0.0
            && (0..3)
                .all(|row| (0..3).all(|other| near(dot(rows[row], rows[other]), f64::from(u8::from(row == other)))))
    }
}

/// What a frame must be and what becomes of its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// Width and height in force.
    pub size_px: [u32; 2],
    /// Which way the vendor's axes point.
    pub axes: Axes,
    /// Points outside it are filtered.
    pub volume: Option<VolumeOfInterest>,
}

impl Wanted {
    /// A frame of that size in the camera's own axes, everywhere.
    pub fn of_size(size_px: [u32; 2]) -> Self {
        Self {
            size_px,
            axes: Axes::SAME,
            volume: None,
        }
    }

    fn is_outside(&self, point: [f32; 3]) -> bool {
        self.volume.is_some_and(|volume| {
            (0..3).any(|axis| !(volume.min_mm[axis]..=volume.max_mm[axis]).contains(&point[axis]))
        })
    }
}

/// A picture in the making: pixels come in row order.
pub(super) struct Canvas<'a> {
    wanted: &'a Wanted,
    xyz: Vec<u8>,
    mask: Vec<u8>,
    valid_count: u32,
}

impl<'a> Canvas<'a> {
    /// Takes memory for so many pixels; the caller has seen a file that holds them.
    pub(super) fn new(wanted: &'a Wanted, pixels: usize) -> Self {
        Self {
            wanted,
            xyz: Vec::with_capacity(pixels * 12),
            mask: Vec::with_capacity(pixels),
            valid_count: 0,
        }
    }

    /// The next pixel in the vendor's coordinates; `None` and points that are not finite are invalid.
    pub(super) fn push(&mut self, vendor: Option<[f64; 3]>) {
        let point = vendor.map(|vendor| self.wanted.axes.apply(vendor));
        let point = point.filter(|point| point.iter().all(|value| value.is_finite()));
        let (point, mask) = match point {
            Some(point) if self.wanted.is_outside(point) => (None, MASK_INVALID | MASK_FILTERED),
            Some(point) => (Some(point), 0),
            None => (None, MASK_INVALID),
        };
        for value in point.unwrap_or([f32::NAN; 3]) {
            self.xyz.extend_from_slice(&value.to_le_bytes());
        }
        self.mask.push(mask);
        self.valid_count += u32::from(point.is_some());
    }

    /// The whole picture, with the pictures that came beside it.
    pub(super) fn finish(self, beside: &Beside<'_>) -> Result<Picture, ConvertError> {
        let pixels = self.mask.len();
        let size_px = self.wanted.size_px;
        let confidence = beside.confidence.map(|file| plane(file, "confidence", pixels));
        Ok(Picture {
            width_px: size_px[0],
            height_px: size_px[1],
            xyz: self.xyz,
            intensity: match beside.intensity {
                Some(file) => plane(file, "intensity", pixels)?,
                None => vec![0; pixels],
            },
            confidence: confidence.transpose()?,
            mask: self.mask,
            valid_count: self.valid_count,
        })
    }
}

/// Pictures that come beside the points: one byte per pixel, row-major, no header.
#[derive(Debug, Clone, Copy, Default)]
pub struct Beside<'a> {
    /// Camera 1's picture.
    pub intensity: Option<VendorFile<'a>>,
    /// Score × 255.
    pub confidence: Option<VendorFile<'a>>,
}

fn plane(file: VendorFile<'_>, field: &'static str, pixels: usize) -> Result<Vec<u8>, ConvertError> {
    exact_length(file, field, pixels as u64)?;
    Ok(file.bytes.to_vec())
}

/// Fails unless the file has exactly so many bytes.
pub(super) fn exact_length(file: VendorFile<'_>, field: &'static str, needed: u64) -> Result<(), ConvertError> {
    let found = file.bytes.len() as u64;
    if found == needed {
        return Ok(());
    }
    Err(ConvertError::Length {
        file: file.name.to_owned(),
        field,
        needed,
        found,
    })
}

/// Fails unless the frame has the size that is in force, which is not empty.
pub(super) fn exact_size(file: VendorFile<'_>, found_px: [u32; 2], expected_px: [u32; 2]) -> Result<(), ConvertError> {
    if found_px == expected_px && !found_px.contains(&0) {
        return Ok(());
    }
    Err(ConvertError::Size {
        file: file.name.to_owned(),
        found_px,
        expected_px,
    })
}

const MASK_INVALID: u8 = 1;
const MASK_FILTERED: u8 = 1 << 4;
const RIGID_TOLERANCE: f64 = 1e-6;
