//! One acquisition, from the accepted trigger to its frame or its error.

use super::connection::ConnectionId;
use super::convert::{Conversion, FrameError};
use super::picture::{Picture, Wanted};
use super::transfer::{Frame, Sending, Transfer, chunk_count};
use super::vendor::FrameFiles;
use super::{Ask, Bridge, BridgeOutput, InForce, STORE_MAX, ranges};
use crate::camera::code;
use crate::camera::message::{
    AcquisitionPhase, CameraError, CameraState, Component, ComponentKind, ExposureDone, FrameBegin, FrameFlags,
    ServerMessage, Trigger, TriggerId,
};
use crate::stamp::Stamp;
use std::sync::Arc;

/// An acquisition in flight.
#[derive(Debug)]
pub(super) struct Flight {
    /// Its number towards the vendor's side.
    pub(super) acquisition: u32,
    pub(super) trigger_id: TriggerId,
    view_id: u32,
    in_force: InForce,
    pub(super) stage: Stage,
    /// Who hears what comes of it; `None` after the controller left.
    pub(super) listener: Option<ConnectionId>,
    accepted: Stamp,
    exposure_end: Stamp,
    /// Whether its files are being converted.
    converting: bool,
    /// Time lost in pauses that were announced.
    paused_ms: u64,
    deadline_ms: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    Exposing,
    Reconstructing,
}

impl Flight {
    pub(super) fn new(
        now: Stamp,
        acquisition: u32,
        listener: ConnectionId,
        trigger: &Trigger,
        in_force: InForce,
    ) -> Self {
        Self {
            acquisition,
            trigger_id: trigger.trigger_id,
            view_id: trigger.view_id,
            in_force,
            stage: Stage::Exposing,
            listener: Some(listener),
            accepted: now,
            exposure_end: now,
            converting: false,
            paused_ms: 0,
            deadline_ms: trigger.deadline_ms,
        }
    }

    pub(super) fn state(&self) -> CameraState {
        match self.stage {
            Stage::Exposing => CameraState::Exposing,
            Stage::Reconstructing => CameraState::Reconstructing,
        }
    }

    fn phase(&self) -> AcquisitionPhase {
        match self.stage {
            Stage::Exposing => AcquisitionPhase::Exposure,
            Stage::Reconstructing => AcquisitionPhase::Reconstruction,
        }
    }

    /// From now to EXPOSURE_DONE and to FRAME_BEGIN, µs, as predicted.
    pub(super) fn remaining_us(&self, now: Stamp) -> [u32; 2] {
        let gone_us = now.ns.saturating_sub(self.accepted.ns) / 1000;
        let paused_us = self.paused_ms * 1000;
        let exposure_us = match self.stage {
            Stage::Exposing => self.in_force.predicted_exposure_us,
            Stage::Reconstructing => 0,
        };
        [exposure_us, self.in_force.predicted_total_us]
            .map(|predicted_us| (u64::from(predicted_us) + paused_us).saturating_sub(gone_us))
            .map(|remaining_us| u32::try_from(remaining_us).unwrap_or(u32::MAX))
    }

    /// When the vendor's side is late, shortly before the client would say so. A frame's conversion has no limit of its
    /// own: it ends.
    fn limit(&self) -> Stamp {
        let (predicted_us, extra_ms) = match self.stage {
            Stage::Exposing => (self.in_force.predicted_exposure_us, EXPOSURE_EXTRA_MS),
            Stage::Reconstructing => (self.in_force.predicted_total_us, TOTAL_EXTRA_MS),
        };
        let predicted_ms = u64::from(predicted_us) * 3 / 2000;
        self.accepted.plus_ms(predicted_ms + extra_ms + self.paused_ms)
    }

    fn deadline(&self) -> Option<Stamp> {
        (self.deadline_ms > 0).then(|| self.accepted.plus_ms(u64::from(self.deadline_ms)))
    }

    /// When it should be looked at.
    pub(super) fn due(&self) -> Stamp {
        self.deadline()
            .map_or(self.limit(), |deadline| deadline.min(self.limit()))
    }

    /// Accounts for a pause, up to what one trigger may lose in pauses.
    pub(super) fn pause(&mut self, duration_ms: u32) {
        self.paused_ms = (self.paused_ms + u64::from(duration_ms)).min(PAUSED_MS_MAX);
    }
}

impl Bridge {
    /// The part may move.
    pub(super) fn handle_exposed(&mut self, now: Stamp, acquisition: u32) {
        let Some(flight) = self.flight.as_mut().filter(|flight| flight.acquisition == acquisition) else {
            return self.note(format!("acquisition {acquisition} is exposed, which nobody waits for"));
        };
        if flight.stage != Stage::Exposing {
            return;
        }
        flight.stage = Stage::Reconstructing;
        flight.exposure_end = now;
        let done = ServerMessage::ExposureDone(ExposureDone {
            trigger_id: flight.trigger_id,
            exposure_begin_ns: flight.accepted.ns,
            exposure_end_ns: now.ns,
        });
        let listener = flight.listener;
        self.tell(listener, &done);
    }

    /// The files of a frame are there.
    pub(super) fn handle_files(&mut self, now: Stamp, files: FrameFiles) {
        let acquisition = files.acquisition;
        self.handle_exposed(now, acquisition);
        let Some(flight) = self.flight.as_mut().filter(|flight| flight.acquisition == acquisition) else {
            return;
        };
        if std::mem::replace(&mut flight.converting, true) {
            return self.note(format!("acquisition {acquisition} brings a second frame"));
        }
        let settings = flight.in_force.settings;
        let wanted = Wanted {
            size_px: ranges::size_px(&settings, &self.caps),
            axes: self.axes,
            volume: settings.volume_of_interest,
        };
        let conversion = Box::new(Conversion { files, wanted });
        self.outbox.push_back(BridgeOutput::Convert(conversion));
    }

    /// A frame has been converted, or could not be.
    pub fn handle_picture(&mut self, now: Stamp, acquisition: u32, picture: Result<Picture, FrameError>) {
        let Some(flight) = self.flight.take_if(|flight| flight.acquisition == acquisition) else {
            return;
        };
        let made = picture
            .map_err(|error| error.to_string())
            .and_then(|picture| self.frame(now, &flight, picture));
        let frame = match made {
            Ok(frame) => Arc::new(frame),
            Err(text) => {
                self.flight = Some(flight);
                return self.fail_flight(code::DEVICE_ABNORMAL, 0, 0, &text);
            }
        };
        self.counts.frames += 1;
        if self.run.store.len() == STORE_MAX {
            self.run.store.pop_front();
        }
        self.run.store.push_back(frame.clone());
        if let Some(listener) = flight.listener {
            self.waiting
                .push_back(Transfer::new(now, listener, frame, Sending::First));
            if self.transfer.is_none() {
                self.next_transfer(now);
            }
        }
    }

    /// The frame of a picture: the components asked for, no others.
    fn frame(&mut self, now: Stamp, flight: &Flight, picture: Picture) -> Result<Frame, String> {
        let settings = &flight.in_force.settings;
        let Picture {
            width_px,
            height_px,
            valid_count,
            xyz,
            intensity,
            confidence,
            mask,
        } = picture;
        let mut xyz = Some(xyz);
        let mut intensity = Some(intensity);
        let mut confidence = confidence;
        let mut mask = Some(mask);
        let mut components = Vec::new();
        let mut entries = Vec::new();
        for kind in ranges::kinds(settings) {
            let bytes = match kind {
                ComponentKind::Xyz => xyz.take(),
                ComponentKind::Intensity => intensity.take(),
                ComponentKind::Confidence => confidence.take(),
                ComponentKind::Mask => mask.take(),
                ComponentKind::Range => None,
            };
            let bytes = bytes.ok_or_else(|| format!("the vendor's side gave no {kind:?} component"))?;
            entries.push(Component {
                kind,
                chunk_count: chunk_count(bytes.len() as u64),
                byte_count: bytes.len() as u64,
            });
            components.push(bytes);
        }
        let frame_id = self.next_frame_id;
        self.next_frame_id += 1;
        let condition = &self.condition;
        let roi = match settings.binning {
            true => [0; 6],
            false => settings.roi_px,
        };
        let begin = FrameBegin {
            frame_id,
            trigger_id: flight.trigger_id,
            view_id: flight.view_id,
            config_id: flight.in_force.config_id,
            exposure_begin_ns: flight.accepted.ns,
            exposure_end_ns: flight.exposure_end.ns,
            reconstruction_end_ns: now.ns,
            flags: FrameFlags {
                pass_count: ranges::pass_count(settings),
                binned: settings.binning,
                degraded: false,
                warm_up_incomplete: condition.warm_up_done_s < condition.warm_up_required_s,
                simulated: self.identity.as_ref().is_some_and(|identity| identity.simulated),
            },
            width_px,
            height_px,
            camera_1_px: [roi[2], roi[3]],
            camera_2_px: [roi[4], roi[5]],
            calibration_id: self.calibration_id,
            scale: [1.0; 3],
            offset: [0.0; 3],
            valid_count,
            saturated_count: 0,
            temperature_c: condition.temperature_c,
            components: entries,
        };
        Ok(Frame { begin, components })
    }

    /// Ends the acquisition in flight with an error that names it.
    pub(super) fn fail_flight(&mut self, code: u16, vendor_code: i32, retry_after_ms: u32, text: &str) {
        let Some(flight) = self.flight.take() else { return };
        self.counts.last_error = code;
        let error = ServerMessage::Error(CameraError {
            about_request_id: 0,
            trigger_id: flight.trigger_id.0,
            code,
            phase: flight.phase(),
            retryable: is_retryable(code),
            retry_after_ms,
            vendor_code,
            text: text.to_owned(),
        });
        self.note(format!("acquisition {}: error {code}: {text}", flight.acquisition));
        self.tell(flight.listener, &error);
    }

    pub(super) fn watch_flight(&mut self, now: Stamp) {
        let Some(flight) = &self.flight else { return };
        let acquisition = flight.acquisition;
        if flight.deadline().is_some_and(|deadline| deadline <= now) {
            self.fail_flight(code::DEADLINE_PASSED, 0, 0, "the frame was not there by its deadline");
        } else if flight.limit() <= now {
            let (code, text) = match flight.stage {
                Stage::Exposing => (code::EXPOSURE_TIMEOUT, "the vendor's side did not expose in time"),
                Stage::Reconstructing => (code::RECONSTRUCTION_TIMEOUT, "the vendor's side gave no frame in time"),
            };
            self.counts.vendor_timeouts += 1;
            self.fail_flight(code, 0, 0, text);
        } else {
            return;
        }
        self.ask_vendor(&Ask::Abort { acquisition });
    }

    fn tell(&mut self, listener: Option<ConnectionId>, message: &ServerMessage<'_>) {
        if let Some(connection) = listener.and_then(|id| self.connections.get_mut(&id)) {
            connection.say(&mut self.outbox, message);
        }
    }
}

/// Whether taking the picture again may help.
fn is_retryable(code: u16) -> bool {
    !matches!(code, code::DEVICE_ABNORMAL | code::GPU_UNAVAILABLE | 300..=399)
}

const EXPOSURE_EXTRA_MS: u64 = 800;
const TOTAL_EXTRA_MS: u64 = 1500;
const PAUSED_MS_MAX: u64 = 60_000;
