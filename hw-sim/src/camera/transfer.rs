//! One frame on its way to the client: its components cut into chunks.

use crate::camera::fields::{Rest, Zero};
use crate::camera::message::{
    ComponentEntry, ComponentSum, ENTRY_BYTES, FrameBegin, FrameChunk, FrameEnd, FrameHead, FrameTail,
};
use crate::camera::render::{Frame, MASK_FILTERED, MASK_INVALID};
use crate::camera::settings::{KIND_INTENSITY, KIND_MASK, KIND_XYZ, Settings};

/// Chunks of a frame that are still to be sent.
#[derive(Clone, Debug)]
pub struct Transfer {
    begin: FrameBegin,
    components: Vec<Component>,
    component_index: usize,
    offset_bytes: usize,
}

#[derive(Clone, Debug)]
struct Component {
    bytes: Vec<u8>,
    crc32c: u32,
}

impl Transfer {
    /// Cuts a frame. The sizes, the counts and the table of `head` are set from it.
    pub fn new(mut head: FrameHead, settings: &Settings, mut frame: Frame) -> Self {
        drop_outside(settings, &mut frame);
        head.width_px = frame.width_px;
        head.height_px = frame.height_px;
        head.valid_count = frame.valid_count;
        head.saturated_count = frame.saturated_count;
        let (mut entries, mut components) = (Vec::new(), Vec::new());
        for kind in settings.kinds() {
            let (format, pixel_bytes) = format_of(kind);
            let bytes = component_bytes(kind, &frame);
            entries.push(ComponentEntry {
                kind,
                reserved_1: Zero,
                format,
                row_stride_bytes: frame.width_px * pixel_bytes,
                chunk_count: bytes.len().div_ceil(CHUNK_BYTES) as u32,
                byte_count: bytes.len() as u64,
                reserved_2: Zero,
            });
            components.push(Component {
                crc32c: crc32c::crc32c(&bytes),
                bytes,
            });
        }
        head.component_count = entries.len() as u16;
        head.entry_len = ENTRY_BYTES as u16;
        Self {
            begin: FrameBegin {
                head,
                components: entries,
            },
            components,
            component_index: 0,
            offset_bytes: 0,
        }
    }

    /// FRAME_BEGIN.
    pub fn begin(&self) -> &FrameBegin {
        &self.begin
    }

    /// Next FRAME_CHUNK; none once all are sent.
    pub fn poll_chunk(&mut self) -> Option<FrameChunk> {
        let component = self.components.get(self.component_index)?;
        let data = component.bytes[self.offset_bytes..]
            .iter()
            .copied()
            .take(CHUNK_BYTES)
            .collect::<Vec<_>>();
        let chunk = FrameChunk {
            frame_id: self.begin.head.frame_id,
            component_index: self.component_index as u16,
            reserved: Zero,
            chunk_index: (self.offset_bytes / CHUNK_BYTES) as u32,
            offset_bytes: self.offset_bytes as u64,
            data: Rest(data),
        };
        self.offset_bytes += chunk.data.0.len();
        if self.offset_bytes == component.bytes.len() {
            self.component_index += 1;
            self.offset_bytes = 0;
        }
        Some(chunk)
    }

    /// FRAME_END of a frame that is sent whole: status 0, every byte and its CRC.
    pub fn end_complete(&self) -> FrameEnd {
        self.end(
            0,
            self.components
                .iter()
                .map(|component| sum(component.bytes.len(), component.crc32c))
                .collect(),
        )
    }

    /// FRAME_END of a frame that is given up with status 1 or 2: what was sent so far.
    pub fn end_early(&self, status: u8) -> FrameEnd {
        let sent = |index: usize| match index.cmp(&self.component_index) {
            core::cmp::Ordering::Less => &self.components[index].bytes[..],
            core::cmp::Ordering::Equal => &self.components[index].bytes[..self.offset_bytes],
            core::cmp::Ordering::Greater => &[],
        };
        let sums = (0..self.components.len()).map(|index| sum(sent(index).len(), crc32c::crc32c(sent(index))));
        self.end(status, sums.collect())
    }

    /// Whether half of the frame's bytes are sent.
    pub fn is_half_sent(&self) -> bool {
        let before: usize = self.components[..self.component_index]
            .iter()
            .map(|component| component.bytes.len())
            .sum();
        let all: usize = self.components.iter().map(|component| component.bytes.len()).sum();
        2 * (before + self.offset_bytes) >= all
    }

    /// Damages a byte in the middle of the first component, whose CRC stays that of the undamaged bytes.
    pub fn damage(&mut self) {
        if let Some(component) = self.components.first_mut() {
            let middle = component.bytes.len() / 2;
            component.bytes[middle] ^= 0x10;
        }
    }

    fn end(&self, status: u8, components: Vec<ComponentSum>) -> FrameEnd {
        let head = &self.begin.head;
        let tail = FrameTail {
            frame_id: head.frame_id,
            trigger_id: head.trigger_id,
            status,
            reserved_1: Zero,
            valid_count: head.valid_count,
            component_count: components.len() as u16,
            reserved_2: Zero,
        };
        FrameEnd { tail, components }
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
        _ => (0x0108_0001, 1),
    }
}

/// Bytes of a pixel of a component kind.
pub fn pixel_bytes(kind: u16) -> u32 {
    format_of(kind).1
}

fn component_bytes(kind: u16, frame: &Frame) -> Vec<u8> {
    match kind {
        KIND_XYZ => frame
            .xyz_mm
            .iter()
            .flatten()
            .flat_map(|value_mm| value_mm.to_le_bytes())
            .collect(),
        KIND_INTENSITY => frame.intensity.clone(),
        KIND_MASK => frame.mask.clone(),
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
