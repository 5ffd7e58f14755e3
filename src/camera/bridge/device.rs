//! The vendor's side and its device: there, lost, starting anew.

use super::vendor::{Condition, Ready, Said};
use super::{Ask, Bridge, BridgeOutput};
use crate::camera::code;
use crate::camera::message::{DeviceEvent, ServerMessage, TRIGGER_ALL};
use crate::stamp::Stamp;

/// What is known of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Device {
    /// The vendor's side does not run.
    ToStart { at: Stamp },
    /// It runs and has not said `ready`.
    Starting { due: Stamp },
    /// It runs and says that its device is gone.
    Lost,
    /// Its device starts anew.
    Resetting,
    /// Its device does not work.
    Fault,
    /// Its device is there.
    Present,
}

impl Bridge {
    /// The vendor's side runs, or has connected.
    pub fn handle_vendor_started(&mut self, now: Stamp) {
        if self.device == Device::Present {
            // A second one has taken the place of the first.
            let text = "another program took the place of the vendor's side";
            self.lose_device(now, Device::Lost, 0, code::DEVICE_LOST, text);
        }
        self.device = Device::Starting {
            due: now.plus_ms(self.ready_timeout_ms),
        };
    }

    /// The vendor's side has ended, or could not be started.
    pub fn handle_vendor_ended(&mut self, now: Stamp, reason: &str) {
        self.note(format!("the vendor's side is gone: {reason}"));
        if self.device == Device::Present {
            self.lose_device(now, Device::Lost, 0, code::DEVICE_LOST, reason);
        }
        self.device = Device::ToStart {
            at: now.plus_ms(RESTART_MS),
        };
    }

    /// The vendor's side has said a line.
    pub fn handle_line(&mut self, now: Stamp, line: &str) {
        if line.trim().is_empty() {
            return;
        }
        let said = match Said::parse(line) {
            Ok(said) => said,
            Err(error) => {
                let line: String = line.chars().take(200).collect();
                return self.note(format!(
                    "a line of the vendor's side is not understood ({error}): {line}"
                ));
            }
        };
        match said {
            Said::Ready(ready) => self.handle_ready(now, *ready),
            Said::Configured {
                config_id,
                predicted_exposure_us,
                predicted_total_us,
            } => self.handle_configured(now, config_id, predicted_exposure_us, predicted_total_us),
            Said::Exposed { acquisition } => self.handle_exposed(now, acquisition),
            Said::Frame(files) => self.handle_files(now, files),
            Said::Error {
                acquisition,
                config_id,
                code,
                vendor_code,
                text,
            } => self.handle_vendor_error(now, acquisition, config_id, code, vendor_code, &text),
            Said::Status(condition) => self.condition = condition,
            Said::Pause { duration_ms, text } => {
                let trigger_id = self.flight.as_mut().map_or(TRIGGER_ALL, |flight| {
                    flight.pause(duration_ms);
                    flight.trigger_id.0
                });
                self.tell_event(now, DeviceEvent::COOLDOWN_PAUSE, trigger_id, duration_ms, &text);
            }
            Said::Lost { duration_ms, text } => {
                let (device, code) = match duration_ms {
                    0 => (Device::Lost, code::DEVICE_LOST),
                    _ => (Device::Resetting, code::RESET_IN_PROGRESS),
                };
                self.lose_device(now, device, duration_ms, code, &text);
            }
            Said::Fault { text } => self.lose_device(now, Device::Fault, 0, code::DEVICE_ABNORMAL, &text),
            Said::Note { text } => self.note(format!("the vendor's side: {text}")),
        }
    }

    fn handle_ready(&mut self, now: Stamp, ready: Ready) {
        if self.device == Device::Present {
            // It began anew without saying so: nothing of before is worth anything.
            self.lose_device(now, Device::Lost, 0, code::DEVICE_LOST, "the device began anew");
        }
        self.note(format!(
            "{} {}, serial number {}",
            ready.vendor, ready.model, ready.serial
        ));
        let text = format!("{} {}", ready.model, ready.serial);
        self.device = Device::Present;
        self.identity = Some(ready);
        self.condition = Condition::default();
        self.condition_due = now;
        self.tell_event(now, DeviceEvent::DEVICE_BACK, TRIGGER_ALL, 0, &text);
    }

    /// The device cannot be used: nothing is armed, no settings are in force, what is in flight ends.
    fn lose_device(&mut self, now: Stamp, device: Device, duration_ms: u32, code: u16, text: &str) {
        self.tell_event(now, DeviceEvent::DEVICE_LOST, TRIGGER_ALL, duration_ms, text);
        self.fail_flight(code, 0, duration_ms, text);
        self.fail_configuring(code, text);
        self.device = device;
        self.in_force = None;
        self.armed = false;
    }

    fn handle_vendor_error(
        &mut self,
        now: Stamp,
        acquisition: Option<u32>,
        config_id: Option<u32>,
        code: u16,
        vendor_code: i32,
        text: &str,
    ) {
        let flight = self
            .flight
            .as_ref()
            .filter(|flight| Some(flight.acquisition) == acquisition);
        let Some(trigger_id) = flight.map(|flight| flight.trigger_id.0) else {
            let asked = self
                .configuring
                .as_ref()
                .map(|configuring| configuring.wanted.config_id);
            if config_id.is_some() && asked == config_id {
                return self.fail_configuring(code, text);
            }
            return self.note(format!("the vendor's side: error {code} ({vendor_code}): {text}"));
        };
        let event = match code {
            code::TRIGGER_MISSED => Some(DeviceEvent::MISSED_TRIGGER),
            code::OVER_TEMPERATURE => Some(DeviceEvent::OVER_TEMPERATURE),
            _ => None,
        };
        if let Some(event) = event {
            self.tell_event(now, event, trigger_id, 0, text);
        }
        self.counts.missed += u32::from(code == code::TRIGGER_MISSED);
        let timeout = matches!(code, code::EXPOSURE_TIMEOUT | code::RECONSTRUCTION_TIMEOUT);
        self.counts.vendor_timeouts += u32::from(timeout);
        self.fail_flight(code, vendor_code, 0, text);
    }

    fn tell_event(&mut self, now: Stamp, code: u16, trigger_id: u64, duration_ms: u32, text: &str) {
        let event = DeviceEvent {
            code,
            trigger_id,
            device_ns: now.ns,
            duration_ms,
            text: text.to_owned(),
        };
        self.announce(&ServerMessage::Event(event));
    }

    /// Starts the vendor's side when it is time, and asks for its condition while nothing else is asked of it.
    pub(super) fn watch_device(&mut self, now: Stamp) {
        match self.device {
            Device::ToStart { at } if at <= now => {
                self.handle_vendor_started(now);
                self.outbox.push_back(BridgeOutput::StartVendor);
            }
            Device::Starting { due } if due <= now => {
                self.note("the vendor's side did not say ready in time".to_owned());
                self.device = Device::ToStart { at: now };
            }
            Device::Present if self.condition_due <= now => {
                self.condition_due = now.plus_ms(CONDITION_MS);
                if self.flight.is_none() {
                    self.ask_vendor(&Ask::Status);
                }
            }
            _ => {}
        }
    }

    /// When [`Self::watch_device`] has something to do.
    pub(super) fn device_due(&self) -> Option<Stamp> {
        match self.device {
            Device::ToStart { at } => Some(at),
            Device::Starting { due } => Some(due),
            Device::Present => Some(self.condition_due),
            Device::Lost | Device::Resetting | Device::Fault => None,
        }
    }
}

/// Between the end of the vendor's side and its next start.
const RESTART_MS: u64 = 2000;
/// Between two questions for the device's condition.
const CONDITION_MS: u64 = 5000;
