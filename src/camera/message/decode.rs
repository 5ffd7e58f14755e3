//! Reading what the server says.

use super::{
    CameraError, CameraStatus, Caps, Component, ComponentKind, Configured, FrameBegin, FrameEnd, Greeting,
    ServerMessage, TriggerId, TriggerOk,
};
use crate::camera::payload::{PayloadError, PayloadReader};
use crate::camera::settings::CameraSettings;

impl ServerMessage {
    /// Reads a message; `Ok(None)` for a type the client does not know.
    pub fn decode(kind: u16, payload: &[u8]) -> Result<Option<Self>, PayloadError> {
        let mut fields = PayloadReader::new(payload);
        let message = match kind {
            0x02 => Self::HelloOk(hello_ok(&mut fields)?),
            0x04 => Self::Caps(caps(&mut fields)?),
            0x11 => Self::Configured(Configured {
                config_id: fields.u32()?,
                predicted_exposure_us: fields.u32()?,
                predicted_total_us: fields.u32()?,
                frame_bytes: fields.u64()?,
                settings: CameraSettings::decode(fields.rest())?,
            }),
            0x14 | 0x15 => {
                fields.u8()?;
                fields.reserved(3)?;
                if kind == 0x14 { Self::Armed } else { Self::Disarmed }
            }
            0x21 => {
                let trigger_id = TriggerId(fields.u64()?);
                fields.u8()?;
                fields.reserved(3)?;
                Self::TriggerOk(TriggerOk {
                    trigger_id,
                    predicted_exposure_us: fields.u32()?,
                    predicted_total_us: fields.u32()?,
                })
            }
            0x22 => {
                let trigger_id = TriggerId(fields.u64()?);
                fields.bytes(16)?;
                Self::ExposureDone { trigger_id }
            }
            0x30 => Self::FrameBegin(Box::new(frame_begin(&mut fields)?)),
            0x31 => {
                let (frame_id, component_index) = (fields.u64()?, fields.u16()?);
                fields.reserved(2)?;
                Self::FrameChunk {
                    frame_id,
                    component_index,
                    chunk_index: fields.u32()?,
                    offset_bytes: fields.u64()?,
                    data: fields.rest().to_vec(),
                }
            }
            0x32 => Self::FrameEnd(frame_end(&mut fields)?),
            0x41 => {
                let trigger_id = fields.u64()?;
                fields.u8()?;
                fields.reserved(3)?;
                Self::Aborted { trigger_id }
            }
            0x51 => Self::Status(status(&mut fields)?),
            0x52 => {
                let code = fields.u16()?;
                fields.reserved(2)?;
                fields.bytes(16 + 4)?; // trigger id, device clock, duration
                Self::Event {
                    code,
                    text: fields.str16()?,
                }
            }
            0x60 => Self::Ping {
                sender_ns: fields.u64()?,
            },
            0x61 => {
                let (sender_ns, device_ns) = (fields.u64()?, fields.u64()?);
                fields.u64()?;
                Self::Pong { sender_ns, device_ns }
            }
            0x70 => Self::Error(error(&mut fields)?),
            0x7F => Self::Bye {
                reason: fields.u16()?,
                text: fields.str8()?,
            },
            _ => return Ok(None),
        };
        fields.end()?;
        Ok(Some(message))
    }
}

fn hello_ok(fields: &mut PayloadReader<'_>) -> Result<Greeting, PayloadError> {
    let (major, minor) = (fields.u8()?, fields.u8()?);
    if (major, minor) != (1, 0) {
        return Err(PayloadError::Value {
            field: "the version (major * 256 + minor)",
            value: u64::from(major) * 256 + u64::from(minor),
        });
    }
    fields.u8()?; // role: we asked for the controller's and an ERROR would have said no
    let simulated = fields.u8()? != 0;
    fields.u32()?; // session id: nothing refers to it in 1.0
    let (boot_id, calibration_id) = (fields.u64()?, fields.u64()?);
    fields.bytes(4 * 4)?; // calibration date, clock, payload limits: fixed by the page or only for people
    let frame_bytes_max = fields.u64()?.min(FRAME_BYTES_LIMIT);
    let greeting = Greeting {
        simulated,
        boot_id,
        calibration_id,
        frame_bytes_max,
        vendor: fields.str8()?,
        model: fields.str8()?,
        serial: fields.str8()?,
        firmware: fields.str8()?,
    };
    fields.str8()?; // version of the vendor's SDK
    Ok(greeting)
}

fn caps(fields: &mut PayloadReader<'_>) -> Result<Caps, PayloadError> {
    let sensor_px = [fields.u16()?, fields.u16()?];
    fields.bytes(4 * 2 + 3 * 4 + 3 * 2 + 4 + 2)?; // ranges: the camera itself refuses what lies outside
    let working_distance_mm = fields.f32x3()?;
    let spacing_mm = fields.f32()?;
    let camera_1_mm = fields.f32x3()?;
    fields.bytes(2 * 12)?; // camera 2 and projector: not used yet
    let components = fields.u32()?;
    fields.bytes(3 * 4)?;
    Ok(Caps {
        sensor_px,
        working_distance_mm,
        spacing_mm,
        camera_1_mm,
        components,
        optics: fields.str8()?,
    })
}

fn frame_begin(fields: &mut PayloadReader<'_>) -> Result<FrameBegin, PayloadError> {
    let (frame_id, trigger_id) = (fields.u64()?, TriggerId(fields.u64()?));
    fields.u32()?; // view id: part of the trigger id
    let config_id = fields.u32()?;
    fields.u64()?; // exposure begin
    let exposure_end_ns = fields.u64()?;
    fields.u64()?; // reconstruction end
    fields.u8()?; // clock id
    for (field, expected) in [("the length unit", 1), ("the axes", 1)] {
        let found = fields.u8()?;
        if found != expected {
            return Err(PayloadError::Value {
                field,
                value: u64::from(found),
            });
        }
    }
    fields.reserved(1)?;
    let frame_flags = fields.u32()?;
    let (width_px, height_px) = (fields.u32()?, fields.u32()?);
    fields.bytes(4 * 2 + 8 + 6 * 8)?; // region of interest, calibration id, scale and offset (of RANGE only)
    let (valid_count, saturated_count) = (fields.u32()?, fields.u32()?);
    fields.bytes(4 * 4)?; // temperatures: STATUS brings them
    let (component_count, entry_len) = (fields.u16()?, fields.u16()?);
    fields.reserved(4)?;
    if entry_len != 32 {
        return Err(PayloadError::Value {
            field: "the length of a component entry",
            value: u64::from(entry_len),
        });
    }
    let pixels = u64::from(width_px) * u64::from(height_px);
    let mut components = Vec::new();
    for _ in 0..component_count {
        let kind = fields.u16()?;
        fields.reserved(2)?;
        let format = fields.u32()?;
        let stride = fields.u32()?;
        let chunk_count = fields.u32()?;
        let byte_count = fields.u64()?;
        fields.reserved(8)?;
        let kind = ComponentKind::from_wire(kind, format).ok_or(PayloadError::Value {
            field: "a component kind",
            value: u64::from(kind),
        })?;
        let expected = pixels.checked_mul(kind.pixel_bytes());
        if expected != Some(byte_count) || u64::from(stride) != u64::from(width_px) * kind.pixel_bytes() {
            return Err(PayloadError::Value {
                field: "the byte count of a component",
                value: byte_count,
            });
        }
        components.push(Component {
            kind,
            chunk_count,
            byte_count,
        });
    }
    Ok(FrameBegin {
        frame_id,
        trigger_id,
        config_id,
        exposure_end_ns,
        frame_flags,
        width_px,
        height_px,
        valid_count,
        saturated_count,
        components,
    })
}

fn frame_end(fields: &mut PayloadReader<'_>) -> Result<FrameEnd, PayloadError> {
    let (frame_id, trigger_id, status) = (fields.u64()?, TriggerId(fields.u64()?), fields.u8()?);
    fields.reserved(3)?;
    let (valid_count, component_count) = (fields.u32()?, fields.u16()?);
    fields.reserved(2)?;
    let mut components = Vec::new();
    for _ in 0..component_count {
        components.push((fields.u64()?, fields.u32()?));
        fields.reserved(4)?;
    }
    Ok(FrameEnd {
        frame_id,
        trigger_id,
        status,
        valid_count,
        components,
    })
}

fn status(fields: &mut PayloadReader<'_>) -> Result<CameraStatus, PayloadError> {
    let state = fields.u8()?;
    fields.u8()?;
    fields.reserved(2)?;
    let mut temperature_c = [None; 4];
    for slot in &mut temperature_c {
        *slot = Some(fields.f32()?).filter(|value| value.is_finite());
    }
    fields.bytes(4 * 4)?; // warm-up, trigger and frame counts
    let missed_count = fields.u32()?;
    fields.bytes(3 * 4 + 2)?;
    fields.reserved(2)?;
    Ok(CameraStatus {
        state,
        temperature_c,
        missed_count,
    })
}

fn error(fields: &mut PayloadReader<'_>) -> Result<CameraError, PayloadError> {
    let (about_request_id, trigger_id, code) = (fields.u32()?, fields.u64()?, fields.u16()?);
    fields.u8()?; // phase: the text says it to people
    let retryable = fields.u8()? != 0;
    fields.bytes(8)?; // retry_after, vendor code
    Ok(CameraError {
        about_request_id,
        trigger_id,
        code,
        retryable,
        text: fields.str16()?,
    })
}

/// No frame is larger than this, whatever the greeting says.
const FRAME_BYTES_LIMIT: u64 = 64 << 20;
