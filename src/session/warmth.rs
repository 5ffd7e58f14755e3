//! A camera that is not warm yet: its frames drift, and the recipe says what that means.

use super::Session;
use crate::camera::{CameraStatus, TriggerId};
use crate::event::Event;
use crate::fault::{Fault, FaultCode};
use crate::settings::WarmUp;
use crate::stamp::Stamp;

/// What is known of it.
#[derive(Debug)]
pub(super) struct Warmth {
    policy: WarmUp,
    noted: bool,
    /// It is waited for, until then.
    until: Option<Stamp>,
    /// The frame on its way is marked as cold and must not be used.
    refused: Option<TriggerId>,
}

impl Warmth {
    pub(super) fn new(policy: WarmUp) -> Self {
        Self {
            policy,
            noted: false,
            until: None,
            refused: None,
        }
    }

    /// Nothing is known of it any more.
    pub(super) fn restart(&mut self) {
        *self = Self::new(self.policy);
    }

    /// Whether the next view may be taken as far as the warmth goes.
    pub(super) fn is_enough(&self) -> bool {
        self.until.is_none()
    }

    pub(super) fn wake_at(&self) -> Option<Stamp> {
        self.until
    }

    /// Whether the frame of this acquisition must not be used.
    pub(super) fn refuses(&self, trigger_id: TriggerId) -> bool {
        self.refused == Some(trigger_id)
    }
}

impl Session {
    pub(super) fn handle_warm_up(&mut self, now: Stamp, status: &CameraStatus) {
        let (done_s, required_s) = (status.warm_up_done_s, status.warm_up_required_s);
        if done_s >= required_s {
            if self.warmth.until.take().is_some() {
                self.note("the camera is warm");
            }
            return;
        }
        if self.ending.is_some() {
            return;
        }
        let seen = format!("the camera is warming up: {done_s} of {required_s} s");
        match self.warmth.policy {
            WarmUp::Note => self.note_cold(seen),
            WarmUp::Wait if self.warmth.until.is_some() => {}
            WarmUp::Wait => {
                let within_ms = u64::from(required_s - done_s) * 1000 + WARM_UP_EXTRA_MS;
                self.warmth.until = Some(now.plus_ms(within_ms));
                self.emit(Event::CameraWaiting {
                    reason: seen,
                    within_ms,
                });
            }
            WarmUp::Refuse => self.fault(now, Fault::new(FaultCode::CameraNotReady, seen)),
        }
    }

    /// The frame on its way was taken before the camera was warm.
    pub(super) fn handle_cold(&mut self, trigger_id: TriggerId) {
        match self.warmth.policy {
            WarmUp::Note => {
                let view_index = trigger_id.view_index();
                self.note_cold(format!("view {view_index} was taken before the camera was warm"));
            }
            WarmUp::Wait | WarmUp::Refuse => self.warmth.refused = Some(trigger_id),
        }
    }

    pub(super) fn watch_warmth(&mut self, now: Stamp) {
        if self.warmth.until.is_some_and(|until| until <= now) {
            self.warmth.until = None;
            if self.ending.is_none() {
                let seen = "the camera did not become warm in its own time and a minute";
                self.fault(now, Fault::new(FaultCode::CameraNotReady, seen));
            }
        }
    }

    fn note_cold(&mut self, text: String) {
        if !self.warmth.noted {
            self.warmth.noted = true;
            self.note(text);
        }
    }
}

const WARM_UP_EXTRA_MS: u64 = 60_000;
