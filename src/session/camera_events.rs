//! What follows from each event of the camera's conversation.

use super::{FAILURES_MAX, Session, Stage, Target};
use crate::camera::{CameraEvent, Trouble};
use crate::event::Event;
use crate::fault::{Fault, FaultCode};
use crate::settings::RetakeReason;
use crate::stamp::Stamp;

impl Session {
    pub(super) fn handle_camera_event(&mut self, now: Stamp, event: CameraEvent) {
        match event {
            CameraEvent::Ready(opened) => self.handle_camera_ready(now, &opened),
            CameraEvent::ExposureDone { trigger_id, ended } => {
                if let Stage::Exposing(standing) = self.stage {
                    debug_assert_eq!(trigger_id.view_index() as usize, standing.target.view_index);
                    self.targets.pop_front();
                    self.awaited = Some(standing);
                    self.stage = Stage::ToTarget;
                    let Target { view_index, attempt } = standing.target;
                    self.emit(Event::ExposureDone {
                        view_index,
                        attempt,
                        ended_ns: ended.map(|stamp| stamp.ns),
                    });
                }
            }
            CameraEvent::Frame(capture) => {
                self.camera_failures_in_a_row = 0;
                if self.warmth.refuses(capture.trigger_id) {
                    let reason = "taken before the camera was warm".into();
                    self.handle_failure(now, RetakeReason::NoFrame, reason, true);
                } else {
                    self.handle_capture(now, capture);
                }
            }
            CameraEvent::Cold { trigger_id } => self.handle_cold(trigger_id),
            CameraEvent::TriggerRefused { trigger_id, reason } => {
                if let Stage::Exposing(standing) = self.stage {
                    self.stage = Stage::AtTarget(standing);
                }
                self.note(format!(
                    "view {}: nothing was exposed ({reason}); it is triggered again when the camera is ready",
                    trigger_id.view_index()
                ));
            }
            CameraEvent::Failed { reason, .. } if self.take_recalled_anew(&reason) => {}
            CameraEvent::Failed {
                reason,
                retryable,
                code,
                ..
            } => {
                self.handle_failure(now, self.why(code), reason.clone(), retryable);
                self.camera_failures_in_a_row += 1;
                if self.camera_failures_in_a_row == FAILURES_MAX && self.ending.is_none() {
                    let seen = format!("{FAILURES_MAX} acquisitions in a row failed; the last: {reason}");
                    self.fault(now, Fault::new(FaultCode::CameraFailing, seen));
                }
            }
            CameraEvent::Away { reason, within_ms } => self.emit(Event::CameraAway { reason, within_ms }),
            CameraEvent::Back {
                away_ms,
                restarted,
                fetched,
            } => self.emit(Event::CameraBack {
                away_ms,
                restarted,
                fetched_view_index: fetched.map(|trigger_id| trigger_id.view_index() as usize),
            }),
            CameraEvent::Waiting { reason, within_ms } => self.emit(Event::CameraWaiting { reason, within_ms }),
            CameraEvent::Rearmed => self.emit(Event::CameraRearmed),
            CameraEvent::Clock(estimate) => self.emit(Event::CameraClock {
                offset_ns: estimate.offset_ns,
                round_trip_ns: estimate.round_trip_ns,
                skew_ppm: estimate.skew_ppm,
            }),
            CameraEvent::Status(status) => {
                self.emit(Event::CameraCondition {
                    state: status.state as u8,
                    temperature_c: status.temperature_c,
                    missed_count: status.missed_count,
                });
                self.handle_warm_up(now, &status);
            }
            CameraEvent::Note(text) => self.note(text),
            CameraEvent::Lost(trouble) => {
                self.camera_done = true;
                if self.ending.is_none() {
                    self.fault(now, camera_fault(&trouble));
                } else {
                    self.note(format!("camera, while ending: {trouble}"));
                }
            }
            CameraEvent::Left => self.camera_done = true,
        }
    }
}

fn camera_fault(trouble: &Trouble) -> Fault {
    let code = match trouble {
        Trouble::Unreachable(_) => FaultCode::CameraUnreachable,
        Trouble::Closed(_) => FaultCode::CameraLost,
        Trouble::Silent(_) => FaultCode::CameraSilent,
        Trouble::Protocol(_) => FaultCode::CameraProtocol,
        Trouble::Settings(_) => FaultCode::CameraSettings,
        Trouble::Refused(_) | Trouble::Replaced(_) => FaultCode::CameraRefused,
        Trouble::Another(_) => FaultCode::CameraIdentity,
        Trouble::NotReady(_) => FaultCode::CameraNotReady,
    };
    Fault::new(code, trouble.to_string())
}
