//! Another process goes on with the run: what is left of it, and a second look at the blade first.

use super::{Hold, Session, Stage, Target};
use crate::event::{CHECK_ATTEMPT_FIRST, Event};
use crate::fault::{Fault, FaultCode};
use crate::stamp::Stamp;

/// How far the second look at the blade has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Check {
    /// None is wanted, or it has passed.
    No,
    /// This view is taken again before any other.
    Wanted(Target),
    /// Its frame is there and is being compared; nothing moves.
    Judging,
}

impl Session {
    /// Goes back to the opening, with the views that are left. An exposure that was under way is neither lost nor made twice:
    /// its frame is fetched. `checked_view` is taken again before any other, to see whether the blade has moved.
    ///
    /// Call [`Self::begin`] next.
    pub fn restart(&mut self, checked_view: Option<usize>) {
        let was_ended = self.ending.take().is_some();
        self.arm.restart();
        self.camera.restart();
        if was_ended {
            // Letting the camera go has aborted what was under way.
            self.stage = Stage::Opening;
            if let Some(target) = self.cut_off.take() {
                self.targets.push_front(target);
            }
        }
        self.recalled = match (self.stage, self.awaited) {
            (Stage::Exposing(standing), _) | (_, Some(standing)) => Some(standing.target),
            _ => None,
        };
        if !matches!(self.stage, Stage::Exposing(_)) {
            self.stage = Stage::Opening;
        }
        self.targets.retain(|target| !target.is_check());
        if self.recalled.is_some_and(Target::is_check) {
            self.recalled = None;
            self.awaited = None;
            self.stage = Stage::Opening;
            self.camera.forget_open();
        }
        self.check = Check::No;
        if let Some(view_index) = checked_view.filter(|_| !self.is_acquired()) {
            self.want_check(Target {
                view_index,
                attempt: check_attempt(self.restart_count),
            });
        }
        self.restart_count += 1;
        self.hold = Hold::No;
        self.hold_after = None;
        (self.arm_done, self.camera_done, self.parking) = (false, false, false);
        (self.robot_known, self.camera_known) = (false, false);
        (self.failures_in_a_row, self.camera_failures_in_a_row) = (0, 0);
        self.warmth.restart();
        self.way.restart();
    }

    /// The blade sits where it sat: the run goes on.
    pub fn pass_check(&mut self) {
        if self.check == Check::Judging {
            self.check = Check::No;
        }
    }

    /// The camera no longer has the frame of what was under way when the process before ended: the same acquisition again,
    /// after the check. Whether it was this acquisition that failed.
    pub(super) fn take_recalled_anew(&mut self, reason: &str) -> bool {
        let Some(target) = self.recalled.take() else {
            return false;
        };
        if self.awaited.take().is_none() {
            self.targets.pop_front();
        }
        self.stage = Stage::ToTarget;
        let place = usize::from(self.targets.front().is_some_and(|first| first.is_check()));
        self.targets.insert(place, target);
        self.note(format!(
            "view {}: exposed before the program was started again, but its frame is gone ({reason}); it is taken again",
            target.view_index
        ));
        true
    }

    /// The check's frame failed.
    pub(super) fn handle_failed_check(&mut self, now: Stamp, target: Target, reason: &str, retryable: bool) {
        let next = Target {
            attempt: target.attempt + 1,
            ..target
        };
        if retryable && target.attempt % CHECKS_PER_RESTART < self.wanted.retakes.max_count {
            self.emit(Event::FrameFailed {
                view_index: target.view_index,
                attempt: target.attempt,
                reason: reason.to_owned(),
                retaken: true,
            });
            return self.want_check(next);
        }
        let seen = format!(
            "view {} was taken again to see whether the blade has moved, but without a frame: {reason}",
            target.view_index
        );
        self.fault(now, Fault::new(FaultCode::CameraFailing, seen));
    }

    /// Puts the check before all but an exposure that is under way.
    fn want_check(&mut self, target: Target) {
        let place = usize::from(matches!(self.stage, Stage::Exposing(_)));
        self.targets.insert(place, target);
        self.check = Check::Wanted(target);
    }
}

impl Target {
    pub(super) fn is_check(self) -> bool {
        self.attempt >= CHECK_ATTEMPT_FIRST
    }
}

/// Each restart has attempts of its own, so that no acquisition is named twice.
fn check_attempt(restart_count: u16) -> u16 {
    CHECK_ATTEMPT_FIRST + restart_count.min(RESTARTS_MAX) * CHECKS_PER_RESTART
}

/// More than `run.retakes_max` can be.
const CHECKS_PER_RESTART: u16 = 16;
const RESTARTS_MAX: u16 = (u16::MAX - CHECK_ATTEMPT_FIRST) / CHECKS_PER_RESTART;
