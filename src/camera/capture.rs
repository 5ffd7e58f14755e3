//! Frames: assembled from chunks, believed only as a whole.

use super::message::{Component, ComponentKind, FrameBegin, FrameChunk, FrameEnd, FrameStatus, TriggerId};
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
    /// XYZ component: f32 x, y, z per pixel, row-major, little-endian, mm; NaN = invalid.
    pub xyz: Vec<u8>,
    /// Camera 1's picture, one byte per pixel.
    pub intensity: Vec<u8>,
    /// Validity bits, one byte per pixel; bit 0 set = invalid.
    pub mask: Vec<u8>,
}

impl Capture {
    /// The organised grid, row-major, mm in the camera frame; NaN in all three coordinates where the mask says invalid.
    pub fn grid_mm(&self) -> Vec<[f32; 3]> {
        let coordinate = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        self.xyz
            .chunks_exact(12)
            .zip(&self.mask)
            .map(|(pixel, mask)| match mask & 1 {
                0 => [
                    coordinate(&pixel[0..4]),
                    coordinate(&pixel[4..8]),
                    coordinate(&pixel[8..12]),
                ],
                _ => [f32::NAN; 3],
            })
            .collect()
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
    /// Not the three components that were configured.
    #[error("the components are not those that were configured")]
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
    /// A component's CRC.
    #[error("the CRC of component {0} does not fit")]
    Crc(usize),
}

/// A frame in the making.
#[derive(Debug)]
pub struct Assembly {
    begin: FrameBegin,
    components: Vec<Vec<u8>>,
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
        let kinds: Vec<ComponentKind> = begin.components.iter().map(|component| component.kind).collect();
        if kinds != [ComponentKind::Xyz, ComponentKind::Intensity, ComponentKind::Mask] {
            return Err(FrameError::Components);
        }
        let space = |component: &Component| Vec::with_capacity(component.byte_count as usize);
        Ok(Self {
            components: begin.components.iter().map(space).collect(),
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
        self.next_chunk += 1;
        if bytes.len() as u64 == expected.byte_count {
            self.current += 1;
            self.next_chunk = 0;
        }
        Ok(())
    }

    /// Closes the frame: every byte count and CRC must agree.
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
            if crc32c::crc32c(bytes) != sent.crc {
                return Err(FrameError::Crc(index));
            }
        }
        let [xyz, intensity, mask] =
            <[Vec<u8>; 3]>::try_from(self.components).expect("begin() checked that there are three");
        Ok(Capture {
            trigger_id: self.begin.trigger_id,
            width_px: self.begin.width_px,
            height_px: self.begin.height_px,
            valid_count: self.begin.valid_count,
            saturated_count: self.begin.saturated_count,
            xyz,
            intensity,
            mask,
        })
    }
}

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
        let grid = capture.grid_mm();
        assert_eq!(grid[0], [1.0, -2.0, 300.5]);
        assert!(grid[1].iter().all(|value| value.is_nan()));
        assert_eq!(capture.intensity, [200, 10]);
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
    fn a_frame_beyond_the_limit_is_refused_before_memory_is_taken() {
        assert!(matches!(
            Assembly::begin(begin(), 27),
            Err(FrameError::TooLarge { stated: 28, max: 27 })
        ));
    }
}
