//! One frame on its way to the client: its components cut into chunks.

use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

use crate::camera::fields::Zero;
use crate::camera::message::{
    ChunkHead, ComponentEntry, ComponentSum, ENTRY_BYTES, FrameBegin, FrameEnd, FrameHead, FrameTail,
};
use crate::camera::render::{Frame, MASK_FILTERED, MASK_INVALID};
use crate::camera::settings::{KIND_CONFIDENCE, KIND_INTENSITY, KIND_MASK, KIND_XYZ, Settings};

/// One complete frame as it is sent: what FRAME_BEGIN says, and the bytes of its components.
#[derive(Clone, Debug)]
pub struct Picture {
    begin: FrameBegin,
    components: Vec<Component>,
    /// Count of valid pixels that FRAME_END states.
    end_valid_count: u32,
}

#[derive(Clone, Debug)]
struct Component {
    bytes: Vec<u8>,
    crc32c: u32,
}

/// Chunks of a frame that are still to be sent.
#[derive(Clone, Debug)]
pub struct Transfer {
    picture: Arc<Picture>,
    component_index: usize,
    offset_bytes: usize,
}

/// One chunk; its data stays where it is until it is written into a frame of the protocol.
#[derive(Clone, Debug)]
pub struct Chunk {
    picture: Arc<Picture>,
    component_index: usize,
    range: Range<usize>,
    is_damaged: bool,
}

impl Picture {
    /// Frame of an acquisition. The sizes, the counts and the table of `head` are set from it.
    pub fn new(mut head: FrameHead, settings: &Settings, mut frame: Frame) -> Self {
        drop_outside(settings, &mut frame);
        head.width_px = frame.width_px;
        head.height_px = frame.height_px;
        head.valid_count = frame.valid_count;
        head.saturated_count = frame.saturated_count;
        let mut components = Vec::new();
        for kind in settings.kinds() {
            let (format, pixel_bytes) = format_of(kind);
            let bytes = component_bytes(kind, &mut frame);
            let entry = ComponentEntry {
                kind,
                reserved_1: Zero,
                format,
                row_stride_bytes: frame.width_px * pixel_bytes,
                chunk_count: bytes.len().div_ceil(CHUNK_BYTES) as u32,
                byte_count: bytes.len() as u64,
                reserved_2: Zero,
            };
            let crc32c = crc32c::crc32c(&bytes);
            components.push((entry, Component { bytes, crc32c }));
        }
        let (entries, components): (Vec<_>, Vec<_>) = components.into_iter().unzip();
        head.component_count = entries.len() as u16;
        head.entry_len = ENTRY_BYTES as u16;
        Self {
            end_valid_count: head.valid_count,
            begin: FrameBegin {
                head,
                components: entries,
            },
            components,
        }
    }

    /// Acquisition that it is of.
    pub fn trigger_id(&self) -> u64 {
        self.begin.head.trigger_id
    }

    /// FRAME_BEGIN.
    pub fn begin(&self) -> &FrameBegin {
        &self.begin
    }

    /// Makes FRAME_BEGIN and FRAME_END state one valid pixel more than there is.
    pub fn miscount(&mut self) {
        self.begin.head.valid_count += 1;
        self.end_valid_count += 1;
    }

    /// FRAME_END of a frame that is sent whole: status 0, every byte and its CRC.
    pub fn end_complete(&self) -> FrameEnd {
        let sums = self.components.iter();
        self.end(
            0,
            sums.map(|component| sum(component.bytes.len(), component.crc32c))
                .collect(),
        )
    }

    fn end(&self, status: u8, components: Vec<ComponentSum>) -> FrameEnd {
        let head = &self.begin.head;
        let tail = FrameTail {
            frame_id: head.frame_id,
            trigger_id: head.trigger_id,
            status,
            reserved_1: Zero,
            valid_count: self.end_valid_count,
            component_count: components.len() as u16,
            reserved_2: Zero,
        };
        FrameEnd { tail, components }
    }

    fn byte_count(&self) -> usize {
        self.components.iter().map(|component| component.bytes.len()).sum()
    }
}

impl Transfer {
    /// Nothing sent yet.
    pub fn new(picture: Arc<Picture>) -> Self {
        Self {
            picture,
            component_index: 0,
            offset_bytes: 0,
        }
    }

    /// What is sent.
    pub fn picture(&self) -> &Arc<Picture> {
        &self.picture
    }

    /// Next FRAME_CHUNK; none once all are sent.
    pub fn poll_chunk(&mut self) -> Option<Chunk> {
        let byte_count = self.picture.components.get(self.component_index)?.bytes.len();
        let end_bytes = byte_count.min(self.offset_bytes + CHUNK_BYTES);
        let chunk = Chunk {
            picture: Arc::clone(&self.picture),
            component_index: self.component_index,
            range: self.offset_bytes..end_bytes,
            is_damaged: false,
        };
        self.offset_bytes = end_bytes;
        if end_bytes == byte_count {
            self.component_index += 1;
            self.offset_bytes = 0;
        }
        Some(chunk)
    }

    /// FRAME_END of a frame that is given up with status 1 or 2: what was sent so far.
    pub fn end_early(&self, status: u8) -> FrameEnd {
        let components = &self.picture.components;
        let sent = |index: usize| match index.cmp(&self.component_index) {
            core::cmp::Ordering::Less => &components[index].bytes[..],
            core::cmp::Ordering::Equal => &components[index].bytes[..self.offset_bytes],
            core::cmp::Ordering::Greater => &[],
        };
        let sums = (0..components.len()).map(|index| sum(sent(index).len(), crc32c::crc32c(sent(index))));
        self.picture.end(status, sums.collect())
    }

    /// Whether half of the frame's bytes are sent.
    pub fn is_half_sent(&self) -> bool {
        let before: usize = self.picture.components[..self.component_index]
            .iter()
            .map(|component| component.bytes.len())
            .sum();
        2 * (before + self.offset_bytes) >= self.picture.byte_count()
    }
}

impl Chunk {
    /// Fields before the data.
    pub fn head(&self) -> ChunkHead {
        ChunkHead {
            frame_id: self.picture.begin.head.frame_id,
            component_index: self.component_index as u16,
            reserved: Zero,
            chunk_index: (self.range.start / CHUNK_BYTES) as u32,
            offset_bytes: self.range.start as u64,
        }
    }

    /// The data.
    pub fn data(&self) -> Cow<'_, [u8]> {
        let bytes = &self.picture.components[self.component_index].bytes[self.range.clone()];
        if !self.is_damaged {
            return Cow::Borrowed(bytes);
        }
        let mut bytes = bytes.to_vec();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x10;
        Cow::Owned(bytes)
    }

    /// Damages a byte in the middle of the data; the CRC of the component stays that of the undamaged ones.
    pub fn damage(&mut self) {
        self.is_damaged = true;
    }
}

/// Makes every pixel of a frame invalid.
pub fn empty(frame: &mut Frame) {
    drop_pixels(frame, |_| false);
}

/// Drops the points outside the volume of interest, marked as filtered.
fn drop_outside(settings: &Settings, frame: &mut Frame) {
    if settings.volume_of_interest.on == 1 {
        drop_pixels(frame, |point_mm| settings.volume_of_interest.keeps(point_mm));
    }
}

fn drop_pixels(frame: &mut Frame, keeps: impl Fn(&[f32; 3]) -> bool) {
    for (point_mm, mask) in frame.xyz_mm.iter_mut().zip(&mut frame.mask) {
        if *mask & MASK_INVALID == 0 && !keeps(point_mm) {
            *point_mm = [f32::NAN; 3];
            *mask |= MASK_INVALID | MASK_FILTERED;
            frame.valid_count -= 1;
        }
    }
}

/// PFNC code and bytes of a pixel; only kinds that the simulated camera offers.
fn format_of(kind: u16) -> (u32, u32) {
    match kind {
        KIND_XYZ => (0x0260_00C0, 12),
        KIND_CONFIDENCE => (0x0108_00C6, 1),
        _ => (0x0108_0001, 1),
    }
}

/// Bytes of a pixel of a component kind.
pub fn pixel_bytes(kind: u16) -> u32 {
    format_of(kind).1
}

/// Bytes of a component; what the frame has as bytes already is taken from it.
fn component_bytes(kind: u16, frame: &mut Frame) -> Vec<u8> {
    match kind {
        KIND_XYZ => frame
            .xyz_mm
            .iter()
            .flatten()
            .flat_map(|value_mm| value_mm.to_le_bytes())
            .collect(),
        KIND_INTENSITY => core::mem::take(&mut frame.intensity),
        KIND_CONFIDENCE => core::mem::take(&mut frame.confidence),
        KIND_MASK => core::mem::take(&mut frame.mask),
        _ => Vec::new(),
    }
}

fn sum(byte_count: usize, crc32c: u32) -> ComponentSum {
    ComponentSum {
        byte_count: byte_count as u64,
        crc32c,
        reserved: Zero,
    }
}

/// Usual data bytes of a chunk.
pub const CHUNK_BYTES: usize = 262_144;
