//! Range images: 16-bit values, a visibility mask and the linear map from (column, row, value) to the vendor's space.

use super::picture::{Beside, Canvas, ConvertError, Picture, VendorFile, Wanted, exact_length, exact_size};

/// A range image with its mask, both row-major without header or filling.
#[derive(Debug, Clone, Copy)]
pub struct RangeImage<'a> {
    /// u16 per pixel, little-endian.
    pub range: VendorFile<'a>,
    /// One byte per pixel; 0 = invalid.
    pub mask: VendorFile<'a>,
    /// Width and height.
    pub size_px: [u32; 2],
    /// Rows of the 3 × 4 map: vendor's x, y, z from (column, row, value, 1).
    pub vendor_from_pixel: [[f64; 4]; 3],
}

/// Converts a range image.
///
/// # Errors
///
/// A file has not exactly the bytes of its pixels. Memory is taken only after that.
pub fn from_range_image(image: &RangeImage<'_>, beside: &Beside<'_>, wanted: &Wanted) -> Result<Picture, ConvertError> {
    exact_size(image.range, image.size_px, wanted.size_px)?;
    let [width, height] = wanted.size_px.map(u64::from);
    let pixels = width * height;
    let two_bytes_each = pixels.checked_mul(2).ok_or_else(|| ConvertError::Field {
        file: image.range.name.to_owned(),
        field: "the number of pixels",
        value: pixels,
        allowed: "a frame of a camera",
    })?;
    exact_length(image.range, "the range", two_bytes_each)?;
    exact_length(image.mask, "the mask", pixels)?;
    let mut canvas = Canvas::new(wanted, pixels as usize);
    let values = image.range.bytes.chunks_exact(2);
    for (index, (value, &mask)) in values.zip(image.mask.bytes).enumerate() {
        let index = index as u64;
        let pixel = [
            (index % width) as f64,
            (index / width) as f64,
            f64::from(u16::from_le_bytes([value[0], value[1]])),
        ];
        canvas.push((mask != 0).then(|| vendor_point(&image.vendor_from_pixel, pixel)));
    }
    canvas.finish(beside)
}

fn vendor_point(rows: &[[f64; 4]; 3], [column, row, value]: [f64; 3]) -> [f64; 3] {
    rows.map(|[a, b, c, offset]| a * column + b * row + c * value + offset)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MAP: [[f64; 4]; 3] = [[0.5, 0.0, 0.0, -1.0], [0.0, 0.25, 0.0, -2.0], [0.0, 0.0, 0.01, 100.0]];

    fn convert(range: &[u8], mask: &[u8], size_px: [u32; 2]) -> Result<Picture, ConvertError> {
        let file = |name, bytes| VendorFile { name, bytes };
        let image = RangeImage {
            range: file("a.range", range),
            mask: file("a.mask", mask),
            size_px,
            vendor_from_pixel: MAP,
        };
        from_range_image(&image, &Beside::default(), &Wanted::of_size(size_px))
    }

    #[test]
    fn column_row_and_value_go_through_the_map() {
        let range: Vec<u8> = [0u16, 1000, 2000, 3000, 4000, 65_535]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let picture = convert(&range, &[255, 0, 1, 1, 1, 1], [3, 2]).unwrap();
        let values: Vec<f32> = picture
            .xyz
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()))
            .collect();
        assert_eq!(values[0..3], [-1.0, -2.0, 100.0]);
        assert!(values[3].is_nan());
        assert_eq!(values[12..15], [-0.5, -1.75, 140.0]);
        assert_eq!((picture.valid_count, picture.mask[1]), (5, 1));
    }

    #[test]
    fn files_of_another_length_are_named() {
        let found = convert(&[0; 11], &[1; 6], [3, 2]).unwrap_err().to_string();
        assert_eq!(found, "a.range: 11 bytes where 12 are needed for the range");
        let found = convert(&[0; 12], &[1; 7], [3, 2]).unwrap_err().to_string();
        assert_eq!(found, "a.mask: 7 bytes where 6 are needed for the mask");
    }

    #[test]
    fn pictures_beside_the_points_must_have_one_byte_a_pixel() {
        let file = |name, bytes| VendorFile { name, bytes };
        let image = RangeImage {
            range: file("a.range", &[0; 12]),
            mask: file("a.mask", &[1; 6]),
            size_px: [3, 2],
            vendor_from_pixel: MAP,
        };
        let mut beside = Beside {
            intensity: Some(file("a.gray", &[7; 6])),
            confidence: Some(file("a.score", &[200; 6])),
        };
        let picture = from_range_image(&image, &beside, &Wanted::of_size([3, 2])).unwrap();
        assert_eq!(
            (picture.intensity, picture.confidence),
            (vec![7; 6], Some(vec![200; 6]))
        );
        beside.confidence = Some(file("a.score", &[200; 5]));
        let found = from_range_image(&image, &beside, &Wanted::of_size([3, 2])).unwrap_err();
        assert_eq!(found.to_string(), "a.score: 5 bytes where 6 are needed for confidence");
    }

    proptest! {
        #[test]
        fn no_files_make_it_panic(
            range in prop::collection::vec(any::<u8>(), 0..40),
            mask in prop::collection::vec(any::<u8>(), 0..20),
            size_px in prop::array::uniform2(prop_oneof![0u32..6, any::<u32>()]),
        ) {
            if let Ok(picture) = convert(&range, &mask, size_px) {
                prop_assert_eq!(picture.mask.len(), mask.len());
            }
        }
    }
}
