//! What follows from each message of the camera.

use super::clock::Clock;
use super::offered::unmet;
use super::report::Trouble;
use super::trouble::{is_passing, words};
use super::{Exchange, Request, Stage};
use crate::camera::code;
use crate::camera::message::{CameraError, Caps, ClientMessage, Configured, Greeting, ServerMessage};
use crate::camera::settings::difference;
use crate::camera::wire::WireFrame;
use crate::stamp::Stamp;

impl Exchange {
    pub(super) fn handle_frame(&mut self, now: Stamp, frame: &WireFrame<'_>) {
        match ServerMessage::decode(frame.kind, frame.payload) {
            Ok(Some(message)) => self.handle_message(now, frame.request_id, message),
            Ok(None) => self.note(format!("message of unknown type {:#06x}", frame.kind)),
            Err(error) => self.accuse(now, 108, format!("message {:#06x}: {error}", frame.kind)),
        }
    }

    fn handle_message(&mut self, now: Stamp, request_id: u32, message: ServerMessage<'_>) {
        match message {
            ServerMessage::HelloOk(greeting) if self.is_asking(Request::Hello, request_id) => {
                self.handle_greeting(now, greeting);
            }
            ServerMessage::Caps(caps) if self.is_asking(Request::Caps, request_id) => self.handle_caps(now, caps),
            ServerMessage::Configured(configured) if self.is_asking(Request::Configure, request_id) => {
                self.handle_configured(now, configured);
            }
            ServerMessage::Armed { .. } if self.is_asking(Request::Arm, request_id) => {
                self.armed = true;
                self.armed_since = now;
                self.go_on(now);
            }
            ServerMessage::Disarmed { .. } if self.is_asking(Request::Disarm, request_id) => {
                self.armed = false;
                self.go_on(now);
            }
            ServerMessage::TriggerOk(accepted) => self.handle_trigger_ok(now, request_id, &accepted),
            ServerMessage::FetchOk(found) => self.handle_fetch_ok(now, request_id, &found),
            ServerMessage::ExposureDone(done) => self.handle_exposure_done(&done),
            ServerMessage::FrameBegin(begin) => self.handle_frame_begin(now, *begin),
            ServerMessage::FrameChunk(chunk) => self.handle_frame_chunk(now, &chunk),
            ServerMessage::FrameEnd(end) => self.handle_frame_end(now, &end),
            ServerMessage::Aborted(aborted) => self.handle_aborted(now, request_id, aborted.trigger_id),
            ServerMessage::Status(status) => self.handle_status(now, status),
            ServerMessage::Event(event) => self.handle_device_event(now, event),
            ServerMessage::Ping { sender_ns } => self.handle_ping(now, request_id, sender_ns),
            ServerMessage::Pong(pong) => self.handle_pong(now, request_id, &pong),
            ServerMessage::Error(error) => self.handle_error(now, request_id, error),
            ServerMessage::Bye(bye) => self.handle_bye(now, &bye),
            ServerMessage::HelloOk(_)
            | ServerMessage::Caps(_)
            | ServerMessage::Configured(_)
            | ServerMessage::Armed { .. }
            | ServerMessage::Disarmed { .. } => {
                self.note(format!("a reply to request {request_id}, which is not open"));
            }
        }
    }

    /// Somebody answers: the same camera as before, if there was one.
    fn handle_greeting(&mut self, now: Stamp, greeting: Greeting) {
        let mut restarted = false;
        if let Some(before) = &self.greeting {
            if let Some(text) = other_camera(before, &greeting) {
                return self.give_up(Trouble::Another(text));
            }
            restarted = before.boot_id != greeting.boot_id;
        } else {
            // Until now another held it; what is lost from here on is lost for the first time.
            self.outage = None;
        }
        self.greeting = Some(greeting);
        if restarted {
            self.clock = Clock::default();
            self.fail(
                "the bridge was started anew, and the frame is lost with it".into(),
                true,
            );
        }
        self.tell_back(now, restarted);
        self.ask(now, Request::Caps);
    }

    fn handle_caps(&mut self, now: Stamp, caps: Caps) {
        if let Some(before) = &self.caps
            && before.optics != caps.optics
        {
            let text = format!("optics \"{}\" instead of \"{}\"", caps.optics, before.optics);
            return self.give_up(Trouble::Another(text));
        }
        if let Some(text) = self.planned.iter().find_map(|settings| unmet(&caps, settings)) {
            return self.give_up(Trouble::Settings(text));
        }
        self.caps = Some(caps);
        // Early answers tell the clocks apart, and how warm the camera is, before the first exposure.
        self.link.hurry_ping(now);
        self.say(&ClientMessage::GetStatus);
        if self.flight.is_some() {
            self.ask(now, Request::Fetch);
        } else {
            self.go_on(now);
        }
    }

    fn handle_configured(&mut self, now: Stamp, configured: Configured) {
        match difference(&self.asked, &configured.settings) {
            Some(difference) => self.give_up(Trouble::Settings(difference)),
            None => {
                self.in_force = Some(configured);
                self.go_on(now);
            }
        }
    }

    fn handle_error(&mut self, now: Stamp, request_id: u32, error: CameraError) {
        match (self.stage, &self.flight) {
            (
                Stage::Asking {
                    request,
                    request_id: open,
                    ..
                },
                _,
            ) if open == request_id => {
                self.handle_refusal(now, request, error);
            }
            (_, Some(flight)) if flight.is_named(error.trigger_id, request_id) => {
                if flight.is_unacknowledged() && is_passing(&error) && error.code >= code::DEVICE_ABNORMAL {
                    self.refuse(words(&error));
                } else {
                    let retryable = error.retryable || error.code < 300;
                    self.fail_with_code(words(&error), retryable, Some(error.code));
                }
                // A request that is out has its own answer, and what follows follows from that.
                if !matches!(self.stage, Stage::Asking { .. }) {
                    self.recover(now, &error);
                }
            }
            _ => self.note(words(&error)),
        }
    }
}

/// What shows that another camera has answered; its frames would not fit those that are there.
fn other_camera(before: &Greeting, now: &Greeting) -> Option<String> {
    let simulated = |greeting: &Greeting| if greeting.simulated { "simulated" } else { "real" }.to_owned();
    let texts = |greeting: &Greeting| {
        [
            ("model", greeting.model.clone()),
            ("serial", greeting.serial.clone()),
            ("kind", simulated(greeting)),
            ("calibration", greeting.calibration_id.to_string()),
        ]
    };
    texts(before)
        .into_iter()
        .zip(texts(now))
        .find(|(before, now)| before != now)
        .map(|((name, before), (_, now))| format!("{name} {now} instead of {before}"))
}
