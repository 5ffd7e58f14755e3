//! What follows from each message of the camera.

use super::report::{CameraEvent, Opened, Trouble};
use super::{EXPOSURE_EXTRA_MS, Exchange, Flight, Opening, Phase, Stage, TRANSFER_BYTES_PER_MS};
use crate::camera::capture::{Assembly, FrameError};
use crate::camera::message::{
    Bye, CameraError, ClientMessage, FrameEnd, Pong, ServerMessage, TRIGGER_ALL, TriggerId, TriggerOk,
};
use crate::camera::settings::difference;
use crate::camera::wire::{FLAG_REPLY, WireFrame};
use crate::stamp::Stamp;
use std::sync::Arc;

impl Exchange {
    pub(super) fn handle_frame(&mut self, now: Stamp, frame: &WireFrame<'_>) {
        match ServerMessage::decode(frame.kind, frame.payload) {
            Ok(Some(message)) => self.handle_message(now, frame.request_id, message),
            Ok(None) => self.note(format!("message of unknown type {:#06x}", frame.kind)),
            Err(error) => self.accuse(108, format!("message {:#06x}: {error}", frame.kind)),
        }
    }

    fn handle_message(&mut self, now: Stamp, request_id: u32, message: ServerMessage<'_>) {
        match message {
            ServerMessage::HelloOk(greeting) if self.opening(Opening::Hello, request_id) => {
                self.greeting = Some(greeting);
                self.request(now, Opening::Caps);
            }
            ServerMessage::Caps(caps) if self.opening(Opening::Caps, request_id) => {
                self.caps = Some(caps);
                self.request(now, Opening::Configure);
            }
            ServerMessage::Configured(configured) if self.opening(Opening::Configure, request_id) => {
                if let Some(difference) = difference(&self.wanted, &configured.settings) {
                    return self.break_off(Trouble::Echo(difference));
                }
                self.configured = Some(configured);
                self.request(now, Opening::Arm);
            }
            ServerMessage::Armed { .. } if self.opening(Opening::Arm, request_id) => self.ready(),
            ServerMessage::TriggerOk(accepted) => self.handle_trigger_ok(now, request_id, accepted),
            ServerMessage::ExposureDone(done) => self.handle_exposure_done(done.trigger_id),
            ServerMessage::FrameBegin(begin) => {
                let max = self.greeting.as_ref().map_or(0, |greeting| greeting.frame_bytes_max);
                let expected = self.configured.as_ref().map(|configured| configured.config_id);
                match &mut self.stage {
                    Stage::InFlight(flight) if flight.trigger_id == begin.trigger_id && flight.assembly.is_none() => {
                        if Some(begin.config_id) != expected {
                            let text = format!("a frame of settings {} instead of {expected:?}", begin.config_id);
                            return self.accuse(206, text);
                        }
                        match Assembly::begin(*begin, max) {
                            Ok(assembly) => flight.assembly = Some(Box::new(assembly)),
                            Err(error) => self.accuse(108, error.to_string()),
                        }
                    }
                    _ => self.note(format!(
                        "a frame of trigger {:#x}, which is not open",
                        begin.trigger_id.0
                    )),
                }
            }
            ServerMessage::FrameChunk(chunk) => {
                if let Stage::InFlight(Flight {
                    assembly: Some(assembly),
                    ..
                }) = &mut self.stage
                    && let Err(error) = assembly.push(&chunk)
                {
                    self.accuse(108, error.to_string());
                }
            }
            ServerMessage::FrameEnd(end) => self.handle_frame_end(now, &end),
            ServerMessage::Aborted(_) => self.handle_aborted(),
            ServerMessage::Status(status) => self.events.push_back(CameraEvent::Status(status)),
            ServerMessage::Event(event) => self.note(format!("camera event {}: {}", event.code, event.text)),
            ServerMessage::Ping { sender_ns } => {
                let pong = ClientMessage::Pong(Pong {
                    sender_ns,
                    device_ns: 0,
                    host_ns: now.ns,
                });
                self.send(&pong, request_id, FLAG_REPLY, false);
            }
            ServerMessage::Pong(_) | ServerMessage::Disarmed { .. } => {}
            ServerMessage::Error(error) => self.handle_error(request_id, error),
            ServerMessage::Bye(Bye { reason, text }) => {
                if !matches!(self.stage, Stage::Leaving { .. }) {
                    self.break_off(Trouble::Closed(format!(
                        "the camera said goodbye (reason {reason}): {text}"
                    )));
                }
            }
            ServerMessage::HelloOk(_)
            | ServerMessage::Caps(_)
            | ServerMessage::Configured(_)
            | ServerMessage::Armed { .. }
            | ServerMessage::FetchOk(_) => self.note(format!("a reply to request {request_id}, which is not open")),
        }
    }

    fn ready(&mut self) {
        self.stage = Stage::Armed;
        let missing = "the opening went through every stage";
        self.events.push_back(CameraEvent::Ready(Box::new(Opened {
            greeting: self.greeting.clone().expect(missing),
            caps: self.caps.clone().expect(missing),
            configured: self.configured.expect(missing),
        })));
    }

    fn handle_trigger_ok(&mut self, now: Stamp, request_id: u32, accepted: TriggerOk) {
        let frame_bytes = self.configured.map_or(0, |configured| configured.frame_bytes);
        let extra_ms = self.times.frame_timeout_extra_ms;
        match &mut self.stage {
            Stage::InFlight(flight)
                if flight.phase == Phase::Acknowledge
                    && flight.request_id == request_id
                    && flight.trigger_id == accepted.trigger_id =>
            {
                flight.phase = Phase::Exposure;
                flight.due = now.plus_ms(u64::from(accepted.predicted_exposure_us) / 1000 + EXPOSURE_EXTRA_MS);
                let transfer_ms = frame_bytes / TRANSFER_BYTES_PER_MS;
                flight.frame_due = now.plus_ms(u64::from(accepted.predicted_total_us) / 1000 + transfer_ms + extra_ms);
            }
            _ => self.note(format!(
                "TRIGGER_OK for {:#x}, which is not open",
                accepted.trigger_id.0
            )),
        }
    }

    fn handle_exposure_done(&mut self, trigger_id: TriggerId) {
        match &mut self.stage {
            Stage::InFlight(flight) if flight.trigger_id == trigger_id && flight.phase == Phase::Exposure => {
                flight.phase = Phase::Frame;
                flight.due = flight.frame_due;
                self.events.push_back(CameraEvent::ExposureDone { trigger_id });
            }
            _ => self.note(format!("EXPOSURE_DONE for {:#x}, which is not open", trigger_id.0)),
        }
    }

    fn handle_frame_end(&mut self, now: Stamp, end: &FrameEnd) {
        let Stage::InFlight(flight) = &mut self.stage else {
            return self.note(format!("the end of frame {}, which is not open", end.frame_id));
        };
        let trigger_id = flight.trigger_id;
        let Some(assembly) = flight.assembly.take() else {
            return self.note(format!("the end of frame {}, which never began", end.frame_id));
        };
        if flight.phase != Phase::Frame {
            return self.accuse(203, "a frame before its EXPOSURE_DONE".into());
        }
        match assembly.end(end) {
            Ok(capture) => {
                self.stage = Stage::Armed;
                self.events.push_back(CameraEvent::Frame(Arc::new(capture)));
            }
            // The stream is whole, the frame is not: nothing of it is used.
            Err(error @ (FrameError::Crc(_) | FrameError::End)) => {
                self.stage = Stage::Armed;
                self.events.push_back(CameraEvent::Failed {
                    trigger_id,
                    reason: error.to_string(),
                    retryable: true,
                });
            }
            Err(error) => self.abort(now, trigger_id, error.to_string(), true),
        }
    }

    fn handle_aborted(&mut self) {
        if let Stage::Aborting { .. } = self.stage
            && let Stage::Aborting {
                trigger_id,
                reason,
                retryable,
                ..
            } = std::mem::replace(&mut self.stage, Stage::Armed)
        {
            self.events.push_back(CameraEvent::Failed {
                trigger_id,
                reason,
                retryable,
            });
        }
    }

    fn handle_error(&mut self, request_id: u32, error: CameraError) {
        match &self.stage {
            Stage::Opening { request_id: open, .. } if *open == request_id => self.break_off(Trouble::Refused(error)),
            Stage::InFlight(flight) if flight.trigger_id.0 == error.trigger_id || flight.request_id == request_id => {
                let trigger_id = flight.trigger_id;
                self.stage = Stage::Armed;
                self.events.push_back(CameraEvent::Failed {
                    trigger_id,
                    reason: format!("camera error {}: {}", error.code, error.text),
                    retryable: error.retryable,
                });
            }
            // An abort that finds nothing in flight ends the same way.
            Stage::Aborting { .. } if error.trigger_id == TRIGGER_ALL || error.code == 406 => self.handle_aborted(),
            _ => self.note(format!("camera error {}: {}", error.code, error.text)),
        }
    }
}
