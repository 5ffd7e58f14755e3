//! What the server answers.

use super::TriggerId;
use crate::camera::payload::{Field, PayloadError, PayloadReader, payload_codes, payload_struct};
use crate::camera::settings::CameraSettings;
use serde::{Deserialize, Serialize};

payload_struct! {
    /// Who the camera is: HELLO_OK (4.2).
    #[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
    Greeting {
        /// The version chosen: major, minor.
        version: [u8; 2];
        /// The role given.
        role: u8;
        /// Nothing is measured.
        simulated: bool;
        /// Names the connection.
        session_id: u32;
        /// New each time the bridge starts.
        boot_id: u64;
        /// Which calibration.
        calibration_id: u64;
        /// year · 10000 + month · 100 + day; 0 = unknown.
        calibration_date: u32;
        /// Ticks of the device clock in a second.
        clock_hz: u32;
        /// The longest control payload, bytes.
        control_payload_max: u32;
        /// The longest FRAME_CHUNK payload, bytes.
        chunk_payload_max: u32;
        /// The largest frame it sends, bytes; at most 64 MiB.
        frame_bytes_max: u64;
        /// Vendor.
        vendor: String;
        /// Real model.
        model: String;
        /// Serial number.
        serial: String;
        /// Firmware version.
        firmware: String;
        /// Version of the vendor's software.
        sdk_version: String;
    }
}

payload_struct! {
    /// What the camera can do (4.3).
    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    Caps {
        /// Sensor width and height, pixels.
        sensor_px: [u16; 2];
        /// Least width and height of the region of interest, pixels.
        roi_min_px: [u16; 2];
        /// Steps of its x and width, and of its y and height, pixels.
        roi_step_px: [u16; 2];
        /// Shortest exposure, µs.
        exposure_min_us: u32;
        /// Longest exposure, µs.
        exposure_max_us: u32;
        /// Usual exposure, µs.
        exposure_default_us: u32;
        /// Fewest images of a frame.
        image_count_min: u16;
        /// Most images of a frame.
        image_count_max: u16;
        /// Usual number of images.
        image_count_default: u16;
        /// Brightest LED setting, percent.
        led_max_percent: u8;
        /// Brightest LED setting without pauses for cooling, percent.
        led_recommended_percent: u8;
        /// Exposure passes beside the main one.
        hdr_slot_count: u8;
        /// Whether they work while running freely.
        hdr_in_free_run: bool, pad 2;
        /// Nearest, nominal and farthest working distance along z, mm.
        working_distance_mm: [f32; 3];
        /// Point spacing at the nominal distance, unbinned, mm.
        spacing_mm: f32;
        /// Centre of projection of camera 1 in the camera frame, mm; NaN if unknown.
        camera_1_mm: [f32; 3];
        /// The same of camera 2.
        camera_2_mm: [f32; 3];
        /// The same of the projector.
        projector_mm: [f32; 3];
        /// Components offered: bit n = kind n.
        components: u32;
        /// Outlier filters offered: bit n = value n.
        outlier_filters: u32;
        /// Compressions offered: bit n = value n.
        compressions: u32;
        /// Working volumes offered: bit n = value n.
        working_volumes: u32;
        /// Name of the lens set.
        optics: String;
    }
}

/// The settings in force and what they cost: CONFIGURED (4.5).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configured {
    /// Names the settings; not 0.
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

impl Field for Configured {
    fn read(fields: &mut PayloadReader<'_>) -> Result<Self, PayloadError> {
        Ok(Self {
            config_id: fields.field()?,
            predicted_exposure_us: fields.field()?,
            predicted_total_us: fields.field()?,
            frame_bytes: fields.field()?,
            settings: CameraSettings::decode_ascending(fields.rest())?,
        })
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        self.config_id.write(bytes);
        self.predicted_exposure_us.write(bytes);
        self.predicted_total_us.write(bytes);
        self.frame_bytes.write(bytes);
        bytes.extend_from_slice(&self.settings.encode());
    }
}

payload_codes! {
    /// Whether a trigger started something (4.8).
    Repeated, "repeated" {
        /// Newly accepted.
        New = 0,
        /// In flight already.
        InFlight = 1,
        /// Done already.
        Done = 2,
    }
}

payload_struct! {
    /// The answer to a trigger (4.8).
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    TriggerOk {
        /// Which acquisition.
        trigger_id: TriggerId;
        /// Whether it started anything.
        repeated: Repeated, pad 3;
        /// From now to EXPOSURE_DONE, µs.
        predicted_exposure_us: u32;
        /// From now to FRAME_BEGIN, µs.
        predicted_total_us: u32;
    }
}

payload_codes! {
    /// Where a fetched frame is (4.16).
    FetchState, "the state of a fetched frame" {
        /// Its messages come to this connection when they are due.
        InFlight = 1,
        /// It follows at once.
        Stored = 2,
    }
}

payload_struct! {
    /// The answer to FETCH (4.16).
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    FetchOk {
        /// Which acquisition.
        trigger_id: TriggerId;
        /// Where its frame is.
        state: FetchState, pad 3;
        /// From now to FRAME_BEGIN, µs; 0 when stored.
        remaining_us: u32;
    }
}

payload_struct! {
    /// The answer to ABORT (3.2).
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    Aborted {
        /// Which acquisition; [`super::TRIGGER_ALL`] when none was in flight.
        trigger_id: u64;
        /// Where it was caught.
        phase: AcquisitionPhase, pad 3;
    }
}

payload_codes! {
    /// How far an acquisition is.
    AcquisitionPhase, "a phase" {
        /// None is in flight.
        None = 0,
        /// Not acknowledged yet.
        Acknowledge = 1,
        /// Patterns are projected.
        Exposure = 2,
        /// Points are computed.
        Reconstruction = 3,
        /// The frame is on its way.
        Transfer = 4,
    }
}
