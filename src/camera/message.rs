//! Messages: what the client says and hears (section 4 of the page).

use super::payload::{PayloadError, PayloadReader, put_str8};
use super::settings::CameraSettings;
use serde::{Deserialize, Serialize};

/// Names one acquisition: `view_index << 16 | attempt`, so that a retake is another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TriggerId(pub u64);

impl TriggerId {
    /// The id of an attempt at a view.
    pub fn new(view_index: u32, attempt: u16) -> Self {
        Self(u64::from(view_index) << 16 | u64::from(attempt))
    }

    /// Which view.
    pub fn view_index(self) -> u32 {
        (self.0 >> 16) as u32
    }

    /// Which attempt, from 0.
    pub fn attempt(self) -> u16 {
        self.0 as u16
    }
}

/// The id that stands for "none" and "all".
pub const TRIGGER_ALL: u64 = u64::MAX;

/// What the client sends.
#[derive(Debug, Clone, PartialEq)]
pub enum ClientMessage {
    /// The greeting.
    Hello {
        /// Who we are.
        client_name: String,
    },
    /// Asks for the capabilities.
    GetCaps,
    /// The complete settings.
    Configure(CameraSettings),
    /// Arms for software triggers.
    Arm {
        /// The settings in force.
        config_id: u32,
    },
    /// Disarms.
    Disarm,
    /// Starts one acquisition.
    Trigger {
        /// Its name.
        trigger_id: TriggerId,
        /// The settings in force.
        config_id: u32,
        /// How long the frame is wanted, ms.
        deadline_ms: u32,
        /// For the server's log.
        tag: String,
    },
    /// Ends whatever acquisition is in flight.
    AbortAll,
    /// A sign of life.
    Ping {
        /// Our clock.
        sender_ns: u64,
    },
    /// Answers a PING.
    Pong {
        /// The server's clock, echoed.
        sender_ns: u64,
        /// Our clock.
        host_ns: u64,
    },
    /// Tells the server why we stop believing it.
    Error {
        /// The protocol's error code.
        code: u16,
        /// In words.
        text: String,
    },
    /// Goodbye.
    Bye {
        /// 1 done, 3 protocol error, 4 time-out.
        reason: u16,
        /// In words.
        text: String,
    },
}

impl ClientMessage {
    /// Type number and payload.
    pub fn encode(&self) -> (u16, Vec<u8>) {
        let mut payload = Vec::new();
        let kind = match self {
            Self::Hello { client_name } => {
                payload.extend_from_slice(&[1, 0, 1, 0, 1, 0, 0, 0]);
                put_str8(&mut payload, client_name);
                0x01
            }
            Self::GetCaps => 0x03,
            Self::Configure(settings) => {
                payload = settings.encode();
                0x10
            }
            Self::Arm { config_id } => {
                payload.extend_from_slice(&[1, 0, 0, 0]);
                payload.extend_from_slice(&config_id.to_le_bytes());
                0x12
            }
            Self::Disarm => 0x13,
            Self::Trigger {
                trigger_id,
                config_id,
                deadline_ms,
                tag,
            } => {
                payload.extend_from_slice(&trigger_id.0.to_le_bytes());
                payload.extend_from_slice(&trigger_id.view_index().to_le_bytes());
                payload.extend_from_slice(&config_id.to_le_bytes());
                payload.extend_from_slice(&deadline_ms.to_le_bytes());
                put_str8(&mut payload, tag);
                0x20
            }
            Self::AbortAll => {
                payload.extend_from_slice(&TRIGGER_ALL.to_le_bytes());
                0x40
            }
            Self::Ping { sender_ns } => {
                payload.extend_from_slice(&sender_ns.to_le_bytes());
                0x60
            }
            Self::Pong { sender_ns, host_ns } => {
                for value in [*sender_ns, 0, *host_ns] {
                    payload.extend_from_slice(&value.to_le_bytes());
                }
                0x61
            }
            Self::Error { code, text } => {
                payload.extend_from_slice(&0u32.to_le_bytes());
                payload.extend_from_slice(&TRIGGER_ALL.to_le_bytes());
                payload.extend_from_slice(&code.to_le_bytes());
                payload.extend_from_slice(&[0, 0]);
                payload.extend_from_slice(&[0; 8]);
                payload.extend_from_slice(&(text.len() as u16).to_le_bytes());
                payload.extend_from_slice(text.as_bytes());
                0x70
            }
            Self::Bye { reason, text } => {
                payload.extend_from_slice(&reason.to_le_bytes());
                put_str8(&mut payload, text);
                0x7F
            }
        };
        (kind, payload)
    }
}

/// What the client hears.
#[derive(Debug, Clone, PartialEq)]
pub enum ServerMessage {
    /// Greeting accepted.
    HelloOk(Greeting),
    /// Capabilities.
    Caps(Caps),
    /// Settings in force.
    Configured(Configured),
    /// Armed.
    Armed,
    /// Disarmed.
    Disarmed,
    /// Trigger accepted, or known already.
    TriggerOk(TriggerOk),
    /// The part may move.
    ExposureDone {
        /// Of which acquisition.
        trigger_id: TriggerId,
    },
    /// A frame begins.
    FrameBegin(Box<FrameBegin>),
    /// A piece of it.
    FrameChunk {
        /// Of which frame.
        frame_id: u64,
        /// Place in its component table.
        component_index: u16,
        /// From 0 in each component.
        chunk_index: u32,
        /// Bytes of the component before this chunk.
        offset_bytes: u64,
        /// The bytes.
        data: Vec<u8>,
    },
    /// A frame ends.
    FrameEnd(FrameEnd),
    /// An acquisition was aborted.
    Aborted {
        /// Which; [`TRIGGER_ALL`] when none was in flight.
        trigger_id: u64,
    },
    /// The camera's condition.
    Status(CameraStatus),
    /// Something happened.
    Event {
        /// What.
        code: u16,
        /// In words.
        text: String,
    },
    /// The server wants a sign of life.
    Ping {
        /// Its clock.
        sender_ns: u64,
    },
    /// Answers our PING.
    Pong {
        /// Our clock, echoed.
        sender_ns: u64,
        /// The device's clock.
        device_ns: u64,
    },
    /// Something went wrong.
    Error(CameraError),
    /// The server leaves.
    Bye {
        /// Why.
        reason: u16,
        /// In words.
        text: String,
    },
}

/// Who the camera is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Greeting {
    /// Nothing was measured.
    pub simulated: bool,
    /// New each time the bridge starts.
    pub boot_id: u64,
    /// Which calibration.
    pub calibration_id: u64,
    /// The largest frame it sends, bytes; at most 64 MiB.
    pub frame_bytes_max: u64,
    /// Vendor.
    pub vendor: String,
    /// Real model.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
}

/// What the camera can do, as far as we use it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Caps {
    /// Sensor width and height, pixels.
    pub sensor_px: [u16; 2],
    /// Nearest, nominal and farthest working distance along z, mm.
    pub working_distance_mm: [f32; 3],
    /// Point spacing at the nominal distance, unbinned, mm.
    pub spacing_mm: f32,
    /// Centre of projection of camera 1 in the camera frame, mm; NaN if unknown.
    pub camera_1_mm: [f32; 3],
    /// Components offered: bit n = kind n.
    pub components: u32,
    /// Name of the lens set.
    pub optics: String,
}

/// The settings in force and what they cost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configured {
    /// Names the settings.
    pub config_id: u32,
    /// From trigger to EXPOSURE_DONE, µs.
    pub predicted_exposure_us: u32,
    /// From trigger to FRAME_BEGIN, µs.
    pub predicted_total_us: u32,
    /// Bytes of one frame.
    pub frame_bytes: u64,
    /// The echo.
    pub settings: CameraSettings,
}

/// The answer to a trigger.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TriggerOk {
    /// Which acquisition.
    pub trigger_id: TriggerId,
    /// From now to EXPOSURE_DONE, µs.
    pub predicted_exposure_us: u32,
    /// From now to FRAME_BEGIN, µs.
    pub predicted_total_us: u32,
}

/// The head of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameBegin {
    /// Names the frame.
    pub frame_id: u64,
    /// The acquisition it belongs to.
    pub trigger_id: TriggerId,
    /// The settings it was taken with.
    pub config_id: u32,
    /// Device clock, ns.
    pub exposure_end_ns: u64,
    /// Flag bits of the page.
    pub frame_flags: u32,
    /// Columns.
    pub width_px: u32,
    /// Rows.
    pub height_px: u32,
    /// Pixels with 3D.
    pub valid_count: u32,
    /// Pixels overexposed.
    pub saturated_count: u32,
    /// The components that follow.
    pub components: Vec<Component>,
}

/// One component of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Component {
    /// What it is.
    pub kind: ComponentKind,
    /// How many chunks follow.
    pub chunk_count: u32,
    /// How many bytes.
    pub byte_count: u64,
}

/// Kinds of components that we ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComponentKind {
    /// f32 x, y, z.
    Xyz,
    /// Camera 1's picture.
    Intensity,
    /// Validity bits.
    Mask,
}

impl ComponentKind {
    /// The components that every configuration of ours asks for.
    pub const WANTED: u32 = 1 | 1 << 2 | 1 << 4;

    fn from_wire(kind: u16, format: u32) -> Option<Self> {
        match (kind, format) {
            (0, 0x0260_00C0) => Some(Self::Xyz),
            (2, 0x0108_0001) => Some(Self::Intensity),
            (4, 0x0108_0001) => Some(Self::Mask),
            _ => None,
        }
    }

    /// Bytes of one pixel.
    pub fn pixel_bytes(self) -> u64 {
        match self {
            Self::Xyz => 12,
            Self::Intensity | Self::Mask => 1,
        }
    }
}

/// The tail of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameEnd {
    /// Which frame.
    pub frame_id: u64,
    /// Which acquisition.
    pub trigger_id: TriggerId,
    /// 0 complete, 1 aborted, 2 failed.
    pub status: u8,
    /// Pixels with 3D.
    pub valid_count: u32,
    /// Bytes and CRC-32C of each component.
    pub components: Vec<(u64, u32)>,
}

/// The camera's condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraStatus {
    /// State number of the page.
    pub state: u8,
    /// Projector, camera 1, camera 2, board; `None` if unknown.
    pub temperature_c: [Option<f32>; 4],
    /// Triggers missed since the bridge started.
    pub missed_count: u32,
}

/// An ERROR message.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CameraError {
    /// The request it refuses, or 0.
    pub about_request_id: u32,
    /// The acquisition it ends, or [`TRIGGER_ALL`].
    pub trigger_id: u64,
    /// Code of section 6.
    pub code: u16,
    /// Trying again may help.
    pub retryable: bool,
    /// In words.
    pub text: String,
}

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
                fields.bytes(16)?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::settings::tests::PAGE_SETTINGS;
    use crate::camera::wire::HEADER_BYTES;
    use crate::vectors::a3dp;

    const PAGE_TRIGGER: TriggerId = TriggerId(5 << 16 | 1);

    fn heard(name: &str) -> ServerMessage {
        let bytes = a3dp(name);
        let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
        ServerMessage::decode(kind, &bytes[HEADER_BYTES..]).unwrap().unwrap()
    }

    #[test]
    fn what_the_client_says_equals_the_vectors_of_the_page() {
        let done = "done".to_owned();
        for (message, name) in [
            (
                ClientMessage::Hello {
                    client_name: "bladescan".into(),
                },
                "hello",
            ),
            (ClientMessage::GetCaps, "get_caps"),
            (ClientMessage::Configure(PAGE_SETTINGS), "configure"),
            (ClientMessage::Arm { config_id: 77 }, "arm"),
            (ClientMessage::Disarm, "disarm"),
            (
                ClientMessage::Trigger {
                    trigger_id: TriggerId::new(5, 1),
                    config_id: 77,
                    deadline_ms: 15_000,
                    tag: "view 5".into(),
                },
                "trigger",
            ),
            (ClientMessage::AbortAll, "abort"),
            (ClientMessage::Ping { sender_ns: 123_456_789 }, "ping"),
            (ClientMessage::Bye { reason: 1, text: done }, "bye"),
        ] {
            let vector = a3dp(name);
            let (kind, payload) = message.encode();
            assert_eq!(kind.to_le_bytes(), vector[6..8], "{name}");
            assert_eq!(payload, vector[HEADER_BYTES..], "{name}");
        }
    }

    #[test]
    fn what_the_server_says_on_the_page_is_understood() {
        let ServerMessage::HelloOk(greeting) = heard("hello_ok") else {
            panic!()
        };
        assert!(greeting.simulated);
        assert_eq!(
            (greeting.serial.as_str(), greeting.frame_bytes_max),
            ("SIM-0001", 64 << 20)
        );
        let ServerMessage::Caps(caps) = heard("caps") else {
            panic!()
        };
        assert_eq!((caps.sensor_px, caps.optics.as_str()), ([1440, 1080], "fine"));
        assert_eq!(caps.working_distance_mm, [200.0, 260.0, 320.0]);
        assert_eq!(caps.camera_1_mm, [0.0; 3]);
        assert_eq!((caps.spacing_mm, caps.components), (0.04, 0b10101));
        let ServerMessage::Configured(configured) = heard("configured") else {
            panic!()
        };
        assert_eq!((configured.config_id, configured.settings), (77, PAGE_SETTINGS));
        assert_eq!(configured.frame_bytes, 5_443_200);
        assert_eq!(heard("armed"), ServerMessage::Armed);
        assert_eq!(heard("disarmed"), ServerMessage::Disarmed);
        let ServerMessage::TriggerOk(accepted) = heard("trigger_ok") else {
            panic!()
        };
        assert_eq!(
            (accepted.trigger_id, accepted.predicted_total_us),
            (PAGE_TRIGGER, 208_000)
        );
        assert_eq!(
            heard("exposure_done"),
            ServerMessage::ExposureDone {
                trigger_id: PAGE_TRIGGER
            }
        );
        let ServerMessage::FrameBegin(begin) = heard("frame_begin") else {
            panic!()
        };
        assert_eq!((begin.width_px, begin.height_px, begin.valid_count), (2, 1, 1));
        assert_eq!(begin.components[0].byte_count, 24);
        let ServerMessage::FrameEnd(end) = heard("frame_end") else {
            panic!()
        };
        assert_eq!((end.status, end.components.len(), end.trigger_id), (0, 3, PAGE_TRIGGER));
        assert_eq!(
            heard("aborted"),
            ServerMessage::Aborted {
                trigger_id: PAGE_TRIGGER.0
            }
        );
        let ServerMessage::Status(status) = heard("status") else {
            panic!()
        };
        assert_eq!((status.state, status.temperature_c[3]), (2, None));
        let ServerMessage::Event { code: 5, text } = heard("event") else {
            panic!()
        };
        assert_eq!(text, "LED pause 200 ms");
        let ServerMessage::Pong { sender_ns, device_ns } = heard("pong") else {
            panic!()
        };
        assert_eq!((sender_ns, device_ns), (123_456_789, 6_000_000));
        let ServerMessage::Error(error) = heard("error") else {
            panic!()
        };
        assert_eq!((error.code, error.retryable, error.about_request_id), (202, true, 5));
    }

    #[test]
    fn cut_and_padded_payloads_are_refused_without_a_panic() {
        for name in [
            "hello_ok",
            "caps",
            "configured",
            "armed",
            "trigger_ok",
            "exposure_done",
            "frame_begin",
            "frame_end",
            "aborted",
            "status",
            "event",
            "pong",
            "error",
            "bye",
        ] {
            let bytes = a3dp(name);
            let kind = u16::from_le_bytes([bytes[6], bytes[7]]);
            let payload = &bytes[HEADER_BYTES..];
            for length in 0..payload.len() {
                assert!(
                    ServerMessage::decode(kind, &payload[..length]).is_err(),
                    "{name} cut to {length}"
                );
            }
            let mut long = payload.to_vec();
            long.push(0);
            assert!(ServerMessage::decode(kind, &long).is_err(), "{name} padded");
        }
    }
}
