//! What goes wrong with the camera: which trouble, and at which phase of which trigger.

use std::fmt;

/// One trouble of one trigger. It happens once.
///
/// Written `NAME[=VALUE]@VIEW[.ATTEMPT][:PHASE]`: view and attempt are the two halves of the trigger id; attempt 0 and the
/// trouble's own phase are meant where nothing is said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraFault {
    /// What goes wrong.
    pub trouble: Trouble,
    /// Upper half of the trigger id.
    pub view: u32,
    /// Lower half of the trigger id.
    pub attempt: u16,
    /// When.
    pub phase: Phase,
}

/// Phase of a trigger (the protocol page's, and one before them). What happens in a phase of some length happens in the
/// middle of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// TRIGGER has come and is not looked at yet.
    Request,
    /// The trigger is accepted, TRIGGER_OK is due.
    Acknowledge,
    /// Patterns are projected; its message is EXPOSURE_DONE.
    Exposure,
    /// Points are computed; its message is FRAME_BEGIN.
    Reconstruction,
    /// The frame is on its way; its message is the FRAME_CHUNK after half of the bytes.
    Transfer,
}

/// What can go wrong with one trigger. Spans are real seconds, whatever the speed of the simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// The controller's connection closes; in the transfer, in the middle of a chunk.
    Gone,
    /// Nothing is read from the controller's connection and nothing sent on it any more; it stays open.
    Silent,
    /// The bridge starts anew: every connection closes, with another boot id nothing is remembered.
    Restart,
    /// The bridge says BYE 2 to everyone and closes, and serves again at once.
    Kicked,
    /// The device starts anew: RESETTING for this long.
    Reset {
        /// Seconds, which EVENT 3 tells.
        span_s: f64,
    },
    /// The device is away: OFFLINE for this long.
    Lost {
        /// Seconds, which EVENT 3 does not tell.
        span_s: f64,
    },
    /// The device does not work any more: FAULT.
    Broken,
    /// An ERROR comes instead of what is due.
    Error {
        /// A3DP error code.
        code: u16,
    },
    /// The trigger is missed: EVENT 1 and ERROR 401.
    Missed,
    /// The device is too hot: EVENT 2 and ERROR 502, and 502 for every trigger within this time.
    Hot {
        /// Seconds.
        span_s: f64,
    },
    /// The vendor's SDK times out (402, 403), and its device counts as in use (503) for this long.
    VendorTimeout {
        /// Seconds.
        span_s: f64,
    },
    /// The projector pauses in mid-exposure, and EVENT 5 says so.
    Pause {
        /// Seconds.
        span_s: f64,
    },
    /// What ends the phase comes later, and nothing says so.
    Late {
        /// Seconds.
        delay_s: f64,
    },
    /// A byte of the frame is damaged: its component's CRC does not agree.
    CorruptComponent,
    /// The message of the phase has a payload that its CRC does not agree with.
    CorruptPayload,
    /// The message of the phase has a header that its CRC does not agree with.
    CorruptHeader,
    /// The message of the phase comes twice, with the same count.
    DuplicateSeq,
    /// A count is left out before the message of the phase.
    SkipSeq,
    /// The message of the phase claims a payload longer than any may be.
    Oversize,
    /// An older frame comes in the place of the one that is due, which goes to the store. Without an older one nothing happens.
    OlderFrame,
    /// The frame comes twice.
    DoubleFrame,
    /// EXPOSURE_DONE comes twice.
    DoubleExposure,
    /// EXPOSURE_DONE does not come.
    NoExposure,
    /// FRAME_END comes before all chunks have.
    EarlyEnd,
    /// FRAME_END (and in the reconstruction FRAME_BEGIN too) states another count of valid pixels than there are.
    WrongCount,
    /// The frame has no valid point.
    Empty,
    /// The frame is marked as degraded.
    Degraded,
}

/// How one trouble is written.
struct Kind {
    name: &'static str,
    /// Name of its value; empty where it has none.
    value: &'static str,
    /// Phases it can be placed at, the usual one first.
    phases: &'static [Phase],
    meaning: &'static str,
    make: fn(f64) -> Trouble,
}

impl CameraFault {
    /// Whether this trigger is meant.
    pub fn is_for(&self, trigger_id: u64) -> bool {
        u64::from(self.view) << 16 | u64::from(self.attempt) == trigger_id
    }

    /// The fault of these written parts; none where one does not fit. `name` must be that of a camera fault.
    pub(crate) fn parse(name: &str, value: &str, place: &str) -> Option<Self> {
        let kind = KINDS.iter().find(|kind| kind.name == name)?;
        let (place, phase) = match place.split_once(':') {
            Some((place, phase)) => (place, Phase::from_name(phase)?),
            None => (place, kind.phases[0]),
        };
        let (view, attempt) = match place.split_once('.') {
            Some((view, attempt)) => (view, attempt.parse().ok()?),
            None => (place, 0),
        };
        let number = match kind.value {
            "" => 0.0,
            VALUE_CODE => f64::from(value.parse::<u16>().ok()?),
            _ => value
                .parse()
                .ok()
                .filter(|span_s| (0.0..=SPAN_MAX_S).contains(span_s))?,
        };
        kind.phases.contains(&phase).then_some(Self {
            trouble: (kind.make)(number),
            view: view.parse().ok()?,
            attempt,
            phase,
        })
    }

    fn kind(&self) -> &'static Kind {
        let number = self.number().unwrap_or_default();
        KINDS
            .iter()
            .find(|kind| (kind.make)(number) == self.trouble)
            .expect("every trouble stands in the table")
    }

    /// Value as it is written.
    fn number(&self) -> Option<f64> {
        match self.trouble {
            Trouble::Reset { span_s }
            | Trouble::Lost { span_s }
            | Trouble::Hot { span_s }
            | Trouble::VendorTimeout { span_s }
            | Trouble::Pause { span_s }
            | Trouble::Late { delay_s: span_s } => Some(span_s),
            Trouble::Error { code } => Some(f64::from(code)),
            _ => None,
        }
    }

    /// Name without value and place.
    pub fn name(&self) -> &'static str {
        self.kind().name
    }

    /// Every camera fault that can be written for a view, once for each phase it can be placed at; values are those given.
    pub fn all(view: u32, attempt: u16, span_s: f64, code: u16) -> Vec<Self> {
        let of_kind = |kind: &'static Kind| {
            let number = if kind.value == VALUE_CODE {
                f64::from(code)
            } else {
                span_s
            };
            kind.phases.iter().map(move |phase| Self {
                trouble: (kind.make)(number),
                view,
                attempt,
                phase: *phase,
            })
        };
        KINDS.iter().flat_map(of_kind).collect()
    }

    /// Spelling and meaning of every camera fault, for people.
    pub(crate) fn catalogue() -> impl Iterator<Item = (String, String)> {
        KINDS.iter().map(|kind| {
            let value = match kind.value {
                "" => String::new(),
                value => format!("={value}"),
            };
            let (phase, phases) = match kind.phases {
                [_] => ("", String::new()),
                phases => (
                    "[:PHASE]",
                    format!(
                        " ({})",
                        phases.iter().map(|phase| phase.name()).collect::<Vec<_>>().join(", ")
                    ),
                ),
            };
            (
                format!("{}{value}@VIEW{phase}", kind.name),
                format!("{}{phases}", kind.meaning),
            )
        })
    }

    /// Whether a camera fault has this name.
    pub(crate) fn has_name(name: &str) -> bool {
        KINDS.iter().any(|kind| kind.name == name)
    }
}

impl fmt::Display for CameraFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = self.kind();
        f.write_str(kind.name)?;
        if let Some(number) = self.number() {
            write!(f, "={number}")?;
        }
        write!(f, "@{}", self.view)?;
        if self.attempt != 0 {
            write!(f, ".{}", self.attempt)?;
        }
        if self.phase != kind.phases[0] {
            write!(f, ":{}", self.phase.name())?;
        }
        Ok(())
    }
}

impl Phase {
    /// As it is written.
    pub fn name(self) -> &'static str {
        match self {
            Self::Request => "request",
            Self::Acknowledge => "acknowledge",
            Self::Exposure => "exposure",
            Self::Reconstruction => "reconstruction",
            Self::Transfer => "transfer",
        }
    }

    fn from_name(name: &str) -> Option<Self> {
        FROM_TRANSFER.into_iter().find(|phase| phase.name() == name)
    }
}

const VALUE_CODE: &str = "CODE";
const VALUE_SECONDS: &str = "SECONDS";
const SPAN_MAX_S: f64 = 3600.0;

const FROM_TRANSFER: [Phase; 5] = [
    Phase::Transfer,
    Phase::Request,
    Phase::Acknowledge,
    Phase::Exposure,
    Phase::Reconstruction,
];
const FROM_EXPOSURE: [Phase; 5] = [
    Phase::Exposure,
    Phase::Request,
    Phase::Acknowledge,
    Phase::Reconstruction,
    Phase::Transfer,
];
/// Phases with a message of their own.
const MESSAGES: [Phase; 4] = [
    Phase::Transfer,
    Phase::Acknowledge,
    Phase::Exposure,
    Phase::Reconstruction,
];

const fn kind(
    name: &'static str,
    value: &'static str,
    phases: &'static [Phase],
    meaning: &'static str,
    make: fn(f64) -> Trouble,
) -> Kind {
    Kind {
        name,
        value,
        phases,
        meaning,
        make,
    }
}

const KINDS: [Kind; 27] = [
    kind(
        "camera-gone",
        "",
        &FROM_TRANSFER,
        "the camera's connection closes; in the transfer in the middle of a chunk",
        |_| Trouble::Gone,
    ),
    kind(
        "camera-silent",
        "",
        &FROM_TRANSFER,
        "the camera neither reads nor sends any more on its connection, without closing it",
        |_| Trouble::Silent,
    ),
    kind(
        "camera-restart",
        "",
        &FROM_EXPOSURE,
        "the bridge starts anew: connections close, another boot id, nothing remembered",
        |_| Trouble::Restart,
    ),
    kind(
        "camera-kick",
        "",
        &FROM_EXPOSURE,
        "the bridge says BYE 2 (shutting down) to controller and observers, and serves again at once",
        |_| Trouble::Kicked,
    ),
    kind(
        "camera-reset",
        VALUE_SECONDS,
        &FROM_EXPOSURE,
        "the camera starts anew and is RESETTING this long (real seconds): EVENT 3, ERROR 504, settings lost",
        |span_s| Trouble::Reset { span_s },
    ),
    kind(
        "camera-lost",
        VALUE_SECONDS,
        &FROM_EXPOSURE,
        "the camera is OFFLINE this long (real seconds): EVENT 3 without a duration, ERROR 501, settings lost",
        |span_s| Trouble::Lost { span_s },
    ),
    kind(
        "camera-broken",
        "",
        &FROM_EXPOSURE,
        "the camera does not work any more: ERROR 500, state FAULT to the end",
        |_| Trouble::Broken,
    ),
    kind(
        "camera-error",
        VALUE_CODE,
        &[
            Phase::Reconstruction,
            Phase::Acknowledge,
            Phase::Exposure,
            Phase::Transfer,
        ],
        "an ERROR of this code comes instead of the frame; at acknowledge the trigger is refused with it",
        |code| Trouble::Error { code: code as u16 },
    ),
    kind(
        "missed-trigger",
        "",
        &[Phase::Exposure, Phase::Acknowledge],
        "the trigger is missed: EVENT 1 and ERROR 401",
        |_| Trouble::Missed,
    ),
    kind(
        "over-temperature",
        VALUE_SECONDS,
        &[Phase::Exposure, Phase::Acknowledge, Phase::Reconstruction],
        "the camera is too hot: EVENT 2 and ERROR 502, and 502 for every trigger this long (real seconds)",
        |span_s| Trouble::Hot { span_s },
    ),
    kind(
        "vendor-timeout",
        VALUE_SECONDS,
        &[Phase::Exposure, Phase::Reconstruction],
        "the vendor's SDK times out (402 or 403), then its device is in use (503) this long (real seconds)",
        |span_s| Trouble::VendorTimeout { span_s },
    ),
    kind(
        "cool-down",
        VALUE_SECONDS,
        &[Phase::Exposure],
        "the projector pauses this long (real seconds) in mid-exposure, and EVENT 5 says so",
        |span_s| Trouble::Pause { span_s },
    ),
    kind(
        "late-frame",
        VALUE_SECONDS,
        &[Phase::Reconstruction, Phase::Exposure],
        "the frame, or EXPOSURE_DONE, comes this much later (real seconds)",
        |delay_s| Trouble::Late { delay_s },
    ),
    kind(
        "corrupt-chunk",
        "",
        &[Phase::Transfer],
        "a byte of the frame is damaged, and its component's CRC no longer agrees",
        |_| Trouble::CorruptComponent,
    ),
    kind(
        "corrupt-payload",
        "",
        &MESSAGES,
        "the message of the phase has a payload that does not agree with its CRC",
        |_| Trouble::CorruptPayload,
    ),
    kind(
        "corrupt-header",
        "",
        &MESSAGES,
        "the message of the phase has a header that does not agree with its CRC",
        |_| Trouble::CorruptHeader,
    ),
    kind(
        "duplicate-seq",
        "",
        &MESSAGES,
        "the message of the phase comes twice with the same count",
        |_| Trouble::DuplicateSeq,
    ),
    kind(
        "skip-seq",
        "",
        &MESSAGES,
        "a count is left out before the message of the phase",
        |_| Trouble::SkipSeq,
    ),
    kind(
        "oversize",
        "",
        &MESSAGES,
        "the message of the phase claims a payload longer than any may be",
        |_| Trouble::Oversize,
    ),
    kind(
        "older-frame",
        "",
        &[Phase::Transfer],
        "the frame before comes in the place of this one (where there is one)",
        |_| Trouble::OlderFrame,
    ),
    kind(
        "double-frame",
        "",
        &[Phase::Transfer],
        "the same frame comes twice",
        |_| Trouble::DoubleFrame,
    ),
    kind(
        "double-exposure",
        "",
        &[Phase::Exposure],
        "EXPOSURE_DONE comes twice",
        |_| Trouble::DoubleExposure,
    ),
    kind(
        "no-exposure",
        "",
        &[Phase::Exposure],
        "the frame comes without EXPOSURE_DONE",
        |_| Trouble::NoExposure,
    ),
    kind(
        "early-end",
        "",
        &[Phase::Transfer],
        "FRAME_END comes before all chunks have",
        |_| Trouble::EarlyEnd,
    ),
    kind(
        "wrong-count",
        "",
        &[Phase::Transfer, Phase::Reconstruction],
        "FRAME_END (at reconstruction FRAME_BEGIN too) states one valid pixel more than there is",
        |_| Trouble::WrongCount,
    ),
    kind(
        "empty-frame",
        "",
        &[Phase::Reconstruction],
        "the frame has no valid point",
        |_| Trouble::Empty,
    ),
    kind(
        "degraded",
        "",
        &[Phase::Reconstruction],
        "the frame is marked as degraded, and packets count as lost",
        |_| Trouble::Degraded,
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::Fault;

    #[test]
    fn every_camera_fault_is_written_and_read_back_at_each_of_its_phases() {
        for fault in CameraFault::all(3, 0, 1.5, 402)
            .into_iter()
            .chain(CameraFault::all(4, 2, 35.0, 503))
        {
            assert_eq!(fault.to_string().parse(), Ok(Fault::Camera(fault)), "{fault}");
        }
    }

    #[test]
    fn attempt_and_phase_are_written_where_they_are_not_the_usual_ones() {
        for written in [
            "camera-gone@3",
            "camera-gone@3:exposure",
            "camera-gone@3.1:acknowledge",
            "camera-reset=35@2",
            "camera-error=403@2.1",
        ] {
            assert_eq!(written.parse::<Fault>().unwrap().to_string(), written);
        }
        assert_eq!("camera-gone@3.0:transfer".parse(), "camera-gone@3".parse::<Fault>());
    }

    #[test]
    fn a_phase_that_a_fault_does_not_have_is_refused() {
        for written in [
            "camera-gone@3:lunch",
            "cool-down=2@3:transfer",
            "camera-gone@3.x",
            "camera-gone@",
            "camera-error=70000@1",
        ] {
            assert!(written.parse::<Fault>().is_err(), "{written}");
        }
    }

    #[test]
    fn a_fault_is_for_the_trigger_of_its_view_and_attempt() {
        let Fault::Camera(fault) = "camera-gone@3.1".parse().unwrap() else {
            panic!()
        };
        assert!(fault.is_for(3 << 16 | 1));
        assert!(!fault.is_for(3 << 16) && !fault.is_for(4 << 16 | 1));
    }
}
