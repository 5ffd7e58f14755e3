//! What a simulated controller is built with.

use crate::fault::Fault;
use crate::robot::pose::Pose;

/// Everything that is fixed before the controller is switched on.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Where the arm stands at first.
    pub home: Pose,
    /// Lowest x, y, z a target may have, µm.
    pub workspace_min_um: [i32; 3],
    /// Highest x, y, z a target may have, µm.
    pub workspace_max_um: [i32; 3],
    /// Seconds of the robot in one second of the clock; positive.
    pub speed: f64,
    /// Seeds the loss of answers.
    pub seed: u64,
    /// What goes wrong; faults of the camera are ignored.
    pub faults: Vec<Fault>,
    /// Jobs in the directory at first: name without extension, text of the file.
    pub jobs: Vec<(String, String)>,
    /// What the sources leave open, or differ between controllers.
    pub options: Options,
}

impl Default for Settings {
    /// An arm in the middle of a workspace of two metres, in real time, without faults and without jobs.
    fn default() -> Self {
        Self {
            home: Pose::from_mm_deg([800.0, 0.0, 900.0], [0.0; 3]),
            workspace_min_um: [-2_000_000; 3],
            workspace_max_um: [2_000_000; 3],
            speed: 1.0,
            seed: 1,
            faults: Vec::new(),
            jobs: Vec::new(),
            options: Options::default(),
        }
    }
}

/// What the sources leave open, or differ between controllers. The default is the strict reading, where
/// the protocol page has no other.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Writes of variables, registers and inputs need command remote. No source says; the strict reading is yes.
    pub writes_need_remote: bool,
    /// Transfers and deletions of files need command remote (0xE2B2).
    pub files_need_remote: bool,
    /// Switching a hold on needs command remote. A stop should need no permission: no.
    pub hold_needs_remote: bool,
    /// An emergency stop leaves an alarm behind that must be reset after its release. The sources model it so, the
    /// protocol page does not: no.
    pub estop_latches_alarm: bool,
    /// An undefined command, attribute or instance is answered with status 0x1F and A000, A002, A001 instead of status
    /// 0x08, 0x09, 0x28.
    pub errors_in_added_status: bool,
    /// 32-byte string variables (0x8C, 0x30C). The sources disagree whether a DX200 has them.
    pub has_long_strings: bool,
    /// Alarms with sub-texts (0x30A, 0x30B), known of newer controllers only.
    pub has_alarm_sub_texts: bool,
    /// Variables of each of the kinds B, I, D, R and S.
    pub scalar_variable_count: u16,
    /// Variables of each of the kinds P, BP and EX.
    pub position_variable_count: u16,
    /// Servo power goes off after this much idleness, in seconds of the controller.
    pub servo_sleep_s: Option<f64>,
    /// A file transfer whose other side is silent this long is dropped, in real seconds.
    pub file_stall_s: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            writes_need_remote: true,
            files_need_remote: true,
            hold_needs_remote: false,
            estop_latches_alarm: false,
            errors_in_added_status: false,
            has_long_strings: false,
            has_alarm_sub_texts: false,
            scalar_variable_count: 200,
            position_variable_count: 128,
            servo_sleep_s: None,
            file_stall_s: 10.0,
        }
    }
}
