//! The open acquisition: from the trigger to its frame or its failure, over as many connections as that takes.

use super::report::CameraEvent;
use super::{Exchange, Request, Stage};
use crate::camera::capture::{Assembly, FrameError};
use crate::camera::message::{
    Configured, DeviceEvent, ExposureDone, FetchOk, FetchState, FrameBegin, FrameChunk, FrameEnd, FrameStatus,
    Repeated, TRIGGER_ALL, TriggerId, TriggerOk,
};
use crate::stamp::Stamp;
use std::sync::Arc;

/// An acquisition that was triggered and has not ended.
#[derive(Debug)]
pub(super) struct Flight {
    trigger_id: TriggerId,
    /// The TRIGGER, on the connection on which it was said.
    request_id: u32,
    config_id: u32,
    frame_bytes: u64,
    phase: Phase,
    due: Stamp,
    frame_due: Stamp,
    /// What announced pauses have added to the limits.
    extended_ms: u64,
    assembly: Option<Assembly>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Not acknowledged yet.
    Acknowledge,
    /// The part must not move.
    Exposure,
    /// The part may move.
    Frame,
    /// Its frame is asked for on a new connection, before which the exposure was over or not.
    Fetch { exposed: bool },
}

impl Flight {
    pub(super) fn begin(now: Stamp, trigger_id: TriggerId, request_id: u32, in_force: &Configured) -> Self {
        let due = now.plus_ms(TRIGGER_OK_MS);
        Self {
            trigger_id,
            request_id,
            config_id: in_force.config_id,
            frame_bytes: in_force.frame_bytes,
            phase: Phase::Acknowledge,
            due,
            frame_due: due,
            extended_ms: 0,
            assembly: None,
        }
    }

    pub(super) fn trigger_id(&self) -> TriggerId {
        self.trigger_id
    }

    pub(super) fn due(&self) -> Stamp {
        self.due
    }

    /// Whether an error with these numbers is about this acquisition.
    pub(super) fn is_named(&self, trigger_id: u64, request_id: u32) -> bool {
        self.trigger_id.0 == trigger_id || (self.phase == Phase::Acknowledge && self.request_id == request_id)
    }

    pub(super) fn is_unacknowledged(&self) -> bool {
        self.phase == Phase::Acknowledge
    }

    /// The connection is gone, and with it what had come of the frame.
    pub(super) fn interrupt(&mut self) {
        let exposed = matches!(self.phase, Phase::Frame | Phase::Fetch { exposed: true });
        self.phase = Phase::Fetch { exposed };
        self.assembly = None;
    }

    fn is_exposed(&self) -> bool {
        matches!(self.phase, Phase::Frame | Phase::Fetch { exposed: true })
    }

    fn transfer_ms(&self, extra_ms: u64) -> u64 {
        self.frame_bytes / TRANSFER_BYTES_PER_MS + extra_ms
    }

    /// What did not come in time.
    fn late(&self) -> &'static str {
        match self.phase {
            Phase::Acknowledge => "the trigger was not acknowledged in time",
            Phase::Exposure => "the exposure did not end in time",
            Phase::Frame | Phase::Fetch { .. } => "the frame did not come in time",
        }
    }
}

impl Exchange {
    /// A limit of the open acquisition has passed: it is aborted, and everything is set anew, so that no later
    /// acquisition inherits its state.
    pub(super) fn handle_late_flight(&mut self, now: Stamp) {
        if let Some(flight) = &self.flight
            && flight.due <= now
        {
            let reason = flight.late();
            self.fail(reason.to_owned(), true);
            self.start_over(now);
        }
    }

    /// The open acquisition ends without a frame.
    pub(super) fn fail(&mut self, reason: String, retryable: bool) {
        self.fail_with_code(reason, retryable, None);
    }

    pub(super) fn fail_with_code(&mut self, reason: String, retryable: bool, code: Option<u16>) {
        if let Some(flight) = self.flight.take() {
            self.events.push_back(CameraEvent::Failed {
                trigger_id: flight.trigger_id,
                reason,
                retryable,
                code,
            });
        }
    }

    /// The open acquisition never began.
    pub(super) fn refuse(&mut self, reason: String) {
        if let Some(flight) = self.flight.take() {
            let trigger_id = flight.trigger_id;
            self.events
                .push_back(CameraEvent::TriggerRefused { trigger_id, reason });
        }
    }

    /// ABORT, DISARM, CONFIGURE, ARM: a state that does not depend on what happened before.
    pub(super) fn start_over(&mut self, now: Stamp) {
        self.in_force = None;
        self.armed = true;
        self.ask(now, Request::Abort);
    }

    pub(super) fn handle_trigger_ok(&mut self, now: Stamp, request_id: u32, accepted: &TriggerOk) {
        let extra_ms = self.times.frame_timeout_extra_ms;
        match &mut self.flight {
            Some(flight)
                if flight.phase == Phase::Acknowledge
                    && flight.request_id == request_id
                    && flight.trigger_id == accepted.trigger_id =>
            {
                if accepted.repeated != Repeated::New {
                    self.fail(
                        "the camera has seen this trigger before and exposed nothing".into(),
                        true,
                    );
                    return self.start_over(now);
                }
                self.patience_until = None;
                flight.phase = Phase::Exposure;
                flight.due = now.plus_ms(with_slack_ms(accepted.predicted_exposure_us) + EXPOSURE_EXTRA_MS);
                let frame_ms = with_slack_ms(accepted.predicted_total_us) + flight.transfer_ms(extra_ms);
                flight.frame_due = now.plus_ms(frame_ms);
            }
            _ => self.note(format!(
                "TRIGGER_OK for {:#x}, which is not open",
                accepted.trigger_id.0
            )),
        }
    }

    pub(super) fn handle_fetch_ok(&mut self, now: Stamp, request_id: u32, found: &FetchOk) {
        let asking = self.is_asking(Request::Fetch, request_id);
        let extra_ms = self.times.frame_timeout_extra_ms;
        match &mut self.flight {
            Some(flight) if asking && flight.trigger_id == found.trigger_id => {
                let transfer_ms = flight.transfer_ms(extra_ms);
                flight.due = now.plus_ms(match found.state {
                    FetchState::InFlight => with_slack_ms(found.remaining_us) + transfer_ms,
                    FetchState::Stored => transfer_ms,
                });
                flight.frame_due = flight.due;
                flight.extended_ms = 0;
                self.stage = Stage::Standing;
                if found.state == FetchState::Stored {
                    self.know_exposed(None);
                }
            }
            _ => self.note(format!("FETCH_OK for {:#x}, which is not open", found.trigger_id.0)),
        }
    }

    pub(super) fn handle_exposure_done(&mut self, done: &ExposureDone) {
        match &mut self.flight {
            Some(flight)
                if flight.trigger_id == done.trigger_id
                    && matches!(flight.phase, Phase::Exposure | Phase::Fetch { exposed: false }) =>
            {
                self.know_exposed(Some(done.exposure_end_ns));
            }
            // On a new connection it is said again when the first may not have arrived.
            Some(flight) if flight.trigger_id == done.trigger_id && flight.phase == Phase::Fetch { exposed: true } => {}
            _ => self.note(format!("EXPOSURE_DONE for {:#x}, which is not open", done.trigger_id.0)),
        }
    }

    /// The exposure of the open acquisition is over; what is known already is not said again.
    fn know_exposed(&mut self, exposure_end_ns: Option<u64>) {
        let ended = exposure_end_ns.and_then(|device_ns| self.clock.run_time(device_ns));
        if let Some(flight) = &mut self.flight
            && !flight.is_exposed()
        {
            flight.phase = match flight.phase {
                Phase::Fetch { .. } => Phase::Fetch { exposed: true },
                _ => Phase::Frame,
            };
            flight.due = flight.frame_due;
            self.events.push_back(CameraEvent::ExposureDone {
                trigger_id: flight.trigger_id,
                ended,
            });
        }
    }

    pub(super) fn handle_frame_begin(&mut self, now: Stamp, begin: FrameBegin) {
        let most = self.greeting.as_ref().map_or(0, |greeting| greeting.frame_bytes_max);
        let (trigger_id, exposure_end_ns) = (begin.trigger_id, begin.exposure_end_ns);
        let cold = begin.flags.warm_up_incomplete;
        let asking = matches!(self.stage, Stage::Asking { .. });
        let wrong = match &mut self.flight {
            Some(flight) if flight.trigger_id == trigger_id && flight.assembly.is_none() && !asking => {
                if begin.config_id != flight.config_id {
                    let expected = flight.config_id;
                    Some((
                        206,
                        format!("a frame of settings {} instead of {expected}", begin.config_id),
                    ))
                } else if matches!(flight.phase, Phase::Acknowledge | Phase::Exposure) {
                    Some((203, "a frame before its EXPOSURE_DONE".into()))
                } else {
                    // Nothing larger than announced is given memory.
                    match Assembly::begin(begin, most.min(flight.frame_bytes)) {
                        Ok(assembly) => {
                            flight.assembly = Some(assembly);
                            None
                        }
                        Err(error) => Some((108, error.to_string())),
                    }
                }
            }
            _ => return self.note(format!("a frame of trigger {:#x}, which is not open", trigger_id.0)),
        };
        if let Some((code, text)) = wrong {
            return self.accuse(now, code, text);
        }
        self.know_exposed(Some(exposure_end_ns));
        if cold {
            self.events.push_back(CameraEvent::Cold { trigger_id });
        }
    }

    pub(super) fn handle_frame_chunk(&mut self, now: Stamp, chunk: &FrameChunk<'_>) {
        if let Some(Flight {
            assembly: Some(assembly),
            ..
        }) = &mut self.flight
            && let Err(error) = assembly.push(chunk)
        {
            self.accuse(now, 108, error.to_string());
        }
    }

    pub(super) fn handle_frame_end(&mut self, now: Stamp, end: &FrameEnd) {
        let assembly = self.flight.as_mut().and_then(|flight| flight.assembly.take());
        let Some(assembly) = assembly else {
            // What an abort or an error has cut off ends late.
            if end.status == FrameStatus::Complete {
                self.note(format!("the end of frame {}, which is not open", end.frame_id));
            }
            return;
        };
        match assembly.end(end) {
            Ok(capture) => {
                self.flight = None;
                self.broken_transfers = 0;
                self.outage = None;
                self.events.push_back(CameraEvent::Frame(Arc::new(capture)));
                self.go_on(now);
            }
            // The stream is whole, the frame is not: nothing of it is used.
            Err(error @ (FrameError::Crc(_) | FrameError::End | FrameError::ValidCount { .. })) => {
                self.fail(error.to_string(), true);
                self.go_on(now);
            }
            Err(error) => self.accuse(now, 108, error.to_string()),
        }
    }

    pub(super) fn handle_aborted(&mut self, now: Stamp, request_id: u32, trigger_id: u64) {
        if self.is_asking(Request::Abort, request_id) {
            return self.go_on(now);
        }
        match &self.flight {
            Some(flight) if trigger_id == TRIGGER_ALL || flight.trigger_id.0 == trigger_id => {
                self.fail("the camera aborted the acquisition".into(), true);
                self.start_over(now);
            }
            _ => self.note(format!("trigger {trigger_id:#x} was aborted, which is not open")),
        }
    }

    /// An announced pause moves the limits of the open acquisition.
    pub(super) fn extend_limits(&mut self, event: &DeviceEvent) {
        if let Some(flight) = &mut self.flight
            && (event.trigger_id == TRIGGER_ALL || event.trigger_id == flight.trigger_id.0)
        {
            let more_ms = u64::from(event.duration_ms).min(EXTENSION_MAX_MS - flight.extended_ms);
            flight.extended_ms += more_ms;
            flight.due = flight.due.plus_ms(more_ms);
            flight.frame_due = flight.frame_due.plus_ms(more_ms);
        }
    }
}

/// One and a half times a prediction.
fn with_slack_ms(predicted_us: u32) -> u64 {
    u64::from(predicted_us) * 3 / 2000
}

/// 500 ms by the page, after the second that a trigger may wait for the recording.
const TRIGGER_OK_MS: u64 = 500 + 1000;
const EXPOSURE_EXTRA_MS: u64 = 1000;
/// 20 MB/s.
const TRANSFER_BYTES_PER_MS: u64 = 20_000;
/// For one trigger, however many pauses are announced.
const EXTENSION_MAX_MS: u64 = 60_000;
