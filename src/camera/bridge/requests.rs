//! What a controller asks for, in the order of the page's checks: role (before), state, values.

use super::connection::ConnectionId;
use super::flight::{Flight, Stage};
use super::transfer::{Sending, Transfer};
use super::vendor::AskedSettings;
use super::{Ask, Bridge, InForce, KNOWN_MAX, ranges};
use crate::camera::code;
use crate::camera::message::{
    Aborted, AcquisitionPhase, Arm, CameraState, Configured, DeviceEvent, FetchOk, FetchState, Repeated, ServerMessage,
    TRIGGER_ALL, Trigger, TriggerId, TriggerOk,
};
use crate::camera::settings::CameraSettings;
use crate::stamp::Stamp;

/// A CONFIGURE that waits for the vendor's side.
#[derive(Debug)]
pub(super) struct Configuring {
    connection: ConnectionId,
    request_id: u32,
    pub(super) wanted: InForce,
    pub(super) due: Stamp,
}

impl Bridge {
    pub(super) fn configure(&mut self, now: Stamp, id: ConnectionId, request_id: u32, settings: CameraSettings) {
        if let Err((code, text)) = self.must_be_idle() {
            return self.refuse(id, request_id, code, text);
        }
        if let Err(refusal) = ranges::check(&settings, &self.caps) {
            return self.refuse(id, request_id, refusal.code, &refusal.text);
        }
        let config_id = self.next_config_id;
        self.next_config_id = config_id.checked_add(1).unwrap_or(1);
        let predicted_exposure_us = ranges::exposure_us(&settings);
        self.configuring = Some(Configuring {
            connection: id,
            request_id,
            wanted: InForce {
                config_id,
                settings,
                predicted_exposure_us,
                predicted_total_us: predicted_exposure_us.saturating_add(self.reconstruction_us),
            },
            due: now.plus_ms(CONFIGURE_MS),
        });
        self.ask_vendor(&Ask::Configure {
            config_id,
            settings: AskedSettings::new(&settings),
        });
    }

    /// The vendor's side has taken the settings, and may know better how long a frame takes.
    pub(super) fn handle_configured(
        &mut self,
        now: Stamp,
        config_id: u32,
        exposure_us: Option<u32>,
        total_us: Option<u32>,
    ) {
        let Some(configuring) = self.configuring.take_if(|open| open.wanted.config_id == config_id) else {
            return self.note(format!("settings {config_id} are in force, which nobody waits for"));
        };
        let mut wanted = configuring.wanted;
        let known_us = wanted.predicted_total_us - wanted.predicted_exposure_us;
        wanted.predicted_exposure_us = exposure_us.unwrap_or(wanted.predicted_exposure_us);
        let total_us = total_us.unwrap_or(wanted.predicted_exposure_us.saturating_add(known_us));
        wanted.predicted_total_us = total_us.max(wanted.predicted_exposure_us);
        if !self.identity.as_ref().is_some_and(|identity| identity.says_exposed) {
            wanted.predicted_exposure_us = wanted.predicted_total_us;
        }
        self.in_force = Some(wanted);
        let configured = Configured {
            config_id,
            predicted_exposure_us: wanted.predicted_exposure_us,
            predicted_total_us: wanted.predicted_total_us,
            frame_bytes: ranges::frame_bytes(&wanted.settings, &self.caps),
            settings: wanted.settings,
        };
        self.reply(
            configuring.connection,
            configuring.request_id,
            &ServerMessage::Configured(configured),
        );
        let changed = ServerMessage::Event(DeviceEvent {
            code: DeviceEvent::CONFIG_CHANGED,
            trigger_id: TRIGGER_ALL,
            device_ns: now.ns,
            duration_ms: 0,
            text: format!("settings {config_id}"),
        });
        let controller = self.controller;
        for (id, connection) in &mut self.connections {
            if connection.role == super::Role::Observer && Some(*id) != controller {
                connection.say(&mut self.outbox, &changed);
            }
        }
    }

    /// An open CONFIGURE ends without settings.
    pub(super) fn fail_configuring(&mut self, code: u16, text: &str) {
        if let Some(configuring) = self.configuring.take() {
            self.refuse(configuring.connection, configuring.request_id, code, text);
        }
    }

    pub(super) fn watch_requests(&mut self, now: Stamp) {
        if self
            .configuring
            .as_ref()
            .is_some_and(|configuring| configuring.due <= now)
        {
            self.counts.vendor_timeouts += 1;
            self.fail_configuring(
                code::DEVICE_ABNORMAL,
                "the vendor's side did not take the settings in time",
            );
        }
    }

    pub(super) fn arm(&mut self, id: ConnectionId, request_id: u32, arm: Arm) {
        if let Err((code, text)) = self.must_be_idle() {
            return self.refuse(id, request_id, code, text);
        }
        if self.in_force.is_none_or(|in_force| in_force.config_id != arm.config_id) {
            return self.refuse(id, request_id, code::WRONG_CONFIG_ID, "these settings are not in force");
        }
        if arm.mode != Arm::SOFTWARE {
            return self.refuse(id, request_id, code::OUT_OF_RANGE, "mode: software triggers only");
        }
        self.armed = true;
        let state = self.state();
        self.reply(id, request_id, &ServerMessage::Armed { state });
    }

    /// CONFIGURE and ARM want IDLE and no CONFIGURE under way.
    fn must_be_idle(&self) -> Result<(), (u16, &'static str)> {
        match self.state() {
            CameraState::Idle if self.configuring.is_none() => Ok(()),
            CameraState::Idle => Err((code::WRONG_STATE, "a CONFIGURE is being carried out")),
            state => Err(no_device(state).unwrap_or((code::WRONG_STATE, "only in IDLE"))),
        }
    }

    pub(super) fn disarm(&mut self, id: ConnectionId, request_id: u32) {
        let state = self.state();
        if matches!(
            state,
            CameraState::Exposing | CameraState::Reconstructing | CameraState::Sending
        ) {
            return self.refuse(id, request_id, code::WRONG_STATE, "an acquisition is in flight");
        }
        self.armed = false;
        let state = self.state();
        self.reply(id, request_id, &ServerMessage::Disarmed { state });
    }

    pub(super) fn trigger(&mut self, now: Stamp, id: ConnectionId, request_id: u32, trigger: &Trigger) {
        let trigger_id = trigger.trigger_id;
        if let Some(known) = self.repeated(now, trigger_id) {
            return self.reply(id, request_id, &ServerMessage::TriggerOk(known));
        }
        let in_force = match self.may_trigger(trigger) {
            Ok(in_force) => in_force,
            Err((code, text)) => return self.refuse_trigger(id, request_id, trigger_id.0, code, text),
        };
        let acquisition = self.next_acquisition;
        self.next_acquisition = acquisition.checked_add(1).unwrap_or(1);
        if self.run.known.len() == KNOWN_MAX {
            self.run.known.pop_front();
        }
        self.run.known.push_back(trigger_id);
        self.counts.triggers += 1;
        self.flight = Some(Flight::new(now, acquisition, id, trigger, in_force));
        self.note(format!(
            "acquisition {acquisition}: trigger {:#x}, {}",
            trigger_id.0, trigger.tag
        ));
        self.ask_vendor(&Ask::Acquire {
            acquisition,
            config_id: in_force.config_id,
        });
        let accepted = TriggerOk {
            trigger_id,
            repeated: Repeated::New,
            predicted_exposure_us: in_force.predicted_exposure_us,
            predicted_total_us: in_force.predicted_total_us,
        };
        self.reply(id, request_id, &ServerMessage::TriggerOk(accepted));
    }

    /// The settings a trigger is taken with, or why it is not.
    fn may_trigger(&self, trigger: &Trigger) -> Result<InForce, (u16, &'static str)> {
        let state = self.state();
        if let Some(refusal) = no_device(state) {
            return Err(refusal);
        }
        let in_force = match (state, self.in_force) {
            (CameraState::Idle, _) | (_, None) => return Err((code::NOT_ARMED, "not armed")),
            (CameraState::Armed, Some(in_force)) => in_force,
            _ => return Err((code::TRIGGER_IN_FLIGHT, "another acquisition is in flight")),
        };
        if in_force.config_id != trigger.config_id {
            return Err((code::WRONG_CONFIG_ID, "these settings are not in force"));
        }
        if trigger.trigger_id.0 == TRIGGER_ALL || trigger.tag.len() > TAG_BYTES_MAX {
            return Err((code::OUT_OF_RANGE, "trigger_id or tag: out of range"));
        }
        Ok(in_force)
    }

    /// What is said to a trigger id that was used before.
    fn repeated(&self, now: Stamp, trigger_id: TriggerId) -> Option<TriggerOk> {
        let known = |repeated, predicted_exposure_us, predicted_total_us| TriggerOk {
            trigger_id,
            repeated,
            predicted_exposure_us,
            predicted_total_us,
        };
        if let Some(flight) = self.flight.as_ref().filter(|flight| flight.trigger_id == trigger_id) {
            let [exposure_us, total_us] = flight.remaining_us(now);
            return Some(known(Repeated::InFlight, exposure_us, total_us));
        }
        let mut transfers = self.transfer.iter().chain(&self.waiting);
        if transfers.any(|transfer| transfer.trigger_id() == trigger_id && transfer.sending == Sending::First) {
            return Some(known(Repeated::InFlight, 0, 0));
        }
        let mut ids = self.run.known.iter();
        ids.any(|id| *id == trigger_id).then(|| known(Repeated::Done, 0, 0))
    }

    pub(super) fn fetch(&mut self, now: Stamp, id: ConnectionId, request_id: u32, trigger_id: TriggerId) {
        let mut found = FetchOk {
            trigger_id,
            state: FetchState::InFlight,
            remaining_us: 0,
        };
        if self.transfer.is_some() || !self.waiting.is_empty() {
            let text = "another frame is being sent";
            return self.refuse_trigger(id, request_id, trigger_id.0, code::TRIGGER_IN_FLIGHT, text);
        }
        if let Some(flight) = self.flight.as_mut().filter(|flight| flight.trigger_id == trigger_id) {
            flight.listener = Some(id);
            found.remaining_us = flight.remaining_us(now)[1];
            return self.reply(id, request_id, &ServerMessage::FetchOk(found));
        }
        let stored = self.run.store.iter().find(|frame| frame.begin.trigger_id == trigger_id);
        let Some(frame) = stored.cloned() else {
            let text = "no frame of this trigger is stored";
            return self.refuse_trigger(id, request_id, trigger_id.0, code::STORE_MISS, text);
        };
        found.state = FetchState::Stored;
        self.reply(id, request_id, &ServerMessage::FetchOk(found));
        self.transfer = Some(Transfer::new(now, id, frame, Sending::Again));
    }

    pub(super) fn abort(&mut self, now: Stamp, id: ConnectionId, request_id: u32, trigger_id: u64) {
        let meant = |candidate: TriggerId| trigger_id == TRIGGER_ALL || trigger_id == candidate.0;
        let mut aborted = Aborted {
            trigger_id,
            phase: AcquisitionPhase::None,
        };
        let transfer = self.transfer.take_if(|transfer| meant(transfer.trigger_id()));
        if let Some(transfer) = &transfer {
            aborted.trigger_id = transfer.trigger_id().0;
            aborted.phase = AcquisitionPhase::Transfer;
            if transfer.sending == Sending::First {
                self.run
                    .store
                    .retain(|frame| frame.begin.trigger_id != transfer.trigger_id());
            }
        }
        if let Some(flight) = self.flight.take_if(|flight| meant(flight.trigger_id)) {
            aborted.trigger_id = flight.trigger_id.0;
            aborted.phase = match flight.stage {
                Stage::Exposing => AcquisitionPhase::Exposure,
                Stage::Reconstructing => AcquisitionPhase::Reconstruction,
            };
            self.ask_vendor(&Ask::Abort {
                acquisition: flight.acquisition,
            });
        }
        self.waiting.retain(|waiting| !meant(waiting.trigger_id()));
        self.reply(id, request_id, &ServerMessage::Aborted(aborted));
        if let Some(transfer) = transfer {
            if transfer.has_begun()
                && let Some(connection) = self.connections.get_mut(&transfer.connection)
            {
                connection.say(&mut self.outbox, &ServerMessage::FrameEnd(transfer.broken_off()));
            }
            self.next_transfer(now);
        }
    }
}

/// The error of a state in which no device can be asked for anything.
fn no_device(state: CameraState) -> Option<(u16, &'static str)> {
    match state {
        CameraState::Offline => Some((code::DEVICE_LOST, "no device is connected")),
        CameraState::Fault => Some((code::DEVICE_ABNORMAL, "the device has a fault")),
        CameraState::Resetting => Some((code::RESET_IN_PROGRESS, "the device starts anew")),
        _ => None,
    }
}

/// The vendor's side must take settings within so long: before the client's 5 s are over.
const CONFIGURE_MS: u64 = 4500;
const TAG_BYTES_MAX: usize = 64;
