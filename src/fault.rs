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

/// How the measurement can go on after a fault: the best that is still possible.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WayBack {
    /// Once the cause is removed, `bladescan resume` goes on with the run.
    Resume,
    /// The run cannot go on, or it would make no sense: another one is begun.
    NewRun,
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
        self.entry().0
    }

    /// How the measurement can go on after it.
    pub fn way_back(self) -> WayBack {
        self.entry().1
    }

    /// What the operator is to do, as in `docs/faults.md`.
    pub fn remedy(self) -> &'static str {
        self.entry().2
    }

    fn entry(self) -> (&'static str, WayBack, &'static str) {
        use WayBack::{NewRun, Resume};
        match self {
            Self::RobotUnreachable => (
                "robot-unreachable",
                Resume,
                "check robot.address in the station file, the cable, and that the HSES function is on (maintenance mode).",
            ),
            Self::RobotSilent => (
                "robot-silent",
                Resume,
                "look at the arm first; use the emergency stop if it moves. Then check network and controller.",
            ),
            Self::RobotGarbled => (
                "robot-garbled",
                Resume,
                "check the address; the bytes are in the recording.",
            ),
            Self::RobotAlarm => ("robot-alarm", Resume, "remove the cause, reset on the pendant."),
            Self::RobotNotRemote => (
                "robot-not-remote",
                Resume,
                "turn the key to REMOTE and set CMD REMOTE SEL (#82015) on the pendant.",
            ),
            Self::RobotServo => ("robot-servo", Resume, "release the stop, close the doors."),
            Self::RobotRefused => ("robot-refused", Resume, "as the message says."),
            Self::RobotElsewhere => (
                "robot-elsewhere",
                Resume,
                "check the pendant for messages, the tool number and the workspace.",
            ),
            Self::RobotLate => (
                "robot-late",
                Resume,
                "check the speed override; raise the time-out if the move is that long.",
            ),
            Self::RobotNotHeld => (
                "robot-not-held",
                Resume,
                "press the emergency stop. Then find out why the network failed.",
            ),
            Self::RobotJob => (
                "robot-job",
                Resume,
                "put docs/robot/BLADESCAN.JBI on the controller, end other jobs at the pendant, see that the variables of the station file are free. After state 3 look for what held bladescan up (a disk, a network) before going on.",
            ),
            Self::RobotIdentity => (
                "robot-identity",
                NewRun,
                "correct the station file. A dry run never moves a real robot.",
            ),
            Self::CameraUnreachable => (
                "camera-unreachable",
                Resume,
                "start the bridge on the vision PC; check camera.address.",
            ),
            Self::CameraLost => (
                "camera-lost",
                Resume,
                "check the vision PC; the half-received frame was thrown away.",
            ),
            Self::CameraSilent => ("camera-silent", Resume, "restart the bridge."),
            Self::CameraProtocol => (
                "camera-protocol",
                Resume,
                "check the bridge's version against docs/protocols/camera.md.",
            ),
            Self::CameraSettings => (
                "camera-settings",
                Resume,
                "correct the recipe, or close the other program.",
            ),
            Self::CameraRefused => ("camera-refused", Resume, "as the message says."),
            Self::CameraNotReady => (
                "camera-not-ready",
                Resume,
                "as the message says; close other programs on the vision PC, let the camera cool down, switch it off and on.",
            ),
            Self::CameraFailing => (
                "camera-failing",
                Resume,
                "look at the blade and the camera; take a single frame by hand.",
            ),
            Self::CameraOptics => (
                "camera-optics",
                NewRun,
                "take the recipe for this camera, or change the lens set.",
            ),
            Self::CameraIdentity => ("camera-identity", NewRun, "correct the station file."),
            Self::BladeMoved => (
                "blade-moved",
                Resume,
                "look at grip and camera. If the blade sits differently, begin a new run; run.check_translation_max_mm and run.check_rotation_max_deg of the recipe say how far is too far.",
            ),
            Self::Journal => ("journal", Resume, "free space."),
            Self::JobPanicked => ("job-panicked", NewRun, "send us the recording."),
        }
    }
}

impl WayBack {
    /// What the operator does once the cause is removed.
    pub fn words(self) -> &'static str {
        match self {
            Self::Resume => "then go on with this run: bladescan resume, with the folder of the run",
            Self::NewRun => "then begin a new run: this one cannot go on",
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
            for part in ["**Seen:**", "**Means:**", "**Do:**", "**Back:**"] {
                assert!(section.contains(part), "{name} lacks {part}");
            }
        }
    }

    /// What stands in an entry of the page after `part`, in one line without marks.
    fn said(section: &str, part: &str) -> String {
        let text = section.split(part).nth(1).unwrap().split("\n**").next().unwrap();
        let (mut plain, mut rest) = (String::new(), text);
        // Of a link only its words are said.
        while let Some((before, link)) = rest.split_once('[') {
            let (words, after) = link.split_once("](").unwrap();
            plain.push_str(before);
            plain.push_str(words);
            rest = after.split_once(')').unwrap().1;
        }
        plain.push_str(rest);
        let plain = plain.replace(['*', '`'], "");
        plain.split_whitespace().collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn the_operator_is_told_what_the_page_says() {
        let page = include_str!("../docs/faults.md");
        for (section, code) in page.split("\n## ").skip(1).zip(FaultCode::ALL) {
            assert_eq!(code.remedy(), said(section, "**Do:**"), "{}", code.name());
            let way = match code.way_back() {
                WayBack::Resume => "resume: ",
                WayBack::NewRun => "new run: ",
            };
            let back = said(section, "**Back:**");
            assert!(back.starts_with(way), "{}: {back}", code.name());
        }
    }

    #[test]
    fn the_name_is_the_serialised_form() {
        for code in FaultCode::ALL {
            assert_eq!(serde_json::to_string(&code).unwrap(), format!("\"{}\"", code.name()));
        }
    }
}
