//! Payloads of the A3DP messages, one structure each (`docs/protocols/camera.md`, section 4).

use crate::camera::fields::{Field, FieldError, Rest, Str8, Str16, Zero, wire_struct};

wire_struct! {
    /// Greeting of a client.
    pub struct Hello {
        /// Lowest version spoken: major, minor.
        pub min_version: [u8; 2],
        /// Highest version spoken: major, minor.
        pub max_version: [u8; 2],
        /// 1 controller, 2 observer.
        pub role: u8,
        /// 0.
        pub reserved: Zero<3>,
        /// Names the run; 0 from an observer.
        pub run_id: u64,
        /// 1 to 64 bytes.
        pub client_name: Str8,
    }
}

wire_struct! {
    /// Greeting of the server.
    pub struct HelloOk {
        /// Version in force: major, minor.
        pub version: [u8; 2],
        /// Role granted.
        pub role: u8,
        /// 1 = nothing was measured.
        pub simulated: u8,
        /// Count of the session.
        pub session_id: u32,
        /// New each time the bridge starts.
        pub boot_id: u64,
        /// Calibration in force.
        pub calibration_id: u64,
        /// year·10000 + month·100 + day.
        pub calibration_date: u32,
        /// 1,000,000,000.
        pub clock_hz: u32,
        /// Longest payload but of chunks.
        pub control_payload_max: u32,
        /// Longest payload of a chunk.
        pub chunk_payload_max: u32,
        /// Largest frame.
        pub frame_bytes_max: u64,
        /// Maker.
        pub vendor: Str8,
        /// Model.
        pub model: Str8,
        /// Serial number.
        pub serial: Str8,
        /// Version of the firmware.
        pub firmware: Str8,
        /// Version of the vendor's SDK.
        pub sdk_version: Str8,
    }
}

wire_struct! {
    /// What the camera can do.
    pub struct Caps {
        /// Width and height of the sensor.
        pub sensor_px: [u16; 2],
        /// Least width and height of a region of interest.
        pub roi_min_px: [u16; 2],
        /// Steps of x and width, of y and height.
        pub roi_step_px: [u16; 2],
        /// Shortest exposure.
        pub exposure_min_us: u32,
        /// Longest exposure.
        pub exposure_max_us: u32,
        /// Usual exposure.
        pub exposure_default_us: u32,
        /// Fewest images of a pass.
        pub image_count_min: u16,
        /// Most images of a pass.
        pub image_count_max: u16,
        /// Usual images of a pass.
        pub image_count_default: u16,
        /// Brightest light.
        pub led_max_percent: u8,
        /// Light that does not age the head.
        pub led_recommended_percent: u8,
        /// Exposure passes beside the first.
        pub hdr_slot_count: u8,
        /// Whether they work in free run.
        pub hdr_in_free_run: u8,
        /// 0.
        pub reserved: Zero<2>,
        /// Nearest working distance.
        pub near_mm: f32,
        /// Nominal working distance.
        pub nominal_mm: f32,
        /// Farthest working distance.
        pub far_mm: f32,
        /// Spacing of points at the nominal distance.
        pub spacing_mm: f32,
        /// Centre of projection of camera 1, camera frame.
        pub camera_1_mm: [f32; 3],
        /// Centre of projection of camera 2, camera frame.
        pub camera_2_mm: [f32; 3],
        /// Centre of projection of the projector, camera frame.
        pub projector_mm: [f32; 3],
        /// Bit n: component kind n is offered.
        pub components: u32,
        /// Bit n: outlier filter n is allowed.
        pub outlier_filters: u32,
        /// Bit n: compression n is allowed.
        pub compressions: u32,
        /// Bit n: working volume n is allowed.
        pub working_volumes: u32,
        /// Name of the lens set.
        pub optics: Str8,
    }
}

wire_struct! {
    /// Settings in force, and what they mean.
    pub struct Configured {
        /// Not 0, new for each.
        pub config_id: u32,
        /// Exposure phase in real time.
        pub predicted_exposure_us: u32,
        /// Exposure and reconstruction in real time.
        pub predicted_total_us: u32,
        /// Bytes of all components.
        pub frame_bytes: u64,
        /// Settings as tag-length-value records, ascending tags.
        pub settings: Rest,
    }
}

wire_struct! {
    /// Asks for readiness.
    pub struct Arm {
        /// 1 software trigger.
        pub mode: u8,
        /// 0.
        pub reserved: Zero<3>,
        /// Settings that must be in force.
        pub config_id: u32,
    }
}

wire_struct! {
    /// State after ARM or DISARM.
    pub struct StateNow {
        /// State of section 3.
        pub state: u8,
        /// 0.
        pub reserved: Zero<3>,
    }
}

wire_struct! {
    /// Asks for one acquisition.
    pub struct Trigger {
        /// Chosen by the client, once for each acquisition.
        pub trigger_id: u64,
        /// View it belongs to.
        pub view_id: u32,
        /// Settings that must be in force.
        pub config_id: u32,
        /// How long the frame is wanted; 0 = no limit.
        pub deadline_ms: u32,
        /// For the log, at most 64 bytes.
        pub tag: Str8,
    }
}

wire_struct! {
    /// Accepts a trigger.
    pub struct TriggerOk {
        /// Trigger accepted.
        pub trigger_id: u64,
        /// 0 new, 1 in flight already, 2 done already.
        pub repeated: u8,
        /// 0.
        pub reserved: Zero<3>,
        /// Exposure phase in real time.
        pub predicted_exposure_us: u32,
        /// Exposure and reconstruction in real time.
        pub predicted_total_us: u32,
    }
}

wire_struct! {
    /// The part may move.
    pub struct ExposureDone {
        /// Trigger that is exposed.
        pub trigger_id: u64,
        /// First light.
        pub exposure_begin_ns: u64,
        /// Last light.
        pub exposure_end_ns: u64,
    }
}

wire_struct! {
    /// Head of a frame, before its component table.
    pub struct FrameHead {
        /// Count of the frame.
        pub frame_id: u64,
        /// Trigger it answers.
        pub trigger_id: u64,
        /// View it belongs to.
        pub view_id: u32,
        /// Settings it was taken with.
        pub config_id: u32,
        /// First light.
        pub exposure_begin_ns: u64,
        /// Last light.
        pub exposure_end_ns: u64,
        /// End of the computation.
        pub reconstruction_end_ns: u64,
        /// 0 device clock.
        pub clock_id: u8,
        /// 1 mm.
        pub unit: u8,
        /// 1 the page's camera frame.
        pub axes: u8,
        /// 0.
        pub reserved_1: Zero<1>,
        /// Passes, binned, degraded, warm-up incomplete, simulated.
        pub frame_flags: u32,
        /// Columns.
        pub width_px: u32,
        /// Rows.
        pub height_px: u32,
        /// First column and row of camera 1's region.
        pub camera_1_px: [u16; 2],
        /// First column and row of camera 2's region.
        pub camera_2_px: [u16; 2],
        /// Calibration in force.
        pub calibration_id: u64,
        /// For RANGE; 1.
        pub scale: [f64; 3],
        /// For RANGE; 0.
        pub offset: [f64; 3],
        /// Pixels with coordinates.
        pub valid_count: u32,
        /// Pixels beyond full scale.
        pub saturated_count: u32,
        /// Projector, camera 1, camera 2, board.
        pub temperature_c: [f32; 4],
        /// Entries that follow.
        pub component_count: u16,
        /// 32.
        pub entry_len: u16,
        /// 0.
        pub reserved_2: Zero<4>,
    }
}

wire_struct! {
    /// One component of a frame.
    pub struct ComponentEntry {
        /// Kind of section 4.10.
        pub kind: u16,
        /// 0.
        pub reserved_1: Zero<2>,
        /// PFNC code.
        pub format: u32,
        /// Bytes of a row.
        pub row_stride_bytes: u32,
        /// Chunks to come.
        pub chunk_count: u32,
        /// Bytes to come.
        pub byte_count: u64,
        /// 0.
        pub reserved_2: Zero<8>,
    }
}

/// Announces a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameBegin {
    /// Everything but the table; its count is that of `components`.
    pub head: FrameHead,
    /// Components in ascending order of kind.
    pub components: Vec<ComponentEntry>,
}

wire_struct! {
    /// Piece of a component, before its data.
    pub struct ChunkHead {
        /// Frame it belongs to.
        pub frame_id: u64,
        /// Index into the table.
        pub component_index: u16,
        /// 0.
        pub reserved: Zero<2>,
        /// Count within the component.
        pub chunk_index: u32,
        /// Bytes of the component before it.
        pub offset_bytes: u64,
    }
}

wire_struct! {
    /// Piece of a component.
    pub struct FrameChunk {
        /// Where it belongs.
        pub head: ChunkHead,
        /// At least 1 byte.
        pub data: Rest,
    }
}

wire_struct! {
    /// Tail of a frame, before its component table.
    pub struct FrameTail {
        /// Frame that ends.
        pub frame_id: u64,
        /// Trigger it answers.
        pub trigger_id: u64,
        /// 0 complete, 1 aborted, 2 failed.
        pub status: u8,
        /// 0.
        pub reserved_1: Zero<3>,
        /// Pixels with coordinates.
        pub valid_count: u32,
        /// Entries that follow.
        pub component_count: u16,
        /// 0.
        pub reserved_2: Zero<2>,
    }
}

wire_struct! {
    /// What was sent of one component.
    pub struct ComponentSum {
        /// Its bytes.
        pub byte_count: u64,
        /// Their CRC-32C.
        pub crc32c: u32,
        /// 0.
        pub reserved: Zero<4>,
    }
}

/// Ends a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameEnd {
    /// Everything but the table; its count is that of `components`.
    pub tail: FrameTail,
    /// Components as in the table of FRAME_BEGIN.
    pub components: Vec<ComponentSum>,
}

wire_struct! {
    /// Answers a FETCH.
    pub struct FetchOk {
        /// Trigger asked for.
        pub trigger_id: u64,
        /// 1 in flight, 2 stored.
        pub state: u8,
        /// 0.
        pub reserved: Zero<3>,
        /// Predicted time to FRAME_BEGIN, real µs; 0 when stored.
        pub remaining_us: u32,
    }
}

wire_struct! {
    /// What an ABORT caught.
    pub struct Aborted {
        /// Trigger that ends.
        pub trigger_id: u64,
        /// Phase it was in; 0 none.
        pub phase: u8,
        /// 0.
        pub reserved: Zero<3>,
    }
}

wire_struct! {
    /// State of the camera.
    pub struct Status {
        /// State of section 3.
        pub state: u8,
        /// Triggers waiting.
        pub queue_count: u8,
        /// 0.
        pub reserved_1: Zero<2>,
        /// Projector, camera 1, camera 2, board.
        pub temperature_c: [f32; 4],
        /// Warm-up so far.
        pub warm_up_done_s: u32,
        /// Warm-up needed.
        pub warm_up_required_s: u32,
        /// Triggers accepted.
        pub trigger_count: u32,
        /// Frames sent whole.
        pub frame_count: u32,
        /// Triggers missed.
        pub missed_count: u32,
        /// Time-outs of the vendor's SDK.
        pub vendor_timeout_count: u32,
        /// Packets lost on the way from the head.
        pub lost_packet_count: u32,
        /// Rate of the link to the head.
        pub link_mbit_s: u32,
        /// Code of the last ERROR; 0 none.
        pub last_error: u16,
        /// 0.
        pub reserved_2: Zero<2>,
    }
}

wire_struct! {
    /// Something happened.
    pub struct Event {
        /// Code of section 4.14.
        pub code: u16,
        /// 0.
        pub reserved: Zero<2>,
        /// Trigger it concerns; [`NO_TRIGGER`].
        pub trigger_id: u64,
        /// When.
        pub device_ns: u64,
        /// How long it lasts, if known; else 0.
        pub duration_ms: u32,
        /// For people.
        pub text: Str16,
    }
}

wire_struct! {
    /// Answer to a PING.
    pub struct Pong {
        /// Clock of the PING.
        pub sender_ns: u64,
        /// Device clock; 0 from a client.
        pub device_ns: u64,
        /// Clock of the host.
        pub host_ns: u64,
    }
}

wire_struct! {
    /// Refuses a request or ends an acquisition.
    pub struct ErrorReport {
        /// Request refused; 0 none.
        pub about_request_id: u32,
        /// Trigger that ends; [`NO_TRIGGER`].
        pub trigger_id: u64,
        /// Code of section 6.
        pub code: u16,
        /// Phase it happened in.
        pub phase: u8,
        /// 1 = another attempt may succeed.
        pub retryable: u8,
        /// When to try again.
        pub retry_after_ms: u32,
        /// Code of the vendor's SDK.
        pub vendor_code: i32,
        /// For people.
        pub text: Str16,
    }
}

wire_struct! {
    /// Ends the connection.
    pub struct Bye {
        /// 1 done, 2 shutting down, 3 protocol error, 4 time-out, 5 refused, 6 replaced.
        pub reason: u16,
        /// For people.
        pub text: Str8,
    }
}

impl Field for FrameBegin {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        let head = FrameHead::read(bytes)?;
        if usize::from(head.entry_len) != ENTRY_BYTES {
            return Err(FieldError::Malformed);
        }
        let components = (0..head.component_count)
            .map(|_| Field::read(bytes))
            .collect::<Result<_, _>>()?;
        Ok(Self { head, components })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.head.write(bytes);
        self.components.iter().for_each(|component| component.write(bytes));
    }
}

impl Field for FrameEnd {
    fn read(bytes: &mut &[u8]) -> Result<Self, FieldError> {
        let tail = FrameTail::read(bytes)?;
        let components = (0..tail.component_count)
            .map(|_| Field::read(bytes))
            .collect::<Result<_, _>>()?;
        Ok(Self { tail, components })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.tail.write(bytes);
        self.components.iter().for_each(|component| component.write(bytes));
    }
}

/// "None" in ERROR and EVENT, "all" in ABORT and ABORTED.
pub const NO_TRIGGER: u64 = u64::MAX;
/// Bytes of one entry of FRAME_BEGIN's table.
pub const ENTRY_BYTES: usize = 32;
