//! Faults to inject: what goes wrong, and at which view or move.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::camera::trouble::CameraFault;

/// One thing that goes wrong in the simulated cell. Each of those with a view happens once.
///
/// The view of a robot fault counts accepted moves from 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// Something is wrong with one trigger of the camera.
    Camera(CameraFault),
    /// CONFIGURED echoes another exposure than was asked for.
    ConfigEcho,
    /// Another controller has the camera.
    ControllerBusy {
        /// Real seconds from the first refusal on; to the end where it is none.
        span_s: Option<f64>,
    },
    /// The camera is cold at first.
    ColdStart {
        /// Triggers after which it is warm.
        trigger_count: u32,
    },
    /// An alarm in the middle of a move.
    RobotAlarm {
        /// Alarm code of the controller.
        code: u32,
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// The emergency stop is pressed in the middle of a move, and stays pressed.
    Estop {
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// The robot controller answers nothing any more, from the answer to this move on.
    RobotSilent {
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// A share of the robot's answers gets lost.
    AnswerLost {
        /// Share of the answers, 0 to 1.
        fraction: f64,
    },
    /// Command remote is not set.
    RemoteOff,
    /// The servo power cannot be switched on.
    ServoRefused,
    /// The robot stops away from where it was sent, and says so.
    Elsewhere {
        /// Distance along the base's z, mm.
        distance_mm: f64,
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// A share of what client and robot send each other gets lost.
    NetLoss {
        /// Share of the pieces, 0 to 1.
        fraction: f64,
    },
    /// What client and robot send each other takes time.
    NetDelay {
        /// Time of each piece, real milliseconds.
        delay_ms: f64,
    },
    /// A share of the datagrams between client and robot comes twice.
    NetDuplicate {
        /// Share of the pieces, 0 to 1.
        fraction: f64,
    },
    /// A share of the datagrams between client and robot is overtaken by others.
    NetReorder {
        /// Share of the pieces, 0 to 1.
        fraction: f64,
    },
    /// A share of what client and robot send each other has a wrong bit.
    NetFlip {
        /// Share of the pieces, 0 to 1.
        fraction: f64,
    },
    /// Nothing passes between client and robot for a while.
    Stall {
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// The cell's door opens in the middle of a move, and stays open.
    Door {
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// A person presses hold at the pendant in the middle of a move, and does not release it.
    PendantHold {
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// Servo power goes off in the middle of a move; it can be switched on again.
    ServoDrop {
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// The robot controller is off for a while from the middle of a move on.
    PowerLoss {
        /// Real seconds.
        span_s: f64,
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// The robot controller refuses everything but reads as busy for a while from the middle of a move on.
    Busy {
        /// Real seconds.
        span_s: f64,
        /// Accepted move, counted from 0.
        view: u32,
    },
    /// The robot controller keeps back one block, or the answer to one, of a file transfer.
    FileStall {
        /// Block; 0 is the answer to the request of a file sent there.
        block: u32,
    },
}

/// Spelling and meaning of every fault, for people.
pub fn catalogue() -> impl Iterator<Item = (String, String)> {
    let others = CATALOGUE
        .iter()
        .map(|(spelling, meaning)| ((*spelling).to_owned(), (*meaning).to_owned()));
    CameraFault::catalogue().chain(others)
}

/// Faults but those of one trigger of the camera.
const CATALOGUE: [(&str, &str); 22] = [
    ("config-echo", "CONFIGURED echoes another exposure than was asked for"),
    (
        "controller-busy[=SECONDS]",
        "another controller has the camera: HELLO is refused, to the end or this long after the first (real seconds)",
    ),
    (
        "cold-start=COUNT",
        "the camera is cold at first, and warm after this many triggers",
    ),
    (
        "robot-alarm=CODE@MOVE",
        "an alarm in the middle of an accepted move, counted from 0",
    ),
    (
        "estop@MOVE",
        "the emergency stop is pressed in the middle of an accepted move, and stays pressed",
    ),
    (
        "robot-silent@MOVE",
        "the robot controller stops answering at this accepted move",
    ),
    (
        "answer-lost=FRACTION",
        "this share of the robot's answers is lost (0 to 1, seeded)",
    ),
    ("remote-off", "command remote is not set: the robot refuses every act"),
    ("servo-refused", "the servo power cannot be switched on"),
    ("elsewhere=MM@MOVE", "the robot stops this far above where it was sent"),
    (
        "net-loss=FRACTION",
        "this share of what client and robot send each other is lost; a stream sends it again, the serial line loses a byte",
    ),
    (
        "net-delay=MS",
        "everything between client and robot takes this long (real milliseconds)",
    ),
    (
        "net-duplicate=FRACTION",
        "this share of the datagrams between client and robot comes twice",
    ),
    (
        "net-reorder=FRACTION",
        "this share of the datagrams between client and robot comes 20 ms later, so that others overtake it",
    ),
    (
        "net-flip=FRACTION",
        "this share of what client and robot send each other has a wrong bit; a stream notices and sends it again",
    ),
    (
        "stall@MOVE",
        "nothing passes between client and robot for 2 s from this accepted move on, then all of it comes at once",
    ),
    (
        "door@MOVE",
        "the cell's door opens in the middle of an accepted move, and stays open: no servo power",
    ),
    (
        "pendant-hold@MOVE",
        "hold is pressed at the pendant in the middle of an accepted move, and stays pressed",
    ),
    (
        "servo-drop@MOVE",
        "servo power goes off in the middle of an accepted move; it can be switched on again",
    ),
    (
        "power-loss=SECONDS@MOVE",
        "the robot controller is off this long (real seconds) from the middle of an accepted move on",
    ),
    (
        "busy=SECONDS@MOVE",
        "the robot controller refuses all but reads with E444 this long (real seconds) from the middle of an accepted move on",
    ),
    (
        "file-stall@BLOCK",
        "the robot controller keeps back this block, or the answer to it, once",
    ),
];

/// Why a fault's text is not a fault.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FaultError {
    /// No fault has this name.
    #[error("no fault is called {kind:?}; there are:{}", Spellings)]
    UnknownKind {
        /// Name as written.
        kind: String,
    },
    /// The fault needs a value, a view, or has one too many; or it is out of range.
    #[error("{written:?} is not of the form {expected}")]
    Form {
        /// Text as written.
        written: String,
        /// Spelling of this kind.
        expected: String,
    },
}

impl FromStr for Fault {
    type Err = FaultError;

    fn from_str(written: &str) -> Result<Self, FaultError> {
        let (head, view) = match written.split_once('@') {
            Some((head, view)) => (head, Some(view)),
            None => (written, None),
        };
        let (kind, value) = match head.split_once('=') {
            Some((kind, value)) => (kind, Some(value)),
            None => (head, None),
        };
        let expected = catalogue()
            .map(|(spelling, _)| spelling)
            .find(|spelling| spelling.split(['=', '@', '[']).next() == Some(kind))
            .ok_or_else(|| FaultError::UnknownKind { kind: kind.to_owned() })?;
        let value_fits = value.is_some() == expected.contains('=') || expected.contains("[=");
        let well_formed = value_fits && view.is_some() == expected.contains('@');
        let form = || FaultError::Form {
            written: written.to_owned(),
            expected: expected.clone(),
        };
        if !well_formed {
            return Err(form());
        }
        let fault = if CameraFault::has_name(kind) {
            CameraFault::parse(kind, value.unwrap_or_default(), view.unwrap_or_default()).map(Self::Camera)
        } else {
            parse_kind(kind, value, view)
        };
        fault.ok_or_else(form)
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Camera(fault) => fault.fmt(f),
            Self::ConfigEcho => write!(f, "config-echo"),
            Self::ControllerBusy { span_s: None } => write!(f, "controller-busy"),
            Self::ControllerBusy { span_s: Some(span_s) } => write!(f, "controller-busy={span_s}"),
            Self::ColdStart { trigger_count } => write!(f, "cold-start={trigger_count}"),
            Self::RobotAlarm { code, view } => write!(f, "robot-alarm={code}@{view}"),
            Self::Estop { view } => write!(f, "estop@{view}"),
            Self::RobotSilent { view } => write!(f, "robot-silent@{view}"),
            Self::AnswerLost { fraction } => write!(f, "answer-lost={fraction}"),
            Self::RemoteOff => write!(f, "remote-off"),
            Self::ServoRefused => write!(f, "servo-refused"),
            Self::Elsewhere { distance_mm, view } => write!(f, "elsewhere={distance_mm}@{view}"),
            Self::NetLoss { fraction } => write!(f, "net-loss={fraction}"),
            Self::NetDelay { delay_ms } => write!(f, "net-delay={delay_ms}"),
            Self::NetDuplicate { fraction } => write!(f, "net-duplicate={fraction}"),
            Self::NetReorder { fraction } => write!(f, "net-reorder={fraction}"),
            Self::NetFlip { fraction } => write!(f, "net-flip={fraction}"),
            Self::Stall { view } => write!(f, "stall@{view}"),
            Self::Door { view } => write!(f, "door@{view}"),
            Self::PendantHold { view } => write!(f, "pendant-hold@{view}"),
            Self::ServoDrop { view } => write!(f, "servo-drop@{view}"),
            Self::PowerLoss { span_s, view } => write!(f, "power-loss={span_s}@{view}"),
            Self::Busy { span_s, view } => write!(f, "busy={span_s}@{view}"),
            Self::FileStall { block } => write!(f, "file-stall@{block}"),
        }
    }
}

/// The fault, or none where value or view is no number or out of range.
fn parse_kind(kind: &str, written: Option<&str>, view: Option<&str>) -> Option<Fault> {
    let value = written.unwrap_or_default();
    let view = match view {
        Some(view) => view.parse::<u32>().ok()?,
        None => 0,
    };
    let span = || {
        value
            .parse()
            .ok()
            .filter(|span: &f64| (0.0..=DELAY_MAX_S).contains(span))
    };
    let number = || value.parse::<f64>().ok().filter(|number| number.is_finite());
    let share = || number().filter(|fraction| (0.0..=1.0).contains(fraction));
    Some(match kind {
        "config-echo" => Fault::ConfigEcho,
        "controller-busy" => Fault::ControllerBusy {
            span_s: if written.is_some() { Some(span()?) } else { None },
        },
        "cold-start" => Fault::ColdStart {
            trigger_count: value.parse().ok().filter(|count| *count > 0)?,
        },
        "robot-alarm" => Fault::RobotAlarm {
            code: value.parse().ok().filter(|code| *code > 0)?,
            view,
        },
        "estop" => Fault::Estop { view },
        "robot-silent" => Fault::RobotSilent { view },
        "answer-lost" => Fault::AnswerLost { fraction: share()? },
        "remote-off" => Fault::RemoteOff,
        "servo-refused" => Fault::ServoRefused,
        "elsewhere" => Fault::Elsewhere {
            distance_mm: number().filter(|mm| mm.abs() <= ELSEWHERE_MAX_MM)?,
            view,
        },
        "net-loss" => Fault::NetLoss { fraction: share()? },
        "net-delay" => Fault::NetDelay {
            delay_ms: number().filter(|delay| (0.0..=DELAY_MAX_S * 1e3).contains(delay))?,
        },
        "net-duplicate" => Fault::NetDuplicate { fraction: share()? },
        "net-reorder" => Fault::NetReorder { fraction: share()? },
        "net-flip" => Fault::NetFlip { fraction: share()? },
        "stall" => Fault::Stall { view },
        "door" => Fault::Door { view },
        "pendant-hold" => Fault::PendantHold { view },
        "servo-drop" => Fault::ServoDrop { view },
        "power-loss" => Fault::PowerLoss { span_s: span()?, view },
        "busy" => Fault::Busy { span_s: span()?, view },
        "file-stall" => Fault::FileStall { block: view },
        _ => return None,
    })
}

/// Writes the catalogue's spellings, one a line.
struct Spellings;

impl fmt::Display for Spellings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        catalogue().try_for_each(|(spelling, meaning)| write!(f, "\n  {spelling:37} {meaning}"))
    }
}

const DELAY_MAX_S: f64 = 3600.0;
const ELSEWHERE_MAX_MM: f64 = 1000.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_of_the_catalogue_is_read_and_written_back() {
        for (spelling, _) in catalogue() {
            let written = spelling
                .replace("@VIEW", "@3")
                .replace("[:PHASE]", "")
                .replace("[=SECONDS]", "=1.5")
                .replace("COUNT", "7")
                .replace("@MOVE", "@3")
                .replace("@BLOCK", "@3")
                .replace("CODE", "402")
                .replace("SECONDS", "1.5")
                .replace("FRACTION", "0.25")
                .replace("MM", "2.5")
                .replace("MS", "2.5");
            let fault: Fault = written.parse().unwrap();
            assert_eq!(fault.to_string(), written);
        }
    }

    #[test]
    fn an_unknown_fault_is_answered_with_the_list_of_all() {
        let error = "camera-on-fire@3".parse::<Fault>().unwrap_err().to_string();
        for (spelling, _) in catalogue() {
            assert!(error.contains(&spelling), "{error}");
        }
    }

    #[test]
    fn a_missing_view_or_a_value_out_of_range_is_refused() {
        for written in [
            "camera-gone",
            "remote-off@3",
            "answer-lost=1.5",
            "late-frame=x@2",
            "robot-alarm@2",
            "estop=1@2",
        ] {
            assert!(
                matches!(written.parse::<Fault>(), Err(FaultError::Form { .. })),
                "{written}"
            );
        }
    }
}
