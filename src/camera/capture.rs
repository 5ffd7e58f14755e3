//! Frames: assembled from chunks, believed only as a whole.

use super::message::{Component, ComponentKind, FrameBegin, FrameChunk, FrameEnd, FrameStatus, TriggerId};
use crate::geometry::grid::Grid;
use thiserror::Error;

/// One complete frame, every byte checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    /// The acquisition.
    pub trigger_id: TriggerId,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixels with 3D, as the camera counts them.
    pub valid_count: u32,
    /// Pixels overexposed.
    pub saturated_count: u32,
    /// Where the points are.
    pub points: CapturedPoints,
    /// Camera 1's picture, one byte per pixel, if it was sent.
    pub intensity: Option<Vec<u8>>,
    /// Matching score × 255, one byte per pixel, if it was sent.
    pub confidence: Option<Vec<u8>>,
    /// Validity bits, one byte per pixel; bit 0 set = invalid.
    pub mask: Vec<u8>,
}

/// The points of a frame as they were sent, row by row, little-endian.
#[derive(Debug, Clone, PartialEq)]
pub enum CapturedPoints {
    /// f32 x, y, z per pixel, mm; NaN = invalid.
    Xyz(Vec<u8>),
    /// u16 per pixel.
    Range {
        /// The values.
        bytes: Vec<u8>,
        /// x, y, z = column, row, value · scale + offset, mm.
        scale: [f64; 3],
        /// See `scale`.
        offset: [f64; 3],
    },
}

impl Capture {
    /// The organised grid, mm in the camera frame; nothing where the mask says invalid, or where the numbers are no point
    /// before the camera.
    pub fn grid(&self) -> Grid {
        let (width, height) = (self.width_px as usize, self.height_px as usize);
        Grid::from_rows(width, height, |row, out| {
            let mask = &self.mask[row * width..][..width];
            match &self.points {
                CapturedPoints::Xyz(bytes) => {
                    let (pixels, _) = bytes[row * width * 12..][..width * 12].as_chunks::<12>();
                    for (((pixel, x), y), z) in pixels
                        .iter()
                        .zip(out.x.iter_mut())
                        .zip(out.y.iter_mut())
                        .zip(out.z.iter_mut())
                    {
                        let (coordinates, _) = pixel.as_chunks::<4>();
                        *x = f32::from_le_bytes(coordinates[0]);
                        *y = f32::from_le_bytes(coordinates[1]);
                        *z = f32::from_le_bytes(coordinates[2]);
                    }
                }
                CapturedPoints::Range { bytes, scale, offset } => {
                    let (values, _) = bytes[row * width * 2..][..width * 2].as_chunks::<2>();
                    for (column, value) in values.iter().enumerate() {
                        out.x[column] = (column as f64 * scale[0] + offset[0]) as f32;
                        out.y[column] = (row as f64 * scale[1] + offset[1]) as f32;
                        out.z[column] = (f64::from(u16::from_le_bytes(*value)) * scale[2] + offset[2]) as f32;
                    }
                }
            }
            for (z, mask) in out.z.iter_mut().zip(mask) {
                *z = if mask & MASK_INVALID == 0 { *z } else { f32::NAN };
            }
        })
    }
}

/// Why a frame is not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum FrameError {
    /// The components together are larger than allowed.
    #[error("{stated} bytes announced where {max} are allowed")]
    TooLarge {
        /// What FRAME_BEGIN announces.
        stated: u64,
        /// The limit.
        max: u64,
    },
    /// No mask, or not one of XYZ and RANGE.
    #[error("the components are no frame: a mask and either XYZ or RANGE are needed")]
    Components,
    /// A chunk out of order, of another frame or with too many bytes.
    #[error("chunk {chunk_index} of component {component_index} does not fit")]
    Chunk {
        /// Place in the component table.
        component_index: u16,
        /// Place in the component.
        chunk_index: u32,
    },
    /// FRAME_END does not fit what came.
    #[error("the end of the frame does not fit what came")]
    End,
    /// The count of pixels with 3D is not the mask's.
    #[error("{stated} valid pixels stated where the mask has {found}")]
    ValidCount {
        /// What FRAME_BEGIN and FRAME_END say.
        stated: u32,
        /// Bytes of the mask without bit 0.
        found: u32,
    },
    /// A component's CRC.
    #[error("the CRC of component {0} does not fit")]
    Crc(usize),
}

/// A frame in the making.
#[derive(Debug)]
pub struct Assembly {
    begin: FrameBegin,
    components: Vec<Vec<u8>>,
    /// Of what has come of each component.
    crcs: Vec<u32>,
    current: usize,
    next_chunk: u32,
}

impl Assembly {
    /// Starts a frame; memory is taken only after the sizes were checked.
    pub fn begin(begin: FrameBegin, frame_bytes_max: u64) -> Result<Self, FrameError> {
        let stated = begin
            .components
            .iter()
            .map(|component| component.byte_count)
            .fold(0, u64::saturating_add);
        if stated > frame_bytes_max {
            return Err(FrameError::TooLarge {
                stated,
                max: frame_bytes_max,
            });
        }
        let has = |kind| begin.components.iter().any(|component| component.kind == kind);
        if !has(ComponentKind::Mask) || has(ComponentKind::Xyz) == has(ComponentKind::Range) {
            return Err(FrameError::Components);
        }
        let space = |component: &Component| Vec::with_capacity(component.byte_count as usize);
        Ok(Self {
            components: begin.components.iter().map(space).collect(),
            crcs: vec![0; begin.components.len()],
            begin,
            current: 0,
            next_chunk: 0,
        })
    }

    /// The acquisition.
    pub fn trigger_id(&self) -> TriggerId {
        self.begin.trigger_id
    }

    /// Takes the next chunk.
    pub fn push(&mut self, chunk: &FrameChunk<'_>) -> Result<(), FrameError> {
        let FrameChunk {
            frame_id,
            component_index,
            chunk_index,
            offset_bytes,
            data,
        } = *chunk;
        let error = FrameError::Chunk {
            component_index,
            chunk_index,
        };
        let expected = self.begin.components.get(self.current).ok_or(error)?;
        let bytes = &mut self.components[self.current];
        let fits = frame_id == self.begin.frame_id
            && usize::from(component_index) == self.current
            && chunk_index == self.next_chunk
            && chunk_index < expected.chunk_count
            && offset_bytes == bytes.len() as u64
            && !data.is_empty()
            && (bytes.len() + data.len()) as u64 <= expected.byte_count;
        if !fits {
            return Err(error);
        }
        bytes.extend_from_slice(data);
        let crc = &mut self.crcs[self.current];
        *crc = crc32c::crc32c_append(*crc, data);
        self.next_chunk += 1;
        if bytes.len() as u64 == expected.byte_count {
            self.current += 1;
            self.next_chunk = 0;
        }
        Ok(())
    }

    /// Closes the frame: every byte count and CRC must agree, and the count of valid pixels with the mask.
    pub fn end(self, end: &FrameEnd) -> Result<Capture, FrameError> {
        let whole = self.current == self.components.len()
            && end.frame_id == self.begin.frame_id
            && end.trigger_id == self.begin.trigger_id
            && end.status == FrameStatus::Complete
            && end.valid_count == self.begin.valid_count
            && end.components.len() == self.components.len();
        if !whole {
            return Err(FrameError::End);
        }
        for (index, (bytes, sent)) in self.components.iter().zip(&end.components).enumerate() {
            if bytes.len() as u64 != sent.byte_count {
                return Err(FrameError::End);
            }
            if self.crcs[index] != sent.crc {
                return Err(FrameError::Crc(index));
            }
        }
        let begin = self.begin;
        let kinds = begin.components.iter().map(|component| component.kind);
        let mut parts: Vec<(ComponentKind, Vec<u8>)> = kinds.zip(self.components).collect();
        let mut take = |wanted: ComponentKind| {
            let place = parts.iter().position(|(kind, _)| *kind == wanted)?;
            Some(parts.swap_remove(place).1)
        };
        let points = match take(ComponentKind::Xyz) {
            Some(bytes) => CapturedPoints::Xyz(bytes),
            None => CapturedPoints::Range {
                bytes: take(ComponentKind::Range).expect("begin() checked that there is XYZ or RANGE"),
                scale: begin.scale,
                offset: begin.offset,
            },
        };
        let mask = take(ComponentKind::Mask).expect("begin() checked that there is a mask");
        let found = mask.iter().filter(|&&bits| bits & MASK_INVALID == 0).count() as u32;
        if found != begin.valid_count {
            let stated = begin.valid_count;
            return Err(FrameError::ValidCount { stated, found });
        }
        Ok(Capture {
            trigger_id: begin.trigger_id,
            width_px: begin.width_px,
            height_px: begin.height_px,
            valid_count: begin.valid_count,
            saturated_count: begin.saturated_count,
            points,
            intensity: take(ComponentKind::Intensity),
            confidence: take(ComponentKind::Confidence),
            mask,
        })
    }
}

/// Bit of the mask: no coordinates.
const MASK_INVALID: u8 = 1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::message::ServerMessage;
    use crate::camera::wire::HEADER_BYTES;
    use crate::vectors::a3dp;

    fn begin() -> FrameBegin {
        let bytes = a3dp("frame_begin");
        match ServerMessage::decode(0x30, &bytes[HEADER_BYTES..]).unwrap() {
            Some(ServerMessage::FrameBegin(begin)) => *begin,
            other => panic!("{other:?}"),
        }
    }

    fn assembly() -> Assembly {
        Assembly::begin(begin(), 1 << 20).unwrap()
    }

    fn push(assembly: &mut Assembly, name: &str) -> Result<(), FrameError> {
        let bytes = a3dp(name);
        match ServerMessage::decode(0x31, &bytes[HEADER_BYTES..]).unwrap() {
            Some(ServerMessage::FrameChunk(chunk)) => assembly.push(&chunk),
            other => panic!("{other:?}"),
        }
    }

    fn end() -> FrameEnd {
        let bytes = a3dp("frame_end");
        match ServerMessage::decode(0x32, &bytes[HEADER_BYTES..]).unwrap() {
            Some(ServerMessage::FrameEnd(end)) => end,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_frame_of_the_page_comes_together() {
        let mut assembly = assembly();
        for name in ["frame_chunk_0", "frame_chunk_1", "frame_chunk_2"] {
            push(&mut assembly, name).unwrap();
        }
        let capture = assembly.end(&end()).unwrap();
        let grid = capture.grid();
        assert_eq!(grid.point(0, 0), Some([1.0, -2.0, 300.5]));
        assert_eq!(grid.point(0, 1), None);
        assert_eq!(capture.intensity, Some(vec![200, 10]));
    }

    #[test]
    fn a_missing_chunk_a_repeated_chunk_and_a_wrong_crc_are_noticed() {
        let mut missing = assembly();
        push(&mut missing, "frame_chunk_0").unwrap();
        assert!(push(&mut missing, "frame_chunk_2").is_err());
        assert_eq!(missing.end(&end()), Err(FrameError::End));
        let mut repeated = assembly();
        push(&mut repeated, "frame_chunk_0").unwrap();
        assert!(push(&mut repeated, "frame_chunk_0").is_err());
        let mut spoilt = assembly();
        for name in ["frame_chunk_0", "frame_chunk_1", "frame_chunk_2"] {
            push(&mut spoilt, name).unwrap();
        }
        let mut wrong = end();
        wrong.components[1].crc ^= 1;
        assert_eq!(spoilt.end(&wrong), Err(FrameError::Crc(1)));
    }

    #[test]
    fn a_count_of_valid_pixels_that_the_mask_contradicts_is_noticed() {
        let mut wrong_begin = begin();
        wrong_begin.valid_count += 1;
        let mut assembly = Assembly::begin(wrong_begin, 1 << 20).unwrap();
        for name in ["frame_chunk_0", "frame_chunk_1", "frame_chunk_2"] {
            push(&mut assembly, name).unwrap();
        }
        let mut wrong_end = end();
        wrong_end.valid_count += 1;
        let expected = FrameError::ValidCount { stated: 2, found: 1 };
        assert_eq!(assembly.end(&wrong_end), Err(expected));
    }

    #[test]
    fn a_frame_beyond_the_limit_is_refused_before_memory_is_taken() {
        assert!(matches!(
            Assembly::begin(begin(), 27),
            Err(FrameError::TooLarge { stated: 28, max: 27 })
        ));
    }

    #[test]
    fn a_range_image_becomes_points_by_scale_and_offset() {
        let capture = Capture {
            trigger_id: TriggerId(0),
            width_px: 2,
            height_px: 2,
            valid_count: 3,
            saturated_count: 0,
            points: CapturedPoints::Range {
                bytes: [0u16, 10, 20, 65_535].map(u16::to_le_bytes).concat(),
                scale: [0.5, 0.25, 0.01],
                offset: [-10.0, -20.0, 300.0],
            },
            intensity: None,
            confidence: None,
            mask: vec![0, 0, 1, 2],
        };
        let grid = capture.grid();
        assert_eq!(grid.point(0, 0), Some([-10.0, -20.0, 300.0]));
        assert_eq!(grid.point(0, 1), Some([-9.5, -20.0, 300.1]));
        assert_eq!(grid.point(1, 0), None);
        assert_eq!(grid.point(1, 1), Some([-9.5, -19.75, 955.35]));
    }

    #[test]
    fn a_frame_needs_a_mask_and_one_kind_of_points() {
        let kinds = |wanted: &[ComponentKind]| {
            let mut begin = begin();
            begin.components = wanted
                .iter()
                .map(|&kind| Component {
                    kind,
                    chunk_count: 1,
                    byte_count: 2 * kind.pixel_bytes(),
                })
                .collect();
            Assembly::begin(begin, 1 << 20).map(|_| ())
        };
        use ComponentKind::{Confidence, Intensity, Mask, Range, Xyz};
        assert_eq!(kinds(&[Range, Confidence, Mask]), Ok(()));
        assert_eq!(kinds(&[Xyz, Mask]), Ok(()));
        assert_eq!(kinds(&[Xyz, Intensity]), Err(FrameError::Components));
        assert_eq!(kinds(&[Xyz, Range, Mask]), Err(FrameError::Components));
        assert_eq!(kinds(&[Intensity, Mask]), Err(FrameError::Components));
    }
}
