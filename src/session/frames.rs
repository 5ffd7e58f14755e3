//! Frames, as they come or fail to come: kept, taken again, or given up.

use super::{Captured, Check, FAILURES_MAX, Session, SessionEvent, Stage, Target};
use crate::camera::Capture;
use crate::event::Event;
use crate::fault::{Fault, FaultCode};
use crate::settings::RetakeReason;
use crate::stamp::Stamp;
use std::sync::Arc;

impl Session {
    pub(super) fn handle_capture(&mut self, now: Stamp, capture: Arc<Capture>) {
        if let Some((reason, seen)) = self.shortcoming(&capture) {
            return self.handle_failure(now, reason, seen, true);
        }
        let Some(standing) = self.awaited.take() else {
            return self.note("a frame nobody waits for");
        };
        self.failures_in_a_row = 0;
        self.recalled = None;
        let Target { view_index, attempt } = standing.target;
        self.emit(Event::FrameArrived {
            view_index,
            attempt,
            valid_count: capture.valid_count,
            saturated_count: capture.saturated_count,
            base_from_tool: standing.base_from_tool,
        });
        let captured = Captured {
            view_index,
            attempt,
            base_from_tool: standing.base_from_tool,
            capture,
        };
        self.events.push_back(if standing.target.is_check() {
            self.check = Check::Judging;
            SessionEvent::Check(captured)
        } else {
            SessionEvent::Captured(captured)
        });
    }

    /// An acquisition gave nothing usable: `why` for the recipe, `reason` in words.
    pub(super) fn handle_failure(&mut self, now: Stamp, why: RetakeReason, reason: String, retryable: bool) {
        let standing = match (self.awaited.take(), self.stage) {
            (Some(standing), _) => standing,
            (None, Stage::Exposing(standing)) => {
                self.targets.pop_front();
                self.stage = Stage::AtTarget(standing);
                standing
            }
            (None, _) => return self.note(format!("a failed frame nobody waits for: {reason}")),
        };
        let Target { view_index, attempt } = standing.target;
        if standing.target.is_check() {
            return self.handle_failed_check(now, standing.target, &reason, retryable);
        }
        let retaken = retryable && self.wanted.retakes.wants(why, attempt);
        self.emit(Event::FrameFailed {
            view_index,
            attempt,
            reason: reason.clone(),
            retaken,
        });
        if retaken {
            self.events.push_back(SessionEvent::Failed {
                view_index,
                attempt,
                reason,
            });
            self.change_exposures(view_index, why);
            let target = Target {
                view_index,
                attempt: attempt + 1,
            };
            self.targets.push_front(target);
            if let Stage::AtTarget(standing) = &mut self.stage
                && standing.target.view_index == view_index
            {
                standing.target = target;
            }
            return;
        }
        self.events.push_back(SessionEvent::Missing {
            view_index,
            reason: reason.clone(),
        });
        self.failures_in_a_row += 1;
        if self.failures_in_a_row == FAILURES_MAX {
            let seen = format!("{FAILURES_MAX} views in a row without a frame; the last: {reason}");
            self.fault(now, Fault::new(FaultCode::CameraFailing, seen));
        }
    }

    /// A view that was exposed but whose frame the end of the run cuts off is missing for that reason.
    pub(super) fn give_up_exposed(&mut self) {
        let exposing = match self.stage {
            Stage::Exposing(standing) => Some(standing),
            _ => None,
        };
        self.cut_off = self.awaited.map(|standing| standing.target);
        if let Some(standing) = self.awaited.take().or(exposing)
            && !standing.target.is_check()
        {
            self.events.push_back(SessionEvent::Missing {
                view_index: standing.target.view_index,
                reason: "the run ended before its frame had come".into(),
            });
        }
    }
}
