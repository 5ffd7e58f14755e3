//! What the camera's bridge does whoever listens: settings, triggers, frames on their way, the device's absences.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::camera::acquisition::{Acquisition, Config, Stage};
use crate::camera::device::DeviceSettings;
use crate::camera::fields::{Str16, Zero};
use crate::camera::identity::{LINK_MBIT_S, STATE_ARMED, STATE_IDLE};
use crate::camera::message::{Aborted, Event, FetchOk, FrameEnd, Message, NO_TRIGGER, Status};
use crate::camera::render::{Capture, Frame};
use crate::camera::script::{Mark, Script};
use crate::camera::store::Store;
use crate::camera::thermal::{Thermal, WARM_UP_S};
use crate::camera::transfer::{Chunk, Picture, Transfer};
use crate::camera::trouble::Trouble;
use crate::fault::Fault;

mod passing;
mod taking;

/// The bridge, and the device behind it.
#[derive(Clone, Debug)]
pub(crate) struct Bridge {
    /// Connection of the controller.
    pub(super) controller: Option<u64>,
    /// Run that the trigger ids are of.
    run_id: Option<u64>,
    config: Option<Config>,
    is_armed: bool,
    condition: Condition,
    /// Every trigger is refused with this code until this time.
    refusing: Option<(u16, u64)>,
    acquisition: Option<Acquisition>,
    sending: Option<Sending>,
    store: Store,
    thermal: Thermal,
    script: Script,
    counts: Counts,
    /// Due and not yet polled.
    steps: VecDeque<Step>,
}

/// What is counted.
#[derive(Clone, Debug, Default)]
struct Counts {
    configs: u32,
    jobs: u64,
    frame_ids: u64,
    since_start: CountsSinceStart,
}

#[derive(Clone, Debug, Default)]
struct CountsSinceStart {
    triggers: u32,
    frames: u32,
    missed: u32,
    vendor_timeouts: u32,
    lost_packets: u32,
    last_error: u16,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    Working,
    /// The device is lost or starts anew.
    Away {
        state: u8,
        /// Code that refuses.
        code: u16,
        back_ns: u64,
    },
    Broken,
}

/// A frame on its way.
#[derive(Clone, Debug)]
struct Sending {
    transfer: Transfer,
    /// Connection it goes to.
    to: u64,
    next_ns: u64,
    /// Whether it is that of the acquisition in flight; another comes from the store.
    is_own: bool,
}

/// What the bridge wants done.
#[derive(Clone, Debug)]
pub(crate) enum Step {
    Send {
        to: u64,
        /// 0 = no reply.
        request_id: u32,
        message: Message,
        mark: Mark,
    },
    Chunk {
        to: u64,
        chunk: Chunk,
        mark: Mark,
    },
    Error {
        to: u64,
        refusal: Refusal,
    },
    /// To everyone greeted.
    Event(Event),
    /// Exposure begins.
    Expose {
        job: u64,
        trigger_id: u64,
        capture: Capture,
    },
    /// Exposure ended.
    Exposed(u64),
    HangUp(u64),
    FallSilent(u64),
    /// BYE 2 to everyone.
    Kick,
    /// The bridge starts anew.
    Restart,
}

/// Why a request is not carried out, or an acquisition ends without a frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub(crate) code: u16,
    pub(crate) trigger_id: u64,
    pub(crate) phase: u8,
    pub(crate) is_retryable: bool,
    pub(crate) retry_after_ms: u32,
    pub(crate) vendor_code: i32,
    pub(crate) text: String,
}

impl Bridge {
    /// Bridge that nobody is connected to, with its device.
    pub(crate) fn new(faults: &[Fault]) -> Self {
        let cold_count = faults.iter().find_map(|fault| match fault {
            Fault::ColdStart { trigger_count } => Some(*trigger_count),
            _ => None,
        });
        Self {
            controller: None,
            run_id: None,
            config: None,
            is_armed: false,
            condition: Condition::Working,
            refusing: None,
            acquisition: None,
            sending: None,
            store: Store::default(),
            thermal: cold_count.map_or(Thermal::warm(), Thermal::cold),
            script: Script::new(faults),
            counts: Counts::default(),
            steps: VecDeque::new(),
        }
    }

    /// The bridge starts anew: it knows of nothing before. The device stays as warm as it is.
    pub(crate) fn restart(&mut self) {
        *self = Self {
            thermal: self.thermal,
            script: core::mem::take(&mut self.script),
            counts: Counts {
                since_start: CountsSinceStart::default(),
                ..self.counts
            },
            ..Self::new(&[])
        };
    }

    /// Troubles that have happened.
    pub(crate) fn script(&self) -> &Script {
        &self.script
    }

    /// Run that is served.
    pub(crate) fn run_id(&self) -> Option<u64> {
        self.run_id
    }

    /// A controller of this run was greeted. Another run than before starts afresh.
    pub(crate) fn handle_controller(&mut self, connection: u64, run_id: u64) {
        if self.run_id != Some(run_id) {
            self.abort(NO_TRIGGER);
            self.store = Store::default();
            self.run_id = Some(run_id);
        }
        self.controller = Some(connection);
    }

    /// A connection ended. What it had triggered lives on; a frame that was being sent is stored.
    pub(crate) fn handle_gone(&mut self, connection: u64) {
        if self.controller == Some(connection) {
            self.controller = None;
            self.is_armed = false;
        }
        if let Some(sending) = self.sending.take_if(|sending| sending.to == connection)
            && sending.is_own
        {
            self.finish(Some(sending.transfer.picture().clone()));
        }
        if let Some(acquisition) = &mut self.acquisition {
            acquisition.receiver = acquisition.receiver.filter(|receiver| *receiver != connection);
        }
    }

    /// State of section 3 of the page.
    pub(crate) fn state(&self) -> u8 {
        match (self.condition, &self.acquisition) {
            (Condition::Broken, _) => STATE_FAULT,
            (Condition::Away { state, .. }, _) => state,
            (_, Some(acquisition)) => match acquisition.stage {
                Stage::Exposing => STATE_EXPOSING,
                Stage::Reconstructing => STATE_RECONSTRUCTING,
                Stage::Sending => STATE_SENDING,
            },
            (_, None) if self.is_armed => STATE_ARMED,
            (_, None) => STATE_IDLE,
        }
    }

    /// Settings in force; 0 where there are none.
    #[cfg(test)]
    pub(crate) fn config_id(&self) -> u32 {
        self.config.as_ref().map_or(0, |config| config.id)
    }

    /// STATUS.
    pub(crate) fn status(&self) -> Message {
        let counts = &self.counts.since_start;
        Message::Status(Status {
            state: self.state(),
            queue_count: 0,
            reserved_1: Zero,
            temperature_c: self.thermal.temperature_c(),
            warm_up_done_s: self.thermal.warm_up_done_s(),
            warm_up_required_s: WARM_UP_S,
            trigger_count: counts.triggers,
            frame_count: counts.frames,
            missed_count: counts.missed,
            vendor_timeout_count: counts.vendor_timeouts,
            lost_packet_count: counts.lost_packets,
            link_mbit_s: LINK_MBIT_S,
            last_error: counts.last_error,
            reserved_2: Zero,
        })
    }

    /// An ERROR leaves.
    pub(crate) fn count_error(&mut self, code: u16) {
        self.counts.since_start.last_error = code;
    }

    /// Ends the acquisition, or the sending of a stored frame, if it is the one meant. FRAME_END follows for each frame that
    /// had begun, with the connection it goes to.
    pub(crate) fn abort(&mut self, trigger_id: u64) -> (Aborted, Vec<(u64, FrameEnd)>) {
        let is_meant = |id: u64| trigger_id == NO_TRIGGER || id == trigger_id;
        let sending = self
            .sending
            .take_if(|sending| is_meant(sending.transfer.picture().trigger_id()));
        let (caught_id, phase) = match (&self.acquisition, &sending) {
            (Some(flying), _) if is_meant(flying.trigger_id) => (flying.trigger_id, flying.phase()),
            (_, Some(sending)) => (sending.transfer.picture().trigger_id(), PHASE_TRANSFER),
            _ => (trigger_id, 0),
        };
        if self
            .acquisition
            .as_ref()
            .is_some_and(|flying| is_meant(flying.trigger_id))
        {
            self.finish(None);
        }
        let aborted = Aborted {
            trigger_id: caught_id,
            phase,
            reserved: Zero,
        };
        let ends = sending
            .iter()
            .map(|sending| (sending.to, sending.transfer.end_early(1)));
        (aborted, ends.collect())
    }

    /// What FETCH answers. What is in flight, or stored, then comes to this connection.
    pub(crate) fn fetch(
        &mut self,
        now_ns: u64,
        connection: u64,
        request_id: u32,
        trigger_id: u64,
    ) -> Result<(), Refusal> {
        let refused = |code, text| {
            Err(Refusal {
                trigger_id,
                ..Refusal::new(code, text)
            })
        };
        let sent_id = self
            .sending
            .as_ref()
            .map(|sending| sending.transfer.picture().trigger_id());
        if sent_id.is_some_and(|sent_id| sent_id != trigger_id) {
            return refused(204, "another frame is being sent");
        }
        let reply = |state, remaining_us| Step::Send {
            to: connection,
            request_id,
            message: Message::FetchOk(FetchOk {
                trigger_id,
                state,
                reserved: Zero,
                remaining_us,
            }),
            mark: Mark::default(),
        };
        if let Some(flying) = self
            .acquisition
            .as_mut()
            .filter(|flying| flying.trigger_id == trigger_id)
        {
            flying.receiver = Some(connection);
            self.steps
                .push_back(reply(FETCH_IN_FLIGHT, flying.remaining_us(now_ns)));
            if flying.stage != Stage::Exposing && flying.told != Some(connection) {
                self.tell_exposure_done();
            }
        } else if sent_id.is_some() {
            self.steps.push_back(reply(FETCH_STORED, 0));
        } else if let Some(picture) = self.store.frame(trigger_id).cloned() {
            self.steps.push_back(reply(FETCH_STORED, 0));
            self.send_picture(now_ns, picture, connection, Mark::default(), false);
        } else {
            return refused(602, "no such frame");
        }
        Ok(())
    }

    /// Keeps the frame if its acquisition still waits for it.
    pub(crate) fn take_frame(&mut self, job: u64, frame: Frame) {
        if let Some(acquisition) = self.acquisition.as_mut().filter(|flying| flying.job == job) {
            acquisition.frame = Some(frame);
        }
    }

    /// When [`Bridge::poll_step`] has something.
    pub(crate) fn wake_at(&self) -> Option<u64> {
        let back_ns = match self.condition {
            Condition::Away { back_ns, .. } => Some(back_ns),
            _ => None,
        };
        let deadline_ns = self.acquisition.as_ref().and_then(|flying| flying.deadline_ns);
        let sending_ns = self.sending.as_ref().map(|sending| sending.next_ns);
        [back_ns, deadline_ns, sending_ns, self.acquisition_due_ns()]
            .into_iter()
            .flatten()
            .min()
    }

    /// Next thing that is due.
    pub(crate) fn poll_step(&mut self, now_ns: u64, device: &DeviceSettings) -> Option<Step> {
        if self.steps.is_empty() {
            self.take_what_is_due(now_ns, device);
        }
        self.steps.pop_front()
    }

    /// The acquisition in flight ended, with its frame or without.
    fn finish(&mut self, picture: Option<Arc<Picture>>) {
        if let Some(acquisition) = self.acquisition.take() {
            self.store.end(acquisition.trigger_id, picture);
        }
    }

    /// The device goes away, and everything that was in flight ends.
    fn leave(&mut self, now_ns: u64, trouble: Trouble) {
        let away = |state, code, span_s: f64| Condition::Away {
            state,
            code,
            back_ns: now_ns + (span_s * 1e9) as u64,
        };
        let (condition, code, told_s, text) = match trouble {
            Trouble::Reset { span_s } => (
                away(STATE_RESETTING, 504, span_s),
                504,
                span_s,
                "the device starts anew",
            ),
            Trouble::Lost { span_s } => (away(STATE_OFFLINE, 501, span_s), 501, 0.0, "the device is lost"),
            _ => (Condition::Broken, 500, 0.0, "the device does not work"),
        };
        if condition != Condition::Broken {
            self.push_event(now_ns, EVENT_DEVICE_LOST, NO_TRIGGER, told_s, text);
        }
        let retry_after_ms = (told_s * 1e3).ceil() as u32;
        self.give_up(code, retry_after_ms, text);
        self.condition = condition;
        self.config = None;
        self.is_armed = false;
    }

    fn come_back(&mut self, now_ns: u64) {
        self.condition = Condition::Working;
        self.push_event(now_ns, EVENT_DEVICE_BACK, NO_TRIGGER, 0.0, "the device is back");
    }

    fn push_event(&mut self, now_ns: u64, code: u16, trigger_id: u64, span_s: f64, text: &str) {
        self.steps.push_back(Step::Event(Event {
            code,
            reserved: Zero,
            trigger_id,
            device_ns: now_ns,
            duration_ms: (span_s * 1e3).ceil() as u32,
            text: Str16(text.to_owned()),
        }));
    }
}

impl Refusal {
    /// Refusal that names no trigger. What the state of the camera refuses may be tried again.
    pub(crate) fn new(code: u16, text: &str) -> Self {
        Self {
            code,
            trigger_id: NO_TRIGGER,
            phase: 0,
            is_retryable: matches!(code, 201..=206 | 401..=499 | 501..=504),
            retry_after_ms: 0,
            vendor_code: 0,
            text: text.to_owned(),
        }
    }
}

const STATE_OFFLINE: u8 = 0;
const STATE_EXPOSING: u8 = 3;
const STATE_RECONSTRUCTING: u8 = 4;
const STATE_SENDING: u8 = 5;
const STATE_FAULT: u8 = 6;
const STATE_RESETTING: u8 = 7;
const PHASE_TRANSFER: u8 = 4;
const FETCH_IN_FLIGHT: u8 = 1;
const FETCH_STORED: u8 = 2;
const EVENT_DEVICE_LOST: u16 = 3;
const EVENT_DEVICE_BACK: u16 = 4;
