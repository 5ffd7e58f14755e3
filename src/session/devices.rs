//! What recipe and station mean for the two conversations.

use super::{ArmSettings, JobSettings, Motion};
use crate::camera;
use crate::robot;
use crate::settings::{self, Recipe, Roi, Station};

/// The times and bounds of the conversation with the station's robot.
pub fn exchange_settings(station: &Station) -> robot::ExchangeSettings {
    let robot = &station.robot;
    robot::ExchangeSettings {
        protocol: match robot.protocol {
            settings::RobotProtocol::Hses => robot::Protocol::Hses,
            settings::RobotProtocol::HostControl => robot::Protocol::HostControl,
            settings::RobotProtocol::Serial { .. } => robot::Protocol::Serial,
        },
        answer_timeout_ms: ms(robot.answer_timeout_ns),
        ask_attempts: robot.ask_attempts,
        set_repeat_ms: ms(robot.hold_repeat_ns),
        set_timeout_ms: ms(robot.hold_timeout_ns),
    }
}

pub(super) fn arm_settings(station: &Station) -> ArmSettings {
    let robot = &station.robot;
    ArmSettings {
        motion: match &robot.motion {
            settings::Motion::Direct => Motion::Direct,
            settings::Motion::Job(job) => Motion::Job(JobSettings {
                name: job.name.clone(),
                position_first: job.position_first,
                variable_first: job.variable_first,
                patience: (ms(job.patience_ns) / JOB_TURN_MS) as i32,
            }),
        },
        tool: robot.tool,
        speed_mm_s: robot.speed_mm_s,
        rotation_speed_rad_s: robot.rotation_speed_rad_s,
        poll_interval_ms: ms(robot.poll_interval_ns),
        start_grace_ms: ms(robot.start_grace_ns),
        move_timeout_ms: ms(robot.move_timeout_ns),
        settle_ms: ms(robot.settle_ns),
        servo_timeout_ms: ms(robot.servo_timeout_ns),
        position_tolerance_mm: robot.position_tolerance_mm,
        rotation_tolerance_rad: robot.rotation_tolerance_rad,
        exchange: exchange_settings(station),
    }
}

/// The times and bounds of the conversation with the station's camera.
pub fn camera_times(station: &Station) -> camera::ExchangeSettings {
    let camera = &station.camera;
    camera::ExchangeSettings {
        connect_timeout_ms: ms(camera.connect_timeout_ns),
        reply_timeout_ms: ms(camera.reply_timeout_ns),
        frame_timeout_extra_ms: ms(camera.frame_timeout_extra_ns),
        ping_interval_ms: ms(camera.ping_interval_ns),
        dead_after_ms: ms(camera.dead_after_ns),
        reconnect_timeout_ms: ms(camera.reconnect_timeout_ns),
        device_timeout_ms: ms(camera.device_timeout_ns),
    }
}

/// What a recipe asks of the camera for one view.
pub fn camera_settings(recipe: &Recipe, view_index: usize) -> camera::CameraSettings {
    let camera = &recipe.camera;
    let exposure = camera.exposure_of(view_index);
    let (binning, roi_px) = match camera.roi {
        Roi::Binned => (true, [1440, 1080, 0, 0, 0, 0]),
        Roi::Rectangle {
            width_px,
            height_px,
            x_px,
            y_px,
        } => (false, [width_px, height_px, x_px, y_px, x_px, y_px]),
    };
    camera::CameraSettings {
        binning,
        roi_px,
        exposure_us: exposure.exposure_us,
        image_count: camera.image_count,
        hdr_us: [exposure.hdr_low_us.unwrap_or(0), exposure.hdr_high_us.unwrap_or(0)],
        compression: camera.compression as u8,
        led_percent: camera.led_percent,
        frame_time_ratio: camera.frame_time_ratio,
        score_threshold: camera.score_threshold,
        outlier_filter: camera.outlier_filter as u8,
        reconstruction_quality: camera.reconstruction_quality,
        pre_filtering: camera.pre_filtering,
        working_volume: camera.working_volume as u8,
        volume_of_interest: None,
        components: camera::COMPONENTS_WANTED,
    }
}

fn ms(ns: u64) -> u64 {
    ns / 1_000_000
}

/// One turn of the scan job's waiting loop (`docs/robot/README.md`).
const JOB_TURN_MS: u64 = 20;
