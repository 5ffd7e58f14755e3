//! One controller's session: its settings, and the acquisition in flight.

use std::collections::VecDeque;

use crate::camera::acquisition::{Acquisition, Config, Stage, capture, predicted_us};
use crate::camera::device::{Counts, DeviceSettings};
use crate::camera::fields::{Rest, Zero};
use crate::camera::identity::{LINK_MBIT_S, STATE_IDLE};
use crate::camera::message::{Aborted, Caps, Configured, FrameEnd, Message, NO_TRIGGER, Trigger, TriggerOk};
use crate::camera::render::{Capture, Frame};
use crate::camera::settings::{Settings, SettingsError};
use crate::camera::transfer::{self, Transfer};
use crate::checks::refuse_first;
use crate::fault::Fault;

/// State between HELLO and the end of the connection.
#[derive(Clone, Debug)]
pub(crate) struct Session {
    /// Connection of the controller.
    pub(crate) connection: u64,
    status_ns: u64,
    ping_ns: u64,
    ping_id: u32,
    config: Option<Config>,
    is_armed: bool,
    acquisition: Option<Acquisition>,
    /// Trigger ids that ended, oldest first.
    done: VecDeque<u64>,
    /// Due and not yet polled.
    steps: VecDeque<Step>,
}

/// What a session wants done at its time.
#[derive(Clone, Debug)]
pub(crate) enum Step {
    Send(Message),
    SendStatus,
    Ping(u32),
    Error(Refusal),
    Exposed(u64),
    FallSilent,
    HangUp,
}

/// Why a request is not carried out, or an acquisition ends without a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub(crate) code: u16,
    pub(crate) trigger_id: u64,
    pub(crate) phase: u8,
    pub(crate) is_retryable: bool,
    pub(crate) text: String,
}

impl Session {
    pub(crate) fn new(now_ns: u64, connection: u64) -> Self {
        Self {
            connection,
            status_ns: now_ns + SIGN_OF_LIFE_NS,
            ping_ns: now_ns + SIGN_OF_LIFE_NS / 2,
            ping_id: 1,
            config: None,
            is_armed: false,
            acquisition: None,
            done: VecDeque::new(),
            steps: VecDeque::new(),
        }
    }

    /// State of section 3 of the page.
    pub(crate) fn state(&self) -> u8 {
        match &self.acquisition {
            Some(Acquisition {
                stage: Stage::Exposing, ..
            }) => STATE_EXPOSING,
            Some(Acquisition {
                stage: Stage::Reconstructing,
                ..
            }) => STATE_RECONSTRUCTING,
            Some(Acquisition {
                stage: Stage::Sending { .. },
                ..
            }) => STATE_SENDING,
            None if self.is_armed => STATE_ARMED,
            None => STATE_IDLE,
        }
    }

    pub(crate) fn configure(
        &mut self,
        records: &[u8],
        caps: &Caps,
        device: &DeviceSettings,
        counts: &mut Counts,
    ) -> Result<Configured, Refusal> {
        if self.state() != STATE_IDLE {
            return Err(Refusal::new(203, "settings change in IDLE only"));
        }
        let refused = |error: SettingsError| Refusal::new(error.code(), &error.to_string());
        let settings = Settings::read(records).map_err(refused)?;
        settings.check(caps).map_err(refused)?;
        counts.configs += 1;
        let (exposure_us, total_us) = predicted_us(&settings, device.speed);
        let [width_px, height_px] = settings.size_px(caps).map(u64::from);
        let pixel_bytes: u64 = settings
            .kinds()
            .map(|kind| u64::from(transfer::pixel_bytes(kind)))
            .sum();
        let mut echo = settings.clone();
        if device.faults.contains(&Fault::ConfigEcho) {
            echo.exposure_us += 1;
        }
        self.config = Some(Config {
            id: counts.configs,
            settings,
            exposure_us,
            total_us,
        });
        Ok(Configured {
            config_id: counts.configs,
            predicted_exposure_us: exposure_us,
            predicted_total_us: total_us,
            frame_bytes: width_px * height_px * pixel_bytes,
            settings: Rest(echo.to_records()),
        })
    }

    /// State after it.
    pub(crate) fn arm(&mut self, mode: u8, config_id: u32) -> Result<u8, Refusal> {
        let is_in_force = self.config.as_ref().is_some_and(|config| config.id == config_id);
        refuse_first([
            (self.state() != STATE_IDLE, (203, "arm in IDLE only")),
            (mode != MODE_SOFTWARE, (301, "only the software trigger is served")),
            (!is_in_force, (206, "these settings are not in force")),
        ])
        .map_err(|(code, text)| Refusal::new(code, text))?;
        self.is_armed = true;
        Ok(self.state())
    }

    /// State after it. An acquisition in flight must be aborted first.
    pub(crate) fn disarm(&mut self) -> Result<u8, Refusal> {
        if self.acquisition.is_some() {
            return Err(Refusal::new(203, "a trigger is in flight"));
        }
        self.is_armed = false;
        Ok(self.state())
    }

    /// Reply, and the job to render when the trigger is new.
    pub(crate) fn trigger(
        &mut self,
        now_ns: u64,
        trigger: &Trigger,
        counts: &mut Counts,
        device: &DeviceSettings,
    ) -> Result<(TriggerOk, Option<(u64, Capture)>), Refusal> {
        let refused = |code, text| {
            Err(Refusal {
                trigger_id: trigger.trigger_id,
                phase: PHASE_ACKNOWLEDGE,
                ..Refusal::new(code, text)
            })
        };
        let reply = |repeated, config: Option<&Config>| TriggerOk {
            trigger_id: trigger.trigger_id,
            repeated,
            reserved: Zero,
            predicted_exposure_us: config.map_or(0, |config| config.exposure_us),
            predicted_total_us: config.map_or(0, |config| config.total_us),
        };
        if let Some(acquisition) = self
            .acquisition
            .as_ref()
            .filter(|flying| flying.trigger_id == trigger.trigger_id)
        {
            return Ok((reply(1, Some(&acquisition.config)), None));
        }
        if self.done.contains(&trigger.trigger_id) {
            return Ok((reply(2, self.config.as_ref()), None));
        }
        if self.acquisition.is_some() {
            return refused(204, "another trigger is in flight");
        }
        let Some(config) = self.config.as_ref().filter(|_| self.is_armed) else {
            return refused(202, "not armed");
        };
        if config.id != trigger.config_id {
            return refused(206, "these settings are not in force");
        }
        if trigger.trigger_id == NO_TRIGGER {
            return refused(301, "this id stands for none");
        }
        counts.triggers += 1;
        let job = u64::from(counts.triggers);
        let exposure_end_ns = now_ns + u64::from(config.exposure_us) * 1000;
        let fault = meet_fault(trigger.trigger_id, counts, device);
        let delay_ns = match fault {
            Some(Fault::LateFrame { delay_s, .. }) => (delay_s * 1e9) as u64,
            _ => 0,
        };
        self.acquisition = Some(Acquisition {
            job,
            trigger_id: trigger.trigger_id,
            view_id: trigger.view_id,
            config: config.clone(),
            begin_ns: now_ns,
            exposure_end_ns,
            reconstruction_end_ns: now_ns + u64::from(config.total_us) * 1000 + delay_ns,
            deadline_ns: (trigger.deadline_ms > 0).then(|| now_ns + u64::from(trigger.deadline_ms) * 1_000_000),
            frame: None,
            stage: Stage::Exposing,
            fault,
        });
        Ok((reply(0, Some(config)), Some((job, capture(&config.settings)))))
    }

    /// Ends the acquisition if it is the one meant. FRAME_END follows when the frame had begun.
    pub(crate) fn abort(&mut self, trigger_id: u64) -> (Aborted, Option<FrameEnd>) {
        let is_meant = |flying: &mut Acquisition| trigger_id == NO_TRIGGER || flying.trigger_id == trigger_id;
        let Some(acquisition) = self.acquisition.take_if(is_meant) else {
            return (
                Aborted {
                    trigger_id,
                    phase: 0,
                    reserved: Zero,
                },
                None,
            );
        };
        self.finish(acquisition.trigger_id);
        let aborted = Aborted {
            trigger_id: acquisition.trigger_id,
            phase: acquisition.phase(),
            reserved: Zero,
        };
        let frame_end = match &acquisition.stage {
            Stage::Sending { transfer, .. } => Some(transfer.end_early(1)),
            _ => None,
        };
        (aborted, frame_end)
    }

    /// Keeps the frame if its acquisition still waits for it.
    pub(crate) fn take_frame(&mut self, job: u64, frame: Frame) {
        if let Some(acquisition) = self.acquisition.as_mut().filter(|flying| flying.job == job) {
            acquisition.frame = Some(frame);
        }
    }

    /// When [`Session::poll_step`] has something.
    pub(crate) fn wake_at(&self) -> Option<u64> {
        let acquisition_ns = self
            .acquisition
            .as_ref()
            .and_then(|flying| [flying.due_ns(), flying.deadline_ns].into_iter().flatten().min());
        [Some(self.status_ns), Some(self.ping_ns), acquisition_ns]
            .into_iter()
            .flatten()
            .min()
    }

    /// Next thing that is due.
    pub(crate) fn poll_step(&mut self, now_ns: u64, counts: &mut Counts, device: &DeviceSettings) -> Option<Step> {
        if self.steps.is_empty() {
            self.take_what_is_due(now_ns, counts, device);
        }
        self.steps.pop_front()
    }

    fn take_what_is_due(&mut self, now_ns: u64, counts: &mut Counts, device: &DeviceSettings) {
        if self.status_ns <= now_ns {
            self.status_ns = now_ns + SIGN_OF_LIFE_NS;
            self.steps.push_back(Step::SendStatus);
        }
        if self.ping_ns <= now_ns {
            self.ping_ns = now_ns + SIGN_OF_LIFE_NS;
            self.steps.push_back(Step::Ping(self.ping_id));
            self.ping_id = self.ping_id.wrapping_add(1).max(1);
        }
        let Some(acquisition) = &mut self.acquisition else {
            return;
        };
        let due_ns = acquisition.due_ns().filter(|due_ns| *due_ns <= now_ns);
        if acquisition
            .deadline_ns
            .is_some_and(|deadline_ns| deadline_ns <= due_ns.unwrap_or(now_ns))
        {
            return self.give_up(407, "the deadline has passed");
        }
        match (&acquisition.stage, due_ns) {
            (_, None) => (),
            (Stage::Exposing, _) => {
                acquisition.stage = Stage::Reconstructing;
                self.steps
                    .extend([Step::Send(acquisition.exposure_done()), Step::Exposed(acquisition.job)]);
            }
            (Stage::Reconstructing, _) => self.begin_frame(now_ns, counts),
            (Stage::Sending { .. }, _) => self.send_chunk(counts, device),
        }
    }

    fn begin_frame(&mut self, now_ns: u64, counts: &Counts) {
        let Some(acquisition) = &mut self.acquisition else {
            return;
        };
        if let Some(Fault::CameraError { code, .. }) = acquisition.fault {
            return self.give_up(code, "a fault of the simulation");
        }
        let Some(mut frame) = acquisition.frame.take() else {
            return;
        };
        if matches!(acquisition.fault, Some(Fault::EmptyFrame { .. })) {
            transfer::empty(&mut frame);
        }
        let head = acquisition.head(now_ns, u64::from(counts.frames) + 1);
        let mut transfer = Transfer::new(head, &acquisition.config.settings, frame);
        if matches!(acquisition.fault, Some(Fault::CorruptChunk { .. })) {
            transfer.damage();
        }
        self.steps
            .push_back(Step::Send(Message::FrameBegin(transfer.begin().clone())));
        acquisition.stage = Stage::Sending {
            transfer: Box::new(transfer),
            next_ns: now_ns,
        };
    }

    fn send_chunk(&mut self, counts: &mut Counts, device: &DeviceSettings) {
        let Some(Acquisition {
            stage: Stage::Sending { transfer, next_ns },
            fault,
            ..
        }) = &mut self.acquisition
        else {
            return;
        };
        if transfer.is_half_sent() {
            match fault.take() {
                Some(Fault::CameraGone { .. }) => return self.steps.push_back(Step::HangUp),
                Some(Fault::CameraSilent { .. }) => return self.steps.push_back(Step::FallSilent),
                _ => (),
            }
        }
        match transfer.poll_chunk() {
            Some(chunk) => {
                let link_ns = chunk.data.0.len() as f64 * 8e3 / f64::from(LINK_MBIT_S);
                *next_ns += (link_ns / device.speed) as u64;
                self.steps.push_back(Step::Send(Message::FrameChunk(chunk)));
            }
            None => {
                let frame_end = transfer.end_complete();
                let trigger_id = frame_end.tail.trigger_id;
                counts.frames += 1;
                self.steps.push_back(Step::Send(Message::FrameEnd(frame_end)));
                self.acquisition = None;
                self.finish(trigger_id);
            }
        }
    }

    /// Ends the acquisition with an ERROR that names it, and the frame if it had begun.
    fn give_up(&mut self, code: u16, text: &str) {
        let Some(acquisition) = self.acquisition.take() else {
            return;
        };
        self.finish(acquisition.trigger_id);
        self.steps.push_back(Step::Error(Refusal {
            trigger_id: acquisition.trigger_id,
            phase: acquisition.phase(),
            is_retryable: true,
            ..Refusal::new(code, text)
        }));
        if let Stage::Sending { transfer, .. } = &acquisition.stage {
            self.steps
                .push_back(Step::Send(Message::FrameEnd(transfer.end_early(2))));
        }
    }

    fn finish(&mut self, trigger_id: u64) {
        if self.done.len() == DONE_COUNT_MAX {
            self.done.pop_front();
        }
        self.done.push_back(trigger_id);
    }
}

impl Refusal {
    /// Refusal that names no trigger. What the state of the camera refuses may be tried again.
    pub(crate) fn new(code: u16, text: &str) -> Self {
        Self {
            code,
            trigger_id: NO_TRIGGER,
            phase: 0,
            is_retryable: (201..=206).contains(&code),
            text: text.to_owned(),
        }
    }
}

/// Fault that this trigger meets: that of its view, at attempt 0, once.
fn meet_fault(trigger_id: u64, counts: &mut Counts, device: &DeviceSettings) -> Option<Fault> {
    if trigger_id & 0xFFFF != 0 {
        return None;
    }
    let is_met = |fault: &Fault| {
        fault
            .camera_view()
            .is_some_and(|view| u64::from(view) == trigger_id >> 16)
    };
    let index = (0..device.faults.len()).find(|index| !counts.met_faults[*index] && is_met(&device.faults[*index]))?;
    counts.met_faults[index] = true;
    Some(device.faults[index])
}

const STATE_ARMED: u8 = 2;
const STATE_EXPOSING: u8 = 3;
const STATE_RECONSTRUCTING: u8 = 4;
const STATE_SENDING: u8 = 5;
const PHASE_ACKNOWLEDGE: u8 = 1;
const MODE_SOFTWARE: u8 = 1;
const SIGN_OF_LIFE_NS: u64 = 1_000_000_000;
/// Ids that a repeated trigger is compared with.
const DONE_COUNT_MAX: usize = 4096;
