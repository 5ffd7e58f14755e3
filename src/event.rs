//! Events: what happened in a run, for the journal, the console and the report.

use crate::fault::Fault;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// One thing that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
#[expect(
    missing_docs,
    reason = "the fields say what they are; view_index and attempt count from 0"
)]
pub enum Event {
    /// The run has begun.
    Started {
        recipe: String,
        station: String,
        view_count: usize,
    },
    /// The robot has said what it is.
    RobotIdentified {
        model: String,
        software: String,
        simulated: bool,
    },
    /// The camera is greeted, configured and armed.
    CameraReady {
        model: String,
        serial: String,
        simulated: bool,
        optics: String,
        calibration_id: u64,
    },
    /// Servo power is on and the arm takes moves.
    RobotReady,
    /// A move has been commanded.
    MoveStarted { view_index: usize, attempt: u16 },
    /// The arm stands at the view's pose.
    Arrived { view_index: usize, attempt: u16 },
    /// The camera has been triggered.
    Triggered { view_index: usize, attempt: u16 },
    /// The exposure is over; the robot may move.
    ExposureDone {
        view_index: usize,
        attempt: u16,
        /// By the camera's clock, in the run's time, ns; `None` while the clocks have not been compared.
        ended_ns: Option<u64>,
    },
    /// A whole frame has come.
    FrameArrived {
        view_index: usize,
        attempt: u16,
        valid_count: u32,
        saturated_count: u32,
        /// Where the controller said the arm stood, 4x4 row-major, mm.
        #[serde(with = "rows")]
        base_from_tool: Isometry3<f64>,
    },
    /// The frame is on the disk: the view counts as taken.
    FrameKept { view_index: usize, attempt: u16 },
    /// An acquisition gave no usable frame.
    FrameFailed {
        view_index: usize,
        attempt: u16,
        reason: String,
        retaken: bool,
    },
    /// The frame has become a cloud with normals.
    ViewPrepared {
        view_index: usize,
        point_count: usize,
        /// What was taken out.
        removed: RemovedCounts,
    },
    /// The view joined the model.
    ViewMerged {
        view_index: usize,
        figures: ViewFigures,
        model_point_count: usize,
    },
    /// The view did not join the model.
    ViewDiscarded {
        view_index: usize,
        figures: ViewFigures,
        reason: String,
    },
    /// A discarded view is to be taken again, now that all views are decided.
    ViewTakenAgain {
        view_index: usize,
        /// The one that begins.
        attempt: u16,
        reason: String,
    },
    /// No usable frame came of a view.
    ViewMissing { view_index: usize, reason: String },
    /// The arm will be held when this view has been taken or given up.
    HoldDeferred { view_index: usize },
    /// The arm is being held.
    HoldAsked { by: HoldBy },
    /// The hold is confirmed and the arm stands.
    Held,
    /// The run goes on.
    Resumed,
    /// The operator ends the run.
    AbortAsked,
    /// The run cannot go on.
    Faulted { fault: Fault },
    /// The camera's condition, once a second.
    CameraCondition {
        /// State number of `docs/protocols/camera.md`, section 3.
        state: u8,
        /// Projector, camera 1, camera 2, board; `None` if unknown.
        temperature_c: [Option<f32>; 4],
        missed_count: u32,
    },
    /// The camera's connection is lost and being opened again; the run goes on where it can.
    CameraAway { reason: String, within_ms: u64 },
    /// The camera's connection stands again.
    CameraBack {
        away_ms: u64,
        /// Whether the bridge was started anew: then what was open is lost.
        restarted: bool,
        /// The view whose frame is fetched, exposed before the connection was lost.
        fetched_view_index: Option<usize>,
    },
    /// The bridge answers, but its camera cannot be used at the moment.
    CameraWaiting { reason: String, within_ms: u64 },
    /// The camera is armed again.
    CameraRearmed,
    /// How the camera's clock stands to the run's.
    CameraClock {
        /// Camera time less run time, ns, right to half the round trip.
        offset_ns: i64,
        round_trip_ns: u64,
        /// How much faster the camera's clock runs, parts in a million; `None` until it can be told.
        skew_ppm: Option<f64>,
    },
    /// A datagram from the robot answered nothing that was open.
    DatagramDropped { reason: String },
    /// Something worth recording that changes nothing.
    Noted { text: String },
    /// Another process goes on with the run.
    Restarted {
        /// Its version of bladescan.
        version: String,
        /// Views whose frames are there.
        taken_count: usize,
        /// Views that are still to be taken.
        left_count: usize,
    },
    /// How far the blade sits from where it sat when this view was taken first.
    GripChecked {
        view_index: usize,
        rotation_deg: f64,
        /// Of the middle of the view's points.
        distance_mm: f64,
        moved: bool,
    },
    /// The run is over.
    Ended { ending: Ending },
}

/// Attempts from here on are second looks at a view after a restart; they join no model.
pub const CHECK_ATTEMPT_FIRST: u16 = 0x8000;

/// Figures of one view's registration.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ViewFigures {
    /// Points that overlap the model; `None` for the first view, which has nothing to overlap.
    pub overlap_count: Option<usize>,
    /// Their share of the view, 0 to 1.
    pub overlap_fraction: Option<f64>,
    /// Root mean square distance of the overlapping points from the model's surface, mm.
    pub rmse_mm: Option<f64>,
    /// Angle between the predicted and the found orientation, degrees.
    pub from_prior_deg: f64,
    /// Distance between the predicted and the found place of the view's centroid, mm.
    pub from_prior_mm: f64,
    /// Directions that the surfaces do not determine.
    pub weak_direction_count: usize,
}

/// How many points of a view were taken out before it was registered, by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct RemovedCounts {
    /// No surface about them.
    pub isolated: usize,
    /// Off the surface, beside a hole or the end of the surface.
    pub flying: usize,
    /// Off the surface, in its midst.
    pub outlier: usize,
    /// In a small patch before or behind the surface.
    pub patch: usize,
    /// Seen at too large an angle.
    pub grazing: usize,
    /// Too few neighbours for a normal.
    pub edge: usize,
}

impl RemovedCounts {
    /// All reasons by name, in their order.
    pub fn by_reason(&self) -> [(&'static str, usize); 6] {
        [
            ("isolated", self.isolated),
            ("flying", self.flying),
            ("outlier", self.outlier),
            ("patch", self.patch),
            ("grazing", self.grazing),
            ("edge", self.edge),
        ]
    }

    /// All together.
    pub fn total(&self) -> usize {
        self.by_reason().iter().map(|(_, count)| count).sum()
    }

    fn words(&self) -> String {
        let found = self.by_reason().into_iter().filter(|(_, count)| *count > 0);
        let reasons: Vec<String> = found.map(|(name, count)| format!("{count} {name}")).collect();
        match self.total() {
            0 => String::new(),
            total => format!(", {total} taken out ({})", reasons.join(", ")),
        }
    }
}

/// Who asked for a hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HoldBy {
    /// The operator at bladescan.
    Operator,
    /// Somebody at the robot.
    Robot,
    /// The program, on its way to the end of the run.
    Ending,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "how", rename_all = "kebab-case")]
pub enum Ending {
    /// Every planned view was taken or given up.
    Finished,
    /// The operator ended it.
    Aborted,
    /// A fault ended it.
    Faulted {
        /// The first one.
        fault: Fault,
    },
}

impl Event {
    /// The event in words, one line.
    pub fn words(&self) -> String {
        match self {
            Self::Started {
                recipe,
                station,
                view_count,
            } => format!("run begins: recipe {recipe}, station {station}, {view_count} views"),
            Self::RobotIdentified { model, software, .. } => format!("robot: {model}, software {software}"),
            Self::CameraReady {
                model, serial, optics, ..
            } => format!("camera: {model}, serial {serial}, optics {optics}"),
            Self::RobotReady => "robot ready, servo power on".into(),
            Self::MoveStarted { view_index, attempt } => format!("{}: moving", named(*view_index, *attempt)),
            Self::Arrived { view_index, attempt } => format!("{}: in position", named(*view_index, *attempt)),
            Self::Triggered { view_index, attempt } => format!("{}: exposing", named(*view_index, *attempt)),
            Self::ExposureDone {
                view_index, attempt, ..
            } => format!("{}: exposed", named(*view_index, *attempt)),
            Self::FrameArrived {
                view_index,
                attempt,
                valid_count,
                ..
            } => format!("{}: frame with {valid_count} points", named(*view_index, *attempt)),
            Self::FrameKept { view_index, attempt } => format!("{}: frame kept", named(*view_index, *attempt)),
            Self::FrameFailed {
                view_index,
                attempt,
                reason,
                retaken,
            } => format!(
                "{}: no frame ({reason}); {}",
                named(*view_index, *attempt),
                if *retaken {
                    "taking it again"
                } else {
                    "going on without it"
                }
            ),
            Self::ViewPrepared {
                view_index,
                point_count,
                removed,
            } => format!(
                "view {view_index}: {point_count} points with normals{}",
                removed.words()
            ),
            Self::ViewMerged {
                view_index,
                figures,
                model_point_count,
            } => format!(
                "view {view_index}: merged{}; model {model_point_count} points",
                figures.words()
            ),
            Self::ViewDiscarded { view_index, reason, .. } => format!("view {view_index}: discarded, {reason}"),
            Self::ViewTakenAgain {
                view_index,
                attempt,
                reason,
            } => format!(
                "{}: taken again, as it was discarded: {reason}",
                named(*view_index, *attempt)
            ),
            Self::ViewMissing { view_index, reason } => format!("view {view_index}: missing, {reason}"),
            Self::HoldDeferred { view_index } => format!("the arm will be held after view {view_index}"),
            Self::HoldAsked { by } => match by {
                HoldBy::Operator => "holding the arm, as the operator asked".into(),
                HoldBy::Robot => "held at the robot: release it there, then resume".into(),
                HoldBy::Ending => "holding the arm".into(),
            },
            Self::Held => "the arm is held and stands".into(),
            Self::Resumed => "the run goes on".into(),
            Self::AbortAsked => "ending the run, as the operator asked".into(),
            Self::Faulted { fault } => format!("FAULT {fault}"),
            Self::CameraCondition { state, .. } => format!("camera state {state}"),
            Self::CameraAway { reason, within_ms } => format!(
                "camera lost: {reason}; connecting again, for {} s at most",
                seconds(*within_ms)
            ),
            Self::CameraBack {
                away_ms,
                restarted,
                fetched_view_index,
            } => {
                let frame = match (restarted, fetched_view_index) {
                    (true, _) => ", its bridge was started anew".to_owned(),
                    (false, Some(view_index)) => format!(", fetching the frame of view {view_index}"),
                    (false, None) => String::new(),
                };
                format!("camera back after {} s{frame}", seconds(*away_ms))
            }
            Self::CameraWaiting { reason, within_ms } => {
                format!("waiting for the camera, {} s at most: {reason}", seconds(*within_ms))
            }
            Self::CameraRearmed => "camera armed again".into(),
            Self::CameraClock {
                offset_ns,
                round_trip_ns,
                skew_ppm,
            } => format!(
                "camera clock: {:.3} ms ahead, round trip {:.3} ms{}",
                *offset_ns as f64 * 1e-6,
                *round_trip_ns as f64 * 1e-6,
                skew_ppm.map_or(String::new(), |skew_ppm| format!(", {skew_ppm:+.1} ppm fast"))
            ),
            Self::DatagramDropped { reason } => format!("robot datagram dropped: {reason}"),
            Self::Noted { text } => text.clone(),
            Self::Restarted {
                version,
                taken_count,
                left_count,
            } => format!("the run goes on with version {version}: {taken_count} views taken, {left_count} left"),
            Self::GripChecked {
                view_index,
                rotation_deg,
                distance_mm,
                moved,
            } => format!(
                "check: the blade sits {rotation_deg:.3}° and {distance_mm:.3} mm from where it sat at view {view_index}{}",
                if *moved { ": it has moved" } else { "" }
            ),
            Self::Ended { ending } => match ending {
                Ending::Finished => "run finished".into(),
                Ending::Aborted => "run aborted by the operator".into(),
                Ending::Faulted { fault } => format!("run stopped by {fault}"),
            },
        }
    }
}

impl ViewFigures {
    fn words(&self) -> String {
        match (self.overlap_fraction, self.rmse_mm) {
            (Some(overlap), Some(rmse_mm)) => format!(
                ", overlap {overlap:.3}, residual {rmse_mm:.4} mm, {:.3}° and {:.3} mm from the robot's pose",
                self.from_prior_deg, self.from_prior_mm
            ),
            _ => String::new(),
        }
    }
}

/// A pose as the rows of its matrix.
mod rows {
    use crate::geometry::{isometry_from_rows, matrix_rows};
    use nalgebra::Isometry3;
    use serde::{Deserialize as _, Deserializer, Serialize as _, Serializer, de};

    pub(super) fn serialize<S: Serializer>(pose: &Isometry3<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        matrix_rows(pose).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Isometry3<f64>, D::Error> {
        let rows = <[[f64; 4]; 4]>::deserialize(deserializer)?;
        isometry_from_rows(&rows).map_err(de::Error::custom)
    }
}

/// Seconds, with a decimal where there is one to show.
fn seconds(ms: u64) -> String {
    match ms % 1000 {
        0 => (ms / 1000).to_string(),
        _ => format!("{:.1}", ms as f64 * 1e-3),
    }
}

fn named(view_index: usize, attempt: u16) -> String {
    match attempt {
        0 => format!("view {view_index}"),
        CHECK_ATTEMPT_FIRST.. => format!("view {view_index} (check)"),
        _ => format!("view {view_index} (attempt {attempt})"),
    }
}
