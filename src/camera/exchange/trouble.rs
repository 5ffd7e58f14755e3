//! Connections that end, devices that are not ready, requests that are refused: what is tried, for how long.

use super::report::{CameraEvent, Trouble};
use super::{CameraOutput, Exchange, Request, Stage};
use crate::camera::code;
use crate::camera::message::{Bye, CameraError, CameraState, CameraStatus, DeviceEvent};
use crate::stamp::Stamp;
use rand::RngExt as _;

/// A connection that is gone, until one has stood for a while.
#[derive(Debug)]
pub(super) struct Outage {
    since: Stamp,
    /// The last attempt begins no later.
    until: Stamp,
    next_pause_ms: u64,
    /// Whether the connection has been reported as gone and not yet as back.
    told: bool,
}

/// A device that is waited for.
#[derive(Debug)]
pub(super) struct Patience {
    reason: String,
    until: Stamp,
    /// The device itself is gone or starts anew: it says when it is back, and is not asked before.
    for_device: bool,
    /// When CONFIGURE is tried again, where nothing will say so.
    again: Stamp,
    /// How often the device has gone since it was waited for.
    gone_count: u32,
}

impl Patience {
    pub(super) fn is_for_device(&self) -> bool {
        self.for_device
    }
}

impl Exchange {
    /// Closes the connection, which is of no use any more, and opens another where that may help.
    pub(super) fn break_off(&mut self, now: Stamp, trouble: Trouble) {
        self.outbox.push_back(CameraOutput::Close);
        self.armed = false;
        self.in_force = None;
        self.patience = None;
        if let Some(flight) = &mut self.flight {
            flight.interrupt();
            self.broken_transfers += 1;
        }
        let known = self.greeting.is_some() || matches!(trouble, Trouble::Refused(_));
        if !known || !trouble.may_pass() {
            return self.over(trouble);
        }
        if self.broken_transfers >= FAILURES_MAX {
            return self.over(trouble.with(&format!("; {FAILURES_MAX} connections in a row broke during a view")));
        }
        let within_ms = match trouble {
            // Its holder may be a connection that nobody serves any more, which the server finds out by then.
            Trouble::Refused(_) => self.times.dead_after_ms + BUSY_EXTRA_MS,
            _ => self.times.reconnect_timeout_ms,
        };
        let outage = self.outage.get_or_insert(Outage {
            since: now,
            until: now.plus_ms(within_ms),
            next_pause_ms: PAUSE_FIRST_MS,
            told: false,
        });
        if now >= outage.until {
            let tried_ms = now.ms_since(outage.since);
            return self.over(match tried_ms {
                0 => trouble,
                _ => trouble.with(&format!("; tried again for {:.1} s", tried_ms as f64 * 1e-3)),
            });
        }
        if !outage.told {
            outage.told = true;
            self.events.push_back(CameraEvent::Away {
                reason: trouble.to_string(),
                within_ms: outage.until.ms_since(now),
            });
        }
        let jitter = self.chance.random_range(0..=2 * JITTER_PERMILLE);
        let pause_ms = outage.next_pause_ms * (1000 - JITTER_PERMILLE + jitter) / 1000;
        outage.next_pause_ms = (2 * outage.next_pause_ms).min(PAUSE_MAX_MS);
        self.stage = Stage::Away {
            again: now.plus_ms(pause_ms).min(outage.until),
        };
    }

    /// Greeted again after an outage.
    pub(super) fn tell_back(&mut self, now: Stamp, restarted: bool) {
        if let Some(outage) = &mut self.outage
            && outage.told
            && self.presented
        {
            outage.told = false;
            self.events.push_back(CameraEvent::Back {
                away_ms: now.ms_since(outage.since),
                restarted,
                fetched: self.flight.as_ref().map(|flight| flight.trigger_id()),
            });
        }
    }

    /// Gives the camera up, with a goodbye where somebody can hear it.
    pub(super) fn give_up(&mut self, trouble: Trouble) {
        self.say_goodbye(Bye::DONE, "giving up");
        self.outbox.push_back(CameraOutput::Close);
        self.over(trouble);
    }

    fn over(&mut self, trouble: Trouble) {
        self.stage = Stage::Over;
        self.flight = None;
        self.events.push_back(CameraEvent::Lost(trouble));
    }

    /// The server refused a request of ours.
    pub(super) fn handle_refusal(&mut self, now: Stamp, request: Request, error: CameraError) {
        match (request, error.code) {
            (Request::Hello, code::CONTROLLER_BUSY) => self.break_off(now, Trouble::Refused(error)),
            (Request::Fetch, _) => {
                self.fail(format!("the camera has no frame of it ({})", words(&error)), true);
                self.recover(now, &error);
            }
            (Request::Abort, _) => self.break_off(now, Trouble::Silent(format!("ABORT: {}", words(&error)))),
            (
                Request::Configure | Request::Arm | Request::Disarm,
                code::WRONG_STATE | code::TRIGGER_IN_FLIGHT | code::WRONG_CONFIG_ID,
            ) if self.remedies < REMEDIES_MAX => {
                self.remedies += 1;
                self.start_over(now);
            }
            (Request::Configure | Request::Arm | Request::Disarm, _) if is_passing(&error) => {
                self.wait_after(now, &error);
            }
            _ => self.give_up(Trouble::Refused(error)),
        }
    }

    /// An error has ended the open acquisition: what has to be done before the next.
    pub(super) fn recover(&mut self, now: Stamp, error: &CameraError) {
        match error.code {
            code::DEVICE_ABNORMAL if !error.retryable => self.give_up(Trouble::Refused(error.clone())),
            code::DEVICE_LOST | code::RESET_IN_PROGRESS | code::OVER_TEMPERATURE | code::IN_USE_BY_OTHER_PROCESS => {
                self.wait_after(now, error);
            }
            code::NOT_ARMED
            | code::WRONG_STATE
            | code::TRIGGER_IN_FLIGHT
            | code::WRONG_CONFIG_ID
            | code::EXPOSURE_TIMEOUT
            | code::RECONSTRUCTION_TIMEOUT => self.start_over(now),
            _ if error.retryable && error.retry_after_ms > 0 => self.wait_after(now, error),
            _ => self.go_on(now),
        }
    }

    fn wait_after(&mut self, now: Stamp, error: &CameraError) {
        let for_device = matches!(error.code, code::DEVICE_LOST | code::RESET_IN_PROGRESS);
        let pause_ms = match u64::from(error.retry_after_ms) {
            0 => DEVICE_PAUSE_MS,
            pause_ms => pause_ms,
        };
        let within_ms = if for_device {
            DEVICE_BACK_MS.max(u64::from(error.retry_after_ms))
        } else {
            self.times.device_timeout_ms
        };
        self.be_patient(now, words(error), within_ms, for_device, now.plus_ms(pause_ms));
        self.wait(now);
    }

    /// Waits for the device. The bound stands from the first reason on; only a device that goes moves it, a few times.
    fn be_patient(&mut self, now: Stamp, reason: String, within_ms: u64, for_device: bool, again: Stamp) {
        self.in_force = None;
        let until = now.plus_ms(within_ms);
        match &mut self.patience {
            Some(patience) => {
                patience.again = again;
                if for_device && !patience.for_device {
                    patience.for_device = true;
                    patience.gone_count += 1;
                    if patience.gone_count <= FAILURES_MAX {
                        patience.until = patience.until.max(until);
                    }
                }
            }
            None => {
                self.patience = Some(Patience {
                    reason: reason.clone(),
                    until,
                    for_device,
                    again,
                    gone_count: u32::from(for_device),
                });
                self.events.push_back(CameraEvent::Waiting { reason, within_ms });
            }
        }
    }

    /// Until the device says that it is back, or the next attempt.
    pub(super) fn wait(&mut self, now: Stamp) {
        if let Some(patience) = &self.patience {
            if now >= patience.until {
                let reason = format!(
                    "{}; waited for until {:.1} s",
                    patience.reason,
                    patience.until.seconds()
                );
                return self.give_up(Trouble::NotReady(reason));
            }
            let again = if patience.for_device {
                patience.until
            } else {
                patience.again.min(patience.until)
            };
            self.stage = Stage::Waiting { again };
        }
    }

    /// The pause is over, or the device has not said in time that it is back.
    pub(super) fn try_device_again(&mut self, now: Stamp) {
        match &self.patience {
            Some(patience) if now >= patience.until => self.wait(now),
            _ => self.go_on(now),
        }
    }

    pub(super) fn handle_device_event(&mut self, now: Stamp, event: DeviceEvent) {
        match event.code {
            DeviceEvent::DEVICE_LOST => {
                let within_ms = match u64::from(event.duration_ms) {
                    0 => DEVICE_BACK_MS,
                    duration_ms => duration_ms + DEVICE_BACK_EXTRA_MS,
                };
                self.handle_device_gone(now, event.text, within_ms);
            }
            DeviceEvent::DEVICE_BACK => {
                self.note(format!("camera event 4: {}", event.text));
                self.handle_device_back(now);
            }
            DeviceEvent::COOLDOWN_PAUSE => {
                self.extend_limits(&event);
                self.note(format!(
                    "the camera pauses for {} ms: {}",
                    event.duration_ms, event.text
                ));
            }
            code => self.note(format!("camera event {code}: {}", event.text)),
        }
    }

    /// STATUS tells once a second what a lost event would have told.
    pub(super) fn handle_status(&mut self, now: Stamp, status: CameraStatus) {
        let (state, last_error) = (status.state, status.last_error);
        self.events.push_back(CameraEvent::Status(status));
        match state {
            CameraState::Fault => {
                let reason =
                    format!("the camera is in state FAULT, last error {last_error}; a person has to look at it");
                self.give_up(Trouble::NotReady(reason));
            }
            CameraState::Offline | CameraState::Resetting => {
                if !self.patience.as_ref().is_some_and(Patience::is_for_device) {
                    self.handle_device_gone(now, format!("the camera is in state {state:?}"), DEVICE_BACK_MS);
                }
            }
            _ => self.handle_device_back(now),
        }
    }

    fn handle_device_gone(&mut self, now: Stamp, reason: String, within_ms: u64) {
        self.armed = false;
        self.be_patient(now, reason, within_ms, true, now);
        // What is in flight ends with an ERROR of its own; what is asked gets its answer.
        if matches!(self.stage, Stage::Standing | Stage::Waiting { .. }) && self.flight.is_none() {
            self.wait(now);
        }
    }

    fn handle_device_back(&mut self, now: Stamp) {
        if let Some(patience) = &mut self.patience
            && patience.for_device
        {
            patience.for_device = false;
            if matches!(self.stage, Stage::Waiting { .. }) {
                self.go_on(now);
            }
        }
    }

    pub(super) fn handle_bye(&mut self, now: Stamp, bye: &Bye) {
        let words = format!("the camera said goodbye (reason {}): {}", bye.reason, bye.text);
        let trouble = match bye.reason {
            Bye::REPLACED => Trouble::Replaced(words),
            Bye::PROTOCOL => Trouble::Protocol(words),
            _ => Trouble::Closed(words),
        };
        self.break_off(now, trouble);
    }
}

/// Whether waiting may mend what the error says.
fn is_passing(error: &CameraError) -> bool {
    error.retryable
        || matches!(
            error.code,
            code::DEVICE_LOST | code::RESET_IN_PROGRESS | code::OVER_TEMPERATURE | code::IN_USE_BY_OTHER_PROCESS
        )
}

pub(super) fn words(error: &CameraError) -> String {
    format!("camera error {}: {}", error.code, error.text)
}

/// Failures in a row after which a person is needed.
const FAILURES_MAX: u32 = 3;
/// From an unexpected state back to armed, without being armed in between.
const REMEDIES_MAX: u32 = 2;
const PAUSE_FIRST_MS: u64 = 200;
const PAUSE_MAX_MS: u64 = 5000;
/// Pauses are drawn within 25 % of their length, so that clients do not come back all at once.
const JITTER_PERMILLE: u64 = 250;
const BUSY_EXTRA_MS: u64 = 1000;
/// Between two attempts at a device that does not say how long it takes.
const DEVICE_PAUSE_MS: u64 = 1000;
/// A device that is gone for an unknown time.
const DEVICE_BACK_MS: u64 = 45_000;
const DEVICE_BACK_EXTRA_MS: u64 = 10_000;
