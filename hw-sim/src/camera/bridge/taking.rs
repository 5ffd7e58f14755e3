//! Requests that change settings or take a frame, and what the state of the camera says to them.

use super::{Bridge, Condition, Refusal, Step};
use crate::camera::acquisition::{Acquisition, Config, Stage, capture};
use crate::camera::device::DeviceSettings;
use crate::camera::fields::{Rest, Zero};
use crate::camera::identity::{STATE_ARMED, STATE_IDLE};
use crate::camera::message::{Arm, Caps, Configured, Message, NO_TRIGGER, Trigger, TriggerOk};
use crate::camera::script::{Mark, is_lasting, is_of_connection, is_of_device};
use crate::camera::settings::{Settings, SettingsError};
use crate::camera::transfer;
use crate::camera::trouble::{Phase, Trouble};
use crate::checks::refuse_first;
use crate::fault::Fault;

impl Bridge {
    /// CONFIGURE.
    pub(crate) fn configure(
        &mut self,
        now_ns: u64,
        records: &[u8],
        caps: &Caps,
        device: &DeviceSettings,
    ) -> Result<Configured, Refusal> {
        let refused = |error: SettingsError| Refusal::new(error.code(), &error.to_string());
        let settings = Settings::read(records);
        if let Err(error @ SettingsError::Damaged { .. }) = settings {
            return Err(refused(error));
        }
        self.check_working(now_ns)?;
        self.check_state(STATE_IDLE, "settings change in IDLE only")?;
        let settings = settings.map_err(refused)?;
        settings.check(caps).map_err(refused)?;
        self.counts.configs += 1;
        let [width_px, height_px] = settings.size_px(caps).map(u64::from);
        let pixel_bytes: u64 = settings
            .kinds()
            .map(|kind| u64::from(transfer::pixel_bytes(kind)))
            .sum();
        let mut echo = settings.clone();
        if device.faults.contains(&Fault::ConfigEcho) {
            echo.exposure_us += 1;
        }
        let config = Config::new(self.counts.configs, settings, device.speed);
        let configured = Configured {
            config_id: config.id,
            predicted_exposure_us: config.exposure_us,
            predicted_total_us: config.total_us,
            frame_bytes: width_px * height_px * pixel_bytes,
            settings: Rest(echo.to_records()),
        };
        self.config = Some(config);
        Ok(configured)
    }

    /// ARM; the state after it.
    pub(crate) fn arm(&mut self, now_ns: u64, arm: &Arm) -> Result<u8, Refusal> {
        self.check_working(now_ns)?;
        self.check_state(STATE_IDLE, "arm in IDLE only")?;
        let is_in_force = self.config.as_ref().is_some_and(|config| config.id == arm.config_id);
        refuse_first([
            (arm.mode != MODE_SOFTWARE, (301, "only the software trigger is served")),
            (!is_in_force, (206, "these settings are not in force")),
        ])
        .map_err(|(code, text)| Refusal::new(code, text))?;
        self.is_armed = true;
        Ok(self.state())
    }

    /// DISARM; the state after it. An acquisition in flight must be aborted first.
    pub(crate) fn disarm(&mut self) -> Result<u8, Refusal> {
        if self.acquisition.is_some() {
            return Err(Refusal::new(203, "a trigger is in flight"));
        }
        self.is_armed = false;
        Ok(self.state())
    }

    /// TRIGGER.
    pub(crate) fn trigger(
        &mut self,
        now_ns: u64,
        connection: u64,
        request_id: u32,
        trigger: &Trigger,
    ) -> Result<(), Refusal> {
        let trigger_id = trigger.trigger_id;
        let about_trigger = |refusal: Refusal| Refusal {
            trigger_id,
            phase: PHASE_ACKNOWLEDGE,
            ..refusal
        };
        if let Some(flying) = self
            .acquisition
            .as_ref()
            .filter(|flying| flying.trigger_id == trigger_id)
        {
            let reply = trigger_ok(trigger_id, 1, Some(&flying.config));
            self.push_reply(connection, request_id, reply, Mark::default());
            return Ok(());
        }
        if self.store.has_ended(trigger_id) {
            let reply = trigger_ok(trigger_id, 2, self.config.as_ref());
            self.push_reply(connection, request_id, reply, Mark::default());
            return Ok(());
        }
        let config = self.check_trigger(now_ns, trigger).map_err(about_trigger)?;
        if let Some(trouble) = self.script.meet(trigger_id, Phase::Request, is_of_connection) {
            self.strike(now_ns, trouble, trigger_id, PHASE_ACKNOWLEDGE);
            return Ok(());
        }
        if let Some(trouble) = self.script.meet(trigger_id, Phase::Request, is_lasting) {
            self.leave(now_ns, trouble);
            return Err(about_trigger(self.check_working(now_ns).err().unwrap_or_else(broken)));
        }
        let is_refused = |trouble| is_of_device(trouble) && !is_lasting(trouble);
        if let Some(trouble) = self.script.meet(trigger_id, Phase::Acknowledge, is_refused) {
            return Err(about_trigger(self.failure(
                now_ns,
                trouble,
                trigger_id,
                PHASE_ACKNOWLEDGE,
            )));
        }
        self.accept(now_ns, connection, trigger, config);
        self.acknowledge(now_ns, connection, request_id, trigger_id);
        Ok(())
    }

    /// The settings that a new trigger is taken with. The checks stand in the order of the page.
    fn check_trigger(&self, now_ns: u64, trigger: &Trigger) -> Result<Config, Refusal> {
        self.check_working(now_ns)?;
        if self.acquisition.is_some() {
            return Err(Refusal::new(204, "another trigger is in flight"));
        }
        let Some(config) = self.config.as_ref().filter(|_| self.state() == STATE_ARMED) else {
            return Err(Refusal::new(202, "not armed"));
        };
        refuse_first([
            (trigger.trigger_id == NO_TRIGGER, (301, "this id stands for none")),
            (trigger.tag.0.len() > TAG_BYTES_MAX, (301, "the tag is too long")),
            (config.id != trigger.config_id, (206, "these settings are not in force")),
        ])
        .map_err(|(code, text)| Refusal::new(code, text))?;
        match self.refusing {
            Some((code, until_ns)) if now_ns < until_ns => Err(Refusal {
                retry_after_ms: ms_until(now_ns, until_ns),
                ..Refusal::new(code, "the device is not to be had")
            }),
            _ => Ok(config.clone()),
        }
    }

    fn accept(&mut self, now_ns: u64, connection: u64, trigger: &Trigger, config: Config) {
        let trigger_id = trigger.trigger_id;
        self.counts.since_start.triggers += 1;
        self.counts.jobs += 1;
        self.thermal.handle_trigger();
        let exposure_ns = u64::from(config.exposure_us) * 1000;
        let mut acquisition = Acquisition {
            job: self.counts.jobs,
            trigger_id,
            view_id: trigger.view_id,
            begin_ns: now_ns,
            exposure_mid_ns: now_ns + exposure_ns / 2,
            exposure_end_ns: now_ns + exposure_ns,
            reconstruction_end_ns: now_ns + u64::from(config.total_us) * 1000,
            deadline_ns: (trigger.deadline_ms > 0).then(|| now_ns + u64::from(trigger.deadline_ms) * 1_000_000),
            pause_us: config.pause_us,
            config,
            frame: None,
            stage: Stage::Exposing,
            receiver: Some(connection),
            told: None,
        };
        let is_late = |trouble| matches!(trouble, Trouble::Late { .. });
        if let Some(Trouble::Late { delay_s }) = self.script.meet(trigger_id, Phase::Exposure, is_late) {
            acquisition.put_off((delay_s * 1e9) as u64);
        }
        if let Some(Trouble::Late { delay_s }) = self.script.meet(trigger_id, Phase::Reconstruction, is_late) {
            acquisition.reconstruction_end_ns += (delay_s * 1e9) as u64;
        }
        self.acquisition = Some(acquisition);
    }

    /// TRIGGER_OK, and what goes wrong about it. The exposure begins in any case.
    fn acknowledge(&mut self, now_ns: u64, connection: u64, request_id: u32, trigger_id: u64) {
        let Some(acquisition) = &self.acquisition else { return };
        let reply = trigger_ok(trigger_id, 0, Some(&acquisition.config));
        let expose = Step::Expose {
            job: acquisition.job,
            trigger_id,
            capture: capture(&acquisition.config.settings),
        };
        match self.script.meet(trigger_id, Phase::Acknowledge, is_of_connection) {
            Some(trouble) => {
                self.steps.push_back(expose);
                self.strike(now_ns, trouble, trigger_id, PHASE_ACKNOWLEDGE);
            }
            None => {
                let mark = self.script.mark(trigger_id, Phase::Acknowledge);
                self.push_reply(connection, request_id, reply, mark);
                self.steps.push_back(expose);
            }
        }
        if let Some(trouble) = self.script.meet(trigger_id, Phase::Acknowledge, is_lasting) {
            self.leave(now_ns, trouble);
        }
    }

    fn push_reply(&mut self, to: u64, request_id: u32, message: Message, mark: Mark) {
        self.steps.push_back(Step::Send {
            to,
            request_id,
            message,
            mark,
        });
    }

    /// What the device's absence refuses.
    fn check_working(&self, now_ns: u64) -> Result<(), Refusal> {
        match self.condition {
            Condition::Working => Ok(()),
            Condition::Broken => Err(broken()),
            Condition::Away { code, back_ns, .. } => Err(Refusal {
                // What is lost is back nobody knows when.
                retry_after_ms: if code == CODE_RESETTING {
                    ms_until(now_ns, back_ns)
                } else {
                    0
                },
                ..Refusal::new(code, "the device is away")
            }),
        }
    }

    fn check_state(&self, state: u8, text: &str) -> Result<(), Refusal> {
        if self.state() == state {
            Ok(())
        } else {
            Err(Refusal::new(203, text))
        }
    }
}

fn broken() -> Refusal {
    Refusal::new(500, "the device does not work")
}

fn trigger_ok(trigger_id: u64, repeated: u8, config: Option<&Config>) -> Message {
    Message::TriggerOk(TriggerOk {
        trigger_id,
        repeated,
        reserved: Zero,
        predicted_exposure_us: config.map_or(0, |config| config.exposure_us),
        predicted_total_us: config.map_or(0, |config| config.total_us),
    })
}

fn ms_until(now_ns: u64, until_ns: u64) -> u32 {
    u32::try_from(until_ns.saturating_sub(now_ns).div_ceil(1_000_000)).unwrap_or(u32::MAX)
}

const PHASE_ACKNOWLEDGE: u8 = 1;
const MODE_SOFTWARE: u8 = 1;
const CODE_RESETTING: u16 = 504;
const TAG_BYTES_MAX: usize = 64;
