//! Faults: what stops a run, as the operator and the journal see it.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Something that a run cannot go on with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// Which entry of `docs/faults.md`.
    pub code: FaultCode,
    /// What was seen, in words.
    pub seen: String,
}

/// One code for each entry of `docs/faults.md`; a test holds the two together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FaultCode {
    /// Nothing listens at the robot's address.
    RobotUnreachable,
    /// The robot does not answer.
    RobotSilent,
    /// The robot's answers make no sense, three times in a row.
    RobotGarbled,
    /// An alarm or error is active.
    RobotAlarm,
    /// The robot does not accept commands (mode, command remote).
    RobotNotRemote,
    /// Servo power did not come on, or went off.
    RobotServo,
    /// The robot refused a command.
    RobotRefused,
    /// The robot stands elsewhere than commanded.
    RobotElsewhere,
    /// A move did not end in time.
    RobotLate,
    /// A hold was not confirmed.
    RobotNotHeld,
    /// The scan job on the controller is missing, of another version, or has stopped.
    RobotJob,
    /// A simulated robot where a real one belongs, or the other way round.
    RobotIdentity,
    /// Nothing listens at the camera's address.
    CameraUnreachable,
    /// The camera's connection ended.
    CameraLost,
    /// The camera does not answer.
    CameraSilent,
    /// The camera broke the protocol.
    CameraProtocol,
    /// The camera's settings are not those of the recipe.
    CameraSettings,
    /// The camera refused the session or the settings.
    CameraRefused,
    /// The bridge answers, but its camera cannot be used.
    CameraNotReady,
    /// Three views, or three acquisitions, in a row gave no frame.
    CameraFailing,
    /// The wrong optics, or a working distance that does not fit.
    CameraOptics,
    /// A simulated camera where a real one belongs, or the other way round.
    CameraIdentity,
    /// After a restart the blade does not sit where it sat.
    BladeMoved,
    /// The journal cannot be written.
    Journal,
    /// A job panicked: a bug of ours.
    JobPanicked,
}

impl FaultCode {
    /// Every code, for the documentation's test.
    pub const ALL: [Self; 25] = [
        Self::RobotUnreachable,
        Self::RobotSilent,
        Self::RobotGarbled,
        Self::RobotAlarm,
        Self::RobotNotRemote,
        Self::RobotServo,
        Self::RobotRefused,
        Self::RobotElsewhere,
        Self::RobotLate,
        Self::RobotNotHeld,
        Self::RobotJob,
        Self::RobotIdentity,
        Self::CameraUnreachable,
        Self::CameraLost,
        Self::CameraSilent,
        Self::CameraProtocol,
        Self::CameraSettings,
        Self::CameraRefused,
        Self::CameraNotReady,
        Self::CameraFailing,
        Self::CameraOptics,
        Self::CameraIdentity,
        Self::BladeMoved,
        Self::Journal,
        Self::JobPanicked,
    ];

    /// The code as it is written everywhere, for example `robot-alarm`.
    pub fn name(self) -> &'static str {
        match self {
            Self::RobotUnreachable => "robot-unreachable",
            Self::RobotSilent => "robot-silent",
            Self::RobotGarbled => "robot-garbled",
            Self::RobotAlarm => "robot-alarm",
            Self::RobotNotRemote => "robot-not-remote",
            Self::RobotServo => "robot-servo",
            Self::RobotRefused => "robot-refused",
            Self::RobotElsewhere => "robot-elsewhere",
            Self::RobotLate => "robot-late",
            Self::RobotNotHeld => "robot-not-held",
            Self::RobotJob => "robot-job",
            Self::RobotIdentity => "robot-identity",
            Self::CameraUnreachable => "camera-unreachable",
            Self::CameraLost => "camera-lost",
            Self::CameraSilent => "camera-silent",
            Self::CameraProtocol => "camera-protocol",
            Self::CameraSettings => "camera-settings",
            Self::CameraRefused => "camera-refused",
            Self::CameraNotReady => "camera-not-ready",
            Self::CameraFailing => "camera-failing",
            Self::CameraOptics => "camera-optics",
            Self::CameraIdentity => "camera-identity",
            Self::BladeMoved => "blade-moved",
            Self::Journal => "journal",
            Self::JobPanicked => "job-panicked",
        }
    }
}

impl Fault {
    /// A fault with what was seen.
    pub fn new(code: FaultCode, seen: impl Into<String>) -> Self {
        Self {
            code,
            seen: seen.into(),
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.code.name(), self.seen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_has_an_entry_in_the_page_and_the_page_has_no_other() {
        let page = include_str!("../docs/faults.md");
        let headings: Vec<&str> = page.lines().filter_map(|line| line.strip_prefix("## ")).collect();
        let codes: Vec<&str> = FaultCode::ALL.iter().map(|code| code.name()).collect();
        assert_eq!(headings, codes);
        for section in page.split("\n## ").skip(1) {
            let name = section.lines().next().unwrap();
            for part in ["**Seen:**", "**Means:**", "**Do:**"] {
                assert!(section.contains(part), "{name} lacks {part}");
            }
        }
    }

    #[test]
    fn the_name_is_the_serialised_form() {
        for code in FaultCode::ALL {
            assert_eq!(serde_json::to_string(&code).unwrap(), format!("\"{}\"", code.name()));
        }
    }
}
