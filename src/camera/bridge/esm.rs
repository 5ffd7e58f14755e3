//! ESM blocks: header and points as VisionPro's `esm_data` gives them.
//!
//! The layout is what one public integration reads (fact, not copied code; `docs/protocols/bridge.md` says where each
//! field stands). Its time unit, its private bytes and three bytes of each point are unknown and not used.

use super::picture::{Beside, Canvas, ConvertError, Picture, VendorFile, Wanted, exact_size};

/// Converts a block.
///
/// # Errors
///
/// A field holds what it must not, or the block is too short for its points. Memory is taken only after that.
pub fn from_esm(file: VendorFile<'_>, beside: &Beside<'_>, wanted: &Wanted) -> Result<Picture, ConvertError> {
    let block = Block::check(file, wanted.size_px)?;
    let mut canvas = Canvas::new(wanted, block.width * block.height);
    for row in 0..block.height {
        let start = block.points_at + row * block.pitch;
        for point in file.bytes[start..start + block.width * ELEMENT_BYTES].chunks_exact(ELEMENT_BYTES) {
            let coordinate = |at: usize| f64::from(f32_at(point, at));
            let valid = point[FLAGS_AT] & FLAG_INVALID == 0;
            canvas.push(valid.then(|| [coordinate(0), coordinate(4), coordinate(8)]));
        }
    }
    canvas.finish(beside)
}

/// The most bytes of a block of that size: header, any offset of the points within 64 KiB, rows filled up to 255 bytes.
pub(super) fn block_bytes_max(width: u64, height: u64) -> u64 {
    u64::from(u16::MAX) + height * (width * ELEMENT_BYTES as u64 + 255)
}

/// Where the points of a checked block are; every index is inside the file.
struct Block {
    width: usize,
    height: usize,
    pitch: usize,
    points_at: usize,
}

impl Block {
    fn check(file: VendorFile<'_>, expected_px: [u32; 2]) -> Result<Self, ConvertError> {
        let wrong = |field: &'static str, value: u64, allowed: &'static str| ConvertError::Field {
            file: file.name.to_owned(),
            field,
            value,
            allowed,
        };
        let short = |field: &'static str, needed: u64| ConvertError::Length {
            file: file.name.to_owned(),
            field,
            needed,
            found: file.bytes.len() as u64,
        };
        let bytes = file.bytes;
        if bytes.len() < HEADER_BYTES_MIN {
            return Err(short("the header", HEADER_BYTES_MIN as u64));
        }
        let magic = u32_at(bytes, 0);
        if magic != MAGIC {
            return Err(wrong("the magic", u64::from(magic), "0xE5BE7A00 (3854465536)"));
        }
        let header_bytes = u64::from(u16::from_le_bytes([bytes[4], bytes[5]]));
        if header_bytes < HEADER_BYTES_MIN as u64 {
            return Err(wrong("the header size", header_bytes, "at least 168"));
        }
        let (element_bytes, alignment) = (bytes[6], u64::from(bytes[7]));
        if usize::from(element_bytes) != ELEMENT_BYTES {
            return Err(wrong("the element size", u64::from(element_bytes), "16"));
        }
        let found_px = [u32_at(bytes, 8), u32_at(bytes, 12)];
        exact_size(file, found_px, expected_px)?;
        let points_at = u64_at(bytes, POINTS_OFFSET_AT);
        if points_at < header_bytes {
            return Err(wrong(
                "the offset of the points",
                points_at,
                "a place behind the header",
            ));
        }
        let [width, height] = found_px.map(u64::from);
        let pitch = (width * ELEMENT_BYTES as u64).next_multiple_of(alignment.max(1));
        // The last row needs no filling up.
        let points = (height.saturating_sub(1))
            .checked_mul(pitch)
            .and_then(|rows| rows.checked_add(width * ELEMENT_BYTES as u64))
            .and_then(|points| points.checked_add(points_at))
            .ok_or_else(|| wrong("the offset of the points", points_at, "a place inside the block"))?;
        if points > bytes.len() as u64 {
            return Err(short("the points", points));
        }
        Ok(Self {
            width: width as usize,
            height: height as usize,
            pitch: pitch as usize,
            points_at: points_at as usize,
        })
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn f32_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_bits(u32_at(bytes, at))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}

const MAGIC: u32 = 0xE5BE_7A00;
const HEADER_BYTES_MIN: usize = 168;
const ELEMENT_BYTES: usize = 16;
const POINTS_OFFSET_AT: usize = 152;
const FLAGS_AT: usize = 15;
const FLAG_INVALID: u8 = 1;

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::camera::bridge::picture::Axes;
    use crate::camera::settings::VolumeOfInterest;
    use proptest::prelude::*;

    /// A block of 3 × 2 points, rows filled up to 64 bytes: point i at (i, 2 i, 3 i), point 4 invalid.
    pub(in crate::camera::bridge) fn block() -> Vec<u8> {
        let mut bytes = vec![0u8; 168];
        bytes[0..4].copy_from_slice(&MAGIC.to_le_bytes());
        bytes[4..6].copy_from_slice(&168u16.to_le_bytes());
        bytes[6] = 16;
        bytes[7] = 64;
        bytes[8..12].copy_from_slice(&3u32.to_le_bytes());
        bytes[12..16].copy_from_slice(&2u32.to_le_bytes());
        bytes[152..160].copy_from_slice(&168u64.to_le_bytes());
        for row in 0..2 {
            for column in 0..3 {
                let index = (row * 3 + column) as f32;
                for value in [index, 2.0 * index, 3.0 * index] {
                    bytes.extend_from_slice(&value.to_le_bytes());
                }
                bytes.extend_from_slice(&[9, 9, 9, u8::from(index == 4.0) | 0x80]);
            }
            bytes.resize(168 + (row + 1) * 64, 0xEE);
        }
        bytes
    }

    fn convert(bytes: &[u8], axes: Axes) -> Result<Picture, ConvertError> {
        let wanted = Wanted {
            axes,
            ..Wanted::of_size([3, 2])
        };
        from_esm(VendorFile { name: "a.esm", bytes }, &Beside::default(), &wanted)
    }

    fn point(picture: &Picture, index: usize) -> [f32; 3] {
        [0, 4, 8].map(|at| f32_at(&picture.xyz[index * 12..], at))
    }

    #[test]
    fn points_keep_their_place_and_the_flagged_one_is_invalid() {
        let picture = convert(&block(), Axes::SAME).unwrap();
        assert_eq!((picture.width_px, picture.height_px, picture.valid_count), (3, 2, 5));
        assert_eq!(point(&picture, 5), [5.0, 10.0, 15.0]);
        assert_eq!(picture.mask, [0, 0, 0, 0, 1, 0]);
        assert!(point(&picture, 4).iter().all(|value| value.is_nan()));
        assert_eq!(picture.intensity, [0; 6]);
    }

    #[test]
    fn unit_and_axes_of_the_vendor_are_normalised() {
        let axes = Axes {
            unit_mm: 10.0,
            camera_from_vendor: [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 5.0], [0.0, 0.0, -1.0, 400.0]],
        };
        assert!(axes.is_rigid());
        let picture = convert(&block(), axes).unwrap();
        assert_eq!(point(&picture, 1), [10.0, -15.0, 370.0]);
    }

    #[test]
    fn points_outside_the_volume_of_interest_are_filtered() {
        let wanted = Wanted {
            volume: Some(VolumeOfInterest {
                min_mm: [1.0, 0.0, 0.0],
                max_mm: [3.0, 100.0, 100.0],
            }),
            ..Wanted::of_size([3, 2])
        };
        let bytes = block();
        let file = VendorFile {
            name: "a.esm",
            bytes: &bytes,
        };
        let picture = from_esm(file, &Beside::default(), &wanted).unwrap();
        assert_eq!(picture.mask, [17, 0, 0, 0, 1, 17]);
        assert!(point(&picture, 0)[0].is_nan());
    }

    #[test]
    fn a_stretching_transform_is_not_taken_for_rigid() {
        let mut axes = Axes::SAME;
        axes.camera_from_vendor[2][2] = 1.01;
        assert!(!axes.is_rigid());
        assert!(
            !Axes {
                unit_mm: 0.0,
                ..Axes::SAME
            }
            .is_rigid()
        );
    }

    #[test]
    fn each_spoilt_field_is_named_with_its_file() {
        for (at, value, words) in [
            (0, 1, "the magic"),
            (4, 100, "the header size"),
            (6, 20, "the element size"),
            (8, 4, "[4, 2] pixels where the settings give [3, 2]"),
            (152, 3, "the offset of the points"),
            (159, 0xFF, "bytes where"),
            (153, 0xFF, "bytes where"),
        ] {
            let mut bytes = block();
            bytes[at] = value;
            let words_found = convert(&bytes, Axes::SAME).unwrap_err().to_string();
            assert!(
                words_found.starts_with("a.esm: ") && words_found.contains(words),
                "{words_found}"
            );
        }
        let whole = block();
        // The filling of the last row may be missing, nothing else.
        assert!(convert(&whole[..168 + 64 + 48], Axes::SAME).is_ok());
        for length in 0..168 + 64 + 48 {
            assert!(convert(&whole[..length], Axes::SAME).is_err(), "cut to {length}");
        }
    }

    proptest! {
        #[test]
        fn no_block_makes_it_panic_or_take_memory_it_has_not_seen(
            changes in prop::collection::vec((0usize..296, any::<u8>()), 0..12),
            length in 0usize..=296,
            expected_px in prop::array::uniform2(prop_oneof![Just(3u32), Just(2), 0u32..8, any::<u32>()]),
        ) {
            let mut bytes = block();
            for (at, value) in changes {
                bytes[at] = value;
            }
            bytes.truncate(length);
            let file = VendorFile { name: "a.esm", bytes: &bytes };
            if let Ok(picture) = from_esm(file, &Beside::default(), &Wanted::of_size(expected_px)) {
                prop_assert!(picture.mask.len() * ELEMENT_BYTES <= bytes.len());
            }
        }
    }
}
