//! What the simulated camera says of itself.

use crate::camera::a3dp::{CHUNK_PAYLOAD_MAX, CONTROL_PAYLOAD_MAX};
use crate::camera::fields::{Str8, Zero};
use crate::camera::message::{Caps, HelloOk};
use crate::camera::optics::Optics;
use crate::camera::settings::{KIND_CONFIDENCE, KIND_INTENSITY, KIND_MASK, KIND_XYZ};

/// Greeting.
pub(super) fn hello_ok(role: u8, session_id: u32, boot_id: u64) -> HelloOk {
    let text = |text: &str| Str8(text.to_owned());
    HelloOk {
        version: VERSION,
        role,
        simulated: 1,
        session_id,
        boot_id,
        calibration_id: CALIBRATION_ID,
        calibration_date: 20_261_121,
        clock_hz: 1_000_000_000,
        control_payload_max: CONTROL_PAYLOAD_MAX,
        chunk_payload_max: CHUNK_PAYLOAD_MAX,
        frame_bytes_max: 67_108_864,
        vendor: text("bladescan"),
        model: text("SIMULATED A5000"),
        serial: text("SIM-0001"),
        firmware: text(env!("CARGO_PKG_VERSION")),
        sdk_version: text("none"),
    }
}

/// Abilities; the figures of the lens set are those of the optics.
pub(super) fn caps(optics: &Optics) -> Caps {
    let centre = |centre_mm: nalgebra::Point3<f64>| [centre_mm.x as f32, centre_mm.y as f32, centre_mm.z as f32];
    Caps {
        sensor_px: [1440, 1080],
        roi_min_px: [80, 4],
        roi_step_px: [8, 4],
        exposure_min_us: 10,
        exposure_max_us: 50_000,
        exposure_default_us: 1000,
        image_count_min: 12,
        image_count_max: 60,
        image_count_default: 24,
        led_max_percent: 100,
        led_recommended_percent: 25,
        hdr_slot_count: 2,
        hdr_in_free_run: 0,
        reserved: Zero,
        near_mm: optics.near_mm as f32,
        nominal_mm: optics.nominal_mm as f32,
        far_mm: optics.far_mm as f32,
        spacing_mm: optics.spacing_mm(optics.nominal_mm) as f32,
        camera_1_mm: [0.0; 3],
        camera_2_mm: centre(optics.camera_2_mm),
        projector_mm: centre(optics.projector_mm),
        components: 1 << KIND_XYZ | 1 << KIND_INTENSITY | 1 << KIND_CONFIDENCE | 1 << KIND_MASK,
        outlier_filters: 0b1111,
        compressions: 0b1111,
        working_volumes: 0b11,
        optics: Str8(optics.name.to_owned()),
    }
}

/// Calibration that the simulated camera claims.
pub(super) const CALIBRATION_ID: u64 = 4242;
/// Rate at which chunks leave.
pub(super) const LINK_MBIT_S: u32 = 1000;
/// A device is there, nothing is armed.
pub(super) const STATE_IDLE: u8 = 1;
/// A trigger is taken.
pub(super) const STATE_ARMED: u8 = 2;
/// The one version that is spoken.
pub(super) const VERSION: [u8; 2] = [1, 0];
/// Role that may say everything.
pub(super) const ROLE_CONTROLLER: u8 = 1;
/// Role that only listens.
pub(super) const ROLE_OBSERVER: u8 = 2;
