//! Head, pieces and tail of a frame (4.9 to 4.12).

use super::TriggerId;
use crate::camera::payload::{Field, PayloadError, PayloadReader, payload_codes, payload_struct};

payload_struct! {
    /// The part may move: EXPOSURE_DONE (4.9).
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    ExposureDone {
        /// Of which acquisition.
        trigger_id: TriggerId;
        /// Device clock, ns.
        exposure_begin_ns: u64;
        /// Device clock, ns.
        exposure_end_ns: u64;
    }
}

/// The head of a frame (4.10). Unit and axes are not here: millimetres in the camera frame, or the message is refused.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameBegin {
    /// Names the frame.
    pub frame_id: u64,
    /// The acquisition it belongs to.
    pub trigger_id: TriggerId,
    /// The view it is for.
    pub view_id: u32,
    /// The settings it was taken with.
    pub config_id: u32,
    /// Device clock, ns.
    pub exposure_begin_ns: u64,
    /// Device clock, ns.
    pub exposure_end_ns: u64,
    /// Device clock, ns.
    pub reconstruction_end_ns: u64,
    /// What was special about it.
    pub flags: FrameFlags,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Place of the region in camera 1's picture: x, y.
    pub camera_1_px: [u16; 2],
    /// Place of the region in camera 2's picture: x, y.
    pub camera_2_px: [u16; 2],
    /// Which calibration.
    pub calibration_id: u64,
    /// RANGE: metric = value · scale + offset per axis; 1 for XYZ.
    pub scale: [f64; 3],
    /// RANGE: metric = value · scale + offset per axis; 0 for XYZ.
    pub offset: [f64; 3],
    /// Pixels with 3D.
    pub valid_count: u32,
    /// Pixels overexposed.
    pub saturated_count: u32,
    /// Projector, camera 1, camera 2, board; `None` if unknown.
    pub temperature_c: [Option<f32>; 4],
    /// The components that follow, ascending by kind.
    pub components: Vec<Component>,
}

/// What was special about a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameFlags {
    /// Exposure passes: 1 to 3.
    pub pass_count: u8,
    /// Width and height are halved.
    pub binned: bool,
    /// The device says that its data is worse than usual.
    pub degraded: bool,
    /// Taken before the device was warm.
    pub warm_up_incomplete: bool,
    /// Nothing was measured.
    pub simulated: bool,
}

impl Field for FrameFlags {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        let bits = fields.field::<u32>()?;
        if bits & !0xFFF != 0 || !(1..=3).contains(&(bits & 0xFF)) {
            return Err(PayloadError::Value {
                field: "frame_flags",
                value: u64::from(bits),
            });
        }
        let bit = |place: u32| bits >> place & 1 == 1;
        Ok(Self {
            pass_count: bits as u8,
            binned: bit(8),
            degraded: bit(9),
            warm_up_incomplete: bit(10),
            simulated: bit(11),
        })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        let bit = |set: bool, place: u32| u32::from(set) << place;
        let bits = u32::from(self.pass_count)
            | bit(self.binned, 8)
            | bit(self.degraded, 9)
            | bit(self.warm_up_incomplete, 10)
            | bit(self.simulated, 11);
        bits.write(bytes);
    }
}

impl Field for FrameBegin {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        let mut begin = Self {
            frame_id: fields.field()?,
            trigger_id: fields.field()?,
            view_id: fields.field()?,
            config_id: fields.field()?,
            exposure_begin_ns: fields.field()?,
            exposure_end_ns: fields.field()?,
            reconstruction_end_ns: fields.field()?,
            flags: {
                expect(fields.field::<u8>()?, CLOCK_DEVICE, "the clock")?;
                expect(fields.field::<u8>()?, UNIT_MM, "the length unit")?;
                expect(fields.field::<u8>()?, AXES_CAMERA, "the axes")?;
                fields.reserved(1)?;
                fields.field()?
            },
            width_px: fields.field()?,
            height_px: fields.field()?,
            camera_1_px: fields.field()?,
            camera_2_px: fields.field()?,
            calibration_id: fields.field()?,
            scale: fields.field()?,
            offset: fields.field()?,
            valid_count: fields.field()?,
            saturated_count: fields.field()?,
            temperature_c: fields.field()?,
            components: Vec::new(),
        };
        let component_count = fields.field::<u16>()?;
        expect(fields.field::<u16>()?, ENTRY_BYTES, "the length of a component entry")?;
        fields.reserved(4)?;
        for _ in 0..component_count {
            let component = Component::read(fields, begin.width_px, begin.height_px)?;
            if begin.components.last().is_some_and(|last| last.kind >= component.kind) {
                return Err(PayloadError::Value {
                    field: "a component out of order, kind",
                    value: component.kind as u64,
                });
            }
            begin.components.push(component);
        }
        Ok(begin)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.frame_id.write(bytes);
        self.trigger_id.write(bytes);
        self.view_id.write(bytes);
        self.config_id.write(bytes);
        self.exposure_begin_ns.write(bytes);
        self.exposure_end_ns.write(bytes);
        self.reconstruction_end_ns.write(bytes);
        bytes.extend_from_slice(&[CLOCK_DEVICE, UNIT_MM, AXES_CAMERA, 0]);
        self.flags.write(bytes);
        self.width_px.write(bytes);
        self.height_px.write(bytes);
        self.camera_1_px.write(bytes);
        self.camera_2_px.write(bytes);
        self.calibration_id.write(bytes);
        self.scale.write(bytes);
        self.offset.write(bytes);
        self.valid_count.write(bytes);
        self.saturated_count.write(bytes);
        self.temperature_c.write(bytes);
        (self.components.len() as u16).write(bytes);
        ENTRY_BYTES.write(bytes);
        bytes.extend_from_slice(&[0; 4]);
        for component in &self.components {
            component.write(bytes, self.width_px);
        }
    }
}

/// One component of a frame. Its format and row stride follow from the kind and the width.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component {
    /// What it is.
    pub kind: ComponentKind,
    /// How many chunks follow.
    pub chunk_count: u32,
    /// How many bytes: pixels × bytes per pixel.
    pub byte_count: u64,
}

impl Component {
    fn read(fields: &mut PayloadReader<'_>, width_px: u32, height_px: u32) -> Result<Self, PayloadError> {
        let kind = fields.field::<u16>()?;
        fields.reserved(2)?;
        let format = fields.field::<u32>()?;
        let (stride, chunk_count) = (fields.field::<u32>()?, fields.field::<u32>()?);
        let byte_count = fields.field::<u64>()?;
        fields.reserved(8)?;
        let kind = ComponentKind::from_wire(kind, format).ok_or(PayloadError::Value {
            field: "a component kind",
            value: u64::from(kind),
        })?;
        let row = u64::from(width_px) * kind.pixel_bytes();
        if row.checked_mul(u64::from(height_px)) != Some(byte_count) || u64::from(stride) != row {
            return Err(PayloadError::Value {
                field: "the byte count of a component",
                value: byte_count,
            });
        }
        Ok(Self {
            kind,
            chunk_count,
            byte_count,
        })
    }

    fn write(&self, bytes: &mut Vec<u8>, width_px: u32) {
        (self.kind as u16).write(bytes);
        bytes.extend_from_slice(&[0; 2]);
        self.kind.format().write(bytes);
        (width_px * self.kind.pixel_bytes() as u32).write(bytes);
        self.chunk_count.write(bytes);
        self.byte_count.write(bytes);
        bytes.extend_from_slice(&[0; 8]);
    }
}

/// Kinds of components, by their number on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ComponentKind {
    /// f32 x, y, z; invalid = NaN in all three.
    Xyz = 0,
    /// u16 range; invalid where the mask says so.
    Range = 1,
    /// Camera 1's picture.
    Intensity = 2,
    /// Score × 255.
    Confidence = 3,
    /// Validity bits.
    Mask = 4,
}

impl ComponentKind {
    /// Every kind, ascending.
    pub const ALL: [Self; 5] = [Self::Xyz, Self::Range, Self::Intensity, Self::Confidence, Self::Mask];

    /// The components that every configuration of ours asks for.
    pub const WANTED: u32 = Self::Xyz.bit() | Self::Intensity.bit() | Self::Mask.bit();

    /// Its bit in a set of components.
    pub const fn bit(self) -> u32 {
        1 << self as u32
    }

    /// Its pixel format (PFNC).
    pub fn format(self) -> u32 {
        match self {
            Self::Xyz => 0x0260_00C0,
            Self::Range => 0x0110_00B8,
            Self::Confidence => 0x0108_00C6,
            Self::Intensity | Self::Mask => 0x0108_0001,
        }
    }

    /// Bytes of one pixel.
    pub fn pixel_bytes(self) -> u64 {
        match self {
            Self::Xyz => 12,
            Self::Range => 2,
            Self::Intensity | Self::Confidence | Self::Mask => 1,
        }
    }

    fn from_wire(kind: u16, format: u32) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|candidate| *candidate as u16 == kind && candidate.format() == format)
    }
}

/// A piece of a frame (4.11).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameChunk<'a> {
    /// Of which frame.
    pub frame_id: u64,
    /// Place in its component table.
    pub component_index: u16,
    /// From 0 in each component.
    pub chunk_index: u32,
    /// Bytes of the component before this chunk.
    pub offset_bytes: u64,
    /// The bytes; at least one.
    pub data: &'a [u8],
}

impl<'a> FrameChunk<'a> {
    pub(super) fn read(fields: &mut PayloadReader<'a>) -> Result<Self, PayloadError> {
        let (frame_id, component_index) = (fields.field()?, fields.field()?);
        fields.reserved(2)?;
        let chunk = Self {
            frame_id,
            component_index,
            chunk_index: fields.field()?,
            offset_bytes: fields.field()?,
            data: fields.rest(),
        };
        match chunk.data {
            [] => Err(PayloadError::Value {
                field: "the length of a chunk",
                value: 0,
            }),
            _ => Ok(chunk),
        }
    }

    pub(super) fn write(&self, bytes: &mut Vec<u8>) {
        bytes.reserve(24 + self.data.len());
        self.frame_id.write(bytes);
        self.component_index.write(bytes);
        bytes.extend_from_slice(&[0; 2]);
        self.chunk_index.write(bytes);
        self.offset_bytes.write(bytes);
        bytes.extend_from_slice(self.data);
    }
}

/// The tail of a frame (4.12).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameEnd {
    /// Which frame.
    pub frame_id: u64,
    /// Which acquisition.
    pub trigger_id: TriggerId,
    /// How it ended.
    pub status: FrameStatus,
    /// Pixels with 3D.
    pub valid_count: u32,
    /// What was really sent of each component.
    pub components: Vec<ComponentEnd>,
}

payload_codes! {
    /// How a frame ended.
    FrameStatus, "the status of a frame" {
        /// Every byte was sent.
        Complete = 0,
        /// Aborted on the way.
        Aborted = 1,
        /// It failed on the way.
        Failed = 2,
    }
}

payload_struct! {
    /// What was sent of one component.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    ComponentEnd {
        /// Bytes.
        byte_count: u64;
        /// CRC-32C of them.
        crc: u32, pad 4;
    }
}

impl Field for FrameEnd {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        let (frame_id, trigger_id, status) = (fields.field()?, fields.field()?, fields.field()?);
        fields.reserved(3)?;
        let (valid_count, component_count) = (fields.field()?, fields.field::<u16>()?);
        fields.reserved(2)?;
        let mut components = Vec::new();
        for _ in 0..component_count {
            components.push(fields.field()?);
        }
        Ok(Self {
            frame_id,
            trigger_id,
            status,
            valid_count,
            components,
        })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.frame_id.write(bytes);
        self.trigger_id.write(bytes);
        self.status.write(bytes);
        bytes.extend_from_slice(&[0; 3]);
        self.valid_count.write(bytes);
        (self.components.len() as u16).write(bytes);
        bytes.extend_from_slice(&[0; 2]);
        for component in &self.components {
            component.write(bytes);
        }
    }
}

/// Fails unless a field holds the one value that the page allows.
fn expect<N: PartialEq + Into<u64>>(found: N, expected: N, field: &'static str) -> Result<(), PayloadError> {
    if found == expected {
        return Ok(());
    }
    Err(PayloadError::Value {
        field,
        value: found.into(),
    })
}

const CLOCK_DEVICE: u8 = 0;
const UNIT_MM: u8 = 1;
const AXES_CAMERA: u8 = 1;
const ENTRY_BYTES: u16 = 32;
